"""Design the LED board of a rig: ``python -m hardware.circuit [--dimensions my.toml] [--out
board]``.

The board is laid out once, for the reference rig; its KiCad files, Gerbers and drawings lie in
``files/board`` and get this circuit's values. Writes ``rig.json`` (the rig as drawn, with its pins)
and ``circuit.json`` too.
"""

from __future__ import annotations

import csv
import functools
import html
import io
import json
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from hardware import sizes
from hardware.films import TRANSMISSION, rig_of
from hardware.safety import check_hazards, rig_hazards
from hardware.stages import Channel, Circuit, Resistor, Stage, design_stage
from splitknit.errors import BadInput, require
from splitknit.io.rig import write_rig
from splitknit.model import Rig
from splitknit_rig.capture.pins import (
    DEFAULT_PINS,
    PULLED_UP,
    SECOND_PINS,
    SERVO_PIN,
    WHITE_PINS,
    led_names,
    pins_of,
    rig_films,
)
from splitknit_simulator.light.films import side_lights

BOARD = Path(__file__).parent / "files" / "board"
# the board's files that show values
_TEXTS = ("circuit.net", "schematic.svg", "wiring.svg", "board.kicad_pcb")
_SUPPLY = ("J1", "J2", "F1", "D90", "C1", "C2")
_ROLES = ("base", "emitter", "series", "pull_down")
_MAX_RATING_W = 0.6  # largest rating of the resistors that the board has places for
_LINK = (
    "0R wire",
    "a piece of wire",
    "a leg cut off a resistor",
    "a resistor of 0 ohms",
    "in place of a resistor",
)
_FUSE_AT_50_DEG = 0.7
"""Fraction of its current at 20 degrees that a resettable fuse still carries in a box of 50
degrees."""
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
"""Resettable fuses by the current in ampere that they carry at 20 degrees: Bel, Bourns, Littelfuse,
footprint."""
_STRONG_PULL_DOWN_OHM = 4700.0
"""Against the 33 to 73 kohm that pull some lines up at power-on: 0.4 V at most, where a transistor
needs 0.6 V."""
_LOW_CURRENT_A = 0.03
_LOW_CURRENT_WHITE = (
    "Cree LC513FWH1-60Q-A0",
    "RND 135-00123 (3000 K)",
    "Cree C513A-WSN",
    "5 mm, flange, not diffused, 20 mA, 2.8 to 3.6 V, half angle 30 deg, all of one bin",
)
"""What to order for white LEDs of at most `_LOW_CURRENT_A`: part, two alternatives, what to
check."""


def design_circuit(rig: Rig, settings: SimpleNamespace) -> Circuit:
    """Stages of a rig's white and NIR LEDs on the lines of ``provenance.pins``, or the default
    ones. Raises BadInput if a margin is missed, a line is used twice, or the rig has LEDs of
    another band or distant lights.
    """
    for index, led in enumerate(rig.leds):
        words = (
            f"LED {index} of the rig is of the band '{led.band}'; there are stages for white and"
            " nir."
        )
        require(led.band in ("white", "nir"), words)
    bands = {led.band for led in rig.leds}
    stages = {band: design_stage(band, settings) for band in DEFAULT_PINS if band in bands}
    places = [
        (f"{band} {k}", pin) for band, pins in DEFAULT_PINS.items() for k, pin in enumerate(pins)
    ]
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
        misfits.append(
            f"it has places for resistors of {_MAX_RATING_W:g} W, but {large:g} W are needed"
        )
    fuse_a = _fuse_for(max(stage.current_a[2] for stage in stages.values()))
    return Circuit(settings, channels, fuse_a, " and ".join(misfits))


