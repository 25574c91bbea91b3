"""``splitknit match A B``: how similar two fingers are."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from splitknit import BadInput
from splitknit.cli.verb import Outcome, Verb
from splitknit.verbs import Help, Progress
from splitknit_match.matching.match_job import MakeTemplateJob, MatchJob

if TYPE_CHECKING:
    from splitknit_match.matching.methods import (
        ComparedSide,
        FmrBasis,
        Match,
        MatchDecision,
        TemplateFile,
        TemplateMade,
    )

_DIGITS = {"minutiae": 0, "fusion": 2}
_NULLS = {"fusion": ("similarity_of_minutiae",), "minutiae": ("nfiq2",)}
"""Fields that ``--json`` has even where the method found none."""


@dataclass(frozen=True, slots=True)
class Raw:
    """How scores are shown."""

    raw: Annotated[bool, Help("print the method's own scores too (--json always has them)")] = False
    exit_code: Annotated[
        bool, Help("end with 0 for a match, 10 for no match, 11 undecided, 12 not acquired (without it always 0)")
    ] = False


@dataclass(frozen=True, slots=True)
class _Words(MatchJob):
    """Report how similar two fingers are."""

    b: Annotated[Path | None, Help("the same; not needed for `template`", "B", positional=True)] = None  # type: ignore[assignment]

    def run(self, progress: Progress) -> Match | TemplateMade:  # type: ignore[override]
        """Compare two fingers, or write the template of one."""
        if self.b is not None:
            return MatchJob.run(self, progress)
        if self.template is None:
            raise BadInput("name a second finger to compare with, or `template` to write.")
        how = {name: getattr(self, name) for name in ("preset", "settings", "input_ppi", "mask", "box")}
        return MakeTemplateJob(self.a, self.template, **how).run(progress)


def _show(found: Match | TemplateMade, job: MatchJob, how: Raw) -> Outcome:
    from splitknit.io.provenance import known_json  # verbs import what they need
    from splitknit_match.matching.methods import TemplateMade

    if isinstance(found, TemplateMade):
        assert found.template is not None
        facts = {"method": job.method, **known_json(replace(found, payload=None))}
        return facts, [*_failure_notes(job.method, found.a), _template_words(found.template)]
    kept = ("fmr", "fmr_missing", "fmr_basis", "decision", "undecided", *_NULLS.get(found.method, ()))
    return known_json(found, kept), _words(found, how.raw)


MATCH = Verb(_Words, _show, Raw)


def one_in(rate: float, basis: FmrBasis | None = None) -> str:
    """Write a false match rate for people, rounded up; "below" where no impostor of its `basis` is as similar.

    >>> one_in(1e-4), one_in(0.0359), one_in(0.7), one_in(0.5)
    ('1 in 10,000', '1 in 27', 'more than 1 in 2', '1 in 2')
    """
    if rate > 0.5:
        return "more than 1 in 2"
    people = int(1 / rate + 1e-9)
    step = 10 ** max(0, len(str(people)) - 2)
    return f"{'below ' if basis is not None and rate <= basis.smallest else ''}1 in {people // step * step:,}"


def decided_at(decision: MatchDecision) -> str:
    """At which false match rate was decided, and whether it is extrapolated."""
    rate, expected = one_in(decision.fmr), decision.expected_fmr
    beyond = "" if expected is None else f" (beyond what was measured: extrapolated; expected is {one_in(expected)})"
    return f"decided at a false match rate of {rate}{beyond}"


def basis_words(basis: FmrBasis) -> str:
    """What false match rates were measured on."""
    return f"{basis.impostors:,} impostor comparisons, {basis.population}"


def _words(found: Match, raw: bool) -> list[str]:
    lines = [_verdict(found)]
    if found.fmr is not None and found.fmr_basis is not None:
        rate, basis = one_in(found.fmr, found.fmr_basis), basis_words(found.fmr_basis)
        lines.append(f"Estimated false match rate: {rate} (measured on {basis}).")
    if raw:
        lines += _raw_words(found)
    lines += [f"{side.path}: {side.note}" for side in (found.a, found.b) if side.note]
    lines += _how(found) + _failure_notes(found.method, found.a, found.b)
    return lines if found.template is None else [*lines, _template_words(found.template)]


def _template_words(made: TemplateFile) -> str:
    return f"Template of {made.bytes} bytes (version {made.version}) written to {made.file}."


def _verdict(found: Match) -> str:
    if not found.compared and not (found.a.doubt or found.b.doubt):
        both = found.a.acquired and found.b.acquired
        apart = found.method in ("thesis", "fusion")
        word = "Undecided" if both else "Not acquired"
        return f"{word}, not compared: {'too little overlap' if both and apart else 'failure to acquire'}."
    if found.answer == "undecided":
        score = f"; its score is {_score(found)}" if found.fmr is None else ""
        return f"Undecided: {found.undecided}{score}."
    assert found.decision is not None
    said = "Match" if found.decision.match else "No match"
    return f"{said}, {decided_at(found.decision)} (method {found.method})."


def _score(found: Match) -> str:
    return f"{found.similarity:.{_DIGITS.get(found.method, 4)}f} ({_SCALES[found.method]})"


def _raw_words(found: Match) -> list[str]:
    digits = _DIGITS.get(found.method, 4)
    needed = "" if found.decision is None else f", a match from {found.decision.threshold:.{digits}f} on"
    lines = [f"Score {_score(found)}{needed}."]
    if found.similarity_of_ridges is not None and found.compared:
        score = found.similarity_of_minutiae
        minutiae = "too few" if score is None else f"{score:.1f}"
        lines.append(f"Its parts: ridges {found.similarity_of_ridges:.4f}, minutiae {minutiae}.")
    return lines


def _how(found: Match) -> list[str]:
    """What was compared: places and counts."""
    if found.method == "minutiae":
        return [_print_words(side) for side in (found.a, found.b)]
    laid = found.alignment
    assert laid is not None
    if found.method in ("thesis", "thesis-code") and laid.right_mm is not None:
        side = "right" if laid.right_mm >= 0 else "left"
        overlap = f"overlap {found.overlap:.3f} of both outlines (intersection over union)"
        return [f"{overlap}, B shifted {abs(laid.right_mm):.2f} mm to the {side}"]
    if not found.compared:
        return []
    turned = f"overlap {found.overlap_mm2:.0f} mm² of skin; A turned by {laid.rotation_deg:.1f} deg"
    return [f"{turned}, its middle {laid.right_mm:+.2f} mm right and {laid.up_mm:+.2f} mm up of B's"]


def _failure_notes(method: str, *sides: ComparedSide) -> list[str]:
    notes = []
    for side in sides:
        if side.acquired:
            continue
        lacks = "fewer than ten minutiae" if method == "minutiae" else "no ridges"
        if method != "minutiae" and side.kind == "print":
            lacks = "less than 10 mm² of ridges, which a print must show"
        if side.note is not None and side.note.startswith("no print of a finger"):
            lacks = side.note
        notes.append(f"Please note: {side.path} holds {lacks} (failure to acquire).")
    return notes


_SCALES = {
    "ridge": "1 = the same picture",
    "fusion": "log-likelihood ratio of ridges and minutiae, natural logarithm",
    "thesis": "1 = equal, 0 = as dissimilar as possible",
    "thesis-code": "1 = equal, negative for most others",
    "minutiae": "bozorth3: about how many pairs of minutiae fit together",
}
"""What the method's own score means."""


def _print_words(side: ComparedSide) -> str:
    if side.kind == "minutiae":
        return f"{side.path}: {side.minutiae} minutiae"
    quality = "unknown" if side.nfiq2 is None else f"{side.nfiq2} of 100"
    return f"{side.path}: {side.minutiae} minutiae, quality (NFIQ 2) {quality}"
