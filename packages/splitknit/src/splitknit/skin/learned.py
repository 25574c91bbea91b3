"""Relief, specular reflection and the shape's residual slopes by networks: their input, and what
their output means."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from splitknit.imaging.chunks import for_each_chunk
from splitknit.imaging.geometry import height_gradients, normals_from_gradients
from splitknit.imaging.pixels import bin_mean
from splitknit.model import BoolArray, FloatArray, Rig
from splitknit.networks.augmentation import Symmetry, mean_over_turns, shrinkage_gain
from splitknit.photometric.equations import length, shading
from splitknit.photometric.near_light import pseudo_normals
from splitknit.skin.diffusion import CHANNELS, Diffusion
from splitknit.skin.grid import BandImages, Grid
from splitknit.skin.light import Lighting, lighting, predict, reached_by_all, slant_of, trust_of
from splitknit.skin.relief import ReliefEstimate
from splitknit.skin.shape import (
    CoarseImages,
    Shape,
    above_plane,
    integrate,
    residual_slopes,
    slopes_inside,
)

# Input of the relief network: the white band's light, described independently of rig, finger and
# exposure. Every pixel's images are decomposed into harmonics of the light's azimuth. The constant
# is the brightness; the first harmonic is the slope, as photometric stereo measures it; no matt
# surface has a second or third one: they are specular reflection. All are relative to their
# neighbourhood, so that exposure, pigment and the finger's shape cancel, and they turn with the
# image as scalars and vectors do.

COUNT = 32
"""Fields of :func:`features`. Source: definition."""


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """Input of the network, and what its output is relative to."""

    fields: FloatArray  # (32, h, w), zero outside the mask
    level: FloatArray  # (C, h, w) local brightness of each channel, specular reflection included


RIDGE_BAND_MM = 0.3
"""Standard deviation of the Gaussian mean that the relief is free of; the networks were trained
with it. Chosen on: judgement. Range: 0.21 to 0.6 (validation/parameters)."""
_LEVEL_MM = 0.6
"""Standard deviation of the Gaussian mean that brightness is relative to; the networks were trained
with it. Chosen on: judgement. Range: 0.3 to 1.2 (validation/parameters)."""


def features(
    band: BandImages,
    grid: Grid,
    surface_mm: FloatArray,
    light: Lighting,
    measured: FloatArray | None = None,
) -> Features:
    """Rig-independent description of the white band's light on a finite smooth surface (h, w) of
    the fine grid.

    Three channels, six lights at least. `light`: of `band.rig` on that surface; `measured`: (C, h,
    w, 3) brightness times normal of ``band.stack / light.entering``, by least squares over the
    lights where it is not given.
    """
    g = measured
    if g is None:
        g = pseudo_normals(
            band.stack,
            band.rig,
            surface_mm,
            grid.mask,
            light.trust,
            view=grid.view,
            entering=light.entering,
        )
    slope_x, slope_y = grid.smooth(
        np.stack(height_gradients(surface_mm, grid.pitch_mm)), grid.mask, RIDGE_BAND_MM
    )
    normals = normals_from_gradients(slope_x, slope_y)
    to_harmonics = _beyond_matt(band.rig)
    channels, lights = band.stack.shape[:2]
    fields = np.zeros((COUNT, *grid.shape), dtype=np.float32)
    bright, slopes, beyond, geometry = np.split(
        fields, np.cumsum([channels, 2 * channels, 4 * channels])
    )
    levels = np.empty((channels, *grid.shape), dtype=np.float32)

    def relative(chunk: slice) -> None:
        vectors = light.vectors[:, :, chunk]
        size = length(np.moveaxis(vectors, 1, 0))
        # of all lights at once: threads wait for each other between operations
        for c in range(channels):
            level, here = levels[c, chunk], np.moveaxis(g[c, chunk], -1, 0)
            bright[c, chunk] = np.clip(bright[c, chunk] / level - 1, -1, 1)
            facing = level * normals[chunk, :, 2]
            for axis, slope in enumerate((slope_x[chunk], slope_y[chunk])):
                slopes[2 * c + axis, chunk] = np.clip(
                    -(here[axis] + slope * here[2]) / facing, -2, 2
                )
            left = band.stack[c, :, chunk] / light.entering[:, chunk]
            left -= shading(here, vectors)  # what a matt surface shows
            left *= light.trust[:, chunk]
            left /= level * size + 1e-9
            beyond[4 * c : 4 * c + 4, chunk] = np.clip(np.tensordot(to_harmonics, left, 1), -1, 1)

    bright[...] = np.einsum("hwk,chwk->chw", normals, g)
    np.maximum(grid.smooth(bright, grid.mask, _LEVEL_MM), 1e-6, out=levels)
    for_each_chunk(relative, *grid.shape, lights)
    slopes -= grid.smooth(slopes, grid.mask, RIDGE_BAND_MM)
    towards = band.rig.light_vectors()
    tangent = float(
        np.mean(np.hypot(towards[:, 0], towards[:, 1]) / np.maximum(towards[:, 2], 1e-6))
    )
    others = [
        np.clip(slope_x, -2, 2) / 2,
        np.clip(slope_y, -2, 2) / 2,
        np.minimum(grid.depth_mm, 1),
        light.trust.mean(axis=0),
        *(np.clip(np.log(level / levels[0]), -3, 3) / 2 for level in levels[1:]),
        grid.pitch_mm / 0.0264 - 1,
        tangent * 2,
        *_statistics(slopes, beyond, light.trust.min(axis=0) > 0.9),
    ]
    for room, field in zip(geometry, others, strict=True):
        room[...] = field
    outside = ~grid.mask
    for field in fields:
        field[outside] = 0
    return Features(fields, levels)


def _statistics(slopes: FloatArray, beyond: FloatArray, lit: BoolArray) -> list[np.float32]:
    """Three numbers of the whole finger, which depend on its scattering and specular reflection:
    logarithms of the rms slope in all channels but the last over the last's, and of the rms of what
    no matt surface explains over the rms slope.
    """
    region = lit if lit.any() else np.ones_like(lit)

    def power(fields: FloatArray) -> float:
        return float(np.mean([np.square(f[region]).mean(dtype=np.float64) for f in fields])) + 1e-9

    channels = len(slopes) // 2
    of_slopes = [power(slopes[2 * c : 2 * c + 2]) for c in range(channels)]
    ratios = [*(p / of_slopes[-1] for p in of_slopes[:-1]), power(beyond) / of_slopes[-1]]
    return [np.float32(np.clip(np.log(ratio), -8, 8) / 2) for ratio in ratios]


def azimuth_waves(rig: Rig, highest: int) -> FloatArray:
    """(L, 1 + 2 highest) the harmonics 1, cos n a, sin n a at the azimuths a of the rig's
    lights."""
    towards = rig.light_vectors()
    azimuth = np.arctan2(towards[:, 1], towards[:, 0])
    waves = [
        np.ones_like(azimuth),
        *(f(n * azimuth) for n in range(1, highest + 1) for f in (np.cos, np.sin)),
    ]
    return np.stack(waves, axis=1).astype(np.float32)


def _beyond_matt(rig: Rig) -> FloatArray:
    """(4, L) from an image's residuals to the second and third harmonic of the light's azimuth."""
    return np.asarray(np.linalg.pinv(azimuth_waves(rig, 3)[:, 3:], rcond=0.2), dtype=np.float32)


Network = Callable[[FloatArray], FloatArray]
"""From (32, h, w) features to (9, h, w): relief, seven harmonics of the specular reflection,
logarithm of the relief's variance."""

