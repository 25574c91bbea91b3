"""The LED board's components and nets, and its folder of files: netlist, layout, parts, pin map, schematic as SVG."""

from __future__ import annotations

import uuid
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from splitknit import __version__
from splitknit.capture.pins import led_names, pins_of
from splitknit.errors import require
from splitknit.io.atomic import atomic_folder
from splitknit.io.csv_table import csv_text
from splitknit.io.provenance import json_text
from splitknit.io.rig import write_rig
from splitknit.io.targets import check_target
from splitknit.model import Rig
from splitknit.rig.board import lay_out
from splitknit.rig.board_files import gerber_zip, kicad_board, quoted, wiring_svg, words
from splitknit.rig.circuit import Channel, Circuit, CircuitSettings, Component, Node, Stage, design_stage
from splitknit.rig.circuit_parts import FIXED, FUSES_A, OFF_BOARD, Order, fuse, led_order, resistor
from splitknit.rig.safety import check_hazards, rig_hazards

HEADER_OF_GPIO: Mapping[int, int] = {
    2: 3, 3: 5, 4: 7, 5: 29, 6: 31, 7: 26, 8: 24, 9: 21, 10: 19, 11: 23, 12: 32, 13: 33, 14: 8, 15: 10, 16: 36,
    17: 11, 18: 12, 19: 35, 20: 38, 21: 40, 22: 15, 23: 16, 24: 18, 25: 22, 26: 37, 27: 13,
}  # fmt: skip
"""Pin of the Raspberry Pi's 40-pin header for each GPIO line (BCM number)."""
GROUND_PINS = (6, 9, 14, 20, 25, 30, 34, 39)
"""Ground pins of the header."""
FUSE_AT_50_DEG = 0.7
"""Fraction of its current at 20 degrees that a resettable fuse still carries in a box of 50 degrees."""

_RESISTOR_FOOTPRINTS = {
    0.25: "Resistor_THT:R_Axial_DIN0207_L6.3mm_D2.5mm_P10.16mm_Horizontal",
    0.6: "Resistor_THT:R_Axial_DIN0207_L6.3mm_D2.5mm_P10.16mm_Horizontal",
    1.0: "Resistor_THT:R_Axial_DIN0411_L9.9mm_D3.6mm_P15.24mm_Horizontal",
    2.0: "Resistor_THT:R_Axial_DIN0414_L11.9mm_D4.5mm_P15.24mm_Horizontal",
    3.0: "Resistor_THT:R_Axial_DIN0617_L17.0mm_D6.0mm_P20.32mm_Horizontal",
}


def design_circuit(rig: Rig, settings: CircuitSettings | None = None) -> Circuit:
    """Design the board for a rig's LEDs.

    Parameters
    ----------
    rig : LEDs of the bands ``white`` and ``nir``; GPIO lines from its ``provenance.pins``, or the default ones
    settings : parts and margins

    Raises
    ------
    BadInput
        If a margin is missed, a GPIO line is used twice, or the rig has LEDs of another band or distant lights.
    """
    settings = settings or CircuitSettings()
    for index, led in enumerate(rig.leds):
        require(
            led.band in ("white", "nir"),
            f"LED {index} of the rig is of the band '{led.band}'; there are stages for white and nir.",
        )
    stages = {
        band: design_stage(band, settings) for band in ("white", "nir") if any(led.band == band for led in rig.leds)
    }
    names, pins = led_names(rig), pins_of(rig)
    channels = tuple(
        Channel(name, pin, stages[led.band], k + 1)
        for k, (name, pin, led) in enumerate(zip(names, pins, rig.leds, strict=True))
    )
    fuse_a = _fuse_for(max(stage.current_a[2] for stage in stages.values()))
    components, nets = _supply_parts(settings, fuse_a)
    for channel in channels:
        _add_stage(channel, settings, components, nets)
    wired = {name: tuple(nodes) for name, nodes in nets.items()}
    return Circuit(settings, channels, tuple(components), wired, fuse_a)


def _fuse_for(led_a: float) -> float:
    """Return the smallest fuse that carries the current of one LED in a warm box. Raises BadInput if there is none."""
    fitting = [hold for hold in FUSES_A if FUSE_AT_50_DEG * hold >= led_a]
    largest = max(FUSES_A) * FUSE_AT_50_DEG
    require(
        len(fitting) > 0,
        f"no resettable fuse of the list carries {1000 * led_a:.0f} mA at 50 degrees; the largest carries "
        f"{1000 * largest:.0f} mA: take a smaller LED current.",
    )
    return min(fitting)


