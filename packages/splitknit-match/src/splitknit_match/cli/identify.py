"""``splitknit identify GALLERY PROBE``: who is it?"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from splitknit.cli.verb import Outcome, Verb, count
from splitknit.model import Progress
from splitknit_match.cli.match import Raw, basis_words, decided_at, one_in
from splitknit_match.cli.pad import Refusal, refuse_attacks
from splitknit_match.gallery.identify_job import IdentifyJob

if TYPE_CHECKING:
    from splitknit_match.gallery.identify import Identification


@dataclass(frozen=True, slots=True)
class _Guarded(IdentifyJob):
    """Find a finger in a gallery, or check whose it is said to be."""

    pad: Refusal = False

    def run(self, progress: Progress) -> Identification:
        """Refuse attacks, then search."""
        presented = refuse_attacks(self.pad, [self.probe], self.preset, progress)
        return replace(IdentifyJob.run(self, progress), presentation=presented)


def _show(found: Identification, job: IdentifyJob, how: Raw) -> Outcome:
    from splitknit.io.provenance import known_json  # verbs import what they need

    return known_json(found), _words(found, how.raw)


IDENTIFY = Verb(_Guarded, _show, Raw)


def _words(found: Identification, raw: bool) -> list[str]:
    lines, basis, decision = [_verdict(found)], found.fmr_basis, found.decision
    for one in found.candidates:
        who = f"{one.person}, {one.finger.replace('_', ' ')}, session {one.session}"
        rate = "not known" if basis is None or one.fmr is None else one_in(one.fmr, basis)
        score = f", score {one.similarity:.5g}" if raw or basis is None else ""
        lines.append(f"{one.rank:>3}. {who}: estimated false match rate {rate}{score}")
    if found.candidates and basis is not None:
        lines.append(f"Rates were measured on {basis_words(basis)}.")
    if raw and decision is not None:
        lines.append(f"A match has a score of {decision.threshold:.5g} or more.")
    searched = found.searched
    how = {"fusion": "by ridges and minutiae", "minutiae": "by minutiae"}.get(searched.compared_by, "ridge by ridge")
    whose = f" ({count(searched.fingers, 'finger')} of {count(searched.people, 'person', 'people')})"
    lines.append(f"Searched: {count(searched.captures, 'capture')}{whose}, {searched.compared} compared {how}.")
    if found.candidates and decision is not None:
        first = found.candidates[0].expected_false_matches or 0.0
        lines.append(
            f"Among {count(searched.captures, 'capture')} of other fingers {first:.2g} are to be "
            "expected as similar as the first candidate, "
            f"and {decision.expected_false_matches:.2g} beyond the limit."
        )
    if found.probe.note:
        lines.append(f"Please note: {found.probe.path}: {found.probe.note}")
    if searched.note:
        lines.append(f"Please note: {searched.note}")
    if searched.failures:
        lines.append(f"Please note: {searched.failures} failures to acquire in the gallery match nobody.")
    return lines


def _verdict(found: Identification) -> str:
    decision = found.decision
    if not found.probe.acquired and not found.probe.doubt:
        lacks = "too few minutiae" if found.by == "minutiae" else "no ridges"
        return f"Not acquired: {found.probe.path} holds {lacks} (failure to acquire)."
    if found.searched.captures == 0:
        return "No match: there is nothing to compare with."
    if decision is None:
        return f"Undecided: {found.undecided}."
    at = f"{decided_at(decision)} a comparison"
    if found.mode == "verification":
        return f"{'Verified' if decision.match else 'Not verified'}: {found.person} ({at})."
    if not decision.match:
        return f"No match: nobody is similar enough ({at})."
    best = found.candidates[0]
    return f"Match: {best.person}, {best.finger.replace('_', ' ')} ({at})."
