"""Identification: one finger against a gallery, or against what one person claims
(verification)."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, Literal

from splitknit import BadInput
from splitknit.arguments import count, text_of
from splitknit.errors import naming, require
from splitknit.findings import Finding, worst_first
from splitknit.io.provenance import known_json, settings_hash
from splitknit.model import Progress, no_progress
from splitknit_match.gallery.file import (
    PART,
    Entry,
    GalleryFile,
    People,
    check_person,
    in_words,
    known_finger,
    session_order,
)
from splitknit_match.gallery.minutia_index import each
from splitknit_match.matching.fusion import SURE, by_ridges
from splitknit_match.matching.inputs import Side, with_print
from splitknit_match.matching.methods import (
    DECIDED_AT,
    Compared,
    check_rate,
    compare_minutiae,
    compare_templates,
    compared_side,
    fmr_table,
    reason,
    scale_doubt,
    side_minutiae,
)
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
from splitknit_match.matching.ridge import Prepared
from splitknit_match.matching.template import Template
from splitknit_match.records.minutiae_record import MINUTIAE_VERSION, Minutiae, unpack_minutiae
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
    """False match rate at this similarity, None where it is not known; of those behind the first
    of a large gallery at most this."""
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
    method: str
    """``ridge``, ``fusion`` or ``minutiae``."""
    pair: Compared


_NEAREST = 0.001
"""Fraction of a larger gallery that is compared, or as many as are to be reported: those whose
minutiae agree best. Chosen on: speed (what is lost: real prints, validation/gallery/index.py)."""


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
    one_blas_thread()
    started = time.perf_counter()
    require(top >= 1, f"`top` must be at least 1, but it is {top}.")
    check_rate(fmr)
    require(merge in _MERGED, f"`merge` must be one of {', '.join(_MERGED)}, but it is {merge!r}.")
    if finger is not None:
        known_finger(finger)
    person = None if person is None else check_person(person)
    people = gallery if isinstance(gallery, People) else comparable_people(gallery, person)
    of_minutiae = people.settings_sha256 == MINUTIAE_HASH
    wanted = person, finger
    sought = {"person": person, "finger": finger}
    words = " and ".join(f"{name} '{value}'" for name, value in sought.items() if value is not None)
    require(
        people.of(*wanted).entries or not words,
        f"'{people.path}' holds nothing of {words}; 'splitknit gallery list' shows who is in it.",
    )
    if fmr is not None:  # refused here, before anything is made, where no such rate was measured
        fmr_table("minutiae_of_prints" if of_minutiae else "ridge").threshold(fmr)
    side = read(lambda stage, fraction: progress(stage, 0.5 * fraction))
    side = side if of_minutiae else with_print(side)
    if side.either and not of_minutiae:
        found = []
        for light in (False, True):
            reading = partial(lambda part, _: part, side.reading(light=light))
            found.append(
                identify_finger(
                    gallery,
                    reading,
                    top=top,
                    person=person,
                    finger=finger,
                    fmr=fmr,
                    merge=merge,
                    progress=progress,
                )
            )
            if found[-1].answer == "match":
                return found[-1]
        return found[0]
    probe = side_minutiae(side) if of_minutiae else side.template
    if probe is None:
        cure = "name a print, or enrol minutiae"
        raise BadInput(f"{side.path} holds minutiae, but '{people.path}' keeps ridges; {cure}.")
    compared = compared_side(side)
    if isinstance(probe, Minutiae):
        compared = ComparedSide(compared.path, side.kind, 0.0, probe.acquired)

    best, searched, findings = _search(
        people, probe, wanted, merge=merge, top=top, progress=progress
    )
    table = "minutiae_of_prints" if of_minutiae else searched.compared_by
    rated = [comparison.pair.rated(fmr) for comparison in best]
    candidates = tuple(
        RankedCandidate(
            rank,
            *comparison.entry.names,
            comparison.pair.similarity,
            rates.fmr,
            None if rates.fmr is None else searched.captures * rates.fmr,
        )
        for rank, (comparison, rates) in enumerate(zip(best, rated, strict=True), start=1)
    )

    doubt = side.doubt
    undoubted = doubt is None and searched.compared == searched.captures and rated
    # two prints of known scales, one of which may be wrong
    prints = undoubted and best[0].method == "fusion" and "photo" not in best[0].pair.scores
    if isinstance(probe, Template) and prints and rated[0].answer != "match":
        doubt = scale_doubt(probe, people.prepared(best[0].entry.row).template, fmr)
        findings += [] if doubt is None else [doubt]
    decision, undecided = _decided(rated, table, fmr, searched.captures)
    if doubt is not None and not (decision and decision.match):  # a match confirms the scale
        decision, undecided = None, reason(doubt)
    answer = "undecided" if decision is None else "match" if decision.match else "no match"
    if not compared.acquired and doubt is None:
        answer, undecided = "not acquired", "failure to acquire"
    seconds = time.perf_counter() - started
    _log.info("searched %d captures in %.2f s: %s", searched.captures, seconds, answer)
    progress("done", 1.0)
    return Identification(
        gallery=str(people.path),
        probe=compared,
        mode="identification" if person is None else "verification",
        person=person,
        finger=finger,
        by="minutiae" if of_minutiae else "ridges",
        searched=searched,
        merge=merge,
        candidates=candidates,
        fmr_basis=rated[0].fmr_basis if rated else fmr_table(table).basis,
        decision=decision,
        answer=answer,
        undecided=undecided,
        findings=worst_first([*side.findings, *findings]),
    )


def comparable_people(gallery: GalleryFile, person: str | None = None) -> People:
    """What a gallery holds, if its templates are of this version."""
    people = gallery.people(person)
    known = MINUTIAE_HASH if people.settings_sha256 == MINUTIAE_HASH else TEMPLATES_HASH
    gallery.require_comparable(people.settings_sha256, known)
    return people


def _decided(
    rated: Sequence[Rated], table: str, fmr: float | None, captures: int
) -> tuple[SearchDecision | None, str | None]:
    """Decision on the best candidate, or why there is none."""
    if rated and rated[0].decision is None:
        return None, rated[0].undecided
    decision = rated[0].decision if rated else None
    if decision is None:
        fmr = fmr or max(DECIDED_AT, fmr_table(table).smallest)
        decision = MatchDecision(False, fmr, fmr_table(table).threshold(fmr))
    return SearchDecision(**asdict(decision), expected_false_matches=captures * decision.fmr), None


ALL_PRINTS = 200
"""In a gallery of no more captures all are compared. Chosen on: speed."""


def _search(
    people: People,
    probe: Template | Minutiae,
    wanted: tuple[str | None, str | None],
    *,
    merge: str,
    top: int,
    progress: Progress,
) -> tuple[list[_Comparison], Searched, list[Finding]]:
    """Compare those of a person, a finger, or of all those whose minutiae agree best; the `top` of
    each person or finger, best first."""
    sought = people.of(*wanted)
    acquired = sought.acquired
    findings = []
    comparisons = []
    if isinstance(probe, Template):
        compared_by, empty = "ridge", probe.empty
        quick = wanted == (None, None) and len(acquired) > max(top, ALL_PRINTS)
    else:
        compared_by, empty, quick = "minutiae", not probe.acquired, False
    if acquired and not empty:
        compare = partial(_compared, probe, wanted, top if quick else 0)
        if people.spread is None:
            comparisons = compare(people, progress)
        else:
            for number, done in enumerate(people.spread(compare)):
                comparisons += done
                progress("comparing", 0.5 + 0.5 * number * PART / len(people.entries))
        if len(comparisons) < len(acquired):
            words = (
                f"of {len(acquired)} captures {len(comparisons)} were compared, those whose"
                " minutiae agree best; this shortcut misses about 1 match in 100."
            )
            findings.append(Finding("captures-left-out", words))
        if any(comparison.method == "fusion" for comparison in comparisons):
            compared_by = "fusion"
    best = _merged(comparisons, merge)[:top]
    if isinstance(probe, Template) and quick and best and (best[0].pair.minutiae or 0.0) < SURE:
        # rates were measured by comparisons as of `match`; in others of a search they may be larger
        best[0] = _beside(people, Prepared(probe), False, best[0].entry)
        best = _ranked(best)
    searched = Searched(
        compared_by=compared_by,
        fingers=sought.fingers,
        people=sought.people,
        failures=len(sought.entries) - len(acquired),
        captures=len(acquired),
        compared=len(comparisons),
    )
    if searched.failures:
        words = f"{searched.failures} failures to acquire in the gallery match nobody."
        findings.append(Finding("failures-in-gallery", words))
    return best, searched, findings


def _compared(
    probe: Template | Minutiae,
    wanted: tuple[str | None, str | None],
    top: int,
    people: People,
    progress: Progress = no_progress,
) -> list[_Comparison]:
    """Compare those of a person, a finger, or all; with `top`, quickly, so many of each index at
    least, whose minutiae agree best."""
    chosen = people.of(*wanted).acquired
    side = probe if isinstance(probe, Minutiae) else Prepared(probe)
    sought = side.cylinders if top and isinstance(side, Prepared) else None
    if sought is not None:
        chosen = [
            people.entries[row]
            for index in people.index(progress)
            for row in (
                *index.nearest(sought, max(top, round(_NEAREST * len(index)))),
                *index.others,
            )
        ]
    comparisons: list[_Comparison] = []
    for comparison in each(partial(_beside, people, side, sought is not None), chosen):
        progress("comparing", 0.5 + 0.5 * len(comparisons) / len(chosen))
        comparisons.append(comparison)
    return comparisons


def _beside(people: People, probe: Prepared | Minutiae, quick: bool, entry: Entry) -> _Comparison:
    """Compare with a capture as `match` does, or `quick` as of
    :func:`splitknit_match.matching.fusion.fused_match`."""
    if isinstance(probe, Minutiae):
        read = partial(unpack_minutiae, people.payload(entry.row))
        enrolled = naming(f"row {entry.row} of '{people.path}'", read)
        return _Comparison(entry, "minutiae", compare_minutiae(probe, enrolled))
    capture = people.prepared(entry.row)
    method = "ridge" if by_ridges(probe.template, capture.template) else "fusion"
    return _Comparison(entry, method, compare_templates(method, probe, capture, quick=quick))


def _ranked(comparisons: Sequence[_Comparison]) -> list[_Comparison]:
    """Best first: by similarity, or by false match rate where methods differ in its scale."""
    scales = {comparison.method for comparison in comparisons}

    def order(comparison: _Comparison) -> tuple[float, float, str, str, tuple[int, int, str]]:
        person, finger, session = comparison.entry.names
        fmr = 1.0 if len(scales) < 2 else comparison.pair.rated(None).fmr
        fmr = 1.0 if fmr is None else fmr
        return fmr, -comparison.pair.similarity, person, finger, session_order(session)

    return sorted(comparisons, key=order)


def _merged(comparisons: Sequence[_Comparison], merge: str) -> list[_Comparison]:
    """The best of each person or finger, best first."""
    parts = _MERGED[merge]
    best: dict[tuple[str, ...], _Comparison] = {}
    for comparison in _ranked(comparisons):
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
