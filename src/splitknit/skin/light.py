"""Lights on the current surface, on the coarse and on the fine grid, and where what they show can be trusted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from splitknit.imaging.geometry import height_gradients, normals_from_gradients
from splitknit.imaging.light_field import light_vectors_at
from splitknit.model import BoolArray, FloatArray, Rig
from splitknit.photometric.equations import shading
from splitknit.skin.glare import fresnel_transmission
from splitknit.skin.grid import Grid, smooth_step


@dataclass(frozen=True, slots=True, eq=False)
class Lighting:
    """Lights of one band on the current surface, on the coarse or on the fine grid."""

    vectors: FloatArray
    """(L, 3, h, w) direction towards the light times its irradiance."""
    entering: FloatArray
    """(L, h, w) light that enters the skin, over normal incidence (Fresnel)."""
    trust: FloatArray
    """(L, h, w) in [0, 1]: zero where the light only grazes the surface or does not reach it."""


def lighting(rig: Rig, grid: Grid, height_mm: FloatArray, normals: FloatArray) -> Lighting:
    """Light vectors, Fresnel transmission and trust of every light at the surface."""
    vectors = grid.view.turned(light_vectors_at(rig, *grid.view.points(height_mm)))
    length = np.sqrt((vectors * vectors).sum(axis=1))
    cosine = shading(np.moveaxis(normals, -1, 0), vectors) / np.maximum(length, np.float32(1e-12))
    trust = np.clip((cosine - np.float32(0.05)) / np.float32(0.15), 0, 1) + np.float32(1e-3)
    return Lighting(vectors, fresnel_transmission(np.maximum(cosine, np.float32(0.05))), trust * grid.mask)


def reached_by_all(light: Lighting, grid: Grid) -> BoolArray:
    """(h, w) pixels away from the outline that every light reaches; the whole mask where there are none."""
    reached = grid.mask & (grid.depth_mm > 0.4) & (light.trust > 0.6).all(axis=0)
    return reached if reached.any() else grid.mask


def predict(light: Lighting, grid: Grid, normals: FloatArray, transfers: Sequence[FloatArray]) -> FloatArray:
    """Diffuse images (C, L, h, w) of an albedo of one, one channel for each of C transfer functions of the skin."""
    irradiance = np.maximum(shading(np.moveaxis(normals, -1, 0), light.vectors), 0) * light.entering
    spectrum = grid.forward((irradiance * grid.mask).astype(np.float32), extend=True)
    return np.stack([grid.inverse(spectrum * transfer) * grid.mask for transfer in transfers])


def fine_lighting(rig: Rig, low: Grid, height_mm: FloatArray, factor: int, grid: Grid) -> Lighting:
    """Lights on a smooth surface (h, w) of the coarse grid, enlarged to the fine one."""
    normals = normals_from_gradients(*height_gradients(height_mm, low.pitch_mm))
    light = lighting(rig, low, height_mm, normals)
    trust = np.where(low.mask, light.trust, np.float32(0.0))

    def enlarge(fields: FloatArray) -> FloatArray:
        size = (low.shape[1] * factor, low.shape[0] * factor)
        flat = fields.reshape(-1, *low.shape)
        large = np.empty((len(flat), *grid.shape), dtype=np.float32)
        for one, field in zip(large, flat, strict=True):
            cv2.resize(field, size, dst=one[: size[1], : size[0]], interpolation=cv2.INTER_LINEAR)
            one[size[1] :, : size[0]] = one[size[1] - 1, : size[0]]
            one[:, size[0] :] = one[:, size[0] - 1 : size[0]]
        return large.reshape(*fields.shape[:-2], *grid.shape)

    fine_trust, entering = enlarge(trust), enlarge(light.entering)
    np.maximum(fine_trust, np.float32(1e-3), out=fine_trust)
    fine_trust *= grid.mask
    np.maximum(entering, np.float32(0.2), out=entering)
    return Lighting(enlarge(light.vectors), entering, fine_trust)


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
