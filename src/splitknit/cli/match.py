"""``splitknit match A B``: how similar two fingers are."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from splitknit.cli.verb import FINGERS, Outcome, Progress, add_input_ppi, add_preset, add_settings, new_verb

if TYPE_CHECKING:
    from splitknit.matching.methods import ComparedSide, FmrBasis, Match, TemplateFile

_MINUTIAE = ("minutiae", "voted")
_DIGITS = {"minutiae": 0, "voted": 0, "fusion": 2}
_IN_SPACE = ("minutiae3d", "tetrahedra")
_NULLS = {
    "fusion": ("similarity_of_minutiae",),
    "minutiae": ("nfiq2",),
}
"""Fields that ``--json`` has even where the method found none."""


def add_match(verbs: Any) -> None:
    """Add the verb."""
    verb = new_verb(verbs, "match", "report how similar two fingers are", _run)
    verb.add_argument("a", type=Path, metavar="A", help=FINGERS)
    verb.add_argument("b", type=Path, metavar="B", nargs="?", help="the same; not needed for --template")
    verb.add_argument(
        "--method",
        choices=("auto", "ridge", "fusion", "thesis", "minutiae", "voted", "minutiae3d", "surface-code", "tetrahedra"),
        default="auto",
        help="auto (the default: fusion of two prints, minutiae where one holds minutiae only, else ridge), ridge, "
        "fusion (of ridges and minutiae of two prints), thesis (local binary patterns; needs captures or results), "
        "minutiae (of the prints, compared by NIST's bozorth3; needs the extra minutiae, on x86-64 "
        "Linux), voted (minutiae on which sets of images that leave one out agree; needs captures), or of surfaces "
        "(captures or results): minutiae3d (Kumar's), surface-code (Kumar's finger surface codes), tetrahedra (Lin's)",
    )
    verb.add_argument(
        "--fmr",
        type=float,
        metavar="RATE",
        help="false match rate at which is decided (default: 1e-4, or the smallest that the method's rates can state)",
    )
    add_raw(verb)
    verb.add_argument("--template", type=Path, metavar="FILE", help="write the template of A (.skt)")
    add_input_ppi(verb)
    add_preset(verb)
    add_settings(verb)


def _run(options: argparse.Namespace) -> Outcome:
    from splitknit.cli.options import read_changes
    from splitknit.errors import BadInput
    from splitknit.io.provenance import known_json
    from splitknit.matching.methods import make_template_file, match_files  # verbs import what they need

    if options.b is None and options.template is None:
        raise BadInput("name a second finger to compare with, or --template to write.")
    changes = read_changes(options.settings, options.assignments)
    with Progress(options) as progress:
        how: dict[str, Any] = {
            "preset": options.preset, "settings": changes, "progress": progress.update, "input_ppi": options.input_ppi
        }  # fmt: skip
        if options.b is None:
            side, written = make_template_file(options.a, options.template, **how)
            facts = {"method": options.method, "a": known_json(side), "template": known_json(written)}
            return facts, [*_failure_notes(options.method, side), _template_words(written)]
        found = match_files(
            options.a, options.b, method=options.method, template=options.template, fmr=options.fmr, **how
        )
    return known_json(found, ("fmr", "fmr_missing", "fmr_basis", "decision", *_NULLS.get(found.method, ()))), _words(
        found, options.raw
    )


def add_raw(verb: argparse.ArgumentParser) -> None:
    """Add ``--raw``."""
    verb.add_argument("--raw", action="store_true", help="print the method's own scores too (--json always has them)")


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
    if not found.compared:
        both = found.a.acquired and found.b.acquired
        apart = found.method == "thesis" or (found.method == "surface-code" and both)
        return f"No decision, not compared: {'too little overlap' if apart else 'failure to acquire'}."
    if found.decision is None:
        return f"No decision: {found.fmr_missing}; its score is {_score(found)}."
    said = "Match" if found.decision.match else "No match"
    return f"{said}, decided at a false match rate of {one_in(found.decision.fmr)} (method {found.method})."


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
    if found.distance is not None and found.compared:
        lines.append(f"{found.distance:.1%} of the bits differ.")
    return lines


def _how(found: Match) -> list[str]:
    """What was compared: places and counts."""
    if found.method in _MINUTIAE:
        return [_print_words(side, found.method == "voted") for side in (found.a, found.b)]
    if found.method in _IN_SPACE:
        both = f"{found.a.minutiae} and {found.b.minutiae}"
        return [f"{found.agreeing} minutiae agree in place and direction, of {both}"]
    laid = found.alignment
    assert laid is not None
    if found.method == "thesis" and laid.right_mm is not None:
        side = "right" if laid.right_mm >= 0 else "left"
        overlap = f"overlap {found.overlap:.3f} of both outlines (intersection over union)"
        return [f"{overlap}, B shifted {abs(laid.right_mm):.2f} mm to the {side}"]
    if not found.compared:
        return []
    turned = f"overlap {found.overlap_mm2:.0f} mm² of skin; A turned by {laid.rotation_deg:.1f} deg"
    if laid.right_mm is None or laid.up_mm is None:
        return [turned]
    return [f"{turned}, its middle {laid.right_mm:+.2f} mm right and {laid.up_mm:+.2f} mm up of B's"]


def _failure_notes(method: str, *sides: ComparedSide) -> list[str]:
    lacks = "fewer than ten minutiae" if method in (*_MINUTIAE, *_IN_SPACE) else "no ridges"
    return [f"Please note: {side.path} holds {lacks} (failure to acquire)." for side in sides if not side.acquired]


_SCALES = {
    "ridge": "1 = the same picture",
    "fusion": "log-likelihood ratio of ridges and minutiae, natural logarithm",
    "thesis": "1 = equal, 0 = as dissimilar as possible",
    "minutiae": "bozorth3: about how many pairs of minutiae fit together",
    "minutiae3d": "fraction of minutiae that agree, squared",
    "tetrahedra": "fraction of minutiae that agree, squared",
    "surface-code": "fraction of equal bits; other fingers have about two thirds",
    "voted": "bozorth3: about how many pairs of minutiae fit together",
}
"""What the method's own score means."""


def _print_words(side: ComparedSide, voted: bool) -> str:
    if side.kind == "minutiae":
        return f"{side.path}: {side.minutiae} minutiae"
    if voted:
        return f"{side.path}: {side.minutiae} voted minutiae"
    quality = "unknown" if side.nfiq2 is None else f"{side.nfiq2} of 100"
    return f"{side.path}: {side.minutiae} minutiae, quality (NFIQ 2) {quality}"
