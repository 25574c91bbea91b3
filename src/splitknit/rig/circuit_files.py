"""The LED board's files: netlist, parts, pin map, and the schematic as plain SVG."""

from __future__ import annotations

import csv
import html
import io
import json
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from splitknit import __version__
from splitknit.io.atomic import atomic_folder
from splitknit.io.rig import write_rig
from splitknit.io.targets import check_target
from splitknit.model import Rig
from splitknit.rig.circuit import CircuitSettings, Stage
from splitknit.rig.netlist import (
    FUSE_HOLD_A,
    HEADER_OF_GPIO,
    Channel,
    Circuit,
    bill_of_materials,
    design_circuit,
    kicad_netlist,
    ohm_text,
)

INK, RAIL, QUIET = "#222222", "#B03A2E", "#555555"
CELL = (270, 300)
"""Width and height of one stage."""
COLUMNS = 5
FILES = ("circuit.net", "schematic.svg", "parts.csv", "circuit.json", "rig.json")


def circuit_to_folder(out: Path, rig: Rig, settings: CircuitSettings) -> dict[str, Any]:
    """Design the LED board of a rig and write its files, the rig's with the pin map; return the facts.

    Raises
    ------
    BadInput
        If the folder holds something else, or no board can be made with these settings.
    """
    check_target(out, "circuit.net", "an earlier board")
    circuit = design_circuit(rig, settings)
    pins = {band: [c.gpio for c in circuit.channels if c.stage.band == band] for band in ("white", "nir")}
    pinned = replace(rig, provenance={**rig.provenance, "pins": {band: lines for band, lines in pins.items() if lines}})
    facts = _facts(circuit, out)
    with atomic_folder(out) as folder:
        (folder / "circuit.net").write_text(kicad_netlist(circuit, __version__), encoding="utf-8")
        (folder / "schematic.svg").write_text(_schematic_svg(circuit) + "\n", encoding="utf-8")
        (folder / "parts.csv").write_text(_parts_csv(circuit), encoding="utf-8")
        (folder / "circuit.json").write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")
        write_rig(pinned, folder / "rig.json")
    return facts


def _schematic_svg(circuit: Circuit) -> str:
    """Return the schematic as one SVG document."""
    rows = -(-len(circuit.channels) // COLUMNS)
    width, top = COLUMNS * CELL[0] + 20, 190
    height = top + rows * CELL[1] + 20
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}" '
        'font-family="sans-serif" font-size="12" role="img" '
        f'aria-label="Schematic of {len(circuit.channels)} LED stages">',
        f'<rect width="{width}" height="{height}" fill="white"/>',
        _text(20, 28, "LED board: one transistor stage for each LED", size=18),
        _text(20, 48, _subtitle(circuit), fill=QUIET),
        *_supply(circuit),
    ]
    for k, channel in enumerate(circuit.channels):
        row, column = divmod(k, COLUMNS)
        parts += _stage(10 + column * CELL[0], top + row * CELL[1], channel, circuit.settings.transistor.name)
    parts.append("</svg>")
    return "\n".join(parts)


def _subtitle(circuit: Circuit) -> str:
    kind = (
        "current sink: the emitter resistor sets the current"
        if circuit.settings.topology == "sink"
        else "switch: the series resistor sets the current"
    )
    return f"{kind}; {circuit.settings.supply_v:g} V; every LED has the same parts as its neighbours of the same band"


