"""A gallery to enrol into and to search: :class:`splitknit_match.Gallery`,
:func:`splitknit_match.enroll`.

Captures, results, templates, prints or records of minutiae go in. A gallery appears with its first
finger, or not at all. It keeps templates of ridges, or, where a record of minutiae came first,
minutiae: the two cannot be compared.
"""

from __future__ import annotations

import datetime
import hashlib
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from splitknit import BadInput, Capture, Reconstruction
from splitknit.arguments import AnyPath, Natural, Preset, Ridges, checked
from splitknit.errors import require
from splitknit.findings import Finding, Severity, worst_first
from splitknit.io.provenance import file_hash
from splitknit.model import Progress, no_progress
from splitknit_match.gallery.file import (
    Entry,
    GalleryFile,
    Key,
    NewCapture,
    check_person,
    check_session,
    in_words,
    known_finger,
)
from splitknit_match.gallery.identify import (
    MINUTIAE_HASH,
    TEMPLATES_HASH,
    Identification,
    Merge,
    RankedCandidate,
    identify_finger,
)
from splitknit_match.matching.inputs import (
    Held,
    Pixels,
    Side,
    held,
    is_of_minutiae,
    read_side,
    side_reader,
    undoubted,
    with_print,
)
from splitknit_match.matching.match import Finger
from splitknit_match.matching.methods import side_minutiae
from splitknit_match.matching.results import one_in
from splitknit_match.matching.ridge import Prepared
from splitknit_match.matching.template import mirrored
from splitknit_match.prints.photo_finger import PhotoFinger
from splitknit_match.records.minutiae_record import pack_minutiae
from splitknit_match.threads import one_blas_thread

_log = logging.getLogger(__name__)

Duplicates = Literal["refuse", "warn", "allow"]
_NOT_INPUTS = ("truth.npz", ".splitknit")


@dataclass(frozen=True, slots=True)
class Enrolling:
    """How fingers are enrolled."""

    preset: str = "metric"
    """By which captures are reconstructed."""
    replace: bool = False
    """Whether a capture takes the place of another of the same names."""
    with_time: bool = False
    """Whether the time of enrolment is kept."""
    resolution_ppi: float | None = None
    """Resolution of prints whose files do not state it."""
    ridges: Ridges = None
    """``dark`` or ``light`` ridges of prints, where it is known."""
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
    source_sha256: str
    new: bool
    """False: the very same source was there already."""
    chance: float | None = None
    """That another impression of the finger, about as large, matches it; None of what is no
    print."""


@dataclass(frozen=True, slots=True)
class Enrolment:
    """What was put into a gallery."""

    content: GalleryContent
    enrolled: tuple[EnrolledCapture, ...]
    alike: tuple[RankedCandidate, ...] = ()
    """Other fingers, also of the same person, that match what was enrolled, best first: is one of
    them named wrong?"""
    findings: tuple[Finding, ...] = ()
    """What was changed of prints on reading, or is in doubt of them, failures to acquire, and
    whether they differ from the finger's earlier captures, or match others; worst first."""


@dataclass(frozen=True, slots=True)
class Made:
    """What becomes a row of a gallery, but for the names."""

    kind: str
    template: bytes = field(repr=False)
    area_mm2: float
    source_sha256: str
    failure: str = ""
    findings: tuple[Finding, ...] = ()
    side: Side | None = field(default=None, repr=False)
    """What is compared of it."""


