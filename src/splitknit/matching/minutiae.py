"""Minutiae of a print by NIST's mindtct, their comparison by bozorth3, and NFIQ 2, all through `nbis-py`.

This is the only module that imports it. It exists for x86-64 Linux alone; elsewhere :func:`extract` says so.
"""

from __future__ import annotations

import struct
import threading
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, require
from splitknit.matching.minutiae_edge import EDGE_MM, edge_distance, inside_by
from splitknit.matching.minutiae_enhance import enhance_print
from splitknit.matching.minutiae_record import (
    BIFURCATION,
    ENDING,
    LARGEST_SIDE_PX,
    MOST_MINUTIAE,
    PPI,
    Minutiae,
    no_minutiae,
)

NFIQ2_FAILED = 255
"""What ISO/IEC 29794-1 gives for a quality that could not be computed."""
LEAST_SIDE_PX = 64
"""A smaller image (3.3 mm at 500 ppi) holds no print; mindtct, given very small ones, ends the whole process."""
_LOCK = threading.Lock()
"""mindtct and NFIQ 2 keep state of their own."""


def extract(
    print_image: NDArray[np.uint8],
    ppi: float = PPI,
    enhance: bool = False,
    *,
    edge_mm: float | None = None,
) -> Minutiae:
    """Find the minutiae of a print with mindtct.

    Parameters
    ----------
    print_image : (H, W) uint8
        Ridges dark, as ink on paper.
    ppi : float
        Its resolution; other ones than 500 are resampled first.
    enhance : bool
        Whether the print is enhanced first: for prints that were pressed on glass or paper. Without, it is taken as it
        is: right for the relief prints of reconstructions, whose contrast is even.
    edge_mm : float, optional
        Minutiae nearer to the print's outline are left out, for there every ridge ends. By default
        :data:`splitknit.matching.minutiae_edge.EDGE_MM` for prints taken as they are, and 0 after `enhance`: pressed
        prints fade out at their border, and mindtct looks after it.

    Returns
    -------
    Minutiae
        At most 150, the most reliable ones, by column and row. None where there are no ridges: a failure to acquire.

    Raises
    ------
    BadInput
        If the image or the resolution is of another kind, or `nbis-py` is not installed.

    References
    ----------
    C. I. Watson et al., "User's Guide to NIST Biometric Image Software (NBIS)", NIST 2007: MINDTCT.
    """
    image = _at_500_ppi(print_image, ppi)
    if min(image.shape) < LEAST_SIDE_PX:
        return no_minutiae((image.shape[0], image.shape[1]))
    if enhance:
        image = enhance_print(image)
    with _LOCK:
        found = _extractor(False).extract_minutiae(_png(image)).get()
    rows = [(m.x(), m.y(), m.angle(), m.kind().value, m.reliability()) for m in found]
    if not rows:
        return no_minutiae((image.shape[0], image.shape[1]))
    x, y, angle, kind, reliability = (np.array(column) for column in zip(*rows, strict=True))
    every = Minutiae(
        x.astype(np.int32),
        y.astype(np.int32),
        np.deg2rad(angle % 360.0),
        np.where(kind == _module().MinutiaKind.BIFURCATION.value, BIFURCATION, ENDING).astype(np.uint8),
        np.clip(np.round(100 * reliability), 0, 100).astype(np.uint8),
        (image.shape[0], image.shape[1]),
    )
    least = edge_mm if edge_mm is not None else (0.0 if enhance else EDGE_MM)
    return inside_by(every, edge_distance(image), least) if least > 0 else every


def minutiae_match(a: Minutiae, b: Minutiae) -> float:
    """Compare two sets of minutiae with bozorth3: about the number of pairs of minutiae that fit together.

    Comparing A with B gives what B with A gives: the larger of both directions. Different fingers seldom reach 40. With
    fewer than ten minutiae on one side (`acquired` is false) nothing is compared, and the score is 0.

    References
    ----------
    C. I. Watson et al., "User's Guide to NIST Biometric Image Software (NBIS)", NIST 2007: BOZORTH3.
    """
    if not (a.acquired and b.acquired):
        return 0.0
    extractor = _extractor(False)
    sides = [extractor.load_iso_19794_2_2005(_exchanged(side)) for side in (a, b)]
    return float(sides[0].compare(sides[1]))


