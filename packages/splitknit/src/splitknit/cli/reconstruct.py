"""``splitknit reconstruct``: a capture folder, or photographs and light directions, in; a folder of results out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from splitknit.cli.verb import Outcome, Verb
from splitknit.jobs import ReconstructJob


def _show(facts: dict[str, Any], job: ReconstructJob) -> Outcome:
    area = facts["result"]["area_px"]
    measured = f"{facts['area_mm2']:.0f} mm²" if facts["result"]["scale_known"] else f"{area} px (scale unknown)"
    spoilt = facts["facts"].get("spoilt", 0)
    lines = [
        *(f"The surface is spoilt: {warning}" for warning in facts["warnings"][:spoilt]),
        f"{measured} reconstructed with preset {facts['preset']} in {facts['total_s']:.1f} s.",
        f"Written to {job.out}: {', '.join(facts['files'])}.",
    ]
    lines += [f"Please note: {warning}" for warning in facts["warnings"][spoilt:]]
    for preset, figure in facts["comparison"].items():
        shown = f"surface rms {figure['surface_rms_mm']:.3f} mm, ridge correlation {figure['ridge_correlation']:.2f}"
        lines.append(f"Against the truth ({preset}): {shown}, ridge gain {figure['ridge_gain']:.2f}.")
    lines.append(f"Open {Path(job.out) / 'report.html'} in a browser.")
    return facts, lines


RECONSTRUCT = Verb(ReconstructJob, _show)