SHAPE_SLOPE = 0.1
"""Unit of the slopes of the shape network. Source: definition (``training/shape.py``)."""
RELIEF_MM = 0.02
"""Unit of the relief of the relief network. Source: definition (``training/relief.py``)."""
GLARE = 0.05
"""Unit of its specular reflection, over the green channel's brightness. Source: definition
(``training/relief.py``)."""


@dataclass(frozen=True, slots=True)
class Networks:
    """Trained networks of the `metric` method."""

    relief: Network
    shape: Network | None = None
    """From (32, h, w) of :func:`_shape_features` to two slopes."""


RELIEF_SYMMETRY = Symmetry(
    vectors=((3, 4), (5, 6), (7, 8), (21, 22)),
    second_harmonics=((9, 10), (13, 14), (17, 18)),
    third_harmonics=((11, 12), (15, 16), (19, 20)),
)
"""Symmetry of the fields of :func:`features`. Source: definition."""
_RELIEF_OUTPUT = Symmetry(vectors=((2, 3),), second_harmonics=((4, 5),), third_harmonics=((6, 7),))
"""Symmetry of the relief network's output. Source: definition."""


def relief_network(
    network: Network, turns: Sequence[int], earlier: FloatArray | None = None
) -> Network:
    """The relief network under test-time augmentation; parameters as for
    :func:`mean_over_turns`."""
    symmetries = RELIEF_SYMMETRY, _RELIEF_OUTPUT
    return lambda fields: mean_over_turns(network, fields, symmetries, turns, earlier)


