"""Heights from polarised light: the surface whose specular image agrees with the photographs.

Light that the skin's boundary reflects keeps its polarisation; light from within the skin has lost nearly all of it.
The difference of two photographs, with the analyser parallel and crossed, is therefore what the boundary reflects, and
a little light that was scattered once or so. Under light k,

    D_k = strength B f(n, l_k; roughness) + rho S max(n.l_k, 0)

with f the reflection of a rough facet (GGX), B the blur of lens and pixels, S that of the short paths below the skin,
and rho the local strength of what is scattered. Unknown are the heights at the corners of the pixels: slopes at the
centres are then differences over one pixel, and integrable. They are found by Gauss-Newton together with strength,
roughness and path length, which three cannot be fitted in turns: ridges would end at 0.8 of their height.

References
----------
S. L. Jacques, J. C. Ramella-Roman and K. Lee, "Imaging skin pathology with polarized light", J. Biomed. Opt. 7, 2002.
W.-C. Ma et al., "Rapid acquisition of specular and diffuse normal maps from polarized spherical gradient illumination",
EGSR 2007.
B. Walter et al., "Microfacet models for refraction through rough surfaces", EGSR 2007, eq. 20, 33 and 34.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.imaging.chunks import for_each_chunk
from splitknit.imaging.geometry import height_gradients, normals_from_gradients
from splitknit.imaging.light_field import light_vectors_at
from splitknit.model import BoolArray, FloatArray, Rig
from splitknit.photometric.equations import shading
from splitknit.skin.glare import fresnel_reflectance
from splitknit.skin.grid import BandImages, Grid
from splitknit.skin.light import slant_of

Slopes = tuple[FloatArray, FloatArray]
"""dz/dx and dz/dy (h, w), y up."""
TURNS = 4
"""Gauss-Newton steps."""
SOLVER_STEPS = 24
"""Conjugate gradients in each of them: where the images say little, the surface stays near its start."""
RIDGES_PER_MM = 14.0
"""Angular frequency of ridges."""
SLOW_MM, SLOW_SLOPE = 0.5, 0.2
"""Standard deviation of the error of the start's slopes, as means over this length."""
PRIOR_FACTOR = 5.0
"""Weakens the start's relief, whose error is one of gain too: on its stated standard deviation."""
LOCAL_RHO = 0.3
"""Relative standard deviation of the scattered part about its mean over `SLOW_MM`: valleys are darker."""
MODEL_ERROR = 0.03
"""Error of the prediction, over the image."""
SCATTERED_ERROR = 0.2
"""Error of the prediction, over its scattered part."""
LIT, SEEN = (0.1, 0.3), (0.35, 0.2)
"""Cosine towards the light, and towards the camera, from which a facet is used, and how much more gives it all its
weight."""
STEEP = 1.0
"""Strength, roughness, path and blur are fitted where the start is less steep than this."""
START = (0.25, 2.0, 0.8)
"""Roughness, path and blur."""
BOUNDS = ((1e-9, 1e9), (0.06, 0.8), (0.3, 8.0), (0.3, 1.5))
"""Of strength, roughness, path and blur."""
SLANT_DEG, SLANT_ERROR = (0, 10, 20, 35, 45, 60, 70), (0.35, 0.35, 0.5, 0.65, 0.7, 0.75, 1.0)
"""Error of the heights over the start's stated one, by slant, on path-traced fingers of two makers: beyond 30 degrees
the steep sides of ridges are hidden from the films, and follow the start."""


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

    def changed(self, logarithms: NDArray[np.float64]) -> Specular:
        """With the logarithms of the four changed, within their bounds."""
        values = np.exp(logarithms) * (self.strength, self.roughness, self.path_px, self.blur_px)
        return Specular(*(float(np.clip(value, *limits)) for value, limits in zip(values, BOUNDS, strict=True)))


