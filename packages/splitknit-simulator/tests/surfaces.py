"""Analytic surfaces for the twin's optics: no finger needed."""

from __future__ import annotations

import numpy as np

from splitknit.model import Camera
from splitknit_simulator.surface import SimulatedSurface

PX_PER_MM = 37.85


def plane(size: tuple[int, int] = (96, 128), px_per_mm: float = 10.0) -> SimulatedSurface:
    """A flat sheet that fills the picture at z = 0."""
    zero = np.zeros(size, dtype=np.float32)
    up = np.zeros((*size, 3), dtype=np.float32)
    up[..., 2] = 1.0
    mask = np.ones(size, dtype=np.bool_)
    return SimulatedSurface(
        Camera(px_per_mm, size), zero, zero, up, up, zero, mask, np.ones(size, dtype=np.float32)
    )


def ridged_egg(
    size: tuple[int, int] = (550, 480),
    px_per_mm: float = PX_PER_MM,
    depth_um: float = 75.0,
    period_mm: float = 0.43,
) -> SimulatedSurface:
    """A finger-sized half ellipsoid with concentric ridges; its normals are those of the ridged
    height, exactly."""
    camera = Camera(px_per_mm, size)
    x = ((np.arange(size[1]) - (size[1] - 1) / 2) / px_per_mm)[None, :]
    y = (((size[0] - 1) / 2 - np.arange(size[0])) / px_per_mm)[:, None]
    width, length, height = 5.8, 6.8, 5.0
    inside = 1.0 - (x / width) ** 2 - (y / length) ** 2
    mask = inside > 0.03
    root = np.sqrt(np.clip(inside, 0.03, 1.0))
    shape = height * root
    radius = np.hypot(x - 0.3, y - 1.0) + 1e-9
    phase = 2.0 * np.pi * radius / period_mm
    # ridges fade towards the outline so that the height stays a single-valued, smooth function
    fade = np.clip(inside, 0.0, 1.0)
    relief = -depth_um * (0.5 - 0.5 * np.cos(phase)) * fade
    slope = -depth_um * 0.5 * np.sin(phase) * 2.0 * np.pi / period_mm * fade * 1e-3
    ripple = -depth_um * (0.5 - 0.5 * np.cos(phase)) * 1e-3
    sx, sy = -height * x / (width**2 * root), -height * y / (length**2 * root)
    gx = sx + slope * (x - 0.3) / radius - ripple * 2.0 * x / width**2
    gy = sy + slope * (y - 1.0) / radius - ripple * 2.0 * y / length**2
    return SimulatedSurface(
        camera=camera,
        height_mm=np.where(mask, shape + relief * 1e-3, np.nan).astype(np.float32),
        shape_mm=np.where(mask, shape, np.nan).astype(np.float32),
        normals=_unit(gx, gy, mask),
        shape_normals=_unit(sx, sy, mask),
        relief_um=np.where(mask, relief, 0.0).astype(np.float32),
        mask=mask,
        pigment=np.ones(size, dtype=np.float32),
        landmarks={"tip": (0.0, 6.8), "pattern": "rings", "pose": {"yaw_deg": 0.0}},
    )


def _unit(gx: np.ndarray, gy: np.ndarray, mask: np.ndarray) -> np.ndarray:
    normals = np.stack([-gx, -gy, np.ones_like(gx)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return np.where(mask[..., None], normals, 0.0).astype(np.float32)


def perspective_camera(
    size: tuple[int, int],
    px_per_mm: float,
    height_mm: float,
    *,
    off: tuple[float, float] = (0.0, 0.0),
    distortion: tuple[float, ...] | None = None,
    shading: tuple[float, ...] = (),
) -> Camera:
    """A camera whose axis meets the sensor `off` pixels (columns, rows) beside the middle."""
    focal = px_per_mm * height_mm
    column, row = (size[1] - 1) / 2 + off[0], (size[0] - 1) / 2 + off[1]
    matrix = np.array([[focal, 0.0, column], [0.0, focal, row], [0.0, 0.0, 1.0]])
    return Camera(px_per_mm, size, height_mm, "perspective", matrix, distortion, shading)


def perspective_plane(camera: Camera, z_mm: float, slope: float = 0.0) -> SimulatedSurface:
    """A flat sheet, z = z_mm + slope x, that fills the picture of a camera without distortion."""
    _, columns = np.indices(camera.image_size)
    assert camera.matrix is not None
    right = (columns - camera.matrix[0, 2]) / camera.matrix[0, 0]
    depth = (camera.height_mm - z_mm) / (1.0 + slope * right)
    z = (camera.height_mm - depth).astype(np.float32)
    normals = np.zeros((*camera.image_size, 3), dtype=np.float32)
    normals[:] = np.array([-slope, 0.0, 1.0]) / np.hypot(slope, 1.0)
    ones = np.ones(camera.image_size, dtype=np.float32)
    return SimulatedSurface(
        camera, z, z, normals, normals, 0.0 * z, np.ones(z.shape, np.bool_), ones
    )
