"""Heights from polarised light: the surface whose specular image agrees with the photographs.

Light that the skin's boundary reflects keeps its polarisation; light from within the skin has lost nearly all of it.
The difference of two photographs, with the analyser parallel and crossed, is therefore what the boundary reflects, and
a little light that was scattered once or so. Under light k,

    D_k = strength B f(n, l_k; roughness) + rho S max(n.l_k, 0)

with f the reflection of a rough facet (GGX), B the blur of lens and pixels, S that of the short paths below the skin,
and rho the local strength of what is scattered. Unknown are the heights at the corners of the pixels: slopes at the
centres are then differences over one pixel, and integrable. They are found by Gauss-Newton together with strength,
roughness and path length, which three cannot be fitted in turns: ridges would end at 0.8 of their height.

Source: S. L. Jacques, J. C. Ramella-Roman and K. Lee, "Imaging skin pathology with polarized light", J. Biomed. Opt. 7,
2002. W.-C. Ma et al., "Rapid acquisition of specular and diffuse normal maps from polarized spherical gradient
illumination", EGSR 2007. B. Walter et al., "Microfacet models for refraction through rough surfaces", EGSR 2007, eq.
20, 33 and 34.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from splitknit.imaging.chunks import for_each_chunk
from splitknit.imaging.geometry import height_gradients, normals_from_gradients
from splitknit.imaging.light_field import light_vectors_at, lights_in_front
from splitknit.model import Array, BoolArray, FloatArray, Rig
from splitknit.photometric.equations import shading
from splitknit.skin.grid import BandImages, Grid, Slopes
from splitknit.skin.light import fresnel_reflectance, slant_of

TURNS, SETTLED = 10, (3, 1.1)
"""Gauss-Newton steps; after how many of them the roughness is too high by no more than a factor, and that factor."""
SOLVER_STEPS = 40
"""Conjugate gradients in each of them."""
RIDGES_PER_MM = 14.0
"""Angular frequency of ridges."""
SLOW_MM, SLOW_SLOPE = 0.5, 0.2
"""Standard deviation of the error of the start's slopes, as means over this length."""
PRIOR_FACTOR = (5.0, 20.0)
"""Weakens the start's relief, whose error is one of gain too: on its stated standard deviation, without lights to the
side and with them, which see the flanks."""
LOCAL_RHO = 0.3
"""Relative standard deviation of the scattered part about its mean over `SLOW_MM`: valleys are darker."""
MODEL_ERROR, FIRST_ERROR, LESS = 0.03, 0.8, 0.66
"""Error of the prediction, over the image; what it is taken for in the first step where lights stand to the side, and
the factor from step to step: facets that start far from their slope would be taken for outliers."""
SCATTERED_ERROR = 0.1
"""Error of the prediction, over its scattered part."""
GRAZING = 0.004
"""Square of the cosine of incidence at which half the light enters that is scattered once; Fresnel's transmittance and
the longer path below the skin would be 0.01 on a smooth surface, but such light also comes from beside the facet."""
LIT, SEEN = ((0.1, 0.3), (0.05, 0.2)), ((0.3, 0.2), (0.1, 0.2))
"""Cosine towards the light, and towards the camera, from which a facet is used, and how much more gives it all its
weight; without lights to the side and with them."""
STEEP = 1.0
"""Strength, roughness, path and blur are fitted where the start is less steep than this."""
START = (0.25, 2.0, 0.8)
"""Roughness, path and blur."""
BOUNDS = ((1e-9, 1e9), (0.06, 0.8), (0.3, 8.0), (0.3, 1.5), (-8.0, 8.0))
"""Bounds of strength, roughness, path, blur and lift."""
ERROR_DEG, ERROR_PART, ERROR_MM = (0, 15, 30, 45, 60, 75), (0.03, 0.05, 0.1, 0.25, 0.5, 1.0), 0.04
"""Error of the heights that films measure, as they are weighed: by slant, over the rms height of the ridges, and in mm
over the standard deviation of a slope by the images' noise, on skin that faces the camera."""
STATED_DEG, ERROR_GAIN = (7.5, 22.5, 37.5, 52.5, 75), (0.05, 0.2)
ERROR_BEND = (0.8, 1.05, 1.5, 1.8, 3.5)
"""The model's error as it is stated, without lights to the side. Of the gain: factor on the square of scattered over
specular light, and most. By slant, over the variance of the lens's blur times the ridges' curvature."""
ERROR_SIDE, ERROR_STEEP = (0.1, 0.035), ((0.03, 0.2, 0.32, 0.05, 0.3), (0.01, 0.09, 0.24, 0.04, 0.37))
"""The same with lights to the side, without films and with them: of the gain; by slant, over the ridges' height times
their slope."""
MISFIT_MEAN = 0.4
"""Mean square that is left over its expected error: the squares of both grow with its power of 3/4."""
GLINTS = 1.6
"""Slope of the ridges (root mean square) over roughness from which that error grows with it: glints hide what lies
between them."""
START_ERROR, ALIKE = 0.9, 0.6
"""Error of the start's ridges over their stated one, and its correlation with that of the films."""