def _fuse_for(led_a: float) -> float:
    """Return the smallest fuse that carries the current of one LED in a warm box. Raises BadInput
    if there is none."""
    fitting = [hold for hold in _FUSES if _FUSE_AT_50_DEG * hold >= led_a]
    largest = max(_FUSES) * _FUSE_AT_50_DEG
    require(
        len(fitting) > 0,
        f"no resettable fuse of the list carries {1000 * led_a:.0f} mA at 50 degrees; the largest"
        f" carries {1000 * largest:.0f} mA: take a smaller LED current.",
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
    """Three digits and a power of ten, as Vishay codes 1 % resistors: 27 ohms are 2709, 360 are
    3600."""
    power = len(str(int(ohm))) - 3
    digit = power if power >= 0 else {-1: 9, -2: 8}[power]
    return f"{round(ohm / 10.0**power):03d}{digit}"


def _values(circuit: Circuit) -> dict[str, str]:
    """Value of every part but the supply's by its reference: R101 to R401 are the first stage's, in
    `_ROLES`."""
    values = {"F1": f"{1000 * circuit.fuse_a:.0f} mA hold, resettable"}
    for channel in circuit.channels:
        n, stage = channel.number, channel.stage
        texts = {r.role: _resistor_text(r) for r in stage.resistors}
        values |= {
            f"R{100 * k + n}": texts.get(role, _LINK[0]) for k, role in enumerate(_ROLES, start=1)
        }
        values |= {f"Q{n}": circuit.settings.transistor.name, f"D{n}": f"{stage.led.name} LED"}
    return values


def _resistor_text(part: Resistor) -> str:
    return f"{_ohm_text(part.ohm)} {part.rating_w:g} W"


def _orders(circuit: Circuit) -> dict[str, tuple[str, ...]]:
    """By value: part, two alternatives, what to check before ordering; for parts that the nominal
    board has not."""
    orders: dict[str, tuple[str, ...]] = {_LINK[0]: _LINK[1:]}
    for channel in circuit.channels:
        # of the size 0207: those of 0.6 W fit where 0.25 W would do
        for part in channel.stage.resistors:
            text = _ohm_text(part.ohm)
            code = _maker_code(part.ohm)
            check = (
                f"{text}, 1 %, {part.rating_w:g} W or more, body not longer than the footprint's"
            )
            others = f"TE LR1F{text.upper()}", f"Yageo MF0207FTE52-{text.upper()}"
            orders[_resistor_text(part)] = (f"Vishay MRS25000C{code}FCT00", *others, check)
        if channel.stage.band == "white" and channel.stage.led.current_a <= _LOW_CURRENT_A:
            orders[f"{channel.stage.led.name} LED"] = _LOW_CURRENT_WHITE
    transistor = circuit.settings.transistor.name
    if transistor != "BC337-40":
        orders[transistor] = ("your own", "", "", f"as circuit.transistor.*: {transistor}")
    return orders


def _bill_of_materials(circuit: Circuit) -> list[list[str]]:
    """Rows of ``parts.csv``: the nominal board's, with this circuit's values and for its number of
    LEDs."""
    with (BOARD / "parts.csv").open(encoding="utf-8", newline="") as file:
        header, *nominal = csv.reader(file)
    rows = {ref: row for row in nominal for ref in row[-1].split()}
    bel, bourns, littelfuse, footprint = _FUSES[circuit.fuse_a]
    hold = (
        f"holds {1000 * circuit.fuse_a:.0f} mA at 20 degrees, trips at twice that, 16 V or more,"
        " leads 5.1 mm apart"
    )
    rows["F1"] = [
        "",
        "",
        f"Bel Fuse {bel}",
        f"Bourns {bourns}",
        f"Littelfuse {littelfuse}",
        hold,
        footprint,
        "F1",
    ]
    orders = _orders(circuit)
    values = _values(circuit)
    lines: dict[tuple[str, ...], list[str]] = {}
    for ref in [*_SUPPLY, *(ref for ref in values if ref not in _SUPPLY)]:
        value = values.get(ref, rows[ref][1])
        lines.setdefault((value, *orders.get(value, rows[ref][2:6]), rows[ref][6]), []).append(ref)
    table = [[str(len(refs)), *line, " ".join(refs)] for line, refs in lines.items()]
    loose = [row for row in nominal if not row[-1]]  # not on the board
    table += [[row[0] if row[0] == "1" else str(len(circuit.channels)), *row[1:]] for row in loose]
    return [header, *table]


def _with_values(text: str, circuit: Circuit) -> str:
    """Give a file of the nominal board this circuit's values; where one is shown without its
    rating, it stays so."""
    svg = text.startswith("<svg")
    for ref, value in _values(circuit).items():
        safe = html.escape(value) if svg else value.replace("\\", "\\\\").replace('"', '\\"')
        place = re.compile(
            rf'("{ref}"[^\n]*\n\s*\((?:fp_text )?value "|>{ref}'
            rf' +|>{ref}</text>\n<text[^>]*>)([^"<]+)'
        )
        if ref[0] != "D":  # the header of an LED bears its name
            for before, printed in set(place.findall(text)):
                new = safe.split()[0] if ref[0] == "R" and " " not in printed else safe
                text = text.replace(before + printed, before + new)
    for channel in circuit.channels:
        low, middle, high = (1000 * a for a in channel.stage.current_a)
        current = rf"\g<1>{middle:.0f} mA ({low:.0f} to {high:.0f})"
        text = re.sub(rf"(>D{channel.number}: .*?>)\d+ mA \([^<]*", current, text, flags=re.DOTALL)
    return re.sub(r"\b9 V\b", f"{circuit.settings.supply_v:g} V", text)


def _second_board(rig: Rig, apart: Sequence[int], settings: SimpleNamespace) -> Circuit:
    """The circuit of the crossed series' LEDs or the side lights: white stages on lines of their
    own. Side lights get the current that their intensity asks for; a line pulled up at power-on
    gets a stronger pull-down.
    """
    white = [k for k, led in enumerate(rig.leds) if led.band == "white"]
    pins = pins_of(rig)
    if side_lights(rig.leds) == apart:
        own, others = (
            np.mean([rig.leds[k].intensity for k in white if (k in apart) == it])
            for it in (True, False)
        )
        names, part = ("current_a", "intensity_cd", "intensity_w_sr"), settings.white
        less = {name: getattr(part, name) * min(1.0, float(own / others)) for name in names}
        settings = SimpleNamespace(
            **{**vars(settings), "white": SimpleNamespace(**{**vars(part), **less})}
        )
    circuit = design_circuit(Rig(rig.camera, tuple(rig.leds[k] for k in apart)), settings)
    channels = []
    for channel, led in zip(circuit.channels, apart, strict=True):
        low = [
            replace(r, ohm=_STRONG_PULL_DOWN_OHM) if r.role == "pull_down" else r
            for r in channel.stage.resistors
        ]
        stage = (
            replace(channel.stage, resistors=tuple(low))
            if pins[led] in PULLED_UP
            else channel.stage
        )
        channels.append(replace(channel, name=led_names(rig)[led], gpio=pins[led], stage=stage))
    return replace(circuit, channels=tuple(channels))


def write_circuit(out: Path, s: SimpleNamespace) -> dict[str, Any]:
    """Design the circuit of a rig's LEDs, write the board's files and the rig's with its pins;
    return the facts.

    A circuit that the laid-out board cannot carry is written without the board's files;
    ``facts["board"]`` says why. Films get rows in ``parts.csv`` and, on the default lines,
    ``films.svg``; LEDs of the crossed series, or side lights, a second board. BadInput if no stage
    can be made of these parts, or its light would be above a limit.
    """
    rig = rig_of(s)
    settings = s.circuit
    films = rig_films(rig)
    side = side_lights(rig.leds)
    apart = films.crossed if films is not None and films.kind == "neighbours" else side
    last = [k for k, led in enumerate(rig.leds) if led.band == "white"][-len(side) :]
    require(
        apart != side or not side or list(side) == last,
        "LEDs at the side must be the last white ones of the rig file: they hang on the second"
        " board.",
    )
    first = replace(rig, leds=tuple(led for k, led in enumerate(rig.leds) if k not in apart))
    circuit = design_circuit(first, settings)
    second = _second_board(rig, apart, settings) if apart else None
    stages = {channel.stage.band: channel.stage for channel in circuit.channels}
    if second is not None and side:
        stages["side"] = second.channels[0].stage
    channels = [*circuit.channels, *(second.channels if second is not None else ())]
    pins = {band: [c.gpio for c in channels if c.stage.band == band] for band in DEFAULT_PINS}
    facts = _facts(circuit, second, stages)
    facts["safety"] = _safety(rig, stages, settings.duty, 1.0 if films is None else TRANSMISSION)
    texts: dict[str, str] = {}
    if not circuit.misfit:
        texts = {
            name: _with_values((BOARD / name).read_text(encoding="utf-8"), circuit)
            for name in _TEXTS
        }
        rows = _bill_of_materials(circuit)
        if films is not None:
            lines = csv.reader((BOARD / "films.csv").read_text(encoding="utf-8").splitlines())
            rows += [row for row in lines if row[1] != "servo" or films.kind == "servo"]
            # sheets of film
            rows[len(rows) - 1 - (films.kind == "servo")][0] = "2" if side else "1"
        for row in _bill_of_materials(second)[1:] if second is not None else []:
            if row[-1] or row[0] != "1":  # cable and adapter serve both boards
                rows.append([*row[:-1], f"second board: {row[-1]}" if row[-1] else ""])
        table = io.StringIO()
        csv.writer(table, lineterminator="\n").writerows(rows)
        texts["parts.csv"] = _with_values(table.getvalue(), circuit)
    if films is not None:
        facts["films"] = {"transmission": TRANSMISSION, **rig.provenance["films"]}
        if films.servo == SERVO_PIN and (
            films.kind != "neighbours" or pins["white"] == [*WHITE_PINS, *SECOND_PINS]
        ):
            texts["films.svg"] = _with_values(
                (BOARD / f"films-{films.kind}.svg").read_text(encoding="utf-8"), circuit
            )
    out.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        (out / name).write_text(text, encoding="utf-8")
    if not circuit.misfit:
        (out / "gerber.zip").write_bytes((BOARD / "gerber.zip").read_bytes())
    write_rig(replace(rig, provenance={**rig.provenance, "pins": pins}), out / "rig.json")
    (out / "circuit.json").write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")
    return facts


def _safety(
    rig: Rig, stages: Mapping[str, Stage], duty: float, passed: float
) -> list[dict[str, Any]]:
    """Light on eye and skin, and its margins: with a shorted transistor, and without films."""
    hazards_of = functools.partial(rig_hazards, rig, stages, duty=duty)
    filmed = hazards_of(passed=passed)
    shorted = hazards_of(passed=passed, shorted=True)
    bare = hazards_of()
    check_hazards(filmed)
    return [
        {
            "leds": hazard.band,
            "hazard": hazard.name,
            "clause": hazard.clause,
            "value": round(hazard.value, 4),
            "limit": round(hazard.limit, 4),
            "unit": hazard.unit,
            "margin": round(hazard.margin, 2),
            "margin_with_a_shorted_transistor": round(failed.margin, 2),
            "margin_without_films": round(unfilmed.margin, 2),
        }
        for hazard, failed, unfilmed in zip(filmed, shorted, bare, strict=True)
    ]


def _facts(circuit: Circuit, second: Circuit | None, stages: Mapping[str, Stage]) -> dict[str, Any]:
    return {
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
        "leds": [
            {"led": c.name, "gpio": c.gpio, "stage": c.number, "board": number}
            for number, board in enumerate((circuit, second), start=1)
            for c in (board.channels if board is not None else ())
        ],
        "board": circuit.misfit or "laid out",
    }


def main() -> None:
    """Design what the command line asks for."""
    options = sizes.arguments(__doc__ or "", "board")
    s = sizes.read_dimensions(options.dimensions)
    facts = write_circuit(options.out, s)
    print(
        f"{len(facts['leds'])} stages ({s.circuit.topology}, {s.circuit.supply_v:g} V), fuse"
        f" {facts['fuse_ma']} mA:"
    )
    for band, stage in facts["stages"].items():
        low, middle, high = stage["current_ma"]
        values = ", ".join(
            f"{role} {r['ohm']:g} ohm {r['rating_w']:g} W" for role, r in stage["resistors"].items()
        )
        print(
            f"  {band:5s} {middle:.0f} mA ({low:.0f} to {high:.0f} over all tolerances): {values}"
        )
    if facts["board"] != "laid out":
        print(
            f"The LED board is left out: {facts['board']}; lay out your own with the values of"
            " circuit.json."
        )
    print(
        "Light on eye and skin, all LEDs on, against the exempt group of IEC 62471 (calculated, no"
        " certificate):"
    )
    for hazard in facts["safety"]:
        bare = f", {hazard['margin_without_films']:.3g} without films" if "films" in facts else ""
        print(
            f"  {hazard['leds']:5s} {hazard['hazard']:26s} {hazard['value']:9.4g} of"
            f" {hazard['limit']:.4g} {hazard['unit']}, margin {hazard['margin']:.3g}"
            f" ({hazard['margin_with_a_shorted_transistor']:.3g} with a shorted transistor{bare})"
        )
    print(f"Written to {options.out}; its rig.json holds the pins.")


if __name__ == "__main__":
    try:
        main()
    except BadInput as error:
        sys.exit(str(error))
