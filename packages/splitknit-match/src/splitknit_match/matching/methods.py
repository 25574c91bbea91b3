"""Matching of files by one of five methods: captures, results, templates and prints in, similarity out."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from splitknit import BadInput
from splitknit.arguments import text_of
from splitknit.errors import naming, require
from splitknit.io.provenance import known_json
from splitknit.model import Progress, no_progress
from splitknit.settings import override
from splitknit_match.matching.fusion import SMALL_MM2, at_one_scale, can_fuse, fused_match, fused_photo
from splitknit_match.matching.inputs import Held, Side, is_photo, read_side, undoubted
from splitknit_match.matching.ridge import Prepared, RidgeMatch, ridge_match
from splitknit_match.matching.score import FmrTable, OwnRates, read_own_rates
from splitknit_match.matching.surface import MatchingSettings, surface_images
from splitknit_match.matching.template import VERSION, Template, mirrored
from splitknit_match.matching.words import failure_notes, match_lines, template_line
from splitknit_match.prints.minutiae import NFIQ2_FAILED, extract, minutiae_match, nfiq2
from splitknit_match.prints.minutiae_record import PPI, Minutiae
from splitknit_match.prints.photo_finger import PhotoFinger
from splitknit_match.records.templates import is_template, write_template

if TYPE_CHECKING:
    from splitknit_match.matching.thesis import FingerImages, ThesisSettings

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
"""Impostor scores, made by validation/match/impostors.py of simulated fingers and by windows.py of real prints."""
REAL_PRINTS = "match_fmr_real_prints.json"
"""The fusion's impostor scores of real prints, which state the rates that are not too small for them."""
_FMR_ROUNDING = 1e-5
"""By this much similarities are rounded so that no rate comes out too low."""
_WHOLE = ("minutiae", "minutiae_of_prints")
"""bozorth3's scores are whole numbers."""
DECIDED_AT = 1e-4
"""False match rate at which is decided whether it is one finger."""


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
    nfiq2: int | None = None
    """Quality of its print, 0 to 100, of the method ``minutiae``; None where NFIQ 2 sees no print."""
    enhanced: bool | None = None
    """Whether its print was enhanced first."""
    note: str | None = None
    """What a photograph was taken for, and how its scale is known."""
    quality: float | None = None
    """Of a photograph, 0 to 100: percent of the finger with clear ridges."""
    doubt: str | None = None
    """Why the resolution of a print cannot be right; the answer is then undecided."""


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
    """Where so small a rate was not measured: what is to be expected; `fmr` is then its upper limit of 95 %."""


@dataclass(frozen=True, slots=True)
class TemplateFile:
    """A template that was written."""

    file: str
    bytes: int
    version: int = VERSION


@dataclass(frozen=True, slots=True, kw_only=True)
class Match:
    """What a comparison found; None is what its method does not measure."""

    method: str
    """That was used, never ``auto``."""
    a: ComparedSide
    b: ComparedSide
    similarity: float
    """The method's score; higher is more similar."""
    similarity_of_ridges: float | None = None
    similarity_of_minutiae: float | None = None
    """Similarity of minutiae in the method ``fusion``, 0 to 1; None where there are too few."""
    compared: bool
    """False: a failure to acquire, or too little overlap."""
    overlap_mm2: float | None = None
    correlation: float | None = None
    overlap: float | None = None
    """Intersection over union of both outlines."""
    dissimilarity: Mapping[str, float] | None = None
    """The thesis's score (5.2) by kind of image, of the method ``thesis``; so `distances`."""
    distances: Mapping[str, float] | None = None
    alignment: PlaneAlignment | None = None
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
    template: TemplateFile | None = None
    """Template of side A, where one was written."""

    @property
    def facts(self) -> dict[str, Any]:
        """The same as plain JSON, without what the method does not measure."""
        kept = ("fmr", "fmr_missing", "fmr_basis", "decision", "undecided")
        own = {"fusion": ("similarity_of_minutiae",), "minutiae": ("nfiq2",)}.get(self.method, ())
        return dict(known_json(self, (*kept, *own)))

    def __str__(self) -> str:
        return text_of(match_lines(self))


@dataclass(frozen=True, slots=True)
class TemplateMade:
    """A finger whose template was made."""

    a: ComparedSide
    template: TemplateFile | None
    """The file, where one was written."""
    payload: bytes | None = None
    """The template itself, which `match`, `identify` and `enroll` take; no bytes for a failure to acquire."""

    @property
    def facts(self) -> dict[str, Any]:
        """The same as plain JSON, without the template itself."""
        return dict(known_json(replace(self, payload=None)))

    def __str__(self) -> str:
        lines = failure_notes("ridge", self.a)
        return text_of(lines if self.template is None else [*lines, template_line(self.template)])


