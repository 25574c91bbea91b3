"""Minutiae of a print by NIST's mindtct, and NFIQ 2, both through `nbis-py`.

This is the only module that imports it. It exists for x86-64 Linux alone; elsewhere :func:`extract`
reports it.
"""

from __future__ import annotations

import threading
from functools import lru_cache
from typing import Any

import cv2
import numpy as np

from splitknit.errors import importing, require
from splitknit.model import FloatArray, GreyArray
from splitknit_match.prints.ridge_field import closed_opened, outline_distance_mm
from splitknit_match.records.minutiae_record import (
    BIFURCATION,
    ENDING,
    LARGEST_MM2,
    PPI,
    Minutiae,
    no_minutiae,
)

# How far inside a print its minutiae lie.
#
# Where a print is cut off, every ridge ends: those ends are the cut's, not the finger's. A contact
# print fades out there, and mindtct leaves such places alone; the print of a reconstruction has
# full contrast up to its outline.


def edge_distance_mm(print_image: GreyArray) -> FloatArray:
    """(H, W) distance of every pixel to the print's outline, 0 on the paper.

    `print_image`: (H, W) uint8 at 500 ppi, ridges dark on white paper. The image's border is an
    outline, too: the finger goes on beyond it.
    """
    # mm: valleys and small gaps belong to the print, thin lines beside it do not
    closed, opened = (round(radius * PPI / 25.4) for radius in (1.0, 0.6))
    # brighter is paper, or the middle of a valley
    area = closed_opened(print_image < 235, closed, opened, closed + 1, cv2.BORDER_CONSTANT)
    return outline_distance_mm(area, PPI)


NFIQ2_FAILED = 255
"""What ISO/IEC 29794-1 gives for a quality that could not be computed. Source: ISO/IEC 29794-1."""
_LOCK = threading.Lock()
"""mindtct and NFIQ 2 keep state of their own."""
EDGE_MM = 0.6
"""Minutiae nearer to the outline are left out: about one and a third ridge periods. Chosen on:
simulated fingers (1,200 pairs of 20 fingers). Range: 0.4 and more."""
_MINDTCT_SIDE_PX = 64
"""A smaller image (3.3 mm at 500 ppi) holds no print; mindtct, given very small ones, ends the
whole process."""


def extract(print_image: GreyArray, ppi: float = PPI, *, edge_mm: float = EDGE_MM) -> Minutiae:
    """Find the minutiae of a print (H, W) uint8, ridges dark, with mindtct: at most 150, by column
    and row.

    None where there are no ridges: a failure to acquire. Other resolutions than 500 ppi are
    resampled first. Minutiae nearer to the print's outline than `edge_mm` are left out, for there
    every ridge ends. Raises BadInput if the image or the resolution is of another kind, or
    `nbis-py` is not installed.

    Source: C. I. Watson et al., "User's Guide to NIST Biometric Image Software (NBIS)", NIST 2007:
    MINDTCT.
    """
    image = at_500_ppi(print_image, ppi)
    if min(image.shape) < _MINDTCT_SIDE_PX:
        return no_minutiae(image.shape)
    with _LOCK:
        minutiae = extractor(False).extract_minutiae(_png(image)).get()
    rows = [(m.x(), m.y(), m.angle(), m.kind().value, m.reliability()) for m in minutiae]
    if not rows:
        return no_minutiae(image.shape)
    x, y, angle, kind, reliability = np.array(rows, dtype=float).T
    every = Minutiae(
        x.astype(np.int32),
        y.astype(np.int32),
        np.deg2rad(angle % 360.0),
        np.where(kind == _module().MinutiaKind.BIFURCATION.value, BIFURCATION, ENDING).astype(
            np.uint8
        ),
        np.clip(np.round(100 * reliability), 0, 100).astype(np.uint8),
        image.shape,
    )
    return every.taken(edge_distance_mm(image)[every.y_px, every.x_px] >= edge_mm)


def nfiq2(print_image: GreyArray, ppi: float = PPI) -> int:
    """NIST Fingerprint Image Quality 2 of a print (H, W) uint8: 0 (useless) to 100, or 255 where it
    sees no print.

    Raises BadInput as :func:`extract`.

    Source: ISO/IEC 29794-4:2017; E. Tabassi et al., "NIST Fingerprint Image Quality 2", NIST IR
    8382, 2021.
    """
    image = at_500_ppi(print_image, ppi)
    if min(image.shape) < _MINDTCT_SIDE_PX:
        return NFIQ2_FAILED
    with _LOCK:
        try:
            return int(extractor(True).extract_minutiae(_png(image)).quality().score)
        except _module().NbisError.Nfiq2ComputeFailed:
            return NFIQ2_FAILED


def is_a_fingers(print_image: GreyArray, ppi: float) -> bool:
    """Whether a print (H, W) is no larger than one finger's."""
    return print_image.size * (25.4 / ppi) ** 2 <= LARGEST_MM2


def at_500_ppi(print_image: GreyArray, ppi: float) -> GreyArray:
    """Resample a print (H, W) uint8 to 500 ppi; the size is checked first.

    Raises BadInput if the image or the resolution is of another kind, or the print is larger than a
    finger's.
    """
    image = np.asarray(print_image)
    require(
        image.ndim == 2 and image.size > 0 and image.dtype == np.uint8,
        f"a print must be (H, W) uint8, ridges dark, but it is {image.shape} {image.dtype}.",
    )
    require(
        np.isfinite(ppi) and 100 <= ppi <= 5000,
        f"ppi must lie between 100 and 5000, but it is {ppi}.",
    )
    rows, columns = (round(side * PPI / ppi) for side in image.shape)
    height_mm, width_mm = (side * 25.4 / ppi for side in image.shape)
    require(
        is_a_fingers(image, ppi),
        f"a print of {width_mm:.0f} x {height_mm:.0f} mm is larger than a finger's"
        f" ({LARGEST_MM2:.0f} mm²); crop one finger, or correct the resolution.",
    )
    if (rows, columns) == image.shape or min(rows, columns) < 1:
        return np.ascontiguousarray(image)
    kind = cv2.INTER_AREA if ppi > PPI else cv2.INTER_CUBIC
    return cv2.resize(image, (columns, rows), interpolation=kind).astype(np.uint8)


def _png(image: GreyArray) -> bytes:
    return cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes()


def _module() -> Any:
    with importing(
        "minutiae need nbis-py, which exists for x86-64 Linux: pip install"
        " 'splitknit-match[minutiae]' there; elsewhere compare with the method ridge."
    ):
        import nbis  # type: ignore[import-untyped,import-not-found,unused-ignore]  # 40 MB
    return nbis


@lru_cache(maxsize=2)
def extractor(quality: bool) -> Any:
    """nbis-py's extractor; `quality`: of NFIQ 2, too."""
    nbis = _module()
    return nbis.new_nbis_extractor(
        nbis.NbisExtractorSettings(
            min_quality=0.0,
            get_center=False,
            check_fingerprint=False,
            compute_nfiq2=quality,
            ppi=PPI,
        )
    )