def _supply(circuit: Circuit) -> list[str]:
    """Jack, fuse, protection and capacitors, from left to right."""
    y, ground = 90, 150
    parts = [
        _box(20, y - 22, 66, 44),
        _text(53, y - 2, "J2", "middle"),
        _text(53, y + 13, f"{circuit.settings.supply_v:g} V DC", "middle"),
    ]
    parts += [
        _line(86, y - 10, 130, y - 10),
        _box(130, y - 18, 46, 16),
        _text(153, y - 24, f"F1 {FUSE_HOLD_A:g} A", "middle"),
    ]
    parts += [_line(176, y - 10, 520, y - 10, RAIL), _text(526, y - 6, "V_LED", fill=RAIL)]
    parts += [_line(86, y + 10, 104, y + 10), _line(104, y + 10, 104, ground), _ground(104, ground)]
    parts += _diode(230, y - 10, ground, "D90", "1N5819")
    for x, ref, value in ((330, "C1", "470 uF"), (430, "C2", "100 nF")):
        middle = (y - 10 + ground) / 2
        parts += [
            _line(x, y - 10, x, middle - 4),
            _line(x - 12, middle - 4, x + 12, middle - 4),
            _line(x - 12, middle + 4, x + 12, middle + 4),
        ]
        parts += [
            _line(x, middle + 4, x, ground),
            _ground(x, ground),
            _text(x + 16, middle - 2, ref),
            _text(x + 16, middle + 12, value),
        ]
    parts += [
        _text(620, y - 8, "J1: the Raspberry Pi's 40-pin header; ground on its pins 6, 9, 14, 20, 25, 30, 34, 39."),
        _text(620, y + 10, "The Pi has a supply of its own; the two grounds meet in J1."),
        _text(
            620,
            y + 28,
            "D90 shorts a supply that is the wrong way round; F1 then opens, as when several LEDs stay on together.",
        ),
    ]
    return parts


def _stage(left: float, top: float, channel: Channel, transistor: str) -> list[str]:
    """One stage: line, base resistor, transistor, emitter resistor, LED, series resistor."""
    stage, n = channel.stage, channel.number
    x, rail, base, ground = left + 185, top + 36, top + 178, top + 268
    parts = [
        f'<rect x="{left + 2}" y="{top + 2}" width="{CELL[0] - 6}" height="{CELL[1] - 8}" fill="none" '
        'stroke="#DDDDDD"/>',
        _text(left + 10, top + 20, f"D{n}: {channel.name}", size=13),
        _line(x - 22, rail, x + 22, rail, RAIL),
        _text(x + 26, rail + 4, "V_LED", fill=RAIL),
    ]
    y = rail
    if stage.ohm("series"):
        parts += _resistor_down(x, y, y + 46, f"R{300 + n}", _value(stage, "series"))
        y += 46
    parts += _led(x, y, y + 42, f"D{n}")
    y += 42
    parts += [_line(x, y, x, base - 14)]
    # transistor: bar, collector, emitter with its arrow
    parts += [
        _line(x - 16, base - 14, x - 16, base + 14, width=3),
        _line(x - 16, base - 6, x, base - 14),
        _line(x - 16, base + 6, x, base + 14),
    ]
    parts += [f'<polygon points="{x},{base + 14} {x - 9},{base + 13} {x - 4},{base + 6}" fill="{INK}"/>']
    parts += [
        f'<circle cx="{x - 8}" cy="{base}" r="20" fill="none" stroke="{INK}"/>',
        _text(x + 16, base - 2, f"Q{n}"),
        _text(x + 16, base + 12, transistor),
    ]
    if stage.ohm("emitter"):
        parts += _resistor_down(x, base + 14, ground - 12, f"R{200 + n}", _value(stage, "emitter"))
        parts += [_line(x, ground - 12, x, ground - 6), _ground(x, ground - 6)]
    else:
        parts += [_line(x, base + 14, x, ground - 6), _ground(x, ground - 6)]
    # base resistor and pull-down
    parts += [
        _line(x - 56, base, x - 16, base),
        _box(x - 104, base - 7, 48, 14),
        _text(x - 80, base - 12, f"R{100 + n}  {ohm_text(stage.ohm('base'))}", "middle"),
    ]
    parts += [_line(left + 30, base, x - 104, base), f'<circle cx="{left + 50}" cy="{base}" r="2.5" fill="{INK}"/>']
    parts += _resistor_down(left + 50, base, base + 52, f"R{400 + n}", ohm_text(stage.ohm("pull_down")))
    parts += [_line(left + 50, base + 52, left + 50, base + 60), _ground(left + 50, base + 60)]
    parts += [
        _text(left + 12, base - 26, f"GPIO {channel.gpio}"),
        _text(left + 12, base - 12, f"J1-{HEADER_OF_GPIO[channel.gpio]}", fill=QUIET),
    ]
    low, middle, high = (1000 * a for a in stage.current_a)
    parts.append(_text(left + 10, top + CELL[1] - 14, f"{middle:.0f} mA ({low:.0f} to {high:.0f})", fill=QUIET))
    return parts