def _supply_parts(s: CircuitSettings, fuse_a: float) -> tuple[list[Component], dict[str, list[Node]]]:
    """The Pi's header, the LEDs' supply with its fuse, and what stores charge."""
    components = [
        Component(
            "J1",
            "Raspberry Pi GPIO",
            "Connector_Generic",
            "Conn_02x20_Odd_Even",
            "Connector_IDC:IDC-Header_2x20_P2.54mm_Vertical",
        ),
        Component(
            "J2",
            f"{s.supply_v:g} V DC, centre +",
            "Connector",
            "Barrel_Jack",
            "Connector_BarrelJack:BarrelJack_Horizontal",
        ),
        Component("F1", f"{1000 * fuse_a:.0f} mA hold, resettable", "Device", "Polyfuse", FUSES_A[fuse_a][3]),
        Component("D90", "1N5819", "Device", "D_Schottky", "Diode_THT:D_DO-41_SOD81_P10.16mm_Horizontal"),
        Component("C1", "470 uF 25 V", "Device", "C_Polarized", "Capacitor_THT:CP_Radial_D10.0mm_P5.00mm"),
        Component("C2", "100 nF", "Device", "C", "Capacitor_THT:C_Disc_D5.0mm_W2.5mm_P5.00mm"),
    ]
    nets = {
        "GND": [
            *(Node("J1", str(pin), "GND") for pin in GROUND_PINS),
            Node("J2", "2", "sleeve"),
            Node("C1", "2", "-"),
            Node("C2", "2"),
            Node("D90", "2", "A"),
        ],
        "SUPPLY_IN": [Node("J2", "1", "tip"), Node("F1", "1")],
        # a supply the wrong way round is shorted by the diode and trips the fuse
        "V_LED": [Node("F1", "2"), Node("D90", "1", "K"), Node("C1", "1", "+"), Node("C2", "1")],
    }
    return components, nets


def _add_stage(channel: Channel, s: CircuitSettings, components: list[Component], nets: dict[str, list[Node]]) -> None:
    """Add one stage's parts, their references numbered by the channel: R101 ... R104, Q1, D1."""
    n, stage = channel.number, channel.stage
    refs = {role: f"R{100 * (k + 1) + n}" for k, role in enumerate(("base", "emitter", "series", "pull_down"))}
    for part in stage.resistors:
        footprint = _RESISTOR_FOOTPRINTS[part.rating_w]
        value = _resistor_text(part.ohm, part.rating_w)
        components.append(Component(refs[part.role], value, "Device", "R", footprint))
    components.append(
        Component(f"Q{n}", s.transistor.name, "Transistor_BJT", "BC337", "Package_TO_SOT_THT:TO-92_Inline_Wide")
    )
    components.append(
        Component(
            f"D{n}",
            f"{channel.name} ({stage.led.name})",
            "Device",
            "LED",
            "Connector_PinHeader_2.54mm:PinHeader_1x02_P2.54mm_Vertical",
        )
    )
    line, base = f"GPIO{channel.gpio}", f"BASE{n}"
    require(channel.gpio in HEADER_OF_GPIO, f"GPIO {channel.gpio} is not on the Raspberry Pi's header.")
    nets[line] = [
        Node("J1", str(HEADER_OF_GPIO[channel.gpio]), line),
        Node(refs["base"], "1"),
        Node(refs["pull_down"], "1"),
    ]
    nets["GND"].append(Node(refs["pull_down"], "2"))
    nets[base] = [Node(refs["base"], "2"), Node(f"Q{n}", "2", "B")]
    if stage.ohm("emitter"):
        nets[f"EMITTER{n}"] = [Node(f"Q{n}", "3", "E"), Node(refs["emitter"], "1")]
        nets["GND"].append(Node(refs["emitter"], "2"))
    else:
        nets["GND"].append(Node(f"Q{n}", "3", "E"))
    nets[f"COLLECTOR{n}"] = [Node(f"Q{n}", "1", "C"), Node(f"D{n}", "1", "K")]
    if stage.ohm("series"):
        nets[f"ANODE{n}"] = [Node(f"D{n}", "2", "A"), Node(refs["series"], "1")]
        nets["V_LED"].append(Node(refs["series"], "2"))
    else:
        nets["V_LED"].append(Node(f"D{n}", "2", "A"))


