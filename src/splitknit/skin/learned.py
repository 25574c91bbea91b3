"""The relief by a network that has seen what skin does to light, and the glare that goes with it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from splitknit.imaging.band import bin_mean
from splitknit.imaging.chunks import for_each_chunk
from splitknit.imaging.geometry import height_gradients, normals_from_gradients
from splitknit.model import BoolArray, FloatArray, Rig
from splitknit.photometric.equations import shading
from splitknit.photometric.near_light import pseudo_normals
from splitknit.skin.coarse import lacking_coarse, slopes_inside
from splitknit.skin.diffusion import Diffusion
from splitknit.skin.grid import BandImages, Grid
from splitknit.skin.light import Lighting, lighting, predict, reached_by_all, slant_of, trust_of
from splitknit.skin.relief import ReliefEstimate
from splitknit.skin.turns import Turns, between

# Input of the relief network: the white band's light, described independently of rig, finger and exposure.
#
# Every pixel's images are taken apart by what the light's azimuth does to them. What does not depend on it is the
# brightness; what turns once is the slope, as photometric stereo finds it; what turns twice or three times no matt
# surface does, it is glare. All are relative to their neighbourhood, so that neither exposure nor pigment nor the
# finger's shape is seen in them, and they turn with the image as scalars and vectors do.


RIDGE_BAND_MM = 0.3
"""Standard deviation of the Gaussian mean that the relief is free of."""
LEVEL_MM = 0.6
"""Standard deviation of the Gaussian mean that brightness is relative to."""
LEAST_LIGHTS = 6
"""Fewer lights leave too little beside the slopes to tell glare."""
COUNT = 32
"""Fields of :func:`features`."""


@dataclass(frozen=True, slots=True, eq=False)
class Features:
    """Input of the network, and what its output is relative to."""

    fields: FloatArray
    """(32, h, w), zero outside the mask."""
    level: FloatArray
    """(C, h, w) local diffuse brightness of each channel, glare included."""


def features(
    band: BandImages, grid: Grid, surface_mm: FloatArray, light: Lighting, found: FloatArray | None = None
) -> Features:
    """Rig-independent description of the white band's light on a smooth surface.

    Parameters
    ----------
    band : three channels, six lights at least
    grid : fine grid
    surface_mm : (h, w) the smooth shape, finite
    light : of `band.rig` on that surface
    found : (C, h, w, 3) brightness times normal of ``band.stack / light.entering``, optional
        By least squares over the lights where it is not given.
    """
    if found is None:
        seen_by = band.rig, surface_mm, grid.mask, light.trust
        found = pseudo_normals(band.stack, *seen_by, view=grid.view, entering=light.entering)
    g = found
    slope_x, slope_y = grid.smooth(np.stack(height_gradients(surface_mm, grid.pitch_mm)), grid.mask, RIDGE_BAND_MM)
    normals = normals_from_gradients(slope_x, slope_y)
    to_harmonics = _beyond_matt(band.rig)
    channels, lights = band.stack.shape[:2]
    fields = np.zeros((COUNT, *grid.shape), dtype=np.float32)
    bright, slopes, beyond, geometry = np.split(fields, np.cumsum([channels, 2 * channels, 4 * channels]))
    levels = np.empty((channels, *grid.shape), dtype=np.float32)

    def brightness(chunk: slice) -> None:
        bright[:, chunk] = shading(np.moveaxis(normals[chunk], -1, 0), np.moveaxis(g[:, chunk], -1, 1))

    def relative(chunk: slice) -> None:
        columns = np.flatnonzero(grid.mask[chunk].any(axis=0))
        if not len(columns):
            return
        part = (chunk, slice(int(columns[0]), int(columns[-1]) + 1))  # the rest is no finger, and left out below
        vectors, trust, entering = light.vectors[:, :, *part], light.trust[:, *part], light.entering[:, *part]
        size = np.sqrt((vectors * vectors).sum(axis=1))  # (L, h, w)
        for c in range(channels):  # of all lights at once: threads wait for each other between operations
            level, here = levels[c, *part], np.moveaxis(g[c, *part], -1, 0)
            bright[c, *part] = np.clip(bright[c, *part] / level - 1, -1, 1)
            facing = level * normals[*part, 2]
            for axis, slope in enumerate((slope_x[part], slope_y[part])):
                slopes[2 * c + axis, *part] = np.clip(-(here[axis] + slope * here[2]) / facing, -2, 2)
            left = band.stack[c, :, *part] / entering
            left -= shading(here, vectors)  # what a matt surface shows
            left *= trust
            left /= level * size + np.float32(1e-9)
            beyond[4 * c : 4 * c + 4, *part] = np.clip(np.tensordot(to_harmonics, left, 1), -1, 1)

    for_each_chunk(brightness, *grid.shape, lights)
    np.maximum(grid.smooth(bright, grid.mask, LEVEL_MM), np.float32(1e-6), out=levels)
    for_each_chunk(relative, *grid.shape, lights)
    slopes -= grid.smooth(slopes, grid.mask, RIDGE_BAND_MM)
    towards = band.rig.light_vectors()
    tangent = float(np.mean(np.hypot(towards[:, 0], towards[:, 1]) / np.maximum(towards[:, 2], 1e-6)))
    others = [
        np.clip(slope_x, -2, 2) / 2,
        np.clip(slope_y, -2, 2) / 2,
        np.minimum(grid.depth_mm, 1),
        light.trust.mean(axis=0),
        *(np.clip(np.log(level / levels[0]), -3, 3) / 2 for level in levels[1:]),
        np.float32(grid.pitch_mm / 0.0264 - 1),
        np.float32(tangent * 2),
        *_statistics(slopes, beyond, light.trust.min(axis=0) > 0.9),
    ]
    for room, field in zip(geometry, others, strict=True):
        room[...] = field
    outside = ~grid.mask
    for field in fields:
        field[outside] = 0
    return Features(fields, levels)


def _statistics(slopes: FloatArray, beyond: FloatArray, lit: BoolArray) -> list[np.float32]:
    """What tells the scattering and the glare of the whole finger.

    Logarithms of the rms slope in every channel but the last over that in the last (more scattering takes more from red
    than from blue), and of the rms of what no matt surface explains over the rms slope.
    """
    region = (lit if lit.any() else np.ones_like(lit)).astype(np.uint8)
    size = cv2.countNonZero(region)

    def power(fields: FloatArray) -> float:
        return float(np.mean([cv2.norm(f, cv2.NORM_L2SQR, region) / size for f in fields])) + 1e-9

    channels = len(slopes) // 2
    of_slopes = [power(slopes[2 * c : 2 * c + 2]) for c in range(channels)]
    ratios = [*(p / of_slopes[-1] for p in of_slopes[:-1]), power(beyond) / of_slopes[-1]]
    return [np.float32(np.clip(np.log(ratio), -8, 8) / 2) for ratio in ratios]


def azimuth_waves(rig: Rig, most: int) -> FloatArray:
    """(L, 1 + 2 most) the waves 1, cos n a, sin n a at the azimuths a of the rig's lights."""
    towards = rig.light_vectors()
    azimuth = np.arctan2(towards[:, 1], towards[:, 0])
    waves = [np.ones_like(azimuth), *(f(n * azimuth) for n in range(1, most + 1) for f in (np.cos, np.sin))]
    return np.stack(waves, axis=1).astype(np.float32)


