"""Features in space: minutiae of the relief's print, mapped back to the surface, and finger surface codes."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit import FloatArray, Surface, height_gradients, require, sampled_at, smoothed, surface_print
from splitknit_match.matching.minutiae_record import SpaceMinutiae, no_space_minutiae
from splitknit_match.matching.surface_code import (
    CODE_PITCH_MM,
    CODE_SMOOTH_MM,
    CODE_WINDOW_MM,
    SurfaceCode,
    SurfaceCodeSettings,
    make_surface_code,
)
from splitknit_match.prints.curvature import REFERENCE_PX_PER_MM, CurvatureSettings, curvature
from splitknit_match.prints.print_map import PrintMap, plane_map
from splitknit_match.records.minutiae3d import angles_of


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


Array = NDArray[np.float64]
SLOPE_SIGMA_MM = 0.2
"""Standard deviation of the Gaussian that smooths the surface before its slope along a ridge is measured: half a
ridge's period, so that the slope is that of the skin and not of the ridge's end."""


def space_minutiae(surface: Surface) -> SpaceMinutiae:
    """Minutiae (x, y, z, theta, phi) of a reconstruction, in the upright finger's frame.

    Found in the relief's print by mindtct; phi is the elevation of the smoothed surface along the minutia's direction.
    Raises BadInput if `nbis-py` is not installed.

    Source: A. Kumar and C. Kwong, "Towards contactless, low-cost and accurate 3D fingerprint identification", IEEE
    Trans. PAMI 37(3), 2015: minutiae of the plane print with their height z and elevation phi.
    """
    from splitknit_match.matching.minutiae import extract  # large, and not everywhere

    found = extract(surface_print(surface, 500.0))
    if not found.count:
        return no_space_minutiae()
    print_map = plane_map(surface.pitch_mm, surface.input_from_upright, surface.upright_size)
    height = smoothed(surface.shape_mm + surface.ridge_mm, surface.mask, SLOPE_SIGMA_MM / surface.pitch_mm)
    height = np.where(surface.mask, height, np.float32(np.nan)).astype(np.float32)
    places = np.stack([found.x_px, found.y_px], axis=1).astype(np.float64)
    turned = surface.input_from_upright
    space = in_space(places, found.direction_rad, print_map, height, surface.pitch_mm, input_from_upright=turned)
    good = np.isfinite(space).all(axis=1)
    if not bool(good.any()):
        return no_space_minutiae()
    theta, phi = angles_of(space[good, 3:])
    return SpaceMinutiae(space[good, :3], theta, phi, found.type[good], found.quality[good])


def in_space(
    places: Array,
    directions_rad: Array,
    print_map: PrintMap,
    height_mm: FloatArray,
    pitch_mm: float,
    *,
    input_from_upright: Array,
    xy_mm: tuple[FloatArray, FloatArray] | None = None,
) -> Array:
    """Where places of a print lie on the surface, in the upright finger's frame, and their directions there.

    Returns (N, 6) x, y, z in mm and the direction; NaN where the print shows nothing, or the surface is not known.
    `places`: (N, 2) column and row on the print; `directions_rad`: (N,) counter-clockwise, as seen in the print;
    `height_mm`: (H, W), NaN where it is not known, of the input's `pitch_mm`; `xy_mm`: x and y (H, W) of the surface's
    points, where the camera's rays spread.
    """
    require(height_mm.ndim == 2, f"heights must be (H, W), but they are {height_mm.shape}.")
    there = print_map.input_from_print(places)
    ahead = print_map.directions_in_input(places, directions_rad)
    slope_x, slope_y = (bilinear(field, there) for field in height_gradients(height_mm, pitch_mm))
    dx, dy = np.cos(ahead), np.sin(ahead)
    along = np.stack([dx, dy], axis=1) @ _turn_of(input_from_upright).T
    points = on_surface(there, height_mm, pitch_mm, input_from_upright, xy_mm)
    return np.column_stack([points, along, slope_x * dx + slope_y * dy])


def on_surface(
    there: Array,
    height_mm: FloatArray,
    pitch_mm: float,
    input_from_upright: Array,
    xy_mm: tuple[FloatArray, FloatArray] | None = None,
) -> Array:
    """(N, 3) x, y, z in mm of the upright finger's frame at the input's pixels `there` (N, 2); see :func:`in_space`."""
    rows, columns = height_mm.shape
    if xy_mm is not None:
        x, y = (bilinear(field, there) for field in xy_mm)
    else:
        x = (there[:, 0] - (columns - 1) / 2) * pitch_mm
        y = ((rows - 1) / 2 - there[:, 1]) * pitch_mm
    return np.column_stack([np.stack([x, y], axis=1) @ _turn_of(input_from_upright).T, bilinear(height_mm, there)])


def _turn_of(input_from_upright: Array) -> Array:
    """(2, 2) turn of the input's plane (y up) into the upright finger's."""
    turn, flip = np.linalg.inv(input_from_upright[:2, :2]), np.diag([1.0, -1.0])
    return np.asarray(flip @ (turn / np.sqrt(abs(np.linalg.det(turn)))) @ flip)


def bilinear(field: FloatArray, places: Array) -> Array:
    """(N, ...) values of a field (H, W, ...) at places (N, 2; column, row); NaN outside and beside NaN."""
    column, row = np.nan_to_num(places, nan=-10.0).T
    return sampled_at(field, column, row, outside=float("nan")).astype(np.float64)
