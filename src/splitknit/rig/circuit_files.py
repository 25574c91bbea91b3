"""The LED board's circuit for a rig, and its folder of files: the laid-out board with this circuit's values, parts.

The board is laid out once, for the nominal rig; its KiCad files, Gerbers and drawings lie in ``board/``.
"""

from __future__ import annotations

import csv
import html
import re
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from splitknit.capture.pins import (
    CROSSED_PINS,
    DEFAULT_PINS,
    PULLED_UP,
    SERVO_PIN,
    WHITE_PINS,
    RigFilms,
    led_names,
    pins_of,
    rig_films,
)
from splitknit.errors import require
from splitknit.io.atomic import atomic_folder
from splitknit.io.csv_table import csv_text
from splitknit.io.provenance import json_text
from splitknit.io.rig import write_rig
from splitknit.io.targets import check_target
from splitknit.model import Rig
from splitknit.rig.circuit import BC337, Channel, Circuit, CircuitSettings, Resistor, design_stage
from splitknit.rig.films import TRANSMISSION
from splitknit.rig.safety import check_hazards, rig_hazards

_BOARD = Path(__file__).with_name("board")
_TEXTS = ("circuit.net", "schematic.svg", "wiring.svg", "board.kicad_pcb")
"""The board's files that show values."""
FILES = (*_TEXTS[:3], "parts.csv", "board.kicad_pcb", "gerber.zip", "circuit.json", "rig.json")
_ALWAYS = FILES[-2:]
"""Files of a circuit that the board cannot carry."""
_LAYOUT = {"size_mm": [90.0, 70.0], "holes_mm": [[3.0, 3.0], [87.0, 3.0], [3.0, 67.0], [87.0, 67.0]], "vias": 9}
_SUPPLY = ("J1", "J2", "F1", "D90", "C1", "C2")
_ROLES = ("base", "emitter", "series", "pull_down")
_MAX_RATING_W = 0.6
"""Of the resistors that the board has places for."""
_LINK = ("0R wire", "a piece of wire", "a leg cut off a resistor", "a resistor of 0 ohms", "in place of a resistor")
_FUSE_AT_50_DEG = 0.7
"""Fraction of its current at 20 degrees that a resettable fuse still carries in a box of 50 degrees."""
_FUSES: Mapping[float, tuple[str, str, str, str]] = {
    0.05: ("0ZRE0005FF", "MF-R005", "RXEF005", "Fuse:Fuse_BelFuse_0ZRE0005FF_L8.3mm_W3.8mm"),
    0.08: ("0ZRE0008FF", "MF-R010", "RXEF010", "Fuse:Fuse_BelFuse_0ZRE0008FF_L8.3mm_W3.8mm"),
    0.12: ("0ZRE0012FF", "MF-R017", "RXEF017", "Fuse:Fuse_BelFuse_0ZRE0012FF_L8.3mm_W3.8mm"),
    0.16: ("0ZRE0016FF", "MF-R017", "RXEF017", "Fuse:Fuse_BelFuse_0ZRE0016FF_L9.9mm_W3.8mm"),
    0.25: ("0ZRE0025FF", "MF-R025", "RXEF025", "Fuse:Fuse_BelFuse_0ZRE0025FF_L9.6mm_W3.8mm"),
    0.33: ("0ZRE0033FF", "MF-R040", "RXEF040", "Fuse:Fuse_BelFuse_0ZRE0033FF_L11.4mm_W3.8mm"),
    0.40: ("0ZRE0040FF", "MF-R040", "RXEF040", "Fuse:Fuse_BelFuse_0ZRE0040FF_L11.5mm_W3.8mm"),
    0.55: ("0ZRE0055FF", "MF-R065", "RXEF065", "Fuse:Fuse_BelFuse_0ZRE0055FF_L14.0mm_W4.1mm"),
}
"""Resettable fuses by the current in ampere that they carry for ever at 20 degrees: Bel, Bourns, Littelfuse, footprint.
"""
_FIRM_OHM = 4700.0
"""Against the 33 to 73 kohm that pull some lines up at power-on: 0.4 V at most, where a transistor needs 0.6 V."""
_WEAK_A = 0.03
_WEAK_WHITE = (
    "Cree LC513FWH1-60Q-A0",
    "RND 135-00123 (3000 K)",
    "Cree C513A-WSN",
    "5 mm, flange, not diffused, 20 mA, 2.8 to 3.6 V, half angle 30 deg, all of one bin",
)
"""What to order for white LEDs of at most `_WEAK_A`: part, two alternatives, what to check."""