@dataclass(frozen=True, slots=True, eq=False)
class PolarisedHeights:
    """The surface that agrees best with the difference of both series."""

    height_mm: FloatArray
    """(h, w) along the line of sight, finite everywhere."""
    deviation_mm: FloatArray
    """(h, w) standard deviation of the ridges' heights."""
    facts: dict[str, Any]


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
    """The difference of two polarised series.

    Where the crossed series has LEDs of its own, beside those of the parallel one, it is taken as under the latter:
    by the brightness of the matt surface under both.

    Parameters
    ----------
    both : mean of the parallel and the crossed series
    crossed : the crossed series
    rig : `rig.leds[k]` lights parallel image k
    grid : of the images
    surface_mm : (h, w) smooth surface
    """
    stack = 2 * (both.stack - crossed.stack).mean(axis=0)
    if rig.leds != crossed.rig.leds:
        normals = np.moveaxis(normals_from_gradients(*height_gradients(surface_mm, grid.pitch_mm)), -1, 0)
        matt = []
        for lights in (rig, crossed.rig):
            vectors = grid.view.turned(light_vectors_at(lights, *grid.view.points(surface_mm)))
            matt.append(np.maximum(shading(normals, vectors), np.float32(0.05)))
        stack -= (matt[0] / matt[1] - 1) * crossed.stack.mean(axis=0)
    stack = np.asarray(stack, dtype=np.float32)
    laplacian = 4 * stack[:, 1:-1, 1:-1] - stack[:, :-2, 1:-1] - stack[:, 2:, 1:-1]
    laplacian -= stack[:, 1:-1, :-2] + stack[:, 1:-1, 2:]
    lit = crossed.stack[0, :, 1:-1, 1:-1] > 0
    noise = float(np.median(np.abs(laplacian[lit])) / 0.6745 / np.sqrt(20)) if lit.any() else 0.0
    return SpecularImages(stack, max(noise, 1e-6), rig)


def polarised_heights(
    images: SpecularImages, grid: Grid, start_mm: FloatArray, deviation_mm: FloatArray
) -> PolarisedHeights:
    """Heights by the specular image, from a start whose shape and relief are about right.

    Parameters
    ----------
    images : of the fine grid
    grid : fine grid
    start_mm : (h, w) surface, finite
    deviation_mm : (h, w) stated standard deviation of its ridges' heights
    """
    difference, noise, rig = images.stack, images.noise, images.rig
    mask = grid.mask & (grid.depth_mm > 3 * grid.pitch_mm)
    lights = _lights(rig, grid, start_mm)
    solver = _Solver(start_mm, grid)
    nodes, before = solver.start, _slopes(solver.start, grid.pitch_mm)
    known = mask & (before[0] ** 2 + before[1] ** 2 < STEEP**2)
    known = known if known.any() else mask
    spread = PRIOR_FACTOR * RIDGES_PER_MM * np.maximum(deviation_mm, np.float32(1e-3))
    prior = (1 / np.minimum(spread, 1.0) ** 2).astype(np.float32)
    weight = (mask / (noise * noise + (MODEL_ERROR * difference) ** 2)).astype(np.float32)
    specular = Specular(0.0, *START)
    gate: FloatArray = np.ones_like(difference)
    for _ in range(TURNS):
        slopes = _slopes(nodes, grid.pitch_mm)
        predicted = _predicted(lights, slopes, specular, mask, grid)
        if specular.strength == 0:
            specular = replace(specular, strength=_first_strength(difference, weight, predicted, grid, mask))
        rho, rho_mean = _scattered(difference, weight * gate, predicted, specular.strength, grid=grid, mask=mask)
        residual = difference - np.float32(specular.strength) * predicted.specular - rho * predicted.scattered
        doubt = 1 + weight * (SCATTERED_ERROR * rho * predicted.scattered) ** 2
        gate = (predicted.trust / doubt / (1 + weight * residual * residual / 9)).astype(np.float32)
        off = slopes[0] - before[0], slopes[1] - before[1]
        rho_prior = (1 / (LOCAL_RHO * rho_mean) ** 2).astype(np.float32)
        beside = _Prior(prior, off, rho_prior, (rho - rho_mean) * mask, known)
        system = _equations(predicted, specular, rho, (weight * gate, residual), beside)
        change = system.change()
        step, added = solver.solve(system.tensor, system.force(change), nodes)
        nodes = nodes + added
        specular = specular.changed(step * change)
    slant = slant_of(grid.smooth(start_mm, grid.mask, 0.3), grid.pitch_mm)
    share = np.sqrt(np.clip(2 * prior / np.maximum(system.tensor[0] + system.tensor[2], prior), 0, 1))
    factor = np.maximum(np.interp(slant, SLANT_DEG, SLANT_ERROR), share)
    shown = np.maximum(np.float32(specular.strength) * predicted.specular, np.float32(1e-9))
    facts = {
        "roughness": specular.roughness,
        "strength": specular.strength,
        "path_mm": specular.path_px * grid.pitch_mm,
        "blur_mm": specular.blur_px * grid.pitch_mm,
        "scattered_over_specular": float((rho * predicted.scattered)[:, mask].mean() / shown[:, mask].mean()),
        "specular_over_noise": float(np.median(shown.max(axis=0)[mask]) / noise),
        "residual_over_noise": float(np.sqrt(np.median(residual[:, mask] ** 2) / 0.455) / noise),
    }
    return PolarisedHeights(_shifted(nodes, -0.5, -1), (deviation_mm * factor).astype(np.float32), facts)