def match_fingers(
    fingers: tuple[Path | Held, Path | Held],
    *,
    method: str,
    preset: str,
    settings: Mapping[str, Any] | None,
    fmr: float | None,
    decision: Path | None,
    template: Path | None,
    input_ppi: float | None,
    where: PhotoFinger,
    progress: Progress = no_progress,
) -> Match:
    """Compare two fingers. Raises BadInput, naming the file at fault, or if `fmr` is below what was measured.

    Where a photograph of a finger is compared with a print, `input_ppi` is the resolution of the photograph alone.
    """
    require(fmr is None or 0 < fmr < 1, f"`fmr` must lie between 0 and 1, but it is {fmr}.")
    thesis = override(MatchingSettings(), settings or {}).thesis
    own = None if decision is None else read_own_rates(decision)
    if template is not None:
        _check_template_file(template, *fingers)
    photos = [(input_ppi is not None or where.given) and is_photo(finger) for finger in fingers]
    chosen = int(photos[1] and not photos[0])  # whose finger `mask` and `box` choose

    def read(number: int) -> Side:
        return read_side(
            fingers[number], preset, no_progress if number else progress,
            input_ppi if photos[number] or not any(photos) else None,
            where=where if number == chosen else None,
        )  # fmt: skip

    if all(isinstance(finger, Path) and finger.is_file() and finger.suffix != ".skt" for finger in fingers):
        from concurrent.futures import ThreadPoolExecutor  # templates need none

        with ThreadPoolExecutor(2) as pool:
            a, b = pool.map(read, range(2))
    else:
        a, b = read(0), read(1)
    if method == "auto":
        ridges = a.template is not None and b.template is not None
        method = "minutiae" if not ridges else "fusion" if can_fuse(_template(a), _template(b)) else "ridge"
    require(
        own is None or own.method == method,
        f"'{decision}' is for the method {'' if own is None else own.method}, but {method} compares these.",
    )
    progress("comparing", 0.9)
    compare: dict[str, Callable[[Side, Side], Match]] = {
        "ridge": _by_ridges,
        "fusion": partial(_fused, input_ppi is None),
        "thesis": partial(_by_thesis, thesis),
        "thesis-code": _by_thesis_code,
        "minutiae": _by_minutiae,
    }
    found = _rated(compare[method](a, b), _scores_of(method, a, b), fmr, own)
    if method == "fusion" and "photo" not in (a.kind, b.kind) and found.fmr is not None and found.answer != "match":
        sides = _template(a), _template(b)
        doubt = scale_doubt(*sides, fmr, own)
        if found.answer == "no match" and doubt is None and _prints_match(mirrored(sides[0]), sides[1], fmr, own):
            doubt = "one seen in a mirror, both match: one of the pictures is mirrored; turn it round"
        found = found if doubt is None else replace(found, answer="undecided", undecided=doubt, decision=None)
    written = None if template is None else _written(template, a)
    progress("done", 1.0)
    return replace(found, template=written)


def make_template_file(
    finger: Path | Held,
    template: Path | None,
    *,
    preset: str,
    settings: Mapping[str, Any] | None,
    input_ppi: float | None,
    where: PhotoFinger,
    progress: Progress = no_progress,
) -> TemplateMade:
    """Write the template of one finger; refusals as of :func:`match_fingers`."""
    override(MatchingSettings(), settings or {})  # refuses unknown ones
    if template is not None:
        _check_template_file(template, finger)
    side = read_side(finger, preset, progress, input_ppi, where=where)
    written = None if template is None else _written(template, side)
    progress("done", 1.0)
    return TemplateMade(_side(side), written, undoubted(side).payload)


def _check_template_file(template: Path, *inputs: Any) -> None:
    from splitknit.io.targets import check_file  # a comparison needs none of it

    empty = template.suffix == ".skt"  # is a failure to acquire
    check_file(template, "a template", lambda data: is_template(data) if data else empty)
    sources = [path.expanduser().resolve() for path in inputs if isinstance(path, Path)]
    require(template.expanduser().resolve() not in sources, f"'{template}' is one of the inputs; name another file.")


def _written(template: Path, side: Side) -> TemplateFile:
    write_template(template, undoubted(side).payload, VERSION)
    return TemplateFile(str(template), template.stat().st_size)


def _by_ridges(a: Side, b: Side) -> Match:
    return _laid("ridge", _side(a), _side(b), ridge_match(_template(a), _template(b)))


