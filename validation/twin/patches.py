"""Patches of ridged skin that the fast twin and the reference are both shown."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from splitknit.model import Camera
from splitknit_simulator.finger.master_print import MasterPrint, MasterPrintSettings, master_print
from splitknit_simulator.finger.skin_map import SkinRelief, skin_map
from splitknit_simulator.surface import SimulatedSurface

Array = NDArray[np.float64]
PITCH_MM = 0.0132
"""Of the maps: the rig's full scale. The reference's pixels are twice as large."""


@lru_cache(maxsize=2)
def _master(seed: int) -> MasterPrint:
    return master_print("whorl", seed, MasterPrintSettings(period_spread=0.0))


def ridged_patch(
    depth_um: float, size_mm: float, *, radius_mm: float | None = None, tilt_deg: float = 0.0, seed: int = 5
) -> SimulatedSurface:
    """A square of ridged skin from the pad of a drawn print, without creases: flat, or a cylinder along y.

    `depth_um` is the mean height of the ridges over the valleys, the same all over. The mean height is zero in the
    middle. `tilt_deg` leans the whole patch towards +x.
    """
    count = 2 * round(0.5 * size_mm / PITCH_MM)
    camera = Camera(px_per_mm=1.0 / PITCH_MM, image_size=(count, count))
    along = (np.arange(count) - (count - 1) / 2) * PITCH_MM
    x, y = np.meshgrid(along, -along)
    shape, slope = np.zeros_like(x), np.zeros_like(x)
    arc = x
    if radius_mm is not None:
        arc = radius_mm * np.arcsin(np.clip(x / radius_mm, -0.999, 0.999))
        shape = np.sqrt(np.maximum(radius_mm**2 - x * x, 1e-3)) - radius_mm
        slope = -x / np.sqrt(np.maximum(radius_mm**2 - x * x, 1e-3))
    slope = slope - np.tan(np.deg2rad(tilt_deg))
    shape = shape - np.tan(np.deg2rad(tilt_deg)) * x
    settings = SkinRelief(ridge_depth_um=depth_um, depth_variation=0.0, pore_darkening=0.0, creases=())
    displacement = skin_map(_master(seed), settings).displacement(arc.ravel(), (y + 13.0).ravel()).reshape(x.shape)
    # to first order: along the shape's normal by d is up by d over the normal's z
    height = shape + displacement * np.hypot(1.0, slope)
    middle = float(height[count // 2 - 60 : count // 2 + 60, count // 2 - 60 : count // 2 + 60].mean())
    down, across = np.gradient(height, PITCH_MM)
    return SimulatedSurface(
        camera, (height - middle).astype(np.float32), (shape - middle).astype(np.float32), _unit(across, -down),
        _unit(slope, 0.0 * slope), (1e3 * displacement).astype(np.float32), np.ones(x.shape, dtype=np.bool_),
        np.ones(x.shape, dtype=np.float32),
    )  # fmt: skip


def middle(surface: SimulatedSurface, size_px: int) -> tuple[slice, slice]:
    """Rows and columns of the central square of `size_px` map pixels."""
    start = (surface.mask.shape[0] - size_px) // 2
    return slice(start, start + size_px), slice(start, start + size_px)


def _unit(slope_x: Array, slope_y: Array) -> NDArray[np.float32]:
    normal = np.stack([-slope_x, -slope_y, np.ones_like(slope_x)], axis=-1)
    return (normal / np.linalg.norm(normal, axis=-1, keepdims=True)).astype(np.float32)
