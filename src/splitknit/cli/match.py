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
    verb.add_argument("b", type=Path, metavar="B", nargs="?", default=None, help="the same; not needed for --template")
    verb.add_argument(
        "--method",
        choices=("auto", "ridge", "fusion", "thesis", "minutiae", "voted", "minutiae3d", "surface-code", "tetrahedra"),
        default="auto",
        help="auto (the default: fusion of two prints, minutiae where one holds minutiae only, else ridge), ridge, "
        "fusion (of ridges and minutiae of two prints), thesis (local binary patterns; needs captures or results), "
        "minutiae (of the prints, by NIST's mindtct and bozorth3; like fusion it needs the extra minutiae, on x86-64 "
        "Linux), voted (minutiae on which sets of images that leave one out agree; needs captures), or of surfaces "
        "(captures or results): minutiae3d (Kumar's), surface-code (Kumar's finger surface codes), tetrahedra (Lin's)",
    )
    verb.add_argument("--template", type=Path, default=None, metavar="FILE", help="write the template of A (.skt)")
    add_input_ppi(verb)
    add_preset(verb)
    add_settings(verb)


def _run(options: argparse.Namespace) -> Outcome:
    """Compare."""
    from splitknit.cli.options import read_changes  # noqa: PLC0415
    from splitknit.matching.methods import match_files  # noqa: PLC0415 - verbs import what they need

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
        )
    return facts, _words(facts)


def _words(facts: dict[str, Any]) -> list[str]:
    lines = []
    if "similarity" in facts:
        shown = f"{facts['similarity']:.{_DIGITS.get(facts['method'], 4)}f}"
        lines.append(f"similarity {shown} ({_meaning(facts)})")
        if facts["fmr"] is not None:
            lines.append(f"fmr at most {facts['fmr']:.2g} (fraction of other, simulated fingers that are as similar)")
        if facts["method"] == "thesis":
            lines.append(
                f"overlap {facts['overlap']:.3f} of both outlines (intersection over union), "
                f"B shifted {abs(facts['alignment']['right_mm']):.2f} mm to the {_side(facts)}"
            )
        elif facts["method"] in _MINUTIAE:
            if facts["similarity_with_ridges"] is not None:
                joined = facts["similarity_with_ridges"]
                lines.append(
                    f"fused with the ridges {joined:.2f} (log-likelihood ratio; most other fingers lie below 0)"
                )
            lines += [_print_words(facts[name]) for name in ("a", "b")]
        elif facts["method"] in _IN_SPACE:
            both = " and ".join(str(facts[name]["minutiae"]) for name in ("a", "b"))
            lines.append(f"{facts['agreeing']} minutiae agree in place and direction, of {both}")
        elif facts["method"] == "surface-code" and facts["compared"]:
            turned = facts["alignment"]["rotation_deg"]
            lines.append(
                f"{facts['distance']:.1%} of the bits differ over {facts['overlap_mm2']:.0f} mm² of skin, A turned by "
                f"{turned:.1f} deg"
            )
        elif facts["compared"]:
            if facts["method"] == "fusion":
                score = facts["similarity_of_minutiae"]
                minutiae = "too few" if score is None else f"{score:.0f}"
                lines.append(f"ridges {facts['similarity_of_ridges']:.4f}, minutiae {minutiae}")
            laid = facts["alignment"]
            lines.append(
                f"overlap {facts['overlap_mm2']:.0f} mm² of skin; A turned by {laid['rotation_deg']:.1f} deg, its "
                f"middle {laid['right_mm']:+.2f} mm right and {laid['up_mm']:+.2f} mm up of B's"
            )
    lines += _notes(facts)
    if "template" in facts:
        made = facts["template"]
        lines.append(f"Template of {made['bytes']} bytes (version {made['version']}) written to {made['file']}.")
    return lines


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


def _meaning(facts: dict[str, Any]) -> str:
    if not facts["compared"]:
        both = facts["a"]["acquired"] and facts["b"]["acquired"]
        apart = facts["method"] == "thesis" or (facts["method"] == "surface-code" and both)
        why = "too little overlap" if apart else "failure to acquire"
        return f"not compared: {why}"
    return {
        "ridge": "1 = the same picture",
        "fusion": "log-likelihood ratio of ridges and minutiae; most other fingers lie below 0",
        "thesis": "1 = equal, 0 = as dissimilar as possible",
        "minutiae": "about how many pairs of minutiae fit together; other fingers seldom reach 40",
        "minutiae3d": "fraction of minutiae that agree, squared",
        "tetrahedra": "fraction of minutiae that agree, squared",
        "surface-code": "fraction of equal bits; other fingers have about two thirds",
        "voted": "about how many pairs of minutiae fit together; other fingers seldom reach 40",
    }[facts["method"]]


def _print_words(side: dict[str, Any]) -> str:
    if side["kind"] == "minutiae":
        return f"{side['path']}: {side['minutiae']} minutiae of another system"
    if "nfiq2" not in side:
        return f"{side['path']}: {side.get('minutiae', 0)} voted minutiae"
    quality = "unknown" if side["nfiq2"] is None else f"{side['nfiq2']} of 100"
    return f"{side['path']}: {side.get('minutiae', 0)} minutiae, quality (NFIQ 2) {quality}"


def _side(facts: dict[str, Any]) -> str:
    return "right" if facts["alignment"]["right_mm"] >= 0 else "left"
