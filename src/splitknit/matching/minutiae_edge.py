"""How far inside a print its minutiae lie.

Where a print is cut off, every ridge ends: those ends are the cut's, not the finger's. A contact print fades out there,
and mindtct leaves such places alone; the print of a reconstruction has full contrast up to its outline.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.matching.minutiae_record import PPI, Minutiae
from splitknit.model import FloatArray

EDGE_MM = 0.6
"""Minutiae nearer to the outline are left out: about one and a third ridge periods."""
_PAPER = 235
"""Brighter is paper (or the middle of a valley)."""
_CLOSED_MM, _OPENED_MM = 1.0, 0.6
"""Radii: valleys and small gaps belong to the print, thin lines beside it do not."""


def edge_distance(print_image: NDArray[np.uint8]) -> FloatArray:
    """Distance of every pixel to the print's outline.

    Parameters
    ----------
    print_image : (H, W) uint8 at 500 ppi
        Ridges dark on white paper.

    Returns
    -------
    (H, W) float32
        In mm; 0 on the paper. The image's border is an outline, too: the finger goes on beyond it.
    """
    closed, opened = (round(radius * PPI / 25.4) for radius in (_CLOSED_MM, _OPENED_MM))
    ink = np.pad((print_image < _PAPER).astype(np.uint8), closed + 1)
    area = cv2.morphologyEx(ink, cv2.MORPH_CLOSE, _disc(closed))
    area = np.pad(area[closed + 1 : -closed - 1, closed + 1 : -closed - 1], 1)  # beyond the image is no print
    area = cv2.morphologyEx(area, cv2.MORPH_OPEN, _disc(opened))
    pixels = cv2.distanceTransform(area, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1]
    return np.asarray(pixels * np.float32(25.4 / PPI), dtype=np.float32)


def inside_by(minutiae: Minutiae, distance_mm: FloatArray, least_mm: float) -> Minutiae:
    """The minutiae whose pixel has a `distance_mm` (H, W) of at least `least_mm`."""
    return minutiae.taken(distance_mm[minutiae.y_px, minutiae.x_px] >= least_mm)


def _disc(radius: int) -> NDArray[np.uint8]:
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    return np.asarray(kernel, dtype=np.uint8)