def _beyond_matt(rig: Rig) -> FloatArray:
    """(4, L) what turns an image's remainders into the second and third waves of the light's azimuth."""
    return np.asarray(np.linalg.pinv(azimuth_waves(rig, 3)[:, 3:], rcond=0.2), dtype=np.float32)


Network = Callable[[FloatArray], FloatArray]
"""From (32, h, w) features to (9, h, w): relief, seven waves of the glare, logarithm of the relief's variance."""

_QUARTER_TURNS = (0, 5, 3, 6)
"""Ways to lay the finger down for the network of the shape: turned by 0, 90, 180 and 270 degrees. Mirrored ones as well
change no figure of accuracy by more than 1 %."""
SHAPE_SLOPE = np.float32(0.1)
"""Unit of the slopes that the network of the shape adds."""
RELIEF_MM = np.float32(0.02)
"""Unit of the network's relief."""
GLARE = np.float32(0.05)
"""Unit of the network's glare, over the green channel's brightness."""


@dataclass(frozen=True, slots=True)
class Networks:
    """What has been learned."""

    relief: Network
    shape: Network | None = None
    """From (32, h, w) of :func:`_shape_features` to two slopes."""


RELIEF_TURNS = Turns(
    vectors=((3, 4), (5, 6), (7, 8), (21, 22)),
    second_waves=((9, 10), (13, 14), (17, 18)),
    third_waves=((11, 12), (15, 16), (19, 20)),
)
"""How the fields of :func:`features` turn."""
_RELIEF = Turns(vectors=((2, 3),), second_waves=((4, 5),), third_waves=((6, 7),))


