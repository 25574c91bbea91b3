"""Identification: one finger against a gallery, or against what one person claims (verification)."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

from splitknit import BadInput
from splitknit.errors import naming
from splitknit.io.provenance import settings_hash
from splitknit.model import no_progress
from splitknit.settings import override
from splitknit.verbs import Progress
from splitknit_match.gallery.entry import Entry, check_person, known_finger, session_order
from splitknit_match.gallery.file import GalleryFile, People
from splitknit_match.gallery.identify_job import IdentifyJob
from splitknit_match.gallery.minutia_index import each, unpacked
from splitknit_match.matching.fusion import fused_match, with_fusion
from splitknit_match.matching.inputs import Side, held, read_side
from splitknit_match.matching.methods import (
    ComparedSide,
    FmrBasis,
    MatchDecision,
    Rated,
    doubt_of,
    fmr_basis,
    rate,
    scale_doubt,
    scores_of,
    side_minutiae,
    similarity_at,
)
from splitknit_match.matching.minutiae import minutiae_match
from splitknit_match.matching.minutiae_record import MINUTIAE_VERSION, Minutiae, unpack_minutiae
from splitknit_match.matching.ridge import Prepared, ridge_match
from splitknit_match.matching.surface import MatchingSettings
from splitknit_match.matching.template import Template

ALL_PRINTS = 200
"""In a gallery of no more captures all are compared."""
NEAREST = 0.001
"""Of more as many as are to be reported, or this fraction, are: those whose minutiae agree best (what is lost:
``validation/gallery/index.py``)."""
TEMPLATES_HASH = "8c8ef4038286462ed584c0c8dcbfd7071a2498ada4a43b75c56c3e740069e7bc"
"""Of all that a template of ridges follows from; templates of one gallery agree in it."""
MINUTIAE_HASH = settings_hash({"minutiae": MINUTIAE_VERSION})
"""What galleries that keep minutiae have in place of :data:`TEMPLATES_HASH`."""


@dataclass(frozen=True, slots=True)
class Searched:
    """What a search went through."""

    method: str
    """``exhaustive`` or ``minutiae``: whether all were compared, or those whose minutiae agree best."""
    compared_by: str
    """``ridge``, ``fusion`` or ``minutiae``."""
    fingers: int
    people: int
    failures: int
    """Failures to acquire in the gallery, which match nobody."""
    captures: int
    compared: int
    note: str | None = None
    """Which were left out, or compared by less than the others."""


@dataclass(frozen=True, slots=True)
class RankedCandidate:
    """One who may have left the finger."""

    rank: int
    person: str
    finger: str
    session: str
    similarity: float
    fmr: float | None
    """False match rate at this similarity, None where it is not known."""
    expected_false_matches: float | None
    """Captures of other fingers, among those searched, that are as similar by chance."""


@dataclass(frozen=True, slots=True)
class SearchDecision(MatchDecision):
    """Whether the best candidate is the finger's owner."""

    expected_false_matches: float = 0.0


@dataclass(frozen=True, slots=True)
class Identification:
    """What a search found; that nobody is found is not an error."""

    gallery: str
    probe: ComparedSide
    mode: str
    """``identification``, or ``verification`` where a person was claimed."""
    person: str | None
    finger: str | None
    by: str
    """``ridges`` or ``minutiae``: what the gallery keeps."""
    searched: Searched
    merge: str
    candidates: tuple[RankedCandidate, ...]
    """Best first."""
    fmr_basis: FmrBasis | None
    decision: SearchDecision | None
    """None where false match rates are not known for the settings, or where the answer is ``undecided``."""
    answer: str
    """``match``, ``no match``, ``undecided``, or ``not acquired``."""
    undecided: str | None
    """Why the answer is neither ``match`` nor ``no match``, and what it takes."""
    timings_s: Mapping[str, float]
    presentation: str | None = None
    """``live`` or ``unknown``, where attacks were to be refused."""


