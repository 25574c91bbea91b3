"""Weighted least squares for the albedo-scaled normal g of every pixel, in closed form.

Minimise sum_k w_k (I_k - l_k . g)^2 with M = sum_k w_k l_k l_k^T and b = sum_k w_k I_k l_k: g = M^-1 b, by the
adjugate. Arrays hold pixels along their last axis. Everything is elementwise, so that chunking changes no byte.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitknit.types import FloatArray

RIDGE = np.float32(1e-6)
"""Added to the diagonal of M, relative to its trace: keeps pixels that too few lights reach finite."""

PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def linear_map(matrix: NDArray[np.floating], images: FloatArray) -> FloatArray:
    """`matrix` (3, L) times `images` (L, n), summed light by light."""
    result = np.empty((matrix.shape[0], images.shape[1]), dtype=np.float32)
    term = np.empty(images.shape[1], dtype=np.float32)
    coefficients = matrix.astype(np.float32)
    for row in range(matrix.shape[0]):
        np.multiply(images[0], coefficients[row, 0], out=result[row])
        for k in range(1, images.shape[0]):
            np.multiply(images[k], coefficients[row, k], out=term)
            result[row] += term
    return result


def moment_matrix(lights: FloatArray, weights: FloatArray | None) -> FloatArray:
    """Upper triangle of M, (6, n) in the order of `PAIRS`, from lights (L, 3) or (L, 3, n) and weights (L, n)."""
    per_pixel = lights[..., None] if lights.ndim == 2 else lights
    pixels = per_pixel.shape[2] if weights is None else weights.shape[1]
    result = np.zeros((6, pixels), dtype=np.float32)
    term = np.empty(pixels, dtype=np.float32)
    for k in range(per_pixel.shape[0]):
        weighted = per_pixel[k] if weights is None else per_pixel[k] * weights[k]
        for index, (i, j) in enumerate(PAIRS):
            np.multiply(weighted[i], per_pixel[k, j], out=term)
            result[index] += term
    return result


def moment_vector(images: FloatArray, lights: FloatArray, weights: FloatArray | None) -> FloatArray:
    """b (3, n)."""
    per_pixel = lights[..., None] if lights.ndim == 2 else lights
    result = np.zeros((3, images.shape[1]), dtype=np.float32)
    term = np.empty(images.shape[1], dtype=np.float32)
    for k in range(images.shape[0]):
        image = images[k] if weights is None else images[k] * weights[k]
        for i in range(3):
            np.multiply(image, per_pixel[k, i], out=term)
            result[i] += term
    return result


def inverse(moments: FloatArray) -> FloatArray:
    """Upper triangle of M^-1, (6, n); M is regularised by `RIDGE`."""
    xx, xy, xz, yy, yz, zz = moments
    ridge = RIDGE * (xx + yy + zz) + np.float32(1e-30)
    xx, yy, zz = xx + ridge, yy + ridge, zz + ridge
    result = np.empty_like(moments)
    result[0] = yy * zz - yz * yz
    result[1] = xz * yz - xy * zz
    result[2] = xy * yz - xz * yy
    result[3] = xx * zz - xz * xz
    result[4] = xy * xz - xx * yz
    result[5] = xx * yy - xy * xy
    determinant = xx * result[0] + xy * result[1] + xz * result[2]
    result /= np.maximum(determinant, np.float32(1e-36))
    return result


def apply_inverse(inverse_moments: FloatArray, vector: FloatArray) -> FloatArray:
    """M^-1 b, (3, n)."""
    xx, xy, xz, yy, yz, zz = inverse_moments
    x, y, z = vector
    return np.stack([xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z])


def solve(images: FloatArray, lights: FloatArray, weights: FloatArray | None) -> FloatArray:
    """g (3, n) of `images` (L, n)."""
    return apply_inverse(inverse(moment_matrix(lights, weights)), moment_vector(images, lights, weights))


def shading(g: FloatArray, lights: FloatArray) -> FloatArray:
    """l_k . g, (L, n): negative where the light is behind the surface."""
    per_pixel = lights[..., None] if lights.ndim == 2 else lights
    result = np.empty((per_pixel.shape[0], g.shape[1]), dtype=np.float32)
    for k in range(per_pixel.shape[0]):
        np.multiply(g[0], per_pixel[k, 0], out=result[k])
        result[k] += g[1] * per_pixel[k, 1]
        result[k] += g[2] * per_pixel[k, 2]
    return result


def unit_normals(g: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Unit normals (3, n) and albedo (n,); a pixel without any light faces the camera and has albedo zero."""
    albedo = np.sqrt(g[0] * g[0] + g[1] * g[1] + g[2] * g[2])
    dark = albedo <= 0
    normals = np.asarray(g / np.where(dark, np.float32(1.0), albedo), dtype=np.float32)
    normals[2][dark] = 1.0
    return normals, albedo
