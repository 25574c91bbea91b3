"""Presentation attack detection: was live skin photographed, or a copy, or is that unknown? `python
validation/pad/detector.py CAPTURE`.

What of a capture and its result differs between skin and copies, and an answer. Terms and rates:
ISO/IEC 30107-3; what the model was fitted to, and its rates: ``docs/experiments/pad.md``.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit import read_capture, reconstruct
from splitknit.capture import Capture
from splitknit.errors import BadExposure, BadInput, require
from splitknit.imaging.geometry import eroded, smoothed
from splitknit.model import Array, BoolArray, FloatArray
from splitknit.observation.observe import observe
from splitknit.reconstruction import Reconstruction

MODEL = Path(__file__).with_name("model.json")
_PX_PER_MM = 15.0
"""Scale at which photographs and results are measured."""


@dataclass(frozen=True, slots=True, eq=False)
class PadImages:
    """What of a capture's images is measured, at `_PX_PER_MM` or as coarse as the capture is."""

    binning: float
    # (L, h, w) linear, above zero: white (luma, which JPEG keeps), nir
    light: Mapping[str, FloatArray]


def not_covered(capture: Capture) -> str:
    """Why the model, which was fitted to fine captures of skin in white and near infrared,
    says nothing."""
    camera = capture.rig.camera
    if not camera.scale_known:
        return "its scale is not known"
    if camera.px_per_mm <= 0.95 * _PX_PER_MM:
        return f"it has less than {0.95 * _PX_PER_MM:.0f} pixels a millimetre"
    if capture.material != "skin":
        return "it is not of skin"
    return "" if "nir" in capture.bands else "it has no near-infrared images"


def pad_images(capture: Capture) -> PadImages:
    """Bring a capture's images to the features' pixels."""
    binning = min(
        max(round(8 * capture.rig.camera.px_per_mm / _PX_PER_MM) / 8, 1.0), *capture.shape
    )
    observation = observe(capture)
    light = {}
    for name in ("white", "nir"):
        if name in observation.bands:
            stack = observation.bands[name].at(binning).grey
            light[name] = np.maximum(stack, 1e-6 * float(stack.max()) + 1e-12)
    return PadImages(binning, light)


def pad_features(images: PadImages, result: Reconstruction) -> dict[str, float]:
    """What differs between skin and copies, by name, as far as the capture has it: ``relief_*``,
    ``shape_*`` (1/mm), ``spread_*`` (logarithms of ratios of ridge contrast: fixed to turning with
    the light, near infrared to white); none depends on brightness, colour or file. BadInput if the
    result has no scale, or shows too little.
    """
    shape, relief, mask = _coarse(result, images.binning)
    pitch = result.pitch_mm * images.binning
    inside = _facing(shape, mask, pitch)
    require(
        result.scale_known and int(inside.sum()) >= 100,
        "presentation attacks show in results with a known scale and at least some mm² of a"
        " finger.",
    )
    features = _of_relief(relief, inside, pitch) | _of_shape(shape, inside, pitch)
    features |= _of_spread(images.light, inside, pitch)
    return {name: value for name, value in features.items() if np.isfinite(value)}


