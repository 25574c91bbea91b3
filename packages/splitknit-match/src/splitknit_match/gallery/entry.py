"""One enrolled capture of a gallery: whose it is, what it came from, and how that is written."""

from __future__ import annotations

import json
import re
import unicodedata
from dataclasses import asdict, dataclass, fields
from typing import Any

from splitknit import BadInput, require

_STEP = 256
"""Names are padded to multiples of this, so that their length does not reveal them."""
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
    template_bytes: int = 0
    """Size of the template, 0 for a failure to acquire; the gallery fills it in."""
    failure: str = ""
    """Why nothing could be acquired, where that is known."""
    enrolled_at: str = ""
    """ISO 8601, UTC; blank where it was not to be kept."""
    images: str = ""
    """``thumbnail`` (a PNG) or ``raw`` (a ZIP of the source), where one is kept."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "person", check_person(self.person))
        require(
            re.fullmatch(r"[a-z0-9_]{1,32}", self.finger) is not None,
            f"{self.finger[:60]!a} cannot be a finger: small letters, digits and _ are expected, such as right_index.",
        )
        check_session(self.session)
        require(self.images in ("", "thumbnail", "raw"), f"images are 'thumbnail' or 'raw', not '{self.images}'.")

    @property
    def words(self) -> str:
        """For people."""
        return f"{self.person}, {self.finger.replace('_', ' ')}, session {self.session}"

    @property
    def names(self) -> bytes:
        """By which a capture is found; no two captures of a gallery share them."""
        return json.dumps([self.person, self.finger, self.session], ensure_ascii=True).encode("ascii")


@dataclass(frozen=True, slots=True)
class Enrolled:
    """A row of a gallery."""

    row: int
    entry: Entry
    code_version: int | None
    """None where no search code is kept."""

    @property
    def template_bytes(self) -> int:
        """Size of the template; 0 for a failure to acquire."""
        return self.entry.template_bytes


@dataclass(frozen=True, slots=True)
class NewCapture:
    """What is put into a gallery."""

    entry: Entry
    template: bytes
    """Payload (:func:`splitknit_match.matching.template.pack`), empty for a failure to acquire."""
    code: bytes | None = None
    code_version: int | None = None
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
    sound = re.fullmatch(r"[A-Za-z0-9_-]{1,32}", text)
    require(
        sound is not None,
        f"{text[:60]!a} cannot be a session: up to 32 letters, digits, - and _ are expected, such as 1.",
    )
    return text


def encode_entry(entry: Entry) -> bytes:
    """JSON in ASCII, padded with spaces."""
    text = json.dumps(asdict(entry), sort_keys=True, separators=(",", ":"), allow_nan=False).encode("ascii")
    return text.ljust(-(-len(text) // _STEP) * _STEP)


def decode_entry(content: bytes) -> Entry:
    """Read what :func:`encode_entry` wrote. Raises BadInput if it is something else."""
    try:
        document: dict[str, Any] = json.loads(content.decode("ascii"))
        kinds: dict[str, type] = {item.name: str for item in fields(Entry)}
        kinds |= {"area_mm2": float, "template_bytes": int}
        require(set(document) == set(kinds), "other fields")
        require(all(isinstance(document[name], kind) for name, kind in kinds.items()), "other kinds")
        return Entry(**document)
    except (ValueError, TypeError, AttributeError, RecursionError) as error:
        raise BadInput("the names of an enrolled finger cannot be read.") from error


def session_order(session: str) -> tuple[int, int, str]:
    """Key to sort sessions by: numbers by their size, before names."""
    number = session.isascii() and session.isdigit()
    return (0, int(session), session) if number else (1, 0, session)
