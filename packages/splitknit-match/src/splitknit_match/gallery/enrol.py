"""Enrolment: captures, results, templates, prints or records of minutiae in, rows of a gallery out.

A gallery appears with its first finger, or not at all. It keeps templates of ridges, or, where a record of minutiae
came first, minutiae: the two cannot be compared.
"""

from __future__ import annotations

import datetime
import hashlib
import io
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from splitknit import BadInput, Capture, Reconstruction, read_capture
from splitknit.errors import read_bytes, require
from splitknit.finger.ridges import surface_print
from splitknit.io.prints import encode_print_png
from splitknit.io.provenance import file_hash
from splitknit.model import no_progress
from splitknit.verbs import Progress
from splitknit_match.gallery.entry import Entry, NewCapture, check_person, check_session, known_finger
from splitknit_match.gallery.file import GalleryFile
from splitknit_match.gallery.identify import (
    MINUTIAE_HASH,
    TEMPLATES_HASH,
    Identification,
    RankedCandidate,
    identify_finger,
)
from splitknit_match.gallery.identify_job import IdentifyJob
from splitknit_match.matching.inputs import Held, Pixels, Side, is_of_minutiae, read_side, undoubted
from splitknit_match.matching.methods import side_minutiae
from splitknit_match.matching.minutiae_record import pack_minutiae
from splitknit_match.matching.photo_finger import PhotoFinger
from splitknit_match.matching.template import mirrored

Duplicates = Literal["refuse", "warn", "allow"]
_UNLIKE_FMR = 0.01
"""Of captures that are called unlike each other: so often other fingers are at least as similar, or more often."""
_THUMBNAIL_PPI = 250.0
_NOT_INPUTS = ("truth.npz", ".splitknit")
LARGEST_RAW = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Enrolling:
    """How fingers are enrolled."""

    preset: str = "metric"
    """By which captures are reconstructed."""
    keep: str = "none"
    """``none``, ``thumbnail`` or ``raw``."""
    replace: bool = False
    """Whether a capture takes the place of another of the same names."""
    with_time: bool = False
    """Whether the time of enrolment is kept."""
    input_ppi: float | None = None
    """Resolution of prints whose files do not state it."""
    where: PhotoFinger = field(default_factory=PhotoFinger)
    """Which finger of a photograph."""


@dataclass(frozen=True, slots=True)
class GalleryContent:
    """What a gallery holds after an enrolment."""

    gallery: str
    created: bool
    encrypted: bool
    captures: int
    fingers: int
    people: int
    failures: int
    """Failures to acquire, which match nobody."""
    settings_sha256: str
    """Hash of the settings that its templates were made with."""


@dataclass(frozen=True, slots=True)
class EnrolledCapture:
    """One source that was enrolled."""

    person: str
    finger: str
    session: str
    kind: str
    area_mm2: float
    acquired: bool
    template_bytes: int
    images: str
    """That are kept of it: ``none``, ``thumbnail`` or ``raw``."""
    source_sha256: str
    new: bool
    """False: the very same source was there already."""
    note: str | None = None
    """What was changed of a print on reading, and whether it differs from the finger's earlier captures."""


@dataclass(frozen=True, slots=True)
class Enrolment:
    """What was put into a gallery."""

    content: GalleryContent
    enrolled: tuple[EnrolledCapture, ...]
    alike: tuple[RankedCandidate, ...] = ()
    """Other fingers, also of the same person, that match what was enrolled, best first: is one of them named wrong?"""