_MIN_LIGHTS = 6
"""Min number of lights: with fewer the slopes leave no degrees of freedom to measure specular
reflection. Chosen on: judgement. Range: 3 to 6 (validation/parameters)."""
_NETWORK_PITCH_MM = (0.017, 0.041)
"""Smallest and largest pixels that the networks are applied to: about those that they were trained
on."""


def can_learn(band: BandImages, pitch_mm: float) -> bool:
    """Whether the networks can be applied to a band: three colours, enough lights all around, and
    fine pixels."""
    if len(band.channels) != 3 or band.stack.shape[1] < _MIN_LIGHTS:
        return False
    # condition of the harmonics up to the second at the lights' azimuths; one for a regular ring
    around = np.linalg.cond(azimuth_waves(band.rig, 2)) < 10.0
    return bool(around) and _NETWORK_PITCH_MM[0] <= pitch_mm <= _NETWORK_PITCH_MM[1]


def relief_by_network(
    light: Features, grid: Grid, smooth_mm: FloatArray, network: Network
) -> ReliefEstimate:
    """Relief as the network estimates it on the fine grid.

    `light`: of the white band on `smooth_mm` (h, w), the shape without the relief; its fields are
    turned in place.
    """
    return relief_of_output(network(light.fields), light.level[:2] * grid.mask, grid, smooth_mm)


SLANT_DEG = (0, 15, 30, 45, 60, 70)
"""Slants at which `SLANT_ERROR` is given. Chosen on: simulated fingers (ten, and two path-traced
ones, validation/path_traced)."""
SLANT_ERROR = (0.74, 0.84, 1.1, 1.12, 1.02, 2.3)
"""Error of the relief over what the network states, by slant; it is smallest where the skin faces
lights and camera. Fingers not trained on have, simulated ones, 0.75 to 0.9 up to 60 degrees and 2
beyond, path-traced ones 0.95 to 1.3 and 2.9. Chosen on: simulated fingers (ten, and two path-traced
ones, validation/path_traced). Range: none within 0.7 to 1.4 (validation/parameters)."""


def relief_of_output(
    output: FloatArray, levels: FloatArray, grid: Grid, smooth_mm: FloatArray
) -> ReliefEstimate:
    """Relief on a smooth shape (h, w) from the network's `output` and the features' first two
    levels, masked."""
    slant = slant_of(smooth_mm, grid.pitch_mm)
    trust = trust_of(slant, grid)
    relief = output[0] * RELIEF_MM
    relief = (relief - grid.smooth(relief, grid.mask, RIDGE_BAND_MM)) * trust
    variance = np.exp(np.clip(output[8], -8, 4)) * RELIEF_MM * RELIEF_MM
    # where skin is too slanted to be estimated, the relief is as high as elsewhere
    inner = trust > 0.9
    power = float((relief[inner] ** 2).mean()) if inner.any() else float(RELIEF_MM) ** 2
    error = float(variance[inner].mean()) if inner.any() else 0.0
    typical = np.float32(np.sqrt(power))
    known = np.interp(slant, SLANT_DEG, SLANT_ERROR).astype(np.float32)
    deviation = np.hypot(np.sqrt(variance) * known * trust, typical * (1 - trust)) * grid.mask
    gloss = float((output[1][inner] * GLARE).mean()) if inner.any() else 0.0
    return ReliefEstimate(
        relief_mm=relief.astype(np.float32),
        deviation_mm=deviation.astype(np.float32),
        trust=trust,
        albedo=levels[0],
        level=levels[1],
        output=output,
        facts={
            "relief_by": "network",
            "gloss": gloss,
            "relief_rms_um": 1000 * float(np.sqrt(power)),
            "relief_error_um": 1000 * float(np.sqrt(error)),
        },
    )


