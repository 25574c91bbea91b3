"""Heights from polarised light: the surface whose specular image agrees with the photographs.

Light that the skin's boundary reflects keeps its polarisation; light from within the skin has lost
nearly all of it. The difference of two photographs, with the analyser parallel and crossed, is
therefore what the boundary reflects, and a little light that was scattered once or so. Under light
k,

    D_k = strength B f(n, l_k; roughness) + rho S max(n.l_k, 0)

with f the reflection of a rough facet (GGX), B the blur of lens and pixels, S that of the short
paths below the skin, and rho the local strength of what is scattered. Unknown are the heights at
the corners of the pixels: slopes at the centres are then differences over one pixel, and
integrable. They are estimated by Gauss-Newton jointly with strength, roughness and path length:
alternating between them does not converge and leaves ridges at 0.8 of their height.

Source: S. L. Jacques, J. C. Ramella-Roman and K. Lee, "Imaging skin pathology with polarized
light", J. Biomed. Opt. 7, 2002. W.-C. Ma et al., "Rapid acquisition of specular and diffuse normal
maps from polarized spherical gradient illumination", EGSR 2007. B. Walter et al., "Microfacet
models for refraction through rough surfaces", EGSR 2007, eq. 20, 33 and 34.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import astuple, dataclass, replace
from typing import Any, NamedTuple

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from splitknit.imaging.chunks import for_each_chunk
from splitknit.imaging.geometry import height_gradients, normals_from_gradients
from splitknit.imaging.light_field import light_vectors_at, lights_in_front
from splitknit.imaging.robust import deviation
from splitknit.integration.conjugate_gradients import conjugate_gradients
from splitknit.model import Array, BoolArray, FloatArray, Rig
from splitknit.photometric.equations import shading
from splitknit.skin.grid import BandImages, Grid, Slopes
from splitknit.skin.light import fresnel_reflectance


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
    """The difference of two polarised series, on a smooth surface (h, w): of `both`, their mean,
    and of the crossed one.

    A crossed series with LEDs of its own is taken as under the parallel one's, `rig.leds[k]` of
    image k: by the brightness of the matt surface under both.
    """
    stack = 2 * (both.stack - crossed.stack).mean(axis=0)
    if rig.leds != crossed.rig.leds:
        normals = normals_from_gradients(*height_gradients(surface_mm, grid.pitch_mm))
        matt = []
        for lights in (rig, crossed.rig):
            vectors = grid.view.turned(light_vectors_at(lights, *grid.view.points(surface_mm)))
            matt.append(np.maximum(shading(np.moveaxis(normals, -1, 0), vectors), 0.05))
        stack -= (matt[0] / matt[1] - 1) * crossed.stack.mean(axis=0)
    lit = crossed.stack[0] > 0
    changes = _laplacian(stack, slice(0, len(stack[0])))[lit]
    noise = deviation(changes) / np.sqrt(20) if changes.size else 0.0
    return SpecularImages(stack, max(noise, 1e-6), rig)


@dataclass(frozen=True, slots=True)
class FitThresholds:
    """Thresholds and assumed errors of the fit."""

    prior_factor: float
    """Factor on the stated deviation of the start's relief, whose error is one of gain too."""
    first_error: float
    """Error of the prediction in the first step, over the image."""
    lit: tuple[float, float]
    """Cosine of incidence from which a facet is used, and how much more gives it all its weight."""
    seen: tuple[float, float]
    """The same of the cosine to the camera."""
    grazing: float
    """Square of the cosine of incidence at which half the light enters that is scattered once.
    Fresnel's transmittance and the longer path below the skin would give 0.01 on a smooth surface,
    but such light also comes from beside the facet."""


_FRONT = FitThresholds(5.0, 0.03, (0.1, 0.3), (0.3, 0.2), 0.0)
_SIDE = FitThresholds(20.0, 0.8, (0.05, 0.2), (0.1, 0.2), 0.004)
"""With lights to the side, which show the flanks; facets far from their slope are no outliers."""
_RIDGES_PER_MM = 14.0
"""Typical angular frequency of ridges, rad/mm."""
_MODEL_ERROR = 0.03
"""Error of the prediction, as a fraction of the image."""
_STEPS = 10
"""Gauss-Newton steps. Chosen on: speed."""
_RAISED_MM = 1.0
"""Step of the derivative by the finger's lift."""
_MISFIT = (0.8, 0.5)
"""Residual of a light to the side, over its image (rms), above which it is not used yet, in the
first and in the second half of the steps: glints of oily skin fit later. Those of a path-traced
finger leave 0.36 at first and 0.09 at last; lights whose films are turned, so that what they
reflect does not pass the camera's, leave 0.82 to 13. Chosen on: path-traced fingers."""


