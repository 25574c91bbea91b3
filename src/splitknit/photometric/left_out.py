"""Photometric stereo once for every light that is left out, from one least-squares problem."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from splitknit.errors import check_lights, check_mask, check_stack, require
from splitknit.model import FloatArray
from splitknit.photometric.equations import linear_map, shading, unit_normals

LEAST_REST = 1e-3
"""Least share of a light's own direction that the other lights still determine; 1 minus its leverage."""


def left_out(stack: Any, lights: Any, mask: Any = None) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Normals and albedo of a matt surface from all images but one, for every image in its turn.

    Leaving out a row of a least-squares problem is a rank-one change of its normal equations. With A = L^T L, g the
    solution of all images and h_k = l_k . A^-1 l_k the leverage of light k, the solution without image k is
    g_k = g - A^-1 l_k (I_k - l_k . g) / (1 - h_k): one scaled picture is added, nothing is solved again. What is kept
    between two turns is g and the L residuals, the size of the stack and three pictures more.

    Parameters
    ----------
    stack : (L, H, W) float32
        Linear light, one image a light; four at least.
    lights : (L, 3)
        Directions towards the lights (x right, y up, z to the camera); the length is the relative strength.
    mask : (H, W) bool, optional
        The surface; everything by default.

    Yields
    ------
    normals : (H, W, 3) float32
        Without image k, k = 0 ... L - 1: as :func:`splitknit.photometric.lambertian` of the other images gives them,
        but for rounding.
    albedo : (H, W) float32

    Raises
    ------
    BadInput
        If shapes or numbers disagree, the lights are fewer than four, or the others lie in one plane when one of them
        is left out.

    References
    ----------
    Q. Zheng, A. Kumar and G. Pan, "Contactless 3D fingerprint identification without 3D reconstruction", IWBF 2018: the
    leave-one-out sets. J. Sherman and W. Morrison, "Adjustment of an inverse matrix corresponding to a change in one
    element of a given matrix", Annals of Mathematical Statistics 21 (1950).
    """
    images = check_stack(stack, least=4)
    count, rows, columns = images.shape
    vectors = check_lights(lights, count)
    inside = check_mask(mask, (rows, columns))
    inverse = np.linalg.inv(vectors.T @ vectors)
    leverage = np.einsum("ki,ij,kj->k", vectors, inverse, vectors)
    alone = int(np.argmax(leverage))
    require(
        bool(leverage[alone] < 1.0 - LEAST_REST),
        f"without image {alone} the lights lie in one plane, so that no normals follow from the others; add a light.",
    )
    where = inside.ravel()
    seen = images.reshape(count, -1)[:, where]
    whole = linear_map(inverse @ vectors.T, seen)
    residuals = seen - shading(whole, vectors.astype(np.float32))
    for k in range(count):
        step = (inverse @ vectors[k] / (1.0 - leverage[k])).astype(np.float32)
        unit, length = unit_normals(whole - step[:, None] * residuals[k])
        normals = np.zeros((rows * columns, 3), dtype=np.float32)
        albedo = np.full(rows * columns, np.nan, dtype=np.float32)
        normals[where], albedo[where] = unit.T, length
        yield normals.reshape(rows, columns, 3), albedo.reshape(rows, columns)
