"""The LED board: values, margins at the corners against an independent solution of the circuit, netlist, pin map."""

from __future__ import annotations

import csv
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

from splitknit.errors import BadInput
from splitknit.io.rig import read_rig
from splitknit.model import Led, default_rig
from splitknit_rig.capture.pins import DEFAULT_PINS, SECOND_PINS, pins_of, rig_films
from splitknit_rig.rig.circuit import (
    BC337,
    E24,
    GPIO_HIGH_V,
    GPIO_LIMIT_A,
    NIR_LED,
    RATINGS_W,
    WHITE_LED,
    Circuit,
    CircuitSettings,
    Stage,
    _preferred,
    _rating_for,
    design_stage,
)
from splitknit_rig.rig.circuit_files import (
    _BOARD,
    FILES,
    _bill_of_materials,
    _fuse_for,
    _ohm_text,
    circuit_to_folder,
    design_circuit,
)
from splitknit_rig.rig.films import with_films


@pytest.fixture(scope="module")
def board() -> Circuit:
    return design_circuit(default_rig())


def solved(
    stage: Stage, *, high_v: float, supply_v: float, forward_v: float, base_v: float, gain: float
) -> tuple[float, float]:
    """LED and base current by the transistor's exponential law (Ebers and Moll): no shortcuts of the design."""
    thermal, back = 0.026, 4.0
    saturation = 0.1 / math.exp(base_v / thermal)  # base_v at 100 mA
    ohm = {resistor.role: resistor.ohm for resistor in stage.resistors}
    base, emitter, series = ohm["base"], ohm.get("emitter", 0.0), max(ohm.get("series", 0.0), 1e-3)

    def currents(of_base: float, of_collector: float) -> tuple[float, float]:
        """Into collector and base at voltages over the emitter."""
        forward = saturation * math.expm1(min(of_base / thermal, 60.0))
        reverse = saturation * math.expm1(min((of_base - of_collector) / thermal, 60.0))
        return forward - reverse * (1 + 1 / back), forward / gain + reverse / back

    def collector(of_base: float, at_emitter: float) -> float:
        """Voltage over the emitter at which LED and transistor carry the same current."""
        top = supply_v - forward_v - at_emitter
        return float(brentq(lambda v: (top - v) / series - currents(of_base, v)[0], -60.0, 60.0, xtol=1e-12))

    def emitter_of(of_base: float) -> float:
        """Voltage over the emitter resistor."""
        if emitter == 0.0:
            return 0.0

        def lacking(v: float) -> float:
            return sum(currents(of_base, collector(of_base, v))) - v / emitter

        return float(brentq(lacking, 0.0, 50.0, xtol=1e-12))

    def too_much(of_base: float) -> float:
        at_emitter = emitter_of(of_base)
        into_base = currents(of_base, collector(of_base, at_emitter))[1]
        return into_base - (high_v - at_emitter - of_base) / base

    of_base = float(brentq(too_much, 0.3, base_v + 0.05, xtol=1e-12))
    at_emitter = emitter_of(of_base)
    of_collector = collector(of_base, at_emitter)
    return (supply_v - forward_v - at_emitter - of_collector) / series, (high_v - at_emitter - of_base) / base


@pytest.mark.parametrize("band", ["white", "nir"])
@pytest.mark.parametrize("topology", ["sink", "switch"])
def test_currents_are_those_of_the_solved_circuit(band: str, topology: str) -> None:
    settings = CircuitSettings(topology=topology)
    stage = design_stage(band, settings)
    forward = stage.led.forward_v
    middle, into_base = solved(stage, high_v=3.275, supply_v=9.0, forward_v=forward, base_v=0.755, gain=440.0)
    assert middle == pytest.approx(stage.current_a[1], rel=0.03)
    assert into_base <= stage.gpio_a
    rng = np.random.default_rng(0)
    for _ in range(40):  # any board that can be built lies within the stated corners
        t = settings.transistor
        current, into_base = solved(
            stage,
            high_v=rng.uniform(*GPIO_HIGH_V),
            supply_v=9.0 * rng.uniform(0.95, 1.05),
            forward_v=forward + rng.uniform(-1, 1) * stage.led.spread_v,
            base_v=rng.uniform(*t.base_v),
            gain=rng.uniform(*t.gain),
        )
        assert 0.98 * stage.current_a[0] <= current <= 1.02 * stage.current_a[2]
        assert into_base <= stage.gpio_a


def test_a_sink_does_not_care_for_the_supply_and_a_switch_does() -> None:
    def change(topology: str) -> float:
        stage = design_stage("white", CircuitSettings(topology=topology))
        low, high = (
            solved(stage, high_v=3.3, supply_v=v, forward_v=4.0, base_v=0.75, gain=400.0)[0] for v in (8.7, 9.3)
        )
        return high / low - 1

    assert change("sink") < 0.01
    assert change("switch") > 0.10


