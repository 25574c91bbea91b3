"""``splitknit print FINGER``: a flat print of a finger in space."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from splitknit.cli.import_photos import add_scale_options, check_scale_options
from splitknit.cli.verb import Outcome, Progress, add_input_ppi, add_preset, add_settings, from_options, new_verb


def add_print(verbs: Any) -> None:
    """Add the verb."""
    verb = new_verb(verbs, "print", "turn a finger in space into a flat print of 500 pixels per inch", _run)
    verb.add_argument(
        "finger",
        type=Path,
        metavar="FINGER",
        help="result folder, or capture folder (reconstructed first); or a print (PNG, TIFF, JPEG, BMP, WSQ, "
        "ISO 19794-4, ANSI/NIST-ITL), which is brought to 500 ppi, enhanced and searched for minutiae; or a photograph "
        "of a finger in colour, which is unrolled by a mean shape",
    )
    verb.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write the print into")
    verb.add_argument(
        "--method",
        choices=("relief", "unroll", "curvature", "photo", "specular", "rolled"),
        help="unroll: the relief on the skin laid flat (the default); relief: seen straight from above (the thesis's); "
        "curvature: the shape index; photo: the photograph (needs a capture); specular: what the surface "
        "reflects (needs polarising films); rolled: around the finger, by front "
        "and its mirrors (needs a capture with mirrors)",
    )
    verb.add_argument(
        "--surface",
        choices=("plane", "free", "arc", "tube", "cylinder"),
        help="where it is printed: the finger plane (default, except for unroll), or the skin laid flat: free (least "
        "distortion, default for unroll), arc (row by row), tube or cylinder (best-fit bodies)",
    )
    verb.add_argument("--ppi", type=int, choices=(500, 1000), default=500, help="pixels per inch (default: 500)")
    add_scale_options(verb)
    add_input_ppi(verb)
    add_preset(verb)
    add_settings(verb)


def _run(options: argparse.Namespace) -> Outcome:
    from splitknit.cli.options import read_changes  # verbs import what they need
    from splitknit.prints.folder import PrintJob, print_to_folder

    check_scale_options(options)
    changes = read_changes(options.settings, options.assignments)
    job = from_options(
        PrintJob, options, path=options.finger, ppi=float(options.ppi), changes=changes,
        ridge_period_mm=options.ridge_period,
    )  # fmt: skip
    with Progress(options) as progress:
        facts = print_to_folder(job, progress.update)
    return facts, _words(facts)


def _words(facts: dict[str, Any]) -> list[str]:
    rows, columns = facts["size"]
    where = {
        "plane": "on the finger plane, seen straight from above",
        "free": "on the skin laid flat with the least distortion",
        "arc": "on the skin laid flat row by row",
        "tube": "on the best-fit tube, unrolled",
        "cylinder": "on the best-fit cylinder, unrolled",
        "paper": "as it was pressed",
    }[facts["surface"]]
    period = facts["ridge_period_mm"]["median"]
    lines = [
        f"Print ({facts['method']}) of {columns} x {rows} pixels at {facts['ppi']:g} ppi, {where}: "
        f"{facts['ridge_area_mm2']:.0f} mm² of ridges, {period:.2f} mm apart."
    ]
    if "scale" in facts:
        lines.append(f"Please note: {facts['scale']}")
    if "rolled" in facts:
        lines.append(_rolled_words(facts["rolled"]))
        lines += [f"Please note: {warning}" for warning in facts["rolled"]["warnings"]]
    if "distortion" in facts:
        figures = facts["distortion"]
        lines.append(
            f"Lengths are off by {figures['length_median_percent']:.1f} % (median) and "
            f"{figures['length_p95_percent']:.1f} % (95th percentile), whichever way is worse."
        )
    minutiae = facts["minutiae"]
    if minutiae["written"]:
        lines.append(f"{minutiae['count']} minutiae.")
    else:
        lines.append(f"Please note: no minutiae.iso: {minutiae['missing']}")
    lines += _quality_words(facts["quality"])
    lines.append(f"Written to {facts['out']}: {', '.join(facts['files'])}.")
    return lines


def _rolled_words(rolled: dict[str, Any]) -> str:
    steps = [seam["step_rms_um"] for seam in rolled["seams"].values() if seam["step_rms_um"] is not None]
    words = (
        f"It reaches {rolled['coverage_deg']['median']:.0f} deg around the finger, from {len(rolled['views'])} views"
    )
    return words + (f"; seams step by {max(steps):.1f} um at most (rms)." if steps else ".")


def _quality_words(quality: dict[str, Any]) -> list[str]:
    """One line of scores and, where something is wrong, what to do."""
    words = f"Quality: {quality['ours']:.0f} of 100"
    if quality["nfiq2"] is not None:
        of_print, of_enhanced = ("none" if value is None else value for value in quality["nfiq2"].values())
        words += f"; NFIQ 2 is {of_print} (print) and {of_enhanced} (enhanced)"
    return [f"{words}.", *quality["advice"]]