def variance_restored(estimate: ReliefEstimate) -> ReliefEstimate:
    """The estimate with the variance that it lost by shrinkage."""
    rms = estimate.facts["relief_rms_um"]
    gain = np.float32(shrinkage_gain(rms, estimate.facts["relief_error_um"]))
    facts = {**estimate.facts, "relief_rms_um": float(gain) * rms}
    return replace(estimate, relief_mm=estimate.relief_mm * gain, facts=facts)


GAIN_UNCERTAINTY = 0.13
"""Standard deviation of the common factor of all heights, which shading does not show: the factor's
rms deviation from one. Chosen on: fingers not trained on (ten path-traced ones of
validation/path_traced/make.py ``--drawn 10 --seed 2``, twelve simulated ones)."""


def stated_deviation(
    relief_mm: FloatArray, deviation_mm: FloatArray, grid: Grid, gain: float
) -> FloatArray:
    """(h, w) deviation of a relief by the network, with the uncertainty `gain` of the factor of
    its heights."""
    ridges = relief_mm - grid.smooth(relief_mm, grid.mask, RIDGE_BAND_MM)
    return np.asarray(np.hypot(deviation_mm, np.float32(gain) * ridges))


def refined_shape(
    shape: Shape,
    relief_mm: FloatArray,
    images: CoarseImages,
    optics: Mapping[str, Diffusion],
    network: Network,
) -> Shape:
    """The shape with the residual slopes that the shape network estimates from the images and the
    relief (H, W)."""
    grid = images.grid
    ridges = _ridge_tensor(relief_mm, images.fine, images.factor, grid)
    fields = _shape_features(
        images.bands, grid, above_plane(shape.height_mm, images) * grid.mask, optics, ridges
    )
    symmetries = SHAPE_SYMMETRY, _SLOPES  # mirroring changes < 1 %
    slope_x, slope_y = mean_over_turns(network, fields, symmetries, range(4)) * SHAPE_SLOPE
    added = integrate(slope_x * grid.mask, slope_y * grid.mask, grid, shape.facing)
    return replace(shape, height_mm=shape.height_mm + added)


_RIDGE_SLOPES_MM = 0.6
"""Standard deviation of the Gaussian mean of the ridges' slopes; the shape network was trained with
it. Chosen on: judgement. Range: 0.3 to 1.2 (validation/parameters)."""


def _ridge_tensor(relief_mm: FloatArray, grid: Grid, factor: int, low: Grid) -> FloatArray:
    """(3, h, w) on the coarse grid: cosine and sine of twice the azimuth across the ridges, times
    the rms slope of the relief (H, W) around, less where unclear; and that slope.
    """
    x, y = height_gradients(relief_mm, grid.pitch_mm)
    rows, columns = (length * factor for length in low.shape)
    parts = [p[:rows, :columns] for p in (x * x - y * y, 2 * x * y, x * x + y * y)]
    coarse = bin_mean(np.ascontiguousarray(np.nan_to_num(np.stack(parts))), factor)
    even, odd, power = low.smooth(coarse, low.mask, _RIDGE_SLOPES_MM)
    slope = np.sqrt(np.maximum(power, 1e-8))
    return np.stack([even / slope, odd / slope, slope]) * low.mask


