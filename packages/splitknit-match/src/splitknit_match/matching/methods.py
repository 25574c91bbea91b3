"""Matching of files by one of five methods: captures, results, templates and prints in, similarity
out."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache, lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from splitknit import BadInput
from splitknit.errors import naming, require
from splitknit.findings import Finding, Severity, worst_first
from splitknit.registry import own_object
from splitknit_match.matching.fusion import (
    SMALL_MM2,
    at_one_scale,
    by_ridges,
    fused_match,
    fused_photo,
)
from splitknit_match.matching.inputs import Side, undoubted, with_print
from splitknit_match.matching.minutiae_match import minutiae_match
from splitknit_match.matching.results import (
    ComparedSide,
    Match,
    MatchDecision,
    MatchOfImages,
    MatchOfPrints,
    MatchOfRidges,
    PlaneAlignment,
    Rated,
    TemplateFile,
)
from splitknit_match.matching.ridge import Prepared, RidgeMatch, ridge_match
from splitknit_match.matching.score import FMR_ROUNDING, FmrTable
from splitknit_match.matching.surface import surface_images
from splitknit_match.matching.template import VERSION, Template, mirrored
from splitknit_match.records.minutiae_record import PPI, Minutiae
from splitknit_match.records.templates import is_template, write_template

if TYPE_CHECKING:
    from splitknit_match.matching.thesis import ThesisSettings

TABLES = {
    "ridge": "match_fmr.json",
    "fusion": "match_fmr_prints.json",
    "fingerphotos alone": "match_fmr_fingerphotos_alone.json",
    "fingerphotos and prints": "match_fmr_fingerphotos_and_prints.json",
    "contactless alone": "match_fmr_contactless_alone.json",
    "contactless and prints": "match_fmr_contactless_and_prints.json",
    "windows": "match_fmr_windows.json",
    "minutiae_of_prints": "match_fmr_minutiae_prints.json",
    "minutiae_of_records": "match_fmr_minutiae_records.json",
}
"""False match rates, made by validation/match/unseen.py of real prints, windows.py of parts of
them, records.py of real records, and impostors.py, telephone.py and surfaces.py of simulated
fingers; where real impostors of such kinds state larger rates, these."""
Common = dict[str, Any]
"""What every method says of a comparison: method and sides."""
OwnMatcher = Callable[[NDArray[np.uint8], NDArray[np.uint8]], float]
"""From two prints (H, W) at 500 ppi, ridges dark, to a similarity; NaN: not compared."""


@dataclass(frozen=True, slots=True)
class Compared:
    """Two fingers, compared by ridges, the fusion or minutiae; whichever door they came by."""

    similarity: float
    compared: bool
    scores: str
    """Impostors by which it is rated."""
    ridge: RidgeMatch
    minutiae: float | None = None
    """Similarity of minutiae alone."""
    scale: float = 1.0
    """At which a photograph fits best, of side `scaled` (0, 1)."""
    scaled: int = 0

    def rated(self, fmr: float | None, own: FmrTable | None = None) -> Rated:
        """Answer and false match rate, decided at `fmr`."""
        if not self.compared:
            return _unknown("nothing was compared")
        return rate(self.similarity, self.scores, self.ridge.overlap_mm2, fmr, own)


def compare_templates(method: str, a: Prepared, b: Prepared, *, quick: bool = False) -> Compared:
    """Compare two templates by ``ridge`` or ``fusion``; `quick` as of
    :func:`splitknit_match.matching.fusion.fused_match`."""
    kinds = a.template.kind, b.template.kind
    if method == "ridge":
        ridge = ridge_match(a, b)
        sides = (a, b) if kinds[0] == kinds[1] else (a.printed, b.printed)
        areas_mm2 = sides[0].template.area_mm2, sides[1].template.area_mm2
        scores = scores_of(impostors_of(method, *kinds), areas_mm2, None)
        return Compared(ridge.similarity, ridge.compared, scores, ridge)
    photos = [kind == "photo" for kind in kinds]
    scale, number = 1.0, 0
    if any(photos):
        fused, scale, number = fused_photo(a, b, photos, quick=quick)
    else:
        fused = fused_match(a, b, quick=quick)
    areas_mm2 = a.printed.template.area_mm2, b.printed.template.area_mm2
    scores = scores_of(impostors_of(method, *kinds), areas_mm2, fused.minutiae)
    return Compared(
        fused.similarity, fused.compared, scores, fused.ridge, fused.minutiae, scale, number
    )


def compare_minutiae(a: Minutiae, b: Minutiae) -> Compared:
    """Compare two sets of minutiae."""
    scores = impostors_of("minutiae", a.kind, b.kind)
    return Compared(minutiae_match(a, b), a.acquired and b.acquired, scores, RidgeMatch(-1.0))


def impostors_of(method: str, *kinds: str) -> str:
    """Impostors by which a comparison of two kinds is rated, see :data:`TABLES`."""
    photos = sum("photo" in kind for kind in kinds)
    contactless = sum(kind in ("surface", "contactless") for kind in kinds)
    if method != "fusion" and photos:
        return f"{method} on photographs"
    if method == "minutiae" and kinds != ("surface", "surface"):
        return "minutiae_of_prints"
    if method != "fusion":
        return method
    if photos and contactless:
        return f"{method} of photographs with surfaces"
    if not photos + contactless:
        return method
    what = "fingerphotos" if photos else "contactless"
    return f"{what} alone" if photos + contactless == 2 else f"{what} and prints"


def compare_sides(
    method: str,
    a: Side,
    b: Side,
    *,
    fmr: float | None,
    own: FmrTable | None,
    thesis: ThesisSettings,
) -> Match:
    """Compare two fingers by a method, with false match rate and decision.

    Where a print does not show whether its ridges are dark, the reading that matches is taken.
    Raises BadInput, naming the file at fault, or if `fmr` is below what was measured.
    """
    if method in ("ridge", "fusion") and (a.either or b.either):
        compare = partial(compare_sides, method, fmr=fmr, own=own, thesis=thesis)
        dark = compare(a.reading(light=False), b.reading(light=False))
        if dark.answer == "match":
            return dark
        # a negative beside a print is as the print beside a negative
        light = compare(a.reading(light=a.either), b.reading(light=not a.either))
        return light if light.answer == "match" else dark
    kinds = [side.template.kind for side in (a, b) if side.template is not None]
    scores = impostors_of(method, *kinds)
    common = {"method": method, "a": compared_side(a), "b": compared_side(b)}
    match: Match
    if method in ("ridge", "fusion"):
        match, scores = _by_templates(method, a, b, common)
    elif method == "minutiae":
        match, scores = _by_minutiae(a, b, common)
    elif method in ("thesis", "thesis-code"):
        match = _by_images(method, thesis, a, b, common)
    else:
        match = _by_own(method, a, b, common)
    doubts = [side.doubt for side in (a, b) if side.doubt is not None]
    match = _rated(match, scores, fmr, own, doubts)
    findings = [*a.findings, *b.findings, *match.findings]
    findings += _failure(method, a, match.a) + _failure(method, b, match.b)
    match = replace(match, findings=worst_first(findings))
    photos = any("photo" in kind for kind in kinds)
    if method == "fusion" and not photos and match.fmr is not None and match.answer != "match":
        templates = _template(a), _template(b)
        doubt = scale_doubt(*templates, fmr, own)
        turned = mirrored(templates[0].printed)
        if (
            doubt is None
            and match.answer == "no match"
            and _prints_match(turned, templates[1], fmr, own)
        ):
            doubt = Finding(
                "mirrored-print",
                "one seen in a mirror, both match: one of the pictures is mirrored; turn it round.",
                Severity.DOUBT,
            )
        if doubt is not None:
            return replace(
                match,
                answer="undecided",
                undecided=reason(doubt),
                decision=None,
                findings=worst_first([*match.findings, doubt]),
            )
    return match


def auto_method(a: Side, b: Side) -> str:
    """The method for what two sides hold."""
    if a.template is None or b.template is None:
        return "minutiae"
    return "ridge" if by_ridges(a.template, b.template) else "fusion"


def check_template_file(template: Path | None, *inputs: Any) -> None:
    """Raise BadInput where a template would replace something else."""
    if template is None:
        return
    from splitknit.io.targets import check_file  # a comparison needs none of it

    empty = template.suffix == ".skt"  # is a failure to acquire
    check_file(template, "a template", lambda data: is_template(data) if data else empty)
    sources = [path.expanduser().resolve() for path in inputs if isinstance(path, Path)]
    require(
        template.expanduser().resolve() not in sources,
        f"'{template}' is one of the inputs; name another file.",
    )


def write_template_file(template: Path | None, side: Side) -> TemplateFile | None:
    """Write the template of a side where a file is named."""
    if template is None:
        return None
    write_template(template, undoubted(side).payload, VERSION)
    return TemplateFile(str(template), template.stat().st_size)


def _by_templates(method: str, a: Side, b: Side, common: Common) -> tuple[MatchOfRidges, str]:
    """Compare by ridges alone, or two prints by ridges and minutiae; and the impostors that rate
    it.

    Raises BadInput if a side holds no ridges, or of the method fusion no minutiae.
    """
    templates = [_comparable(method, side) for side in (a, b)]
    left, right = (
        side.prepared or _ready(template) for side, template in zip((a, b), templates, strict=True)
    )
    pair = compare_templates(method, left, right)
    ridge = pair.ridge
    common = {
        **common,
        "similarity": pair.similarity,
        "compared": pair.compared,
        "overlap_mm2": ridge.overlap_mm2,
        "correlation": ridge.correlation,
        "alignment": PlaneAlignment(ridge.rotation_deg, ridge.right_mm, ridge.up_mm),
    }
    if method == "ridge":
        return MatchOfRidges(**common), pair.scores
    for name, side in (("a", a), ("b", b)):
        printed = _template(side).printed
        assert printed.minutiae is not None
        acquired = printed.minutiae.acquired or not printed.empty
        common[name] = replace(common[name], minutiae=printed.minutiae.count, acquired=acquired)
    findings = []
    if abs(pair.scale - 1) >= 0.01:
        larger = f"{100 * abs(pair.scale - 1):.0f} % {'larger' if pair.scale > 1 else 'smaller'}"
        fits = Finding("fingerphoto-scale", f"it fits best {larger}.")
        findings.append(fits.of_file((a, b)[pair.scaled].path))
    match = MatchOfPrints(
        **common,
        similarity_of_ridges=ridge.similarity,
        similarity_of_minutiae=pair.minutiae,
        findings=tuple(findings),
    )
    return match, pair.scores


@lru_cache(8)
def _ready(template: Template) -> Prepared:
    """What the questions of one comparison share."""
    return Prepared(template)


def _comparable(method: str, side: Side) -> Template:
    template = _template(side)
    if method != "ridge" and template.printed.minutiae is None:
        raise BadInput(
            f"{side.path} is a {side.kind} without minutiae of a print; the method {method}"
            " compares prints: name one, or a template (.skt) that was made of one."
        )
    return template


def _by_minutiae(a: Side, b: Side, common: Common) -> tuple[Match, str]:
    """Compare by minutiae; and the impostors that rate it. Raises BadInput if a side is a template
    of ridges."""
    minutiae = side_minutiae(a), side_minutiae(b)
    sides = {
        name: replace(common[name], minutiae=own.count, acquired=own.acquired)
        for name, own in zip("ab", minutiae, strict=True)
    }
    pair = compare_minutiae(*minutiae)
    return Match(**common | sides, similarity=pair.similarity, compared=pair.compared), pair.scores


def _by_images(
    method: str, settings: ThesisSettings, a: Side, b: Side, common: Common
) -> MatchOfImages:
    from splitknit_match.matching.thesis import thesis_match  # a template needs none of these
    from splitknit_match.matching.thesis_code import code_match, code_side

    images = []
    for side in (a, b):
        if side.surface is None:
            raise BadInput(
                f"{side.path} is a {side.kind}; the method {method} compares surfaces: name a"
                " capture or a result."
            )
        images.append(naming(side.path, partial(surface_images, side.surface)))
    match = (
        thesis_match(images[0], images[1], settings)
        if method == "thesis"
        else code_match(*map(code_side, images))
    )
    return MatchOfImages(
        **common,
        similarity=match.similarity,
        compared=match.compared,
        overlap=match.ratio,
        distances=match.distances,
        dissimilarity=match.dissimilarity or None,
        alignment=PlaneAlignment(right_mm=match.shift_px / images[0].px_per_mm),
    )


KNOWN = ("auto", "ridge", "fusion", "thesis", "thesis-code", "minutiae")


def check_method(method: str) -> None:
    """Raise BadInput if it is neither known nor somebody's own matcher."""
    if method not in KNOWN:
        own_object("matcher", method, KNOWN)


