"""Presentation attack detection: what of a capture and its result differs between skin and copies, and a probability.

Terms and rates: ISO/IEC 30107-3; what the shipped model was fitted to, and its rates: ``docs/experiments/pad.md``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib import resources
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, require
from splitknit.imaging.band import has_colour, linear_channels
from splitknit.imaging.geometry import smoothed
from splitknit.model import Band, BoolArray, Capture, FloatArray, Reconstruction, vector_at_origin

BASIS = "the model was fitted to simulated attacks only; nobody has measured it on real ones."
PX_PER_MM = 15.0  # at which photographs and results are measured
_FACING = 0.8  # cosine between the surface without ridges and the view: flanks are left out
_SLOW_MM, _FINE_MM = 0.35, 0.06  # standard deviations of the Gaussians around the band of ridges
_COLOURS = ("red", "green", "blue")


@dataclass(frozen=True, slots=True, eq=False)
class PadImages:
    """What of a capture's images is measured, at `PX_PER_MM` or as coarse as the capture is."""

    binning: float
    light: Mapping[str, FloatArray]  # (L, h, w) linear, above zero: red, green, blue (or grey), nir
    vectors: Mapping[str, NDArray[np.float64]]  # (L, 3) light on the origin in the images of each
    exposed: bool  # whether exposures are stated, so that bands compare
    polarised: Sequence[FloatArray]  # (3, h, w) mean of the parallel and of the crossed images, or nothing


def is_judged(capture: Capture) -> bool:
    """Whether a capture has what the shipped model was fitted to: skin in white colours and near infrared."""
    white, camera = capture.bands["white"], capture.rig.camera
    fine = camera.scale_known and camera.px_per_mm > 0.95 * PX_PER_MM and has_colour(white) and not white.colours
    return fine and capture.material == "skin" and "nir" in capture.bands


def pad_images(capture: Capture) -> PadImages:
    """Bring a capture's images to the features' pixels."""
    binning = max(round(8 * capture.rig.camera.px_per_mm / PX_PER_MM) / 8, 1.0)
    white, nir, crossed = (capture.bands.get(name) for name in ("white", "nir", "white_crossed"))
    assert white is not None
    colours = _COLOURS if has_colour(white) and not white.colours else ("grey",)
    light = dict(zip(colours, linear_channels(white, capture.encoding, colours, None, binning), strict=True))
    vectors = dict.fromkeys(colours, _vectors(capture, white))
    if nir is not None:
        light["nir"] = linear_channels(nir, capture.encoding, ("grey",), None, binning)[0]
        vectors["nir"] = _vectors(capture, nir)
    series = () if crossed is None or colours != _COLOURS else (replace(white, crossed=None), crossed)
    polarised = [linear_channels(one, capture.encoding, colours, None, binning).mean(axis=1) for one in series]
    exposed = any(bool((band.exposure != 1.0).any()) for band in capture.bands.values())
    lit = {name: np.maximum(one, 1e-6 * float(one.max()) + 1e-12) for name, one in light.items()}
    return PadImages(binning, lit, vectors, exposed, polarised)


def pad_features(seen: PadImages, result: Reconstruction) -> dict[str, float]:
    """What differs between skin and copies, by name; what the capture has no part for is left out.

    ``relief_*`` of the result, ``shape_*`` (1/mm), ``colour_*`` (ratios of diffuse light), ``spread_*`` (contrast of
    ridges by colour), ``gloss_*`` and ``polarised_*`` (logarithms), ``motion_um``. Raises BadInput if the result has no
    scale, or shows too little.
    """
    shape, relief, mask = _coarse(result, seen.binning)
    pitch = result.pitch_mm * seen.binning
    inside = _facing(shape, mask, pitch)
    require(
        result.scale_known and int(inside.sum()) >= 100,
        "presentation attacks show in results with a known scale and at least some mm² of a finger.",
    )
    found = _of_relief(relief, inside, pitch) | _of_shape(shape, inside, pitch)
    found |= _of_colour(seen, inside) | _of_spread(seen.light, inside, pitch)
    for name, band in (("grey", "white"), ("green", "white"), ("nir", "nir")):
        if name in seen.light:
            found |= _of_gloss(band, seen.light[name], inside, seen.vectors[name])
    if seen.polarised:
        found |= _of_films(*(one[:, inside] for one in seen.polarised))
    if moved := dict(result.quality.get("white", {})).get("motion_mm"):
        found["motion_um"] = 1000 * float(np.median(moved))
    return {name: value for name, value in found.items() if np.isfinite(value)}


