"""The thesis's photometric stereo: least squares over all lights, the same for every pixel."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from splitknit.errors import check_lights, check_mask, check_stack, require
from splitknit.imaging.chunks import gather
from splitknit.model import FloatArray
from splitknit.photometric.equations import linear_map, shading, surface_by_chunks, unit_normals


def lambertian(stack: Any, lights: Any, mask: Any = None) -> tuple[FloatArray, FloatArray]:
    """Normals and albedo of a matt surface under distant lights, by least squares over all images.

    Shadows and highlights are taken for shading; :func:`splitknit.photometric.robust` leaves them out.

    Parameters
    ----------
    stack : (L, H, W) float32
        Linear light, one image a light; three at least.
    lights : (L, 3)
        Directions towards the lights (x right, y up, z to the camera); the length is the relative strength.
    mask : (H, W) bool, optional
        The surface; everything by default.

    Returns
    -------
    normals : (H, W, 3) float32
        Unit vectors; zero outside the mask, (0, 0, 1) where all images are black.
    albedo : (H, W) float32
        In units of the images at a light of strength one; NaN outside the mask.

    Raises
    ------
    BadInput
        If shapes or numbers disagree, values are not finite, or the lights are fewer than three, duplicate or coplanar.

    References
    ----------
    R. J. Woodham, "Photometric method for determining surface orientation from multiple images", Optical Engineering 19
    (1980); the thesis, section 3.2.3.

    Examples
    --------
    >>> import numpy as np
    >>> lights = np.array([[0.0, 0.6, 0.8], [0.6, 0.0, 0.8], [0.0, 0.0, 1.0]])
    >>> stack = np.tile((0.5 * lights @ [0.0, 0.0, 1.0])[:, None, None], (1, 2, 2))
    >>> normals, albedo = lambertian(stack, lights)
    >>> np.round(normals[0, 0], 3).tolist(), round(float(albedo[0, 0]), 3)
    ([0.0, 0.0, 1.0], 0.5)
    """
    images = check_stack(stack, least=3)
    count, rows, columns = images.shape
    vectors = check_lights(lights, count)
    inside = check_mask(mask, (rows, columns))
    inverse = np.linalg.pinv(vectors)  # (3, L)
    return surface_by_chunks(inside, count, lambda chunk, here: linear_map(inverse, gather(images, chunk, here)))


# Photometric stereo once for every light that is left out, from one least-squares problem.

MIN_REST = 1e-3
"""Minimum fraction of a light's own direction that the other lights still determine; 1 minus its leverage."""


def left_out(stack: Any, lights: Any, mask: Any = None) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Normals and albedo of a matt surface from all images but one, for every image in its turn.

    Yields normals (H, W, 3) and albedo (H, W) without image k, k = 0 ... L - 1: as :func:`lambertian` of the other
    images gives them, but for rounding. Leaving out a row of a least-squares problem is a rank-one change of its normal
    equations: with A = L^T L, g the solution of all images and h_k = l_k . A^-1 l_k the leverage of light k, it is
    g_k = g - A^-1 l_k (I_k - l_k . g) / (1 - h_k). Parameters as of :func:`lambertian`, but four images at least.
    Raises BadInput if shapes or numbers disagree, the lights are fewer than four, or the others lie in one plane when
    one of them is left out.

    Source: Q. Zheng, A. Kumar and G. Pan, "Contactless 3D fingerprint identification without 3D reconstruction", IWBF
    2018: the leave-one-out sets. J. Sherman and W. Morrison, "Adjustment of an inverse matrix corresponding to a change
    in one element of a given matrix", Annals of Mathematical Statistics 21 (1950).
    """
    images = check_stack(stack, least=4)
    count, rows, columns = images.shape
    vectors = check_lights(lights, count)
    inside = check_mask(mask, (rows, columns))
    inverse = np.linalg.inv(vectors.T @ vectors)
    leverage = np.einsum("ki,ij,kj->k", vectors, inverse, vectors)
    alone = int(np.argmax(leverage))
    require(
        leverage[alone] < 1.0 - MIN_REST,
        f"without image {alone} the lights lie in one plane, so that no normals follow from the others; add a light.",
    )
    where = inside.ravel()
    measured = images.reshape(count, -1)[:, where]
    whole = linear_map(inverse @ vectors.T, measured)
    residuals = measured - shading(whole, vectors.astype(np.float32))
    for k in range(count):
        step = (inverse @ vectors[k] / (1.0 - leverage[k])).astype(np.float32)
        unit, length = unit_normals(whole - step[:, None] * residuals[k])
        normals = np.zeros((rows * columns, 3), dtype=np.float32)
        albedo = np.full(rows * columns, np.nan, dtype=np.float32)
        normals[where], albedo[where] = unit.T, length
        yield normals.reshape(rows, columns, 3), albedo.reshape(rows, columns)