def test_margins_are_kept() -> None:
    for band in ("white", "nir"):
        for topology in ("sink", "switch"):
            settings = CircuitSettings(topology=topology)
            stage = design_stage(band, settings)
            assert stage.current_a[0] >= 0.7 * stage.led.current_a
            assert stage.current_a[2] <= stage.led.limit_a
            assert stage.transistor_w <= 0.6 * settings.transistor.limit_w
            assert max(stage.gpio_a, stage.gpio_fault_a) <= GPIO_LIMIT_A
            for r in stage.resistors:
                assert r.heat_w <= 0.6 * r.rating_w
                assert r.rating_w in RATINGS_W
                assert any(math.isclose(r.ohm / 10 ** math.floor(math.log10(r.ohm)), v, rel_tol=1e-6) for v in E24)


@pytest.mark.parametrize(
    ("band", "changes", "words"),
    [
        ("white", {"supply_v": 5.0}, r"5 V are too little for the white LEDs.*circuit\.supply_v to 7\.4"),
        ("white", {"supply_v": 5.0, "topology": "switch"}, "up to 141 mA through an LED of 120 mA"),
        ("white", {"supply_v": 3.6, "topology": "switch"}, "too little for the white LEDs of 3.4 V"),
        ("nir", {"supply_v": 14.0}, "heat its transistor"),
        ("nir", {"transistor": replace(BC337, gain=(20.0, 40.0)), "topology": "switch"}, "gain of at least 40"),
        ("nir", {"transistor": replace(BC337, limit_a=0.15)}, "transistor for at least"),
        ("blue", {}, "white and nir"),
    ],
)
def test_missed_margins_are_named(band: str, changes: dict[str, object], words: str) -> None:
    with pytest.raises(BadInput, match=words):
        design_stage(band, CircuitSettings(**changes))  # type: ignore[arg-type]


def test_the_supply_that_is_named_is_enough() -> None:
    design_stage("white", CircuitSettings(supply_v=7.4))
    with pytest.raises(BadInput, match="too little"):
        design_stage("white", CircuitSettings(supply_v=7.3))


def test_settings_are_checked() -> None:
    for bad in ({"topology": "bridge"}, {"supply_v": 48.0}, {"supply_spread": 0.5}, {"resistor_spread": 0.3}):
        with pytest.raises(BadInput, match=r"circuit\."):
            CircuitSettings(**bad)  # type: ignore[arg-type]


def test_preferred_values() -> None:
    assert _preferred(25.1) == 27.0
    assert _preferred(25.1, up=False) == 24.0
    assert _preferred(1000.0) == _preferred(1000.0, up=False) == 1000.0
    assert _preferred(9.5) == 10.0
    assert _rating_for(0.3) == 0.6
    with pytest.raises(BadInput, match="heat"):
        _rating_for(5.0)
    with pytest.raises(BadInput, match="positive"):
        _preferred(0.0)
    assert [_ohm_text(v) for v in (27.0, 4700.0, 100_000.0, 1.5, 0.47)] == ["27R", "4k7", "100k", "1R5", "0R47"]


@pytest.fixture(scope="module")
def netlist() -> str:
    return (_BOARD / "circuit.net").read_text(encoding="utf-8")


def nets_of(text: str) -> dict[str, set[tuple[str, str]]]:
    """Read the netlist again with a parser of its own."""
    nets = {}
    for part in re.split(r"\(net ", text.partition("(nets")[2])[1:]:
        name = re.search(r'\(name "([^"]*)"\)', part)
        assert name
        nets[name[1]] = set(re.findall(r'\(node \(ref "([^"]*)"\) \(pin "([^"]*)"\)', part))
    return nets


def test_every_led_hangs_on_its_line(netlist: str) -> None:
    nets = nets_of(netlist)
    values = dict(re.findall(r'\(comp \(ref "(\w+)"\)\s+\(value "([^"]*)"\)', netlist))

    def other_end(ref: str, net: str) -> str:
        return next(name for name, nodes in nets.items() if name != net and any(r == ref for r, _ in nodes))

    lines = [*DEFAULT_PINS["white"], *DEFAULT_PINS["nir"]]
    pins = [11, 13, 15, 33, 35, 37, 40, 12, 16, 18, 22, 32, 36, 38]  # of the header, read off its drawing
    for k, (line, pin) in enumerate(zip(lines, pins, strict=True), start=1):
        net = nets[f"GPIO{line}"]
        assert ("J1", str(pin)) in net
        assert other_end(f"R{100 + k}", f"GPIO{line}") == f"BASE{k}"
        assert other_end(f"R{400 + k}", f"GPIO{line}") == "GND"
        assert (f"Q{k}", "2") in nets[f"BASE{k}"]
        assert {(f"Q{k}", "1"), (f"D{k}", "1")} == nets[f"COLLECTOR{k}"]
        assert {(f"Q{k}", "3"), (f"R{200 + k}", "1")} == nets[f"EMITTER{k}"]
        assert {(f"D{k}", "2"), (f"R{300 + k}", "1")} == nets[f"ANODE{k}"]
        assert (f"R{300 + k}", "2") in nets["V_LED"]
        assert (f"R{200 + k}", "2") in nets["GND"]
        assert values[f"D{k}"].startswith("white" if k <= 7 else "nir")


