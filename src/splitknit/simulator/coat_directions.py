"""From the map of the skin to the picture: values at the points that the camera sees, and directions in space."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from splitknit.errors import require
from splitknit.model import BoolArray, FloatArray
from splitknit.simulator.master_print import MasterPrint
from splitknit.simulator.skin_map import SkinMap
from splitknit.simulator.surface import Surface

Array = NDArray[np.float64]


def on_chart(values: Array, surface: Surface, laid: SkinMap) -> FloatArray:
    """(H, W) values of the skin's map at the points of the picture, zero beside the finger."""
    require(surface.chart is not None, "the surface must have its chart (keep_chart).")
    assert surface.chart is not None
    chart = np.nan_to_num(surface.chart).astype(np.float64)
    rows, columns = (laid.v0_mm - chart[..., 1]) / laid.pitch_mm, (chart[..., 0] - laid.u0_mm) / laid.pitch_mm
    found = ndimage.map_coordinates(values, [rows, columns], order=1, mode="mirror")
    return np.asarray(np.where(surface.mask, found, 0.0), dtype=np.float32)


def ridges_in_space(angle_rad: Array, surface: Surface, master: MasterPrint) -> FloatArray:
    """(H, W, 3) unit vectors along the ridges, in the skin's surface.

    A step in the picture moves the point on the chart by the chart's Jacobian; the inverse takes the ridges' direction
    to the picture, and z follows from the normal.
    """
    require(surface.chart is not None, "the surface must have its chart (keep_chart).")
    assert surface.chart is not None
    pitch = float(master.u_mm[1] - master.u_mm[0])
    u, v = surface.chart[..., 0].astype(np.float64), surface.chart[..., 1].astype(np.float64)
    rows, columns = np.nan_to_num(master.v_mm[0] - v) / pitch, np.nan_to_num(u - master.u_mm[0]) / pitch
    doubled = [
        ndimage.map_coordinates(part, [rows, columns], order=1, mode="mirror")
        for part in (np.cos(2.0 * angle_rad), np.sin(2.0 * angle_rad))
    ]
    angle = 0.5 * np.arctan2(doubled[1], doubled[0])
    wanted_u, wanted_v = np.cos(angle), np.sin(angle)
    u_row, u_x = np.gradient(u)
    v_row, v_x = np.gradient(v)
    u_y, v_y = -u_row, -v_row
    determinant = u_x * v_y - u_y * v_x
    with np.errstate(invalid="ignore", divide="ignore"):
        x = (v_y * wanted_u - u_y * wanted_v) / determinant
        y = (-v_x * wanted_u + u_x * wanted_v) / determinant
    n = surface.normals.astype(np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        z = -(n[..., 0] * x + n[..., 1] * y) / n[..., 2]
        vectors = np.stack([x, y, z], axis=-1)
        vectors /= np.linalg.norm(vectors, axis=-1, keepdims=True)
    sound = surface.mask & np.isfinite(vectors).all(axis=-1)
    return np.asarray(np.where(sound[..., None], vectors, [1.0, 0.0, 0.0]), dtype=np.float32)


def bend_within_pixels(normals: NDArray[np.floating], mask: BoolArray) -> Array:
    """(H, W) variance of the slope inside a pixel, one direction's: a bent mirror shows a pixel many normals.

    References
    ----------
    Olano and Baker 2010, LEAN mapping: the variance of the slopes adds to that of the microfacets.
    """
    nz = np.where(mask, np.maximum(normals[..., 2], 0.2), 1.0)
    slopes = [np.where(mask, -normals[..., axis] / nz, 0.0) for axis in (0, 1)]
    total = np.zeros(mask.shape)
    for slope in slopes:
        down, right = np.gradient(slope)
        total += (down**2 + right**2) / 12.0
    return np.asarray(np.minimum(0.5 * total, 0.25))
