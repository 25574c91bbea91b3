"""Whether the finger moved between the shots. Measured and warned of; :mod:`.registration` undoes
it.

On copies of at most 10 px/mm, coarser for the coarse bands. Shots differ in illumination, and a
moving light looks like a moving finger: a ridge lit from the left seems shifted against the same
ridge lit from the right by up to a tenth of a millimetre. That apparent shift follows the light's
direction, so it is fitted and taken off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

import cv2
import numpy as np

from splitknit.findings import Finding, escaped
from splitknit.finger.regions import blur, dilate, quantile, reduce_image, reduce_mask, reduction
from splitknit.finger.registration import BAND_RATIO, SURROUND_MM
from splitknit.imaging.geometry import bounding_box
from splitknit.imaging.robust import deviation, huber
from splitknit.model import Array, BoolArray, FloatArray
from splitknit.settings import Checked, Limits


@dataclass(frozen=True, slots=True)
class MotionSettings(Checked):
    """How motion between shots is measured, and undone."""

    correct: Literal["auto", "on", "off"] = "auto"
    """``auto``: motion of skin above 0.02 mm is undone; ``on``: any motion is; ``off``: motion only
    gives a warning."""
    most_mm: Annotated[float, Limits(0, above=True)] = 0.8
    """More motion is refused, because ridges may be mistaken for their neighbours."""


class _ShotMotion(NamedTuple):
    shift_mm: Array
    """(L, 2): x right, y up."""
    reliability: Array
    """(L,) in [0, 1]: correlation of the shot's details with those of the other shots, after
    alignment."""


_MOTION_BANDS_MM = (0.3, 0.15, 0.08)
"""Fine ends (sigma) of the band-pass filters, coarse to fine; a finger may move by about twice the
first. Chosen on: judgement. Range: 1 to 2 times these values (validation/parameters)."""
MOTION_PX_PER_MM = 10.0
"""Scale of the copies that are compared in the finest band. Chosen on: speed."""


def shot_motion(stack: FloatArray, mask: BoolArray, px_per_mm: float) -> _ShotMotion:
    """By how much the finger shifted in each shot of `stack` (L, H, W), linear, against the others.
    Each shot, over its local brightness and band-passed, is registered to the others' mean
    (Lucas-Kanade with a gain, robustly weighted), coarse to fine; what of the shifts is a linear
    function of the light's centroid is illumination, the rest motion. All is zero below five shots,
    and a drift that follows the lights around is underestimated. Source: Lucas, B. and Kanade, T.,
    "An iterative image registration technique", IJCAI 1981.
    """
    box = bounding_box(
        mask, int((2.0 * SURROUND_MM + 2.0 * BAND_RATIO * _MOTION_BANDS_MM[0]) * px_per_mm)
    )
    count = len(stack)
    if count < 5:
        return _ShotMotion(np.zeros((count, 2)), np.zeros(count))
    scale = reduction(mask[box].shape, px_per_mm, MOTION_PX_PER_MM, 600)
    stack = np.stack([reduce_image(image[box], scale) for image in stack])
    mask = _reduced(mask[box], scale)
    px_per_mm = px_per_mm * scale
    shifts = np.zeros((count, 2))  # columns, rows; mm
    agreement = np.zeros(count)
    for band in _MOTION_BANDS_MM:
        bands, region, light, px = _details(stack, mask, px_per_mm, band)
        aligned = np.stack(
            [_shifted(image, shift * px) for image, shift in zip(bands, shifts, strict=True)]
        )
        total = aligned.sum(axis=0)
        shifts_px = np.zeros_like(shifts)
        for k in range(count):
            reference = np.subtract(total, aligned[k]) / (count - 1)
            shifts_px[k], agreement[k] = _register(reference, bands[k], shifts[k] * px, region)
        shifts = _without_illumination(shifts_px / px, light)
    return _ShotMotion(shifts * np.array([1.0, -1.0]), np.clip(agreement, 0.0, 1.0))


WARN_MM = 0.05
"""Motion above this is reported: a ninth of a ridge period blurs the combined relief visibly."""
MIN_RELIABILITY = 0.8
"""Motion of a shot with less reliability than this is ignored, in correlation. Chosen on:
judgement. Range: 0.4 to 0.8 (validation/parameters)."""


def motion_findings(motion: _ShotMotion, names: Sequence[str] = ()) -> tuple[Finding, ...]:
    """A finding of shots in which the finger moved by more than `WARN_MM`; `names`: of the
    photographs' files."""
    length = np.hypot(motion.shift_mm[:, 0], motion.shift_mm[:, 1])
    moved = np.flatnonzero((length > WARN_MM) & (motion.reliability >= MIN_RELIABILITY))
    if len(moved) == 0:
        return ()
    files = tuple(names[int(k)] if names else f"image {k}" for k in moved)
    which = ", ".join(f"{escaped(file)} by {{:.2f mm}}" for file in files)
    return (
        Finding(
            "moved-finger",
            f"the finger moved between the shots ({which}): the relief is blurred there; rest the"
            " finger on its support and capture again.",
            files=files,
            lengths_mm=tuple(length[moved].tolist()),
        ),
    )