def _coarse(result: Reconstruction, binning: float) -> tuple[NDArray[Any], NDArray[Any], BoolArray]:
    """Shape (mm), relief (um) and mask on the features' pixels."""
    size = tuple(int(n // binning) for n in result.mask.shape[::-1])
    whole = result.mask & np.isfinite(result.height_mm)

    def mean(field: NDArray[Any]) -> NDArray[Any]:
        return cv2.resize(field.astype(np.float32), size, interpolation=cv2.INTER_AREA)

    weight = np.maximum(mean(whole), 1e-3)
    shape, relief = (mean(np.where(whole, np.nan_to_num(one), 0)) for one in (result.shape_mm, result.ridge_mm))
    return shape / weight, 1000 * relief / weight, weight > 0.99


def _facing(shape: FloatArray, mask: BoolArray, pitch: float) -> BoolArray:
    """Where the surface faces the camera, 1 mm from its outline."""
    slow = smoothed(shape, mask, 0.5 / pitch)
    down, right = np.gradient(slow, pitch)
    outline = np.pad(mask, 1).astype(np.uint8)
    far = cv2.distanceTransform(outline, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1] * pitch > 1.0
    facing = far & (1 / np.sqrt(1 + down**2 + right**2) > _FACING)
    return np.asarray(facing if facing.sum() * pitch**2 > 20.0 else far)


def _band_of(image: FloatArray, inside: BoolArray, pitch: float) -> FloatArray:
    """The band of ridges of an image, robustly limited."""
    fine = smoothed(image, inside, _FINE_MM / pitch)
    band = np.where(inside, fine - smoothed(image, inside, _SLOW_MM / pitch), 0)
    limit = 6.0 * float(np.median(np.abs(band[inside]))) + 1e-12
    return np.asarray(np.clip(band, -limit, limit), dtype=np.float32)


def _of_relief(relief: FloatArray, inside: BoolArray, pitch: float) -> dict[str, float]:
    band = _band_of(relief, inside, pitch)
    rest = (relief - smoothed(relief, inside, 0.1 / pitch))[inside]
    right, down = (cv2.Sobel(band, cv2.CV_32F, *axes) for axes in ((1, 0), (0, 1)))
    xx, yy, xy = (smoothed(one, inside, 0.5 / pitch) for one in (right * right, down * down, right * down))
    coherence = np.hypot(xx - yy, 2 * xy) / np.maximum(xx + yy, 1e-12)
    deviation = float(band[inside].std()) + 1e-3
    return {
        "relief_rms": float(np.log(deviation)),
        "relief_fine": float(np.log(rest.std() / deviation + 1e-3)),
        "relief_skew": float(np.mean((band[inside] / deviation) ** 3)),
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


def _of_colour(seen: PadImages, inside: BoolArray) -> dict[str, float]:
    """Medians over the lights leave reflections out."""
    level = {name: np.log(np.median(one[:, inside], axis=0)) for name, one in seen.light.items()}
    if "green" not in level:
        return {}
    found = {f"colour_{one}": float(np.median(level[one] - level["green"])) for one in ("red", "blue")}
    if "nir" in level and seen.exposed:
        here, there = (np.median(seen.vectors[name][:, 2]) for name in ("nir", "red"))
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
    bright = np.max(images, axis=0) / np.maximum(np.median(images, axis=0), 1e-9)
    return {
        f"gloss_rest_{name}": float(np.log(np.sqrt(np.mean(rest**2)) / np.mean(images) + 1e-4)),
        f"gloss_{name}": float(np.log(np.median(bright))),
        f"gloss_tail_{name}": float(np.log(np.percentile(bright, 99.5) / np.median(bright))),
    }


def _of_films(parallel: FloatArray, crossed: FloatArray) -> dict[str, float]:
    """Light (3, n) that kept its polarisation: the surface's, and light scattered once, of which red has most."""
    kept = np.maximum(np.median(parallel - crossed, axis=1), 1e-9)
    share = np.log(max(kept[1] / np.median(crossed[1]), 1e-3))
    return {"polarised_share": float(share), "polarised_red": float(np.log(kept[0] / kept[2]))}


# The model: how far each group of features lies from live skin's, and a logistic regression on these distances.

Model = Mapping[str, Any]
"""``names``, ``mean`` and ``covariance`` of live skin's features; ``groups``: names of theirs; ``usual``: live skin's
mean distance by group; ``weights`` of the distances, none negative; ``offset``; ``threshold`` of the probability."""


@lru_cache(maxsize=1)
def shipped_model() -> Model:
    """Return the shipped model."""
    return dict(json.loads(resources.files("splitknit").joinpath("pad_model.json").read_bytes()))


def distances(model: Model, found: Mapping[str, float]) -> dict[str, float]:
    """Logarithm of one plus the mean squared distance to live skin (Mahalanobis 1936), by group, of what is there."""
    covariance, result = np.array(model["covariance"]), {}
    for group, names in model["groups"].items():
        there = [name for name in names if name in found]
        if there:
            at = [model["names"].index(name) for name in there]
            away = np.array([found[name] - model["mean"][k] for k, name in zip(at, there, strict=True)])
            squared = float(away @ np.linalg.solve(covariance[np.ix_(at, at)], away))
            result[group] = float(np.log1p(squared / len(there)))
    return result


@dataclass(frozen=True, slots=True)
class Presentation:
    """What was decided of one capture."""

    probability: float  # of live skin, if attacks were as frequent as it
    live: bool  # at least the threshold
    threshold: float
    suspicion: dict[str, float]  # by group of features: what it takes from the log odds, 0 = usual live skin


def judge(found: Mapping[str, float], model: Model | None = None) -> Presentation:
    """Probability that :func:`pad_features` are those of live skin, by the shipped model or by another one.

    Examples
    --------
    >>> judge(dict(zip(shipped_model()["names"], shipped_model()["mean"], strict=True))).live
    True
    """
    model = model or shipped_model()
    away = distances(model, found)
    suspicion = {name: model["weights"][name] * (far - model["usual"][name]) for name, far in away.items()}
    odds = model["offset"] - sum(suspicion.values())
    probability = float(1 / (1 + np.exp(-np.clip(odds, -60, 60))))
    return Presentation(probability, probability >= model["threshold"], model["threshold"], suspicion)


def with_probability(result: Reconstruction, seen: PadImages | None) -> Reconstruction:
    """Add the probability of live skin to a result's facts, where there is one."""
    try:
        found = {} if seen is None else {"live_probability": round(judge(pad_features(seen, result)).probability, 4)}
    except BadInput:  # too little of it
        found = {}
    return replace(result, facts={**result.facts, **found})