def _by_own(method: str, a: Side, b: Side, common: Common) -> Match:
    matcher: OwnMatcher = own_object("matcher", method, KNOWN)
    similarity = float(matcher(_print_of(a), _print_of(b)))
    acquired = common["a"].acquired and common["b"].acquired
    compared = acquired and math.isfinite(similarity)
    return Match(**common, similarity=similarity, compared=compared)


def _template(side: Side) -> Template:
    if side.template is None:
        raise BadInput(f"{side.path} holds minutiae, no ridges; compare by the method minutiae.")
    return side.template


def compared_side(side: Side) -> ComparedSide:
    """What a result says of a side."""
    template = side.template
    if template is None:
        assert side.minutiae is not None
        return ComparedSide(str(side.path), side.kind, 0.0, side.minutiae.acquired)
    return ComparedSide(
        str(side.path),
        side.kind,
        template.area_mm2,
        not template.empty,
        quality=side.quality,
        chance=template.chance,
    )


def template_findings(side: Side) -> tuple[Finding, ...]:
    """What is to be known of a side whose template is made."""
    return worst_first([*side.findings, *_failure("ridge", side, compared_side(side))])


def _failure(method: str, side: Side, compared: ComparedSide) -> list[Finding]:
    """A finding where nothing was acquired from a side."""
    if compared.acquired:
        return []
    code = "failure-to-acquire"
    if side.template is not None and side.template.lacks:
        code = "not-a-print"
        lacks = side.template.lacks
    elif method == "minutiae":
        lacks = "fewer than ten minutiae"
    elif side.kind == "print":
        lacks = "less than 10 mm² of ridges, which a print must show"
    else:
        lacks = "no ridges"
    path = compared.path
    return [Finding(code, f"{path} holds {lacks} (failure to acquire).", files=(path,))]


