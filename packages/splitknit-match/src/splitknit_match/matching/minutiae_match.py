"""How similar two sets of minutiae are, whoever found them: those that agree once one is laid on
the other and has drifted as skin slips.

What lies around minutiae proposes how one set lies on the other
(:mod:`splitknit_match.matching.minutia_pairs`). No ridges are known: a set shows what lies in the
hull of its minutiae.
"""

from __future__ import annotations

import math
from functools import lru_cache

import cv2
import numpy as np

from splitknit_match.matching.minutia_pairs import (
    Cylinders,
    Places,
    agreeing,
    drifted,
    on_ridges,
    pair_minutiae,
)
from splitknit_match.matching.ridge import Prepared
from splitknit_match.matching.template import Template
from splitknit_match.records.minutiae_record import PPI, Minutiae

_PITCH_MM = 0.1
"""Pitch of the mask of what a set of minutiae shows."""
_MARGIN_MM = 1.0
"""So far beyond the hull of its minutiae a print is taken to show more. Chosen on: ISO templates of
four FVC sets (validation/match/records.py). Range: 0.5 to 2."""
_FEW = 4.0
"""Minutiae that are added to those that could agree, so that few of few count little. Chosen on:
ISO templates of four FVC sets (validation/match/records.py). Range: 2 to 9."""


def minutiae_match(a: Minutiae, b: Minutiae) -> float:
    """Compare two sets of minutiae: those that agree, over the root of those that could agree and
    four more; different fingers seldom reach 1.5.

    Comparing A with B gives what B with A gives. With fewer than ten minutiae on one side
    (`acquired` is false) nothing is compared, and the score is 0.
    """
    if not (a.acquired and b.acquired):
        return 0.0
    (left, left_hull), (right, right_hull) = sorted(
        (_hull(a), _hull(b)), key=lambda side: side[0].place.tobytes()
    )
    similarity = 0.0
    for pairing in pair_minutiae(left, right):
        laid = pairing.moved(left.place)
        turn = left.turn + pairing.angle_rad
        (shift,) = drifted((laid, turn), (right.place, right.turn), [laid])
        laid = laid + shift @ np.array([1, 1j])
        back = (right.place - pairing.shift_mm) * np.exp(-1j * pairing.angle_rad)
        possible = math.sqrt(_shown(right_hull, laid) * _shown(left_hull, back))
        agree = agreeing((laid, turn), (right.place, right.turn))
        similarity = max(similarity, agree / math.sqrt(possible + _FEW))
    return similarity


def _shown(side: Prepared, place: Places) -> int:
    """How many of some places (N,) a side shows."""
    return int(on_ridges(side.template.valid, side.pixels(place)).sum())


@lru_cache(32)
def _hull(minutiae: Minutiae) -> tuple[Cylinders, Prepared]:
    """Minutiae, in whatever order they come, on a template that shows their hull and no ridges."""
    minutiae = minutiae.taken(
        np.lexsort((minutiae.direction_rad, minutiae.x_px, minutiae.y_px, minutiae.quality))
    )
    step = 25.4 / PPI / _PITCH_MM
    rows, columns = minutiae.size
    corners = np.stack([columns - 1 - minutiae.x_px, minutiae.y_px], axis=1) * step
    valid = np.zeros((math.ceil(rows * step), math.ceil(columns * step)), dtype=np.uint8)
    cv2.fillConvexPoly(valid, cv2.convexHull(np.rint(corners).astype(np.int32)), 1)
    side = 2 * round(_MARGIN_MM / _PITCH_MM) + 1
    shown = cv2.dilate(valid, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))) > 0
    hull = Prepared(Template(np.zeros_like(valid), shown, _PITCH_MM, minutiae))
    assert hull.cylinders is not None
    return hull.cylinders, hull
