"""Matching of files by one of five methods: captures, results, templates and prints in, similarity
out."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from splitknit import BadInput
from splitknit.errors import naming, require
from splitknit.findings import Finding, Severity, worst_first
from splitknit.registry import own_object
from splitknit_match.matching.fusion import at_one_scale, can_fuse, fused_match, fused_photo
from splitknit_match.matching.inputs import Side, undoubted
from splitknit_match.matching.parameters import DECIDED_AT, SMALL_MM2
from splitknit_match.matching.results import (
    ComparedSide,
    FmrBasis,
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
from splitknit_match.matching.score import FmrTable
from splitknit_match.matching.surface import surface_images
from splitknit_match.matching.template import VERSION, Template, mirrored
from splitknit_match.prints.minutiae import NFIQ2_FAILED, extract, minutiae_match, nfiq2
from splitknit_match.prints.minutiae_record import PPI, Minutiae
from splitknit_match.records.templates import is_template, write_template

if TYPE_CHECKING:
    from splitknit_match.matching.thesis import ThesisSettings

TABLES = {
    "ridge": "match_fmr.json",
    "fusion": "match_fmr_prints.json",
    "fingerphotos": "match_fmr_fingerphotos.json",
    "fingerphotos alone": "match_fmr_fingerphotos_alone.json",
    "fingerphotos and prints": "match_fmr_fingerphotos_and_prints.json",
    "windows": "match_fmr_windows.json",
    "minutiae": "match_fmr_minutiae.json",
    "minutiae_of_prints": "match_fmr_minutiae_prints.json",
}
"""Impostor scores, made by validation/match/impostors.py of simulated fingers and by windows.py of
real prints."""
OwnMatcher = Callable[[NDArray[np.uint8], NDArray[np.uint8]], float]
"""From two prints (H, W) at 500 ppi, ridges dark, to a similarity; NaN: not compared."""
REAL_PRINTS = "match_fmr_real_prints.json"
"""The fusion's impostor scores of real prints, which state the rates that are not too small for
them."""


def compare_sides(
    method: str,
    a: Side,
    b: Side,
    *,
    fmr: float | None,
    own: FmrTable | None,
    thesis: ThesisSettings,
    known_scale: bool,
) -> Match:
    """Compare two fingers by a method, with false match rate and decision.

    `known_scale`: photographs of fingers are not tried at several. Raises BadInput, naming the file
    at fault, or if `fmr` is below what was measured.
    """
    photos = [side.kind == "photo" for side in (a, b)]
    scores = method
    if any(photos):
        kinds = {"photo": " alone", "print": " and prints"}
        of = kinds.get(a.kind if photos[1] else b.kind, "")
        scores = f"fingerphotos{of}" if method == "fusion" else f"{method} on photographs"
    elif method == "minutiae" and (a.surface is None or b.surface is None):
        scores = "minutiae_of_prints"
    if method == "ridge":
        ridge = ridge_match(_template(a), _template(b))
        match: Match = MatchOfRidges(
            method="ridge",
            a=compared_side(a),
            b=compared_side(b),
            similarity=ridge.similarity,
            compared=ridge.compared,
            **_alignment(ridge),
        )
    elif method == "fusion":
        match = _by_ridges_and_minutiae(a, b, photos if any(photos) and not known_scale else None)
    elif method == "minutiae":
        match = _by_minutiae(a, b)
    elif method in ("thesis", "thesis-code"):
        match = _by_images(method, thesis, a, b)
    else:
        match = _by_own(method, a, b)
    doubts = [side.doubt for side in (a, b) if side.doubt is not None]
    match = _rated(match, scores, fmr, own, doubts)
    findings = [*a.findings, *b.findings, *match.findings]
    findings += _failure(method, a, match.a) + _failure(method, b, match.b)
    match = replace(match, findings=worst_first(findings))
    if method == "fusion" and not any(photos) and match.fmr is not None and match.answer != "match":
        templates = _template(a), _template(b)
        doubt = scale_doubt(*templates, fmr, own)
        if (
            doubt is None
            and match.answer == "no match"
            and _prints_match(mirrored(templates[0]), templates[1], fmr, own)
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
    return "fusion" if can_fuse(a.template, b.template) else "ridge"


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


def _alignment(ridge: RidgeMatch) -> dict[str, Any]:
    """What comparisons by ridges have in common."""
    return {
        "overlap_mm2": ridge.overlap_mm2,
        "correlation": ridge.correlation,
        "alignment": PlaneAlignment(ridge.rotation_deg, ridge.right_mm, ridge.up_mm),
    }


def _by_ridges_and_minutiae(a: Side, b: Side, photos: Sequence[bool] | None) -> MatchOfPrints:
    """Compare two prints; `photos`: which sides are photographs of assumed scale, tried at several.

    Raises BadInput if a side holds no minutiae.
    """
    sides = []
    for side in (a, b):
        minutiae = _template(side).minutiae
        if minutiae is None:
            raise BadInput(
                f"{side.path} is a {side.kind} without minutiae of a print; the method fusion"
                " compares prints: name one, or a template (.skt) that was made of one."
            )
        acquired = minutiae.acquired or not _template(side).empty
        sides.append(replace(compared_side(side), minutiae=minutiae.count, acquired=acquired))
    left, right = Prepared(_template(a)), Prepared(_template(b))
    findings = []
    if photos is None:
        fused = fused_match(left, right)
    else:
        fused, scale, number = fused_photo(left, right, photos)
        if abs(scale - 1) >= 0.01:
            larger = f"{100 * abs(scale - 1):.0f} % {'larger' if scale > 1 else 'smaller'}"
            fits = Finding("fingerphoto-scale", f"it fits best {larger}.")
            findings.append(fits.of_file(sides[number].path))
    return MatchOfPrints(
        method="fusion",
        a=sides[0],
        b=sides[1],
        similarity=fused.similarity,
        compared=fused.compared,
        similarity_of_ridges=fused.ridge.similarity,
        similarity_of_minutiae=fused.minutiae,
        findings=tuple(findings),
        **_alignment(fused.ridge),
    )


def _by_minutiae(a: Side, b: Side) -> Match:
    """Compare by minutiae: surfaces by their relief prints as they are, prints from files after
    enhancement.

    Raises BadInput if a side is a template of ridges, or nbis-py is not installed.
    """
    minutiae = side_minutiae(a), side_minutiae(b)
    sides = []
    for side, own in zip((a, b), minutiae, strict=True):
        quality = NFIQ2_FAILED if side.template is None else nfiq2(_print_of(side), PPI)
        sides.append(
            replace(
                compared_side(side),
                minutiae=own.count,
                acquired=own.acquired,
                nfiq2=None if quality == NFIQ2_FAILED else quality,
                enhanced=side.picture is not None,
            )
        )
    compared = all(own.acquired for own in minutiae)
    return Match(
        method="minutiae",
        a=sides[0],
        b=sides[1],
        similarity=minutiae_match(*minutiae),
        compared=compared,
    )


def _by_images(method: str, settings: ThesisSettings, a: Side, b: Side) -> MatchOfImages:
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
        method=method,
        a=compared_side(a),
        b=compared_side(b),
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
        own_matcher(method)


def own_matcher(name: str) -> OwnMatcher:
    """Somebody's own matcher. Raises BadInput if there is none of the name."""
    return own_object("matcher", name, KNOWN)  # type: ignore[no-any-return]


