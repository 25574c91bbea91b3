"""Enrolment: captures, results, templates, prints or records of minutiae in, rows of a gallery out.

A gallery appears with its first finger, or not at all. It keeps templates of ridges, or, where a record of minutiae
came first, minutiae: the two cannot be compared.
"""

from __future__ import annotations

import contextlib
import datetime
import hashlib
import io
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from splitknit import (
    FINGERS,
    BadInput,
    Capture,
    Progress,
    Reconstruction,
    encode_print_png,
    file_hash,
    no_progress,
    read_bytes,
    read_capture,
    require,
    settings_hash,
    surface_print,
)
from splitknit_match.gallery.entry import Enrolled, Entry, NewCapture, check_person, check_session
from splitknit_match.gallery.gallery import Gallery
from splitknit_match.gallery.key import Key
from splitknit_match.matching.code import CODE_VERSION, code_of
from splitknit_match.matching.inputs import Held, Pixels, Side, is_of_minutiae, read_side, undoubted
from splitknit_match.matching.methods import side_minutiae
from splitknit_match.matching.minutiae_record import MINUTIAE_VERSION, holds_minutiae, pack_minutiae
from splitknit_match.matching.photo_finger import PhotoFinger
from splitknit_match.matching.surface import MatchingSettings
from splitknit_match.matching.template import VERSION, unpack

if TYPE_CHECKING:
    from splitknit_match.gallery.identify import RankedCandidate


@dataclass(frozen=True, slots=True)
class Enrolling:
    """How fingers are enrolled."""

    preset: str = "metric"
    """By which captures are reconstructed."""
    matching: MatchingSettings = field(default_factory=MatchingSettings)
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


def enroll_files(
    gallery: Path,
    sources: Sequence[Path | Held],
    person: str,
    finger: str,
    session: str | None,
    *,
    settings: Enrolling,
    key: Key | None = None,
    progress: Progress = no_progress,
    examine: Callable[[Sequence[Side]], Sequence[str]] | None = None,
    put_down: Callable[[], None] = lambda: None,
) -> Enrolment:
    """Enrol sources of one finger, as :func:`splitknit_match.enroll` does.

    `session`: by default that of the very same source if it is enrolled already, else the next number. `examine`:
    called with the fingers before anything is written, once beforehand and once while no other program can change the
    gallery; may refuse them, and returns a note on each. `put_down`: called before what was written is final. A source
    other than a template from which nothing was acquired is refused.
    """
    require(len(sources) > 0, "name a capture, a result, a template (.skt), a print or a record of minutiae to enrol.")
    require(len(sources) == 1 or session is None, "`session` goes with one source; several are numbered by themselves.")
    name, finger = check_person(person), known_finger(finger)
    if session is not None:
        check_session(session)
    earlier: list[Enrolled] = []
    with contextlib.ExitStack() as stack:
        of_minutiae = any(is_of_minutiae(source) for source in sources)
        found = opened(gallery, key, settings.matching, of_minutiae=of_minutiae)
        if found is not None:
            earlier = stack.enter_context(found).entries(name, finger)
            of_minutiae = found.settings_sha256 == MINUTIAE_HASH
        made, sides = [], list[Side]()
        for k, source in enumerate(sources):
            made.append(
                _made_of(
                    source, settings, of_minutiae,
                    lambda stage, fraction, k=k: progress(stage, (k + 0.9 * fraction) / len(sources)),  # type: ignore[misc]
                    None if examine is None else sides.append,
                )
            )  # fmt: skip
            lacks = made[-1].failure
            require(
                not lacks or made[-1].kind == "template",
                f"{_name_of(source)} holds {lacks} (failure to acquire), so nothing was enrolled; capture it again.",
            )
        new = []
        taken = {one.entry.session: one.entry.source_sha256 for one in earlier}
        for one in made:
            after = 1 + max((int(number) for number in taken if number.isascii() and number.isdigit()), default=0)
            same = (number for number, source in taken.items() if source == one.source_sha256)  # the very same source
            chosen = session or next(same, str(after))
            taken[chosen] = one.source_sha256
            new.append(new_capture(one, name, finger, chosen, settings))
        sha256 = MINUTIAE_HASH if of_minutiae else templates_hash(settings.matching)
        target = found or stack.enter_context(Gallery.create(gallery, sha256, key))
        target.require_comparable(sha256)
        notes: Sequence[str] = [""] * len(made)
        if examine is not None:
            notes = examine(sides)  # the first look may take long, and holds nobody up
        added = target.add(
            new,
            replace=settings.replace,
            first=lambda: None if examine is None else examine(sides),
            last=put_down,
        )
        content = content_of(target, created=found is None)
    progress("done", 1.0)
    enrolled = tuple(
        EnrolledCapture(
            one.entry.person, one.entry.finger, one.entry.session, one.entry.kind, one.entry.area_mm2,
            bool(one.template), len(one.template), one.entry.images or "none", one.entry.source_sha256, is_new,
            " ".join(filter(None, (of.note, note))) or None,
        )
        for one, is_new, of, note in zip(new, added, made, notes, strict=True)
    )  # fmt: skip
    return Enrolment(content, enrolled)


