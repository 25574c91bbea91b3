"""What a code is made of: how ridges run and how wide they are, on a coarse grid in the finger's own frame.

The frame's origin lies in the middle of the finger at the height of its uppermost valid skin, x to the right, y down.
Both are known to some millimetres only (roll shifts ridges across, pitch along), which is why a probe is sampled in
many places and turned by several angles, and a gallery finger once.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.matching.ridge_band import blur
from splitknit.matching.template import Template
from splitknit.model import FloatArray

COLUMNS, ROWS, STEP_MM = 17, 17, 1.0
"""The grid of a code: its first row lies one step below the finger's uppermost skin."""
CELLS = COLUMNS * ROWS
CHANNELS = 3
"""Cosine and sine of twice the direction across the ridges, times coherence; log of their frequency (rad a 0.1 mm)."""
_WINDOW_MM = 0.7
_TURN_MM = 10.0
"""A probe is turned about a point so far below the origin."""
_DERIVATIVE = np.array([-1, 9, -45, 0, 45, -9, 1], dtype=np.float32) / 60
"""Central difference of the sixth order: ridges have but four pixels of the template, too few for shorter ones."""
_HERE = np.ones(1, dtype=np.float32)
_STRANGE = 0.2
"""Where the logarithm of the frequency is so far from the finger's median, a cell counts less, and at twice not."""
_REDUCED = 2
"""Pixels of the template, each way, that share a pixel of the maps."""


@dataclass(frozen=True, slots=True, eq=False)
class RidgeField:
    """Maps of one finger."""

    maps: FloatArray
    """(4, H, W): the channels, and how much of the window about each pixel is valid, 0 to 1."""
    origin_px: tuple[float, float]
    """Column and row of the frame's origin."""
    pitch_mm: float
    """Of the maps."""


def ridge_field(template: Template) -> RidgeField:
    """Directions and frequency of the ridges of a template that is not empty.

    Raises
    ------
    BadInput
        If the template is empty.

    References
    ----------
    Bigun and Granlund 1987, Optimal orientation detection of linear symmetry; Cappelli 2011, Fast and accurate
    fingerprint indexing based on ridge orientation and frequency.
    """
    require(not template.empty, "a failure to acquire has no ridges; test template.empty first.")
    pitch = template.pitch_mm
    valid = template.valid.astype(np.uint8)
    value = blur(template.value(), 0.6)
    # gradients beside the border of the valid skin are those of the border
    inside = cv2.erode(valid, np.ones((5, 5), np.uint8), borderValue=0).astype(np.float32)
    right = cv2.sepFilter2D(value, cv2.CV_32F, _DERIVATIVE, _HERE) * inside
    up = cv2.sepFilter2D(value, cv2.CV_32F, _HERE, _DERIVATIVE) * -inside
    parts = (right * right, up * up, right * up, value * value * inside, inside)
    small = max(1, valid.shape[1] // _REDUCED), max(1, valid.shape[0] // _REDUCED)
    sigma = _WINDOW_MM / (pitch * _REDUCED)
    xx, yy, xy, power, weight = (
        blur(np.asarray(cv2.resize(part, small, interpolation=cv2.INTER_AREA)), sigma) for part in parts
    )
    total = np.maximum(xx + yy, np.float32(1e-6))
    frequency = 0.5 * np.log(total / np.maximum(power, np.float32(1e-6)))
    frequency -= np.float32(np.log(pitch / 0.1))
    # creases and folds look like ridges, but for their width
    usual = float(np.median(frequency[weight > 0.5])) if bool((weight > 0.5).any()) else 0.0
    strange = np.abs(frequency - usual) / _STRANGE
    weight = weight * np.clip(2.0 - strange, 0.0, 1.0)
    maps = np.stack([(xx - yy) / total, 2 * xy / total, frequency, weight])
    column, row = origin_of(template)
    scale = small[0] / valid.shape[1], small[1] / valid.shape[0]
    origin = (column + 0.5) * scale[0] - 0.5, (row + 0.5) * scale[1] - 0.5
    return RidgeField(maps.astype(np.float32), origin, pitch * _REDUCED)


def origin_of(template: Template) -> tuple[float, float]:
    """Column of the finger's middle and row of its uppermost skin: the origin of its frame, pixels of the template."""
    valid, pitch = template.valid, template.pitch_mm
    broad = np.flatnonzero(valid.sum(axis=1) >= min(2.0 / pitch, 0.5 * valid.sum(axis=1).max()))
    top = int(broad[0])
    rows = valid[top + round(3.0 / pitch) : top + round(14.0 / pitch)]
    rows = rows[rows.any(axis=1)]
    if not len(rows):
        rows = valid[valid.any(axis=1)]
    first = rows.argmax(axis=1)
    last = rows.shape[1] - 1 - rows[:, ::-1].argmax(axis=1)
    return float(np.mean(first + last)) / 2, float(top)


def laid_on(probe: Template, other: Template, turn_rad: float, right_mm: float, down_mm: float) -> NDArray[np.float64]:
    """(2, 3) matrix from (column, row, 1) in the probe to the other template, for a variant of :func:`sampled`."""
    pitch = probe.pitch_mm
    cos, sin = np.cos(turn_rad), np.sin(turn_rad)
    turn = np.array([[cos, sin], [-sin, cos]])
    below = np.array([0.0, _TURN_MM / pitch])
    shift = np.array([right_mm, down_mm]) / pitch
    target = np.array(origin_of(other)) + below + shift
    return np.hstack([turn, (target - turn @ (np.array(origin_of(probe)) + below))[:, None]])


def sampled(
    field: RidgeField, turn_rad: NDArray[np.float64], right_mm: NDArray[np.float64], down_mm: NDArray[np.float64]
) -> tuple[FloatArray, FloatArray]:
    """Channels and weights on the grid of a code, for the finger turned and then shifted in several ways.

    Parameters
    ----------
    field : RidgeField
    turn_rad : (V,) counter-clockwise as seen
    right_mm, down_mm : (V,)

    Returns
    -------
    channels : (V, CHANNELS, CELLS) float32
    weights : (V, CELLS) float32, 0 to 1
    """
    x = (np.arange(COLUMNS) - (COLUMNS - 1) / 2) * STEP_MM
    y = (1.0 + np.arange(ROWS)) * STEP_MM
    gx = np.tile(x, ROWS)[None, :] - right_mm[:, None]
    gy = np.repeat(y, COLUMNS)[None, :] - down_mm[:, None] - _TURN_MM
    cos, sin = np.cos(turn_rad)[:, None], np.sin(turn_rad)[:, None]
    columns = field.origin_px[0] + (cos * gx - sin * gy) / field.pitch_mm
    rows = field.origin_px[1] + (sin * gx + cos * gy + _TURN_MM) / field.pitch_mm
    there = columns.astype(np.float32), rows.astype(np.float32)
    cosine, sine, frequency, weight = (
        cv2.remap(plane, *there, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0.0)
        for plane in field.maps
    )
    two_cos, two_sin = np.cos(2 * turn_rad)[:, None], np.sin(2 * turn_rad)[:, None]
    channels = np.stack([two_cos * cosine - two_sin * sine, two_sin * cosine + two_cos * sine, frequency], axis=1)
    return channels.astype(np.float32), np.clip(np.asarray(weight, dtype=np.float32), 0.0, 1.0)
