"""Fingers and impression types by name, and their codes in the standards of minutiae and image records."""

from __future__ import annotations

from collections.abc import Mapping

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
"""Of all the standards here: ISO/IEC 19794-2 table 2, ANSI/INCITS 378, ANSI/NIST-ITL table 8."""

ITL_IMPRESSIONS = {
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
"""ANSI/NIST-ITL 1-2011 (update 2015), table 7, as far as single fingers go: 24 is a plain print, taken contactless of a
finger at rest; older editions call it live-scan, optical, contactless, plain."""

ANSI_2009_IMPRESSIONS = {name: code for name, code in ITL_IMPRESSIONS.items() if code <= 29}
"""ANSI/INCITS 378-2009."""

ISO_2005_IMPRESSIONS = {"live_plain": 0, "live_rolled": 1, "nonlive_plain": 2, "nonlive_rolled": 3, "swipe": 8}
"""ISO/IEC 19794-2:2005, table 3. It has no code for contactless prints."""

ANSI_2004_IMPRESSIONS = {**ISO_2005_IMPRESSIONS, "contactless": 9}
"""ANSI/INCITS 378-2004."""

IMPRESSIONS = tuple(ITL_IMPRESSIONS)
"""All names."""


def name_of(code: int, codes: Mapping[str, int], what: str) -> str:
    """Name of a `code` of the table `codes`; `what` it is, for messages.

    Raises
    ------
    BadInput
        If the table does not have it.

    Examples
    --------
    >>> name_of(7, FINGER_CODES, "finger position")
    'left_index'
    """
    names = [name for name, known in codes.items() if known == code]
    known = ", ".join(str(value) for value in sorted(codes.values()))
    require(bool(names), f"the {what} {code} is not one of the standard's codes ({known}); correct the record.")
    return names[0]


def code_of(name: str, codes: Mapping[str, int], what: str) -> int:
    """Code of a `name` in the table `codes`; `what` it is, for messages.

    Raises
    ------
    BadInput
        If the table does not have it.
    """
    require(name in codes, f"the {what} '{name}' has no code here; choose one of {', '.join(codes)}.")
    return codes[name]