@dataclass(frozen=True, slots=True)
class Specular:
    """What is fitted for a whole finger."""

    strength: float
    """Factor on the reflection of a clean boundary, in the images' units."""
    roughness: float
    """GGX alpha."""
    path_px: float
    """Standard deviation of the blur by the paths of scattered light that is still polarised, in pixels."""
    blur_px: float
    """Standard deviation of the blur of lens and pixels."""
    lift_mm: float = 0.0
    """By how much the finger lies higher than the start."""

    def changed(self, by: Array) -> Specular:
        """With the logarithms of the first four and, where given, the lift in mm changed, within their bounds."""
        factors = np.exp(by[:4])
        values = *(factors * (self.strength, self.roughness, self.path_px, self.blur_px)), self.lift_mm + by[4:].sum()
        return Specular(*(float(np.clip(value, *limits)) for value, limits in zip(values, BOUNDS, strict=True)))


@dataclass(frozen=True, slots=True, eq=False)
class SpecularImages:
    """Parallel less crossed images, mean over the channels."""

    stack: FloatArray
    """(L, h, w)."""
    noise: float
    """Standard deviation of a pixel."""
    rig: Rig
    """`rig.leds[k]` lights image k."""


def specular_images(
    both: BandImages, crossed: BandImages, rig: Rig, grid: Grid, surface_mm: FloatArray
) -> SpecularImages:
    """The difference of two polarised series, on a smooth surface (h, w): of `both`, their mean, and of the crossed
    one.

    A crossed series with LEDs of its own is taken as under the parallel one's, `rig.leds[k]` of image k: by the
    brightness of the matt surface under both.
    """
    stack = 2 * (both.stack - crossed.stack).mean(axis=0)
    if rig.leds != crossed.rig.leds:
        normals = np.moveaxis(normals_from_gradients(*height_gradients(surface_mm, grid.pitch_mm)), -1, 0)
        matt = []
        for lights in (rig, crossed.rig):
            vectors = grid.view.turned(light_vectors_at(lights, *grid.view.points(surface_mm)))
            matt.append(np.maximum(shading(normals, vectors), 0.05))
        stack -= (matt[0] / matt[1] - 1) * crossed.stack.mean(axis=0)
    laplacian = 4 * stack[:, 1:-1, 1:-1] - stack[:, :-2, 1:-1] - stack[:, 2:, 1:-1]
    laplacian -= stack[:, 1:-1, :-2] + stack[:, 1:-1, 2:]
    lit = crossed.stack[0, :, 1:-1, 1:-1] > 0
    noise = float(np.median(np.abs(laplacian[lit])) / 0.6745 / np.sqrt(20)) if lit.any() else 0.0
    return SpecularImages(stack, max(noise, 1e-6), rig)