def _laid(method: str, a: ComparedSide, b: ComparedSide, ridge: RidgeMatch) -> Match:
    """A comparison by ridges."""
    return Match(
        method=method, a=a, b=b, similarity=ridge.similarity, compared=ridge.compared, overlap_mm2=ridge.overlap_mm2,
        correlation=ridge.correlation, alignment=PlaneAlignment(ridge.rotation_deg, ridge.right_mm, ridge.up_mm),
    )  # fmt: skip


def _fused(assumed: bool, a: Side, b: Side) -> Match:
    """Compare two prints by ridges and minutiae, where one is a photograph of assumed scale at several.

    Raises BadInput if a side holds no minutiae.
    """
    sides = []
    for side in (a, b):
        minutiae = _template(side).minutiae
        if minutiae is None:
            raise BadInput(
                f"{side.path} is a {side.kind} without minutiae of a print; the method fusion compares prints: name "
                "one, or a template (.skt) that was made of one."
            )
        acquired = minutiae.acquired or not _template(side).empty
        sides.append(replace(_side(side), minutiae=minutiae.count, acquired=acquired))
    left, right = (Prepared(_template(side)) for side in (a, b))
    photos = [side.kind == "photo" for side in (a, b)]
    if assumed and any(photos):
        found, scale, number = fused_photo(left, right, photos)
        if abs(scale - 1) >= 0.01:
            larger = f"{100 * abs(scale - 1):.0f} % {'larger' if scale > 1 else 'smaller'}"
            sides[number] = replace(sides[number], note=f"{sides[number].note} It fits best {larger}.")
    else:
        found = fused_match(left, right)
    return replace(
        _laid("fusion", sides[0], sides[1], found.ridge), similarity=found.similarity, compared=found.compared,
        similarity_of_ridges=found.ridge.similarity, similarity_of_minutiae=found.minutiae,
    )  # fmt: skip


def _scores_of(method: str, a: Side, b: Side) -> str:
    """Which table holds the impostor scores of a comparison."""
    if "photo" in (a.kind, b.kind):
        of = {"photo": " alone", "print": " and prints"}.get(a.kind if b.kind == "photo" else b.kind, "")
        return f"fingerphotos{of}" if method == "fusion" else f"{method} on photographs"
    of_surfaces = a.surface is not None and b.surface is not None
    return "minutiae_of_prints" if method == "minutiae" and not of_surfaces else method


def doubt_of(side: Side | ComparedSide) -> str | None:
    """Why the resolution of a side's print cannot be right, with its path; None where nothing speaks against it."""
    return None if side.doubt is None else f"{side.path}: {side.doubt}".rstrip(".")


def _prints_match(a: Template, b: Template, fmr: float | None, own: OwnRates | None) -> bool:
    """Whether two prints match by ridges and minutiae."""
    found = fused_match(a, b)
    scores = scores_of("fusion", (a.area_mm2, b.area_mm2), found.minutiae)
    return rate(found.similarity, scores, found.ridge.overlap_mm2, fmr, own).answer == "match"


def scale_doubt(a: Template, b: Template, fmr: float | None, own: OwnRates | None = None) -> str | None:
    """Why two prints that do not match are not shown to be of two fingers: at one scale of their ridges they match."""
    if (sides := at_one_scale(a, b)) is None:
        return None
    if not _prints_match(*sides[:2], fmr, own):
        return None
    apart = 100 * (sides[2] - 1)
    return f"the ridges of one lie {apart:.0f} % farther apart, and at one scale both match: check their resolutions"


def _rated(found: Match, scores: str, fmr: float | None, own: OwnRates | None) -> Match:
    """With the false match rate and its basis, or why there is none, and the decision at a rate, by own rates."""
    doubts = [doubt for doubt in map(doubt_of, (found.a, found.b)) if doubt is not None]
    if not doubts and not (found.a.acquired and found.b.acquired):
        return replace(found, fmr_missing="nothing was compared", answer="not acquired", undecided="failure to acquire")
    missing = ""
    if scores not in TABLES and own is None:
        missing = f"false match rates of the method {scores} were not measured"
    elif not found.compared:
        missing = "nothing was compared"
    else:
        scores = scores_of(scores, (found.a.area_mm2, found.b.area_mm2), found.similarity_of_minutiae)
        rated = rate(found.similarity, scores, found.overlap_mm2, fmr, own)
        if not doubts or (len(doubts) == 1 and rated.answer == "match"):  # one resolution confirms the other
            return replace(
                found, fmr=rated.fmr, fmr_missing=rated.missing, fmr_basis=rated.basis, decision=rated.decision,
                answer=rated.answer, undecided=rated.undecided,
            )  # fmt: skip
    missing = doubts[0] if doubts else missing
    return replace(found, fmr_missing=missing, undecided=missing)