def design_circuit(rig: Rig, settings: CircuitSettings | None = None) -> Circuit:
    """Design the stages of a rig's white and NIR LEDs; GPIO lines from its ``provenance.pins``, or the default ones.
    Raises BadInput if a margin is missed, a line is used twice, or the rig has LEDs of another band or distant lights.
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
    places = [(f"{band} {k}", pin) for band, pins in DEFAULT_PINS.items() for k, pin in enumerate(pins)]
    named = [*zip(led_names(rig), pins_of(rig), strict=True)]
    strays = [f"the LED {name} on GPIO {pin}" for name, pin in named if (name, pin) not in places]
    channels = tuple(
        Channel(name, pin, stages[led.band], k if strays else places.index((name, pin)) + 1)
        for k, ((name, pin), led) in enumerate(zip(named, rig.leds, strict=True), start=1)
    )
    large = max(r.rating_w for stage in stages.values() for r in stage.resistors)
    misfits = [f"it has no place for {strays[0]}"] if strays else []
    if settings.topology != "sink":
        misfits.append(f"it is laid out for the topology sink, not {settings.topology}")
    if large > _MAX_RATING_W:
        misfits.append(f"it has places for resistors of {_MAX_RATING_W:g} W, but {large:g} W are needed")
    fuse_a = _fuse_for(max(stage.current_a[2] for stage in stages.values()))
    return Circuit(settings, channels, fuse_a, " and ".join(misfits))


def _fuse_for(led_a: float) -> float:
    """Return the smallest fuse that carries the current of one LED in a warm box. Raises BadInput if there is none."""
    fitting = [hold for hold in _FUSES if _FUSE_AT_50_DEG * hold >= led_a]
    largest = max(_FUSES) * _FUSE_AT_50_DEG
    require(
        len(fitting) > 0,
        f"no resettable fuse of the list carries {1000 * led_a:.0f} mA at 50 degrees; the largest carries "
        f"{1000 * largest:.0f} mA: take a smaller LED current.",
    )
    return min(fitting)


def _ohm_text(ohm: float) -> str:
    """Return a resistance as it is written on a drawing: 27R, 4k7, 100k."""
    for size, letter in ((1e6, "M"), (1e3, "k"), (1.0, "R")):
        if ohm >= size:
            whole, _, part = f"{ohm / size:.3g}".partition(".")
            return f"{whole}{letter}{part}"
    return f"0R{f'{ohm:.2f}'.partition('.')[2]}"


def _maker_code(ohm: float) -> str:
    """Three digits and a power of ten, as Vishay codes 1 % resistors: 27 ohms are 2709, 360 are 3600.

    >>> _maker_code(27.0), _maker_code(360.0), _maker_code(100_000.0)
    ('2709', '3600', '1003')
    """
    power = len(str(int(ohm))) - 3
    digit = power if power >= 0 else {-1: 9, -2: 8}[power]
    return f"{round(ohm / 10.0**power):03d}{digit}"


def _values(circuit: Circuit) -> dict[str, str]:
    """Value of every part by its reference, in the order of the parts list, without the supply's: R101, R201, R301 and
    R401 are the first stage's base, emitter and series resistors and its pull-down.
    """
    values = {"F1": f"{1000 * circuit.fuse_a:.0f} mA hold, resettable"}
    for channel in circuit.channels:
        n, stage = channel.number, channel.stage
        texts = {r.role: _resistor_text(r) for r in stage.resistors}
        values |= {f"R{100 * k + n}": texts.get(role, _LINK[0]) for k, role in enumerate(_ROLES, start=1)}
        values |= {f"Q{n}": circuit.settings.transistor.name, f"D{n}": f"{stage.led.name} LED"}
    return values


def _resistor_text(part: Resistor) -> str:
    return f"{_ohm_text(part.ohm)} {part.rating_w:g} W"


def _orders(circuit: Circuit) -> dict[str, tuple[str, ...]]:
    """By value: part, two alternatives, what to check before ordering; for parts that the nominal board has not."""
    orders: dict[str, tuple[str, ...]] = {_LINK[0]: _LINK[1:]}
    for channel in circuit.channels:
        for part in channel.stage.resistors:  # of the size 0207: those of 0.6 W fit where 0.25 W would do
            text, code = _ohm_text(part.ohm), _maker_code(part.ohm)
            check = f"{text}, 1 %, {part.rating_w:g} W or more, body not longer than the footprint's"
            others = f"TE LR1F{text.upper()}", f"Yageo MF0207FTE52-{text.upper()}"
            orders[_resistor_text(part)] = (f"Vishay MRS25000C{code}FCT00", *others, check)
        if channel.stage.band == "white" and channel.stage.led.current_a <= _WEAK_A:
            orders[f"{channel.stage.led.name} LED"] = _WEAK_WHITE
    transistor = circuit.settings.transistor.name
    if transistor != BC337.name:
        orders[transistor] = ("your own", "", "", f"as circuit.transistor.*: {transistor}")
    return orders


def _bill_of_materials(circuit: Circuit) -> list[list[str]]:
    """Rows of ``parts.csv``: the nominal board's, with this circuit's values and for its number of LEDs."""
    with (_BOARD / "parts.csv").open(encoding="utf-8", newline="") as file:
        header, *nominal = csv.reader(file)
    rows = {ref: row for row in nominal for ref in row[-1].split()}
    fuse, footprint = _FUSES[circuit.fuse_a][:3], _FUSES[circuit.fuse_a][3]
    hold = f"holds {1000 * circuit.fuse_a:.0f} mA at 20 degrees, trips at twice that, 16 V or more, leads 5.1 mm apart"
    makers = ("Bel Fuse", "Bourns", "Littelfuse")
    rows["F1"] = ["", "", *(" ".join(pair) for pair in zip(makers, fuse, strict=True)), hold, footprint, "F1"]
    orders, values = _orders(circuit), _values(circuit)
    lines: dict[tuple[str, ...], list[str]] = {}
    for ref in [*_SUPPLY, *(ref for ref in values if ref not in _SUPPLY)]:
        value = values.get(ref, rows[ref][1])
        lines.setdefault((value, *orders.get(value, rows[ref][2:6]), rows[ref][6]), []).append(ref)
    table = [[str(len(refs)), *line, " ".join(refs)] for line, refs in lines.items()]
    for row in nominal:
        if not row[-1]:  # not on the board
            table.append([row[0] if row[0] == "1" else str(len(circuit.channels)), *row[1:]])
    return [header, *table]


def _with_values(text: str, circuit: Circuit) -> str:
    """Give a file of the nominal board this circuit's values; where one is shown without its rating, it stays so."""
    svg = text.startswith("<svg")
    for ref, value in _values(circuit).items():
        safe = html.escape(value) if svg else value.replace("\\", "\\\\").replace('"', '\\"')
        place = re.compile(rf'("{ref}"[^\n]*\n\s*\((?:fp_text )?value "|>{ref} +|>{ref}</text>\n<text[^>]*>)([^"<]+)')
        if ref[0] != "D":  # the header of an LED bears its name
            for before, shown in set(place.findall(text)):
                text = text.replace(
                    before + shown, before + (safe.split()[0] if ref[0] == "R" and " " not in shown else safe)
                )
    for channel in circuit.channels:
        low, middle, high = (1000 * a for a in channel.stage.current_a)
        current = rf"\g<1>{middle:.0f} mA ({low:.0f} to {high:.0f})"
        text = re.sub(rf"(>D{channel.number}: .*?>)\d+ mA \([^<]*", current, text, flags=re.DOTALL)
    return re.sub(r"\b9 V\b", f"{circuit.settings.supply_v:g} V", text)