def _ohm_text(ohm: float) -> str:
    """Return a resistance as it is written on a drawing: 27R, 4k7, 100k."""
    for size, letter in ((1e6, "M"), (1e3, "k"), (1.0, "R")):
        if ohm >= size:
            whole, _, part = f"{ohm / size:.3g}".partition(".")
            return f"{whole}{letter}{part}"
    return f"0R{f'{ohm:.2f}'.partition('.')[2]}"


def _resistor_text(ohm: float, rating_w: float) -> str:
    return f"{_ohm_text(ohm)} {rating_w:g} W"


def _kicad_netlist(circuit: Circuit, version: str) -> str:
    """Return KiCad's netlist (its S-expression format, version E), to import into the board editor.

    The same circuit gives the same text: there is no date in it, and the parts' identifiers follow from their names.
    """
    lines = [
        '(export (version "E")',
        f'  (design (source "splitknit rig circuit") (tool "splitknit {version}"))',
        "  (components",
    ]
    for part in circuit.components:
        stamp = uuid.uuid5(uuid.NAMESPACE_URL, f"splitknit:circuit:{part.ref}")
        lines += [
            f"    (comp (ref {quoted(part.ref)})",
            f"      (value {quoted(part.value)})",
            f"      (footprint {quoted(part.footprint)})",
            f'      (libsource (lib {quoted(part.library)}) (part {quoted(part.symbol)}) (description ""))',
            f"      (tstamps {quoted(str(stamp))}))",
        ]
    lines.append("  )")
    lines.append("  (nets")
    for code, (name, nodes) in enumerate(circuit.nets.items(), start=1):
        lines.append(f"    (net (code {quoted(str(code))}) (name {quoted(name)})")
        lines += [f"      {_node(node)}" for node in nodes]
        lines[-1] += ")"
    lines[-1] += "))"
    return "\n".join(lines) + "\n"


def _node(node: Node) -> str:
    function = f" (pinfunction {quoted(node.function)})" if node.function else ""
    return f'(node (ref {quoted(node.ref)}) (pin {quoted(node.pin)}){function} (pintype "passive"))'


@dataclass(frozen=True, slots=True)
class _Line:
    """One line of the bill of materials."""

    quantity: int
    value: str
    order: Order
    footprint: str
    references: tuple[str, ...]


def _bill_of_materials(circuit: Circuit) -> list[_Line]:
    """Every kind of part in the order of its first reference, then what is not on the board."""
    kinds: dict[tuple[str, str], list[str]] = {}
    orders: dict[tuple[str, str], Order] = {}
    stages = {c.number: c.stage for c in circuit.channels}
    resistors = {_resistor_text(r.ohm, r.rating_w): r for stage in stages.values() for r in stage.resistors}
    for part in circuit.components:
        kind = (part.value, part.footprint)
        if part.symbol == "LED":
            stage = stages[int(part.ref[1:])]
            kind = (f"{stage.led.name} LED", part.footprint)
            orders[kind] = led_order(stage.band, stage.led.current_a)
        elif part.value in resistors:
            chosen = resistors[part.value]
            orders[kind] = resistor(chosen.ohm, chosen.rating_w, _ohm_text(chosen.ohm))
        elif part.ref == "F1":
            orders[kind] = fuse(circuit.fuse_a)
        else:
            own = Order("your own", ("", ""), f"as circuit.transistor.*: {part.value}")
            orders[kind] = FIXED.get(part.ref) or FIXED.get(part.value, own)
        kinds.setdefault(kind, []).append(part.ref)
    lines = [_Line(len(refs), kind[0], orders[kind], kind[1], tuple(refs)) for kind, refs in kinds.items()]
    for number, value, order in OFF_BOARD:
        lines.append(_Line(number(len(circuit.channels)), value, order, "not on the board", ()))
    return lines


INK, RAIL, QUIET = "#222222", "#B03A2E", "#555555"
CELL = (270, 300)
"""Width and height of one stage."""
COLUMNS = 5
PARTS_COLUMNS = (
    "quantity",
    "value",
    "part",
    "alternative 1",
    "alternative 2",
    "check before ordering",
    "footprint",
    "references",
)
FILES = (
    "circuit.net",
    "schematic.svg",
    "wiring.svg",
    "parts.csv",
    "board.kicad_pcb",
    "gerber.zip",
    "circuit.json",
    "rig.json",
)