def test_every_pin_is_on_one_net_and_every_part_is_connected(board: Circuit, netlist: str) -> None:
    nets = nets_of(netlist)
    nodes = [node for net in nets.values() for node in net]
    assert len(nodes) == len(set(nodes))
    refs = re.findall(r'\(comp \(ref "(\w+)"\)', netlist)
    ground_pins = {"6", "9", "14", "20", "25", "30", "34", "39"}  # of the header
    assert {("J1", pin) for pin in ground_pins} <= nets["GND"]
    for ref in refs:
        pins = {pin for part, pin in nodes if part == ref}
        assert len(pins) == {"Q": 3}.get(ref[0], 2 if ref != "J1" else 14 + len(ground_pins)), ref
    assert all(len(net) >= 2 for net in nets.values())
    assert len(set(refs)) == len(refs) == board.parts == 90
    assert len(nets) == 73


def test_the_netlist_is_balanced(netlist: str) -> None:
    depth = 0
    for character in re.sub(r'"[^"]*"', "", netlist):
        depth += {"(": 1, ")": -1}.get(character, 0)
        assert depth >= 0
    assert depth == 0
    assert netlist.startswith('(export (version "E")')


def test_parts_add_up_and_every_line_names_three_parts(board: Circuit) -> None:
    bill = _bill_of_materials(board)[1:]
    on_board = [line for line in bill if line[-1]]
    assert sum(int(line[0]) for line in on_board) == board.parts
    assert len({ref for line in on_board for ref in line[-1].split()}) == board.parts
    assert ["14", "BC337-40"] in [line[:2] for line in bill]
    leds = [line[1] for line in bill if line[0] == "7" and line[1].endswith("LED")]
    assert leds == ["white, 0.5 W LED", "850 nm LED"]
    for line in bill:
        assert len(set(line[2:5])) == 3, line
        assert all(line[2:6])
    orders = {line[1]: line[2:6] for line in bill}
    assert orders["27R 0.6 W"][0] == "Vishay MRS25000C2709FCT00"
    assert orders["360R 0.25 W"][1:3] == ["TE LR1F360R", "Yageo MF0207FTE52-360R"]
    assert orders["160 mA hold, resettable"][0] == "Bel Fuse 0ZRE0016FF"
    assert "3.1 to 3.7 V" in orders["white, 0.5 W LED"][3]  # as the settings have it
    assert pytest.approx((3.1, 3.7)) == (
        WHITE_LED.forward_v - WHITE_LED.spread_v,
        WHITE_LED.forward_v + WHITE_LED.spread_v,
    )


def test_weak_leds_and_other_transistors_get_their_own_lines() -> None:
    weak = replace(WHITE_LED, current_a=0.02, limit_a=0.025)
    settings = CircuitSettings(white=weak, transistor=replace(BC337, name="2N2222"))
    bill = {line[1]: line for line in _bill_of_materials(design_circuit(default_rig(), settings))}
    assert bill["white, 0.5 W LED"][2] == "Cree LC513FWH1-60Q-A0"
    assert bill["2N2222"][2] == "your own"


def test_a_place_without_a_resistor_gets_a_wire() -> None:
    bill = {line[1]: line for line in _bill_of_materials(design_circuit(default_rig(), CircuitSettings(supply_v=7.36)))}
    assert bill["0R wire"][-1] == " ".join(f"R{300 + n}" for n in range(1, 8))


def test_the_parts_list_follows_the_number_of_leds() -> None:
    rig = default_rig()
    board = design_circuit(replace(rig, leds=rig.leds[:2] + rig.leds[7:8]))
    assert [(c.number, c.gpio) for c in board.channels] == [(1, 17), (2, 27), (8, 18)]
    bill = _bill_of_materials(board)[1:]
    refs = {ref for line in bill for ref in line[-1].split()}
    assert {"Q1", "Q2", "Q8", "D8", "R101", "R408", "J1", "C2"} <= refs
    assert len(refs) == board.parts == 6 + 3 * 6
    assert [line[0] for line in bill if not line[-1]] == ["3", "3", "1", "1"]