# One prediction: both parts of the difference for strengths of one, and their derivatives.


@dataclass(frozen=True, slots=True, eq=False)
class _Light:
    """One light on the surface."""

    towards: FloatArray
    """(3, h, w) unit vectors."""
    half: FloatArray
    """(3, h, w) unit vectors halfway to the camera."""
    irradiance: FloatArray
    """(h, w) at normal incidence."""
    reflected: FloatArray
    """(h, w) irradiance times Fresnel's reflectance at the half vector."""


@dataclass(frozen=True, slots=True, eq=False)
class _Predicted:
    """(L, h, w) each."""

    specular: FloatArray
    scattered: FloatArray
    specular_x: FloatArray
    """Derivative by dz/dx, before the blur, whose effect on it is of second order."""
    specular_y: FloatArray
    scattered_x: FloatArray
    scattered_y: FloatArray
    by_roughness: FloatArray
    """Of the specular part, by the roughness's logarithm."""
    by_path: FloatArray
    """Of the scattered part, by the path's logarithm."""
    by_blur: FloatArray
    """Of the specular part, by the blur's logarithm."""
    trust: FloatArray
    """In [0, 1]: lit and seen well."""


def _lights(rig: Rig, grid: Grid, surface_mm: FloatArray) -> list[_Light]:
    vectors = grid.view.turned(light_vectors_at(rig, *grid.view.points(surface_mm)))
    lights = []
    for vector in vectors:
        irradiance = np.sqrt((vector * vector).sum(axis=0))
        towards = vector / np.maximum(irradiance, np.float32(1e-12))
        half = towards.copy()
        half[2] += 1
        length = np.maximum(np.sqrt((half * half).sum(axis=0)), np.float32(1e-6))
        lights.append(_Light(towards, half / length, irradiance, irradiance * fresnel_reflectance(length / 2)))
    return lights


def _predicted(lights: Sequence[_Light], slopes: Slopes, specular: Specular, mask: BoolArray, grid: Grid) -> _Predicted:
    parts = np.empty((10, len(lights), *mask.shape), dtype=np.float32)
    inside = mask.astype(np.float32)
    damped = np.float32(np.exp(-0.5 * (RIDGES_PER_MM * grid.pitch_mm * specular.path_px) ** 2))

    def blurred(image: FloatArray, sigma_px: float) -> FloatArray:
        total = cv2.GaussianBlur(image * inside, (0, 0), sigma_px)
        return np.asarray(total / np.maximum(cv2.GaussianBlur(inside, (0, 0), sigma_px), np.float32(0.05)))

    def one(k: int) -> None:
        image, (x, y), matt, (matt_x, matt_y), other, cosine = _facets(lights[k], slopes, specular.roughness)
        blur = specular.blur_px
        path = [float(np.hypot(blur, s * specular.path_px)) for s in (1.0, 1.1)]
        sharp, soft, softer = blurred(image, blur), blurred(matt, path[0]), blurred(matt, path[1])
        seen = 1 / np.sqrt(1 + slopes[0] ** 2 + slopes[1] ** 2)
        trust = _from(blurred(cosine, blur), LIT) * _from(seen, SEEN)
        rougher, wider = (blurred(other, blur) - sharp) / _STEP, (softer - soft) / _WIDER
        blurrier = (blurred(image, 1.1 * blur) - sharp) / _WIDER
        parts[:, k] = sharp, soft, x, y, matt_x * damped, matt_y * damped, rougher, wider, blurrier, trust

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(one, range(len(lights))))
    return _Predicted(*parts)