class Gallery(GalleryFile):
    """A gallery that stays open, in memory; threads and forked processes may use one object.

    Each call sees what the file holds at that time, also what other programs changed, and whichever
    file has the name then; one that was there and is gone is refused. One that is not there yet
    appears with its first finger. Iteration gives what is known of each capture
    (:class:`splitknit_match.gallery.file.Entry`).

    Examples
    --------
    >>> import splitknit_match
    >>> with splitknit_match.Gallery("people.skg") as gallery:  # doctest: +SKIP
    ...     gallery.enroll(pixels, "Ann", "right_index", resolution_ppi=500)
    ...     people = {capture.person for capture in gallery}
    ...     identification = gallery.identify(probe, resolution_ppi=500)
    ...     gallery.remove("Ann", "right_index")
    """

    def check(self) -> GalleryContent:
        """What it holds, once all of it could be read. Raises BadInput if it cannot be used."""
        self.people()
        return content_of(self, created=False)

    @checked
    def identify(
        self,
        probe: Finger,
        *,
        top: Natural = 10,
        person: str | None = None,
        finger: str | None = None,
        fmr: float | None = None,
        merge: Merge = "person",
        resolution_ppi: float | None = None,
        ridges: Ridges = None,
        preset: Preset = "metric",
        progress: Progress = no_progress,
    ) -> Identification:
        """Who is it? Arguments, and what is raised, as of :func:`splitknit_match.identify`."""
        return identify_finger(
            self,
            side_reader(probe, preset, resolution_ppi, ridges),
            top=top,
            person=person,
            finger=finger,
            fmr=fmr,
            merge=merge,
            progress=progress,
        )

    @checked
    def enroll(
        self,
        finger_of: Finger | Sequence[Finger],
        person: str,
        finger: str,
        *,
        session: str | None = None,
        resolution_ppi: float | None = None,
        ridges: Ridges = None,
        duplicates: Duplicates = "warn",
        how: Enrolling | None = None,
        put_down: Callable[[], object] = lambda: None,
        progress: Progress = no_progress,
    ) -> Enrolment:
        """Put a finger, or several sessions of one, in; as :func:`splitknit_match.enroll`.

        `session`: by default that of the very same source if it is enrolled already, else the next
        number. `put_down`: called before what was written is final, such as to write a line into a
        log; what it raises undoes it. A source other than a template from which nothing was
        acquired is refused.
        """
        one_blas_thread()
        how = how or Enrolling()
        ppi = how.resolution_ppi if resolution_ppi is None else resolution_ppi
        several = finger_of if isinstance(finger_of, list | tuple) else [finger_of]
        ridges = ridges or how.ridges
        sources = [held(source, ppi, ridges) for source in several]
        if any(isinstance(source, Pixels) for source in sources):
            ppi = ridges = None  # beside arrays they are theirs
        how = replace(how, resolution_ppi=ppi, ridges=ridges)
        kinds = "a capture, a result, a template (.skt), a print or a record of minutiae"
        require(sources, f"name {kinds} to enrol.")
        require(
            len(sources) == 1 or session is None,
            "`session` goes with one source; several are numbered by themselves.",
        )
        person, finger = check_person(person), known_finger(finger)
        if session is not None:
            check_session(session)
        created = not self.there
        settings_sha256 = settings_of(
            self, of_minutiae=any(is_of_minutiae(source) for source in sources)
        )
        rows = []
        for number, source in enumerate(sources):

            def part(stage: str, fraction: float, number: int = number) -> None:
                progress(stage, (number + 0.9 * fraction) / len(sources))

            row = made_of(source, how, settings_sha256 == MINUTIAE_HASH, part)
            name = f"'{source}'" if isinstance(source, Path) else "what was given"
            require(
                not row.failure or row.kind == "template",
                f"{name} holds {row.failure} (failure to acquire), so nothing was enrolled; capture"
                " it again.",
            )
            rows.append(row)
        earlier = [] if created else self.entries(person, finger)
        sessions = _sessions(rows, earlier, session)
        captures = [
            new_capture(row, person, finger, its, how)
            for row, its in zip(rows, sessions, strict=True)
        ]
        sides = [row.side for row in rows if row.side is not None]
        review = _Review(self, sides, (person, finger), duplicates)
        review.look()  # the first look may take long, and holds nobody up

        def last() -> None:
            progress("done", 1.0)
            put_down()

        added = self.add(
            captures, settings_sha256, replaces=how.replace, first=review.look, last=last
        )
        _log.info("enrolled %d captures, %d of them new", len(added), sum(added))
        enrolled = [
            EnrolledCapture(
                *row.entry.names,
                row.entry.kind,
                row.entry.area_mm2,
                row.template != b"",
                len(row.template),
                row.entry.source_sha256,
                is_new,
                None if side.template is None else side.template.chance,
            )
            for row, is_new, side in zip(captures, added, sides, strict=True)
        ]
        findings = [finding for row in rows for finding in row.findings]
        findings += [finding for each in enrolled if each.new for finding in _shortcoming(each)]
        return Enrolment(
            content_of(self, created=created),
            tuple(enrolled),
            tuple(review.alike),
            worst_first([*findings, *review.findings]),
        )


def enroll(
    gallery: AnyPath,
    finger_of: Finger | Sequence[Finger],
    person: str,
    finger: str,
    *,
    session: str | None = None,
    key: Key | AnyPath | None = None,
    resolution_ppi: float | None = None,
    ridges: Ridges = None,
    duplicates: Duplicates = "warn",
    how: Enrolling | None = None,
    progress: Progress = no_progress,
) -> Enrolment:
    """Put a finger, or several sessions of one, into a gallery, which is made where there is none;
    all or none.

    Parameters
    ----------
    gallery : path
    finger_of : path, array (H, W) uint8 of a print, or bytes of a template; or a list of them
    person, finger, session : str
        Finger: such as ``right_index``; session: by default the next number.
    key : path, optional
        File with the key of an encrypted gallery.
    resolution_ppi : float, optional
        Pixels per inch of arrays; where none is an array, of the files.
    ridges : {"dark", "light"}, optional
        As of :func:`splitknit_match.match`.
    duplicates : {"refuse", "warn", "allow"}
        What to do about one that matches another person's (of the person's own fingers it is only
        said), at a false match rate of 1 in 10,000 a comparison (of small prints at the smallest
        measured): refuse it, report it (the default), or not look. Of more than 200 captures those
        whose minutiae agree best are compared, so that about 1 in 100 such fingers is missed.
    how : Enrolling, optional
        Preset, settings and what is kept.
    progress : callable, optional

    Returns
    -------
    Enrolment

    Raises
    ------
    BadInput
        Naming what is at fault; the gallery is then as before.
    """
    return Gallery(gallery, key).enroll(
        finger_of,
        person,
        finger,
        session=session,
        resolution_ppi=resolution_ppi,
        ridges=ridges,
        duplicates=duplicates,
        how=how,
        progress=progress,
    )


