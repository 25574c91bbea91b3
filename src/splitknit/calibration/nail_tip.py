"""The tip of a cone seen from above, from how its faces are lit."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import BoolArray, FloatArray


def nail_tip(stack: FloatArray, nail: BoolArray, px_per_mm: float) -> NDArray[np.float64]:
    """Find the image of a cone's tip.

    The straight lines on a cone from its tip to its base are each lit alike along their whole length, and all their
    images pass through that of the tip, whatever camera looks on. So brightness changes across them only: its gradient
    g at the pixel p obeys g . (p - tip) = 0. Least squares over all pixels of the cone and all images, weighted anew by
    how well each obeys. Brightness is taken against the mean over the LEDs, which stand evenly around.

    Parameters
    ----------
    stack : (L, H, W) linear light, under another LED each
    nail : (H, W) where the nail is seen
    px_per_mm : scale on the finger plane

    Returns
    -------
    (2,) column and row

    Raises
    ------
    BadInput
        If the nail's faces do not show where its tip is.

    References
    ----------
    R. Parthasarathy, "Rapid, accurate particle tracking by calculation of radial symmetry centers", Nature Methods 9,
    2012, for the same equation turned by 90 deg.
    """
    sigma = max(0.08 * px_per_mm, 0.7)
    margin = round(3.0 * sigma) + 1
    rows, columns = np.nonzero(nail)
    top, left = max(int(rows.min()) - margin, 0), max(int(columns.min()) - margin, 0)
    part = (slice(top, int(rows.max()) + margin + 1), slice(left, int(columns.max()) + margin + 1))
    size = 2 * margin + 1
    inner = cv2.erode(
        nail[part].astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)), borderValue=0
    )
    places = np.argwhere(inner > 0)[:, ::-1].astype(np.float64)
    require(len(places) >= 30, "the nail is too small in the picture for its tip to be found; type the table instead.")
    soft = [cv2.GaussianBlur(np.asarray(image[part], dtype=np.float32), (0, 0), sigma) for image in stack]
    # against the mean of all images, so that the fall-off from the tip, which is nearer to the light, cancels
    mean = np.maximum(np.mean(soft, axis=0), np.float32(1e-6))
    slopes = []
    for image in soft:
        ratio = image / mean
        gradient = np.stack([cv2.Sobel(ratio, cv2.CV_32F, 1, 0), cv2.Sobel(ratio, cv2.CV_32F, 0, 1)], axis=-1)
        slopes.append(gradient[inner > 0])
    g = np.concatenate(slopes).astype(np.float64)  # (L N, 2)
    p = np.tile(places, (len(stack), 1))
    tip = places.mean(axis=0)
    weights = np.ones(len(g))
    scale = float(np.sqrt((g * g).sum(axis=1).mean()))
    require(scale > 0, "the nail shows no shading, so that its tip cannot be found; type the table instead.")
    for _ in range(12):
        # a gradient far from the tip has a longer lever for the same error of its direction
        lever = np.linalg.norm(p - tip, axis=1) + 2.0 * sigma
        w = weights / lever**2
        normal = np.einsum("n,ni,nj->ij", w, g, g)
        right = np.einsum("n,ni,nj,nj->i", w, g, g, p)
        before, tip = tip, np.linalg.solve(normal + 1e-9 * np.trace(normal) * np.eye(2), right)
        off = np.abs(((p - tip) * g).sum(axis=1)) / lever / scale
        weights = 1.0 / (1.0 + (off / (0.1 + 2.0 * float(np.median(off)))) ** 2) ** 2
        if float(np.abs(tip - before).max()) < 1e-3:
            break
    column, row = tip + np.array([left, top])
    inside = 0 <= row < nail.shape[0] and 0 <= column < nail.shape[1] and bool(nail[int(row), int(column)])
    require(inside, "the nail's faces do not show where its tip is; type the table, or photograph a matt cone.")
    return np.array([column, row])
