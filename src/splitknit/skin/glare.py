"""Glare: light that the skin's surface mirrors, as a rough dielectric boundary does.

It has the colour of the light and not of the skin, and it moves with the light: two handles to take hold of it.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from splitknit.model import FloatArray

INDEX = 1.42
"""Refractive index of the stratum corneum, about."""


def fresnel_transmission(cosine: Any, index: float = INDEX) -> FloatArray:
    """Unpolarised light that enters a dielectric at an angle with this cosine, over that at normal incidence.

    References
    ----------
    M. Born and E. Wolf, "Principles of Optics", section 1.5.
    """
    normal = 1.0 - ((index - 1.0) / (index + 1.0)) ** 2
    return ((1.0 - _fresnel(cosine, index)) / np.float32(normal)).astype(np.float32)


def _fresnel(cosine: Any, index: float = INDEX) -> FloatArray:
    c = np.clip(np.asarray(cosine, dtype=np.float32), np.float32(1e-3), np.float32(1.0))
    inside = np.sqrt(1.0 - (1.0 - c * c) / np.float32(index**2))
    s = (c - index * inside) / (c + index * inside)
    p = (index * c - inside) / (index * c + inside)
    return np.asarray(0.5 * (s * s + p * p), dtype=np.float32)


def microfacet_glare(normals: FloatArray, lights: FloatArray, roughness: float) -> FloatArray:
    """Glare under each light, for a viewer along z and an irradiance of one at normal incidence.

    Parameters
    ----------
    normals : (H, W, 3)
    lights : (L, 3, H, W)
        Direction towards the light times its irradiance.
    roughness : GGX alpha

    Returns
    -------
    (L, H, W) float32

    References
    ----------
    B. Walter et al., "Microfacet models for refraction through rough surfaces", EGSR 2007, eq. 20, 33 and 34.
    """
    a2 = np.float32(roughness**2)
    nx, ny, nz = (np.ascontiguousarray(normals[..., axis]) for axis in range(3))
    view = np.clip(nz, np.float32(0.05), 1)
    seen = _one_way(view, a2) / (4 * view)
    glare = np.empty((lights.shape[0], *nz.shape), dtype=np.float32)

    def one(k: int) -> None:
        light = lights[k]
        strength = np.sqrt(light[0] * light[0] + light[1] * light[1] + light[2] * light[2])
        safe = np.maximum(strength, np.float32(1e-12))
        lx, ly, lz = light[0] / safe, light[1] / safe, light[2] / safe
        cosine = lx * nx + ly * ny + lz * nz
        length = np.sqrt(np.maximum(2 * (lz + 1), np.float32(1e-12)))  # of light plus view
        nh = np.clip((cosine + nz) / length, 0, 1)
        falloff = nh * nh * (a2 - 1) + 1
        spread = a2 / (np.float32(np.pi) * falloff * falloff)
        incoming = _one_way(np.maximum(cosine, np.float32(1e-4)), a2) * _fresnel(length / 2) * strength
        glare[k] = np.where(cosine > 0, spread * seen * incoming, np.float32(0.0))

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(one, range(lights.shape[0])))
    return glare


def _one_way(cosine: FloatArray, a2: np.float32) -> FloatArray:
    return np.asarray(2 * cosine / (cosine + np.sqrt(a2 + (1 - a2) * cosine * cosine)), dtype=np.float32)


@dataclass(frozen=True, slots=True)
class GlareFit:
    """Glare that best explains what no matt surface explains."""

    roughness: float
    """GGX alpha."""
    strength: float
    """Factor on :func:`microfacet_glare`, in the images' units; never negative."""
    explained: float
    """Part of the squared residual that it explains."""


def fit_glare(
    stack: FloatArray,
    lights: FloatArray,
    model: Callable[[float], FloatArray],
    roughnesses: tuple[float, ...] = (0.12, 0.18, 0.24, 0.30, 0.36, 0.42),
) -> GlareFit:
    """Fit strength and roughness of the glare in the images of one band.

    At each pixel a matt surface's images lie in the space that its light vectors span. What is left of the images when
    that space is projected out is compared with what is left of the glare; roughness by search, strength by least
    squares.

    Parameters
    ----------
    stack : (L, n), four lights at least
        Images at n pixels that all lights reach.
    lights : (L, 3, n)
    model : glare (L, n) of strength one for a roughness, as :func:`microfacet_glare`
    roughnesses : values to try
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
