"""What a record of minutiae holds, whatever the standard in which it is written; codes of fingers and impressions."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require

FINGER_CODES = {
    "unknown": 0,
    "right_thumb": 1,
    "right_index": 2,
    "right_middle": 3,
    "right_ring": 4,
    "right_little": 5,
    "left_thumb": 6,
    "left_index": 7,
    "left_middle": 8,
    "left_ring": 9,
    "left_little": 10,
}
"""Finger positions in all the standards here: ISO/IEC 19794-2 table 2, ANSI/INCITS 378, ANSI/NIST-ITL table 8."""

LATENT_IMPRESSIONS = {"latent_impression": 4, "latent_tracing": 5, "latent_photo": 6, "latent_lift": 7}
FINGER_IMPRESSIONS = {
    "live_plain": 0,
    "live_rolled": 1,
    "nonlive_plain": 2,
    "nonlive_rolled": 3,
    "swipe": 8,
    "optical_contact_plain": 20,
    "optical_contact_rolled": 21,
    "nonoptical_contact_plain": 22,
    "nonoptical_contact_rolled": 23,
    "contactless": 24,
    "contactless_rolled": 25,
    "nonoptical_contactless_plain": 26,
    "nonoptical_contactless_rolled": 27,
    "other": 28,
    "unknown": 29,
    "contactless_rolled_moving": 41,
    "contactless_moving": 42,
}
ITL_IMPRESSIONS = {**FINGER_IMPRESSIONS, **LATENT_IMPRESSIONS}
"""ANSI/NIST-ITL 1-2011 (update 2015), table 7, of single fingers: 24 is a plain print, taken contactless of
a finger at rest; older editions call it live-scan, optical, contactless, plain."""

ANSI_2009_IMPRESSIONS = {name: code for name, code in FINGER_IMPRESSIONS.items() if code <= 29}
"""ANSI/INCITS 378-2009."""

ISO_2005_IMPRESSIONS = {"live_plain": 0, "live_rolled": 1, "nonlive_plain": 2, "nonlive_rolled": 3, "swipe": 8}
"""ISO/IEC 19794-2:2005, table 3. It has no code for contactless prints."""

ANSI_2004_IMPRESSIONS = {**ISO_2005_IMPRESSIONS, "contactless": 9}
"""ANSI/INCITS 378-2004."""

IMPRESSIONS = tuple(ITL_IMPRESSIONS)
"""All names."""


def name_of(code: int, codes: Mapping[str, int], what: str) -> str:
    """Name of a `code` of the table `codes`, BadInput if there is none; `what` it is, for messages.

    >>> name_of(7, FINGER_CODES, "finger position")
    'left_index'
    """
    names = [name for name, known in codes.items() if known == code]
    known = ", ".join(str(value) for value in sorted(codes.values()))
    require(names, f"the {what} {code} is not one of the standard's codes ({known}); correct the record.")
    return names[0]


def standard_code(name: str, codes: Mapping[str, int], what: str) -> int:
    """Code of a `name` in the table `codes`, BadInput if there is none; `what` it is, for messages."""
    require(name in codes, f"the {what} '{name}' has no code here; choose one of {', '.join(codes)}.")
    return codes[name]


OTHER, ENDING, BIFURCATION = 0, 1, 2
"""Types of minutiae, with the codes that all the standards share."""
MAX_MINUTIAE = 255
"""A view of a record cannot count more; those of the highest quality are written."""
VENDOR_UNKNOWN = 0x0103
"""IBIA's number for a producer that has not registered."""
RESOLUTION_500_PPI = (197, 197)
"""500 pixels per inch in pixels per centimetre, rounded as the standards' whole numbers require."""


@dataclass(frozen=True, slots=True, eq=False)
class FingerView:
    """N minutiae of one image of one finger, on the image's pixel grid. The frame is that of the print: column 0 at its
    left, row 0 at its top, seen as ink on paper, as in all the standards here: nothing is turned or mirrored.
    """

    x_px: NDArray[np.int32]
    """(N,) column of a pixel."""
    y_px: NDArray[np.int32]
    """(N,) row, downwards."""
    direction_rad: NDArray[np.float64]
    """(N,) counter-clockwise as seen in the print, 0 to the right: from an ending back along its ridge, from a
    bifurcation between its branches."""
    type: NDArray[np.uint8]
    """(N,) 1 ridge ending, 2 bifurcation, 0 other."""
    quality: NDArray[np.uint8]
    """(N,) 0 (none known) to 100."""
    size: tuple[int, int]
    """(rows, columns) of the image."""
    finger_quality: int
    """0 to 100, the higher the better (such as NFIQ 2)."""
    finger: str = "unknown"
    """``right_thumb`` to ``left_little``, or ``unknown``."""
    impression: str = "contactless"
    """One of :data:`splitknit_match.records.minutiae_record.IMPRESSIONS`."""
    resolution_ppcm: tuple[int, int] = RESOLUTION_500_PPI
    """Pixels per centimetre along columns and rows."""

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self.x_px)

    def best(self, count: int = MAX_MINUTIAE) -> FingerView:
        """Return the `count` minutiae of the highest quality, in the order they have here."""
        order = np.argsort(-np.asarray(self.quality).astype(np.int64), kind="stable")[:count]
        index = np.sort(order)
        names = ("x_px", "y_px", "direction_rad", "type", "quality")
        return dataclasses.replace(self, **{name: getattr(self, name)[index] for name in names})