def _reduced(mask: BoolArray, scale: float) -> BoolArray:
    fraction = reduce_mask(mask, scale)
    return fraction > 0.5 if (fraction > 0.5).any() else fraction > 0.0


def _details(
    stack: FloatArray, mask: BoolArray, px_per_mm: float, band_mm: float
) -> tuple[FloatArray, BoolArray, Array, float]:
    """Band-passed copies (L, h, w), pixels used, where the light falls in each (L, 2), and their
    scale."""
    scale = min(1.0, 0.8 / band_mm / px_per_mm)
    px = px_per_mm * scale
    inside = _reduced(mask, scale)
    region = dilate(inside, SURROUND_MM * px)
    reach = BAND_RATIO * band_mm
    box = bounding_box(dilate(region, 2.0 * reach * px))
    rim = max(2, round(reach * px))
    framed = np.zeros_like(region)
    framed[rim:-rim, rim:-rim] = region[rim:-rim, rim:-rim]
    region = (framed if framed.any() else inside)[box]
    inside = inside[box]
    places = np.argwhere(inside)[:, ::-1]
    details = []
    light = []
    for image in stack:
        small = reduce_image(image, scale)[box]
        on_finger = np.maximum(small[inside], 0.0)
        light.append(on_finger @ places / max(float(on_finger.sum()), 1e-12))
        floor = max(0.1 * quantile(on_finger[::8]), 1e-12)
        local = np.maximum(blur(small, 1.2 * px), floor)
        relative: FloatArray = np.divide(small, local, dtype=np.float32)
        details.append(np.subtract(blur(relative, band_mm * px), blur(relative, reach * px)))
    return np.stack(details), region, np.array(light) / px, px


def _shifted(image: FloatArray, shift: Array) -> FloatArray:
    """The image with a shift of (columns, rows) undone: cubic interpolation, between pixels at any
    place."""
    across, down = (_cubic(float(along)) for along in shift)
    return np.asarray(
        cv2.sepFilter2D(image, cv2.CV_32F, across, down, borderType=cv2.BORDER_REPLICATE)
    )


def _cubic(shift: float) -> Array:
    """Weights of the pixels around one for the value at a distance of `shift`; Keys' kernel with a
    = -0.75."""
    reach = int(np.ceil(abs(shift))) + 1
    away = np.abs(np.arange(-reach, reach + 1) - shift)
    near = (1.25 * away - 2.25) * away * away + 1.0
    far = ((-0.75 * away + 3.75) * away - 6.0) * away + 3.0
    return np.where(away < 1.0, near, np.where(away < 2.0, far, 0.0))


def _register(
    reference: FloatArray, image: FloatArray, start: Array, region: BoolArray
) -> tuple[Array, float]:
    """Shift of `image` against `reference` (columns, rows; pixels), and their correlation when
    aligned."""
    places = np.flatnonzero(region)
    # pixels that are compared in each band, at least, of those on the finger and around it
    places = places[:: max(1, len(places) // 20_000)]
    every = max(1, len(places) // 4_000)  # a median needs no more
    down, right = np.gradient(reference)
    terms = np.stack([each.ravel()[places] for each in (-right, -down, reference)])
    shift = start
    weights = np.ones_like(terms[0])
    for _ in range(6):
        values = _shifted(image, shift).ravel()[places]
        for _ in range(2):
            weighted = terms * weights
            solution = np.linalg.lstsq(weighted @ terms.T, weighted @ values, rcond=None)[0]
            residual = values - solution @ terms
            weights = huber(residual, 1.5 * max(deviation(residual[::every]), 1e-12))
        step = np.clip(solution[:2] / max(float(solution[2]), 0.3), -1.5, 1.5)
        shift = shift + step
        if np.abs(step).max() < 0.01:
            break
    both = np.stack([terms[2], values])
    products = both * weights @ both.T
    return shift, float(products[0, 1] / np.sqrt(max(products[0, 0] * products[1, 1], 1e-30)))


def _without_illumination(shifts: Array, light: Array) -> Array:
    """What of the shifts (L, 2) is not a linear function of the light's place (L, 2): least
    absolute deviations."""
    place = light - light.mean(axis=0)
    place = place / max(float(np.abs(place).max()), 1e-9)
    design = np.column_stack([place, np.ones(len(place))])
    root = np.ones((len(place), 1))
    residual = shifts
    for _ in range(30):
        residual = shifts - design @ np.linalg.lstsq(design * root, shifts * root, rcond=None)[0]
        root = 1.0 / np.sqrt(np.maximum(np.linalg.norm(residual, axis=1, keepdims=True), 1e-3))
    return residual