def enroll_fingers(
    gallery: GalleryFile,
    sources: Sequence[Path | Held],
    person: str,
    finger: str,
    session: str | None = None,
    *,
    how: Enrolling,
    duplicates: Duplicates = "warn",
    put_down: Callable[[], object] = lambda: None,
    progress: Progress = no_progress,
) -> Enrolment:
    """Enrol sources of one finger, as :func:`splitknit_match.enroll` does.

    `session`: by default that of the very same source if it is enrolled already, else the next number. `put_down`:
    called before what was written is final. A source other than a template from which nothing was acquired is refused.
    """
    require(duplicates in ("refuse", "warn", "allow"), f"`duplicates` is refuse, warn or allow, not '{duplicates}'.")
    require(len(sources) > 0, "name a capture, a result, a template (.skt), a print or a record of minutiae to enrol.")
    require(len(sources) == 1 or session is None, "`session` goes with one source; several are numbered by themselves.")
    name, finger = check_person(person), known_finger(finger)
    if session is not None:
        check_session(session)
    created = not gallery.there
    of_minutiae = settings_of(gallery, how, of_minutiae=any(is_of_minutiae(one) for one in sources)) == MINUTIAE_HASH
    taken = {} if created else {one.session: one.source_sha256 for one in gallery.entries(name, finger)}
    made, new = [], []
    for k, source in enumerate(sources):
        one = made_of(
            source, how, of_minutiae,
            lambda stage, fraction, k=k: progress(stage, (k + 0.9 * fraction) / len(sources)),  # type: ignore[misc]
        )  # fmt: skip
        require(
            not one.failure or one.kind == "template",
            f"{_name_of(source)} holds {one.failure} (failure to acquire), so nothing was enrolled; capture it again.",
        )
        after = 1 + max((int(number) for number in taken if number.isascii() and number.isdigit()), default=0)
        same = (number for number, sha256 in taken.items() if sha256 == one.source_sha256)  # the very same source
        chosen = session or next(same, str(after))
        taken[chosen] = one.source_sha256
        made.append(one)
        new.append(new_capture(one, name, finger, chosen, how))
    looks = _Looks(gallery, [one.side for one in made if one.side is not None], (name, finger), how, duplicates)
    looks.look()  # the first look may take long, and holds nobody up
    sha256 = MINUTIAE_HASH if of_minutiae else TEMPLATES_HASH
    added = gallery.add(new, sha256, replaces=how.replace, first=looks.look, last=put_down)
    content = content_of(gallery, created=created)
    progress("done", 1.0)
    enrolled = tuple(
        EnrolledCapture(
            one.entry.person, one.entry.finger, one.entry.session, one.entry.kind, one.entry.area_mm2,
            bool(one.template), len(one.template), one.entry.images or "none", one.entry.source_sha256, is_new,
            " ".join(filter(None, (of.note, note))) or None,
        )
        for one, is_new, of, note in zip(new, added, made, looks.notes or [""] * len(made), strict=True)
    )  # fmt: skip
    return Enrolment(content, enrolled, tuple(looks.alike))


