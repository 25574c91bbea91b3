"""Photometric stereo where two lights of one exposure nearly cancel: slopes that the lights hardly tell stay near the
shape's."""

from __future__ import annotations

import numpy as np

from splitknit.imaging.geometry import height_gradients, normals_from_gradients
from splitknit.model import FloatArray
from splitknit.skin.grid import Grid
from splitknit.skin.light import FineLight


def held_normals(  # noqa: PLR0917
    stack: FloatArray, light: FineLight, smooth_mm: FloatArray, grid: Grid, prior: float, chunk: int = 64
) -> FloatArray:
    """(C, h, w, 3) brightness times normal: least squares over the lights, slopes held near the shape's.

    An LED and its image in a mirror that leans by 45 deg lie on both sides of the mirror's plane: together they tell
    little of the slope towards it. Minimises

        sum_k w_k (I_k - L_k g)^2 + prior mean(w) |t|^2,

    t the part of g across the shape's normal.

    Parameters
    ----------
    stack : (C, L, h, w) images over the light that enters
    light : on the smooth surface
    smooth_mm : (h, w)
    prior : variance of the images' relative error over that of the slopes; zero holds nothing
    """
    channels, count = stack.shape[:2]
    slopes = (grid.smooth(s, grid.mask, 0.3) for s in height_gradients(smooth_mm, grid.pitch_mm))
    normals = np.moveaxis(normals_from_gradients(*slopes), -1, 0)  # (3, h, w)
    weights = light.trust * light.entering * light.entering
    result = np.zeros((channels, *grid.shape, 3), dtype=np.float32)
    for start in range(0, grid.shape[0], chunk):
        rows = slice(start, start + chunk)
        here = grid.mask[rows]
        if not here.any():
            continue
        v = light.vectors[:, :, rows][:, :, here].astype(np.float64)  # (L, 3, n)
        w = weights[:, rows][:, here].astype(np.float64)
        n = normals[:, rows][:, here].astype(np.float64)  # (3, n)
        across = np.eye(3)[:, :, None] - n[:, None] * n[None]
        hold = prior * np.maximum(w.sum(axis=0), 1e-3) / count
        matrix = np.einsum("ln,lin,ljn->nij", w, v, v) + np.moveaxis(hold * across, -1, 0) + 1e-6 * np.eye(3)
        right = np.einsum("ln,cln,lin->nic", w, stack[:, :, rows][:, :, here].astype(np.float64), v)
        solved = np.linalg.solve(matrix, right)  # (n, 3, C)
        for c in range(channels):
            result[c, rows][here] = solved[:, :, c]
    return result