def polarised_heights(
    images: SpecularImages, grid: Grid, start_mm: FloatArray, deviation_mm: FloatArray, roughest: float | None = None
) -> tuple[FloatArray, FloatArray, dict[str, float]]:
    """Heights by the specular image of the fine grid, from a finite start (h, w) of about the right shape and relief.
    `deviation_mm`: (h, w) stated standard deviation of its ridges' heights. Returns heights (h, w) along the line of
    sight, finite everywhere, the standard deviation (h, w) of their ridges, and what was found. Both are the means of
    what films show and of the start, weighted by their variances. `roughest`: of images without films; skin that turns
    out rougher is not fitted to the end.
    """
    difference, noise, mask = images.stack, images.noise, grid.mask & (grid.depth_mm > 3 * grid.pitch_mm)
    gains, specular = np.ones((2, len(difference)), dtype=np.float32), Specular(0.0, *START)
    lights = _Lights.of(images.rig, grid, start_mm, gains)
    solver = _Solver(start_mm, grid)
    nodes, before = solver.start, _slopes(solver.start, grid.pitch_mm)
    known = mask & (before[0] ** 2 + before[1] ** 2 < STEEP**2)
    side = np.flatnonzero(~lights_in_front(images.rig))
    spread = PRIOR_FACTOR[bool(side.size)] * RIDGES_PER_MM * np.maximum(deviation_mm, 1e-3)
    prior = (1 / np.minimum(spread, 1.0) ** 2).astype(np.float32)
    first = FIRST_ERROR if side.size else MODEL_ERROR
    reached = np.ones(difference.shape, dtype=np.float32)
    reached[side] = 0  # the brightness of lights to the side is fitted first
    weight = _weight(images, mask, slice(None), first) * reached
    fit = np.zeros(side.size, dtype=np.bool_)  # a light that does not fit waits: glints of oily skin do later
    for count in range(TURNS):
        higher = None
        if fit.any():  # from there on the lights' brightness and the finger's height are fitted
            lights, higher = (
                _Lights.of(images.rig, grid, start_mm + (specular.lift_mm + by), gains) for by in (0, RAISED_MM)
            )
        for k in side[fit]:
            if count % SHADOWS_EVERY == 1 or not reached[k].any():
                reached[k] = lights.reached(int(k), _shifted(nodes, -0.5, -1), grid)
        slopes = _slopes(nodes, grid.pitch_mm)
        sharp, soft = _predicted(lights, slopes, specular, mask)
        strength, rho, rho_mean = _strengths((difference, weight), (sharp, soft), grid, mask, specular.strength)
        specular = replace(specular, strength=strength)
        off = slopes[0] - before[0], slopes[1] - before[1]
        error = max(MODEL_ERROR, first * LESS**count)
        turn = _Turn(
            images, grid, mask, lights, higher, slopes, specular, sharp, soft, rho, error, reached, side[fit],
            bool(side.size), prior, off, rho_mean,
        )  # fmt: skip
        change = _change(turn, known)
        tensor, force = _system(turn, change, weight)
        step, added = solver.solve(tensor, force, nodes)
        nodes = nodes + added
        numbers, brightness = np.split(step * change, [change.size - 2 * turn.aside.size])
        specular = specular.changed(numbers)
        gains[:, turn.aside] *= np.exp(brightness).reshape(2, -1)
        if roughest is not None and count >= SETTLED[0] and specular.roughness > SETTLED[1] * roughest:
            break
        fit = _fitted(turn, side, gains, MISFIT[count > TURNS // 2])
    tensor[0::2] -= prior
    height_mm = _shifted(nodes, -0.5, -1)
    shown = np.maximum(turn.specular.strength * sharp, 1e-9)
    left = (difference - shown - rho * soft)[:, mask]
    ratio = float((rho * soft)[:, mask].mean() / shown[:, mask].mean())
    gain, blur_mm = min(ERROR_GAIN[0] * ratio**2, ERROR_GAIN[1]), specular.blur_px * grid.pitch_mm
    tensor = grid.smooth(tensor, mask, NEAR_MM)
    height_mm, stated_mm = _joined(
        height_mm, start_mm, deviation_mm, tensor, grid, blur=blur_mm**2, gain=gain, roughness=specular.roughness,
        films=roughest is None, misfit=_misfit(turn) if fit.any() else None,
    )  # fmt: skip
    facts = {
        "side_lights": float(reached[side].any(axis=(1, 2)).sum()),
        "roughness": specular.roughness,
        "scattered_over_specular": ratio,
        "specular_over_noise": float(np.median(shown.max(axis=0)[mask]) / noise),
        "residual_over_noise": float(np.sqrt(np.median(left**2) / 0.455) / noise),
    }
    return height_mm, stated_mm, facts


def _misfit(turn: _Turn) -> FloatArray:
    """(h, w) local mean square over the lights of what is left of the images, over its expected error."""
    shown, scattered = turn.specular.strength * turn.sharp, turn.rho * turn.soft
    expected = turn.images.noise**2 + (MODEL_ERROR * turn.images.stack) ** 2
    expected += (SCATTERED_ERROR * scattered) ** 2
    found = (turn.reached * (turn.images.stack - shown - scattered) ** 2 / expected).mean(axis=0)
    return turn.grid.smooth(found, turn.mask, RIDGE_MM)


NEAR_MM, RIDGE_MM = 0.1, 0.3
"""Standard deviations of the Gaussians over which what the images say is averaged, and that parts ridges from shape."""


def _joined(
    height_mm: FloatArray, start_mm: FloatArray, deviation_mm: FloatArray, known: FloatArray, grid: Grid,
    *, blur: float, gain: float, roughness: float, films: bool, misfit: FloatArray | None,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Heights and their standard deviation, from those that films show and those of the start, by their variances.
    `known`: (3, h, w) inverse covariance of a slope (xx, xy, yy); `blur`: variance of the lens's blur in mm^2; `gain`:
    error of the gain; `misfit`: with lights to the side, (h, w) mean square over the lights of what is left over its
    expected error."""
    shape = grid.smooth(start_mm, grid.mask, RIDGE_MM)
    slant = slant_of(shape, grid.pitch_mm)
    rest = start_mm - height_mm
    rest -= grid.smooth(rest, grid.mask, RIDGE_MM)
    ridges = height_mm - shape
    ridges -= grid.smooth(ridges, grid.mask, RIDGE_MM)
    x, y = height_gradients(ridges, grid.pitch_mm)
    bend = height_gradients(x, grid.pitch_mm)[0] + height_gradients(y, grid.pitch_mm)[1]
    facing = np.cos(np.deg2rad(slant))
    flat = grid.mask & (facing >= np.quantile(facing[grid.mask], 0.5))
    relief = np.sqrt((ridges[flat] ** 2).mean(dtype=np.float64))
    both = np.maximum(known[0] * known[2] - known[1] * known[1], 1e-3)
    noise = ERROR_MM**2 * (known[0] + known[2]) / (2 * both * np.maximum(facing, 0.2) ** 4)
    of_films = (np.interp(slant, ERROR_DEG, ERROR_PART) * relief) ** 2 + noise
    of_start = np.maximum(START_ERROR * deviation_mm, 1e-4) ** 2
    common = np.float32(ALIKE) * np.sqrt(of_films * of_start)
    part = np.clip((of_films - common) / (of_films + of_start - 2 * common), 0, 1)
    if misfit is None:
        glints = np.sqrt((x * x + y * y)[flat].mean(dtype=np.float64)) / (GLINTS * roughness)
        lost = np.interp(slant, STATED_DEG, ERROR_BEND).astype(np.float32) * bend
        lost *= np.float32(blur * max(glints, 1))
        stated = noise + grid.smooth(lost * lost + (gain * ridges) ** 2, grid.mask, RIDGE_MM)
    else:
        steep, power = (grid.smooth(one, grid.mask, RIDGE_MM) for one in (x * x + y * y, ridges * ridges))
        lost = np.interp(slant, STATED_DEG, ERROR_STEEP[films]).astype(np.float32) ** 2 * steep
        lost += ERROR_SIDE[films] ** 2
        stated = noise + power * lost * (misfit / MISFIT_MEAN) ** np.float32(0.75)
    common = np.float32(ALIKE) * np.sqrt(stated * of_start)
    left = part**2 * of_start + (1 - part) ** 2 * stated + 2 * part * (1 - part) * common
    return (height_mm + part * rest).astype(np.float32), np.sqrt(left).astype(np.float32)


# One prediction: both parts of the difference for strengths of one, and their derivatives, some rows at a time.


@dataclass(frozen=True, slots=True, eq=False)
class _Lights:
    """The lights on the start, on every `EVERY`-th row: they vary little."""

    fields: FloatArray
    """(8, L, n, w): unit vector towards the light, irradiance at normal incidence; unit vector halfway to the camera,
    irradiance times Fresnel's reflectance there."""
    between: FloatArray
    """(h, n) weights of the rows."""
    grazing: float
    """`GRAZING` with lights to the side, else 0."""

    @classmethod
    def of(cls, rig: Rig, grid: Grid, surface_mm: FloatArray, gains: FloatArray) -> _Lights:
        some = slice(None, None, EVERY)
        vectors = np.moveaxis(
            grid.view.turned(light_vectors_at(rig, *grid.view.points(surface_mm[some], some)), some), 1, 0
        )
        irradiance = np.sqrt((vectors * vectors).sum(axis=0))
        towards = vectors / np.maximum(irradiance, 1e-12)
        half = towards + np.array([0, 0, 1], dtype=np.float32)[:, None, None, None]
        length = np.maximum(np.sqrt((half * half).sum(axis=0)), 1e-6)
        fields = np.stack([*towards, irradiance, *(half / length), irradiance * fresnel_reflectance(length / 2)])
        fields[3::4] *= gains[..., None, None]
        rows, count = np.arange(grid.shape[0]), fields.shape[2]
        between = np.zeros((len(rows), count), dtype=np.float32)
        low = np.minimum(rows // EVERY, max(count - 2, 0))
        between[rows, low] = 1 - (rows / EVERY - low)
        between[rows, np.minimum(low + 1, count - 1)] += rows / EVERY - low
        aside = not lights_in_front(rig).all()
        return cls(fields, between, GRAZING * aside)

    def reached(self, k: int, surface_mm: FloatArray, grid: Grid) -> FloatArray:
        """(h, w) in [0, 1]: which part of the surface (h, w) no cast shadow hides from light `k`."""
        found, size = np.ones(grid.shape, dtype=np.float32), (grid.shape[1], grid.shape[0])
        middle = np.unravel_index(int(np.argmax(grid.depth_mm)), grid.shape)
        x, y, z = np.matmul(self.between, self.fields[:3, k])
        rise = z / np.maximum(np.hypot(x, y), 1e-3) * grid.pitch_mm
        right, up = (float(one[middle]) for one in (x, y))
        right, up = right / np.hypot(right, up), up / np.hypot(right, up)
        for far in SHADOW_PX:
            matrix = np.array([[1, 0, far * right], [0, 1, -far * up]], dtype=np.float32)
            flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
            above = cv2.warpAffine(surface_mm, matrix, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
            above -= surface_mm + far * rise
            np.minimum(found, 0.5 - above / (2 * PENUMBRA * far * grid.pitch_mm), out=found)
        return np.clip(found, 0, 1, out=found)

    def on(self, rows: slice) -> FloatArray:
        """(8, L, rows, w)."""
        part = slice(max(min(rows.start // EVERY, self.between.shape[1] - 2), 0), (rows.stop - 1) // EVERY + 2)
        return np.asarray(np.matmul(self.between[rows, part], self.fields[:, :, part]))


def _fitted(turn: _Turn, side: NDArray[np.intp], gains: FloatArray, misfit: float) -> BoolArray:
    """Fit the brightness of the lights `side` that did not fit before, in `gains` (2, L), which are kept within bounds.
    Returns which fit; the others are left out."""
    some, fit = slice(None, None, 3), np.zeros(side.size, dtype=np.bool_)
    for n, k in enumerate(side):
        parts = turn.rho[some] * turn.soft[k, some], turn.specular.strength * turn.sharp[k, some]
        found = _brightness(turn.images.stack[k, some], turn.error, parts, misfit)
        fit[n] = found is not None
        gains[:, k] *= (1, 1) if found is None or k in turn.aside else found
        turn.reached[k] *= fit[n]
    np.clip(gains, *GAINS, out=gains)
    return fit


def _brightness(
    measured: FloatArray, error: float, parts: tuple[FloatArray, FloatArray], misfit: float
) -> tuple[float, float] | None:
    """Brightness of a light, over the present one, by what is `measured` (h, w) of it: of what is scattered and of what
    is reflected, whose predictions are `parts` in turn: films change both at grazing light (Fresnel's two
    reflectances). `error`: of the prediction, over the image. None if the light leaves more than `misfit`.
    """
    left = measured - parts[0] - parts[1]
    lit = parts[1] > 0
    if not lit.any():
        return None
    usual = np.median(np.abs(left[lit]))
    weight = 1 / ((error * measured) ** 2 + (2 * usual) ** 2 + left * left + 1e-12)
    columns = [weight * part for part in parts]
    normal = np.array([[float((a * b).sum(dtype=np.float64)) for b in parts] for a in columns])
    force = np.array([float((a * measured).sum(dtype=np.float64)) for a in columns])
    prior = np.diag(PRIOR_GAIN * np.diag(normal)) + 1e-9 * np.eye(2)
    gains = np.clip(np.linalg.solve(normal + prior, force + prior.sum(axis=1)), *GAINS)
    left = measured - np.float32(gains[0]) * parts[0] - np.float32(gains[1]) * parts[1]
    return None if left[lit].std() > misfit * measured[lit].std() else (float(gains[0]), float(gains[1]))


SHADOWS_EVERY, PENUMBRA = 4, 0.05
"""Steps after which cast shadows are found anew, and half the tangent over which they are soft: the LED's size, and
the error of the surface."""
SHADOW_PX = (*range(1, 13), 14, 16, 19, 22, 26, 31, 38, 47, 60, 80, 110, 160)
"""Distances at which the surface may stand in the way."""
PRIOR_GAIN, GAINS, MISFIT = 0.02, (0.15, 3.0), (0.8, 0.5)
"""Weight of a brightness of one, over that of the images; what is left of a light to the side, over its image (rms),
from which it waits, in the first steps and later. A path-traced finger's leave 0.36 at first and 0.09 at last;
lights whose films are turned, so that what they reflect does not pass the camera's, leave 0.82 to 13."""
EVERY, PER_CHUNK = 8, 2
"""Rows over which light changes little; chunks are smaller by the latter, as a facet has many numbers."""


def _predicted(lights: _Lights, slopes: Slopes, specular: Specular, mask: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Specular and scattered images (L, h, w) of strengths of one."""
    rows, columns = mask.shape
    sharp = np.empty((lights.fields.shape[1], rows, columns), dtype=np.float32)
    soft, inside = np.empty_like(sharp), mask.astype(np.float32)

    def work(part: slice) -> None:
        here = slopes[0][part], slopes[1][part]
        image, matt = _facets(lights.on(part), here, specular.roughness, lights.grazing)
        sharp[:, part], soft[:, part] = image * inside[part], matt * inside[part]

    for_each_chunk(work, rows, columns, PER_CHUNK * len(sharp))
    _blur(sharp, specular.blur_px, inside)
    _blur(soft, float(np.hypot(specular.blur_px, specular.path_px)), inside)
    return sharp, soft


def _blur(stack: FloatArray, sigma_px: float, inside: FloatArray) -> None:
    """Gaussian means over the finger, in place."""
    around = np.maximum(cv2.GaussianBlur(inside, (0, 0), sigma_px), 0.05)
    with ThreadPoolExecutor(2) as pool:
        list(pool.map(lambda one: np.divide(cv2.GaussianBlur(one, (0, 0), sigma_px), around, out=one), stack))


def _facets(
    light: FloatArray, slopes: Slopes, roughness: float, grazing: float = 0.0, *, derivatives: bool = False
) -> list[FloatArray]:
    """Specular and matt image (L, h, w); with `derivatives` also theirs by dz/dx and dz/dy, that of the specular image
    by the roughness's logarithm, and the cosine of incidence."""
    p, q = slopes
    towards, irradiance, half, reflected = light[:3], light[3], light[4:7], light[7]
    nz = 1 / np.sqrt(1 + p * p + q * q)
    cosine = (towards[2] - p * towards[0] - q * towards[1]) * nz
    nh = (half[2] - p * half[0] - q * half[1]) * nz
    lit = cosine > 1e-3
    nl = np.maximum(cosine, 1e-3)
    a2 = np.float32(roughness * roughness)
    b = 1 - a2
    below = 1 - b * nh * nh
    root_l, root_z = np.sqrt(a2 + b * nl * nl), np.sqrt(a2 + b * nz * nz)
    unit = irradiance * lit
    entering = nl * nl + grazing
    matt = unit * nl * (nl * nl / entering)
    image = reflected * lit * nl * (a2 / np.pi / (nz + root_z)) / (below * below * (nl + root_l))
    if not derivatives:
        return [image, matt]
    by_h = 4 * b * nh / below
    by_l = 1 / nl - (1 + b * nl / root_l) / (nl + root_l)
    by_z = -(1 + b * nz / root_z) / (nz + root_z)
    by_matt = unit * (nl * nl / entering) * (1 + 2 * grazing / entering)
    specular, scattered = [], []
    for axis, slope in enumerate(slopes):
        turned = slope * nz * nz
        dl, dh = -towards[axis] * nz - nl * turned, -half[axis] * nz - nh * turned
        specular.append(image * (by_h * dh + by_l * dl - by_z * turned * nz))
        scattered.append(by_matt * dl)
    rougher = 2 - 4 * a2 * nh * nh / below
    rougher -= a2 * ((1 - nl * nl) / (root_l * (nl + root_l)) + (1 - nz * nz) / (root_z * (nz + root_z)))
    return [image, matt, *specular, *scattered, image * rougher, cosine]


def _strengths(
    measured: tuple[FloatArray, FloatArray], predicted: tuple[FloatArray, FloatArray], grid: Grid, mask: BoolArray,
    strength: float,
) -> tuple[float, FloatArray, FloatArray]:  # fmt: skip
    """Specular strength, by least squares where zero, and that of the scattered part (h, w) with its local mean."""
    (difference, weight), (sharp, soft), first = measured, predicted, strength == 0
    sums = np.empty((5, *mask.shape), dtype=np.float32)

    def work(rows: slice) -> None:
        heavy, given = weight[:, rows] * soft[:, rows], difference[:, rows]
        lobe = weight[:, rows] * sharp[:, rows]
        pairs = ((heavy, given), (heavy, sharp[:, rows]), (heavy, soft[:, rows]), (lobe, sharp[:, rows]), (lobe, given))
        for total, (one, other) in zip(sums, pairs, strict=True):
            np.einsum("lij,lij->ij", one, other, out=total[rows])

    for_each_chunk(work, *grid.shape, PER_CHUNK * len(soft))
    right, both, power = sums[:3]
    means = grid.smooth(sums[:3], mask, SLOW_MM)
    own, given = (float(one.sum(dtype=np.float64)) for one in sums[3:])
    strength = given / max(own, 1e-12) if first else strength
    for turn in range(7 if first else 1, 0, -1):
        s = strength
        mean = np.maximum((means[0] - s * means[1]) / np.maximum(means[2], 1e-9), 1e-6)
        prior = 1 / (LOCAL_RHO * mean) ** 2
        rho = np.where(mask, (right - s * both + prior * mean) / (power + prior), 0.0)
        if turn > 1:
            strength = max((given - float((rho * both).sum(dtype=np.float64))) / max(own, 1e-12), 1e-9)
    return strength, rho, mean


def _weight(images: SpecularImages, mask: BoolArray, rows: slice, relative: float) -> FloatArray:
    """(L, rows, w) inverse variance of the difference; `relative`: error of the prediction."""
    error = relative * images.stack[:, rows]
    return mask[rows] / (images.noise**2 + error * error)


# One step: linear equations for slopes, scattered part and the finger's four numbers.


@dataclass(frozen=True, slots=True, eq=False)
class _Turn:
    """Where a step starts."""

    images: SpecularImages
    grid: Grid
    mask: BoolArray
    lights: _Lights
    higher: _Lights | None
    """The same on a finger that lies `RAISED_MM` higher, where lights to the side show how high it lies."""
    slopes: Slopes
    specular: Specular
    sharp: FloatArray
    """(L, h, w) specular images of strength one."""
    soft: FloatArray
    """(L, h, w) scattered ones."""
    rho: FloatArray
    """(h, w) strength of the scattered part."""
    error: float
    """Of the prediction, over the image."""
    reached: FloatArray
    """(L, h, w) in [0, 1]: the surface that no cast shadow hides from a light."""
    aside: NDArray[np.intp]
    """Lights to the side whose brightness is fitted."""
    with_side: bool
    """Whether there are lights to the side."""
    prior: FloatArray
    """(h, w) inverse variance of the start's slopes."""
    slopes_off: Slopes
    """From the start's."""
    rho_mean: FloatArray
    """(h, w) local mean of the scattered part's strength."""

    def columns(self, rows: slice, lift: bool = False) -> tuple[list[FloatArray], FloatArray]:
        """Derivatives of some rows by both slopes and rho, their residual, derivatives by the logarithms of strength,
        roughness, path and blur, and by the `lift`; and weights: (L, rows, w) each. Derivatives by slopes, roughness
        and lift leave out the blur, an effect of second order.
        """
        p, q = slopes = self.slopes[0][rows], self.slopes[1][rows]
        grazing, roughness = self.lights.grazing, self.specular.roughness
        facets = _facets(self.lights.on(rows), slopes, roughness, grazing, derivatives=True)
        strength, rho, soft = self.specular.strength, self.rho[rows], self.soft[:, rows]
        shown, scattered = strength * self.sharp[:, rows], self.rho[rows] * soft
        residual = self.images.stack[:, rows] - shown - scattered
        weight = _weight(self.images, self.mask, rows, self.error)
        trust = _from(facets[7], LIT[self.with_side])
        trust *= _from(1 / np.sqrt(1 + p * p + q * q), SEEN[self.with_side])
        error = SCATTERED_ERROR * scattered
        trust *= self.reached[:, rows]
        gate = trust / ((1 + weight * error * error) * (1 + weight * residual * residual / 9))
        damped = rho * np.float32(np.exp(-0.5 * (RIDGES_PER_MM * self.grid.pitch_mm * self.specular.path_px) ** 2))
        x, y = (strength * facets[2 + n] + damped * facets[4 + n] for n in range(2))
        wider = np.float32(self.specular.path_px**2) * rho * _laplacian(self.soft, rows)  # heat equation
        blurrier = np.float32(self.specular.blur_px**2) * strength * _laplacian(self.sharp, rows)
        columns = [x, y, soft, residual, shown, strength * facets[6], wider, blurrier]
        if lift and self.higher is not None:
            image, matt = _facets(self.higher.on(rows), slopes, roughness, grazing)
            columns.append((strength * (image - facets[0]) + rho * (matt - facets[1])) / RAISED_MM)
        return columns, weight * gate

    def brightness(self, rows: slice) -> list[tuple[int, FloatArray]]:
        """Lights to the side and derivatives (rows, w) of their images by the logarithms of their two brightnesses."""
        shown = self.specular.strength * self.sharp[self.aside, rows]
        scattered = self.rho[rows] * self.soft[self.aside, rows]
        return [(int(k), part) for parts in (scattered, shown) for k, part in zip(self.aside, parts, strict=True)]


def _from(cosine: FloatArray, limits: tuple[float, float]) -> FloatArray:
    """Weights in [0, 1]."""
    return np.asarray(np.clip((cosine - limits[0]) / limits[1], 0, 1))


def _laplacian(stack: FloatArray, rows: slice) -> FloatArray:
    """(L, rows, w) of some rows of `stack`."""
    first = max(rows.start - 1, 0)
    inner = slice(rows.start - first, rows.stop - first)
    return np.stack([cv2.Laplacian(one, cv2.CV_32F)[inner] for one in stack[:, first : rows.stop + 1]])


PRIOR_WEIGHTS, MOST = (1e-6, 1e-6, 1.0, 1.0, 0.1), (0.25, 0.25, 0.25, 0.25, 1.5)
"""Weights of the priors on the change of the finger's numbers, relative to the images, and its most in one step."""
RAISED_MM = 1.0
"""Step of the derivative by the finger's lift."""
STRIPES = 12
"""Chunks of rows that give them, about."""


def _change(turn: _Turn, known: BoolArray) -> Array:
    """Of the logarithms of strength, roughness, path and blur, and, where lights to the side show them, of the lift in
    mm and of these lights' brightness (scattered, then reflected), with whatever slopes suit the `known` pixels best.
    """
    sums: dict[int, Array] = {}

    def work(rows: slice) -> None:
        height = rows.stop - rows.start
        if (rows.start // height) % max(1, turn.grid.shape[0] // (STRIPES * height)):
            return
        columns, weight = turn.columns(rows, lift=True)
        gram = _gram(turn, columns, weight, rows, turn.brightness(rows))
        for slope in range(2):
            gram = _without(gram, slope)
        sums[rows.start] = gram[3:, 3:, known[rows]].sum(axis=2, dtype=np.float64)

    for_each_chunk(work, *turn.grid.shape, PER_CHUNK * len(turn.soft))
    total = np.sum([sums[start] for start in sorted(sums)], axis=0)
    damping, most = (np.full(len(total) - 1, values[0]) for values in (PRIOR_WEIGHTS, MOST))
    numbers = 4 + (turn.higher is not None)
    damping[:numbers], most[:numbers] = PRIOR_WEIGHTS[:numbers], MOST[:numbers]
    return np.clip(np.linalg.solve(total[1:, 1:] + np.diag(damping), total[1:, 0]), -most, most)


def _system(turn: _Turn, change: Array, used: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Tensor (3, h, w) of the slopes (xx, xy, yy) and force (2, h, w) on them, the four numbers changed and the
    scattered part eliminated at each pixel; `used` (L, h, w) becomes the weights."""
    tensor, force = (np.empty((n, *turn.mask.shape), dtype=np.float32) for n in (3, 2))

    def work(rows: slice) -> None:
        columns, weight = turn.columns(rows)
        brightness = turn.brightness(rows)
        for by, column in zip(change.astype(np.float32), columns[4:], strict=False):  # the lift's comes in the next one
            columns[3] -= by * column
        for by, (k, column) in zip(change[change.size - len(brightness) :], brightness, strict=True):
            columns[3][k] -= np.float32(by) * column
        gram = _gram(turn, columns[:4], weight, rows)
        tensor[:, rows], force[:, rows] = (gram[0, 0], gram[0, 1], gram[1, 1]), (gram[0, 3], gram[1, 3])
        used[:, rows] = weight

    for_each_chunk(work, *turn.grid.shape, PER_CHUNK * len(turn.soft))
    return tensor, force


def _gram(
    turn: _Turn, columns: list[FloatArray], weight: FloatArray, rows: slice,
    single: Sequence[tuple[int, FloatArray]] = (),
) -> FloatArray:  # fmt: skip
    """Normal equations (n, n, rows, w) of columns, of those of a `single` light each, and of the prior, the scattered
    part eliminated."""
    count, heavy = len(columns), [weight * column for column in columns]
    gram = np.zeros((count + len(single), count + len(single), *weight.shape[1:]), dtype=np.float32)
    for i, one in enumerate(heavy):
        for j, other in enumerate(columns[: i + 1]):
            gram[i, j] = gram[j, i] = np.einsum("lij,lij->ij", one, other)
    for n, (k, column) in enumerate(single, count):
        for i, one in enumerate(heavy):
            gram[i, n] = gram[n, i] = one[k] * column
        for m, (light, beside) in enumerate(single, count):
            if light == k:
                gram[n, m] = weight[k] * column * beside
    for axis, off in enumerate(turn.slopes_off):
        gram[axis, axis] += turn.prior[rows]
        gram[axis, 3] -= turn.prior[rows] * off[rows]
        gram[3, axis] = gram[axis, 3]
    mean = turn.rho_mean[rows]
    stiff = 1 / (LOCAL_RHO * mean) ** 2
    gram[2, 2] += stiff
    gram[2, 3] -= stiff * ((turn.rho[rows] - mean) * turn.mask[rows])
    gram[3, 2] = gram[2, 3]
    return _without(gram, 2)


def _without(gram: FloatArray, i: int) -> FloatArray:
    """Normal equations (n, n, rows, w) with an unknown eliminated."""
    return np.asarray(gram - gram[:, i, None] * (gram[i] / np.maximum(gram[i, i], 1e-12)))


# Heights at the corners of the pixels.


class _Solver:
    """Heights (h + 1, w + 1) of least squares with a tensor at every pixel, by conjugate gradients on their cosine
    transform, in which the slopes' prior and the preconditioner (Poisson's equation with the mean tensor) are diagonal.
    """

    def __init__(self, start_mm: FloatArray, grid: Grid) -> None:
        self.start = _shifted(start_mm, 0.5, 1)
        """Start at the corners."""
        self._pitch, self._mask = grid.pitch_mm, grid.mask
        self._size = tuple(scipy.fft.next_fast_len(n, True) for n in self.start.shape)
        rows, columns = ((2 - 2 * np.cos(np.pi * np.arange(n) / n)) / grid.pitch_mm**2 for n in self._size)
        self._square = (rows[:, None] + columns[None]).astype(np.float32)
        self._slow = self._square * np.exp(-self._square * SLOW_MM**2) / SLOW_SLOPE**2

    def solve(self, tensor: FloatArray, force: FloatArray, nodes: FloatArray) -> tuple[float, FloatArray]:
        """Part of the step that is taken, and the change of the heights."""
        damped = tensor.copy()
        damped[0::2] += 0.02 * (tensor[0] + tensor[2])
        mean = np.float32(np.median((tensor[0] + tensor[2])[self._mask]) / 2)
        rest = 1e-6 * mean
        precondition = 1 / (self._square * mean + self._slow + rest)

        def product(x: FloatArray) -> FloatArray:
            along, up = _slopes(self._inverse(x), self._pitch)
            turned = damped[0] * along + damped[1] * up, damped[1] * along + damped[2] * up
            return np.asarray(self._forward(_transposed(*turned, self._pitch)) + (self._slow + rest) * x)

        residual = self._forward(_transposed(force[0], force[1], self._pitch))
        residual -= self._slow * self._forward(nodes - self.start)
        x = np.zeros_like(residual)
        better = precondition * residual
        along, size = better, _dot(residual, better)
        first = size
        for _ in range(SOLVER_STEPS):
            if size <= 1e-6 * first:
                break
            image = product(along)
            length = size / _dot(along, image)
            x, residual = x + length * along, residual - length * image
            better = precondition * residual
            size, last = _dot(residual, better), size
            along = better + size / last * along
        added = self._inverse(x)
        steepest = float(np.percentile(np.hypot(*_slopes(added, self._pitch))[self._mask], 99.5))
        step = min(1.0, MAX_SLOPE_STEP / max(steepest, 1e-9))
        return step, added * step

    def _forward(self, nodes: FloatArray) -> FloatArray:
        return np.asarray(scipy.fft.dctn(nodes, s=self._size, norm="ortho", workers=2), dtype=np.float32)

    def _inverse(self, spectrum: FloatArray) -> FloatArray:
        rows, columns = self.start.shape
        return np.asarray(scipy.fft.idctn(spectrum, norm="ortho", workers=2)[:rows, :columns], dtype=np.float32)


MAX_SLOPE_STEP = 0.6
"""Largest change of a slope in one step, but for a few pixels."""


def _dot(a: FloatArray, b: FloatArray) -> float:
    return float(np.einsum("ij,ij->", a, b, dtype=np.float64))


def _slopes(nodes: FloatArray, pitch_mm: float) -> Slopes:
    """dz/dx and dz/dy (h, w) at the centres of the pixels whose corners are `nodes` (h + 1, w + 1)."""
    half = 0.5 / pitch_mm
    falling = (nodes[:-1, 1:] - nodes[1:, :-1]) * half
    rising = (nodes[1:, 1:] - nodes[:-1, :-1]) * half
    return rising + falling, falling - rising


def _transposed(x: FloatArray, y: FloatArray, pitch_mm: float) -> FloatArray:
    """The transpose of :func:`_slopes`."""
    half = 0.5 / pitch_mm
    nodes = np.zeros((x.shape[0] + 1, x.shape[1] + 1), dtype=np.float32)
    falling, rising = (x + y) * half, (x - y) * half
    nodes[:-1, 1:] += falling
    nodes[1:, :-1] -= falling
    nodes[1:, 1:] += rising
    nodes[:-1, :-1] -= rising
    return nodes


def _shifted(image: FloatArray, by: float, larger: int) -> FloatArray:
    """An image (h + larger, w + larger) moved by a part of a pixel, bicubic."""
    matrix = np.array([[1, 0, by], [0, 1, by]], dtype=np.float32)
    size = (image.shape[1] + larger, image.shape[0] + larger)
    moved = cv2.warpAffine(image, matrix, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(moved)
