"""Components and nets of the whole circuit, and KiCad's netlist of them."""

from __future__ import annotations

import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from splitknit.capture.pins import led_names, pins_of
from splitknit.errors import require
from splitknit.model import Rig
from splitknit.rig.circuit import CircuitSettings, Stage, design_stage

HEADER_OF_GPIO: Mapping[int, int] = {
    2: 3, 3: 5, 4: 7, 5: 29, 6: 31, 7: 26, 8: 24, 9: 21, 10: 19, 11: 23, 12: 32, 13: 33, 14: 8, 15: 10, 16: 36,
    17: 11, 18: 12, 19: 35, 20: 38, 21: 40, 22: 15, 23: 16, 24: 18, 25: 22, 26: 37, 27: 13,
}  # fmt: skip
"""Pin of the Raspberry Pi's 40-pin header for each GPIO line (BCM number)."""
GROUND_PINS = (6, 9, 14, 20, 25, 30, 34, 39)
"""Ground pins of the header."""
FUSE_HOLD_A = 0.16
"""Current that the resettable fuse carries for ever; at twice that, with a few LEDs on together, it opens."""

_RESISTOR_FOOTPRINTS = {
    0.25: "Resistor_THT:R_Axial_DIN0207_L6.3mm_D2.5mm_P10.16mm_Horizontal",
    0.6: "Resistor_THT:R_Axial_DIN0207_L6.3mm_D2.5mm_P10.16mm_Horizontal",
    1.0: "Resistor_THT:R_Axial_DIN0411_L9.9mm_D3.6mm_P15.24mm_Horizontal",
    2.0: "Resistor_THT:R_Axial_DIN0414_L11.9mm_D4.5mm_P15.24mm_Horizontal",
    3.0: "Resistor_THT:R_Axial_DIN0617_L17.0mm_D6.0mm_P20.32mm_Horizontal",
}


@dataclass(frozen=True, slots=True)
class _Component:
    """One part on the board."""

    ref: str
    value: str
    library: str
    symbol: str
    footprint: str


@dataclass(frozen=True, slots=True)
class _Node:
    """One pin on a net."""

    ref: str
    pin: str
    function: str = ""


@dataclass(frozen=True, slots=True)
class Channel:
    """One LED's stage on the board."""

    name: str
    """Of the LED, such as ``white 3``."""
    gpio: int
    stage: Stage
    number: int
    """From 1, in the order of the rig file."""


@dataclass(frozen=True, slots=True)
class Circuit:
    """The whole board."""

    settings: CircuitSettings
    channels: tuple[Channel, ...]
    components: tuple[_Component, ...]
    nets: Mapping[str, tuple[_Node, ...]]


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
    components, nets = _supply(settings)
    for channel in channels:
        _add_stage(channel, settings, components, nets)
    return Circuit(settings, channels, tuple(components), {name: tuple(nodes) for name, nodes in nets.items()})


def _supply(s: CircuitSettings) -> tuple[list[_Component], dict[str, list[_Node]]]:
    """The Pi's header, the LEDs' supply with its fuse, and what stores charge."""
    components = [
        _Component(
            "J1",
            "Raspberry Pi GPIO",
            "Connector_Generic",
            "Conn_02x20_Odd_Even",
            "Connector_PinSocket_2.54mm:PinSocket_2x20_P2.54mm_Vertical",
        ),
        _Component(
            "J2",
            f"{s.supply_v:g} V DC, centre +",
            "Connector",
            "Barrel_Jack",
            "Connector_BarrelJack:BarrelJack_Horizontal",
        ),
        _Component(
            "F1",
            f"{1000 * FUSE_HOLD_A:.0f} mA hold, resettable",
            "Device",
            "Polyfuse",
            "Fuse:Fuse_BelFuse_0ZRE0016FF_L9.9mm_W3.8mm",
        ),
        _Component("D90", "1N5819", "Device", "D_Schottky", "Diode_THT:D_DO-41_SOD81_P10.16mm_Horizontal"),
        _Component("C1", "470 uF 25 V", "Device", "C_Polarized", "Capacitor_THT:CP_Radial_D10.0mm_P5.00mm"),
        _Component("C2", "100 nF", "Device", "C", "Capacitor_THT:C_Disc_D5.0mm_W2.5mm_P5.00mm"),
    ]
    nets = {
        "GND": [
            *(_Node("J1", str(pin), "GND") for pin in GROUND_PINS),
            _Node("J2", "2", "sleeve"),
            _Node("C1", "2", "-"),
            _Node("C2", "2"),
            _Node("D90", "2", "A"),
        ],
        "SUPPLY_IN": [_Node("J2", "1", "tip"), _Node("F1", "1")],
        # a supply the wrong way round is shorted by the diode and trips the fuse
        "V_LED": [_Node("F1", "2"), _Node("D90", "1", "K"), _Node("C1", "1", "+"), _Node("C2", "1")],
    }
    return components, nets


