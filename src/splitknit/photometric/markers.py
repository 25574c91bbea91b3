"""Printed dots on an elastomer's coat: found, and bridged in what is measured around them."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import BoolArray, FloatArray

_MARGIN = 0.2
"""Of a dot's diameter that is masked around it: there the dot's edge, blurred by the lens, still darkens the coat."""
_LONGEST = 2.0
"""A dot is no longer than this many diameters, seen obliquely or where two touch; a scratch or a shadow is."""
_LEAST_AREA = 0.15
"""Of a disc of the diameter: what is smaller is noise or dust and is left alone."""
_CONTRAST = 0.25
"""Of a dot against the coat beside it, at least."""
_TRIANGLE = 2.45
"""Half width of a triangular kernel over the standard deviation of the Gaussian that it stands for."""
_ROUNDS = 3
"""Of means over a square: a field that is linear across a hole is then within 0.2 % of its change there."""


def find_markers(light: NDArray[np.floating], diameter_px: float) -> BoolArray:
    """Pixels (H, W) bool that printed dark dots of `diameter_px` (2 at least) cover, their blurred edge included.

    A dot absorbs every colour; a slope that turns from one light is still lit by the others. So a pixel belongs to a
    dot where *all* images of linear `light` (L, H, W), not divided by a flat photograph, are darker than their
    surroundings (the closing of the image by a square of 1.5 diameters) by a quarter or more, and the spot is about as
    large as a dot. Raises BadInput if the diameter is out of range. Source: J. Serra, "Image analysis and mathematical
    morphology", Academic Press 1982, chapter XII (the top-hat transform).

    >>> import numpy as np
    >>> light = np.full((3, 60, 80), 0.5)
    >>> light[:, 20:28, 30:38] = 0.1
    >>> dots = find_markers(light, 8)
    >>> bool(dots[24, 34]), bool(dots[40, 40])
    (True, False)
    """
    shape = np.shape(light)
    require(
        len(shape) == 3 and 2 <= diameter_px <= min(shape[1:]) / 4,
        f"a marker's diameter must lie between 2 pixels and a quarter of the image, but it is {diameter_px:g}.",
    )
    side = 2 * int(0.75 * diameter_px) + 3
    square = np.ones((side, side), np.uint8)
    dark = np.ones(shape[1:], np.bool_)
    for one in light:
        image = cv2.GaussianBlur(np.asarray(one, dtype=np.float32), (0, 0), 0.15 * diameter_px)
        dark &= image < np.float32(1.0 - _CONTRAST) * cv2.morphologyEx(image, cv2.MORPH_CLOSE, square)
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(dark.view(np.uint8), connectivity=4)
    sound = boxes[:, cv2.CC_STAT_AREA] >= _LEAST_AREA * np.pi / 4 * diameter_px**2
    sound &= boxes[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]].max(axis=1) <= _LONGEST * diameter_px
    sound[0] = False  # what is not dark
    if count < 2 or not sound.any():
        return np.zeros(shape[1:], np.bool_)
    margin = 2 * round(_MARGIN * diameter_px) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (margin, margin))
    return cv2.dilate(sound[labels].view(np.uint8), disc).view(np.bool_)


def bridge(fields: NDArray[np.floating], mask: BoolArray, reach_px: float) -> FloatArray:
    """`fields` (N, H, W) float32 whose masked pixels are replaced by means of the others near them.

    The means have a bell-shaped kernel (triangles along rows and columns) of standard deviation `reach_px`, about half
    the diameter of the holes, and inside larger holes of two and four times that and so on, normalised by how much of
    it is not masked. Then each masked pixel becomes the mean of a square around it, a few times over: a field that is
    linear across a hole stays so. Raises BadInput if everything is masked. Source: H. Knutsson and C.-F. Westin,
    "Normalized and differential convolution", CVPR 1993.

    >>> import numpy as np
    >>> hole = np.zeros((30, 30), bool)
    >>> hole[12:16, 12:16] = True
    >>> filled = bridge(np.where(hole, 9.0, 2.0)[None], hole, 2.0)
    >>> round(float(filled.max()), 3)
    2.0
    """
    require(not bool(mask.all()), "no pixel is left beside the markers; check their diameter.")
    result = np.array(fields, dtype=np.float32)
    known, reach = ~mask, reach_px
    while not known.all():
        across = (2 * round(_TRIANGLE * reach) + 1,) * 2  # its cost is the same however wide it is
        weight = cv2.stackBlur(known.astype(np.float32), across)
        filled = ~known & (weight > 0.05)
        for field in result:
            near = cv2.stackBlur(np.where(known, field, np.float32(0.0)), across)
            field[filled] = near[filled] / weight[filled]
        known, reach = known | filled, 2 * reach
    side = 2 * round(0.5 * reach_px) + 3
    for field in result:
        for _ in range(_ROUNDS):
            cv2.copyTo(cv2.blur(field, (side, side)), mask.view(np.uint8), field)
    return result