_WIDER = np.float32(np.log(1.1))
_STEP = np.float32(0.01)
"""Of the roughness's logarithm, for its derivative."""


def _from(cosine: FloatArray, limits: tuple[float, float]) -> FloatArray:
    """Weights in [0, 1]."""
    return np.asarray(np.clip((cosine - np.float32(limits[0])) / np.float32(limits[1]), 0, 1))


def _facets(
    light: _Light, slopes: Slopes, roughness: float
) -> tuple[FloatArray, Slopes, FloatArray, Slopes, FloatArray, FloatArray]:
    """Specular and matt image (h, w) of one light, each with its derivatives by the slopes; the specular image of a
    roughness that is larger by `_STEP`; and the cosine of incidence."""
    p, q = slopes
    nz = 1 / np.sqrt(1 + p * p + q * q)
    towards, half = light.towards, light.half
    cosine = (towards[2] - p * towards[0] - q * towards[1]) * nz
    nh = (half[2] - p * half[0] - q * half[1]) * nz
    lit = cosine > np.float32(1e-3)
    nl = np.where(lit, cosine, np.float32(1e-3))
    a2 = np.float32(roughness * roughness)
    b = 1 - a2
    below = 1 - b * nh * nh
    root_l, root_z = np.sqrt(a2 + b * nl * nl), np.sqrt(a2 + b * nz * nz)
    strength = light.reflected * lit * nl
    image = strength * a2 / (np.float32(np.pi) * below * below * (nl + root_l) * (nz + root_z))
    by_h = 4 * b * nh / below
    by_l = 1 / nl - (1 + b * nl / root_l) / (nl + root_l)
    by_z = -(1 + b * nz / root_z) / (nz + root_z)
    matt, unit = light.irradiance * lit * nl, light.irradiance * lit
    specular, scattered = [], []
    for axis, slope in enumerate(slopes):
        turned = slope * nz * nz
        dl, dh = -towards[axis] * nz - nl * turned, -half[axis] * nz - nh * turned
        specular.append(image * (by_h * dh + by_l * dl - by_z * turned * nz))
        scattered.append(unit * dl)
    c2 = a2 * np.float32(np.exp(2 * _STEP))
    c = 1 - c2
    other = 1 - c * nh * nh
    wide_l, wide_z = np.sqrt(c2 + c * nl * nl), np.sqrt(c2 + c * nz * nz)
    rougher = strength * c2 / (np.float32(np.pi) * other * other * (nl + wide_l) * (nz + wide_z))
    return image, (specular[0], specular[1]), matt, (scattered[0], scattered[1]), rougher, cosine


def _first_strength(
    difference: FloatArray, weight: FloatArray, predicted: _Predicted, grid: Grid, mask: BoolArray
) -> float:
    """Strength of the specular part by least squares, the scattered part fitted in turns with it."""
    power = float((weight * predicted.specular**2).sum(dtype=np.float64))
    strength = float((weight * predicted.specular * difference).sum(dtype=np.float64)) / max(power, 1e-12)
    for _ in range(6):
        _, rho = _scattered(difference, weight, predicted, strength, grid=grid, mask=mask)
        residual = difference - rho * predicted.scattered
        strength = max(float((weight * predicted.specular * residual).sum(dtype=np.float64)) / max(power, 1e-12), 1e-9)
    return strength


