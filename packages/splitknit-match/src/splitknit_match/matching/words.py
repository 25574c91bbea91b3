"""What comparisons say to people: lines out of their results."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from splitknit_match.matching.methods import ComparedSide, FmrBasis, Match, MatchDecision, TemplateFile

_DIGITS = {"minutiae": 0, "fusion": 2}
_SCALES = {
    "ridge": "1 = the same picture",
    "fusion": "log-likelihood ratio of ridges and minutiae, natural logarithm",
    "thesis": "1 = equal, 0 = as dissimilar as possible",
    "thesis-code": "1 = equal, negative for most others",
    "minutiae": "bozorth3: about how many pairs of minutiae fit together",
}
"""What the method's own score means."""


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


def match_lines(match: Match, *, scores: bool = False) -> list[str]:
    """Of a comparison; `scores`: also the method's own, whose scale few know."""
    lines = [_verdict(match)]
    if match.fmr is not None and match.fmr_basis is not None:
        rate, basis = one_in(match.fmr, match.fmr_basis), basis_words(match.fmr_basis)
        lines.append(f"Estimated false match rate: {rate} (measured on {basis}).")
    if scores:
        lines += _score_lines(match)
    lines += [f"{side.path}: {side.note}" for side in (match.a, match.b) if side.note]
    lines += _how(match) + failure_notes(match.method, match.a, match.b)
    return lines if match.template is None else [*lines, template_line(match.template)]


def template_line(template: TemplateFile) -> str:
    """Of a template that was written."""
    return f"Template of {template.bytes} bytes (version {template.version}) written to {template.file}."


def _verdict(match: Match) -> str:
    if not match.compared and not (match.a.doubt or match.b.doubt):
        both = match.a.acquired and match.b.acquired
        apart = match.method in ("thesis", "fusion")
        word = "Undecided" if both else "Not acquired"
        return f"{word}, not compared: {'too little overlap' if both and apart else 'failure to acquire'}."
    if match.answer == "undecided":
        score = f"; its score is {_score(match)}" if match.fmr is None else ""
        return f"Undecided: {match.undecided}{score}."
    assert match.decision is not None
    answer = "Match" if match.decision.match else "No match"
    return f"{answer}, {decided_at(match.decision)} (method {match.method})."


def _score(match: Match) -> str:
    return f"{match.similarity:.{_DIGITS.get(match.method, 4)}f} ({_SCALES[match.method]})"


def _score_lines(match: Match) -> list[str]:
    digits = _DIGITS.get(match.method, 4)
    needed = "" if match.decision is None else f", a match from {match.decision.threshold:.{digits}f} on"
    lines = [f"Score {_score(match)}{needed}."]
    if match.similarity_of_ridges is not None and match.compared:
        score = match.similarity_of_minutiae
        minutiae = "too few" if score is None else f"{score:.1f}"
        lines.append(f"Its parts: ridges {match.similarity_of_ridges:.4f}, minutiae {minutiae}.")
    return lines


def _how(match: Match) -> list[str]:
    """What was compared: places and counts."""
    if match.method == "minutiae":
        return [_print_words(side) for side in (match.a, match.b)]
    laid = match.alignment
    assert laid is not None
    if match.method in ("thesis", "thesis-code") and laid.right_mm is not None:
        side = "right" if laid.right_mm >= 0 else "left"
        overlap = f"overlap {match.overlap:.3f} of both outlines (intersection over union)"
        return [f"{overlap}, B shifted {abs(laid.right_mm):.2f} mm to the {side}"]
    if not match.compared:
        return []
    turned = f"overlap {match.overlap_mm2:.0f} mm² of skin; A turned by {laid.rotation_deg:.1f} deg"
    return [f"{turned}, its middle {laid.right_mm:+.2f} mm right and {laid.up_mm:+.2f} mm up of B's"]


def failure_notes(method: str, *sides: ComparedSide) -> list[str]:
    """Of sides from which nothing was acquired."""
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


def _print_words(side: ComparedSide) -> str:
    if side.kind == "minutiae":
        return f"{side.path}: {side.minutiae} minutiae"
    quality = "unknown" if side.nfiq2 is None else f"{side.nfiq2} of 100"
    return f"{side.path}: {side.minutiae} minutiae, quality (NFIQ 2) {quality}"
