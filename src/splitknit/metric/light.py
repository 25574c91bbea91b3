"""The white lights on the fine grid, and where what they show can be trusted."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from splitknit.geometry import height_gradients, normals_from_gradients
from splitknit.metric.coarse import lighting
from splitknit.metric.grid import Grid, smooth_step
from splitknit.types import FloatArray, Rig


@dataclass(frozen=True, slots=True, eq=False)
class FineLight:
    """The white lights on the fine grid, as far as they vary with the surface's slant."""

    vectors: FloatArray
    """(L, 3, h, w) direction towards the light times its irradiance."""
    entering: FloatArray
    """(L, h, w) light that enters the skin, over normal incidence."""
    trust: FloatArray
    """(L, h, w) in [0, 1]."""


def fine_lighting(rig: Rig, low: Grid, height_mm: FloatArray, factor: int, grid: Grid) -> FineLight:
    """Lights on a smooth surface (h, w) of the coarse grid, enlarged to the fine one."""
    normals = normals_from_gradients(*height_gradients(height_mm, low.pitch_mm))
    light = lighting(rig, low, height_mm, normals)
    trust = np.where(low.mask, light.trust, np.float32(0.0))

    def enlarge(fields: FloatArray) -> FloatArray:
        size = (low.shape[1] * factor, low.shape[0] * factor)
        flat = fields.reshape(-1, *low.shape)
        large = np.empty((len(flat), *grid.shape), dtype=np.float32)
        for one, field in zip(large, flat, strict=True):
            inner = cv2.resize(field, size, interpolation=cv2.INTER_LINEAR)
            one[: size[1], : size[0]] = inner
            one[size[1] :, : size[0]] = inner[-1]
            one[:, size[0] :] = one[:, size[0] - 1 : size[0]]
        return large.reshape(*fields.shape[:-2], *grid.shape)

    seen = np.maximum(enlarge(trust), np.float32(1e-3)) * grid.mask
    return FineLight(enlarge(light.vectors), np.maximum(enlarge(light.entering), np.float32(0.2)), seen)


def slant_of(surface_mm: FloatArray, pitch_mm: float) -> FloatArray:
    """(h, w) angle between the surface's normal and the line of sight, degrees."""
    normals = normals_from_gradients(*height_gradients(surface_mm, pitch_mm))
    return np.rad2deg(np.arccos(np.clip(normals[..., 2], 0, 1))).astype(np.float32)


def trust_of(slant_deg: FloatArray, grid: Grid) -> FloatArray:
    """(h, w) in [0, 1]: fades out towards grazing slopes and the outline."""
    return np.asarray(
        smooth_step((np.float32(74) - slant_deg) / np.float32(14))
        * smooth_step((grid.depth_mm - np.float32(0.1)) / np.float32(0.3))
        * grid.mask,
        dtype=np.float32,
    )