def _value(stage: Stage, role: str) -> str:
    rating = next(r.rating_w for r in stage.resistors if r.role == role)
    return f"{ohm_text(stage.ohm(role))} {rating:g} W"


def _resistor_down(x: float, first: float, last: float, ref: str, value: str) -> list[str]:
    middle = (first + last) / 2
    return [
        _line(x, first, x, middle - 15),
        _box(x - 6, middle - 15, 12, 30),
        _line(x, middle + 15, x, last),
        _text(x + 11, middle - 2, ref),
        _text(x + 11, middle + 12, value),
    ]


def _led(x: float, first: float, last: float, ref: str) -> list[str]:
    middle = (first + last) / 2
    arrows = "".join(
        f'<path d="M{x - 14},{middle + d} l-12,-7 m0,0 l5,0 m-5,0 l2.4,4.4" stroke="{INK}" fill="none"/>'
        for d in (-4, 5)
    )
    return [
        _line(x, first, x, middle - 9),
        f'<polygon points="{x - 10},{middle - 9} {x + 10},{middle - 9} {x},{middle + 8}" fill="white" stroke="{INK}"/>',
        _line(x - 10, middle + 8, x + 10, middle + 8, width=2),
        _line(x, middle + 8, x, last),
        arrows,
        _text(x + 16, middle + 4, ref),
    ]


def _diode(x: float, rail: float, ground: float, ref: str, value: str) -> list[str]:
    middle = (rail + ground) / 2
    return [
        _line(x, rail, x, middle - 8),
        _line(x - 9, middle - 8, x + 9, middle - 8, width=2),
        f'<polygon points="{x - 9},{middle + 8} {x + 9},{middle + 8} {x},{middle - 8}" fill="white" stroke="{INK}"/>',
        _line(x, middle + 8, x, ground),
        _ground(x, ground),
        _text(x + 14, middle - 2, ref),
        _text(x + 14, middle + 12, value),
    ]


def _ground(x: float, y: float) -> str:
    return "".join(_line(x - 9 + 3 * k, y + 4 * k, x + 9 - 3 * k, y + 4 * k) for k in range(3))


def _line(x1: float, y1: float, x2: float, y2: float, stroke: str = INK, width: float = 1.3) -> str:  # noqa: PLR0917
    return f'<line x1="{x1:g}" y1="{y1:g}" x2="{x2:g}" y2="{y2:g}" stroke="{stroke}" stroke-width="{width:g}"/>'


def _box(x: float, y: float, width: float, height: float) -> str:
    size = f'width="{width:g}" height="{height:g}"'
    return f'<rect x="{x:g}" y="{y:g}" {size} fill="white" stroke="{INK}" stroke-width="1.3"/>'


def _text(x: float, y: float, text: str, anchor: str = "start", *, size: int = 12, fill: str = INK) -> str:
    return f'<text x="{x:g}" y="{y:g}" text-anchor="{anchor}" font-size="{size}" fill="{fill}">{_escaped(text)}</text>'


def _escaped(text: str) -> str:
    return html.escape(text).replace("&#x27;", "&#39;").replace("&quot;", "&#34;")


def _facts(circuit: Circuit, out: Path) -> dict[str, Any]:
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


def _parts_csv(circuit: Circuit) -> str:
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["quantity", "value", "footprint", "references"])
    for quantity, value, footprint, references in bill_of_materials(circuit):
        writer.writerow([quantity, value, footprint, " ".join(references)])
    return stream.getvalue()
