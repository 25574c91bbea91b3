"""The usual ways, written plainly, and other libraries, to race against.

Libraries that this project does not need (pyamg, scikit-learn, bob.measure, fingerprint-enhancer,
pyfing) are taken from the folder that SPLITKNIT_PEERS names (``.../site-packages`` of an
environment of its own); without it they sit out.
"""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Callable
from types import ModuleType
from typing import Any

import numpy as np
import scipy.fft
import scipy.sparse
import scipy.sparse.linalg
from numpy.typing import NDArray

Array = NDArray[Any]
if os.environ.get("SPLITKNIT_PEERS"):
    sys.path.append(os.environ["SPLITKNIT_PEERS"])


def library(name: str) -> ModuleType | None:
    """A library to race against; None, which is printed, where it is missing."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        print(f"\n{name} sits out: {error}.")
        return None


def batched_weighted_photometric_stereo(
    stack: Array, lights: Array, threshold: float = 0.02
) -> Array:
    """Shadow-aware: 3 x 3 normal equations of every pixel, by numpy's batched solver."""
    weights = (stack > threshold * stack.max(axis=0)).astype(np.float32)
    vectors = lights.astype(np.float32)
    moments = np.einsum("lhw,li,lj->hwij", weights, vectors, vectors, optimize=True)
    right = np.einsum("lhw,lhw,li->hwi", weights, stack, vectors, optimize=True)
    g = np.linalg.solve(moments + 1e-6 * np.eye(3, dtype=np.float32), right[..., None])[..., 0]
    return np.asarray(g / np.maximum(np.linalg.norm(g, axis=-1, keepdims=True), 1e-9))


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


def pyamg_solver(pyamg: Any, system: tuple[Any, Array], mask: Array) -> Callable[[float], Array]:
    """Masked least squares by Ruge-Stueben algebraic multigrid, matrix and hierarchy at hand,
    double precision."""
    matrix, right_side = system
    grounded = (matrix + 1e-9 * scipy.sparse.identity(matrix.shape[0], format="csr")).tocsr()
    grounded.indices, grounded.indptr = (
        grounded.indices.astype(np.int32),
        grounded.indptr.astype(np.int32),
    )
    hierarchy = pyamg.ruge_stuben_solver(grounded)
    return lambda tolerance: _on_grid(hierarchy.solve(right_side, tol=tolerance, accel="cg"), mask)


def _on_grid(solution: Array, mask: Array) -> Array:
    height = np.full(mask.shape, np.nan)
    height[mask] = solution - solution.mean()
    return height


def shapelets_scale_by_scale(slope_x: Array, slope_y: Array, scales: int) -> Array:
    """Kovesi's way: the transforms of every scale's slant and tilt fields, correlated with the
    surface's."""
    rows, columns = slope_x.shape
    x = scipy.fft.fftfreq(columns, 1 / columns)[None]
    y = -scipy.fft.fftfreq(rows, 1 / rows)[:, None]
    steepness = np.hypot(slope_x, slope_y)
    tilt = np.arctan2(slope_y, slope_x)
    cosine = np.fft.fft2(steepness * np.cos(tilt))
    sine = np.fft.fft2(steepness * np.sin(tilt))
    total = np.zeros(slope_x.shape)
    for k in range(scales):
        sigma = 2.0**k
        bump = np.exp(-(x**2 + y**2) / (2 * sigma**2))
        slant = np.hypot(x, y) / sigma**2 * bump
        direction = np.arctan2(-y, -x)
        total += np.fft.ifft2(np.conj(np.fft.fft2(slant * np.cos(direction))) * cosine).real
        total += np.fft.ifft2(np.conj(np.fft.fft2(slant * np.sin(direction))) * sine).real
    return total * np.log(4) / (4 * np.pi)