def _drawn_in(
    ways: Sequence[int], network: Network, fields: FloatArray, before: FloatArray | None = None
) -> FloatArray:
    """Mean of what the network of the relief draws on the finger laid down in some of the eight ways, and of what it
    drew `before` in one more; both kinds of fields turn. The `fields` are lost: beside the network, which needs most
    memory, there is one copy of them."""
    parts = [] if before is None else [before]
    laid, lies = fields, 0
    for way in ways:
        if way != lies:
            laid, lies = RELIEF_TURNS.turned_in_place(laid, between(lies, way)), way
        part = network(laid)
        parts.append(_RELIEF.turned_back(part, way) if way else part)
    return np.asarray(sum(parts) / np.float32(len(parts)), dtype=np.float32)


LITTLE_GLOSS = 0.015
"""Mean specular reflection over the diffuse light, as the network finds it: below, there may be none."""
GAIN_UNCERTAINTY = (0.2, 0.15)
"""Standard deviation of the common factor of all heights with less and with more than that, on simulated skin whose
brightness of heights (a factor of seven) and boundary vary as nobody knows skin's; it is part of the deviation."""
SLANT_DEG, SLANT_ERROR = (0, 15, 30, 45, 60, 70), (0.74, 0.84, 1.1, 1.12, 1.02, 2.3)
"""Error of the relief over what the network states, by slant: the error is smallest where the skin faces lights
and camera. Ten fingers of our simulator have 0.7 to 0.9 up to 60 degrees, 2.3 beyond; two path-traced ones 0.6 to 0.8
below 15 degrees and 0.8 to 1.5 above (``validation/path_traced/score.py``)."""
MOST_MISSING = 0.25
"""Of the relief's power that is believed to be missing in the network's estimate."""
MOST_UNEVEN = 10.0
"""Condition of the waves up to the second at the lights' azimuths; one for a regular ring."""
PITCH_MM = (0.017, 0.041)
"""Pixels that the networks have learned to read, about."""


def can_learn(band: BandImages, pitch_mm: float) -> bool:
    """Whether a band shows what the networks need: three colours, enough lights all around, and fine pixels."""
    if len(band.channels) != 3 or band.stack.shape[1] < LEAST_LIGHTS:
        return False
    around = np.linalg.cond(azimuth_waves(band.rig, 2)) < MOST_UNEVEN
    return bool(around) and PITCH_MM[0] <= pitch_mm <= PITCH_MM[1]


def relief_by_network(  # noqa: PLR0917
    white: BandImages,
    grid: Grid,
    smooth_mm: FloatArray,
    light: Lighting,
    network: Network,
    found: FloatArray | None = None,
    ways: Sequence[int] = (0,),
    before: FloatArray | None = None,
) -> ReliefEstimate:
    """Relief as the network draws it; :func:`glare_of` has the glare that it drew with it.

    Parameters
    ----------
    white : three channels, six lights at least, see :func:`can_learn`
    grid : fine grid
    smooth_mm : (h, w) the shape without the relief
    light : lights on that shape
    network : see :data:`Network`
    found : see :func:`splitknit.skin.learned.features`
    ways : to lay the finger down (0 to 7), over which the mean is taken
    before : (9, h, w) what was drawn in one more way on an earlier shape, optional
    """
    seen = features(white, grid, smooth_mm, light, found)
    del light  # of no use beside the network, where memory is needed most
    drawn, levels = _drawn_in(ways, network, seen.fields, before), seen.level
    del seen
    slant = slant_of(smooth_mm, grid.pitch_mm)
    trust = trust_of(slant, grid)
    relief = drawn[0] * RELIEF_MM
    relief = (relief - grid.smooth(relief, grid.mask, RIDGE_BAND_MM)) * trust
    variance = np.exp(np.clip(drawn[8], -8, 4)) * RELIEF_MM * RELIEF_MM
    # where nothing is drawn, the relief is as high as elsewhere
    inner = trust > np.float32(0.9)
    power = float((relief[inner] ** 2).mean()) if inner.any() else float(RELIEF_MM) ** 2
    error = float(variance[inner].mean()) if inner.any() else 0.0
    typical = np.float32(np.sqrt(power))
    known = np.interp(slant, SLANT_DEG, SLANT_ERROR).astype(np.float32)
    deviation = np.hypot(np.sqrt(variance) * known * trust, typical * (1 - trust)) * grid.mask
    gloss = float((drawn[1][inner] * GLARE).mean()) if inner.any() else 0.0
    return ReliefEstimate(
        relief_mm=relief.astype(np.float32),
        deviation_mm=deviation.astype(np.float32),
        trust=trust,
        albedo=levels[0] * grid.mask,
        level=levels[1] * grid.mask,
        drawn=drawn,
        facts={
            "relief_by": "network",
            "gloss": gloss,
            "gain_uncertainty": GAIN_UNCERTAINTY[0 if gloss < LITTLE_GLOSS else 1],
            "relief_rms_um": 1000 * float(np.sqrt(power)),
            "relief_error_um": 1000 * float(np.sqrt(error)),
        },
    )