def _coarse(result: Reconstruction, binning: float) -> tuple[NDArray[Any], NDArray[Any], BoolArray]:
    """Shape (mm), relief (um) and mask on the features' pixels."""
    size = tuple(int(n // binning) for n in result.mask.shape[::-1])
    known = result.mask & np.isfinite(result.height_mm)

    def mean(field: NDArray[Any]) -> NDArray[Any]:
        inside = np.where(known, np.nan_to_num(field), 0).astype(np.float32)
        return cv2.resize(inside, size, interpolation=cv2.INTER_AREA)

    weight = np.maximum(mean(known), 1e-3)
    return mean(result.shape_mm) / weight, 1000 * mean(result.ridge_mm) / weight, weight > 0.99


def _facing(shape: FloatArray, mask: BoolArray, pitch: float) -> BoolArray:
    """Where the surface faces the camera, 1 mm from its outline."""
    slow = smoothed(shape, mask, 0.5 / pitch)
    down, right = np.gradient(slow, pitch)
    far = eroded(mask, 1.0 / pitch)
    facing = far & (1 / np.sqrt(1 + down**2 + right**2) > 0.8)  # cosine to the view: no flanks
    return facing if facing.sum() * pitch**2 > 20.0 else far


def _band_of(image: FloatArray, inside: BoolArray, pitch: float) -> FloatArray:
    """The band of ridges of an image, between Gaussians of 0.06 and 0.35 mm, robustly limited."""
    fine = smoothed(image, inside, 0.06 / pitch)
    band = np.where(inside, fine - smoothed(image, inside, 0.35 / pitch), 0)
    limit = 6.0 * float(np.median(np.abs(band[inside]))) + 1e-12
    return np.clip(band, -limit, limit)


def _of_relief(relief: FloatArray, inside: BoolArray, pitch: float) -> dict[str, float]:
    band = _band_of(relief, inside, pitch)
    right = cv2.Sobel(band, cv2.CV_32F, 1, 0)
    down = cv2.Sobel(band, cv2.CV_32F, 0, 1)
    products = (right * right, down * down, right * down)
    xx, yy, xy = (smoothed(product, inside, 0.5 / pitch) for product in products)
    coherence = np.hypot(xx - yy, 2 * xy) / np.maximum(xx + yy, 1e-12)
    return {
        "relief_rms": float(np.log(float(band[inside].std()) + 1e-3)),
        "relief_coherence": float(np.mean(coherence[inside])),
    }


def _of_shape(shape: FloatArray, inside: BoolArray, pitch: float) -> dict[str, float]:
    rows, columns = np.nonzero(inside)
    x = (columns - columns.mean()) * pitch
    y = (rows - rows.mean()) * pitch
    basis = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    values = shape[inside].astype(np.float64)
    fit = np.linalg.lstsq(basis, values, rcond=None)[0]
    bends = np.linalg.eigvalsh([[2 * fit[3], fit[4]], [fit[4], 2 * fit[5]]])
    rest = float(np.std(values - basis @ fit))
    return {
        "shape_across": float(bends[0]),
        "shape_along": float(bends[1]),
        "shape_rest": float(np.log(rest + 1e-3)),
    }


def _of_spread(
    stacks: Mapping[str, FloatArray], inside: BoolArray, pitch: float
) -> dict[str, float]:
    """Contrast of ridges that turns with the light (relief), and that does not (pigment, print)."""
    turning = {}
    fixed = {}
    for name, stack in stacks.items():
        bands = np.stack([_band_of(np.log(image), inside, pitch)[inside] for image in stack])
        mean = bands.mean(axis=0)
        turning[name] = float(np.log(np.sqrt(np.mean((bands - mean) ** 2)) + 1e-4))
        fixed[name] = float(np.log(np.std(mean) + 1e-4))
    spread = {"spread_fixed": fixed["white"] - turning["white"]}
    if "nir" in stacks:
        spread["spread_nir"] = turning["nir"] - turning["white"]
        spread["spread_fixed_nir"] = fixed["nir"] - fixed["white"]
    return spread


# The model: how far each feature lies from live skin's, towards what copies have, and what training
# covered.

Model = Mapping[str, Any]
"""``names``; ``mean`` and ``scale`` of live skin's features; ``weights`` of deviations above and
below it, none negative; ``offset`` of the log odds; ``kinds``: mean deviations of live skin and of
each species, and ``precision``: inverse covariance about them; ``covered``: largest distance to the
nearest; ``live``, ``attack``, ``far``: log odds of live skin from which, up to which, and far from
everything up to which an answer is given."""


@lru_cache(maxsize=1)
def shipped_model() -> Model:
    """Return the model of :data:`MODEL`."""
    return dict(json.loads(MODEL.read_bytes()))


def deviations(model: Model, features: Mapping[str, float]) -> Array:
    """Features' deviations from live skin in its standard deviations; 0 on a side on which nothing
    is suspicious."""
    away = np.array([features[name] for name in model["names"]]) - model["mean"]
    above, below = np.array(model["weights"]).T
    one_sided = np.where(away > 0, above > 0, below > 0) | ((above == 0) & (below == 0))
    return np.where(one_sided, away / model["scale"], 0.0)


def suspicious(away: Array) -> Array:
    """(..., 2) what counts of deviations (...), above and below: from 0.5 up to 6.5 standard
    deviations of live skin."""
    return np.clip(np.stack([away, -away], axis=-1), 0.5, 6.5) - 0.5


def distance(model: Model, away: Array) -> float:
    """Mahalanobis distance to the nearest of live skin and the species of the training, a feature's
    mean."""
    rest = away - np.array(model["kinds"])
    squared = np.einsum("ki,ij,kj->k", rest, np.array(model["precision"]), rest)
    return float(np.sqrt(squared.min() / len(away)))


@dataclass(frozen=True, slots=True)
class Presentation:
    """What was decided of one capture."""

    answer: Literal["live", "attack", "unknown"]
    reason: str = ""  # why it is unknown
    probability: float | None = None  # of live skin, if attacks were as frequent as it
    distance: float | None = None  # to the nearest kind of the training
    covered: float | None = None  # the largest distance of what training covered
    # by group of features: what it takes from the log odds
    suspicion: Mapping[str, float] | None = None


def judge(features: Mapping[str, float], model: Model | None = None) -> Presentation:
    """Whether :func:`pad_features` are those of live skin, by the model or by another one.

    Unknown is what training did not cover, unless it is very suspicious, and what lies between live
    skin and copies.

    >>> judge(dict(zip(shipped_model()["names"], shipped_model()["mean"], strict=True))).answer
    'live'
    """
    model = model or shipped_model()
    missing = [name for name in model["names"] if name not in features]
    if missing:
        return Presentation("unknown", f"it has no {', '.join(missing)}, which the model needs.")
    away = deviations(model, features)
    far = distance(model, away)
    taken = (np.array(model["weights"]) * suspicious(away)).sum(axis=1)
    odds = model["offset"] - float(taken.sum())
    suspicion: dict[str, float] = {}
    for name, part in zip(model["names"], taken.tolist(), strict=True):
        group = name.split("_")[0]
        suspicion[group] = suspicion.get(group, 0.0) + part
    covered = model["covered"]
    answer: Literal["live", "attack", "unknown"] = "unknown"
    reason = ""
    if odds <= (model["attack"] if far <= covered else model["far"]):
        answer = "attack"
    elif far > covered:
        reason = "it is unlike everything that the model was fitted to."
    elif odds >= model["live"]:
        answer = "live"
    else:
        reason = "it lies between live skin and copies."
    return Presentation(answer, reason, float(1 / (1 + np.exp(-odds))), far, covered, suspicion)


def presentation(folder: Path, preset: str = "metric") -> Presentation:
    """Answer for a capture folder; unknown where it cannot be reconstructed. Raises BadInput if it
    is none, or damaged."""
    refused: type[BadInput] = BadExposure  # as a screen's own light has it
    try:
        capture = read_capture(folder)
        refused = BadInput  # no finger, or too little of one
        features = pad_features(pad_images(capture), reconstruct(capture, preset))
    except refused as error:
        reason = f"it cannot be reconstructed ({str(error).rstrip('.')})."
        return Presentation("unknown", reason)
    missing = not_covered(capture)
    return Presentation("unknown", f"{missing}.") if missing else judge(features)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--preset", default="metric")
    options = parser.parse_args()
    print(presentation(options.capture, options.preset))
