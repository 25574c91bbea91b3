"""``splitknit match A B``: how similar two fingers are."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from splitknit.cli.verb import FINGERS, Outcome, Progress, add_input_ppi, add_preset, add_settings, new_verb

_MINUTIAE = ("minutiae", "voted")
_DIGITS = {"minutiae": 0, "voted": 0, "fusion": 2}
_IN_SPACE = ("minutiae3d", "tetrahedra")


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
        "minutiae (of the prints, compared by NIST's bozorth3; like fusion it needs the extra minutiae, on x86-64 "
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
    """Compare."""
    from splitknit.cli.options import read_changes
    from splitknit.matching.methods import match_files  # verbs import what they need

    changes = read_changes(options.settings, options.assignments)
    with Progress(options) as progress:
        facts = match_files(
            options.a,
            options.b,
            method=options.method,
            template=options.template,
            preset=options.preset,
            settings=changes,
            progress=progress.update,
            input_ppi=options.input_ppi,
            fmr=options.fmr,
        )
    return facts, _words(facts, options.raw)


def add_raw(verb: argparse.ArgumentParser) -> None:
    """Add ``--raw``."""
    verb.add_argument("--raw", action="store_true", help="print the method's own scores too (--json always has them)")


def one_in(rate: float, basis: dict[str, Any] | None = None) -> str:
    """Write a false match rate for people, rounded up; "below" where no impostor of its `basis` is as similar.

    Examples
    --------
    >>> one_in(1e-4), one_in(0.0359), one_in(0.7), one_in(8.95e-5, {"smallest": 8.95e-5})
    ('1 in 10,000', '1 in 27', 'more than 1 in 2', 'below 1 in 11,000')
    """
    if rate > 0.5:
        return "more than 1 in 2"
    people = int(1 / rate + 1e-9)
    step = 10 ** max(0, len(str(people)) - 2)
    return f"{'below ' if basis is not None and rate <= basis['smallest'] else ''}1 in {people // step * step:,}"


def basis_words(basis: dict[str, Any]) -> str:
    """What false match rates were measured on."""
    return f"{basis['impostors']:,} impostor comparisons, {basis['population']}"


def _words(facts: dict[str, Any], raw: bool) -> list[str]:
    lines = []
    if "similarity" in facts:
        lines.append(_verdict(facts))
        if facts["fmr"] is not None:
            rate, basis = one_in(facts["fmr"], facts["fmr_basis"]), basis_words(facts["fmr_basis"])
            lines.append(f"Estimated false match rate: {rate} (measured on {basis}).")
        if raw:
            lines += _raw_words(facts)
        lines += _how(facts)
    lines += _notes(facts)
    if "template" in facts:
        made = facts["template"]
        lines.append(f"Template of {made['bytes']} bytes (version {made['version']}) written to {made['file']}.")
    return lines


def _verdict(facts: dict[str, Any]) -> str:
    decision = facts["decision"]
    if not facts["compared"]:
        both = facts["a"]["acquired"] and facts["b"]["acquired"]
        apart = facts["method"] == "thesis" or (facts["method"] == "surface-code" and both)
        return f"No decision, not compared: {'too little overlap' if apart else 'failure to acquire'}."
    if decision is None:
        return f"No decision: {facts['fmr_missing']}; its score is {_score(facts)}."
    said = "Match" if decision["match"] else "No match"
    return f"{said}, decided at a false match rate of {one_in(decision['fmr'])} (method {facts['method']})."


def _score(facts: dict[str, Any]) -> str:
    return f"{facts['similarity']:.{_DIGITS.get(facts['method'], 4)}f} ({_SCALES[facts['method']]})"


def _raw_words(facts: dict[str, Any]) -> list[str]:
    decision, digits = facts["decision"], _DIGITS.get(facts["method"], 4)
    needed = "" if decision is None else f", a match from {decision['threshold']:.{digits}f} on"
    lines = [f"Score {_score(facts)}{needed}."]
    if facts["method"] == "fusion" and facts["compared"]:
        score = facts["similarity_of_minutiae"]
        minutiae = "too few" if score is None else f"{score:.0f}"
        lines.append(f"Its parts: ridges {facts['similarity_of_ridges']:.4f}, minutiae {minutiae}.")
    if facts.get("similarity_with_ridges") is not None:
        lines.append(f"Fused with the ridges {facts['similarity_with_ridges']:.2f} (log-likelihood ratio).")
    if facts["method"] == "surface-code" and facts["compared"]:
        lines.append(f"{facts['distance']:.1%} of the bits differ.")
    return lines


def _how(facts: dict[str, Any]) -> list[str]:
    """What was compared: places and counts."""
    method = facts["method"]
    if method == "thesis":
        shift = abs(facts["alignment"]["right_mm"])
        side = "right" if facts["alignment"]["right_mm"] >= 0 else "left"
        overlap = f"overlap {facts['overlap']:.3f} of both outlines (intersection over union)"
        return [f"{overlap}, B shifted {shift:.2f} mm to the {side}"]
    if method in _MINUTIAE:
        return [_print_words(facts[name]) for name in ("a", "b")]
    if method in _IN_SPACE:
        both = " and ".join(str(facts[name]["minutiae"]) for name in ("a", "b"))
        return [f"{facts['agreeing']} minutiae agree in place and direction, of {both}"]
    if not facts["compared"]:
        return []
    laid, overlap = facts["alignment"], f"overlap {facts['overlap_mm2']:.0f} mm² of skin"
    turned = f"{overlap}; A turned by {laid['rotation_deg']:.1f} deg"
    if method == "surface-code":
        return [turned]
    return [f"{turned}, its middle {laid['right_mm']:+.2f} mm right and {laid['up_mm']:+.2f} mm up of B's"]


def _notes(facts: dict[str, Any]) -> list[str]:
    lines = []
    for name in ("a", "b"):
        if name in facts and not facts[name]["acquired"]:
            lacks = "fewer than ten minutiae" if facts["method"] in (*_MINUTIAE, *_IN_SPACE) else "no ridges"
            lines.append(f"Please note: {facts[name]['path']} holds {lacks} (failure to acquire).")
    if "fusion_missing" in facts:
        lines.append(
            "Please note: compared by ridges alone; ridges and minutiae together distinguish prints better, which "
            "needs nbis-py: pip install 'splitknit[minutiae]' (x86-64 Linux)."
        )
    return lines


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


def _print_words(side: dict[str, Any]) -> str:
    if side["kind"] == "minutiae":
        return f"{side['path']}: {side['minutiae']} minutiae"
    if "nfiq2" not in side:
        return f"{side['path']}: {side.get('minutiae', 0)} voted minutiae"
    quality = "unknown" if side["nfiq2"] is None else f"{side['nfiq2']} of 100"
    return f"{side['path']}: {side.get('minutiae', 0)} minutiae, quality (NFIQ 2) {quality}"
