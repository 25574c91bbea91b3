"""Views of fingers as ISO/IEC 19794-2:2005 and ANSI/INCITS 378-2004 both write them: 6 bytes and 6 for each minutia."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass

from splitknit.errors import require
from splitknit.io.finger_codes import FINGER_CODES, code_of, name_of
from splitknit.io.fmr_bytes import Cursor, check_rest, decode_minutiae, encode_minutiae, make_view
from splitknit.io.minutiae_record import FingerView

_VIEW = struct.Struct(">BBBB")
_EXTENDED = struct.Struct(">H")


@dataclass(frozen=True, slots=True)
class ViewCodes:
    """In what the two standards differ."""

    standard: str
    steps: int
    """Directions in a turn."""
    impressions: Mapping[str, int]
    nearest: Mapping[str, str]
    """Impression types without a code, and what is written for them."""


def encode_views(views: tuple[FingerView, ...], codes: ViewCodes) -> bytes:
    """Bytes of all views.

    Raises
    ------
    BadInput
        If the standard has no way to say what a view holds.
    """
    return b"".join(_encode_view(view, codes) for view in views)


def decode_views(
    cursor: Cursor, count: int, size: tuple[int, int], resolution_ppcm: tuple[int, int], codes: ViewCodes
) -> tuple[FingerView, ...]:
    """Read `count` views, which must fill the rest of the record.

    Raises
    ------
    BadInput
        If they are truncated or say what the standard does not allow.
    """
    views = []
    for number in range(1, count + 1):
        what, name = f"view {number}", cursor.name
        position, packed, quality, minutiae = cursor.unpack(_VIEW, f"the header of {what}")
        table = decode_minutiae(cursor, minutiae, codes.steps, what)
        (extended,) = cursor.unpack(_EXTENDED, f"the length of the extended data of {what}")
        require(
            quality <= 100 and (minutiae == 0 or int(table["quality"].max()) <= 100),
            f"{name}: a quality of {what} is above 100, the highest.",
        )
        fields = {
            "size": size,
            "finger_quality": quality,
            "finger": name_of(position, FINGER_CODES, f"finger position of {what} of {name}"),
            "impression": name_of(packed & 15, codes.impressions, f"impression type of {what} of {name}"),
            "view": packed >> 4,
            "resolution_ppcm": resolution_ppcm,
            "extended": cursor.take(extended, f"the extended data of {what}"),
        }
        views.append(make_view(name, what, **table, **fields))
    check_rest(cursor, count)
    return tuple(views)


def _encode_view(view: FingerView, codes: ViewCodes) -> bytes:
    require(
        view.finger_quality <= 100,
        f"the finger's quality is {view.finger_quality} (not computed), which {codes.standard} cannot say; give 0 to "
        "100.",
    )
    impression = codes.nearest.get(view.impression, view.impression)
    packed = view.view << 4 | code_of(impression, codes.impressions, "impression type")
    minutiae = encode_minutiae(view, codes.steps, 100)
    head = _VIEW.pack(FINGER_CODES[view.finger], packed, view.finger_quality, view.count)
    return head + minutiae + _EXTENDED.pack(len(view.extended)) + view.extended