def _add_stage(
    channel: Channel, s: CircuitSettings, components: list[_Component], nets: dict[str, list[_Node]]
) -> None:
    """Add one stage's parts, their references numbered by the channel: R101 ... R104, Q1, D1."""
    n, stage = channel.number, channel.stage
    refs = {role: f"R{100 * (k + 1) + n}" for k, role in enumerate(("base", "emitter", "series", "pull_down"))}
    for resistor in stage.resistors:
        footprint = _RESISTOR_FOOTPRINTS[resistor.rating_w]
        value = f"{ohm_text(resistor.ohm)} {resistor.rating_w:g} W"
        components.append(_Component(refs[resistor.role], value, "Device", "R", footprint))
    components.append(
        _Component(f"Q{n}", s.transistor.name, "Transistor_BJT", "BC337", "Package_TO_SOT_THT:TO-92_Inline")
    )
    led = f"{channel.name} ({stage.led.name})"
    components.append(
        _Component(f"D{n}", led, "Device", "LED", "Connector_PinHeader_2.54mm:PinHeader_1x02_P2.54mm_Vertical")
    )
    line, base = f"GPIO{channel.gpio}", f"BASE{n}"
    require(channel.gpio in HEADER_OF_GPIO, f"GPIO {channel.gpio} is not on the Raspberry Pi's header.")
    nets[line] = [
        _Node("J1", str(HEADER_OF_GPIO[channel.gpio]), line),
        _Node(refs["base"], "1"),
        _Node(refs["pull_down"], "1"),
    ]
    nets["GND"].append(_Node(refs["pull_down"], "2"))
    nets[base] = [_Node(refs["base"], "2"), _Node(f"Q{n}", "2", "B")]
    if stage.ohm("emitter"):
        nets[f"EMITTER{n}"] = [_Node(f"Q{n}", "3", "E"), _Node(refs["emitter"], "1")]
        nets["GND"].append(_Node(refs["emitter"], "2"))
    else:
        nets["GND"].append(_Node(f"Q{n}", "3", "E"))
    nets[f"COLLECTOR{n}"] = [_Node(f"Q{n}", "1", "C"), _Node(f"D{n}", "1", "K")]
    if stage.ohm("series"):
        nets[f"ANODE{n}"] = [_Node(f"D{n}", "2", "A"), _Node(refs["series"], "1")]
        nets["V_LED"].append(_Node(refs["series"], "2"))
    else:
        nets["V_LED"].append(_Node(f"D{n}", "2", "A"))


def ohm_text(ohm: float) -> str:
    """Return a resistance as it is written on a drawing: 27R, 4k7, 100k."""
    for size, letter in ((1e6, "M"), (1e3, "k"), (1.0, "R")):
        if ohm >= size:
            whole, _, part = f"{ohm / size:.3g}".partition(".")
            return f"{whole}{letter}{part}"
    return f"0R{f'{ohm:.2f}'.partition('.')[2]}"


def kicad_netlist(circuit: Circuit, version: str) -> str:
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
            f"    (comp (ref {_quoted(part.ref)})",
            f"      (value {_quoted(part.value)})",
            f"      (footprint {_quoted(part.footprint)})",
            f'      (libsource (lib {_quoted(part.library)}) (part {_quoted(part.symbol)}) (description ""))',
            f"      (tstamps {_quoted(str(stamp))}))",
        ]
    lines.append("  )")
    lines.append("  (nets")
    for code, (name, nodes) in enumerate(circuit.nets.items(), start=1):
        lines.append(f"    (net (code {_quoted(str(code))}) (name {_quoted(name)})")
        lines += [f"      {_node(node)}" for node in nodes]
        lines[-1] += ")"
    lines[-1] += "))"
    return "\n".join(lines) + "\n"


def _node(node: _Node) -> str:
    function = f" (pinfunction {_quoted(node.function)})" if node.function else ""
    return f'(node (ref {_quoted(node.ref)}) (pin {_quoted(node.pin)}){function} (pintype "passive"))'


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def bill_of_materials(circuit: Circuit) -> list[tuple[int, str, str, Sequence[str]]]:
    """Return (quantity, value, footprint, references) of every kind of part, in the order of the first reference."""
    kinds: dict[tuple[str, str], list[str]] = {}
    for part in circuit.components:
        value = (
            part.value
            if not part.ref.startswith("D") or part.symbol != "LED"
            else part.value.partition("(")[2].rstrip(")") + " LED"
        )
        kinds.setdefault((value, part.footprint), []).append(part.ref)
    return [(len(refs), value, footprint, refs) for (value, footprint), refs in kinds.items()]
