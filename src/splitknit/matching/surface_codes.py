"""Finger surface codes of reconstructions."""

from __future__ import annotations

import cv2
import numpy as np

from splitknit.imaging.geometry import smoothed
from splitknit.matching.surface_code import (
    CODE_PITCH_MM,
    CODE_SMOOTH_MM,
    CODE_WINDOW_MM,
    SurfaceCode,
    SurfaceCodeSettings,
    make_surface_code,
)
from splitknit.model import Surface
from splitknit.prints.curvature import REFERENCE_PX_PER_MM, CurvatureSettings, curvature


def surface_code(surface: Surface, settings: SurfaceCodeSettings | None = None) -> SurfaceCode:
    """Code of a reconstruction: the shape index of its smoothed surface, on an upright grid about its middle."""
    settings = settings or SurfaceCodeSettings()
    pitch = surface.pitch_mm
    height = smoothed(surface.shape_mm + surface.ridge_mm, surface.mask, CODE_SMOOTH_MM / pitch)
    fits = CurvatureSettings(window_px=CODE_WINDOW_MM * REFERENCE_PX_PER_MM)
    index = curvature(height, surface.mask, pitch, fits).shape_index
    step = CODE_PITCH_MM / pitch
    rows, columns = (max(1, round(side / step)) for side in surface.upright_size)
    input_from_grid = surface.input_from_upright @ np.array(
        [
            [step, 0.0, (surface.upright_size[1] - 1) / 2 - step * (columns - 1) / 2],
            [0.0, step, (surface.upright_size[0] - 1) / 2 - step * (rows - 1) / 2],
            [0.0, 0.0, 1.0],
        ]
    )
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    there = cv2.warpAffine(index, input_from_grid[:2], (columns, rows), flags=flags, borderValue=float("nan"))
    return make_surface_code(np.asarray(there, dtype=np.float32), np.isfinite(there), settings)