def side_minutiae(side: Side) -> Minutiae:
    """Minutiae of a side: those of its record, or of its print (of a surface unrolled). Raises
    BadInput if it is a template that holds none."""
    minutiae = side.minutiae
    if minutiae is None:
        minutiae = _comparable("minutiae", with_print(side)).printed.minutiae
        assert minutiae is not None
    return minutiae if side.template is None else replace(minutiae, kind=side.template.kind)


def _print_of(side: Side) -> NDArray[np.uint8]:
    """The print of a side at 500 ppi."""
    if side.surface is not None:
        from splitknit.finger.ridges import surface_print  # a template needs none of it

        return naming(side.path, partial(surface_print, side.surface, PPI))
    if side.picture is None:
        raise BadInput(
            f"{side.path} is a {side.kind} of ridges, which keeps no minutiae; name a capture, a"
            " result or a print."
        )
    return side.picture


def reason(doubt: Finding) -> str:
    """A doubt as the reason of an answer."""
    return str(doubt).rstrip(".")


def _prints_match(a: Template, b: Template, fmr: float | None, own: FmrTable | None) -> bool:
    """Whether two prints match by ridges and minutiae."""
    pair = compare_templates("fusion", _ready(a), _ready(b), quick=True)
    return pair.rated(fmr, own).answer == "match"


