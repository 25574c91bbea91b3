"""A gallery that stays open: what it holds is kept in memory, for threads and across a fork; and enrolment with a look
for the same finger under another name.
"""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from splitknit import AnyPath, BadInput, Progress, no_progress, require
from splitknit_match.gallery import LOG
from splitknit_match.gallery.enrol import MINUTIAE_HASH, Enrolling, Enrolment, enroll_files
from splitknit_match.gallery.entry import Enrolled
from splitknit_match.gallery.file import Unavailable, place_of
from splitknit_match.gallery.gallery import Gallery
from splitknit_match.gallery.identify import Identification, RankedCandidate, identify_finger
from splitknit_match.gallery.identify_job import IdentifyJob
from splitknit_match.gallery.key import Key, key_of
from splitknit_match.gallery.minutia_index import MinutiaIndex
from splitknit_match.matching.code import CODE_VERSION
from splitknit_match.matching.inputs import Side, held
from splitknit_match.matching.match_job import Finger
from splitknit_match.matching.surface import MatchingSettings
from splitknit_match.matching.template import mirrored

Duplicates = Literal["refuse", "warn", "allow"]


class _Kept(Gallery):
    """What a gallery held at one time; threads share it. It reads no file."""

    def __init__(self, of: Gallery, rows: dict[int, bytes], earlier: _Kept | None = None) -> None:
        self.path, self.about, self.version, self.row_versions = of.path, of.about, of.version, rows
        known = {} if earlier is None or earlier.about != of.about else earlier.row_versions
        same = [row for row in rows if known.get(row) == rows[row]]
        self._lock = threading.Lock()
        self._index: MinutiaIndex | None = None if earlier is None else earlier._index
        self._indexed: set[int] | None = set(same)
        if earlier is not None and earlier._indexed is not None:
            self._indexed &= earlier._indexed  # its index was made before it
        self.kept: dict[int, Enrolled] = {}
        self.payloads: dict[int, bytes] = {}
        self.kept_codes: dict[int, bytes] = {}
        if earlier is not None and same:
            for name in ("kept", "payloads", "kept_codes"):
                there = getattr(earlier, name)
                setattr(self, name, {row: there[row] for row in same if row in there})
        new = None if not same else [row for row in rows if row not in self.kept]
        self.kept |= {one.row: one for one in of.entries()} if new is None else of.entries_at(new)
        self.payloads |= of.templates(new)
        each = ((CODE_VERSION,),) if new is None else [(CODE_VERSION, row) for row in new]
        self.kept_codes |= of.contents("code", "code_version = ?" + ("" if new is None else " AND id = ?"), each)

    def __len__(self) -> int:
        return len(self.kept)

    def _all(self) -> list[Enrolled]:
        return list(self.kept.values())

    def entries_at(self, rows: Sequence[int]) -> dict[int, Enrolled]:
        return {row: self.kept[row] for row in rows}

    def without_code(self, version: int) -> list[int]:
        return [row for row in self.kept if row not in self.kept_codes]

    def templates(self, rows: Sequence[int] | None = None) -> dict[int, bytes]:
        return self.payloads if rows is None else {row: self.payloads[row] for row in rows}

    def codes(self, version: int) -> dict[int, bytes]:
        return self.kept_codes

    def minutia_index(self) -> MinutiaIndex:
        with self._lock:
            if self._index is None or self._indexed is not None:
                self._index = MinutiaIndex(self.payloads, self.path, self._index, self._indexed or ())
                self._indexed = None
            return self._index


