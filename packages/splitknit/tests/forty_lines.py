"""A baseline for the shape that shares no code with the package: near lights, least squares, masked
integration."""

from __future__ import annotations

import numpy as np
from scipy import ndimage, sparse
from scipy.sparse.linalg import spsolve

BLOCK = 4
"""Pixels of the image along a pixel of the baseline."""


def blocks(image: np.ndarray) -> np.ndarray:
    """Means over blocks of the last two axes."""
    rows, columns = (length // BLOCK for length in image.shape[-2:])
    cut = image[..., : rows * BLOCK, : columns * BLOCK]
    return cut.reshape(*cut.shape[:-2], rows, BLOCK, columns, BLOCK).mean((-3, -1))


def forty_lines(
    images: np.ndarray, leds_mm: np.ndarray, powers: np.ndarray, mask: np.ndarray, pitch_mm: float
):
    """Height (mm, on blocks) and the blocks' mask, from linear images (L, H, W) of lights at
    `leds_mm` (L, 3)."""
    pitch, inside = pitch_mm * BLOCK, blocks(mask.astype(float)) > 0.999
    seen = blocks(images) / powers[:, None, None]
    y, x = np.mgrid[: inside.shape[0], : inside.shape[1]]
    x = ((x + 0.5) * BLOCK - mask.shape[1] / 2) * pitch_mm
    y = -((y + 0.5) * BLOCK - mask.shape[0] / 2) * pitch_mm
    z = np.full(inside.shape, 3.0)
    for _ in range(4):
        to_led = leds_mm[:, None, None] - np.stack([x, y, z], -1)
        vectors = to_led / np.linalg.norm(to_led, axis=-1, keepdims=True) ** 3
        square = np.einsum("lhwi,lhwj->hwij", vectors, vectors)
        g = np.linalg.solve(square, np.einsum("lhwi,lhw->hwi", vectors, seen)[..., None])[..., 0]
        n = g / np.maximum(np.linalg.norm(g, axis=-1, keepdims=True), 1e-12)
        nz = np.maximum(n[..., 2], 0.12)
        height = integrated(
            -n[..., 0] / nz * pitch,
            n[..., 1] / nz * pitch,
            inside,
            np.clip(n[..., 2], 0.02, 1) ** 2,
        )
        z = np.where(inside, height - height[inside].max() + 5, 3.0)
    return height, inside


def integrated(
    right: np.ndarray, down: np.ndarray, mask: np.ndarray, weight: np.ndarray
) -> np.ndarray:
    """Weighted least squares of the differences between neighbours inside the mask."""
    number = np.full(mask.shape, -1)
    number[mask] = np.arange(mask.sum())
    ends, wanted, trust = [], [], []
    for axis, slope in ((1, right), (0, down)):
        a, b = (np.take(number, range(k, mask.shape[axis] - 1 + k), axis) for k in (0, 1))
        s0, s1, w0, w1 = (
            np.take(f, range(k, mask.shape[axis] - 1 + k), axis)
            for f in (slope, weight)
            for k in (0, 1)
        )
        both = (a >= 0) & (b >= 0)
        ends.append(np.stack([a[both], b[both]]))
        wanted.append(0.5 * (s0 + s1)[both])
        trust.append(np.minimum(w0, w1)[both])
    pairs, steps, weights = np.concatenate(ends, 1), np.concatenate(wanted), np.concatenate(trust)
    rows = np.arange(pairs.shape[1])
    values = np.r_[-np.ones(rows.size), np.ones(rows.size)]
    matrix = sparse.csr_matrix(
        (values, (np.r_[rows, rows], pairs.ravel())), (rows.size, int(mask.sum()))
    )
    normal = matrix.T @ sparse.diags(weights) @ matrix + 1e-8 * sparse.identity(int(mask.sum()))
    height = np.zeros(mask.shape)
    height[mask] = spsolve(normal.tocsc(), matrix.T @ (weights * steps))
    return height


def surface_rms_mm(
    height: np.ndarray, true: np.ndarray, mask: np.ndarray, edge_mm: float, pitch_mm: float
) -> float:
    """Root mean square difference away from the edge, each less its mean."""
    known = mask & np.isfinite(height) & np.isfinite(true)
    inner = ndimage.binary_erosion(known, iterations=max(1, round(edge_mm / pitch_mm)))
    return float((height[inner] - true[inner]).std())