class _Looks:
    """For the same finger under another name, and another one under the same name."""

    def __init__(
        self, gallery: GalleryFile, sides: list[Side], who: tuple[str, str], how: Enrolling, duplicates: Duplicates
    ) -> None:
        self.gallery, self.sides, self.who, self.duplicates = gallery, sides, who, duplicates
        self.able = duplicates != "allow"
        self.alike: list[RankedCandidate] = []
        self.notes: list[str] = []
        self._seen: object = None

    def look(self) -> None:
        """Look, unless nobody changed the gallery since the last look; may refuse."""
        if not self.able or not self.gallery.there or self.gallery.people() is self._seen:
            return
        people = self._seen = self.gallery.people()
        of_minutiae = people.settings_sha256 == MINUTIAE_HASH
        others = any((one.person, one.finger) != self.who for one in people.entries.values())
        mine = [one for one in people.entries.values() if (one.person, one.finger) == self.who and one.template_bytes]
        self.alike, self.notes = [], []
        for side in self.sides:
            if others and (of_minutiae or side.template is not None):
                self.alike += self._like_others(side)
            unlike = mine and not of_minutiae and side.template is not None
            self.notes.append(self._unlike_itself(side, len(mine)) if unlike else "")

    def _asked(self, side: Side, **how: object) -> Identification:
        job = IdentifyJob(self.gallery.path, b"", **how)  # type: ignore[arg-type]
        return identify_finger(job, gallery=self.gallery, side=side)

    def _like_others(self, side: Side) -> list[RankedCandidate]:
        """Candidates beyond the limit that are other fingers."""
        found = self._asked(side, merge="finger")
        limit = found.decision.threshold if found.decision is not None else float("inf")
        alike = [one for one in found.candidates if (one.person, one.finger) != self.who and one.similarity >= limit]
        others = [one for one in alike if one.person != self.who[0]]
        if others and self.duplicates == "refuse":
            raise BadInput(
                f"{side.path} matches {others[0].finger.replace('_', ' ')} of another person, '{others[0].person}', at "
                "a false match rate of 1 in 10,000 a comparison; enrol it under that name, or give `duplicates` allow."
            )
        return alike

    def _unlike_itself(self, side: Side, count: int) -> str:
        """A note where a finger matches none of its earlier captures."""
        found = self._asked(side, person=self.who[0], finger=self.who[1])
        best = found.candidates[0].fmr if found.candidates else None
        if found.answer != "no match" or best is None or best < _UNLIKE_FMR:
            return ""
        assert side.template is not None
        turned = replace(side, template=mirrored(side.template))
        if self._asked(turned, person=self.who[0], finger=self.who[1]).answer == "match":
            return "it matches its earlier captures only in a mirror: the picture is mirrored; turn it round."
        return f"it is unlike the {count} earlier captures of this finger: is it another finger?"


def settings_of(gallery: GalleryFile, how: Enrolling, *, of_minutiae: bool = False) -> str:
    """Hash of the settings of templates to enrol, `of_minutiae` where a source is a record of them.

    A gallery of minutiae takes everything, for minutiae can be found in it. Raises BadInput if the gallery is of other
    settings, or its folder is missing.
    """
    sha256 = MINUTIAE_HASH if of_minutiae else TEMPLATES_HASH
    if not gallery.there:
        folder = gallery.path.parent
        require(folder.is_dir(), f"there is no folder '{folder}' for the gallery; make it first.")
        return sha256
    own = gallery.settings_sha256
    if own == MINUTIAE_HASH:
        return own
    require(
        not of_minutiae,
        f"'{gallery.path}' keeps templates of ridges, which records of minutiae cannot be compared with; enrol them "
        "into a gallery of their own.",
    )
    gallery.require_comparable(own, sha256)
    return own


def new_capture(made: Made, person: str, finger: str, session: str, how: Enrolling) -> NewCapture:
    """Give what was made its names."""
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds") if how.with_time else ""
    images = "" if made.images is None else how.keep
    entry = Entry(
        person, finger, session, made.kind, made.source_sha256, made.area_mm2, failure=made.failure, enrolled_at=now,
        images=images,
    )  # fmt: skip
    return NewCapture(entry, made.template, made.images)


def content_of(gallery: GalleryFile, *, created: bool) -> GalleryContent:
    """Return what a gallery holds after an enrolment."""
    entries = gallery.entries()
    return GalleryContent(
        gallery=str(gallery.path),
        created=created,
        encrypted=gallery.key is not None,
        captures=len(entries),
        fingers=len({(one.person, one.finger) for one in entries}),
        people=len({one.person for one in entries}),
        failures=sum(one.template_bytes == 0 for one in entries),
        settings_sha256=gallery.settings_sha256,
    )


@dataclass(frozen=True, slots=True)
class Made:
    """What becomes a row of a gallery, but for the names."""

    kind: str
    template: bytes
    area_mm2: float
    source_sha256: str
    failure: str = ""
    images: bytes | None = None
    note: str | None = None
    side: Side | None = None
    """What is compared of it."""


