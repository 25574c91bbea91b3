"""Presentation attack detection: what of a capture and its result differs between skin and copies, and a probability.

Terms and rates: ISO/IEC 30107-3. The shipped model (``data/pad.json``) was fitted to simulated attacks only:
``docs/experiments/pad.md``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from splitknit.imaging.band import has_colour, linear_channels
from splitknit.imaging.geometry import smoothed
from splitknit.model import Band, BoolArray, Capture, FloatArray, Reconstruction, vector_at_origin

PX_PER_MM = 15.0
"""At which everything is measured: photographs and results are brought to it."""
_FACING = 0.8
"""Cosine between the surface without ridges and the view: flanks are left out."""
_SLOW_MM, _FINE_MM = 0.35, 0.06
"""Standard deviations of the Gaussians around the band of ridges."""
_LEAST_MM2 = 20.0


def features(capture: Capture, result: Reconstruction) -> dict[str, float]:
    """What tells skin from copies, by name; NaN where the capture lacks the part.

    Parameters
    ----------
    capture : white light at least; colours, near infrared, known exposures and polarised series add features
    result : of this capture, any preset

    Returns
    -------
    dict
        ``relief_*`` (of the result), ``shape_*`` (1/mm), ``colour_*`` (logarithms of ratios of diffuse light),
        ``spread_*`` (contrast of ridges by colour, logarithms), ``gloss_*``, ``polarised_*`` and ``motion_um``.

    References
    ----------
    Spread: the contrast of ridges falls with the radius over which a colour scatters (Jensen et al. 2001, section 2).
    """
    binning = max(round(8 * capture.rig.camera.px_per_mm / PX_PER_MM) / 8, 1.0)
    shape, relief, mask = _coarse(result, binning)
    pitch = result.pitch_mm * binning
    inside = _facing(shape, mask, pitch)
    found = dict.fromkeys(FEATURES, np.nan)
    if not result.scale_known or inside.sum() < 100:
        return found
    found |= _of_relief(relief, inside, pitch) | _of_shape(shape, inside, pitch)
    white, nir = capture.bands["white"], capture.bands.get("nir")
    colours = ("red", "green", "blue") if has_colour(white) and not white.colours else ("grey",)
    light = dict(zip(colours, linear_channels(white, capture.encoding, colours, None, binning), strict=True))
    if nir is not None:
        light["nir"] = linear_channels(nir, capture.encoding, ("grey",), None, binning)[0]
    stacks = {name: np.maximum(one, 1e-6 * float(one.max()) + 1e-12) for name, one in light.items()}
    found |= _of_colour(stacks, inside, capture) | _of_spread(stacks, inside, pitch)
    vectors = {"nir": nir, **dict.fromkeys(colours, white)}
    for name in stacks.keys() & {"grey", "green", "nir"}:
        band = vectors[name]
        assert band is not None
        found |= _of_gloss("nir" if name == "nir" else "white", stacks[name], inside, _vectors(capture, band))
    if (crossed := capture.bands.get("white_crossed")) is not None:
        found |= _of_films(capture, crossed, inside, binning)
    moved = result.quality.get("white", {}).get("motion_mm") if isinstance(result.quality.get("white"), Mapping) else None
    if moved:
        found["motion_um"] = 1000 * float(np.median(moved))
    return {name: value if np.isfinite(value) else np.nan for name, value in found.items()}


FEATURES = (
    "relief_rms", "relief_fine", "relief_skew", "relief_coherence", "shape_across", "shape_along", "shape_rest",
    "colour_red", "colour_blue", "colour_nir", "spread_red", "spread_green", "spread_nir", "spread_blue",
    "spread_fixed", "spread_fixed_nir", "spread_fixed_red", "gloss_white", "gloss_nir", "gloss_rest_white",
    "gloss_rest_nir", "gloss_tail_white", "gloss_tail_nir", "polarised_share", "polarised_red", "motion_um",
)  # fmt: skip


def _coarse(result: Reconstruction, binning: float) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Shape (mm), relief (um) and mask on the features' pixels."""
    size = tuple(int(n // binning) for n in result.mask.shape[::-1])
    whole = result.mask & np.isfinite(result.height_mm)

    def mean(field: NDArray[Any]) -> FloatArray:
        return np.asarray(cv2.resize(field.astype(np.float32), size, interpolation=cv2.INTER_AREA), dtype=np.float32)

    weight = mean(whole)
    shape, relief = (mean(np.where(whole, np.nan_to_num(one), 0)) for one in (result.shape_mm, result.ridge_mm))
    over = np.maximum(weight, 1e-3)
    return shape / over, 1000 * relief / over, weight > 0.99


def _facing(shape: FloatArray, mask: BoolArray, pitch: float) -> BoolArray:
    """Where the surface faces the camera, 1 mm from its outline."""
    slow = smoothed(shape, mask, 0.5 / pitch)
    down, right = np.gradient(slow, pitch)
    far = ndimage.distance_transform_edt(np.pad(mask, 1))[1:-1, 1:-1] * pitch > 1.0
    facing = far & (1 / np.sqrt(1 + down**2 + right**2) > _FACING)
    return np.asarray(facing if facing.sum() * pitch**2 > _LEAST_MM2 else far)


def _band_of(image: FloatArray, inside: BoolArray, pitch: float) -> FloatArray:
    """The band of ridges of an image, robustly limited."""
    fine = smoothed(image, inside, _FINE_MM / pitch)
    band = np.where(inside, fine - smoothed(image, inside, _SLOW_MM / pitch), 0)
    limit = 6.0 * float(np.median(np.abs(band[inside]))) + 1e-12
    return np.asarray(np.clip(band, -limit, limit), dtype=np.float32)


def _of_relief(relief: FloatArray, inside: BoolArray, pitch: float) -> dict[str, float]:
    band = _band_of(relief, inside, pitch)
    values = band[inside]
    rest = (relief - smoothed(relief, inside, 0.1 / pitch))[inside]
    right, down = (cv2.Sobel(band, cv2.CV_32F, *axes) for axes in ((1, 0), (0, 1)))
    xx, yy, xy = (smoothed(one, inside, 0.5 / pitch) for one in (right * right, down * down, right * down))
    coherence = np.hypot(xx - yy, 2 * xy) / np.maximum(xx + yy, 1e-12)
    deviation = float(values.std()) + 1e-3
    return {
        "relief_rms": float(np.log(deviation)),
        "relief_fine": float(np.log(rest.std() / deviation + 1e-3)),
        "relief_skew": float(np.mean((values / deviation) ** 3)),
        "relief_coherence": float(np.mean(coherence[inside])),
    }


def _of_shape(shape: FloatArray, inside: BoolArray, pitch: float) -> dict[str, float]:
    rows, columns = np.nonzero(inside)
    x, y = (columns - columns.mean()) * pitch, (rows - rows.mean()) * pitch
    basis = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    values = shape[inside].astype(np.float64)
    fit = np.linalg.lstsq(basis, values, rcond=None)[0]
    bends = np.linalg.eigvalsh([[2 * fit[3], fit[4]], [fit[4], 2 * fit[5]]])
    rest = float(np.std(values - basis @ fit))
    return {"shape_across": float(bends[0]), "shape_along": float(bends[1]), "shape_rest": float(np.log(rest + 1e-3))}


def _vectors(capture: Capture, band: Band) -> NDArray[np.float64]:
    """(L, 3) light on the origin in every image."""
    leds = capture.rig.leds
    return np.array([sum(vector_at_origin(leds[k]) for k in group) for group in band.lights])


def _of_colour(stacks: Mapping[str, FloatArray], inside: BoolArray, capture: Capture) -> dict[str, float]:
    """Medians over the lights leave reflections out."""
    level = {name: np.log(np.median(one[:, inside], axis=0)) for name, one in stacks.items()}
    found = {}
    if "green" in level:
        found = {f"colour_{one}": float(np.median(level[one] - level["green"])) for one in ("red", "blue")}
    nir = capture.bands.get("nir")
    exposed = any(bool((band.exposure != 1.0).any()) for band in capture.bands.values())
    if nir is not None and "red" in level and exposed:
        here, there = (np.median(_vectors(capture, band)[:, 2]) for band in (nir, capture.bands["white"]))
        found["colour_nir"] = float(np.median(level["nir"] - level["red"]) - np.log(here / there))
    return found


def _of_spread(stacks: Mapping[str, FloatArray], inside: BoolArray, pitch: float) -> dict[str, float]:
    """Contrast of ridges that turns with the light (relief), and that does not (pigment, print), by colour."""
    turning, fixed = {}, {}
    for name, stack in stacks.items():
        bands = np.stack([_band_of(np.log(one), inside, pitch)[inside] for one in stack])
        mean = bands.mean(axis=0)
        turning[name] = float(np.log(np.sqrt(np.mean((bands - mean) ** 2)) + 1e-4))
        fixed[name] = float(np.log(np.std(mean) + 1e-4))
    finest = "blue" if "blue" in stacks else "grey"
    found = {"spread_blue": turning[finest], "spread_fixed": fixed[finest] - turning[finest]}
    found |= {f"spread_{one}": turning[one] - turning[finest] for one in ("red", "green", "nir") if one in turning}
    return found | {f"spread_fixed_{one}": fixed[one] - fixed[finest] for one in ("red", "nir") if one in fixed}


def _of_gloss(name: str, stack: FloatArray, inside: BoolArray, vectors: NDArray[np.float64]) -> dict[str, float]:
    """Light that no matt surface sends: what Lambert's law leaves, and the tail of highlights."""
    images = stack[:, inside].astype(np.float64)
    rest = images - vectors @ (np.linalg.pinv(vectors) @ images)
    typical = np.median(images, axis=0)
    bright = np.max(images, axis=0) / np.maximum(typical, 1e-9)
    return {
        f"gloss_rest_{name}": float(np.log(np.sqrt(np.mean(rest**2)) / np.mean(images) + 1e-4)),
        f"gloss_{name}": float(np.log(np.median(bright))),
        f"gloss_tail_{name}": float(np.log(np.percentile(bright, 99.5) / np.median(bright))),
    }


def _of_films(capture: Capture, crossed: Band, inside: BoolArray, binning: float) -> dict[str, float]:
    """Light that kept its polarisation: the surface's, and once scattered, which is deeper in red."""
    from dataclasses import replace

    bands = replace(capture.bands["white"], crossed=None), crossed
    colours = ("red", "green", "blue")
    if not all(has_colour(one) for one in bands):
        return {}
    parallel, across = (
        linear_channels(one, capture.encoding, colours, None, binning)[..., inside].mean(axis=1) for one in bands
    )
    kept = [float(np.median(parallel[c] - across[c])) for c in range(3)]
    scattered = [float(np.median(across[c])) for c in range(3)]
    share = np.log(max(kept[1] / scattered[1], 1e-3))
    return {"polarised_share": float(share), "polarised_red": float(np.log(max(kept[0], 1e-9) / max(kept[2], 1e-9)))}
