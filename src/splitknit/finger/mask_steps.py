"""The finger's mask in two steps, where time counts: roughly where it is, and its outline around that."""

from __future__ import annotations

import cv2
import numpy as np

from splitknit.errors import require
from splitknit.finger.mask import (
    BLUR_MM,
    NO_FINGER,
    MaskSettings,
    check_borders,
    check_image,
    coarse_mask,
    fine_outline,
)
from splitknit.finger.regions import blur, reduce_image, reduction
from splitknit.model import BoolArray, FloatArray

FEW_SAMPLES = 2000
"""Pixels to which the backdrop is fitted where time counts."""


def finger_region(mean_image: FloatArray, px_per_mm: float, settings: MaskSettings | None = None) -> BoolArray:
    """Find roughly where the finger is: what :func:`finger_mask` does first, in a fraction of its time.

    Parameters, result and what is refused are those of :func:`finger_mask`; the outline is good to the pitch of the
    coarse copy (``coarse_px_per_mm``). :func:`finger_outline` makes it exact.
    """
    settings = settings or MaskSettings()
    image = check_image(mean_image)
    height, width = image.shape[:2]
    require(np.isfinite(px_per_mm) and px_per_mm > 0, "px_per_mm must be a positive number.")
    scale = reduction((height, width), px_per_mm, settings.coarse_px_per_mm, 600)
    coarse = blur(reduce_image(image, scale), 0.5 * BLUR_MM * px_per_mm * scale)
    mask = coarse_mask(coarse, px_per_mm * scale, FEW_SAMPLES)
    check_borders(mask)
    full = cv2.resize(mask.astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR) > 0.5
    return np.asarray(full, dtype=np.bool_)


def finger_outline(
    mean_image: FloatArray, rough: BoolArray, px_per_mm: float, settings: MaskSettings | None = None
) -> BoolArray:
    """Find the outline of a finger that is roughly known, as :func:`finger_mask` does in the end.

    Parameters
    ----------
    mean_image : (H, W, 3) or (H, W) float32
        The finger and at least three times ``edge_margin_mm`` of backdrop around it, save where it leaves the image.
    rough : (h, w) bool
        The finger on the same piece of the scene, at any scale.
    px_per_mm : float
        Of `mean_image`.
    settings : MaskSettings, optional

    Returns
    -------
    mask : (H, W) bool
        One component without holes.

    Raises
    ------
    BadInput
        If nothing stands out from the backdrop there.
    """
    settings = settings or MaskSettings()
    image = check_image(mean_image)
    height, width = image.shape[:2]
    require(bool(rough.any()), NO_FINGER)
    scale = reduction((height, width), px_per_mm, settings.fine_px_per_mm, 1200)
    fine = reduce_image(image, scale)
    return fine_outline(fine, rough, (height, width), px_per_mm * scale, FEW_SAMPLES)