def nfiq2(print_image: NDArray[np.uint8], ppi: float = PPI) -> int:
    """NIST Fingerprint Image Quality 2 of a print (H, W) uint8: 0 (useless) to 100, or 255 where it sees no print.

    Raises
    ------
    BadInput
        As :func:`extract`.

    References
    ----------
    ISO/IEC 29794-4:2017; E. Tabassi et al., "NIST Fingerprint Image Quality 2", NIST IR 8382, 2021.
    """
    image = _at_500_ppi(print_image, ppi)
    if min(image.shape) < LEAST_SIDE_PX:
        return NFIQ2_FAILED
    with _LOCK:
        try:
            return int(_extractor(True).extract_minutiae(_png(image)).quality().score)
        except _module().NbisError.Nfiq2ComputeFailed:
            return NFIQ2_FAILED


def _exchanged(minutiae: Minutiae) -> bytes:
    """Minutiae as `nbis-py` reads them: its own dialect of ISO/IEC 19794-2, its only way in.

    bozorth3 needs them sorted by column: it stops looking for neighbours at the first that is too far to the right, and
    `nbis-py` leaves the order as it comes. Their quality plays no part beyond the choice of the best.
    """
    order = np.lexsort((minutiae.y_px, minutiae.x_px))
    if minutiae.count > MOST_MINUTIAE:
        best = np.argsort(-minutiae.quality.astype(np.int64), kind="stable")[:MOST_MINUTIAE]
        order = order[np.isin(order, best)]
    table = np.zeros(len(order), dtype=[("x", ">u2"), ("y", ">u2"), ("angle", "u1"), ("quality", "u1")])
    kind = np.where(minutiae.type[order] == BIFURCATION, 2, 1)
    table["x"] = minutiae.x_px[order] | (kind << 14)
    table["y"] = minutiae.y_px[order]
    table["angle"] = np.round(minutiae.direction_rad[order] * (128 / np.pi)).astype(np.int64) % 256
    table["quality"] = 50
    body = table.tobytes()
    rows, columns = minutiae.size
    head = b"FMR\0 20\0" + struct.pack(">IxxHHxxxxxxxB", 26 + len(body), columns, rows, len(order))
    return head + body


def _at_500_ppi(print_image: NDArray[np.uint8], ppi: float) -> NDArray[np.uint8]:
    image = np.asarray(print_image)
    require(
        image.ndim == 2 and image.size > 0 and image.dtype == np.uint8,
        f"a print must be (H, W) uint8, ridges dark, but it is {image.shape} {image.dtype}.",
    )
    require(bool(np.isfinite(ppi)) and 100 <= ppi <= 5000, f"ppi must lie between 100 and 5000, but it is {ppi}.")
    rows, columns = (round(side * PPI / ppi) for side in image.shape)
    require(
        max(rows, columns) <= LARGEST_SIDE_PX,
        f"a print of {rows} x {columns} pixels at 500 ppi is larger than {LARGEST_SIDE_PX}; check its resolution.",
    )
    if (rows, columns) == image.shape or min(rows, columns) < 1:
        return np.ascontiguousarray(image)
    way = cv2.INTER_AREA if ppi > PPI else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(image, (columns, rows), interpolation=way), dtype=np.uint8)


def _png(image: NDArray[np.uint8]) -> bytes:
    return bytes(cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes())


def _module() -> Any:
    try:
        import nbis  # type: ignore[import-untyped,import-not-found,unused-ignore]  # noqa: PLC0415 - 40 MB
    except (ImportError, OSError) as error:
        raise BadInput(
            "minutiae need nbis-py, which exists for x86-64 Linux: pip install 'splitknit[minutiae]' there; elsewhere "
            "compare with the method ridge."
        ) from error
    return nbis


@lru_cache(maxsize=2)
def _extractor(quality: bool) -> Any:
    nbis = _module()
    return nbis.new_nbis_extractor(
        nbis.NbisExtractorSettings(
            min_quality=0.0, get_center=False, check_fingerprint=False, compute_nfiq2=quality, ppi=PPI
        )
    )
