"""Results of comparisons: what each method measured, the answer, and how both are printed."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from splitknit.arguments import text_of
from splitknit.findings import Finding, Severity
from splitknit.io.provenance import known_json
from splitknit_match.matching.template import VERSION

_DIGITS = {"minutiae": 2, "fusion": 2}
_SCALES = {
    "ridge": "1 = the same picture",
    "fusion": "log-likelihood ratio of ridges and minutiae, natural logarithm",
    "thesis": "1 = equal, 0 = as dissimilar as possible",
    "thesis-code": "1 = the same images, negative even for two captures of one finger",
    "minutiae": "agreeing minutiae over the root of those that could agree",
}
"""What the method's own score means."""


@dataclass(frozen=True, slots=True)
class ComparedSide:
    """One of two fingers that were compared."""

    path: str
    kind: str
    """``capture``, ``result``, ``template``, ``print``, ``photo`` (of a finger) or ``minutiae``."""
    area_mm2: float
    """Area of its ridges."""
    acquired: bool
    """False: a failure to acquire, which matches nobody."""
    minutiae: int | None = None
    """How many were compared, by methods of minutiae."""
    quality: float | None = None
    """Of a photograph, 0 to 100: percent of the finger with clear ridges."""
    chance: float | None = None
    """Of a print: that another impression of the finger, about as large, matches it, 0 to 1."""


@dataclass(frozen=True, slots=True)
class PlaneAlignment:
    """How side A is laid on side B, in the plane; None where the method does not move it so."""

    rotation_deg: float | None = None
    right_mm: float | None = None
    up_mm: float | None = None


@dataclass(frozen=True, slots=True)
class FmrBasis:
    """What false match rates were measured on."""

    impostors: int
    """Comparisons of different fingers."""
    population: str
    smallest: float
    """The smallest rate that they can state."""


@dataclass(frozen=True, slots=True)
class MatchDecision:
    """Whether it is one finger."""

    match: bool
    fmr: float
    """False match rate at which was decided."""
    threshold: float
    """Similarity from which on it is a match."""
    expected_fmr: float | None = None
    """Where so small a rate was not measured: what is to be expected; `fmr` is then its upper limit
    of 95 %."""


@dataclass(frozen=True, slots=True)
class TemplateFile:
    """A template that was written."""

    file: str
    bytes: int
    version: int = VERSION


@dataclass(frozen=True, slots=True, kw_only=True)
class Rated:
    """What a similarity says, given what was compared."""

    fmr: float | None = None
    """False match rate at this similarity, None where it is not known."""
    fmr_missing: str | None = None
    """Why it is not."""
    fmr_basis: FmrBasis | None = None
    decision: MatchDecision | None = None
    answer: str = "undecided"
    """``match``, ``no match``, ``undecided``, or ``not acquired``."""
    undecided: str | None = None
    """Why the answer is neither ``match`` nor ``no match``, and what it takes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Match(Rated):
    """What a comparison by any method says."""

    method: str
    """That was used, never ``auto``."""
    a: ComparedSide
    b: ComparedSide
    similarity: float
    """The method's score; higher is more similar."""
    compared: bool
    """False: a failure to acquire, or too little overlap."""
    template: TemplateFile | None = None
    """Template of side A, where one was written."""
    findings: tuple[Finding, ...] = ()
    """What was assumed of both sides, or is in doubt: then the answer is undecided."""

    @property
    def facts(self) -> dict[str, Any]:
        """The same as plain JSON."""
        kept = ("fmr", "fmr_missing", "fmr_basis", "decision", "undecided")
        return dict(known_json(self, kept))

    def __str__(self) -> str:
        return text_of(match_lines(self))


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchOfRidges(Match):
    """Of the method ``ridge``."""

    overlap_mm2: float
    correlation: float
    alignment: PlaneAlignment


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchOfPrints(MatchOfRidges):
    """Of the method ``fusion``."""

    similarity_of_ridges: float
    similarity_of_minutiae: float | None
    """0 to 1; None where there are too few."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchOfImages(Match):
    """Of the methods ``thesis`` and ``thesis-code``."""

    overlap: float
    """Intersection over union of both outlines."""
    distances: Mapping[str, float]
    """By kind of image; so `dissimilarity`."""
    dissimilarity: Mapping[str, float] | None = None
    """The thesis's score (5.2), of the method ``thesis``."""
    alignment: PlaneAlignment


@dataclass(frozen=True, slots=True)
class TemplateMade:
    """A finger whose template was made."""

    a: ComparedSide
    template: TemplateFile | None
    """The file, where one was written."""
    payload: bytes = field(default=b"", repr=False)
    """What a `.skt` file holds, which `match`, `identify` and `enroll` take; no bytes for a failure
    to acquire."""
    findings: tuple[Finding, ...] = ()
    """What was assumed of the finger, worst first."""

    @property
    def facts(self) -> dict[str, Any]:
        """The same as plain JSON, without the template itself."""
        return {name: known_json(getattr(self, name)) for name in ("a", "template", "findings")}

    def __str__(self) -> str:
        lines = [f"Please note: {finding}" for finding in self.findings]
        return text_of(lines if self.template is None else [*lines, template_line(self.template)])