def polarised_heights(
    images: SpecularImages,
    grid: Grid,
    start_mm: FloatArray,
    deviation_mm: FloatArray,
    films: bool = True,
) -> tuple[FloatArray, FloatArray, dict[str, float]]:
    """Heights by the specular image of the fine grid, from a finite start (h, w) of about the right
    shape and relief.

    `deviation_mm`: (h, w) stated standard deviation of its ridges' heights. Returns heights (h, w)
    along the line of sight, finite everywhere, the standard deviation (h, w) of their ridges, and
    figures of the fit. `films`: whether films separated the images.
    """
    mask = grid.mask & (grid.depth_mm > 3 * grid.pitch_mm)
    side = np.flatnonzero(~lights_in_front(images.rig))
    limits = _SIDE if side.size else _FRONT
    gains = np.ones((2, len(images.stack)), dtype=np.float32)
    model = SpecularModel(strength=0.0, roughness=0.25, path_px=2.0, blur_px=0.8)
    lights = _light_fields(images.rig, grid, start_mm, gains)
    nodes = start_nodes = _shifted(start_mm, 0.5, 1)
    start_slopes = _slopes(start_nodes, grid.pitch_mm)
    gentle = mask & (np.hypot(*start_slopes) < 1)  # the model is fitted there
    slope_deviation = limits.prior_factor * _RIDGES_PER_MM * np.maximum(deviation_mm, 1e-3)
    prior = (1 / np.minimum(slope_deviation, 1.0) ** 2).astype(np.float32)
    visible = np.ones(images.stack.shape, dtype=np.float32)
    visible[side] = 0  # the brightness of lights to the side is fitted first
    weight = _inverse_variance(images, mask, slice(None), limits.first_error) * visible
    fitting = side[:0]
    for step in range(_STEPS):
        raised = None
        if fitting.size:  # then the lights' brightness and the finger's height are fitted
            level = model.lift_mm
            lights = _light_fields(images.rig, grid, start_mm + level, gains)
            raised = _light_fields(images.rig, grid, start_mm + (level + _RAISED_MM), gains)
        for k in fitting.tolist():
            if step % 4 == 1 or not visible[k].any():
                visible[k] = _visibility(lights[:3, k], _shifted(nodes, -0.5, -1), grid)
        slopes = _slopes(nodes, grid.pitch_mm)
        sharp, soft = _predicted(lights, slopes, model, mask, limits.grazing)
        strength, rho, rho_mean = _strengths(
            images.stack, weight, (sharp, soft), grid, mask, strength=model.strength
        )
        fit = SpecularFit(
            images=images,
            grid=grid,
            mask=mask,
            lights=lights,
            raised=raised,
            model=replace(model, strength=strength),
            slopes=slopes,
            slopes_from_start=(slopes[0] - start_slopes[0], slopes[1] - start_slopes[1]),
            slope_prior=prior,
            sharp=sharp,
            soft=soft,
            rho=rho,
            rho_mean=rho_mean,
            limits=limits,
            error=max(_MODEL_ERROR, limits.first_error * 0.66**step),
            visible=visible,
            side=side,
            fitting=fitting,
        )
        change = _model_change(fit, gentle)
        information, force = _slope_equations(fit, change, weight)
        fraction, added = _height_change(information, force, nodes, start_nodes, grid)
        nodes = nodes + added
        of_model, brightness = np.split(fraction * change, [change.size - 2 * fitting.size])
        model = fit.model.changed(of_model)
        gains[:, fitting] *= np.exp(brightness).reshape(2, -1)
        fitting = _fitting_lights(fit, gains, _MISFIT[step > _STEPS // 2])
    information[0::2] -= prior
    specular = np.maximum(fit.specular(), 1e-9)
    residual = fit.residual()[:, mask]
    height_mm = _shifted(nodes, -0.5, -1)
    ridges_mm = height_mm - grid.smooth(start_mm, grid.mask, _RIDGE_MM)
    ridges_mm -= grid.smooth(ridges_mm, grid.mask, _RIDGE_MM)
    error_mm = _ridge_deviation(fit, ridges_mm, grid.smooth(information, mask, 0.1), films)
    if not films:  # then the start's ridges are about as well known
        fraction = error_mm**2 / (error_mm**2 + np.maximum(deviation_mm, 1e-4) ** 2)
        start_ridges = start_mm - grid.smooth(start_mm, grid.mask, _RIDGE_MM)
        start_ridges -= grid.smooth(start_ridges, grid.mask, _RIDGE_MM)
        height_mm = height_mm + fraction * (start_ridges - ridges_mm)
    return height_mm, error_mm, {
        "side_lights": float(visible[side].any(axis=(1, 2)).sum()),
        "roughness": model.roughness,
        "scattered_over_specular": float(
            fit.scattered()[:, mask].mean() / specular[:, mask].mean()
        ),
        "specular_over_noise": float(np.median(specular.max(axis=0)[mask]) / images.noise),
        "residual_over_noise": float(np.sqrt(np.median(residual**2) / 0.455) / images.noise),
    }  # fmt: skip


_LOWEST = (1e-9, 0.06, 0.3, 0.3, -8.0)
_HIGHEST = (1e9, 0.8, 8.0, 1.5, 8.0)
"""Bounds of the fields of `SpecularModel`."""


@dataclass(frozen=True, slots=True)
class SpecularModel:
    """What is fitted for a whole finger."""

    strength: float
    """Factor on the reflection of a clean boundary, in the images' units."""
    roughness: float
    """GGX alpha."""
    path_px: float
    """Standard deviation of the blur by the paths of scattered light that is still polarised."""
    blur_px: float
    """Standard deviation of the blur of lens and pixels."""
    lift_mm: float = 0.0
    """By how much the finger lies higher than the start."""

    def changed(self, change: Array) -> SpecularModel:
        """Changed by the logarithms of the first four fields and, where it is fitted, the lift."""
        values = np.array(astuple(self))
        values[:4] *= np.exp(change[:4])
        values[4] += change[4:].sum()
        return SpecularModel(*np.clip(values, _LOWEST, _HIGHEST).tolist())


@dataclass(frozen=True, slots=True, eq=False)
class SpecularFit:
    """The state from which a Gauss-Newton step starts."""

    images: SpecularImages
    grid: Grid
    mask: BoolArray
    lights: FloatArray
    """(8, L, n, w), see :func:`_light_fields`."""
    raised: FloatArray | None
    """On a finger that lies `_RAISED_MM` higher, where lights to the side show its height."""
    model: SpecularModel
    slopes: Slopes
    slopes_from_start: Slopes
    slope_prior: FloatArray
    """(h, w) inverse variance of the start's slopes."""
    sharp: FloatArray
    """(L, h, w) specular images of strength one."""
    soft: FloatArray
    """(L, h, w) scattered ones."""
    rho: FloatArray
    """(h, w) strength of the scattered part."""
    rho_mean: FloatArray
    """(h, w) its local mean."""
    limits: FitThresholds
    error: float
    """Of the prediction, over the image."""
    visible: FloatArray
    """(L, h, w) in [0, 1]: the surface that no cast shadow hides from a light."""
    side: NDArray[np.intp]
    """Lights to the side."""
    fitting: NDArray[np.intp]
    """Those whose brightness is fitted."""

    def specular(self, rows: slice = slice(None)) -> FloatArray:
        """(L, rows, w) specular part of the prediction."""
        return self.model.strength * self.sharp[:, rows]

    def scattered(self, rows: slice = slice(None)) -> FloatArray:
        """(L, rows, w) scattered part of the prediction."""
        return self.rho[rows] * self.soft[:, rows]

    def residual(self, rows: slice = slice(None)) -> FloatArray:
        """(L, rows, w) images less the prediction."""
        return self.images.stack[:, rows] - self.specular(rows) - self.scattered(rows)


_SCATTERED_ERROR = 0.1
"""Error of the prediction's scattered part, as a fraction of that part."""
_RIDGE_MM = 0.3
"""Sigma of the Gaussian mean that separates ridges from shape."""


def local_chi_square(fit: SpecularFit) -> FloatArray:
    """Reduced chi-square of the residual over all lights, a mean over `_RIDGE_MM`, (h, w)."""
    variance = fit.images.noise**2 + (_MODEL_ERROR * fit.images.stack) ** 2
    variance += (_SCATTERED_ERROR * fit.scattered()) ** 2
    chi_square = (fit.visible * fit.residual() ** 2 / variance).mean(axis=0)
    return fit.grid.smooth(chi_square, fit.mask, _RIDGE_MM)


_STEEP_MM = (0.026, 0.0145)
"""Error of the model over the mean square of the ridges' slopes, under front lights alone and with
lights to the side. Chosen on: simulated fingers (a, c, g, i and j of
validation/path_traced/drawn_films.py)."""
_SEPARATED_BY_COLOUR = 0.1
"""Error of the heights over the ridges' where colours separate the images, not films. Chosen on:
path-traced fingers."""


def _ridge_deviation(
    fit: SpecularFit, ridges_mm: FloatArray, information: FloatArray, films: bool
) -> FloatArray:
    """Standard deviation (h, w) of the ridges' heights (h, w): from the covariance of the slopes,
    taken over 0.04 mm, and a model error that grows with the square of the ridges' slopes, as do
    their blur and the reflections between them; more where the residual is large.

    `information`: (3, h, w) inverse covariance of a slope (xx, xy, yy).
    """
    x, y = height_gradients(ridges_mm, fit.grid.pitch_mm)
    steep = fit.grid.smooth(x * x + y * y, fit.grid.mask, _RIDGE_MM)
    xx, xy, yy = information
    covariance = (xx + yy) / (2 * np.maximum(xx * yy - xy * xy, 1e-3))
    model_error_mm = _STEEP_MM[fit.side.size > 0] * steep
    variance = (0.04**2 * covariance + model_error_mm**2) * local_chi_square(fit) ** 0.3
    if not films:
        variance += (_SEPARATED_BY_COLOUR * ridges_mm) ** 2
    return np.asarray(np.sqrt(variance))


# One prediction: both parts of the difference for strengths of one, and their derivatives.


_LIGHT_ROWS = 8
"""Rows over which light changes little. Chosen on: speed."""
_SHADOW_PX = (*range(1, 13), 14, 16, 19, 22, 26, 31, 38, 47, 60, 80, 110, 160)
"""Distances at which the surface may block the light. Chosen on: speed."""


def _light_fields(rig: Rig, grid: Grid, surface_mm: FloatArray, gains: FloatArray) -> FloatArray:
    """The lights (8, L, n, w) on every `_LIGHT_ROWS`-th row of a surface: unit vector towards the
    light, irradiance at normal incidence; unit vector halfway to the camera, irradiance times
    Fresnel's reflectance there. `gains`: (2, L) brightness in scattered and in specular light.
    """
    sampled = slice(None, None, _LIGHT_ROWS)
    points = grid.view.points(surface_mm[sampled], sampled)
    vectors = np.moveaxis(grid.view.turned(light_vectors_at(rig, *points), sampled), 1, 0)
    irradiance = np.sqrt((vectors * vectors).sum(axis=0))
    towards = vectors / np.maximum(irradiance, 1e-12)
    half = towards + np.array([0, 0, 1], dtype=np.float32)[:, None, None, None]
    length = np.maximum(np.sqrt((half * half).sum(axis=0)), 1e-6)
    reflected = irradiance * fresnel_reflectance(length / 2)
    fields = np.stack([*towards, irradiance, *(half / length), reflected])
    fields[3::4] *= gains[..., None, None]
    return fields


def _between_rows(fields: FloatArray, rows: slice) -> FloatArray:
    """(..., rows, w) of fields (..., n, w) on every `_LIGHT_ROWS`-th row."""
    last = fields.shape[-2] - 1
    place = np.minimum(np.arange(rows.start, rows.stop) / _LIGHT_ROWS, last)
    part = slice(int(place[0]), int(place[-1]) + 2)
    sampled = np.arange(last + 1)[part]
    between = np.maximum(1 - np.abs(place[:, None] - sampled), 0).astype(np.float32)
    return np.asarray(np.matmul(between, fields[..., part, :]))


def _visibility(towards: FloatArray, surface_mm: FloatArray, grid: Grid) -> FloatArray:
    """(h, w) in [0, 1]: the part of the surface (h, w) that a light reaches. `towards`: (3, n, w)
    unit vectors to it on every `_LIGHT_ROWS`-th row."""
    x, y, z = _between_rows(towards, slice(0, grid.shape[0]))
    rise = z / np.maximum(np.hypot(x, y), 1e-3) * grid.pitch_mm
    middle = np.unravel_index(int(np.argmax(grid.depth_mm)), grid.shape)
    right = float(x[middle])
    up = float(y[middle])
    length = np.hypot(right, up)
    visible = np.ones(grid.shape, dtype=np.float32)
    for far in _SHADOW_PX:
        shift = (far * (right / length), -far * (up / length))
        blocking = _warped(surface_mm, shift, 0, cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
        blocking -= surface_mm + far * rise
        # shadows are soft over a tangent of 0.1: the LED's size, and the surface's error
        lit = 0.5 - blocking / (0.1 * far * grid.pitch_mm)
        np.minimum(visible, lit, out=visible)
    return np.clip(visible, 0, 1, out=visible)


def _predicted(
    lights: FloatArray, slopes: Slopes, model: SpecularModel, mask: BoolArray, grazing: float
) -> tuple[FloatArray, FloatArray]:
    """Specular and scattered images (L, h, w) of strengths of one."""
    sharp = np.empty((lights.shape[1], *mask.shape), dtype=np.float32)
    soft = np.empty_like(sharp)
    inside = mask.astype(np.float32)

    def work(rows: slice) -> None:
        there = slopes[0][rows], slopes[1][rows]
        facets = _facets(_between_rows(lights, rows), there, model.roughness, grazing)
        sharp[:, rows] = facets.specular * inside[rows]
        soft[:, rows] = facets.matt * inside[rows]

    for_each_chunk(work, mask.shape[0], mask.shape[1], 2 * len(sharp))
    _blur(sharp, model.blur_px, inside)
    _blur(soft, float(np.hypot(model.blur_px, model.path_px)), inside)
    return sharp, soft


def _blur(stack: FloatArray, sigma_px: float, inside: FloatArray) -> None:
    """Gaussian means over the finger, in place."""
    total = np.maximum(cv2.GaussianBlur(inside, (0, 0), sigma_px), 0.05)

    def mean(image: FloatArray) -> None:
        np.divide(cv2.GaussianBlur(image, (0, 0), sigma_px), total, out=image)

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(mean, stack))


class _Facets(NamedTuple):
    """Light of facets (L, h, w), and its derivatives where they are wanted."""

    specular: FloatArray
    matt: FloatArray
    cosine: FloatArray
    """Of incidence."""
    specular_by_slope: Sequence[FloatArray] = ()
    matt_by_slope: Sequence[FloatArray] = ()
    specular_by_roughness: FloatArray | float = 0.0
    """By the roughness's logarithm."""


def _facets(
    light: FloatArray,
    slopes: Slopes,
    roughness: float,
    grazing: float,
    *,
    derivatives: bool = False,
) -> _Facets:
    """Walter et al. 2007: D of eq. 33, G of eq. 34 (GGX), reflection of eq. 20; matt beside it."""
    p, q = slopes
    towards = light[:3]
    half = light[4:7]
    nz = 1 / np.sqrt(1 + p * p + q * q)
    cosine = (towards[2] - p * towards[0] - q * towards[1]) * nz
    nh = (half[2] - p * half[0] - q * half[1]) * nz
    lit = cosine > 1e-3
    nl = np.maximum(cosine, 1e-3)
    a2 = np.float32(roughness * roughness)
    b = 1 - a2
    below = 1 - b * nh * nh
    root_l = np.sqrt(a2 + b * nl * nl)
    root_z = np.sqrt(a2 + b * nz * nz)
    irradiance = light[3] * lit
    entering = nl * nl + grazing
    matt = irradiance * nl * (nl * nl / entering)
    specular = light[7] * lit * nl * (a2 / np.pi / (nz + root_z)) / (below * below * (nl + root_l))
    if not derivatives:
        return _Facets(specular, matt, cosine)
    by_h = 4 * b * nh / below
    by_l = 1 / nl - (1 + b * nl / root_l) / (nl + root_l)
    by_z = -(1 + b * nz / root_z) / (nz + root_z)
    matt_by_l = irradiance * (nl * nl / entering) * (1 + 2 * grazing / entering)
    specular_by_slope = []
    matt_by_slope = []
    for axis, slope in enumerate(slopes):
        turned = slope * nz * nz
        dl = -towards[axis] * nz - nl * turned
        dh = -half[axis] * nz - nh * turned
        specular_by_slope.append(specular * (by_h * dh + by_l * dl - by_z * turned * nz))
        matt_by_slope.append(matt_by_l * dl)
    rougher = 2 - 4 * a2 * nh * nh / below
    masking = (1 - nl * nl) / (root_l * (nl + root_l)) + (1 - nz * nz) / (root_z * (nz + root_z))
    rougher -= a2 * masking
    return _Facets(specular, matt, cosine, specular_by_slope, matt_by_slope, specular * rougher)


# The brightness of both parts.


_SLOW_MM = 0.5
"""Length over which means of the start's slopes and of rho are known."""
_LOCAL_RHO = 0.3
"""Relative standard deviation of rho about its mean over `_SLOW_MM`: valleys are darker."""


def _strengths(
    images: FloatArray,
    weight: FloatArray,
    prediction: tuple[FloatArray, FloatArray],
    grid: Grid,
    mask: BoolArray,
    *,
    strength: float,
) -> tuple[float, FloatArray, FloatArray]:
    """Specular strength, by least squares where zero; rho (h, w) and its local mean."""
    sums = [np.zeros(grid.shape, dtype=np.float32) for _ in range(5)]
    for measured, of_light, lobe, matt in zip(images, weight, *prediction, strict=True):
        soft = of_light * matt
        sharp = of_light * lobe
        products = soft * measured, soft * lobe, soft * matt, sharp * lobe, sharp * measured
        for total, product in zip(sums, products, strict=True):
            np.add(total, product, out=total)
    soft_image, soft_lobe, soft_power = sums[:3]
    mean_image, mean_lobe, mean_power = grid.smooth(np.stack(sums[:3]), mask, _SLOW_MM)
    lobe_power, lobe_image = (float(total.sum(dtype=np.float64)) for total in sums[3:])
    unknown = strength == 0
    if unknown:
        strength = lobe_image / max(lobe_power, 1e-12)
    for remaining in range(6 if unknown else 0, -1, -1):  # each with the other
        mean = (mean_image - strength * mean_lobe) / np.maximum(mean_power, 1e-9)
        mean = np.maximum(mean, 1e-6)
        prior = 1 / (_LOCAL_RHO * mean) ** 2
        rho = (soft_image - strength * soft_lobe + prior * mean) / (soft_power + prior)
        rho = np.where(mask, rho, 0.0)
        if remaining:
            beside = lobe_image - float((rho * soft_lobe).sum(dtype=np.float64))
            strength = max(beside / max(lobe_power, 1e-12), 1e-9)
    return strength, rho, mean


def _inverse_variance(
    images: SpecularImages, mask: BoolArray, rows: slice, relative_error: float
) -> FloatArray:
    """(L, rows, w) weights of the difference, whose prediction has an error relative to it."""
    error = relative_error * images.stack[:, rows]
    return mask[rows] / (images.noise**2 + error * error)


_GAINS = (0.15, 3.0)  # bounds of a light's brightness


def _fitting_lights(fit: SpecularFit, gains: FloatArray, misfit: float) -> NDArray[np.intp]:
    """The lights to the side that fit; those that begin to get their brightness in `gains` (2, L).

    The others become invisible in `fit.visible`.
    """
    rows = slice(None, None, 3)
    scattered = fit.scattered(rows)
    specular = fit.specular(rows)
    accepted = []
    for k in fit.side:
        parts = scattered[k], specular[k]
        brightness = _brightness(fit.images.stack[k, rows], fit.error, parts, misfit)
        if brightness is None:
            fit.visible[k] = 0
            continue
        accepted.append(k)
        if k not in fit.fitting:
            gains[:, k] *= brightness
    np.clip(gains, *_GAINS, out=gains)
    return np.array(accepted, dtype=np.intp)


def _brightness(
    measured: FloatArray, error: float, parts: tuple[FloatArray, FloatArray], misfit: float
) -> Array | None:
    """Brightness of a light `measured` (h, w) in scattered and in specular light, over the present.

    `parts`: both predictions; films change both at grazing light (Fresnel's two reflectances).
    `error`: of the prediction, over the image. None if the residual exceeds `misfit`.
    """
    lit = parts[1] > 0
    if not lit.any():
        return None
    residual = measured - parts[0] - parts[1]
    typical = np.median(np.abs(residual[lit]))
    variance = (error * measured) ** 2 + (2 * typical) ** 2 + residual * residual + 1e-12
    design = np.stack(parts).reshape(2, -1).astype(np.float64)
    weighted = design / variance.ravel()
    normal = weighted @ design.T
    right = weighted @ measured.ravel()
    # a brightness of one is worth a fiftieth of the images
    prior = np.diag(0.02 * np.diag(normal)) + 1e-9 * np.eye(2)
    gains = np.clip(np.linalg.solve(normal + prior, right + prior.sum(axis=1)), *_GAINS)
    residual = measured - np.float32(gains[0]) * parts[0] - np.float32(gains[1]) * parts[1]
    return gains if residual[lit].std() <= misfit * measured[lit].std() else None


# One step: linear equations for slopes, scattered part, the model and the lights to the side.


def _columns(
    fit: SpecularFit, rows: slice, lift: bool = False
) -> tuple[list[FloatArray], FloatArray]:
    """Derivatives of some rows by both slopes and rho, their residual, derivatives by the
    logarithms of strength, roughness, path and blur, and by the `lift`; and weights: (L, rows, w)
    each. Derivatives by slopes, roughness and lift leave out the blur, an effect of second order.
    """
    model = fit.model
    slopes = p, q = fit.slopes[0][rows], fit.slopes[1][rows]
    rho = fit.rho[rows]
    grazing = fit.limits.grazing
    facets = _facets(
        _between_rows(fit.lights, rows), slopes, model.roughness, grazing, derivatives=True
    )
    specular = fit.specular(rows)
    residual = fit.residual(rows)
    weight = _inverse_variance(fit.images, fit.mask, rows, fit.error)
    trust = _ramp(facets.cosine, fit.limits.lit)
    seen = 1 / np.sqrt(1 + p * p + q * q)
    trust *= _ramp(seen, fit.limits.seen)
    trust *= fit.visible[:, rows]
    error = _SCATTERED_ERROR * fit.scattered(rows)
    trust /= (1 + weight * error * error) * (1 + weight * residual * residual / 9)
    ridge_px = _RIDGES_PER_MM * fit.grid.pitch_mm
    damped = rho * np.float32(np.exp(-0.5 * (ridge_px * model.path_px) ** 2))
    by_slope = [
        model.strength * specular_by + damped * matt_by
        for specular_by, matt_by in zip(facets.specular_by_slope, facets.matt_by_slope, strict=True)
    ]
    columns: list[Any] = [
        *by_slope,
        fit.soft[:, rows],
        residual,
        specular,
        model.strength * facets.specular_by_roughness,
        model.path_px**2 * rho * _laplacian(fit.soft, rows),  # heat equation
        np.float32(model.blur_px**2) * model.strength * _laplacian(fit.sharp, rows),
    ]
    if lift and fit.raised is not None:
        raised = _facets(_between_rows(fit.raised, rows), slopes, model.roughness, grazing)
        by_lift = model.strength * (raised.specular - facets.specular)
        columns.append((by_lift + rho * (raised.matt - facets.matt)) / _RAISED_MM)
    return columns, weight * trust


def _ramp(cosine: FloatArray, limits: tuple[float, float]) -> FloatArray:
    """Weights in [0, 1]."""
    return np.asarray(np.clip((cosine - limits[0]) / limits[1], 0, 1))


def _laplacian(stack: FloatArray, rows: slice) -> FloatArray:
    """(L, rows, w) of some rows of `stack`."""
    first = max(rows.start - 1, 0)
    inner = slice(rows.start - first, rows.stop - first)
    around = stack[:, first : rows.stop + 1]
    return np.stack([cv2.Laplacian(image, cv2.CV_32F)[inner] for image in around])


def _brightness_columns(fit: SpecularFit, rows: slice) -> list[tuple[int, FloatArray]]:
    """Lights to the side and derivatives (rows, w) of their images by the logarithms of their
    brightness, scattered light first."""
    parts = fit.scattered(rows), fit.specular(rows)
    return [(k, part[k]) for part in parts for k in fit.fitting.tolist()]


_PRIOR_WEIGHTS = (1e-6, 1e-6, 1.0, 1.0, 0.1)
"""Weights of the priors on the model's change, relative to the images: of the logarithms of its
first four fields, and of the lift."""
_MAX_CHANGE = (0.25, 0.25, 0.25, 0.25, 1.5)
"""Its largest change in one step; the lift's in mm."""


def _model_change(fit: SpecularFit, gentle: BoolArray) -> Array:
    """Change of the logarithms of strength, roughness, path and blur, and, where lights to the side
    show them, of the lift in mm and of these lights' brightness (scattered, then specular); the
    slopes of the `gentle` pixels are free.
    """
    sums: dict[int, Array] = {}

    def work(rows: slice) -> None:
        height = rows.stop - rows.start
        if (rows.start // height) % max(1, fit.grid.shape[0] // (12 * height)):
            return  # about 12 chunks suffice
        columns, weight = _columns(fit, rows, lift=True)
        gram = _gram(fit, columns, weight, rows, _brightness_columns(fit, rows))
        gram = _eliminated(_eliminated(gram, 0), 1)
        sums[rows.start] = gram[3:, 3:, gentle[rows]].sum(axis=2, dtype=np.float64)

    for_each_chunk(work, *fit.grid.shape, 2 * len(fit.soft))
    total = np.sum([sums[start] for start in sorted(sums)], axis=0)
    unknowns = len(total) - 1
    brightness = 2 * fit.fitting.size
    damping = [*_PRIOR_WEIGHTS, *[_PRIOR_WEIGHTS[0]] * brightness][:unknowns]
    largest = np.array([*_MAX_CHANGE, *[_MAX_CHANGE[0]] * brightness][:unknowns])
    change = np.linalg.solve(total[1:, 1:] + np.diag(damping), total[1:, 0])
    return np.clip(change, -largest, largest)


def _slope_equations(
    fit: SpecularFit,
    change: Array,
    used: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Information (3, h, w) of the slopes (xx, xy, yy) and force (2, h, w) on them, the model
    changed and the scattered part eliminated at each pixel; `used` (L, h, w) becomes the weights.
    """
    information = np.empty((3, *fit.mask.shape), dtype=np.float32)
    force = np.empty((2, *fit.mask.shape), dtype=np.float32)

    def work(rows: slice) -> None:
        columns, weight = _columns(fit, rows)
        residual = columns[3]
        brightness = _brightness_columns(fit, rows)
        for by, column in zip(change, columns[4:], strict=False):  # the lift's comes next
            residual -= np.float32(by) * column
        of_lights = change[change.size - len(brightness) :]
        for by, (k, column) in zip(of_lights, brightness, strict=True):
            residual[k] -= np.float32(by) * column
        gram = _gram(fit, columns[:4], weight, rows)
        information[:, rows] = gram[0, 0], gram[0, 1], gram[1, 1]
        force[:, rows] = gram[:2, 3]
        used[:, rows] = weight

    for_each_chunk(work, *fit.grid.shape, 2 * len(fit.soft))
    return information, force


def _gram(
    fit: SpecularFit,
    columns: list[FloatArray],
    weight: FloatArray,
    rows: slice,
    single: Sequence[tuple[int, FloatArray]] = (),
) -> FloatArray:
    """Normal equations (n, n, rows, w) of columns, of those of a `single` light each, and of the
    prior, rho eliminated."""
    count = len(columns)
    size = count + len(single)
    gram = np.zeros((size, size, *weight.shape[1:]), dtype=np.float32)
    weighted = [weight * column for column in columns]
    for i, weighted_column in enumerate(weighted):
        for j, column in enumerate(columns[: i + 1]):
            gram[i, j] = gram[j, i] = np.einsum("lij,lij->ij", weighted_column, column)
    for n, (k, column) in enumerate(single, count):
        for i, weighted_column in enumerate(weighted):
            gram[i, n] = gram[n, i] = weighted_column[k] * column
        for m, (light, beside) in enumerate(single, count):
            if light == k:
                gram[n, m] = weight[k] * column * beside
    slope_prior = fit.slope_prior[rows]
    for axis, off in enumerate(fit.slopes_from_start):
        gram[axis, axis] += slope_prior
        gram[axis, 3] -= slope_prior * off[rows]
        gram[3, axis] = gram[axis, 3]
    mean = fit.rho_mean[rows]
    rho_prior = 1 / (_LOCAL_RHO * mean) ** 2
    gram[2, 2] += rho_prior
    gram[2, 3] -= rho_prior * ((fit.rho[rows] - mean) * fit.mask[rows])
    gram[3, 2] = gram[2, 3]
    return _eliminated(gram, 2)


def _eliminated(gram: FloatArray, i: int) -> FloatArray:
    """Normal equations (n, n, rows, w) with unknown `i` eliminated."""
    return np.asarray(gram - gram[:, i, None] * (gram[i] / np.maximum(gram[i, i], 1e-12)))


# Heights at the corners of the pixels.


def _height_change(
    information: FloatArray, force: FloatArray, nodes: FloatArray, start: FloatArray, grid: Grid
) -> tuple[float, FloatArray]:
    """Fraction of the step that is taken, and the change of the heights (h + 1, w + 1).

    Conjugate gradients on their cosine transform, in which the slopes' prior and the preconditioner
    (Poisson's equation with the mean information) are diagonal.
    """
    pitch_mm = grid.pitch_mm
    size = [scipy.fft.next_fast_len(n, True) for n in start.shape]

    def forward(heights: FloatArray) -> FloatArray:
        return np.asarray(scipy.fft.dctn(heights, s=size, norm="ortho", workers=2), np.float32)

    def inverse(spectrum: FloatArray) -> FloatArray:
        heights = scipy.fft.idctn(spectrum, norm="ortho", workers=2)
        return np.asarray(heights[: start.shape[0], : start.shape[1]], np.float32)

    xx, xy, yy = information
    trace = xx + yy
    xx = xx + 0.02 * trace
    yy = yy + 0.02 * trace
    mean = np.float32(np.median(trace[grid.mask]) / 2)
    of_rows, of_columns = ((2 - 2 * np.cos(np.pi * np.arange(n) / n)) / pitch_mm**2 for n in size)
    laplacian = (of_rows[:, None] + of_columns[None]).astype(np.float32)
    # over `_SLOW_MM`, the start's mean slope is known to 0.2
    slow = laplacian * np.exp(-laplacian * _SLOW_MM**2) / 0.2**2
    laplacian[0, 0] = np.inf  # slopes do not show the mean height: it does not change

    def applied(spectrum: FloatArray) -> FloatArray:
        x, y = _slopes(inverse(spectrum), pitch_mm)
        pulled = forward(_slopes_adjoint(xx * x + xy * y, xy * x + yy * y, pitch_mm))
        return np.asarray(pulled + slow * spectrum)

    residual = forward(_slopes_adjoint(force[0], force[1], pitch_mm))
    residual -= slow * forward(nodes - start)
    solution, _ = conjugate_gradients(
        applied, lambda spectrum: spectrum / (laplacian * mean + slow), residual, most=40
    )
    added = inverse(solution)
    steepness = np.hypot(*_slopes(added, pitch_mm))
    steepest = float(np.percentile(steepness[grid.mask], 99.5))
    fraction = min(1.0, 0.6 / max(steepest, 1e-9))  # slopes change by no more, but for a few
    return fraction, added * fraction


def _slopes(nodes: FloatArray, pitch_mm: float) -> Slopes:
    """dz/dx and dz/dy (h, w) at the centres of the pixels whose corners are `nodes`."""
    half = 0.5 / pitch_mm
    falling = (nodes[:-1, 1:] - nodes[1:, :-1]) * half
    rising = (nodes[1:, 1:] - nodes[:-1, :-1]) * half
    return rising + falling, falling - rising


def _slopes_adjoint(x: FloatArray, y: FloatArray, pitch_mm: float) -> FloatArray:
    """The adjoint of :func:`_slopes`."""
    half = 0.5 / pitch_mm
    falling = (x + y) * half
    rising = (x - y) * half
    nodes = np.zeros((x.shape[0] + 1, x.shape[1] + 1), dtype=np.float32)
    nodes[:-1, 1:] += falling
    nodes[1:, :-1] -= falling
    nodes[1:, 1:] += rising
    nodes[:-1, :-1] -= rising
    return nodes


def _shifted(image: FloatArray, by: float, larger: int) -> FloatArray:
    """An image (h + larger, w + larger) moved by a fraction of a pixel, bicubic."""
    return _warped(image, (by, by), larger, cv2.INTER_CUBIC)


def _warped(image: FloatArray, shift: tuple[float, float], larger: int, flags: int) -> FloatArray:
    matrix = np.array([[1, 0, shift[0]], [0, 1, shift[1]]], dtype=np.float32)
    size = (image.shape[1] + larger, image.shape[0] + larger)
    border = cv2.BORDER_REPLICATE
    return np.asarray(cv2.warpAffine(image, matrix, size, flags=flags, borderMode=border))
