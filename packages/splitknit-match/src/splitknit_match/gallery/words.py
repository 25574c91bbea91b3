"""What identifications say to people: lines out of their results."""

from __future__ import annotations

from typing import TYPE_CHECKING

from splitknit.arguments import count
from splitknit_match.matching.results import basis_words, decided_at, one_in

if TYPE_CHECKING:
    from splitknit_match.gallery.identify import Identification


def identification_lines(search: Identification, *, scores: bool = False) -> list[str]:
    """Of an identification; `scores`: also the method's own, whose scale few know."""
    lines, basis, decision = [_verdict(search)], search.fmr_basis, search.decision
    for candidate in search.candidates:
        who = f"{candidate.person}, {candidate.finger.replace('_', ' ')}, session {candidate.session}"
        rate = "not known" if basis is None or candidate.fmr is None else one_in(candidate.fmr, basis)
        score = f", score {candidate.similarity:.5g}" if scores or basis is None else ""
        lines.append(f"{candidate.rank:>3}. {who}: estimated false match rate {rate}{score}")
    if search.candidates and basis is not None:
        lines.append(f"Rates were measured on {basis_words(basis)}.")
    if scores and decision is not None:
        lines.append(f"A match has a score of {decision.threshold:.5g} or more.")
    searched = search.searched
    how = {"fusion": "by ridges and minutiae", "minutiae": "by minutiae"}.get(searched.compared_by, "ridge by ridge")
    whose = f" ({count(searched.fingers, 'finger')} of {count(searched.people, 'person', 'people')})"
    lines.append(f"Searched: {count(searched.captures, 'capture')}{whose}, {searched.compared} compared {how}.")
    if search.candidates and decision is not None:
        first = search.candidates[0].expected_false_matches or 0.0
        lines.append(
            f"Among {count(searched.captures, 'capture')} of other fingers {first:.2g} are to be "
            "expected as similar as the first candidate, "
            f"and {decision.expected_false_matches:.2g} beyond the limit."
        )
    if search.probe.note:
        lines.append(f"Please note: {search.probe.path}: {search.probe.note}")
    if searched.note:
        lines.append(f"Please note: {searched.note}")
    if searched.failures:
        lines.append(f"Please note: {searched.failures} failures to acquire in the gallery match nobody.")
    return lines


def _verdict(search: Identification) -> str:
    decision = search.decision
    if not search.probe.acquired and not search.probe.doubt:
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