class OpenGallery:
    """A gallery that stays open, in memory; threads and forked processes may use one object.

    Each call sees what the file holds at that time, also what other programs changed, and whichever file has the name
    then; one that was there and is gone is refused.

    Examples
    --------
    >>> import splitknit_match
    >>> with splitknit_match.OpenGallery.open("people.skg") as gallery:  # doctest: +SKIP
    ...     gallery.enroll(pixels, "Ann", "right_index", resolution_ppi=500)
    ...     found = gallery.identify(other_pixels, resolution_ppi=500)
    """

    def __init__(self, path: AnyPath, key: Key | AnyPath | None = None) -> None:
        """Remember path and key; the file is read with the first call that needs it."""
        self.path, self._key = Path(path), key_of(key)
        self._lock = threading.Lock()
        self._open: Gallery | None = None
        self._kept: _Kept | None = None
        self._seen: int | None = None
        self._place: tuple[int, int] | None = None
        """Of the file that was read last."""
        self._stamp: tuple[int, int] | None = None
        """Its size and the time of its last change."""
        self._pid = os.getpid()

    @classmethod
    def open(cls, path: AnyPath, key: Key | AnyPath | None = None) -> OpenGallery:
        """Open a gallery and read it; one that is not there yet appears with its first finger.

        Raises BadInput as the command line does: no gallery, damaged, the key is missing, wrong or not wanted.
        """
        made = cls(path, key)
        if made.path.exists():
            made._content()
        return made

    def __enter__(self) -> OpenGallery:
        return self

    def __exit__(self, *unused: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the file and what was read."""
        with self._lock:
            if self._pid != os.getpid():
                self._open = None
            self._let_go()
            self._kept = self._place = None

    def __len__(self) -> int:
        """How many captures it holds."""
        return len(self._content()) if self._place is not None or self.path.exists() else 0

    def places(self) -> list[Path]:
        """Files and folders of this machine that a sentence of this gallery may name."""
        counter = None if self._key is None else self._key.counter
        files = [self.path, self.path.resolve(), *([] if counter is None else [counter])]
        beside = [file.with_name(file.name + end) for file in files for end in ("", "-journal", LOG)]
        return [*beside, *(file.parent for file in files)]

    def require_there(self) -> None:
        """Refuse to go on without a file that was there; raises Unavailable."""
        gone = self._place is not None and place_of(self.path) is None
        require(not gone, f"the gallery '{self.path}' is gone (moved or removed); put it back.", Unavailable)

    def _content(self) -> _Kept:
        """What the file holds now; rows that are known already are not read again."""
        self.require_there()
        if self._pid != os.getpid():  # a database must not cross a fork; the lock may be held by a thread left behind
            self._lock, self._open, self._stamp, self._pid = threading.Lock(), None, None, os.getpid()
        with self._lock:
            stamp = _stamp_of(self.path)
            if self._open is not None and self._open.place != place_of(self.path):
                self._let_go()
                self._kept = None
            if self._open is None:
                self._open = Gallery.open(self.path, self._key, shared=True)
            self._place = self._open.place
            try:
                if stamp != self._stamp:  # SQLite tells changes by a counter, which a file copied over it may share
                    self._open.database.execute("PRAGMA shrink_memory")
                    self._open.verified = None
                with self._open.reading() as database:
                    if self._kept is not None and (self._seen, self._stamp) == (self._open.verified, stamp):
                        return self._kept
                    version = "version" if self._open.version > 1 else "NULL"
                    found = database.execute(f"SELECT id, tag, {version}, substr(entry, 1, 32) FROM finger ORDER BY id")
                    rows = {row: b"%b%b%b" % (tag, state or b"", entry) for row, tag, state, entry in found}
                if self._kept is None or (self._kept.about, self._kept.row_versions) != (self._open.about, rows):
                    self._kept = _Kept(self._open, rows, self._kept)
                self._seen, self._stamp = self._open.verified, stamp
            except BadInput:
                self._let_go()
                raise
            return self._kept

    def _let_go(self) -> None:
        if self._open is not None:
            self._open.close()
        self._open = self._stamp = None

    def identify(self, probe: Finger, *, side: Side | None = None, **how: Any) -> Identification:
        """Who is it? `how`: as of :func:`splitknit_match.identify` (``resolution_ppi``, ``top``, ``fmr``, ``person``
        for verification ...). Raises BadInput as it.
        """
        kept = self._content()
        return identify_finger(IdentifyJob(self.path, probe, self._key, **how), warm=kept, side=side)

    def enroll(self, finger_of: Finger | Sequence[Finger], person: str, finger: str, **how: Any) -> Enrolment:
        """Put a finger in; `how`: as of :func:`splitknit_match.enroll` (``session``, ``resolution_ppi`` ...)."""
        self.require_there()
        return enroll(self.path, finger_of, person, finger, key=self._key, opened=self, **how)


def _stamp_of(path: Path) -> tuple[int, int] | None:
    with contextlib.suppress(OSError):
        found = path.stat()
        return found.st_size, found.st_mtime_ns
    return None


def enroll(
    gallery: AnyPath,
    finger_of: Finger | Sequence[Finger],
    person: str,
    finger: str,
    *,
    session: str | None = None,
    key: Key | AnyPath | None = None,
    resolution_ppi: float | None = None,
    duplicates: Duplicates = "warn",
    how: Enrolling | None = None,
    opened: OpenGallery | None = None,
    put_down: Callable[[], None] = lambda: None,
    progress: Progress = no_progress,
) -> Enrolment:
    """Put a finger, or several sessions of one, into a gallery, which is made where there is none; all or none.

    Parameters
    ----------
    gallery : path
    finger_of : path, array (H, W) uint8 of a print, or bytes of a template; or a list of them
    person, finger, session : str
        Finger: such as ``right_index``; session: by default the next number.
    key : path, optional
        File with the key of an encrypted gallery.
    resolution_ppi : float, optional
        Pixels per inch of arrays.
    duplicates : {"refuse", "warn", "allow"}
        What to do about one that matches another person's (of the person's own fingers it is only said),
        at a false match rate of 1 in 10,000 a comparison:
        refuse it, report it (the default), or not look. Where both are prints, only the twentieth whose minutiae
        support it best is compared, so that about 2 in 100 such fingers are missed.
    how : Enrolling, optional
        Preset, settings and what is kept.
    opened : OpenGallery, optional
        The gallery, where it is open already.
    put_down : callable, optional
        Called before what was written is final, such as to write a line into a log; what it raises undoes it.
    progress : callable, optional

    Returns
    -------
    Enrolment

    Raises
    ------
    BadInput
        Naming what is at fault; the gallery is then as before.
    """
    require(duplicates in ("refuse", "warn", "allow"), f"`duplicates` is refuse, warn or allow, not '{duplicates}'.")
    chosen, several = how or Enrolling(), isinstance(finger_of, list | tuple)
    fingers: Sequence[Any] = finger_of if several else [finger_of]  # type: ignore[assignment]
    sources = [held(one, resolution_ppi) for one in fingers]
    warm = OpenGallery(gallery, key) if opened is None else opened
    alike: list[RankedCandidate] = []
    looked: _Kept | None = None
    notes: list[str] = []

    def examine(sides: Sequence[Side]) -> list[str]:
        nonlocal looked, notes
        kept = warm._content()
        if kept is looked:  # nobody changed it since the first look
            return notes
        looked = kept
        alike.clear()
        for side in sides:
            alike.extend(_like_others(kept, side, (person, finger), chosen.matching))
            others = [one for one in alike if one.person != person]
            if others and duplicates == "refuse":
                raise BadInput(
                    f"{side.path} matches {others[0].finger.replace('_', ' ')} of another person, '{others[0].person}'"
                    ", at a false match rate of 1 in 10,000 a comparison; enrol it under that name, or give "
                    "`duplicates` allow."
                )
        notes = [_unlike_itself(kept, side, (person, finger), chosen.matching) for side in sides]
        return notes

    try:
        done = enroll_files(
            Path(gallery), sources, person, finger, session, settings=chosen, key=key_of(key), progress=progress,
            examine=None if duplicates == "allow" else examine, put_down=put_down,
        )  # fmt: skip
    finally:
        if opened is None:
            warm.close()
    return replace(done, alike=tuple(alike))


def _like_others(kept: _Kept, side: Side, who: tuple[str, str], matching: MatchingSettings) -> list[RankedCandidate]:
    """Candidates beyond the limit that are other fingers; none where no rates are known for what is compared.

    `who`: person and finger.
    """
    of_minutiae = kept.settings_sha256 == MINUTIAE_HASH
    if (
        matching != MatchingSettings()
        or all((one.entry.person, one.entry.finger) == who for one in kept.kept.values())
        or (not of_minutiae and side.template is None)
    ):
        return []
    found = identify_finger(IdentifyJob(kept.path, b"", top=5, search="minutiae", merge="finger"), warm=kept, side=side)
    limit = found.decision.threshold if found.decision is not None else float("inf")
    return [one for one in found.candidates if (one.person, one.finger) != who and one.similarity >= limit]


_UNLIKE_FMR = 0.01
"""Of captures that are called unlike each other: so often other fingers are at least as similar, or more often."""


def _unlike_itself(kept: _Kept, side: Side, who: tuple[str, str], matching: MatchingSettings) -> str:
    """A note where a finger matches none of its earlier captures; person and finger are `who`."""
    same = [one for one in kept.kept.values() if (one.entry.person, one.entry.finger) == who and one.template_bytes]
    if not same or matching != MatchingSettings() or side.template is None or kept.settings_sha256 == MINUTIAE_HASH:
        return ""

    def asked(shown: Side) -> Identification:
        return identify_finger(IdentifyJob(kept.path, b"", person=who[0], finger=who[1]), warm=kept, side=shown)

    found = asked(side)
    best = found.candidates[0].fmr if found.candidates else None
    if found.answer != "no match" or best is None or best < _UNLIKE_FMR:
        return ""
    if asked(replace(side, template=mirrored(side.template))).answer == "match":
        return "it matches its earlier captures only in a mirror: the picture is mirrored; turn it round."
    return f"it is unlike the {len(same)} earlier captures of this finger: is it another finger?"
