"""Matching of files by one of eight methods: captures, results, templates and prints in, similarity out."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, naming, require
from splitknit.io.templates import is_template, write_template
from splitknit.matching.fusion import can_fuse, fused_match
from splitknit.matching.inputs import Side, read_side
from splitknit.matching.minutiae import NFIQ2_FAILED, extract, minutiae_match, nfiq2
from splitknit.matching.minutiae_record import PPI, Minutiae, SpaceMinutiae
from splitknit.matching.ridge import RidgeMatch, prepared, ridge_match
from splitknit.matching.score import FmrTable
from splitknit.matching.surface import MatchingSettings, surface_images
from splitknit.matching.template import VERSION, Template
from splitknit.model import Capture, Progress, Reconstruction, Surface, no_progress
from splitknit.settings import override

SPACE_METHODS = ("minutiae3d", "surface-code", "tetrahedra")
"""Those that compare surfaces in space."""
METHODS = ("auto", "ridge", "fusion", "thesis", "minutiae", "voted", *SPACE_METHODS)
TABLES = {
    "ridge": "match_fmr.json",
    "fusion": "match_fmr_prints.json",
    "fingerphotos": "match_fmr_fingerphotos.json",
    "minutiae": "match_fmr_minutiae.json",
    "minutiae_of_prints": "match_fmr_minutiae_prints.json",
    "minutiae3d": "match_fmr_minutiae3d.json",
    "tetrahedra": "match_fmr_tetrahedra.json",
    "surface_code": "match_fmr_surface_code.json",
}
"""Impostor scores of simulated fingers, made by validation/match/impostors.py."""
_FMR_ROUNDING = 1e-5
"""Of the similarities in it: no rate comes out too low."""
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
    """Of its ridges."""
    acquired: bool
    """False: a failure to acquire, which matches nobody."""
    minutiae: int | None = None
    """How many were compared, by methods of minutiae."""
    nfiq2: int | None = None
    """Quality of its print, 0 to 100, of the method ``minutiae``; None where NFIQ 2 sees no print."""
    enhanced: bool | None = None
    """Whether its print was enhanced first."""
    code_mm2: float | None = None
    """Area of its finger surface code."""
    note: str | None = None
    """What a photograph was taken for, and how its scale is known."""


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
    """Of the method ``fusion``, 0 to 1; None where there are too few."""
    compared: bool
    """False: a failure to acquire, or too little overlap."""
    agreeing: int | None = None
    """Minutiae that agree in place and direction."""
    tetrahedra: int | None = None
    """That proposed an alignment."""
    distance: float | None = None
    """Fraction of bits that differ."""
    overlap_mm2: float | None = None
    correlation: float | None = None
    overlap: float | None = None
    """Of both outlines, intersection over union."""
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
    template: TemplateFile | None = None
    """Of side A, where one was written."""


def match_files(
    a: Path | Reconstruction | Capture,
    b: Path | Reconstruction | Capture,
    *,
    method: str = "auto",
    template: Path | None = None,
    preset: str = "metric",
    settings: MatchingSettings | Mapping[str, Any] | None = None,
    progress: Progress = no_progress,
    input_ppi: float | None = None,
    fmr: float | None = None,
) -> Match:
    """Compare two fingers' files. Raises BadInput, naming the file at fault, or if `fmr` is below what was measured.

    Parameters
    ----------
    a, b : capture folder, result folder, template (``.skt``), print, record of minutiae, or an object
    method
        ``ridge``, ``fusion`` (of ridges and minutiae; of two prints), ``thesis``, ``minutiae``, ``voted``,
        ``minutiae3d``, ``surface-code`` or ``tetrahedra``; ``auto`` is ``minutiae`` where one is a record of minutiae,
        ``fusion`` where both sides have minutiae of a print, else ``ridge``.
    template : file to write the template of `a` into
    preset : by which captures are reconstructed
    input_ppi : resolution of prints whose files do not state it; where a photograph of a finger is compared with a
        print, that of the photograph alone
    fmr
        False match rate at which is decided whether it is one finger (``decision``); by default 1e-4, or the smallest
        one that the method's impostor scores can state.
    """
    require(method in METHODS, f"method must be one of {', '.join(METHODS)}, but it is '{method}'.")
    require(fmr is None or 0 < fmr < 1, f"`fmr` must lie between 0 and 1, but it is {fmr}.")
    chosen = settings if isinstance(settings, MatchingSettings) else override(MatchingSettings(), settings or {})
    if template is not None:
        _check_template_file(template, a, b)
    photos = [_is_photo(side) for side in (a, b)]
    scales = [input_ppi if photo or not any(photos) else None for photo in photos]
    first, second = (
        read_side(side, preset, chosen, progress, ppi) for side, ppi in zip((a, b), scales, strict=True)
    )  # fmt: skip
    if method == "auto":
        method = _usual_method(first, second)
    progress("comparing", 0.9)
    compare: dict[str, Callable[[Side, Side, MatchingSettings], Match]] = {
        "ridge": _by_ridges,
        "fusion": _fused,
        "thesis": _by_thesis,
        "minutiae": _by_minutiae,
        "voted": partial(_by_votes, preset),
        "surface-code": _by_codes,
        **{name: partial(_by_space_minutiae, name) for name in ("minutiae3d", "tetrahedra")},
    }
    found = _rated(compare[method](first, second, chosen), _scores_of(method, first, second), chosen, fmr)
    written = None if template is None else _written(template, first)
    progress("done", 1.0)
    return replace(found, template=written)


def make_template_file(
    finger: Path | Reconstruction | Capture,
    template: Path,
    *,
    preset: str = "metric",
    settings: MatchingSettings | Mapping[str, Any] | None = None,
    progress: Progress = no_progress,
    input_ppi: float | None = None,
) -> tuple[ComparedSide, TemplateFile]:
    """Write the template of one finger; parameters and refusals as of :func:`match_files`."""
    chosen = settings if isinstance(settings, MatchingSettings) else override(MatchingSettings(), settings or {})
    _check_template_file(template, finger)
    side = read_side(finger, preset, chosen, progress, input_ppi)
    written = _written(template, side)
    progress("done", 1.0)
    return _side(side), written


def _check_template_file(template: Path, *inputs: Path | Reconstruction | Capture) -> None:
    from splitknit.io.targets import check_file  # a comparison needs none of it

    empty = template.suffix == ".skt"  # is a failure to acquire
    check_file(template, "a template", lambda data: is_template(data) if data else empty)
    sources = [path.expanduser().resolve() for path in inputs if isinstance(path, Path)]
    require(template.expanduser().resolve() not in sources, f"'{template}' is one of the inputs; name another file.")


def _written(template: Path, side: Side) -> TemplateFile:
    write_template(template, side.payload, VERSION)
    return TemplateFile(str(template), template.stat().st_size)


def _is_photo(side: Path | Reconstruction | Capture) -> bool:
    if not isinstance(side, Path) or side.suffix.lower() in (".skt", ".npz") or not side.is_file():
        return False
    from splitknit.prints.fingerphoto import is_fingerphoto  # a template needs none of it

    return is_fingerphoto(side)


def _usual_method(a: Side, b: Side) -> str:
    if a.template is None or b.template is None:
        return "minutiae"
    return "fusion" if can_fuse(a.template, b.template) else "ridge"


def _by_ridges(a: Side, b: Side, settings: MatchingSettings) -> Match:
    found = ridge_match(_template(a), _template(b), settings.ridge)
    return Match(
        method="ridge", a=_side(a), b=_side(b), similarity=found.similarity, compared=found.compared,
        overlap_mm2=found.overlap_mm2, correlation=found.correlation, alignment=_laid(found),
    )  # fmt: skip


def _fused(a: Side, b: Side, settings: MatchingSettings) -> Match:
    """Compare two prints by ridges and minutiae. Raises BadInput if a side holds no minutiae."""
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
    found = fused_match(prepared(_template(a), settings.ridge), prepared(_template(b), settings.ridge))
    return Match(
        method="fusion", a=sides[0], b=sides[1], similarity=found.similarity, compared=found.compared,
        similarity_of_ridges=found.ridge.similarity, similarity_of_minutiae=found.minutiae,
        overlap_mm2=found.ridge.overlap_mm2, correlation=found.ridge.correlation, alignment=_laid(found.ridge),
    )  # fmt: skip


def _laid(found: RidgeMatch) -> PlaneAlignment:
    return PlaneAlignment(found.rotation_deg, found.right_mm, found.up_mm)


def _scores_of(method: str, a: Side, b: Side) -> str:
    """Which table holds the impostor scores of a comparison."""
    if "photo" in (a.kind, b.kind):
        return "fingerphotos" if method == "fusion" else f"{method} on photographs"
    of_surfaces = a.surface is not None and b.surface is not None
    return "minutiae_of_prints" if method == "minutiae" and not of_surfaces else method.replace("-", "_")


def _rated(found: Match, scores: str, settings: MatchingSettings, fmr: float | None) -> Match:
    """With the false match rate and its basis, or why there is none, and the decision at `fmr`."""
    table = _fmr_table(scores)
    if table is None:
        missing: str | None = f"false match rates of the method {scores} were not measured"
    elif not as_calibrated(settings, scores):
        missing = "with other settings than the shipped ones false match rates are not known"
    else:
        missing = None if found.compared else "nothing was compared"
    if table is None or missing is not None:
        return replace(found, fmr_missing=missing)
    at = max(DECIDED_AT, table.smallest) if fmr is None else fmr
    threshold = similarity_at(at, scores)
    return replace(
        found,
        fmr=false_match_rate(found.similarity, scores),
        fmr_basis=fmr_basis(scores),
        decision=MatchDecision(found.similarity >= threshold, at, threshold),
    )


def fmr_basis(method: str = "ridge") -> FmrBasis:
    """Return what false match rates were measured on: impostor comparisons, and among which fingers."""
    table = _measured(method)
    return FmrBasis(table.impostors, table.population, table.smallest)


def false_match_rate(similarity: float, method: str = "ridge") -> float:
    """Rate at which other (simulated) fingers reach this similarity of a method of :data:`TABLES`.

    Never below one over the number of impostor comparisons that the table was measured on.
    """
    return _measured(method)(similarity - (0.0 if method in _WHOLE else _FMR_ROUNDING))


def similarity_at(fmr: float, method: str = "ridge") -> float:
    """Smallest similarity (in steps of 1e-5) at which :func:`false_match_rate` is `fmr` or less.

    Raises BadInput if the table was measured on too few comparisons to state such a rate.
    """
    table = _measured(method)
    enough = table.fmr <= fmr
    require(
        bool(enough.any()),
        f"false match rates were measured on {table.impostors} comparisons, so that none below {table.smallest:.2g} "
        f"can be stated; give a larger one than {fmr:g}.",
    )
    least = float(table.similarity[np.argmax(enough)])
    return math.ceil(least) if method in _WHOLE else (math.ceil(least / _FMR_ROUNDING) + 1) * _FMR_ROUNDING


def as_calibrated(settings: MatchingSettings, method: str = "ridge") -> bool:
    """Whether scores mean what they meant when the table was measured."""
    ridges = ("band", "template", "ridge")
    names = {
        "ridge": ridges,
        "fusion": ridges,
        "fingerphotos": ridges,
        "surface_code": ("surface_code", "surface_match"),
    }
    plain = MatchingSettings()
    asked = names.get(method, (method,) if hasattr(plain, method) else ())
    return all(getattr(settings, name) == getattr(plain, name) for name in asked)


def _by_thesis(a: Side, b: Side, settings: MatchingSettings) -> Match:
    from splitknit.matching.thesis import thesis_match  # a template needs none of it

    images = [naming(side.path, partial(surface_images, _surface(side, "thesis"))) for side in (a, b)]
    found = thesis_match(images[0], images[1], settings.thesis)
    return Match(
        method="thesis", a=_side(a), b=_side(b), similarity=found.similarity, compared=found.compared,
        overlap=found.ratio, dissimilarity=dict(found.dissimilarity), distances=dict(found.distances),
        alignment=PlaneAlignment(right_mm=found.shift_px / images[0].px_per_mm),
    )  # fmt: skip


def _template(side: Side) -> Template:
    if side.template is None:
        raise BadInput(f"{side.path} holds minutiae, no ridges; compare by the method minutiae.")
    return side.template


def _side(side: Side) -> ComparedSide:
    template = side.template
    if template is None:
        assert side.minutiae is not None
        return ComparedSide(str(side.path), side.kind, 0.0, side.minutiae.acquired)
    return ComparedSide(str(side.path), side.kind, template.area_mm2, not template.empty, note=side.note)


def _by_minutiae(a: Side, b: Side, settings: MatchingSettings) -> Match:
    """Compare by minutiae: similarity, and what each side's print holds.

    Surfaces are compared by their relief prints as they are, prints from files after enhancement. Raises BadInput if a
    side is a template of ridges, or nbis-py is not installed.
    """
    found = [side_minutiae(side) for side in (a, b)]
    sides = []
    for side, known in zip((a, b), _with_minutiae(a, b, found), strict=True):
        quality = NFIQ2_FAILED if side.template is None else nfiq2(_print_of(side)[0], PPI)
        quality_or_none = None if quality == NFIQ2_FAILED else quality
        sides.append(replace(known, nfiq2=quality_or_none, enhanced=side.picture is not None))
    compared = all(one.acquired for one in found)
    return Match(method="minutiae", a=sides[0], b=sides[1], similarity=minutiae_match(*found), compared=compared)


def side_minutiae(side: Side) -> Minutiae:
    """Minutiae of a side: those of its record, or of its print, as ``splitknit print`` finds them.

    Those of a surface are mindtct's, of its relief seen from above. Raises BadInput if it is a template of ridges, or
    nbis-py is not installed.
    """
    if side.minutiae is not None:
        return side.minutiae
    image, pressed = _print_of(side)
    if pressed:
        from splitknit.prints.from_file import print_minutiae  # a template needs none of it

        return naming(side.path, partial(print_minutiae, image))
    return naming(side.path, partial(extract, image, PPI))


def _print_of(side: Side) -> tuple[NDArray[np.uint8], bool]:
    """The print of a side at 500 ppi, and whether it comes from a file."""
    if side.surface is not None:
        from splitknit.prints.ridges import surface_print  # a template needs none of it

        return naming(side.path, partial(surface_print, side.surface, PPI)), False
    if side.picture is None:
        raise BadInput(
            f"{side.path} is a {side.kind} of ridges, which keeps no minutiae; name a capture, a result or a print."
        )
    return side.picture, True


def _surface(side: Side, method: str) -> Surface:
    if side.surface is None:
        raise BadInput(
            f"{side.path} is a {side.kind}; the method {method} compares surfaces: name a capture or a result."
        )
    return side.surface


def _with_minutiae(a: Side, b: Side, found: Sequence[Minutiae | SpaceMinutiae]) -> list[ComparedSide]:
    """Both sides, with how many minutiae were found in each."""
    return [
        replace(_side(side), minutiae=one.count, acquired=one.acquired) for side, one in zip((a, b), found, strict=True)
    ]


def _by_space_minutiae(method: str, a: Side, b: Side, settings: MatchingSettings) -> Match:
    from splitknit.matching.minutiae3d import minutiae3d_match, tetrahedra_match  # a template needs none of it
    from splitknit.matching.space_features import space_minutiae  # a template needs none of it

    surfaces = [_surface(side, method) for side in (a, b)]
    left, right = (naming(side.path, partial(space_minutiae, one)) for side, one in zip((a, b), surfaces, strict=True))
    tetrahedra = method == "tetrahedra"
    if tetrahedra:
        found = tetrahedra_match(left, right, settings.tetrahedra)
    else:
        found = minutiae3d_match(left, right, settings.minutiae3d)
    sides = _with_minutiae(a, b, (left, right))
    return Match(
        method=method, a=sides[0], b=sides[1], similarity=found.similarity, compared=found.compared,
        agreeing=found.agreeing, tetrahedra=found.proposals if tetrahedra else None,
    )  # fmt: skip


def _by_codes(a: Side, b: Side, settings: MatchingSettings) -> Match:
    from splitknit.matching.space_features import surface_code  # a template needs none of it
    from splitknit.matching.surface_code import surface_code_match  # a template needs none of it

    surfaces = [_surface(side, "surface-code") for side in (a, b)]
    codes = [
        naming(side.path, partial(surface_code, one, settings.surface_code))
        for side, one in zip((a, b), surfaces, strict=True)
    ]
    found = surface_code_match(codes[0], codes[1], settings.surface_match)
    sides = [
        replace(_side(side), code_mm2=one.area_mm2, acquired=not one.empty)
        for side, one in zip((a, b), codes, strict=True)
    ]
    return Match(
        method="surface-code", a=sides[0], b=sides[1], similarity=found.similarity, compared=found.compared,
        distance=found.distance, overlap_mm2=found.overlap_mm2, alignment=PlaneAlignment(found.rotation_deg),
    )  # fmt: skip


def _by_votes(preset: str, a: Side, b: Side, settings: MatchingSettings) -> Match:
    """Compare by voted minutiae. Raises BadInput if a side is no capture, or nbis-py is not installed."""
    for side in (a, b):
        if side.kind != "capture":
            raise BadInput(
                f"{side.path} is a {side.kind} without the images that it was made of, which the method voted needs; "
                "name the capture itself, or compare with the method minutiae."
            )
    voted = [_voted(side, preset, settings) for side in (a, b)]
    sides = [replace(side, enhanced=False) for side in _with_minutiae(a, b, voted)]
    return Match(
        method="voted", a=sides[0], b=sides[1], similarity=minutiae_match(*voted),
        compared=all(one.acquired for one in voted),
    )  # fmt: skip


def _voted(side: Side, preset: str, settings: MatchingSettings) -> Minutiae:
    from splitknit.io.capture import read_capture  # of captures only
    from splitknit.matching.voted_minutiae import voted_minutiae
    from splitknit.presets import preset_settings

    capture = read_capture(side.path)
    return naming(
        side.path, lambda: voted_minutiae(capture, preset_settings(preset), settings.leave_one_out, settings.voted)
    )


@cache
def _fmr_table(method: str) -> FmrTable | None:
    """Impostor scores of a method; None where they were not measured."""
    if method not in TABLES:
        return None
    document = json.loads(Path(__file__).with_name(TABLES[method]).read_text(encoding="utf-8"))
    scores, rates = np.array(document["similarity"]), np.array(document["fmr"])
    return FmrTable(scores, rates, int(document["impostors"]), document["what"])


def _measured(method: str) -> FmrTable:
    table = _fmr_table(method)
    assert table is not None, method
    return table
