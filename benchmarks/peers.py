"""The usual ways, written plainly, to race against."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.fft
import scipy.sparse
import scipy.sparse.linalg
from numpy.typing import NDArray

Array = NDArray[Any]


def pinv_photometric_stereo(stack: Array, lights: Array) -> Array:
    """Normals (H, W, 3) by one pseudo-inverse in one matrix product."""
    count, rows, columns = stack.shape
    g = np.linalg.pinv(lights).astype(np.float32) @ stack.reshape(count, -1)
    return np.ascontiguousarray((g / np.maximum(np.linalg.norm(g, axis=0), 1e-9)).T).reshape(rows, columns, 3)


def batched_weighted_photometric_stereo(stack: Array, lights: Array, threshold: float = 0.02) -> Array:
    """Shadow-aware: 3 x 3 normal equations of every pixel, by numpy's batched solver."""
    weights = (stack > threshold * stack.max(axis=0)).astype(np.float32)
    vectors = lights.astype(np.float32)
    moments = np.einsum("lhw,li,lj->hwij", weights, vectors, vectors, optimize=True)
    right = np.einsum("lhw,lhw,li->hwi", weights, stack, vectors, optimize=True)
    g = np.linalg.solve(moments + 1e-6 * np.eye(3, dtype=np.float32), right[..., None])[..., 0]
    return np.asarray(g / np.maximum(np.linalg.norm(g, axis=-1, keepdims=True), 1e-9))


def frankot_chellappa_plain(slope_x: Array, slope_y: Array) -> Array:
    """Zero-filled Frankot-Chellappa with complex transforms in double precision."""
    wy, wx = np.meshgrid(*(2 * np.pi * np.fft.fftfreq(n) for n in slope_x.shape), indexing="ij")
    square = wx**2 + wy**2
    square[0, 0] = 1
    spectrum = -1j * (wx * np.fft.fft2(slope_x) - wy * np.fft.fft2(slope_y)) / square
    spectrum[0, 0] = 0
    return np.fft.ifft2(spectrum).real


def dct_poisson(slope_x: Array, slope_y: Array) -> Array:
    """Whole rectangle, trapezoidal differences, one cosine transform each way, double precision."""
    right_side = np.zeros(slope_x.shape)
    step = (slope_x[:, 1:] + slope_x[:, :-1]) / 2
    right_side[:, 1:] += step
    right_side[:, :-1] -= step
    step = -(slope_y[1:] + slope_y[:-1]) / 2
    right_side[1:] += step
    right_side[:-1] -= step
    return dct_inverse_laplacian(right_side)


def dct_inverse_laplacian(right_side: Array) -> Array:
    """Negative Laplacian with free borders, inverted on its cosines."""
    values = [2 - 2 * np.cos(np.pi * np.arange(n) / n) for n in right_side.shape]
    eigenvalues = values[0][:, None] + values[1][None]
    eigenvalues[0, 0] = 1
    spectrum = scipy.fft.dctn(right_side, workers=2) / eigenvalues
    spectrum[0, 0] = 0
    return np.asarray(scipy.fft.idctn(spectrum, workers=2))


def masked_system(slope_x: Array, slope_y: Array, mask: Array) -> tuple[Any, Array]:
    """Sparse normal equations of masked least squares, and their right side."""
    index = np.full(mask.shape, -1)
    index[mask] = np.arange(mask.sum())
    right, down = mask[:, 1:] & mask[:, :-1], mask[1:] & mask[:-1]
    first = np.concatenate([index[:, :-1][right], index[:-1][down]])
    second = np.concatenate([index[:, 1:][right], index[1:][down]])
    target = np.concatenate(
        [((slope_x[:, 1:] + slope_x[:, :-1]) / 2)[right], -((slope_y[1:] + slope_y[:-1]) / 2)[down]]
    )
    edge = np.arange(first.size)
    operator = scipy.sparse.csr_matrix(
        (np.repeat([-1.0, 1.0], first.size), (np.tile(edge, 2), np.concatenate([first, second]))),
        shape=(first.size, int(mask.sum())),
    )
    return (operator.T @ operator).tocsr(), operator.T @ target


def masked_cg_dct(slope_x: Array, slope_y: Array, mask: Array, tolerance: float = 1e-6) -> Array:
    """Masked least squares by conjugate gradients with the rectangle's Poisson solver as preconditioner."""
    matrix, right_side = masked_system(slope_x, slope_y, mask)
    start = dct_poisson(slope_x, slope_y)[mask]

    def precondition(residual: Array) -> Array:
        image = np.zeros(mask.shape)
        image[mask] = residual
        return dct_inverse_laplacian(image)[mask]

    inverse = scipy.sparse.linalg.LinearOperator(matrix.shape, matvec=precondition)
    solution, _ = scipy.sparse.linalg.cg(matrix, right_side, x0=start, rtol=tolerance, maxiter=200, M=inverse)
    height = np.full(mask.shape, np.nan)
    height[mask] = solution
    return height


def masked_pyamg(slope_x: Array, slope_y: Array, mask: Array) -> Array:
    """Masked least squares by Ruge-Stueben algebraic multigrid; needs pyamg."""
    import pyamg  # noqa: PLC0415

    matrix, right_side = masked_system(slope_x, slope_y, mask)
    grounded = matrix + 1e-9 * scipy.sparse.identity(matrix.shape[0], format="csr")
    height = np.full(mask.shape, np.nan)
    height[mask] = pyamg.ruge_stuben_solver(grounded).solve(right_side, tol=1e-8, accel="cg")
    return height


def shapelets_scale_by_scale(slope_x: Array, slope_y: Array, scales: int) -> Array:
    """Kovesi's way: the transforms of every scale's slant and tilt fields, correlated with the surface's."""
    rows, columns = slope_x.shape
    x, y = scipy.fft.fftfreq(columns, 1 / columns)[None], -scipy.fft.fftfreq(rows, 1 / rows)[:, None]
    steepness, tilt = np.hypot(slope_x, slope_y), np.arctan2(slope_y, slope_x)
    cosine, sine = np.fft.fft2(steepness * np.cos(tilt)), np.fft.fft2(steepness * np.sin(tilt))
    total = np.zeros(slope_x.shape)
    for k in range(scales):
        sigma = 2.0**k
        bump = np.exp(-(x**2 + y**2) / (2 * sigma**2))
        slant, direction = np.hypot(x, y) / sigma**2 * bump, np.arctan2(-y, -x)
        total += np.fft.ifft2(np.conj(np.fft.fft2(slant * np.cos(direction))) * cosine).real
        total += np.fft.ifft2(np.conj(np.fft.fft2(slant * np.sin(direction))) * sine).real
    return total * np.log(4) / (4 * np.pi)
