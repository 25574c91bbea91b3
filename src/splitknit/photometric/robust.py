"""Photometric stereo that leaves out shadowed and glossy lights, pixel by pixel."""

from __future__ import annotations

from typing import Any

import numpy as np

from splitknit.errors import check_lights, check_mask, check_stack
from splitknit.imaging.chunks import for_each_chunk, gather
from splitknit.model import FloatArray
from splitknit.photometric.equations import unit_normals
from splitknit.photometric.weights import RobustSettings, robust_fit


def robust(
    stack: Any, lights: Any, mask: Any = None, settings: RobustSettings | None = None
) -> tuple[FloatArray, FloatArray]:
    """Normals and albedo under distant lights, from the lights that are neither shadowed nor glossy at a pixel.

    Parameters
    ----------
    stack : (L, H, W) float32
        Linear light, one image a light; three at least, and five or more for an effect on highlights.
    lights : (L, 3)
        Directions towards the lights (x right, y up, z to the camera); the length is the relative strength.
    mask : (H, W) bool, optional
        The surface; everything by default.
    settings : RobustSettings, optional

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
    P. W. Holland and R. E. Welsch, "Robust regression using iteratively reweighted least-squares", Communications in
    Statistics A6 (1977), for the weights; S. Ikehata, D. Wipf, Y. Matsushita and K. Aizawa, "Robust photometric stereo
    using sparse regression", CVPR 2012, for the view of shadow and glare as sparse errors.
    """
    return _run(stack, lights, mask, settings, None)


def light_weights(stack: Any, lights: Any, mask: Any = None, settings: RobustSettings | None = None) -> FloatArray:
    """Weights (L, H, W) in [0, 1] that :func:`robust` gives every light; zero outside the mask.

    Parameters are those of :func:`robust`.

    Raises
    ------
    BadInput
        As :func:`robust`.
    """
    count, rows, columns = np.shape(check_stack(stack, least=3))
    weights = np.zeros((count, rows, columns), dtype=np.float32)
    _run(stack, lights, mask, settings, weights)
    return weights


def _run(
    stack: Any, lights: Any, mask: Any, settings: RobustSettings | None, weights: FloatArray | None
) -> tuple[FloatArray, FloatArray]:
    chosen = settings if settings is not None else RobustSettings()
    images = check_stack(stack, least=3)
    count, rows, columns = images.shape
    checked = check_lights(lights, count)
    scale = float(np.linalg.norm(checked, axis=1).mean())
    vectors = (checked / scale).astype(np.float32)
    inside = check_mask(mask, (rows, columns))
    normals = np.zeros((rows, columns, 3), dtype=np.float32)
    albedo = np.full((rows, columns), np.nan, dtype=np.float32)

    def work(chunk: slice) -> None:
        here = inside[chunk]
        if not here.any():
            return
        g, used = robust_fit(gather(images, chunk, here), vectors, chosen)
        unit, length = unit_normals(g)
        normals[chunk][here] = unit.T
        albedo[chunk][here] = length / np.float32(scale)
        if weights is not None:
            weights[:, chunk][:, here] = used

    for_each_chunk(work, rows, columns, count)
    return normals, albedo