def _second_board(rig: Rig, films: RigFilms, settings: CircuitSettings) -> Circuit:
    """The circuit of the LEDs of the crossed series: the white stages of another LED board, on lines of their own. A
    line that is pulled up at power-on gets a stronger pull-down, so that its LED stays dark while the Pi boots.
    """
    circuit = design_circuit(Rig(rig.camera, tuple(rig.leds[k] for k in films.crossed)), settings)
    pins = pins_of(rig)
    channels = []
    for channel, led in zip(circuit.channels, films.crossed, strict=True):
        low = [replace(r, ohm=_FIRM_OHM) if r.role == "pull_down" else r for r in channel.stage.resistors]
        stage = replace(channel.stage, resistors=tuple(low)) if pins[led] in PULLED_UP else channel.stage
        channels.append(replace(channel, name=led_names(rig)[led], gpio=pins[led], stage=stage))
    return replace(circuit, channels=tuple(channels))


def circuit_to_folder(out: Path, rig: Rig, settings: CircuitSettings) -> dict[str, Any]:
    """Design the circuit of a rig's LEDs and write the board's files, the rig's with the pin map; return the facts.

    A circuit that the laid-out board cannot carry is written without the board's files; ``facts["board"]`` says why. A
    rig with films gets rows for them in ``parts.csv`` and, on the default lines, ``films.svg``; LEDs of the crossed
    series get a second board. Raises BadInput if the folder holds something else, no stage can be made with these
    settings, or its light would be above a limit of :mod:`splitknit.rig.safety`.
    """
    check_target(out, "circuit.json", "an earlier board")
    films, second = rig_films(rig), None
    apart = films.crossed if films is not None and films.kind == "neighbours" else ()
    circuit = design_circuit(
        replace(rig, leds=tuple(led for k, led in enumerate(rig.leds) if k not in apart)), settings
    )
    stages = {channel.stage.band: channel.stage for channel in circuit.channels}
    passed = 1.0 if films is None else TRANSMISSION
    found = rig_hazards(rig, stages, duty=settings.duty, passed=passed)
    check_hazards(found)
    shorted = rig_hazards(rig, stages, duty=settings.duty, shorted=True, passed=passed)
    bare = rig_hazards(rig, stages, duty=settings.duty)
    channels = list(circuit.channels)
    if films is not None and apart:
        second = _second_board(rig, films, settings)
        channels += second.channels
    pins = {band: [c.gpio for c in channels if c.stage.band == band] for band in stages}
    pinned = replace(rig, provenance={**rig.provenance, "pins": pins})
    texts: dict[str, str] = {}
    if not circuit.misfit:
        texts = {name: _with_values((_BOARD / name).read_text(encoding="utf-8"), circuit) for name in _TEXTS}
        rows = _bill_of_materials(circuit)
        if films is not None:
            lines = csv.reader((_BOARD / "films.csv").read_text(encoding="utf-8").splitlines())
            rows += [row for row in lines if row[1] != "servo" or films.kind == "servo"]
        for row in _bill_of_materials(second)[1:] if second is not None else []:
            if row[-1] or row[0] != "1":  # cable and adapter serve both boards
                rows.append([*row[:-1], f"second board: {row[-1]}" if row[-1] else ""])
        texts["parts.csv"] = _with_values(csv_text(rows), circuit)
    facts = _facts(circuit, out, [name for name in FILES if name in _ALWAYS or not circuit.misfit])
    if films is not None:
        if films.servo == SERVO_PIN and (second is None or pins["white"] == [*WHITE_PINS, *CROSSED_PINS]):
            texts["films.svg"] = _with_values((_BOARD / f"films-{films.kind}.svg").read_text(encoding="utf-8"), circuit)
            facts["files"].append("films.svg")
        facts["films"] = {"transmission": TRANSMISSION, **rig.provenance["films"]}
    if second is not None:
        facts["leds"] += [{"led": c.name, "gpio": c.gpio, "stage": c.number, "board": 2} for c in second.channels]
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
            **({} if films is None else {"margin_without_films": round(unfilmed.margin, 2)}),
        }
        for hazard, failed, unfilmed in zip(found, shorted, bare, strict=True)
    ]
    with atomic_folder(out) as folder:
        for name, text in texts.items():
            (folder / name).write_text(text, encoding="utf-8")
        if not circuit.misfit:
            (folder / "gerber.zip").write_bytes((_BOARD / "gerber.zip").read_bytes())
        (folder / "circuit.json").write_text(json_text(facts), encoding="utf-8")
        write_rig(pinned, folder / "rig.json")
    return facts


def _facts(circuit: Circuit, out: Path, files: list[str]) -> dict[str, Any]:
    stages = {channel.stage.band: channel.stage for channel in circuit.channels}
    return {
        "out": str(out),
        "files": files,
        "settings": asdict(circuit.settings),
        "stages": {
            band: {
                "resistors": {
                    r.role: {"ohm": r.ohm, "rating_w": r.rating_w, "heat_w": round(r.heat_w, 4)}
                    for r in stage.resistors
                },
                "current_ma": [round(1000 * a, 2) for a in stage.current_a],
                "gpio_ma": round(1000 * stage.gpio_a, 3),
                "gpio_without_supply_ma": round(1000 * stage.gpio_fault_a, 3),
                "transistor_w": round(stage.transistor_w, 3),
            }
            for band, stage in sorted(stages.items(), reverse=True)
        },
        "fuse_ma": round(1000 * circuit.fuse_a),
        "leds": [{"led": c.name, "gpio": c.gpio, "stage": c.number} for c in circuit.channels],
        "parts": circuit.parts,
        "nets": 3 + sum(len(channel.stage.resistors) + 1 for channel in circuit.channels),
        "board": {"misfit": circuit.misfit} if circuit.misfit else _LAYOUT,
    }