@dataclass(frozen=True, slots=True)
class _Found:
    """One comparison."""

    entry: Entry
    similarity: float
    minutiae: float | None = None
    """Similarity of minutiae alone."""
    overlap_mm2: float | None = None

    def rated(self, by: str, area_mm2: float, fmr: float) -> Rated:
        """By the impostors of what was compared: area and minutiae."""
        areas = area_mm2, self.entry.area_mm2
        scores = by if by == "minutiae_of_prints" else scores_of(by, areas, self.minutiae)
        return rate(self.similarity, scores, self.overlap_mm2, fmr)


def identify_finger(
    question: IdentifyJob,
    progress: Progress = no_progress,
    gallery: GalleryFile | None = None,
    side: Side | None = None,
) -> Identification:
    """Who is it? That nobody is found is a result, no error. Raises BadInput as :class:`IdentifyJob` states.

    `gallery`: where it is open already; `side`: the probe, where it was read already.
    """
    override(MatchingSettings(), question.settings or {})  # refuses unknown ones
    probe = held(question.probe, question.resolution_ppi)
    person = None if question.person is None else check_person(question.person)
    finger = None if question.finger is None else known_finger(question.finger)
    opened = GalleryFile(question.gallery, question.key) if gallery is None else gallery
    with opened if gallery is None else contextlib.nullcontext():
        people = opened.people(person)
    of_minutiae = people.settings_sha256 == MINUTIAE_HASH
    opened.require_comparable(people.settings_sha256, MINUTIAE_HASH if of_minutiae else TEMPLATES_HASH)
    entries = people.of(person, finger)
    # refused here, before anything is made, where no such rate was measured
    similarity_at(question.fmr, "minutiae_of_prints" if of_minutiae else "ridge")
    side = side or read_side(probe, question.preset, lambda stage, at: progress(stage, 0.5 * at), question.input_ppi)
    made = side_minutiae(side) if of_minutiae else side.template
    if made is None:
        raise BadInput(
            f"{side.path} holds minutiae, but '{question.gallery}' keeps ridges; name a print, or enrol minutiae."
        )
    acquired = made.acquired if isinstance(made, Minutiae) else not made.empty
    area_mm2 = 0.0 if isinstance(made, Minutiae) else made.area_mm2
    started = time.perf_counter()
    exhaustive = question.search == "exhaustive" or person is not None or finger is not None
    most = len(entries) if exhaustive else max(question.top, round(NEAREST * len(entries)))
    found, facts = _search(people, made, entries, most=most, progress=progress)
    seconds = time.perf_counter() - started
    by = {"minutiae": "minutiae_of_prints"}.get(facts.compared_by, facts.compared_by)
    if by == "fusion" and side.kind == "photo":
        by = "fingerphotos"
    best = _merged(found, question.merge)[: question.top]
    rated = [one.rated(by, area_mm2, question.fmr) for one in best]
    doubt = doubt_of(side)
    if (
        isinstance(made, Template) and best and by == "fusion" and doubt is None
        and facts.compared == facts.captures and rated[0].answer != "match"
    ):  # fmt: skip
        row = best[0].entry.row
        doubt = scale_doubt(made, unpacked(people.path, row, people.templates[row]), question.fmr)
    decision, undecided = None, None
    if rated and rated[0].decision is None:
        undecided = rated[0].undecided
    else:
        none = MatchDecision(False, question.fmr, similarity_at(question.fmr, by))
        at = (rated[0].decision if rated else None) or none
        decision = SearchDecision(at.match, at.fmr, at.threshold, at.expected_fmr, facts.captures * at.fmr)
    if doubt is not None and not (decision and decision.match):  # a match confirms the scale
        decision, undecided = None, doubt
    answer = "undecided" if decision is None else "match" if decision.match else "no match"
    candidates = [
        RankedCandidate(
            rank, *one.entry.names, one.similarity, at.fmr, None if at.fmr is None else facts.captures * at.fmr
        )
        for rank, (one, at) in enumerate(zip(best, rated, strict=True), start=1)
    ]
    progress("done", 1.0)
    return Identification(
        gallery=str(question.gallery), mode="identification" if person is None else "verification", person=person,
        finger=finger,
        probe=ComparedSide(str(side.path), side.kind, area_mm2, acquired, note=side.note, doubt=side.doubt),
        by="minutiae" if of_minutiae else "ridges", searched=facts, merge=question.merge, candidates=tuple(candidates),
        fmr_basis=rated[0].basis if rated else fmr_basis(by), decision=decision,
        answer=answer if acquired or doubt else "not acquired",
        undecided=undecided if acquired or doubt else "failure to acquire", timings_s={"search": seconds},
    )  # fmt: skip