_DISSIMILAR_FMR = 0.01
"""False match rate from which on captures of one finger are called dissimilar: so often other
fingers are at least as similar."""


class _Review:
    """Looks for the same finger under another name, and for another finger under the same name."""

    def __init__(
        self, gallery: Gallery, sides: list[Side], names: tuple[str, str], duplicates: Duplicates
    ) -> None:
        self.gallery, self.sides, self.names, self.duplicates = gallery, sides, names, duplicates
        self.alike: list[RankedCandidate] = []
        self.findings: list[Finding] = []
        self._seen: object = None

    def look(self) -> None:
        """Look, unless nobody changed the gallery since the last look; may refuse."""
        if (
            self.duplicates == "allow"
            or not self.gallery.there
            or self.gallery.people() is self._seen
        ):
            return
        people = self._seen = self.gallery.people()
        of_minutiae = people.settings_sha256 == MINUTIAE_HASH
        acquired = people.of(None, None).acquired
        owners = [(entry.person, entry.finger) for entry in acquired]
        earlier = owners.count(self.names)
        self.alike, self.findings = [], []
        for side in self.sides:
            if len(owners) > earlier and (of_minutiae or side.template is not None):
                alike = self._duplicates(side)
                self.alike += alike
                self.findings += [_alike(candidate, self.names[0]) for candidate in alike]
            if earlier and not of_minutiae and side.template is not None:
                self.findings += self._dissimilar(side, earlier)

    def _duplicates(self, side: Side) -> list[RankedCandidate]:
        """Candidates beyond the threshold that are other fingers."""
        identification = identify_finger(self.gallery, lambda _: side, merge="finger")
        decision = identification.decision
        alike = [
            candidate
            for candidate in identification.candidates
            if decision is not None
            and candidate.similarity >= decision.threshold
            and (candidate.person, candidate.finger) != self.names
        ]
        others = [candidate for candidate in alike if candidate.person != self.names[0]]
        if others and decision is not None and self.duplicates == "refuse":
            whose = f"{others[0].finger.replace('_', ' ')} of another person, '{others[0].person}'"
            raise BadInput(
                f"{side.path} matches {whose}, at a false match rate of {one_in(decision.fmr)} a"
                " comparison;"
                " enrol it under that name, or give `duplicates` allow."
            )
        return alike

    def _dissimilar(self, side: Side, count: int) -> list[Finding]:
        """A finding where a finger matches none of its earlier captures."""
        person, finger = self.names
        own = identify_finger(self.gallery, lambda _: side, person=person, finger=finger)
        fmr = own.candidates[0].fmr if own.candidates else None
        if own.answer != "no match" or fmr is None or fmr < _DISSIMILAR_FMR:
            return []
        assert side.template is not None
        turned = replace(side, template=mirrored(side.template))
        mirror = identify_finger(self.gallery, lambda _: turned, person=person, finger=finger)
        code = "mirrored-print"
        words = (
            "it matches its earlier captures only in a mirror: the picture is mirrored; turn it"
            " round."
        )
        if mirror.answer != "match":
            code = "unlike-earlier"
            words = (
                f"it is unlike the {count} earlier captures of this finger: is it another finger?"
            )
        return [Finding(code, words, Severity.DOUBT).of_file(side.path)]


def _alike(candidate: RankedCandidate, person: str) -> Finding:
    """That a finger of a person matches another one."""
    who = in_words(candidate.person, candidate.finger, candidate.session)
    same = candidate.person == person
    asked = "the same finger, named wrong" if same else "the same person under another name"
    return Finding("matches-another", f"it matches {who}; is that {asked}?", Severity.DOUBT)


_POOR_CHANCE = 0.8
"""Chance of a match below which another impression is asked for; 80 mm2 of clear ridges have it.
Source: judgement."""


