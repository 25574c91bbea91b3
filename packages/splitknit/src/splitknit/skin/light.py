"""Light on skin: glare of its surface, the lights on the current shape, and where what they show
can be trusted.

Glare is light that the surface mirrors, as a rough dielectric boundary does. It has the colour of
the light, not of the skin, and it moves with the light; both properties separate it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from splitknit.imaging.geometry import enlarged, height_gradients, normals_from_gradients
from splitknit.imaging.light_field import light_vectors_at
from splitknit.model import BoolArray, FloatArray, Rig
from splitknit.photometric.equations import shading
from splitknit.skin.grid import Grid, smooth_step


def fresnel_transmission(cosine: Any, index: float = 1.42) -> FloatArray:
    """Unpolarised light that enters a dielectric, relative to normal incidence, by the cosine (Born
    and Wolf 1.5); 1.42 is about the stratum corneum's index."""
    normal = 1.0 - ((index - 1.0) / (index + 1.0)) ** 2
    return ((1.0 - fresnel_reflectance(cosine, index)) / normal).astype(np.float32)


def fresnel_reflectance(cosine: Any, index: float = 1.42) -> FloatArray:
    """Part of unpolarised light that a dielectric reflects at an angle with this cosine (Born and
    Wolf, 1.5)."""
    c = np.clip(np.asarray(cosine, dtype=np.float32), 1e-3, 1.0)
    inside = np.sqrt(1.0 - (1.0 - c * c) / (index**2))
    s = (c - index * inside) / (c + index * inside)
    p = (index * c - inside) / (index * c + inside)
    return np.asarray(0.5 * (s * s + p * p))


ROUGHNESS = 0.3
"""Roughness (GGX alpha) of the skin's boundary: fitted ones, between 0.12 and 0.42, change the
surface by -0.5 % on average. Chosen on: simulated fingers (eight, and four path-traced ones)."""


def microfacet_glare(
    normals: FloatArray, lights: FloatArray, roughness: float = ROUGHNESS
) -> FloatArray:
    """(L, ...) glare under each light, for a viewer along z and an irradiance of one at normal
    incidence.

    `normals` (..., 3); `lights` (L, 3, ...): direction towards the light times its irradiance. B.
    Walter et al., "Microfacet models for refraction through rough surfaces", EGSR 2007, eq. 20, 33
    and 34.
    """
    planes = np.ascontiguousarray(np.moveaxis(normals, -1, 0))
    strength = np.sqrt((lights * lights).sum(axis=1))
    safe = np.maximum(strength, 1e-12)
    cosine = shading(planes, lights) / safe
    length = np.sqrt(np.maximum(2 * (lights[:, 2] / safe + 1), 1e-12))  # of light plus view
    half = np.clip((cosine + planes[2]) / length, 0, 1)
    mirrored = np.where(cosine > 0, fresnel_reflectance(length / 2) * strength, 0.0)
    view = np.clip(planes[2], 0.05, 1)
    a2 = np.float32(roughness**2)
    falloff = half * half * (a2 - 1) + 1
    spread = a2 / (np.pi * falloff * falloff)
    masking = _one_way(view, a2) * _one_way(np.maximum(cosine, 1e-4), a2) / (4 * view)
    return np.asarray(spread * masking * mirrored, dtype=np.float32)


def _one_way(cosine: FloatArray, a2: np.float32) -> FloatArray:
    return 2 * cosine / (cosine + np.sqrt(a2 + (1 - a2) * cosine * cosine))


def glare_strength(stack: FloatArray, lights: FloatArray, glare: FloatArray) -> float:
    """Factor on the `glare` (L, n), not negative, that explains most of what no matt surface
    explains of `stack` (L, n): images of one channel, L >= 4, at n pixels that all lights reach.

    `lights`: (L, 3, n). Both images and glare are taken without the space of matt images, which
    the pixel's light vectors span.
    """
    if stack.shape[0] < 4 or stack.shape[1] == 0:
        return 0.0
    matt = np.linalg.qr(np.moveaxis(lights, -1, 0))[0]  # (n, L, 3), orthonormal
    left, lobe = (
        images - np.einsum("nlk,nk->ln", matt, np.einsum("nlk,ln->nk", matt, images))
        for images in (stack, glare)
    )
    return factor_of(lobe, left)


