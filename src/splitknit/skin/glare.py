"""Glare: light that the skin's surface mirrors, as a rough dielectric boundary does.

It has the colour of the light, not of the skin, and it moves with the light; both properties separate it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from splitknit.model import FloatArray
from splitknit.photometric.equations import shading

INDEX = 1.42
"""Refractive index of the stratum corneum, about."""


def fresnel_transmission(cosine: Any, index: float = INDEX) -> FloatArray:
    """Unpolarised light that enters a dielectric, relative to normal incidence, by the cosine (Born and Wolf 1.5)."""
    normal = 1.0 - ((index - 1.0) / (index + 1.0)) ** 2
    return ((1.0 - fresnel_reflectance(cosine, index)) / np.float32(normal)).astype(np.float32)


def fresnel_reflectance(cosine: Any, index: float = INDEX) -> FloatArray:
    """Part of unpolarised light that a dielectric reflects at an angle with this cosine (Born and Wolf, 1.5)."""
    c = np.clip(np.asarray(cosine, dtype=np.float32), np.float32(1e-3), np.float32(1.0))
    inside = np.sqrt(1.0 - (1.0 - c * c) / np.float32(index**2))
    s = (c - index * inside) / (c + index * inside)
    p = (index * c - inside) / (index * c + inside)
    return np.asarray(0.5 * (s * s + p * p), dtype=np.float32)


class MicrofacetGlare:
    """Glare under each light, for a viewer along z and an irradiance of one at normal incidence, by its roughness.

    `normals` (..., 3); `lights` (L, 3, ...): direction towards the light times its irradiance. B. Walter et al.,
    "Microfacet models for refraction through rough surfaces", EGSR 2007, eq. 20, 33 and 34.
    """

    def __init__(self, normals: FloatArray, lights: FloatArray) -> None:
        """Keep what does not depend on the roughness."""
        planes = np.ascontiguousarray(np.moveaxis(normals, -1, 0))
        nz, strength = planes[2], np.sqrt((lights * lights).sum(axis=1))
        safe = np.maximum(strength, np.float32(1e-12))
        cosine = shading(planes, lights) / safe
        length = np.sqrt(np.maximum(2 * (lights[:, 2] / safe + 1), np.float32(1e-12)))  # of light plus view
        half = np.clip((cosine + nz) / length, 0, 1)
        self._half_squared = half * half
        self._incoming = np.maximum(cosine, np.float32(1e-4))
        self._mirrored = np.where(cosine > 0, fresnel_reflectance(length / 2) * strength, np.float32(0.0))
        self._view = np.clip(nz, np.float32(0.05), 1)

    def __call__(self, roughness: float) -> FloatArray:
        """(L, ...) float32 for a roughness (GGX alpha)."""
        a2 = np.float32(roughness**2)
        masking = _one_way(self._view, a2) / (4 * self._view)
        falloff = self._half_squared * (a2 - 1) + 1
        spread = a2 / (np.float32(np.pi) * falloff * falloff)
        return np.asarray(spread * masking * _one_way(self._incoming, a2) * self._mirrored, dtype=np.float32)


def _one_way(cosine: FloatArray, a2: np.float32) -> FloatArray:
    return np.asarray(2 * cosine / (cosine + np.sqrt(a2 + (1 - a2) * cosine * cosine)), dtype=np.float32)


@dataclass(frozen=True, slots=True)
class GlareFit:
    """Glare that best explains what no matt surface explains."""

    roughness: float
    """GGX alpha."""
    strength: float
    """Factor on :class:`MicrofacetGlare`, in the images' units; never negative."""
    explained: float
    """Part of the squared residual that it explains."""


def fit_glare(
    stack: FloatArray,
    lights: FloatArray,
    model: Callable[[float], FloatArray],
    roughnesses: tuple[float, ...] = (0.12, 0.18, 0.24, 0.30, 0.36, 0.42),
) -> GlareFit:
    """Strength and roughness of the glare in `stack` (L, n) of one band, L >= 4, at n pixels that all lights reach.

    `lights`: (L, 3, n); `model`: glare (L, n) of strength one, as of :class:`MicrofacetGlare`. Both images and glare
    are taken without the space of matt images, which the pixel's light vectors span; roughness by search, strength by
    least squares.
    """
    if stack.shape[0] < 4 or stack.shape[1] == 0:
        return GlareFit(roughnesses[0], 0.0, 0.0)
    basis = _orthonormal(lights)
    left = _project_out(stack, basis)
    total = float((left * left).sum(dtype=np.float64))
    best = GlareFit(roughnesses[0], 0.0, 0.0)
    for roughness in roughnesses:
        trial = _project_out(model(roughness), basis)
        power = float((trial * trial).sum(dtype=np.float64))
        if power <= 0 or total <= 0:
            continue
        product = float((trial * left).sum(dtype=np.float64))
        explained = max(product, 0.0) ** 2 / power / total
        if explained > best.explained:
            best = GlareFit(roughness, product / power, explained)
    return best


def _orthonormal(lights: FloatArray) -> list[FloatArray]:
    """Orthonormal basis (three arrays (L, n)) of the columns of `lights` (L, 3, n), pixel by pixel (Gram-Schmidt)."""
    basis: list[FloatArray] = []
    for axis in (2, 0, 1):
        vector = _project_out(lights[:, axis], basis)
        norm = np.sqrt((vector * vector).sum(axis=0))
        basis.append(vector / np.maximum(norm, np.float32(1e-9)))
    return basis


def _project_out(values: FloatArray, basis: list[FloatArray]) -> FloatArray:
    for vector in basis:
        values = values - vector * (values * vector).sum(axis=0)
    return values