def _shortcoming(capture: EnrolledCapture) -> list[Finding]:
    """That a new capture will match nobody, or perhaps not its own finger."""
    who = in_words(capture.person, capture.finger, capture.session)
    if not capture.acquired:
        lacks = "too few ridges or minutiae (failure to acquire)"
        words = f"{who} holds {lacks}; it is kept as such and will match nobody."
        return [Finding("failure-to-acquire", words)]
    if capture.chance is None or capture.chance >= _POOR_CHANCE:
        return []
    words = (
        f"another impression like {who} matches it with a chance of {100 * capture.chance:.0f} %:"
        " enrol another impression, of more skin or clearer."
    )
    return [Finding("low-chance", words)]


def _sessions(rows: Sequence[Made], earlier: Sequence[Entry], session: str | None) -> list[str]:
    """Sessions of what is enrolled: as named, or of the very same source, or the next number."""
    taken = {entry.session: entry.source_sha256 for entry in earlier}
    chosen = []
    for row in rows:
        numbers = [int(name) for name in taken if name.isascii() and name.isdigit()]
        same = (name for name, sha256 in taken.items() if sha256 == row.source_sha256)
        chosen.append(session or next(same, str(1 + max(numbers, default=0))))
        taken[chosen[-1]] = row.source_sha256
    return chosen


def settings_of(gallery: GalleryFile, *, of_minutiae: bool = False) -> str:
    """Hash of the settings of templates to enrol, `of_minutiae` where a source is a record of them.

    A gallery of minutiae takes everything, for minutiae can be found in it. Raises BadInput if the
    gallery is of other settings, or its folder is missing.
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
        f"'{gallery.path}' keeps templates of ridges, which records of minutiae cannot be compared"
        " with; enrol them into a gallery of their own.",
    )
    gallery.require_comparable(own, sha256)
    return own


def new_capture(row: Made, person: str, finger: str, session: str, how: Enrolling) -> NewCapture:
    """Give a row its names."""
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds") if how.with_time else ""
    entry = Entry(
        person, finger, session, row.kind, row.source_sha256, row.area_mm2, row.failure, now
    )
    return NewCapture(entry, row.template)


def content_of(gallery: GalleryFile, *, created: bool) -> GalleryContent:
    """Return what a gallery holds after an enrolment."""
    entries = gallery.entries()
    return GalleryContent(
        gallery=str(gallery.path),
        created=created,
        encrypted=gallery.key is not None,
        captures=len(entries),
        fingers=len({(entry.person, entry.finger) for entry in entries}),
        people=len({entry.person for entry in entries}),
        failures=sum(entry.template_bytes == 0 for entry in entries),
        settings_sha256=gallery.settings_sha256,
    )


def made_of(
    path: Path | Held, how: Enrolling, of_minutiae: bool = False, progress: Progress = no_progress
) -> Made:
    """Template and facts of one source. Raises BadInput if it cannot be read, or (a capture) not be
    reconstructed."""
    side = undoubted(
        read_side(
            path, how.preset, progress, how.resolution_ppi, ridges=how.ridges, where=how.where
        )
    )
    side = side if of_minutiae else with_print(side)
    minutiae = side_minutiae(side) if of_minutiae else side.minutiae
    compared = replace(side, surface=None, picture=None, minutiae=minutiae)
    if of_minutiae:
        assert minutiae is not None
        payload = pack_minutiae(minutiae) if minutiae.acquired else b""
        failure = "" if minutiae.acquired else "fewer than ten minutiae"
        area_mm2 = 0.0
    elif side.template is not None:
        payload = side.payload
        failure = (
            (side.template.lacks or "too little skin with ridges") if side.template.empty else ""
        )
        area_mm2 = round(side.template.area_mm2, 2)
    else:
        raise BadInput(
            f"{side.path} holds minutiae, no ridges; enrol it into a gallery of minutiae."
        )
    return Made(side.kind, payload, area_mm2, source_hash(path), failure, side.findings, compared)


def source_hash(path: Path | Held) -> str:
    """SHA-256 of a source: of a file, or of names and hashes of the files of a capture (without its
    truth)."""
    if isinstance(path, Capture | Reconstruction | Prepared):
        raise BadInput(
            "a capture or a result is enrolled from its folder; give its path, or the bytes of a"
            " template."
        )
    if not isinstance(path, Path):
        return path.sha256 if isinstance(path, Pixels) else hashlib.sha256(path).hexdigest()
    if not path.is_dir():
        return file_hash(path)
    if (path / "height.npz").is_file():
        files = [path / "height.npz"]
    else:
        files = sorted(
            file for file in path.rglob("*") if file.is_file() and file.name not in _NOT_INPUTS
        )
    lines = [f"{file_hash(file)}  {file.relative_to(path).as_posix()}\n" for file in files]
    return hashlib.sha256("".join(lines).encode("utf-8")).hexdigest()
