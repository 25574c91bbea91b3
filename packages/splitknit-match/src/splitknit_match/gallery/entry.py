"""One enrolled capture of a gallery: whose it is, and what it came from."""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass

from splitknit.errors import require
from splitknit.io.enrolment import FINGERS

LONGEST_NAME = 100
"""Characters of a person's name, at most."""


@dataclass(frozen=True, slots=True)
class Entry:
    """What is known of an enrolled capture beside its template."""

    person: str
    """1 to 100 printable characters."""
    finger: str
    """Small letters, digits and _ ."""
    session: str
    """Letters, digits, - and _ ."""
    kind: str
    """``capture``, ``result``, ``template`` or ``print``."""
    source_sha256: str
    """Hash of the files that it was made from."""
    area_mm2: float = 0.0
    """Area of skin in the template; 0 for a failure to acquire."""
    failure: str = ""
    """Why nothing could be acquired, where that is known."""
    enrolled_at: str = ""
    """ISO 8601, UTC; blank where it was not to be kept."""
    images: str = ""
    """``thumbnail`` (a PNG) or ``raw`` (a ZIP of the source), where one is kept."""
    template_bytes: int = 0
    """Size of the template, 0 for a failure to acquire; the gallery fills it in, and what follows."""
    template_sha256: str = ""
    row: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "person", check_person(self.person))
        require(
            re.fullmatch(r"[a-z0-9_]{1,32}", self.finger) is not None,
            f"{self.finger[:60]!a} cannot be a finger: small letters, digits and _ are expected, such as right_index.",
        )
        check_session(self.session)
        require(0 <= self.area_mm2 <= 1e6, f"area_mm2 must be a number from 0 to a million, not {self.area_mm2}.")
        require(self.images in ("", "thumbnail", "raw"), f"images are 'thumbnail' or 'raw', not {self.images[:60]!a}.")

    @property
    def names(self) -> tuple[str, str, str]:
        """By which a capture is found; no two captures of a gallery share them."""
        return self.person, self.finger, self.session

    @property
    def words(self) -> str:
        """For people."""
        return f"{self.person}, {self.finger.replace('_', ' ')}, session {self.session}"


@dataclass(frozen=True, slots=True)
class NewCapture:
    """What is put into a gallery."""

    entry: Entry
    template: bytes
    """Payload (:func:`splitknit_match.matching.template.pack`), empty for a failure to acquire."""
    images: bytes | None = None


def check_person(text: str) -> str:
    """Return `text` in one normal form (NFC) if it can be a person's name. Raises BadInput."""
    name = unicodedata.normalize("NFC", text).strip()
    sound = 0 < len(name) <= LONGEST_NAME and name.isprintable()
    shown = text.encode("unicode_escape").decode("ascii")[:60]
    require(sound, f"'{shown}' cannot be a person's name: 1 to {LONGEST_NAME} printable characters are expected.")
    return name


def check_session(text: str) -> str:
    """Return `text` if it can be a session's name."""
    require(
        re.fullmatch(r"[A-Za-z0-9_-]{1,32}", text) is not None,
        f"{text[:60]!a} cannot be a session: up to 32 letters, digits, - and _ are expected, such as 1.",
    )
    return text


def known_finger(finger: str) -> str:
    """Return `finger` if it is one of the ten."""
    require(finger in FINGERS, f"'{finger}' is not a finger; fingers are {', '.join(FINGERS)}.")
    return finger


def session_order(session: str) -> tuple[int, int, str]:
    """Key to sort sessions by: numbers by their size, before names."""
    number = session.isascii() and session.isdigit()
    return (0, int(session), session) if number else (1, 0, session)