def scale_doubt(
    a: Template, b: Template, fmr: float | None, own: FmrTable | None = None
) -> Finding | None:
    """Why two prints that do not match are not shown to be of two fingers: at one scale of their
    ridges they match."""
    sides = at_one_scale(a.printed, b.printed)
    if sides is None or not _prints_match(*sides[:2], fmr, own):
        return None
    apart = 100 * (sides[2] - 1)
    return Finding(
        "unequal-scales",
        f"the ridges of one lie {apart:.0f} % farther apart, and at one scale both match: check"
        " their resolutions.",
        Severity.DOUBT,
    )


def _rated(
    match: Match, scores: str, fmr: float | None, own: FmrTable | None, doubts: Sequence[Finding]
) -> Match:
    """With the false match rate and its basis, or why there is none, and the decision at a rate, by
    own rates; `doubts`: of the sides."""
    if not doubts and not (match.a.acquired and match.b.acquired):
        return replace(
            match,
            fmr_missing="nothing was compared",
            answer="not acquired",
            undecided="failure to acquire",
        )
    if not match.compared:
        rated = _unknown("nothing was compared")
    else:
        overlap_mm2 = match.overlap_mm2 if isinstance(match, MatchOfRidges) else None
        rated = rate(match.similarity, scores, overlap_mm2, fmr, own)
    # one resolution confirms the other
    if doubts and not (len(doubts) == 1 and rated.answer == "match"):
        rated = _unknown(reason(doubts[0]))
    return replace(match, **{field.name: getattr(rated, field.name) for field in fields(Rated)})


