"""The phantom as drawn: half a finger with ridges of known height, period and direction."""

from __future__ import annotations

from typing import Any

import numpy as np

from splitknit import Reconstruction
from splitknit.imaging.geometry import height_gradients, normals_from_gradients
from splitknit.model import Array, FloatArray

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