def _search(
    people: People,
    probe: Template | Minutiae,
    entries: Sequence[Entry],
    *,
    most: int,
    progress: Progress,
) -> tuple[list[_Found], Searched]:
    """Compare these, or of many the `most` whose minutiae agree best; best first."""
    acquired = [one for one in entries if one.template_bytes > 0]
    fingers, whose = {(one.person, one.finger) for one in acquired}, {one.person for one in acquired}
    method, by, chosen, note = "exhaustive", "ridge", acquired, ""
    found: list[_Found] = []
    if isinstance(probe, Minutiae):
        by = "minutiae"
        found = _by_minutiae(people, probe, acquired)
    elif not probe.empty and acquired:
        ready = Prepared(probe)
        if len(acquired) > max(most, ALL_PRINTS) and ready.cylinders is not None:
            index, method = people.index(), "minutiae"
            chosen = [people.entries[row] for row in (*index.nearest(ready.cylinders, most), *index.others)]
            if len(chosen) < len(acquired):
                note = (
                    f"of {len(acquired)} captures {len(chosen)} were compared, those whose minutiae agree best; about "
                    "1 in 100 matches is lost so"
                )
        # of many, laid on the probe by minutiae alone where these propose how: four times as quick
        sure = 0.0 if method == "minutiae" else None
        found, lacking = _compared(people, ready, chosen, sure, progress)
        note = "; ".join(filter(None, (note, lacking)))
        if any(one.minutiae is not None or one.overlap_mm2 is not None for one in found):
            by = "fusion"
    found.sort(key=lambda one: (-one.similarity, one.entry.person, one.entry.finger, session_order(one.entry.session)))
    failures = len(entries) - len(acquired)
    return found, Searched(method, by, len(fingers), len(whose), failures, len(acquired), len(found), note or None)


def _compared(
    people: People, probe: Prepared, entries: Sequence[Entry], sure: float | None, progress: Progress
) -> tuple[list[_Found], str | None]:
    """Compare by ridges, and by minutiae where both hold some; and a note."""
    templates = {one.row: unpacked(people.path, one.row, people.templates[one.row]) for one in entries}
    fused, note = with_fusion(templates.values(), probe.template)

    def compare(one: Entry) -> _Found:
        other = Prepared(templates[one.row])
        if not fused:
            return _Found(one, ridge_match(probe, other).similarity)
        both = fused_match(probe, other, sure)
        return _Found(one, both.similarity, both.minutiae, both.ridge.overlap_mm2)

    found: list[_Found] = []
    for one in each(compare, entries):
        progress("comparing", 0.5 + 0.5 * len(found) / len(entries))
        found.append(one)
    return found, note


def _by_minutiae(people: People, probe: Minutiae, entries: Sequence[Entry]) -> list[_Found]:
    found = []
    for one in entries if probe.acquired else ():
        payload = people.templates[one.row]
        other = naming(f"row {one.row} of '{people.path}'", partial(unpack_minutiae, payload))
        found.append(_Found(one, minutiae_match(probe, other)))
    return found


def _merged(found: Sequence[_Found], merge: str) -> list[_Found]:
    """The best of each person or finger, best first."""
    count = {"person": 1, "finger": 2, "none": 3}[merge]
    best: dict[tuple[str, ...], _Found] = {}
    for one in found:
        best.setdefault(one.entry.names[:count], one)
    return list(best.values())
