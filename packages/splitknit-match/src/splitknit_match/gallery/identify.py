"""Identification: one finger against a gallery, or against what one person claims
(verification)."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

from splitknit import BadInput
from splitknit.arguments import count, text_of
from splitknit.errors import naming, require
from splitknit.findings import Finding, worst_first
from splitknit.io.provenance import known_json, settings_hash
from splitknit.model import Progress, no_progress
from splitknit_match.gallery.file import (
    Entry,
    GalleryFile,
    People,
    check_person,
    in_words,
    known_finger,
    session_order,
)
from splitknit_match.gallery.minutia_index import each, unpacked
from splitknit_match.gallery.parameters import ALL_PRINTS, NEAREST
from splitknit_match.matching.fusion import fused_match, with_fusion
from splitknit_match.matching.inputs import Side
from splitknit_match.matching.methods import (
    check_rate,
    fmr_basis,
    rate,
    reason,
    scale_doubt,
    scores_of,
    side_minutiae,
    similarity_at,
)
from splitknit_match.matching.parameters import DECIDED_AT
from splitknit_match.matching.results import (
    ComparedSide,
    FmrBasis,
    MatchDecision,
    Rated,
    basis_words,
    decided_at,
    noted,
    one_in,
)
from splitknit_match.matching.ridge import Prepared, ridge_match
from splitknit_match.matching.template import Template
from splitknit_match.prints.minutiae import minutiae_match
from splitknit_match.prints.minutiae_record import MINUTIAE_VERSION, Minutiae, unpack_minutiae
from splitknit_match.threads import one_blas_thread

TEMPLATES_HASH = "8c8ef4038286462ed584c0c8dcbfd7071a2498ada4a43b75c56c3e740069e7bc"
"""Of all that a template of ridges follows from; templates of one gallery agree in it."""
MINUTIAE_HASH = settings_hash({"minutiae": MINUTIAE_VERSION})
"""What galleries that keep minutiae have in place of :data:`TEMPLATES_HASH`."""

_log = logging.getLogger(__name__)

Merge = Literal["person", "finger", "none"]
_MERGED = {"person": 1, "finger": 2, "none": 3}
"""How many of person, finger and session make one candidate."""


@dataclass(frozen=True, slots=True)
class Searched:
    """What a search went through."""

    compared_by: str
    """``ridge``, ``fusion`` or ``minutiae``."""
    fingers: int
    people: int
    failures: int
    """Failures to acquire in the gallery, which match nobody."""
    captures: int
    compared: int
    """Fewer where those were chosen whose minutiae agree best."""


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
    """None where the answer is ``undecided``."""
    answer: str
    """``match``, ``no match``, ``undecided``, or ``not acquired``."""
    undecided: str | None
    """Why the answer is neither ``match`` nor ``no match``, and what it takes."""
    presentation: str | None = None
    """``live`` or ``unknown``, where attacks were to be refused."""
    findings: tuple[Finding, ...] = ()
    """What was assumed of the probe, which captures were left out, and what is in doubt: then the
    answer is undecided."""

    @property
    def facts(self) -> dict[str, Any]:
        """The same as plain JSON."""
        return dict(known_json(self))

    def __str__(self) -> str:
        return text_of(identification_lines(self))


@dataclass(frozen=True, slots=True)
class _Comparison:
    """The probe beside one capture."""

    entry: Entry
    similarity: float
    minutiae: float | None = None
    """Similarity of minutiae alone."""
    overlap_mm2: float | None = None

    def rated(self, table: str, area_mm2: float, fmr: float | None) -> Rated:
        """By the impostors of what was compared: area and minutiae."""
        areas = area_mm2, self.entry.area_mm2
        scores = table if table == "minutiae_of_prints" else scores_of(table, areas, self.minutiae)
        return rate(self.similarity, scores, self.overlap_mm2, fmr)


@one_blas_thread()
def identify_finger(
    gallery: GalleryFile | People,
    read: Callable[[Progress], Side],
    *,
    top: int = 10,
    person: str | None = None,
    finger: str | None = None,
    fmr: float | None = None,
    merge: Merge = "person",
    progress: Progress = no_progress,
) -> Identification:
    """Who is it? That nobody is found is a result, no error. Raises BadInput as
    :func:`splitknit_match.identify`.

    `gallery`: a file, or what was read of one. `read`: reads the probe, once all else is known to
    be sound.
    """
    started = time.perf_counter()
    _check(top, finger, fmr, merge)
    person = None if person is None else check_person(person)
    people = gallery if isinstance(gallery, People) else _comparable_people(gallery, person)
    of_minutiae = people.settings_sha256 == MINUTIAE_HASH
    entries = people.of(person, finger)
    if fmr is not None:  # refused here, before anything is made, where no such rate was measured
        similarity_at(fmr, "minutiae_of_prints" if of_minutiae else "ridge")

    def reading(stage: str, fraction: float) -> None:
        progress(stage, 0.5 * fraction)

    side = read(reading)
    probe = side_minutiae(side) if of_minutiae else side.template
    if probe is None:
        cure = "name a print, or enrol minutiae"
        raise BadInput(f"{side.path} holds minutiae, but '{people.path}' keeps ridges; {cure}.")
    acquired = probe.acquired if isinstance(probe, Minutiae) else not probe.empty
    area_mm2 = 0.0 if isinstance(probe, Minutiae) else probe.area_mm2

    of_everybody = person is None and finger is None
    most = max(top, round(NEAREST * len(entries))) if of_everybody else len(entries)
    comparisons, searched, findings = _search(people, probe, entries, most=most, progress=progress)
    table = {"minutiae": "minutiae_of_prints"}.get(searched.compared_by, searched.compared_by)
    if table == "fusion" and side.kind == "photo":
        table = "fingerphotos"
    best = _merged(comparisons, merge)[:top]
    rated = [comparison.rated(table, area_mm2, fmr) for comparison in best]
    candidates = tuple(
        RankedCandidate(
            rank,
            *comparison.entry.names,
            comparison.similarity,
            rates.fmr,
            None if rates.fmr is None else searched.captures * rates.fmr,
        )
        for rank, (comparison, rates) in enumerate(zip(best, rated, strict=True), start=1)
    )

    doubt = side.doubt
    undoubted = doubt is None and searched.compared == searched.captures and table == "fusion"
    if isinstance(probe, Template) and undoubted and rated and rated[0].answer != "match":
        row = best[0].entry.row
        doubt = scale_doubt(probe, unpacked(people.path, row, people.templates[row]), fmr)
        findings += [] if doubt is None else [doubt]
    decision, undecided = _decided(rated, table, fmr, searched.captures)
    if doubt is not None and not (decision and decision.match):  # a match confirms the scale
        decision, undecided = None, reason(doubt)
    answer = "undecided" if decision is None else "match" if decision.match else "no match"
    if not acquired and doubt is None:
        answer, undecided = "not acquired", "failure to acquire"
    basis = rated[0].fmr_basis if rated else fmr_basis(table)
    seconds = time.perf_counter() - started
    _log.info("searched %d captures in %.2f s: %s", searched.captures, seconds, answer)
    progress("done", 1.0)
    return Identification(
        gallery=str(people.path),
        probe=ComparedSide(str(side.path), side.kind, area_mm2, acquired),
        mode="identification" if person is None else "verification",
        person=person,
        finger=finger,
        by="minutiae" if of_minutiae else "ridges",
        searched=searched,
        merge=merge,
        candidates=candidates,
        fmr_basis=basis,
        decision=decision,
        answer=answer,
        undecided=undecided,
        findings=worst_first([*side.findings, *findings]),
    )


def _comparable_people(gallery: GalleryFile, person: str | None) -> People:
    """What a gallery holds, if its templates are of this version."""
    people = gallery.people(person)
    known = MINUTIAE_HASH if people.settings_sha256 == MINUTIAE_HASH else TEMPLATES_HASH
    gallery.require_comparable(people.settings_sha256, known)
    return people


def _check(top: int, finger: str | None, fmr: float | None, merge: str) -> None:
    require(top >= 1, f"`top` must be at least 1, but it is {top}.")
    check_rate(fmr)
    require(merge in _MERGED, f"`merge` must be one of {', '.join(_MERGED)}, but it is {merge!r}.")
    if finger is not None:
        known_finger(finger)


def _decided(
    rated: Sequence[Rated], table: str, fmr: float | None, captures: int
) -> tuple[SearchDecision | None, str | None]:
    """Decision on the best candidate, or why there is none."""
    if rated and rated[0].decision is None:
        return None, rated[0].undecided
    decision = rated[0].decision if rated else None
    if decision is None:
        fmr = fmr or max(DECIDED_AT, fmr_basis(table).smallest)
        decision = MatchDecision(False, fmr, similarity_at(fmr, table))
    return (
        SearchDecision(
            decision.match,
            decision.fmr,
            decision.threshold,
            decision.expected_fmr,
            captures * decision.fmr,
        ),
        None,
    )


def _search(
    people: People,
    probe: Template | Minutiae,
    entries: Sequence[Entry],
    *,
    most: int,
    progress: Progress,
) -> tuple[list[_Comparison], Searched, list[Finding]]:
    """Compare these, or of many the `most` whose minutiae agree best; best first."""
    acquired = [entry for entry in entries if entry.template_bytes > 0]
    compared_by = "ridge"
    findings: list[Finding] = []
    comparisons: list[_Comparison] = []
    if isinstance(probe, Minutiae):
        compared_by = "minutiae"
        comparisons = _by_minutiae(people, probe, acquired)
    elif not probe.empty and acquired:
        prepared, chosen, support = Prepared(probe), acquired, None
        if len(acquired) > max(most, ALL_PRINTS) and prepared.cylinders is not None:
            index = people.index()
            chosen = [
                people.entries[row]
                for row in (*index.nearest(prepared.cylinders, most), *index.others)
            ]
            # laid on the probe by minutiae alone where these propose how: four times as quick
            support = 0.0
        if len(chosen) < len(acquired):
            words = (
                f"of {len(acquired)} captures {len(chosen)} were compared, those whose minutiae"
                " agree best; this shortcut misses about 1 match in 100."
            )
            findings.append(Finding("captures-left-out", words))
        comparisons, others = _by_ridges(people, prepared, chosen, support, progress)
        findings += others
        if any(c.minutiae is not None or c.overlap_mm2 is not None for c in comparisons):
            compared_by = "fusion"
    comparisons.sort(key=_order)
    searched = Searched(
        compared_by=compared_by,
        fingers=len({(entry.person, entry.finger) for entry in acquired}),
        people=len({entry.person for entry in acquired}),
        failures=len(entries) - len(acquired),
        captures=len(acquired),
        compared=len(comparisons),
    )
    if searched.failures:
        words = f"{searched.failures} failures to acquire in the gallery match nobody."
        findings.append(Finding("failures-in-gallery", words))
    return comparisons, searched, findings


def _order(comparison: _Comparison) -> tuple[float, str, str, tuple[int, int, str]]:
    person, finger, session = comparison.entry.names
    return -comparison.similarity, person, finger, session_order(session)


def _by_ridges(
    people: People,
    probe: Prepared,
    entries: Sequence[Entry],
    support: float | None,
    progress: Progress,
) -> tuple[list[_Comparison], tuple[Finding, ...]]:
    """Compare by ridges, and by minutiae where both hold some; and findings."""
    templates = {
        entry.row: unpacked(people.path, entry.row, people.templates[entry.row])
        for entry in entries
    }
    fused, findings = with_fusion(templates.values(), probe.template)

    def compare(entry: Entry) -> _Comparison:
        enrolled = Prepared(templates[entry.row])
        if not fused:
            return _Comparison(entry, ridge_match(probe, enrolled).similarity)
        both = fused_match(probe, enrolled, support)
        return _Comparison(entry, both.similarity, both.minutiae, both.ridge.overlap_mm2)

    comparisons: list[_Comparison] = []
    for comparison in each(compare, entries):
        progress("comparing", 0.5 + 0.5 * len(comparisons) / len(entries))
        comparisons.append(comparison)
    return comparisons, findings


def _by_minutiae(people: People, probe: Minutiae, entries: Sequence[Entry]) -> list[_Comparison]:
    comparisons = []
    for entry in entries if probe.acquired else ():
        read = partial(unpack_minutiae, people.templates[entry.row])
        enrolled = naming(f"row {entry.row} of '{people.path}'", read)
        comparisons.append(_Comparison(entry, minutiae_match(probe, enrolled)))
    return comparisons


def _merged(comparisons: Sequence[_Comparison], merge: str) -> list[_Comparison]:
    """The best of each person or finger, best first."""
    parts = _MERGED[merge]
    best: dict[tuple[str, ...], _Comparison] = {}
    for comparison in comparisons:
        best.setdefault(comparison.entry.names[:parts], comparison)
    return list(best.values())


def identification_lines(search: Identification, *, scores: bool = False) -> list[str]:
    """Of an identification; `scores`: also the method's own, whose scale few know."""
    lines, basis, decision = [_verdict(search)], search.fmr_basis, search.decision
    for candidate in search.candidates:
        who = in_words(candidate.person, candidate.finger, candidate.session)
        rate = (
            "not known" if basis is None or candidate.fmr is None else one_in(candidate.fmr, basis)
        )
        score = f", score {candidate.similarity:.5g}" if scores or basis is None else ""
        lines.append(f"{candidate.rank:>3}. {who}: estimated false match rate {rate}{score}")
    if search.candidates and basis is not None:
        lines.append(f"Rates were measured on {basis_words(basis)}.")
    if scores and decision is not None:
        lines.append(f"A match has a score of {decision.threshold:.5g} or more.")
    searched = search.searched
    how = {"fusion": "by ridges and minutiae", "minutiae": "by minutiae"}.get(
        searched.compared_by, "ridge by ridge"
    )
    whose = (
        f" ({count(searched.fingers, 'finger')} of {count(searched.people, 'person', 'people')})"
    )
    lines.append(
        f"Searched: {count(searched.captures, 'capture')}{whose}, {searched.compared} compared"
        f" {how}."
    )
    if search.candidates and decision is not None:
        first = search.candidates[0].expected_false_matches or 0.0
        lines.append(
            f"Among {count(searched.captures, 'capture')} of other fingers {first:.2g} are to be "
            "expected as similar as the first candidate, "
            f"and {decision.expected_false_matches:.2g} beyond the limit."
        )
    return lines + noted(search.findings)


def _verdict(search: Identification) -> str:
    decision = search.decision
    if search.answer == "not acquired":
        lacks = "too few minutiae" if search.by == "minutiae" else "no ridges"
        return f"Not acquired: {search.probe.path} holds {lacks} (failure to acquire)."
    if search.searched.captures == 0:
        return "No match: there is nothing to compare with."
    if decision is None:
        return f"Undecided: {search.undecided}."
    at = f"{decided_at(decision)} a comparison"
    if search.mode == "verification":
        return f"{'Verified' if decision.match else 'Not verified'}: {search.person} ({at})."
    if not decision.match:
        return f"No match: nobody is similar enough ({at})."
    best = search.candidates[0]
    return f"Match: {best.person}, {best.finger.replace('_', ' ')} ({at})."
