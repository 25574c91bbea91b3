"""NIST's bozorth3 through nbis-py (x86-64 Linux): a peer of the matcher of minutiae.

Source: C. I. Watson et al., "User's Guide to NIST Biometric Image Software (NBIS)", NIST 2007.
"""

from __future__ import annotations

import struct

import numpy as np

from splitknit_match.prints.minutiae import extractor
from splitknit_match.records.minutiae_record import BIFURCATION, Minutiae

MOST = 200
"""bozorth3 compares no more minutiae (its MAX_BOZORTH_MINUTIAE)."""


def bozorth3(a: Minutiae, b: Minutiae) -> float:
    """About how many pairs of minutiae fit together, the larger of both directions; 0 for failures
    to acquire."""
    if not (a.acquired and b.acquired):
        return 0.0
    sides = [extractor(quality=False).load_iso_19794_2_2005(_exchanged(side)) for side in (a, b)]
    return float(sides[0].compare(sides[1]))


def _exchanged(minutiae: Minutiae) -> bytes:
    """Minutiae as nbis-py reads them: its own dialect of ISO/IEC 19794-2, its only input format.

    bozorth3 needs them sorted by column: it stops looking for neighbours at the first that is too
    far to the right, and nbis-py leaves the order as it comes. Their quality plays no part beyond
    the choice of the best.
    """
    best = minutiae.best(MOST)
    best = best.taken(np.lexsort((best.y_px, best.x_px)))
    x = best.x_px | (np.where(best.type == BIFURCATION, 2, 1) << 14)
    angle = np.round(best.direction_rad * (128 / np.pi)).astype(np.int64) % 256
    body = np.rec.fromarrays(
        [x, best.y_px, angle, np.full(best.count, 50)], ">u2, >u2, u1, u1"
    ).tobytes()
    rows, columns = best.size
    return (
        b"FMR\0 20\0"
        + struct.pack(">IxxHHxxxxxxxB", 26 + len(body), columns, rows, best.count)
        + body
    )