def glare_of(found: ReliefEstimate, rig: Rig, light: Lighting) -> FloatArray:
    """(L, h, w) light that the surface mirrors in each white image, as the network drew it."""
    assert found.drawn is not None
    assert found.level is not None
    size = np.sqrt((light.vectors * light.vectors).sum(axis=1))
    glare = np.tensordot(azimuth_waves(rig, 3), found.drawn[1:8] * GLARE, 1) * found.level * size
    return np.asarray(np.maximum(glare, 0), dtype=np.float32)


def with_its_power(found: ReliefEstimate) -> ReliefEstimate:
    """The estimate as high as the relief is.

    A mean over what is possible has less power than what is there, by its variance: one factor for the finger brings it
    back, up to :data:`MOST_MISSING`.
    """
    rms, error = found.facts["relief_rms_um"], found.facts["relief_error_um"]
    factor = np.float32(np.sqrt(1 + min((error / max(rms, 1e-6)) ** 2, MOST_MISSING)))
    facts = {**found.facts, "relief_rms_um": float(factor) * rms}
    return replace(found, relief_mm=found.relief_mm * factor, facts=facts)


def slopes_by_network(  # noqa: PLR0917
    bands: tuple[BandImages, ...],
    grid: Grid,
    height_mm: FloatArray,
    skin: dict[str, Diffusion],
    ridges: FloatArray,
    network: Network,
) -> tuple[FloatArray, FloatArray]:
    """Slopes (h, w) along x and y that the shape lacks: the mean over four ways to lay the finger down.

    Parameters as for :func:`_shape_features`.
    """
    fields = _shape_features(bands, grid, height_mm, skin, ridges)
    drawn = (_SLOPES.turned_back(network(SHAPE_TURNS.turned_by(fields, way)), way) for way in _QUARTER_TURNS)
    slopes = sum(drawn) / np.float32(len(_QUARTER_TURNS)) * SHAPE_SLOPE * grid.mask
    return slopes[0], slopes[1]


def ridge_tensor(relief_mm: FloatArray, grid: Grid, factor: int, low: Grid) -> FloatArray:
    """(3, h, w) how steep the ridges are on the coarse grid, and across which direction.

    The last is the root mean square slope of the relief (H, W) around each pixel; the others are that slope times the
    cosine and the sine of twice the azimuth of the direction across the ridges, less where the direction is not clear.
    """
    x, y = height_gradients(relief_mm, grid.pitch_mm)
    rows, columns = (length * factor for length in low.shape)
    parts = [p[:rows, :columns] for p in (x * x - y * y, 2 * x * y, x * x + y * y)]
    coarse = bin_mean(np.ascontiguousarray(np.nan_to_num(np.stack(parts))), factor)
    even, odd, power = low.smooth(coarse, low.mask, RIDGES_MM)
    slope = np.sqrt(np.maximum(power, np.float32(1e-8)))
    return np.asarray(np.stack([even / slope, odd / slope, slope]) * low.mask, dtype=np.float32)


# What the network of the shape sees: how images and prediction differ on the coarse grid, all bands together.
#
# The finished comparison leaves errors of one kind: where the finger turns away, towards its tip and its outline,
# ridges that nobody resolves, light that is lost at the rim and glare at grazing angles bend the shape. They show in
# what all bands have in common, which a network that has seen many fingers reads.