def _by_own(method: str, a: Side, b: Side) -> Match:
    similarity = float(own_matcher(method)(_print_of(a), _print_of(b)))
    sides = compared_side(a), compared_side(b)
    compared = all(side.acquired for side in sides) and math.isfinite(similarity)
    return Match(method=method, a=sides[0], b=sides[1], similarity=similarity, compared=compared)


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
    """Minutiae of a side: those of its record, or of its print, as ``splitknit print`` finds them.

    Those of a surface are mindtct's, of its relief seen from above. Raises BadInput if it is a
    template of ridges, or nbis-py is not installed.
    """
    if side.minutiae is not None:
        return side.minutiae
    image = _print_of(side)
    if side.surface is not None:
        return naming(side.path, lambda: extract(image, PPI))
    from splitknit_match.prints.from_file import print_minutiae  # a template needs none of it

    return naming(side.path, lambda: print_minutiae(image))


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
    fused = fused_match(a, b)
    scores = scores_of("fusion", (a.area_mm2, b.area_mm2), fused.minutiae)
    return rate(fused.similarity, scores, fused.ridge.overlap_mm2, fmr, own).answer == "match"


def scale_doubt(
    a: Template, b: Template, fmr: float | None, own: FmrTable | None = None
) -> Finding | None:
    """Why two prints that do not match are not shown to be of two fingers: at one scale of their
    ridges they match."""
    sides = at_one_scale(a, b)
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
        minutiae = match.similarity_of_minutiae if isinstance(match, MatchOfPrints) else None
        overlap_mm2 = match.overlap_mm2 if isinstance(match, MatchOfRidges) else None
        scores = scores_of(scores, (match.a.area_mm2, match.b.area_mm2), minutiae)
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
    return (
        f"{method} small" if small and (method == "ridge" or "fingerphotos" in method) else method
    )