def factor_of(lobe: FloatArray, light: FloatArray) -> float:
    """Factor on the lobe, not negative, that is nearest to the light, both (L, n)."""
    power = float((lobe * lobe).sum(dtype=np.float64))
    return max(float((lobe * light).sum(dtype=np.float64)), 0.0) / max(power, 1e-30)


@dataclass(frozen=True, slots=True, eq=False)
class Lighting:
    """Lights of one band on the current surface, on the coarse or on the fine grid."""

    vectors: FloatArray  # (L, 3, h, w) direction towards the light times its irradiance
    entering: FloatArray  # (L, h, w) light that enters the skin, over normal incidence (Fresnel)
    # (L, h, w) in [0, 1]: zero where the light only grazes the surface or does not reach it
    trust: FloatArray


def lighting(rig: Rig, grid: Grid, height_mm: FloatArray, normals: FloatArray) -> Lighting:
    """Light vectors, Fresnel transmission and trust of every light at the surface."""
    vectors = grid.view.turned(light_vectors_at(rig, *grid.view.points(height_mm)))
    length = np.sqrt((vectors * vectors).sum(axis=1))
    cosine = shading(np.moveaxis(normals, -1, 0), vectors) / np.maximum(length, 1e-12)
    trust = np.clip((cosine - 0.05) / 0.15, 0, 1) + 1e-3
    return Lighting(vectors, fresnel_transmission(np.maximum(cosine, 0.05)), trust * grid.mask)


def reached_by_all(light: Lighting, grid: Grid) -> BoolArray:
    """(h, w) pixels away from the outline that every light reaches; the whole mask where there are
    none."""
    reached = grid.mask & (grid.depth_mm > 0.4) & (light.trust > 0.6).all(axis=0)
    return reached if reached.any() else grid.mask


def predict(
    light: Lighting, grid: Grid, normals: FloatArray, transfers: Sequence[FloatArray]
) -> FloatArray:
    """Diffuse images (C, L, h, w) of an albedo of one, one channel for each of C transfer functions
    of the skin."""
    irradiance = np.maximum(shading(np.moveaxis(normals, -1, 0), light.vectors), 0) * light.entering
    spectrum = grid.forward((irradiance * grid.mask).astype(np.float32), extend=True)
    return np.stack([grid.inverse(spectrum * transfer) * grid.mask for transfer in transfers])


def fine_lighting(rig: Rig, low: Grid, height_mm: FloatArray, factor: int, grid: Grid) -> Lighting:
    """Lights on a smooth surface (h, w) of the coarse grid, enlarged to the fine one."""
    normals = normals_from_gradients(*height_gradients(height_mm, low.pitch_mm))
    light = lighting(rig, low, height_mm, normals)
    trust = np.where(low.mask, light.trust, 0.0)

    def enlarge(fields: FloatArray) -> FloatArray:
        large = np.empty((*fields.shape[:-2], *grid.shape), dtype=np.float32)
        for place in np.ndindex(fields.shape[:-2]):
            large[place] = enlarged(fields[place], factor, grid.shape)
        return large

    fine_trust, entering = enlarge(trust), enlarge(light.entering)
    np.maximum(fine_trust, 1e-3, out=fine_trust)
    fine_trust *= grid.mask
    np.maximum(entering, 0.2, out=entering)
    return Lighting(enlarge(light.vectors), entering, fine_trust)


def slant_of(surface_mm: FloatArray, pitch_mm: float) -> FloatArray:
    """(h, w) angle between the surface's normal and the line of sight, degrees."""
    normals = normals_from_gradients(*height_gradients(surface_mm, pitch_mm))
    return np.rad2deg(np.arccos(np.clip(normals[..., 2], 0, 1))).astype(np.float32)


def trust_of(slant_deg: FloatArray, grid: Grid) -> FloatArray:
    """(h, w) in [0, 1]: fades out towards grazing slopes and the outline."""
    return smooth_step((74 - slant_deg) / 14) * smooth_step((grid.depth_mm - 0.1) / 0.3) * grid.mask