@dataclass(frozen=True, slots=True)
class Rated:
    """What a similarity says, given what was compared."""

    answer: str
    fmr: float | None = None
    missing: str | None = None
    basis: FmrBasis | None = None
    decision: MatchDecision | None = None
    undecided: str | None = None


def scores_of(method: str, areas_mm2: tuple[float, float], minutiae: float | None) -> str:
    """Which impostors a comparison is rated by: where little or no minutiae were compared, other than of the method.

    `minutiae`: the fusion's `similarity_of_minutiae`.
    """
    small = min(areas_mm2) < SMALL_MM2
    if method == "fusion":
        return "windows" if small or minutiae is None else method
    return f"{method} small" if small and (method == "ridge" or "fingerphotos" in method) else method


def rate(
    similarity: float, scores: str, overlap_mm2: float | None, fmr: float | None = None, own: OwnRates | None = None
) -> Rated:
    """Answer and false match rate of a similarity by `scores` (:func:`scores_of`) or `own` rates, decided at `fmr`.

    Raises BadInput if no rate as small as `fmr` was measured (but of small prints, which are undecided).
    """

    def unknown(why: str) -> Rated:
        return Rated("undecided", missing=why, undecided=why)

    if own is None and scores not in TABLES:
        method = scores.removesuffix(" small")
        return unknown(f"false match rates of the method {method} were measured on {SMALL_MM2:.0f} mm² of skin or more")
    table = _fmr_table(scores) if own is None else own.table
    rated_mm2, excluded_mm2 = _limits(scores) if own is None else (own.least_mm2, 0.0)
    if overlap_mm2 is not None and overlap_mm2 < rated_mm2:
        return unknown(f"only {overlap_mm2:.0f} mm² of skin overlap; it takes {rated_mm2:.0f} mm² or more")
    basis, found = _basis(table), table(similarity - (0.0 if scores in _WHOLE else _FMR_ROUNDING))
    at = max(DECIDED_AT, basis.smallest) if fmr is None else fmr
    if at < basis.smallest and scores == "windows":
        why = f"on small prints false match rates below {basis.smallest:.2g} were not measured"
        return Rated("undecided", found, basis=basis, undecided=why)
    threshold = _threshold(table, at, scores)
    expected = table.beyond(at)[1] if at < table.smallest else None
    decision = MatchDecision(similarity >= threshold, at, threshold, expected)
    if not decision.match and overlap_mm2 is not None and overlap_mm2 < excluded_mm2:
        why = (
            f"the ridges agree too little for a match, but {overlap_mm2:.0f} mm² are too few to exclude one: it takes "
            f"{excluded_mm2:.0f} mm² or more"
        )
        return Rated("undecided", found, basis=basis, undecided=why)
    return Rated("match" if decision.match else "no match", found, basis=basis, decision=decision)


def fmr_basis(method: str = "ridge") -> FmrBasis:
    """Return what false match rates were measured on: impostor comparisons, and among which fingers."""
    return _basis(_fmr_table(method))


def _basis(table: FmrTable) -> FmrBasis:
    return FmrBasis(table.impostors, table.population, table.smallest)


def similarity_at(fmr: float, method: str = "ridge") -> float:
    """Smallest similarity (in steps of 1e-5) at which the rate of false matches is `fmr` or less.

    A smaller one than was measured is extrapolated (:meth:`splitknit_match.matching.score.FmrTable.beyond`). Raises
    BadInput if it is less than a hundredth of that.
    """
    return _threshold(_fmr_table(method), fmr, method)


def _threshold(table: FmrTable, fmr: float, method: str) -> float:
    require(
        fmr >= 0.01 * table.smallest,
        f"false match rates were measured on {table.impostors} comparisons, so that none below "
        f"{0.01 * table.smallest:.2g} can be stated; give a larger one than {fmr:g}.",
    )
    measured = float(table.similarity[np.argmax(table.fmr <= fmr)])
    least = measured if fmr >= table.smallest else table.beyond(fmr)[0]
    return math.ceil(least) if method in _WHOLE else (math.ceil(least / _FMR_ROUNDING) + 1) * _FMR_ROUNDING


