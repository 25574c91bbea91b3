"""``splitknit print FINGER``: a flat print of a finger in space."""

from __future__ import annotations

from typing import Any

from splitknit.cli.verb import Verb
from splitknit_match.prints.print_job import PrintJob

PRINT = Verb(PrintJob, lambda facts, job: (facts, _words(facts)))


def _words(facts: dict[str, Any]) -> list[str]:
    rows, columns = facts["size"]
    where = {
        "plane": "on the finger plane, seen straight from above",
        "free": "on the skin laid flat with the least distortion",
        "arc": "on the skin laid flat row by row",
        "paper": "as it was pressed",
    }[facts["surface"]]
    period = facts["ridge_period_mm"]["median"]
    size = f"{columns} x {rows} pixels at {facts['ppi']:g} ppi"
    ridges = f"{facts['ridge_area_mm2']:.0f} mm² of ridges, {period:.2f} mm apart"
    lines = [f"Print ({facts['method']}) of {size}, {where}: {ridges}."]
    if "scale" in facts:
        lines.append(f"Please note: {facts['scale']}")
    if "rolled" in facts:
        reach, views = facts["rolled"]["coverage_deg"]["median"], facts["rolled"]["views"]
        lines.append(f"It reaches {reach:.0f} deg around the finger, from {len(views)} views.")
        lines += [f"Please note: {warning}" for warning in facts["rolled"]["warnings"]]
    if facts.get("distortion"):
        figures = facts["distortion"]
        median, most = figures["length_median_percent"], figures["length_p95_percent"]
        off = f"{median:.1f} % (median) and {most:.1f} % (95th percentile)"
        lines.append(f"Lengths are off by {off}, whichever way is worse.")
    lines.append(f"{facts['minutiae']['count']} minutiae.")
    lines += [] if "photo" in facts["quality"] else _quality_words(facts["quality"])  # a photograph's note says it
    lines.append(f"Written to {facts['out']}: {', '.join(facts['files'])}.")
    return lines


def _quality_words(quality: dict[str, Any]) -> list[str]:
    """One line of scores and, where something is wrong, what to do."""
    words = f"Quality: {quality['ours']:.0f} of 100"
    if quality["nfiq2"] is not None:
        of_print, of_enhanced = ("none" if value is None else value for value in quality["nfiq2"].values())
        words += f"; NFIQ 2 is {of_print} (print) and {of_enhanced} (enhanced)"
    return [f"{words}.", *quality["advice"]]
