"""``splitknit enroll GALLERY SOURCE...``: fingers into a gallery."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

from splitknit import BadInput
from splitknit.cli.verb import Outcome, Verb, count
from splitknit.errors import require
from splitknit.verbs import (
    FINGER,
    AnyPath,
    Help,
    HowReconstructed,
    InputPpi,
    Job,
    KeyFile,
    Natural,
    Progress,
    path,
    refuse_given,
)
from splitknit_match.cli.pad import Refusal, refuse_attacks
from splitknit_match.prints.photo_finger import PhotoBox, PhotoFinger, PhotoMask

if TYPE_CHECKING:
    from splitknit_match.gallery.gallery import EnrolledCapture, Enrolling
    from splitknit_match.gallery.identify import RankedCandidate


@dataclass(frozen=True, slots=True)
class EnrollJob(Job):
    """Put fingers into a gallery, which is made where there is none."""

    # fmt: off
    gallery: Annotated[AnyPath, Help("file of the gallery", "GALLERY", positional=True, secret=True)]
    sources: Annotated[tuple[AnyPath, ...], Help(
        f"{FINGER}; several are sessions of one finger", "SOURCE", positional=True)] = ()
    _: KW_ONLY
    key_file: KeyFile = None
    person: Annotated[str | None, Help("whose finger it is", "NAME")] = None
    finger: Annotated[str | None, Help("which, such as right_index", "FINGER")] = None
    session: Annotated[str | None, Help("which session (default: the next number)", "S")] = None
    population: Annotated[AnyPath | None, Help(
        "instead of sources: a whole enrolment, FOLDER/S01/session_1/right_index (or right_index.png) and so on; "
        "resumable", "FOLDER")] = None
    workers: Annotated[Natural | None, Help("processes for a population (default: 1)", "N")] = None
    replace: Annotated[bool, Help("let a capture take the place of one of the same names")] = False
    with_time: Annotated[bool, Help("keep the time of enrolment as well")] = False
    duplicates: Annotated[Literal["refuse", "warn", "allow"], Help(
        "what to do about a finger that matches another person's: refuse it, report it (default), or not look"
        )] = "warn"
    pad: Refusal = False
    input_ppi: InputPpi = None
    mask: PhotoMask = None
    box: PhotoBox = None
    preset: HowReconstructed = "metric"
    # fmt: on

    def run(self, progress: Progress) -> Outcome:
        """Enrol sources, or a population."""
        from splitknit_match.gallery.file import key_of
        from splitknit_match.gallery.gallery import Enrolling  # verbs import what they need

        how = Enrolling(self.preset, self.replace, self.with_time, self.input_ppi, PhotoFinger(self.mask, self.box))
        key = key_of(self.key_file)
        presented = refuse_attacks(self.pad, self.sources, self.preset, progress)
        enrol = self._sources if self.population is None else self._population
        facts, lines = enrol(how, key, progress)
        locked = ", encrypted" if facts["encrypted"] else ""
        people = count(facts["people"], "person", "people")
        held = f"{count(facts['captures'], 'capture')} of {count(facts['fingers'], 'finger')} of {people}"
        lines.append(f"{facts['gallery']} holds {held}{locked}.")
        return facts if presented is None else {**facts, "presentation": presented}, lines

    def _sources(self, how: Enrolling, key: Any, progress: Progress) -> Outcome:
        from splitknit.io.provenance import known_json
        from splitknit_match.gallery.gallery import enroll

        require(self.workers is None, "`workers` is for `population`.")
        cure = "name one source."
        require(len(self.sources) == 1 or not how.where.given, f"`mask` and `box` are for one photograph; {cure}")
        if self.person is None or self.finger is None:
            raise BadInput("name whose finger it is: `person` NAME `finger` right_index (or `population` FOLDER).")
        found = enroll(
            path(self.gallery), list(self.sources), self.person, self.finger, session=self.session, key=key, how=how,
            duplicates=self.duplicates, progress=progress,
        )  # fmt: skip
        facts = {**known_json(found.content), "enrolled": known_json(found.enrolled), "alike": known_json(found.alike)}
        return facts, [
            *map(_words, found.enrolled),
            *(_alike(one, self.person) for one in found.alike),
        ]

    def _population(self, how: Enrolling, key: Any, progress: Progress) -> Outcome:
        from splitknit_match.batch.enrol import enroll_population

        apart = ("person", "finger", "session", "mask", "box")
        refuse_given(self, apart, "does not go with `population`, whose folders have names.")
        refuse_given(self, ("duplicates",), "goes with sources; people of a `population` are not compared.")
        require(not self.sources, "name sources or a `population`, not both.")
        assert self.population is not None
        workers = 1 if self.workers is None else self.workers
        gallery, folder = path(self.gallery), path(self.population)
        facts = enroll_population(gallery, folder, how, key=key, workers=workers, progress=progress)
        failed = facts["failures_to_acquire"]
        new = count(facts["new"], "capture")
        lines = [f"{new} enrolled, {facts['known']} of {facts['found']} were there already."]
        if failed:
            first = f"first: {failed[0]['path']}: {failed[0]['reason'].rstrip('.')}"
            lines.append(f"Please note: {count(len(failed), 'failure')} to acquire, kept as such ({first}).")
        return facts, lines


ENROLL = Verb(EnrollJob)


def _alike(one: RankedCandidate, person: str) -> str:
    who = f"{one.person}, {one.finger.replace('_', ' ')}, session {one.session}"
    asked = "the same finger, named wrong" if one.person == person else "the same person under another name"
    return f"Please note: it matches {who}; is that {asked}?"


def _words(one: EnrolledCapture) -> str:
    who = f"{one.person}, {one.finger.replace('_', ' ')}, session {one.session}"
    if not one.new:
        return f"{who} was enrolled from the same source already."
    if not one.acquired:
        lacks = "too few ridges or minutiae (failure to acquire)"
        return f"Please note: {who} holds {lacks}; it is kept as such and will match nobody."
    held = f"{one.area_mm2:.0f} mm² of skin" if one.area_mm2 else "minutiae"
    enrolled = f"Enrolled {who}: {held}, {one.template_bytes / 1000:.1f} kB."
    return f"{enrolled} Please note: {one.note}" if one.note else enrolled
