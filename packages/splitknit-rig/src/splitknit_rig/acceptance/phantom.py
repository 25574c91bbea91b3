"""The phantom as drawn: half a finger with ridges of known height, period and direction."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from splitknit import BadInput, Reconstruction
from splitknit.accuracy import BAND_SIGMA_MM, eroded, high_passed
from splitknit.errors import require
from splitknit.imaging.geometry import height_gradients, normals_from_gradients
from splitknit.model import Array, BoolArray, FloatArray
from splitknit_rig.acceptance.parameters import EDGE_MM, MAX_TURN_DEG, MIN_LIKENESS, REACH_MM

PITCH_MM = 0.05
"""Of the drawing. Source: this drawing."""
PLATE_MM = (20.0, 34.0)
"""Sides of the plate that carries the half cylinder.

Source: this drawing.
"""
RADIUS_MM = 8.5
"""Radius of the half cylinder.

Source: this drawing.
"""
STEEPEST_DEG = 62.0
"""Steepest slope of the half cylinder's skirts.

Source: this drawing.
"""
ENDS_MM = (-14.5, 6.0)
"""Where the half cylinder begins, and where its round tip starts.

Source: this drawing.
"""
HEIGHTS_UM = (25.0, 50.0, 75.0, 100.0)
"""Heights of ridges from valley to top, a row of fields each.

Source: this drawing.
"""
PERIODS_MM = (0.35, 0.45, 0.6)
"""Ridge periods of the fields, in turn.

Source: this drawing.
"""
TURNS_DEG = (0.0, 60.0, 120.0)
"""Directions across the ridges of the fields, in turn.

Source: this drawing.
"""
FIELD_MM = 4.6
"""Side of a field of ridges, along the skin.

Source: this drawing.
"""
FIELD_SPACING_MM = 5.2
"""From the middle of a field to that of the next, along the skin.

Source: this drawing.
"""
FIELDS_END_MM = ENDS_MM[0] + 3.0 + 3 * FIELD_SPACING_MM + FIELD_MM / 2
"""Where the fields end, towards the tip. Source: this drawing."""
MARKS_MM = ((-3.5, 9.0), (0.6, 9.4), (3.0, 8.6), (-0.6, 10.8))
"""Across and along the skin: domes of 0.15 mm that no turn takes to each other.

