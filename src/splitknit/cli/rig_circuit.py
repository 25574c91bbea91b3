"""``splitknit rig circuit``: the LED board, its parts, its light on eye and skin, and the rig file's pin map."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from splitknit.cli.verb import Outcome, add_settings, new_verb


def add_circuit(kinds: Any) -> None:
    """Add ``splitknit rig circuit``."""
    verb = new_verb(
        kinds, "circuit", "the LED board: layout, Gerbers, schematic, parts, pin map, light on eye and skin", _run
    )
    verb.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write")
    verb.add_argument("--rig", type=Path, default=None, metavar="RIG", help="rig file (default: the thesis's 14 LEDs)")
    verb.add_argument(
        "--topology",
        choices=("sink", "switch"),
        default=None,
        help="sink: the current does not depend on supply and LED (the default); switch: the thesis's stage",
    )
    verb.add_argument("--supply-v", type=float, default=None, help="voltage of the LEDs' supply (default: 9)")
    add_settings(verb)


def _run(options: argparse.Namespace) -> Outcome:
    """Design the board and write it."""
    from splitknit.cli.options import read_changes  # noqa: PLC0415
    from splitknit.io.rig import read_rig  # noqa: PLC0415
    from splitknit.model import default_rig  # noqa: PLC0415
    from splitknit.rig.circuit import CircuitSettings  # noqa: PLC0415
    from splitknit.rig.circuit_files import circuit_to_folder  # noqa: PLC0415
    from splitknit.settings import flatten, override  # noqa: PLC0415

    given = {"topology": options.topology, "supply_v": options.supply_v}
    # ``circuit.supply_v`` and ``supply_v`` are the same setting
    changes = flatten(read_changes(options.settings, options.assignments))
    named = {name.removeprefix("circuit."): value for name, value in changes.items()}
    settings = override(CircuitSettings(), {**{k: v for k, v in given.items() if v is not None}, **named})
    facts = circuit_to_folder(options.out, read_rig(options.rig) if options.rig else default_rig(), settings)
    lines = [f"LED board of {len(facts['leds'])} stages ({settings.topology}, {settings.supply_v:g} V):"]
    for band, stage in facts["stages"].items():
        low, middle, high = stage["current_ma"]
        values = ", ".join(f"{role} {r['ohm']:g} ohm {r['rating_w']:g} W" for role, r in stage["resistors"].items())
        lines.append(f"  {band:5s} {middle:.0f} mA ({low:.0f} to {high:.0f} over all tolerances): {values}")
    lines.append(f"  fuse {facts['fuse_ma']} mA, for one LED at a time")
    width, height = facts["board"]["size_mm"]
    lines.append(f"  laid out on {width:g} x {height:g} mm with two layers; not yet made")
    lines.append(
        "Light on eye and skin, all LEDs on, against the exempt group of IEC 62471 (calculated, no certificate):"
    )
    for hazard in facts["safety"]:
        lines.append(
            f"  {hazard['leds']:5s} {hazard['hazard']:26s} {hazard['value']:9.4g} of {hazard['limit']:.4g} "
            f"{hazard['unit']}, margin {hazard['margin']:.3g} ({hazard['margin_with_a_shorted_transistor']:.3g} with a "
            "shorted transistor)"
        )
    lines.append(f"Written to {options.out}: {', '.join(facts['files'])}; rig.json holds the pin map.")
    return facts, lines