def _scattered(
    difference: FloatArray, weight: FloatArray, predicted: _Predicted, strength: float, *, grid: Grid, mask: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """(h, w) strength of the scattered part at each pixel, and its local mean."""
    residual = ((difference - np.float32(strength) * predicted.specular) * predicted.scattered * weight).sum(axis=0)
    power = (predicted.scattered * predicted.scattered * weight).sum(axis=0)
    means = grid.smooth(np.stack([residual, power]), mask, SLOW_MM)
    mean = np.maximum(means[0] / np.maximum(means[1], np.float32(1e-9)), np.float32(1e-6))
    prior = 1 / (LOCAL_RHO * mean) ** 2
    return np.where(mask, (residual + prior * mean) / (power + prior), np.float32(0.0)), mean


# One step: linear equations for slopes, scattered part and the finger's three numbers.


@dataclass(frozen=True, slots=True, eq=False)
class _Equations:
    """Normal equations of a step, the scattered part eliminated at each pixel."""

    tensor: FloatArray
    """(3, h, w) of the slopes: xx, xy, yy."""
    forces: FloatArray
    """(5, 2, h, w) on the slopes: of the residual, and of each of the four numbers."""
    own: NDArray[np.float64]
    """(4, 4) of the four numbers, slopes eliminated."""
    right: NDArray[np.float64]
    """(4,)."""

    def change(self) -> NDArray[np.float64]:
        """(4,) of the logarithms of strength, roughness, path and blur, with whatever slopes suit them best."""
        own = self.own + np.diag(PRIOR_WEIGHTS)
        return np.asarray(np.clip(np.linalg.solve(own, self.right), -0.25, 0.25))

    def force(self, change: NDArray[np.float64]) -> FloatArray:
        """(2, h, w) on the slopes, the four numbers changed."""
        return np.asarray(self.forces[0] - np.tensordot(change.astype(np.float32), self.forces[1:], 1))


PRIOR_WEIGHTS = (0.0, 0.0, 4.0, 4.0)
"""Of the last step's numbers, on their logarithms, beside the images."""


def _equations(
    predicted: _Predicted, specular: Specular, rho: FloatArray, weighted: tuple[FloatArray, FloatArray], prior: _Prior
) -> _Equations:
    """Normal equations of the residual.

    Parameters
    ----------
    predicted : at the current slopes
    specular, rho : at which the residual was taken
    weighted : (L, h, w) weights, and residual
    prior : beside the images
    """
    weight, residual = weighted
    strength = np.float32(specular.strength)
    shape = rho.shape
    tensor = np.empty((3, *shape), dtype=np.float32)
    forces = np.empty((5, 2, *shape), dtype=np.float32)
    sums: dict[int, NDArray[np.float64]] = {}

    def work(rows: slice) -> None:
        columns = (
            strength * predicted.specular_x[:, rows] + rho[rows] * predicted.scattered_x[:, rows],
            strength * predicted.specular_y[:, rows] + rho[rows] * predicted.scattered_y[:, rows],
            predicted.scattered[:, rows],
            residual[:, rows],
            strength * predicted.specular[:, rows],
            strength * predicted.by_roughness[:, rows],
            rho[rows] * predicted.by_path[:, rows],
            strength * predicted.by_blur[:, rows],
        )
        heavy = [weight[:, rows] * column for column in columns]
        gram = {(i, j): (heavy[i] * columns[j]).sum(axis=0) for i in range(8) for j in range(i, 8)}
        for i, off in enumerate(prior.slopes_off):
            gram[i, i] = gram[i, i] + prior.slopes[rows]
            gram[i, 3] = gram[i, 3] - prior.slopes[rows] * off[rows]
        gram[2, 2] = gram[2, 2] + prior.rho[rows]
        gram[2, 3] = gram[2, 3] - prior.rho[rows] * prior.rho_off[rows]
        inverse = 1 / gram[2, 2]
        for i in (0, 1, 3, 4, 5, 6, 7):
            for j in range(i, 8):
                if j != 2:
                    gram[i, j] = gram[i, j] - _pair(gram, i, 2) * _pair(gram, j, 2) * inverse
        xx, xy, yy = gram[0, 0], gram[0, 1], gram[1, 1]
        tensor[:, rows] = xx, xy, yy
        for n in range(5):
            forces[n, :, rows] = gram[0, 3 + n], gram[1, 3 + n]
        below = np.maximum(xx * yy - xy * xy, np.float32(1e-12))
        here = prior.known[rows]
        total = np.empty((4, 5))
        for n in range(4):
            fx, fy = gram[0, 4 + n], gram[1, 4 + n]
            x, y = (yy * fx - xy * fy) / below, (xx * fy - xy * fx) / below
            for m in range(5):
                rest = _pair(gram, 3 + m, 4 + n) - x * gram[0, 3 + m] - y * gram[1, 3 + m]
                total[n, m] = rest[here].sum(dtype=np.float64)
        sums[rows.start] = total

    for_each_chunk(work, shape[0], shape[1], len(residual))
    total = np.sum([sums[start] for start in sorted(sums)], axis=0)
    return _Equations(tensor, forces, total[:, 1:], total[:, 0])


def _pair(gram: dict[tuple[int, int], FloatArray], i: int, j: int) -> FloatArray:
    return gram[min(i, j), max(i, j)]


@dataclass(frozen=True, slots=True, eq=False)
class _Prior:
    """What is known beside the images."""

    slopes: FloatArray
    """(h, w) inverse variance of the start's slopes."""
    slopes_off: Slopes
    """From the start's."""
    rho: FloatArray
    """(h, w) inverse variance of the scattered part about its local mean."""
    rho_off: FloatArray
    known: BoolArray
    """(h, w) pixels that give the three numbers."""


# Heights at the corners of the pixels.


class _Solver:
    """Heights (h + 1, w + 1) of least squares with a tensor at every pixel, by conjugate gradients.

    The unknowns are the heights' cosine transform, in which the prior of the slow slopes is diagonal, and so is the
    preconditioner: Poisson's equation with the mean tensor.
    """

    def __init__(self, start_mm: FloatArray, grid: Grid) -> None:
        import scipy.fft

        self.start = _shifted(start_mm, 0.5, 1)
        """Start at the corners."""
        self._fft, self._pitch, self._mask = scipy.fft, grid.pitch_mm, grid.mask
        self._size = tuple(scipy.fft.next_fast_len(n, True) for n in self.start.shape)
        rows, columns = ((2 - 2 * np.cos(np.pi * np.arange(n) / n)) / grid.pitch_mm**2 for n in self._size)
        self._square = (rows[:, None] + columns[None]).astype(np.float32)
        self._slow = self._square * np.exp(-self._square * np.float32(SLOW_MM**2)) / np.float32(SLOW_SLOPE**2)

    def solve(self, tensor: FloatArray, force: FloatArray, nodes: FloatArray) -> tuple[float, FloatArray]:
        """Part of the step that is taken, and the change of the heights."""
        damped = tensor.copy()
        damped[0::2] += np.float32(0.02) * (tensor[0] + tensor[2])
        mean = np.float32(np.median((tensor[0] + tensor[2])[self._mask]) / 2)
        rest = np.float32(1e-6) * mean
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
            length = np.float32(size / _dot(along, image))
            x, residual = x + length * along, residual - length * image
            better = precondition * residual
            size, last = _dot(residual, better), size
            along = better + np.float32(size / last) * along
        added = self._inverse(x)
        steepest = float(np.percentile(np.hypot(*_slopes(added, self._pitch))[self._mask], 99.5))
        step = min(1.0, MAX_SLOPE_STEP / max(steepest, 1e-9))
        return step, np.asarray(added * np.float32(step))

    def _forward(self, nodes: FloatArray) -> FloatArray:
        missing = [(0, n - m) for n, m in zip(self._size, nodes.shape, strict=True)]
        return np.asarray(self._fft.dctn(np.pad(nodes, missing), norm="ortho", workers=2), dtype=np.float32)

    def _inverse(self, spectrum: FloatArray) -> FloatArray:
        rows, columns = self.start.shape
        return np.asarray(self._fft.idctn(spectrum, norm="ortho", workers=2)[:rows, :columns], dtype=np.float32)


MAX_SLOPE_STEP = 0.6
"""Largest change of a slope in one step, but for a few pixels."""


def _dot(a: FloatArray, b: FloatArray) -> float:
    return float(np.einsum("ij,ij->", a, b, dtype=np.float64))


def _slopes(nodes: FloatArray, pitch_mm: float) -> Slopes:
    """dz/dx and dz/dy (h, w) at the centres of the pixels whose corners are `nodes` (h + 1, w + 1)."""
    half = np.float32(0.5 / pitch_mm)
    falling = (nodes[:-1, 1:] - nodes[1:, :-1]) * half
    rising = (nodes[1:, 1:] - nodes[:-1, :-1]) * half
    return np.asarray(rising + falling), np.asarray(falling - rising)


def _transposed(x: FloatArray, y: FloatArray, pitch_mm: float) -> FloatArray:
    """The transpose of :func:`_slopes`."""
    half = np.float32(0.5 / pitch_mm)
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
    return np.asarray(moved, dtype=np.float32)