def made_of(path: Path | Held, how: Enrolling, of_minutiae: bool = False, progress: Progress = no_progress) -> Made:
    """Template and facts of one source. Raises BadInput if it cannot be read, or (a capture) not be reconstructed."""
    side = undoubted(read_side(path, how.preset, progress, how.input_ppi, where=how.where))
    kept = None if how.keep == "none" else _kept(path, side, how.keep)
    minutiae = side_minutiae(side) if of_minutiae else side.minutiae
    compared = replace(side, surface=None, picture=None, minutiae=minutiae)
    if of_minutiae:
        assert minutiae is not None
        failure = "" if minutiae.acquired else "fewer than ten minutiae"
        payload = pack_minutiae(minutiae) if minutiae.acquired else b""
        return Made(side.kind, payload, 0.0, source_hash(path), failure, kept, side.note, compared)
    if side.template is None:
        raise BadInput(f"{side.path} holds minutiae, no ridges; enrol it into a gallery of minutiae.")
    empty = side.template.empty
    area = 0.0 if empty else round(side.template.area_mm2, 2)
    failure = (side.template.lacks or "too little skin with ridges") if empty else ""
    return Made(side.kind, side.payload, area, source_hash(path), failure, kept, side.note, compared)


def made_or_failed(path: Path, how: Enrolling) -> Made | str:
    """As :func:`made_of`, for many: a capture that is sound but shows no finger is a failure to acquire.

    Returns a sentence, and no row, where the files themselves are unusable.
    """
    try:
        return replace(made_of(path, how), side=None)
    except BadInput as error:
        if not (path / "capture.json").is_file() or (path / "height.npz").is_file():
            return str(error)
        try:
            read_capture(path)
        except BadInput as unread:
            return str(unread)
        said = str(error).removeprefix(f"{path}: ")
        return Made("capture", b"", 0.0, source_hash(path), failure=said)


def source_hash(path: Path | Held) -> str:
    """SHA-256 of a source: of a file, or of names and hashes of the files of a capture (without its truth)."""
    if isinstance(path, Capture | Reconstruction):
        raise BadInput("a capture or a result is enrolled from its folder; give its path, or the bytes of a template.")
    if not isinstance(path, Path):
        return path.sha256 if isinstance(path, Pixels) else hashlib.sha256(path).hexdigest()
    files = _files(path)
    if files == [path]:
        return file_hash(path)
    lines = [f"{file_hash(file)}  {file.relative_to(path).as_posix()}\n" for file in files]
    return hashlib.sha256("".join(lines).encode("utf-8")).hexdigest()


def _files(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    if (path / "height.npz").is_file():
        return [path / "height.npz"]
    return sorted(file for file in path.rglob("*") if file.is_file() and file.name not in _NOT_INPUTS)


def _name_of(source: Path | Held) -> str:
    return f"'{source}'" if isinstance(source, Path) else "what was given"


def _kept(path: Path | Held, side: Side, keep: str) -> bytes | None:
    """PNG of the relief as a print, or ZIP of the source's files; None for the print of a template, which has none."""
    if keep == "raw":
        if not isinstance(path, Path):
            raise BadInput("an array has no files to keep; keep a thumbnail.")
        return _zipped(path)
    if side.kind in ("template", "minutiae"):
        return None
    if side.picture is not None:
        rows, columns = side.picture.shape
        size = (max(1, columns // 2), max(1, rows // 2))
        small = cv2.resize(side.picture, size, interpolation=cv2.INTER_AREA)
        return encode_print_png(small.astype(np.uint8), _THUMBNAIL_PPI)
    assert side.surface is not None
    return encode_print_png(surface_print(side.surface, _THUMBNAIL_PPI), _THUMBNAIL_PPI)


def _zipped(path: Path) -> bytes:
    files = _files(path)
    total = sum(file.stat().st_size for file in files)
    require(total <= LARGEST_RAW, f"the files of '{path}' have {total} bytes, too many to keep; keep a thumbnail.")
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED) as archive:
        for file in files:
            name = file.name if file == path else file.relative_to(path).as_posix()
            archive.writestr(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), read_bytes(file, LARGEST_RAW))
    return stream.getvalue()