def opened(gallery: Path, key: Key | None, settings: MatchingSettings, *, of_minutiae: bool = False) -> Gallery | None:
    """Open a gallery that can be changed and takes templates of these settings, or `of_minutiae`.

    Returns None if there is no such file. A gallery of minutiae takes everything, for minutiae can be found in it.
    """
    if not gallery.exists():
        require(gallery.parent.is_dir(), f"there is no folder '{gallery.parent}' for the gallery; make it first.")
        return None
    found = Gallery.open(gallery, key)
    try:
        found.require_version()
        if found.settings_sha256 != MINUTIAE_HASH:
            require(
                not of_minutiae,
                f"'{gallery}' keeps templates of ridges, which records of minutiae cannot be compared with; enrol them "
                "into a gallery of their own.",
            )
            found.require_comparable(templates_hash(settings))
    except BaseException:
        found.close()
        raise
    return found


def known_finger(finger: str) -> str:
    """Return `finger` if it is one of the ten."""
    require(finger in FINGERS, f"'{finger}' is not a finger; fingers are {', '.join(FINGERS)}.")
    return finger


def new_capture(made: Made, person: str, finger: str, session: str, settings: Enrolling) -> NewCapture:
    """Give what was made its names."""
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds") if settings.with_time else ""
    images = "" if made.images is None else settings.keep
    entry = Entry(
        person, finger, session, made.kind, made.source_sha256, made.area_mm2, failure=made.failure, enrolled_at=now,
        images=images,
    )  # fmt: skip
    code = code_of_payload(made.template)
    return NewCapture(entry, made.template, code, None if code is None else CODE_VERSION, made.images)


def content_of(gallery: Gallery, *, created: bool) -> GalleryContent:
    """Return what a gallery holds after an enrolment."""
    rows = gallery.entries()
    entries = [one.entry for one in rows]
    return GalleryContent(
        gallery=str(gallery.path),
        created=created,
        encrypted=gallery.encrypted,
        captures=len(entries),
        fingers=len({(one.person, one.finger) for one in entries}),
        people=len({one.person for one in entries}),
        failures=sum(one.template_bytes == 0 for one in rows),
        settings_sha256=gallery.settings_sha256,
    )


_THUMBNAIL_PPI = 250.0
_NOT_INPUTS = ("truth.npz", ".splitknit")
LARGEST_RAW = 1_000_000_000


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


def _made_of(
    path: Path | Held,
    settings: Enrolling,
    of_minutiae: bool = False,
    progress: Progress = no_progress,
    examine: Callable[[Side], None] | None = None,
) -> Made:
    """Template and facts of one source. Raises BadInput if it cannot be read, or (a capture) not be reconstructed."""
    side = undoubted(
        read_side(path, settings.preset, settings.matching, progress, settings.input_ppi, where=settings.where)
    )
    kept = None if settings.keep == "none" else _kept(path, side, settings.keep)
    minutiae = side_minutiae(side) if of_minutiae else side.minutiae
    if examine is not None:  # of the finger, what is compared
        examine(replace(side, surface=None, picture=None, minutiae=minutiae))
    if of_minutiae:
        assert minutiae is not None
        failure = "" if minutiae.acquired else "fewer than ten minutiae"
        payload = pack_minutiae(minutiae) if minutiae.acquired else b""
        return Made(side.kind, payload, 0.0, source_hash(path), failure, kept, side.note)
    if side.template is None:
        raise BadInput(f"{side.path} holds minutiae, no ridges; enrol it into a gallery of minutiae.")
    empty = side.template.empty
    area = 0.0 if empty else round(side.template.area_mm2, 2)
    failure = (side.template.lacks or "too little skin with ridges") if empty else ""
    return Made(side.kind, side.payload, area, source_hash(path), failure, kept, side.note)


def made_or_failed(path: Path, settings: Enrolling) -> Made | str:
    """As :func:`_made_of`, for many: a capture that is sound but shows no finger is a failure to acquire.

    Returns a sentence, and no row, where the files themselves are unusable.
    """
    try:
        return _made_of(path, settings)
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
    if side.kind == "touches":
        raise BadInput(f"of {_name_of(path)}, a folder of touches, no thumbnail is made; keep `raw` or none.")
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


def templates_hash(settings: MatchingSettings) -> str:
    """SHA-256 of all that a template follows from; templates of one gallery agree in it."""
    document: dict[str, Any] = {"version": VERSION, "band": settings.band, "template": settings.template}
    return settings_hash(document)


MINUTIAE_HASH = settings_hash({"minutiae": MINUTIAE_VERSION})
"""The same of galleries that keep minutiae."""


def code_of_payload(payload: bytes) -> bytes | None:
    """Search code of a row's template; None for a failure to acquire, and for minutiae, which have none."""
    return None if not payload or holds_minutiae(payload) else code_of(unpack(payload)).tobytes()