Source: this drawing.
"""


def phantom() -> tuple[Reconstruction, list[dict[str, Any]]]:
    """The phantom's surface as drawn, as a result, and its fields of ridges: ``middle_mm`` across
    and along the skin, ``height_um``, ``period_mm``, ``turn_deg``.
    """
    columns, rows = (round(side / PITCH_MM) + 1 for side in PLATE_MM)
    x = (np.arange(columns) - (columns - 1) / 2) * PITCH_MM
    y = (((rows - 1) / 2 - np.arange(rows)) * PITCH_MM)[:, None]
    beside = np.hypot(x, np.maximum(y - ENDS_MM[1], 0.0))
    steep = np.deg2rad(STEEPEST_DEG)
    mask = (beside < RADIUS_MM * np.sin(steep)) & (y > ENDS_MM[0])
    top = np.sqrt(np.maximum(RADIUS_MM**2 - beside**2, 0.0))
    shape = np.where(mask, top - RADIUS_MM * np.cos(steep), 0.0)
    across = RADIUS_MM * np.arcsin(np.clip(x / RADIUS_MM, -1.0, 1.0))
    along = y
    relief: Array = np.zeros(shape.shape)
    fields = []
    for row, high in enumerate(HEIGHTS_UM):
        for column in range(3):
            middle = FIELD_SPACING_MM * (column - 1), ENDS_MM[0] + 3.0 + FIELD_SPACING_MM * row
            period, turn = PERIODS_MM[(row + column) % 3], TURNS_DEG[(row + 2 * column) % 3]
            u, v = across - middle[0], along - middle[1]
            phase = (
                2.0 * np.pi / period * (np.cos(np.deg2rad(turn)) * u + np.sin(np.deg2rad(turn)) * v)
            )
            edge = np.clip((0.5 * FIELD_MM - np.maximum(np.abs(u), np.abs(v))) / 0.4, 0.0, 1.0)
            relief += 1e-3 * high * edge * edge * (3.0 - 2.0 * edge) * (0.5 - 0.5 * np.cos(phase))
            fields.append(
                {"middle_mm": middle, "height_um": high, "period_mm": period, "turn_deg": turn}
            )
    for right, high in MARKS_MM:
        relief += 0.15 * np.clip(
            1.0 - ((across - right) ** 2 + (along - high) ** 2) / 0.36, 0.0, 1.0
        )
    drawn = np.where(mask, shape + relief * RADIUS_MM / np.maximum(top, 1e-3), 0.0)
    height: FloatArray = drawn.astype(np.float32)
    seen = np.where(mask, 1.0, np.nan).astype(np.float32)
    smooth: FloatArray = (shape * seen).astype(np.float32)
    result = Reconstruction(
        height * seen,
        height * seen - smooth,
        smooth,
        mask,
        normals_from_gradients(*height_gradients(height, PITCH_MM)),
        seen,
        PITCH_MM,
        np.eye(3),
        mask.shape,
        "phantom",
        facts={"material": "opaque"},
    )
    return result, fields


_UNSEEN = "the phantom's ridges are not seen; lay it tip up on dark ground, in focus."


def ridge_heights(result: Reconstruction) -> tuple[float, float]:
    """Height of the phantom's ridges over the drawn one (least squares), and the correlation of
    both, the measured phantom laid on the drawing.

    Raises BadInput where its ridges are not seen.
    """
    drawn, _ = phantom()
    seen = _on_grid(result)
    template = _relief(drawn.height_mm, drawn.mask)
    size = np.array(template.shape[::-1]) + 2 * round(REACH_MM / PITCH_MM)
    middle = (np.array(seen.shape[::-1]) - 1.0) / 2
    centring = (size - 1.0) / 2 - middle
    best = -1.0
    for turn in np.arange(-MAX_TURN_DEG, MAX_TURN_DEG + 0.5, 1.0):
        ahead = np.asarray(cv2.getRotationMatrix2D(middle.tolist(), turn, 1.0), dtype=np.float64)
        ahead[:, 2] += centring
        turned = cv2.warpAffine(seen, ahead, size.tolist())
        alike = cv2.matchTemplate(turned, template, cv2.TM_CCORR_NORMED)
        _, value, _, corner = cv2.minMaxLoc(alike)
        if value > best:
            ahead[:, 2] -= corner
            best, start = value, cv2.invertAffineTransform(ahead)
    inside = (seen != 0.0).astype(np.uint8)
    steps = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-6)
    try:
        _, place = cv2.findTransformECC(
            template, seen, start.astype(np.float32), cv2.MOTION_AFFINE, steps, inside, 1
        )
    except cv2.error as error:
        raise BadInput(_UNSEEN) from error
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    measured = cv2.warpAffine(seen, place, template.shape[::-1], flags=flags)
    both = (measured != 0.0) & (template != 0.0)
    both[: round((PLATE_MM[1] / 2 - FIELDS_END_MM) / PITCH_MM)] = False  # the marks
    require(both.any(), _UNSEEN)
    likeness = float(np.corrcoef(measured[both], template[both])[0, 1])
    require(likeness > MIN_LIKENESS, _UNSEEN)
    return float(measured[both] @ template[both] / (template[both] @ template[both])), likeness


def _relief(height_mm: FloatArray, mask: BoolArray) -> FloatArray:
    """The ridge band, zero beside the phantom and at its edge."""
    relief = high_passed(np.nan_to_num(height_mm), mask, BAND_SIGMA_MM / PITCH_MM)
    return np.where(eroded(mask, EDGE_MM / PITCH_MM), relief, 0.0).astype(np.float32)


def _on_grid(result: Reconstruction) -> FloatArray:
    """Relief on the drawing's grid, about the middle of the picture."""
    rows, columns = result.mask.shape
    known = result.mask & np.isfinite(result.height_mm)
    size = [round(length * result.pitch_mm / PITCH_MM) + 1 for length in (rows, columns)]
    y, x = ((np.arange(n) - (n - 1) / 2) * PITCH_MM for n in size)
    x, y = np.broadcast_arrays(x[None, :], -y[:, None])
    ahead = x / result.pitch_mm + (columns - 1) / 2, (rows - 1) / 2 - y / result.pitch_mm
    column, row = (axis.astype(np.float32) for axis in ahead)
    if result.x_mm is not None and result.y_mm is not None:  # perspective
        plane, at = (column, row), np.indices(known.shape)
        points = (
            result.x_mm / result.pitch_mm + (columns - 1) / 2,
            (rows - 1) / 2 - result.y_mm / result.pitch_mm,
        )
        beside = [
            np.where(known, point - pixel, 0.0).astype(np.float32)
            for point, pixel in zip(points, at[::-1], strict=True)
        ]
        for _ in range(4):  # a contraction, by the depth over the distance
            column, row = (
                line - cv2.remap(shift, column, row, cv2.INTER_LINEAR)
                for line, shift in zip(plane, beside, strict=True)
            )
    height = np.where(known, result.height_mm, 0.0).astype(np.float32)
    mask = cv2.remap(known.astype(np.float32), column, row, cv2.INTER_LINEAR) > 0.999
    height = np.asarray(cv2.remap(height, column, row, cv2.INTER_CUBIC), dtype=np.float32)
    return _relief(height, mask)