RIDGES_MM = 0.6
"""Standard deviation of the Gaussian mean of the ridges' slopes."""
SHAPE_COUNT = 32
"""Fields of :func:`_shape_features`."""
CHANNELS = ("red", "green", "blue", "nir")
WITH_WAVES = ("green", "nir")
"""Channels whose second and third waves are given."""
SHAPE_TURNS = Turns(
    vectors=((0, 1), (2, 3), (4, 5), (6, 7), (20, 21)),
    second_waves=((12, 13), (16, 17), (24, 25)),
    third_waves=((14, 15), (18, 19)),
)
"""How these fields turn; the direction across the ridges is given by cosine and sine of twice its azimuth."""
_SLOPES = Turns(vectors=((0, 1),), second_waves=(), third_waves=())


def _shape_features(
    bands: tuple[BandImages, ...], grid: Grid, height_mm: FloatArray, skin: dict[str, Diffusion], ridges: FloatArray
) -> FloatArray:
    """Describe how the images differ from what the shape predicts.

    Parameters
    ----------
    bands : images on `grid`; what a missing channel would show is zero
    grid : coarse grid
    height_mm : (h, w) the shape at its height above the finger plane, zero outside the mask
    skin : transfer function of each channel
    ridges : (3, h, w) of :func:`ridge_tensor`

    Returns
    -------
    (32, h, w) float32, zero outside the mask
    """
    slope_x, slope_y = slopes_inside(height_mm, grid)
    normals = normals_from_gradients(slope_x, slope_y)
    fields: dict[str, FloatArray] = {}
    brightness: dict[str, float] = {}
    trusted = np.zeros(grid.shape, dtype=np.float32)
    for band in bands:
        light = lighting(band.rig, grid, height_mm, normals)
        trusted = light.trust.mean(axis=0)
        reached = reached_by_all(light, grid)
        predicted_all = predict(light, grid, normals, [grid.sampled(skin[name]) for name in band.channels])
        waves = _beyond_matt(band.rig)
        size = np.sqrt((light.vectors * light.vectors).sum(axis=1))
        for c, name in enumerate(band.channels):
            expected = predicted_all[c]
            ratio = band.stack[c][:, reached] / np.maximum(expected[:, reached], np.float32(1e-4))
            brightness[name] = float(np.median(ratio))
            expected *= np.float32(brightness[name])
            both = np.stack([band.stack[c], expected]).astype(np.float32)
            seen, predicted = pseudo_normals(both, band.rig, height_mm, grid.mask, light.trust, view=grid.view)
            x, y = lacking_coarse(seen, predicted, grid)
            level = np.maximum(predicted[..., 2], np.float32(0.05 * brightness[name]))
            fields[f"{name} x"], fields[f"{name} y"] = 4 * x, 4 * y
            fields[f"{name} level"] = np.log(np.clip(seen[..., 2] / level, 0.2, 5.0))
            if name in WITH_WAVES:
                matt = shading(np.moveaxis(seen, -1, 0), light.vectors)
                left = (band.stack[c] - matt) * light.trust / (level * size + np.float32(1e-9))
                for n, wave in enumerate(np.clip(np.tensordot(waves, left, 1), -0.5, 0.5)):
                    fields[f"{name} {n}"] = 10 * wave
    nothing = np.zeros(grid.shape, dtype=np.float32)
    names = [f"{name} {axis}" for name in CHANNELS for axis in "xy"] + [f"{name} level" for name in CHANNELS]
    names += [f"{name} {n}" for name in WITH_WAVES for n in range(4)]
    reference = max(brightness.get("red", next(iter(brightness.values()))), 1e-9)
    tints = [np.log(max(brightness.get(name, reference), 1e-9) / reference) / 2 for name in CHANNELS[1:]]
    known: list[FloatArray] = [
        _f32(np.clip(slope_x, -4, 4) / 2),
        _f32(np.clip(slope_y, -4, 4) / 2),
        _f32(np.minimum(grid.depth_mm, 3) / 2),
        trusted,
        *ridges,
        *(nothing + np.float32(t) for t in tints),
        nothing + np.float32("nir" in brightness),
        nothing + np.float32(grid.pitch_mm / 0.106 - 1),
    ]
    stacked = np.stack([*(fields.get(name, nothing) for name in names), *known]).astype(np.float32)
    return np.asarray(np.nan_to_num(stacked) * grid.mask, dtype=np.float32)


def _f32(field: Any) -> FloatArray:
    return np.asarray(field, dtype=np.float32)