def _unknown(why: str) -> Rated:
    return Rated(fmr_missing=why, undecided=why)


def scores_of(method: str, areas_mm2: tuple[float, float], minutiae: float | None) -> str:
    """Choose the impostor table; comparisons with few minutiae have their own.

    `minutiae`: the fusion's `similarity_of_minutiae`.
    """
    small = min(areas_mm2) < SMALL_MM2
    if method == "fusion":
        return "windows" if small or minutiae is None else method
    if method.startswith("contactless"):
        return f"{method} small" if small or minutiae is None else method
    return (
        f"{method} small" if small and (method == "ridge" or "fingerphotos" in method) else method
    )


DECIDED_AT = 1e-4  # false match rate at which is decided whether it is one finger


def rate(
    similarity: float,
    scores: str,
    overlap_mm2: float | None,
    fmr: float | None = None,
    own: FmrTable | None = None,
) -> Rated:
    """Answer and false match rate of a similarity by `scores` (:func:`scores_of`) or `own` rates,
    decided at `fmr`.

    Raises BadInput if no rate as small as `fmr` was measured (but of small prints and photographs,
    which are undecided).
    """
    if own is None and scores not in TABLES:
        method = scores.removesuffix(" small")
        where = (
            "not measured"
            if method == scores
            else f"measured on {SMALL_MM2:.0f} mm² of skin or more"
        )
        return _unknown(f"false match rates of the method {method} were {where}")
    table = own or fmr_table(scores)
    if overlap_mm2 is not None and overlap_mm2 < table.rated_mm2:
        return _unknown(
            f"only {overlap_mm2:.0f} mm² of skin overlap; it takes {table.rated_mm2:.0f} mm² or"
            " more"
        )
    rated = Rated(fmr=table(similarity - FMR_ROUNDING), fmr_basis=table.basis)
    at = fmr or max(DECIDED_AT, table.smallest)
    if at < table.smallest and scores.startswith(("windows", "fingerphotos")):
        why = (
            f"of such pairs false match rates below {table.smallest:.2g} were not measured;"
            " leave `fmr` out, or give a larger one"
        )
        return replace(rated, undecided=why)
    threshold = table.threshold(at)
    match = similarity >= threshold
    if not match and overlap_mm2 is not None and overlap_mm2 < table.excluded_mm2:
        why = (
            f"the ridges agree too little for a match, but {overlap_mm2:.0f} mm² are too few to"
            f" exclude one: it takes {table.excluded_mm2:.0f} mm² or more"
        )
        return replace(rated, undecided=why)
    expected = table.beyond(at)[1] if at < table.smallest else None
    decision = MatchDecision(match, at, threshold, expected)
    return replace(rated, decision=decision, answer="match" if match else "no match")


def check_rate(fmr: Any) -> None:
    """Raise BadInput if the rate at which is to be decided is none."""
    require(
        fmr is None or (isinstance(fmr, int | float) and 0 < fmr < 1),
        f"`fmr` must lie between 0 and 1, but it is {fmr!r}.",
    )


@cache
def fmr_table(scores: str = "ridge") -> FmrTable:
    """False match rates of a name of :data:`TABLES`."""
    file = Path(__file__).with_name(TABLES[scores])
    document = json.loads(file.read_text(encoding="utf-8"))
    return FmrTable(
        np.array(document["similarity"]),
        np.array(document["fmr"]),
        document["impostors"],
        document["what"],
        document.get("rated_mm2", 0.0),
        document.get("excluded_mm2", 0.0),
        scores,
    )