def circuit_to_folder(out: Path, rig: Rig, settings: CircuitSettings) -> dict[str, Any]:
    """Design the LED board of a rig and write its files, the rig's with the pin map; return the facts.

    Raises
    ------
    BadInput
        If the folder holds something else, no board can be made with these settings, or its light would be above a
        limit of :mod:`splitknit.rig.safety`.
    """
    check_target(out, "circuit.net", "an earlier board")
    circuit = design_circuit(rig, settings)
    stages = {channel.stage.band: channel.stage for channel in circuit.channels}
    found = rig_hazards(rig, stages, duty=settings.duty)
    check_hazards(found)
    shorted = rig_hazards(rig, stages, duty=settings.duty, shorted=True)
    pins = {band: [c.gpio for c in circuit.channels if c.stage.band == band] for band in ("white", "nir")}
    pinned = replace(rig, provenance={**rig.provenance, "pins": {band: lines for band, lines in pins.items() if lines}})
    board = lay_out(circuit)
    facts = _facts(circuit, out)
    facts["board"] = {
        "size_mm": list(board.size_mm),
        "holes_mm": [list(hole) for hole in board.holes_mm],
        "vias": len(board.vias),
    }
    facts["safety"] = [
        {
            "leds": hazard.band,
            "hazard": hazard.name,
            "clause": hazard.clause,
            "value": round(hazard.value, 4),
            "limit": round(hazard.limit, 4),
            "unit": hazard.unit,
            "margin": round(hazard.margin, 2),
            "margin_with_a_shorted_transistor": round(failed.margin, 2),
        }
        for hazard, failed in zip(found, shorted, strict=True)
    ]
    with atomic_folder(out) as folder:
        (folder / "circuit.net").write_text(_kicad_netlist(circuit, __version__), encoding="utf-8")
        (folder / "schematic.svg").write_text(_schematic_svg(circuit) + "\n", encoding="utf-8")
        (folder / "wiring.svg").write_text(wiring_svg(board, circuit, rig), encoding="utf-8")
        (folder / "board.kicad_pcb").write_text(kicad_board(board, __version__), encoding="utf-8")
        (folder / "gerber.zip").write_bytes(gerber_zip(board))
        (folder / "parts.csv").write_text(_parts_csv(circuit), encoding="utf-8")
        (folder / "circuit.json").write_text(json_text(facts), encoding="utf-8")
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
        _text(153, y - 24, f"F1 {circuit.fuse_a:g} A", "middle"),
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
        _text(x - 80, base - 12, f"R{100 + n}  {_ohm_text(stage.ohm('base'))}", "middle"),
    ]
    parts += [_line(left + 30, base, x - 104, base), f'<circle cx="{left + 50}" cy="{base}" r="2.5" fill="{INK}"/>']
    parts += _resistor_down(left + 50, base, base + 52, f"R{400 + n}", _ohm_text(stage.ohm("pull_down")))
    parts += [_line(left + 50, base + 52, left + 50, base + 60), _ground(left + 50, base + 60)]
    parts += [
        _text(left + 12, base - 26, f"GPIO {channel.gpio}"),
        _text(left + 12, base - 12, f"J1-{HEADER_OF_GPIO[channel.gpio]}", fill=QUIET),
    ]
    low, middle, high = (1000 * a for a in stage.current_a)
    parts.append(_text(left + 10, top + CELL[1] - 14, f"{middle:.0f} mA ({low:.0f} to {high:.0f})", fill=QUIET))
    return parts


def _value(stage: Stage, role: str) -> str:
    return next(_resistor_text(r.ohm, r.rating_w) for r in stage.resistors if r.role == role)


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


_text = partial(words, size=12)


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
        "fuse_ma": round(1000 * circuit.fuse_a),
        "leds": [{"led": c.name, "gpio": c.gpio, "stage": c.number} for c in circuit.channels],
        "parts": len(circuit.components),
        "nets": len(circuit.nets),
    }


def _parts_csv(circuit: Circuit) -> str:
    rows: list[list[Any]] = [list(PARTS_COLUMNS)]
    for line in _bill_of_materials(circuit):
        order = line.order
        row = [line.quantity, line.value, order.part, *order.alternatives, order.check, line.footprint]
        rows.append([*row, " ".join(line.references)])
    return csv_text(rows)