# Input of the shape network: how images and prediction differ on the coarse grid, in all bands.
#
# Analysis by synthesis leaves errors with a pattern: where the finger turns away, towards its tip
# and its outline, unresolved ridges, light that is lost at the rim and specular reflection at
# grazing angles bend the shape.

WITH_WAVES = ("green", "nir")
"""Channels whose second and third harmonics are given."""
SHAPE_SYMMETRY = Symmetry(
    vectors=((0, 1), (2, 3), (4, 5), (6, 7), (20, 21)),
    second_harmonics=((12, 13), (16, 17), (24, 25)),
    third_harmonics=((14, 15), (18, 19)),
)
"""Symmetry of these fields; the direction across the ridges is given by cosine and sine of twice
its azimuth. Source: definition."""
_SLOPES = Symmetry(vectors=((0, 1),))
"""Symmetry of the shape network's output. Source: definition."""


def _shape_features(
    bands: tuple[BandImages, ...],
    grid: Grid,
    height_mm: FloatArray,
    skin: Mapping[str, Diffusion],
    ridges: FloatArray,
) -> FloatArray:
    """(32, h, w) how coarse images differ from the shape's prediction; zero outside the mask, and
    of missing channels. `height_mm`: above the finger plane, zero outside the mask; `skin`:
    transfer function of each channel; `ridges`: (3, h, w) of :func:`_ridge_tensor`.
    """
    slope_x, slope_y = slopes_inside(height_mm, grid)
    normals = normals_from_gradients(slope_x, slope_y)
    fields = np.zeros((COUNT, *grid.shape), dtype=np.float32)
    brightness: dict[str, float] = {}
    trusted = np.zeros(grid.shape, dtype=np.float32)
    for band in bands:
        light = lighting(band.rig, grid, height_mm, normals)
        trusted = light.trust.mean(axis=0)
        reached = reached_by_all(light, grid)
        predicted_all = predict(
            light, grid, normals, [grid.sampled(skin[name]) for name in band.channels]
        )
        waves = _beyond_matt(band.rig)
        size = length(np.moveaxis(light.vectors, 1, 0))
        for c, name in enumerate(band.channels):
            expected = predicted_all[c]
            ratio = band.stack[c][:, reached] / np.maximum(expected[:, reached], 1e-4)
            brightness[name] = float(np.median(ratio))
            expected *= brightness[name]
            both = np.stack([band.stack[c], expected]).astype(np.float32)
            measured, predicted = pseudo_normals(
                both, band.rig, height_mm, grid.mask, light.trust, view=grid.view
            )
            x, y = residual_slopes(measured, predicted, grid)
            level = np.maximum(predicted[..., 2], 0.05 * brightness[name])
            k = CHANNELS.index(name)
            fields[2 * k], fields[2 * k + 1] = 4 * x, 4 * y
            fields[8 + k] = np.log(np.clip(measured[..., 2] / level, 0.2, 5.0))
            if name in WITH_WAVES:
                matt = shading(np.moveaxis(measured, -1, 0), light.vectors)
                left = (band.stack[c] - matt) * light.trust / (level * size + 1e-9)
                first = 12 + 4 * WITH_WAVES.index(name)
                harmonics = np.clip(np.tensordot(waves, left, 1), -0.5, 0.5)
                fields[first : first + 4] = 10 * harmonics
    reference = max(brightness.get("red", next(iter(brightness.values()))), 1e-9)
    tints = [
        np.log(max(brightness.get(name, reference), 1e-9) / reference) / 2 for name in CHANNELS[1:]
    ]
    known: list[Any] = [
        np.clip(slope_x, -4, 4) / 2,
        np.clip(slope_y, -4, 4) / 2,
        np.minimum(grid.depth_mm, 3) / 2,
        trusted,
        *ridges,
        *tints,
        "nir" in brightness,
        grid.pitch_mm / 0.106 - 1,
    ]
    for field, values in zip(fields[20:], known, strict=True):
        field[...] = values
    return np.nan_to_num(fields) * grid.mask
