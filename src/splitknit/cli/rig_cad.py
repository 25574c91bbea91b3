"""The command line of ``splitknit rig cad``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from splitknit.cli.verb import Outcome, Progress, add_settings, new_verb


def add_cad(kinds: Any) -> None:
    """Add ``splitknit rig cad``."""
    verb = new_verb(kinds, "cad", "draw the parts of a rig for a 3D printer: STL, STEP, pictures, checks", _run)
    verb.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write")
    verb.add_argument(
        "--rig", type=Path, default=None, metavar="FILE", help="rig file (default: the thesis's rig, 14 cm, 14 LEDs)"
    )
    verb.add_argument("--below", action="store_true", help="put the assembly together with the camera below the finger")
    verb.add_argument("--no-pictures", action="store_true", help="leave the pictures out")
    add_settings(verb)


def _run(options: argparse.Namespace) -> Outcome:
    """Draw, check and write the parts."""
    from splitknit.cli.options import read_changes  # noqa: PLC0415 - verbs import what they need
    from splitknit.rig.cad import cad_to_folder  # noqa: PLC0415

    changes = read_changes(options.settings, options.assignments)
    with Progress(options) as progress:
        facts = cad_to_folder(
            options.out,
            rig_file=options.rig,
            changes=changes,
            below=options.below,
            pictures=not options.no_pictures,
            progress=progress.update,
        )
    return facts, _lines(facts, options.out)


def _lines(facts: dict[str, Any], out: Path) -> list[str]:
    parts, dimensions = facts["parts"], facts["dimensions"]
    needed = sum(part["mass_g"] * part["quantity"] for part in parts.values() if part["needed"])
    tilts = sorted({led["tilt_deg"] for led in dimensions["leds"]})
    tilt = f"{tilts[0]:.1f} deg" if tilts[-1] - tilts[0] < 0.1 else f"{tilts[0]:.1f} to {tilts[-1]:.1f} deg"
    lines = [
        f"{len(parts)} parts drawn, all closed; the rig stands {dimensions['total_height_mm']:.0f} mm high, its "
        f"{len(dimensions['leds'])} LED holes are tilted by {tilt}, the nail is {dimensions['nail']['height_mm']:g} mm "
        f"high.",
        f"What the rig needs weighs {needed:.0f} g in solid PLA, less with infill.",
    ]
    for name, part in parts.items():
        size = " x ".join(f"{value:.0f}" for value in part["size_mm"])
        checks = part["checks"]
        lines.append(
            f"  {name:22s} {size} mm, {part['mass_g']:.0f} g, thinnest wall {checks['wall']['smallest_mm']:.1f} mm, "
            f"longest bridge {checks['overhang']['bridge_mm']:.1f} mm"
        )
        lines += [f"    {finding}" for finding in part["findings"]]
    return [*lines, f"Written to {out}: stl/, step/, assembly.step, pictures/, parts.json."]