@pytest.mark.parametrize(
    ("current_a", "hold_a"), [(0.02, 0.05), (0.04, 0.08), (0.1, 0.16), (0.111, 0.16), (0.113, 0.25), (0.385, 0.55)]
)
def test_the_fuse_carries_one_led_in_a_warm_box(current_a: float, hold_a: float) -> None:
    assert _fuse_for(current_a) == hold_a


def test_the_fuse_follows_the_led_current() -> None:
    weak = [replace(part, current_a=0.02, limit_a=0.025) for part in (WHITE_LED, NIR_LED)]
    board = design_circuit(default_rig(), CircuitSettings(white=weak[0], nir=weak[1]))
    assert board.fuse_a == 0.05
    line = next(line for line in _bill_of_materials(board) if line[-1] == "F1")
    assert line[1:3] == ["50 mA hold, resettable", "Bel Fuse 0ZRE0005FF"]
    assert line[6] == "Fuse:Fuse_BelFuse_0ZRE0005FF_L8.3mm_W3.8mm"
    with pytest.raises(BadInput, match="no resettable fuse of the list carries 500 mA"):
        _fuse_for(0.5)


def test_other_rigs_get_other_circuits() -> None:
    rig = default_rig()
    few = replace(rig, leds=rig.leds[:3], provenance={"pins": {"white": [5, 6, 13]}})
    board = design_circuit(few, CircuitSettings(topology="switch"))
    assert [c.gpio for c in board.channels] == [5, 6, 13]
    assert [c.number for c in board.channels] == [1, 2, 3]
    assert board.misfit
    with pytest.raises(BadInput, match="band 'uv'"):
        design_circuit(replace(rig, leds=(Led("uv", (0.0, 0.0, 100.0)),)))
    with pytest.raises(BadInput, match="GPIO 13 to two LEDs"):
        design_circuit(replace(few, provenance={"pins": {"white": [5, 13, 13]}}))


@pytest.mark.parametrize("kind", ["servo", "hand", "neighbours"])
def test_films_add_rows_a_drawing_and_what_the_rig_file_says(kind: str, tmp_path: Path) -> None:
    rig = with_films(default_rig(), kind)
    assert with_films(rig, None) == with_films(rig, kind) == rig
    with pytest.raises(BadInput, match=f"has films of the kind '{kind}'"):
        with_films(rig, "servo" if kind == "hand" else "hand")
    facts = circuit_to_folder(tmp_path / "board", rig, CircuitSettings(supply_v=8.5))
    assert facts["files"] == [*FILES, "films.svg"]
    written = read_rig(tmp_path / "board" / "rig.json")
    assert rig_films(written) == rig_films(rig)
    assert pins_of(written) == pins_of(rig)
    bill = list(csv.reader((tmp_path / "board" / "parts.csv").read_text(encoding="utf-8").splitlines()))
    names = [line[1] for line in bill]
    assert ("servo" in names) == (kind == "servo")
    assert "linear polarising film, 50 x 50 mm" in names
    second = [line for line in bill if line[-1].startswith("second board")]
    drawing = (tmp_path / "board" / "films.svg").read_text(encoding="utf-8")
    assert ("GPIO 4)" in drawing) == (kind == "servo")
    assert ("8.5 V adapter" in drawing) == (kind == "neighbours")
    if kind == "neighbours":
        assert [one["gpio"] for one in facts["leds"][14:]] == list(SECOND_PINS)
        assert all(f"GPIO {pin})" in drawing for pin in SECOND_PINS)
        refs = {ref: line[1] for line in second for ref in line[-1].split()[2:]}
        assert refs["R406"] == refs["R407"] == "4k7 0.25 W"  # against the pull-up of GPIO 5 and 6
        assert refs["R405"] == "100k 0.25 W"
        assert len(refs) == 6 + 7 * 6
        turned = rig.leds[14].position_mm, rig.leds[0].position_mm
        assert math.dist(*turned) == pytest.approx(2 * 52.5 * math.sin(math.pi / 28))  # a quarter of the way round
    else:
        assert (second, rig.leds) == ([], default_rig().leds)
    margins = {one["hazard"]: one for one in facts["safety"]}["retina, blue light"]
    assert margins["margin"] == pytest.approx(margins["margin_without_films"] / 0.45, rel=0.01)


def test_other_lines_get_no_drawing_of_the_default_ones(tmp_path: Path) -> None:
    rig = replace(default_rig(), provenance={"films": {"kind": "servo", "servo": 5}})
    facts = circuit_to_folder(tmp_path / "board", rig, CircuitSettings())
    assert facts["files"] == [*FILES]
    with pytest.raises(BadInput, match=r"3 to 7 white LEDs.* this one has 2"):
        with_films(replace(default_rig(), leds=default_rig().leds[:2]), "neighbours")
