"""``splitknit rig circuit``: the LED board as netlist, drawing and list of parts, and the rig file's pin map."""

from __future__ import annotations

import argparse
import csv
import io
import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from splitknit.apps.verb import Outcome, add_settings, new_verb

FILES = ("circuit.net", "schematic.svg", "parts.csv", "circuit.json", "rig.json")


def add_circuit(kinds: Any) -> None:
    """Add ``splitknit rig circuit``."""
    verb = new_verb(kinds, "circuit", "the LED board: KiCad netlist, schematic, parts, pin map", run)
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


def run(options: argparse.Namespace) -> Outcome:
    """Design the board and write it."""
    from splitknit import __version__  # noqa: PLC0415
    from splitknit.apps.building.schematic import schematic_svg  # noqa: PLC0415
    from splitknit.apps.options import read_changes  # noqa: PLC0415
    from splitknit.apps.targets import check_target  # noqa: PLC0415
    from splitknit.io.atomic import atomic_folder  # noqa: PLC0415
    from splitknit.io.rig import read_rig, write_rig  # noqa: PLC0415
    from splitknit.model import default_rig  # noqa: PLC0415
    from splitknit.rig.circuit import CircuitSettings  # noqa: PLC0415
    from splitknit.rig.netlist import design_circuit, kicad_netlist  # noqa: PLC0415
    from splitknit.settings import override  # noqa: PLC0415

    check_target(options.out, "circuit.net", "an earlier board")
    changes = dict(read_changes(options.settings, options.assignments))
    given = {"topology": options.topology, "supply_v": options.supply_v}
    settings = override(
        CircuitSettings(), {**{k: v for k, v in given.items() if v is not None}, **_without_stage(changes)}
    )
    rig = read_rig(options.rig) if options.rig else default_rig()
    circuit = design_circuit(rig, settings)
    pins = {band: [c.gpio for c in circuit.channels if c.stage.band == band] for band in ("white", "nir")}
    pinned = replace(rig, provenance={**rig.provenance, "pins": {band: lines for band, lines in pins.items() if lines}})
    facts = _facts(circuit, options.out)
    with atomic_folder(options.out) as folder:
        (folder / "circuit.net").write_text(kicad_netlist(circuit, __version__), encoding="utf-8")
        (folder / "schematic.svg").write_text(str(schematic_svg(circuit)) + "\n", encoding="utf-8")
        (folder / "parts.csv").write_text(_parts_csv(circuit), encoding="utf-8")
        (folder / "circuit.json").write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")
        write_rig(pinned, folder / "rig.json")
    lines = [f"LED board of {len(circuit.channels)} stages ({settings.topology}, {settings.supply_v:g} V):"]
    for band, stage in facts["stages"].items():
        low, middle, high = stage["current_ma"]
        values = ", ".join(f"{role} {r['ohm']:g} ohm {r['rating_w']:g} W" for role, r in stage["resistors"].items())
        lines.append(f"  {band:5s} {middle:.0f} mA ({low:.0f} to {high:.0f} over all tolerances): {values}")
    lines.append(f"Written to {options.out}: {', '.join(FILES)}; rig.json holds the pin map.")
    return facts, lines


def _without_stage(changes: dict[str, Any]) -> dict[str, Any]:
    """``circuit.supply_v`` and ``supply_v`` are the same setting."""
    from splitknit.settings import flatten  # noqa: PLC0415

    return {name.removeprefix("circuit."): value for name, value in flatten(changes).items()}


def _facts(circuit: Any, out: Path) -> dict[str, Any]:
    stages = {}
    for band in ("white", "nir"):
        stage = next((c.stage for c in circuit.channels if c.stage.band == band), None)
        if stage is None:
            continue
        stages[band] = {
            "resistors": {
                r.role: {"ohm": r.ohm, "rating_w": r.rating_w, "heat_w": round(r.heat_w, 4)} for r in stage.resistors
            },
            "current_ma": [round(1000 * a, 2) for a in stage.current_a],
            "gpio_ma": round(1000 * stage.gpio_a, 3),
            "gpio_without_supply_ma": round(1000 * stage.gpio_fault_a, 3),
            "transistor_w": round(stage.transistor_w, 3),
        }
    return {
        "out": str(out),
        "files": list(FILES),
        "settings": asdict(circuit.settings),
        "stages": stages,
        "leds": [{"led": c.name, "gpio": c.gpio, "stage": c.number} for c in circuit.channels],
        "parts": len(circuit.components),
        "nets": len(circuit.nets),
    }


def _parts_csv(circuit: Any) -> str:
    from splitknit.rig.netlist import bill_of_materials  # noqa: PLC0415

    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["quantity", "value", "footprint", "references"])
    for quantity, value, footprint, references in bill_of_materials(circuit):
        writer.writerow([quantity, value, footprint, " ".join(references)])
    return stream.getvalue()