def _by_thesis(settings: ThesisSettings, a: Side, b: Side) -> Match:
    from splitknit_match.matching.thesis import thesis_match  # a template needs none of it

    left, right = _images(a, "thesis"), _images(b, "thesis")
    found = thesis_match(left, right, settings)
    return Match(
        method="thesis", a=_side(a), b=_side(b), similarity=found.similarity, compared=found.compared,
        overlap=found.ratio, dissimilarity=found.dissimilarity, distances=found.distances,
        alignment=PlaneAlignment(right_mm=found.shift_px / left.px_per_mm),
    )  # fmt: skip


def _by_thesis_code(a: Side, b: Side) -> Match:
    from splitknit_match.matching.thesis_code import code_match, code_side  # a template needs none of it

    left, right = _images(a, "thesis-code"), _images(b, "thesis-code")
    found = code_match(code_side(left), code_side(right))
    return Match(
        method="thesis-code", a=_side(a), b=_side(b), similarity=found.similarity, compared=True, overlap=found.ratio,
        distances={name: 1.0 - score for name, score in found.scores.items()},
        alignment=PlaneAlignment(right_mm=found.shift_px / left.px_per_mm),
    )  # fmt: skip


def _images(side: Side, method: str) -> FingerImages:
    surface = side.surface
    if surface is None:
        raise BadInput(
            f"{side.path} is a {side.kind}; the method {method} compares surfaces: name a capture or a result."
        )
    return naming(side.path, lambda: surface_images(surface))


def _template(side: Side) -> Template:
    if side.template is None:
        raise BadInput(f"{side.path} holds minutiae, no ridges; compare by the method minutiae.")
    return side.template


def _side(side: Side) -> ComparedSide:
    template = side.template
    if template is None:
        assert side.minutiae is not None
        return ComparedSide(str(side.path), side.kind, 0.0, side.minutiae.acquired)
    return ComparedSide(
        str(side.path), side.kind, template.area_mm2, not template.empty, note=template.lacks or side.note,
        quality=side.quality, doubt=side.doubt,
    )  # fmt: skip


def _by_minutiae(a: Side, b: Side) -> Match:
    """Compare by minutiae: similarity, and what each side's print holds.

    Surfaces are compared by their relief prints as they are, prints from files after enhancement. Raises BadInput if a
    side is a template of ridges, or nbis-py is not installed.
    """
    found = [side_minutiae(side) for side in (a, b)]
    sides = []
    for side, minutiae in zip((a, b), found, strict=True):
        quality = NFIQ2_FAILED if side.template is None else nfiq2(_print_of(side), PPI)
        sides.append(
            replace(
                _side(side), minutiae=minutiae.count, acquired=minutiae.acquired,
                nfiq2=None if quality == NFIQ2_FAILED else quality, enhanced=side.picture is not None,
            )
        )  # fmt: skip
    compared = all(minutiae.acquired for minutiae in found)
    return Match(method="minutiae", a=sides[0], b=sides[1], similarity=minutiae_match(*found), compared=compared)


def side_minutiae(side: Side) -> Minutiae:
    """Minutiae of a side: those of its record, or of its print, as ``splitknit print`` finds them.

    Those of a surface are mindtct's, of its relief seen from above. Raises BadInput if it is a template of ridges, or
    nbis-py is not installed.
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
            f"{side.path} is a {side.kind} of ridges, which keeps no minutiae; name a capture, a result or a print."
        )
    return side.picture


@cache
def _limits(method: str) -> tuple[float, float]:
    """Of what overlaps, mm2: below the first no rate is stated, below the second no finger excluded."""
    document = _document(TABLES[method])
    return document.get("rated_mm2", 0.0), document.get("excluded_mm2", 0.0)


def _document(file: str) -> dict[str, Any]:
    return dict(json.loads(Path(__file__).with_name(file).read_text(encoding="utf-8")))


@cache
def _fmr_table(method: str) -> FmrTable:
    """Impostor scores of a method of :data:`TABLES`; of the fusion real ones, and simulated ones where those end."""
    document = _document(TABLES[method])
    scores, rates = np.array(document["similarity"]), np.array(document["fmr"])
    impostors, what = int(document["impostors"]), document["what"]
    if method == "fusion":
        real = _document(REAL_PRINTS)
        beyond = rates < min(real["fmr"])  # reached by no real impostor either
        scores = np.append(real["similarity"], np.maximum(scores[beyond], max(real["similarity"])))
        rates = np.append(real["fmr"], rates[beyond])
        what = f"of them {real['impostors']:,} {real['what']}, which state the larger rates; the others {what}"
        impostors += int(real["impostors"])
    return FmrTable(scores, rates, impostors, what)