def one_in(rate: float, basis: FmrBasis | None = None) -> str:
    """Write a false match rate for people, rounded up; "below" where no impostor of its `basis` is
    as similar.

    >>> one_in(1e-4), one_in(0.0359), one_in(0.7), one_in(0.5)
    ('1 in 10,000', '1 in 27', 'more than 1 in 2', '1 in 2')
    """
    if rate > 0.5:
        return "more than 1 in 2"
    people = int(1 / rate + 1e-9)
    step = 10 ** max(0, len(str(people)) - 2)
    below = "below " if basis is not None and rate <= basis.smallest else ""
    return f"{below}1 in {people // step * step:,}"


def decided_at(decision: MatchDecision) -> str:
    """At which false match rate was decided, and whether it is extrapolated."""
    words = f"decided at a false match rate of {one_in(decision.fmr)}"
    if decision.expected_fmr is None:
        return words
    return (
        f"{words} (beyond what was measured: extrapolated; expected is"
        f" {one_in(decision.expected_fmr)})"
    )


def basis_words(basis: FmrBasis) -> str:
    """What false match rates were measured on."""
    return f"{basis.impostors:,} impostor comparisons, {basis.population}"


def match_lines(match: Match, *, scores: bool = False) -> list[str]:
    """Of a comparison; `scores`: also the method's own, whose scale few know."""
    lines = [_verdict(match)]
    if match.fmr is not None and match.fmr_basis is not None:
        rate = one_in(match.fmr, match.fmr_basis)
        lines.append(
            f"Estimated false match rate: {rate} (measured on {basis_words(match.fmr_basis)})."
        )
    if scores:
        threshold = (
            ""
            if match.decision is None
            else f", a match from {_number(match, match.decision.threshold)} on"
        )
        lines.append(f"Score {_score(match)}{threshold}.")
        if isinstance(match, MatchOfPrints) and match.compared:
            minutiae = match.similarity_of_minutiae
            words = "too few" if minutiae is None else f"{minutiae:.1f}"
            lines.append(f"Its parts: ridges {match.similarity_of_ridges:.4f}, minutiae {words}.")
    lines += _how(match) + noted(match.findings)
    return lines if match.template is None else [*lines, template_line(match.template)]


def noted(findings: Iterable[Finding]) -> list[str]:
    """Lines of what is to be noted; a doubt is stated by the verdict."""
    return [f"Please note: {each}" for each in findings if each.severity == Severity.NOTE]


def template_line(template: TemplateFile) -> str:
    """Of a template that was written."""
    return (
        f"Template of {template.bytes} bytes (version {template.version}) written to"
        f" {template.file}."
    )


def _verdict(match: Match) -> str:
    doubted = any(finding.severity == Severity.DOUBT for finding in match.findings)
    if not match.compared and not doubted:
        if not (match.a.acquired and match.b.acquired):
            return "Not acquired, not compared: failure to acquire."
        little = match.method in ("thesis", "fusion")
        return (
            f"Undecided, not compared: {'too little overlap' if little else 'failure to acquire'}."
        )
    if match.decision is None:
        score = f"; its score is {_score(match)}" if match.fmr is None else ""
        return f"Undecided: {match.undecided}{score}."
    answer = "Match" if match.decision.match else "No match"
    return f"{answer}, {decided_at(match.decision)} (method {match.method})."


def _number(match: Match, score: float) -> str:
    return f"{score:.{_DIGITS.get(match.method, 4)}f}"


def _score(match: Match) -> str:
    scale = _SCALES.get(match.method, "higher is more similar")
    return f"{_number(match, match.similarity)} ({scale})"


def _how(match: Match) -> list[str]:
    """What was compared: places and counts."""
    if isinstance(match, MatchOfImages):
        right_mm = match.alignment.right_mm or 0.0
        way = "right" if right_mm >= 0 else "left"
        overlap = f"overlap {match.overlap:.3f} of both outlines (intersection over union)"
        return [f"{overlap}, B shifted {abs(right_mm):.2f} mm to the {way}"]
    if isinstance(match, MatchOfRidges):
        laid = match.alignment
        turned = (
            f"overlap {match.overlap_mm2:.0f} mm² of skin; A turned by {laid.rotation_deg:.1f} deg"
        )
        line = (
            f"{turned}, its middle {laid.right_mm:+.2f} mm right and {laid.up_mm:+.2f} mm up of B's"
        )
        return [line] if match.compared else []
    return [f"{side.path}: {side.minutiae} minutiae" for side in (match.a, match.b)]