def rate(
    similarity: float,
    scores: str,
    overlap_mm2: float | None,
    fmr: float | None = None,
    own: FmrTable | None = None,
) -> Rated:
    """Answer and false match rate of a similarity by `scores` (:func:`scores_of`) or `own` rates,
    decided at `fmr`.

    Raises BadInput if no rate as small as `fmr` was measured (but of small prints, which are
    undecided).
    """
    if own is None and scores not in TABLES:
        method = scores.removesuffix(" small")
        where = (
            "not measured"
            if method == scores
            else f"measured on {SMALL_MM2:.0f} mm² of skin or more"
        )
        return _unknown(f"false match rates of the method {method} were {where}")
    table = own or _fmr_table(scores)
    if overlap_mm2 is not None and overlap_mm2 < table.rated_mm2:
        return _unknown(
            f"only {overlap_mm2:.0f} mm² of skin overlap; it takes {table.rated_mm2:.0f} mm² or"
            " more"
        )
    rated = Rated(fmr=table(similarity - table.rounding), fmr_basis=table.basis)
    at = max(DECIDED_AT, table.smallest) if fmr is None else fmr
    if at < table.smallest and scores == "windows":
        why = (
            f"on small prints false match rates below {table.smallest:.2g} were not measured;"
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
    sound = fmr is None or (isinstance(fmr, int | float) and 0 < fmr < 1)
    require(sound, f"`fmr` must lie between 0 and 1, but it is {fmr!r}.")


def fmr_basis(method: str = "ridge") -> FmrBasis:
    """Return what false match rates were measured on: impostor comparisons, and among which
    fingers."""
    return _fmr_table(method).basis


def similarity_at(fmr: float, method: str = "ridge") -> float:
    """Smallest similarity at which the rate of false matches is `fmr` or less, as
    :meth:`FmrTable.threshold`."""
    return _fmr_table(method).threshold(fmr)


def _document(file: str) -> dict[str, Any]:
    return dict(json.loads(Path(__file__).with_name(file).read_text(encoding="utf-8")))


@cache
def _fmr_table(method: str) -> FmrTable:
    """Impostor scores of a method of :data:`TABLES`; of the fusion real ones, and simulated ones
    where those end."""
    document = _document(TABLES[method])
    similarity, fmr = np.array(document["similarity"]), np.array(document["fmr"])
    impostors, population = document["impostors"], document["what"]
    if method == "fusion":
        real = _document(REAL_PRINTS)
        beyond = fmr < min(real["fmr"])  # reached by no real impostor either
        similarity = np.append(
            real["similarity"], np.maximum(similarity[beyond], max(real["similarity"]))
        )
        fmr = np.append(real["fmr"], fmr[beyond])
        population = (
            f"of them {real['impostors']:,} {real['what']}, which state the larger rates; the"
            f" others {population}"
        )
        impostors += real["impostors"]
    return FmrTable(
        similarity,
        fmr,
        impostors,
        population,
        document.get("rated_mm2", 0.0),
        document.get("excluded_mm2", 0.0),
        method,
    )
