"""The files of ``hardware/`` and the scripts that draw them: circuit, light on eye and skin,
phantom, printed parts."""

import csv
import itertools
import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

from hardware import draw, films, lens, phantom, safety, sizes
from hardware.checks import check_dimensions
from hardware.circuit import BOARD, write_circuit
from hardware.geometry import dimensions_of, holder_places, mirror_profile
from hardware.sizes import read_dimensions
from hardware.stages import GPIO_HIGH_V, GPIO_LIMIT_A, design_stage
from refusals import bad_input
from splitknit.io.rig import read_rig
from splitknit.nominal import default_rig
from splitknit_rig.calibration.phantom import HEIGHTS_UM
from splitknit_rig.capture.pins import SECOND_PINS, pins_of, rig_films
from splitknit_simulator.rigs import MirrorSettings, holder_profile, mirror_rig

ROOT = Path(__file__).resolve().parents[2]
PARTS = json.loads((ROOT / "hardware" / "files" / "parts.json").read_text(encoding="utf-8"))


def circuit(**changes):
    return read_dimensions(changes={"circuit": changes}).circuit


def led(band, **changes):
    return getattr(circuit(**{band: changes}), band)


def test_a_file_of_dimensions_changes_what_it_names(tmp_path):
    own = tmp_path / "own.toml"
    own.write_text(
        "[rig]\ncamera_height_mm = 120.0\nled_radius_mm = 45.0\n[finger]\nreach_mm = 44.0\n"
    )
    s = read_dimensions(own)
    rig = films.rig_of(s)
    assert (rig.camera.height_mm, rig.leds[0].position_mm) == (120.0, (45.0, 0.0, 120.0))
    check_dimensions(dimensions_of(rig, s))
    assert films.rig_of(read_dimensions()).leds == default_rig().leds
    own.write_text("[finger]\nwidth_mm = 3.0\n")
    with bad_input(r"'finger.width_mm' is not a dimension; known are .*finger.widest_mm"):
        read_dimensions(own)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"printer": {"bed_x_mm": 100.0}}, "more than the printer's bed of 100 mm"),
        ({"finger": {"stop_height_mm": 15.0}}, "must end below the finger plane"),
        ({"rig": {"led_radius_mm": 10.0}}, "LED"),
        ({"rig": {"films": "neighbours", "side": 7}}, "second LED board"),
        ({"rig": {"side": 1}}, "from 2 to 7"),
    ],
)
def test_rigs_that_cannot_be_built_are_refused(changes, words):
    with bad_input(words):
        s = read_dimensions(changes=changes)
        check_dimensions(dimensions_of(films.rig_of(s), s))


def test_mirrors_stand_where_the_simulator_has_them():
    enlarged = {
        "tip_margin_mm": 27.0,
        "pad_height_mm": 21.2,
        "widest_mm": 22.0,
        "groove_depth_mm": 3.0,
    }
    changes = {"finger": {**enlarged, "stop_height_mm": 3.5}, "mirror": {"wide_mm": 30.0}}
    rig = mirror_rig(MirrorSettings(names=("left", "right", "tip")), 0.5)
    d = dimensions_of(rig, read_dimensions(changes=changes))
    corners = {mirror.name: np.array(mirror.corners_mm) for mirror in rig.mirrors}
    for name, place, away in zip(
        ("right", "left", "tip"), holder_places(d), (0, 0, 1), strict=True
    ):
        assert corners[name][:, 1 - away].mean() == pytest.approx(place[1 - away], abs=1e-9)
        assert np.ptp(corners[name][:, 1 - away]) == pytest.approx(sizes.MIRROR_LONG_MM)
    profile, outline = holder_profile(), np.array(mirror_profile(d.settings))
    for corner in (*profile["lip"], *profile["lip_front"], *profile["back"]):
        assert np.hypot(*(outline - corner).T).min() < 1e-9


# The LED board.


def solved(stage, *, high_v, supply_v, forward_v, base_v, gain):
    """LED and base current by the transistor's exponential law (Ebers and Moll): no shortcuts of
    the design."""
    thermal, back = 0.026, 4.0
    saturation = 0.1 / math.exp(base_v / thermal)  # base_v at 100 mA
    ohm = {resistor.role: resistor.ohm for resistor in stage.resistors}
    base, emitter, series = ohm["base"], ohm.get("emitter", 0.0), max(ohm.get("series", 0.0), 1e-3)

    def currents(of_base, of_collector):
        """Into collector and base at voltages over the emitter."""
        forward = saturation * math.expm1(min(of_base / thermal, 60.0))
        reverse = saturation * math.expm1(min((of_base - of_collector) / thermal, 60.0))
        return forward - reverse * (1 + 1 / back), forward / gain + reverse / back

    def collector(of_base, at_emitter):
        """Voltage over the emitter at which LED and transistor carry the same current."""
        top = supply_v - forward_v - at_emitter
        return float(
            brentq(lambda v: (top - v) / series - currents(of_base, v)[0], -60.0, 60.0, xtol=1e-12)
        )

    def emitter_of(of_base):
        """Voltage over the emitter resistor."""
        if emitter == 0.0:
            return 0.0
        ends = (0.0, 50.0)
        return float(
            brentq(
                lambda v: sum(currents(of_base, collector(of_base, v))) - v / emitter,
                *ends,
                xtol=1e-12,
            )
        )

    def too_much(of_base):
        at_emitter = emitter_of(of_base)
        return (
            currents(of_base, collector(of_base, at_emitter))[1]
            - (high_v - at_emitter - of_base) / base
        )

    of_base = float(brentq(too_much, 0.3, base_v + 0.05, xtol=1e-12))
    at_emitter = emitter_of(of_base)
    of_collector = collector(of_base, at_emitter)
    return (supply_v - forward_v - at_emitter - of_collector) / series, (
        high_v - at_emitter - of_base
    ) / base


@pytest.mark.parametrize("band", ["white", "nir"])
@pytest.mark.parametrize("topology", ["sink", "switch"])
def test_currents_are_those_of_the_solved_circuit(band, topology):
    s = circuit(topology=topology)
    stage = design_stage(band, s)
    rng = np.random.default_rng(0)
    for _ in range(20):  # any board that can be built lies within the stated corners
        current, into_base = solved(
            stage,
            high_v=rng.uniform(*GPIO_HIGH_V),
            supply_v=9.0 * rng.uniform(0.95, 1.05),
            forward_v=stage.led.forward_v + rng.uniform(-1, 1) * stage.led.spread_v,
            base_v=rng.uniform(*s.transistor.base_v),
            gain=rng.uniform(*s.transistor.gain),
        )
        assert 0.98 * stage.current_a[0] <= current <= 1.02 * stage.current_a[2]
        assert into_base <= stage.gpio_a <= GPIO_LIMIT_A
    assert stage.current_a[2] <= stage.led.limit_a
    assert stage.transistor_w <= 0.6 * s.transistor.limit_w
    assert all(r.heat_w <= 0.6 * r.rating_w for r in stage.resistors)


def test_missed_margins_are_named():
    for changes, words in (
        ({"supply_v": 6.0}, "too little"),
        ({"white": {"current_a": 0.3}}, "an LED of 120 mA"),
    ):
        with bad_input(words):
            design_stage("white", circuit(**changes))


def test_the_reference_board_is_what_lies_there(tmp_path):
    write_circuit(tmp_path, read_dimensions())
    for file in tmp_path.iterdir():
        if file.name != "rig.json":  # it names the release
            assert file.read_bytes() == (BOARD / file.name).read_bytes(), file.name
    assert read_rig(tmp_path / "rig.json").leds == read_rig(BOARD / "rig.json").leds


def test_the_page_shows_the_lens_as_its_script_draws_it():
    s = read_dimensions()
    d = dimensions_of(films.rig_of(s), s)
    assert lens.depth_mm(d, 2.0) == pytest.approx(1.35, abs=0.01)
    drawn = (ROOT / "docs" / "images" / lens.NAME).read_text(encoding="utf-8")
    assert lens.figure(d) == drawn


@pytest.mark.parametrize("kind", ["servo", "hand", "neighbours"])
def test_films_add_rows_a_drawing_and_what_the_rig_file_says(kind, tmp_path):
    facts = write_circuit(
        tmp_path, read_dimensions(changes={"rig": {"films": kind}, "circuit": {"supply_v": 8.5}})
    )
    written = read_rig(tmp_path / "rig.json")
    assert rig_films(written).kind == kind
    with bad_input(f"has films of the kind '{kind}'"):
        films.with_films(written, "servo" if kind == "hand" else "hand")
    bill = list(csv.reader((tmp_path / "parts.csv").read_text(encoding="utf-8").splitlines()))
    names = [line[1] for line in bill]
    assert ("servo" in names) == (kind == "servo") and "linear polarising film, 50 x 50 mm" in names
    drawing = (tmp_path / "films.svg").read_text(encoding="utf-8")
    assert ("GPIO 4)" in drawing) == (kind == "servo")
    refs = {
        ref: line[1]
        for line in bill
        if line[-1].startswith("second board")
        for ref in line[-1].split()[2:]
    }
    if kind == "neighbours":
        assert [led["gpio"] for led in facts["leds"][14:]] == list(SECOND_PINS)
        # against the pull-up of GPIO 5
        assert refs["R406"] == "4k7 0.25 W" and refs["R405"] == "100k 0.25 W"
    else:
        assert refs == {}
    blue = next(limit for limit in facts["safety"] if limit["hazard"] == "retina, blue light")
    assert blue["margin"] == pytest.approx(blue["margin_without_films"] / 0.45, rel=0.01)


def test_the_second_board_drives_side_lights_as_bright_as_the_ring(tmp_path):
    facts = write_circuit(tmp_path, read_dimensions(changes={"rig": {"films": "servo", "side": 7}}))
    assert facts["stages"]["side"]["current_ma"][1] == pytest.approx(100 * 0.4026, rel=0.01)
    blue = {
        limit["leds"]: limit for limit in facts["safety"] if limit["hazard"] == "retina, blue light"
    }
    assert blue["side"]["margin"] > 3 and blue["side"]["margin_without_films"] > 1.5
    # light falls with the squared distance: they give an eye in the finger plane what the ring
    # gives it
    assert blue["side"]["value"] == pytest.approx(blue["white"]["value"], rel=0.12)
    assert pins_of(read_rig(tmp_path / "rig.json"))[14:] == SECOND_PINS
    again = read_dimensions(changes={"rig": {"file": str(tmp_path / "rig.json")}})
    assert films.rig_of(again).leds == read_rig(tmp_path / "rig.json").leds
    s = read_dimensions(changes={"rig": {"side": 7}})
    d = dimensions_of(films.rig_of(s), s)
    angles = [round(films.side_film_deg(hole.light_mm.tolist()), 1) for hole in d.sides]
    assert angles == [-13.3, 6.9, 32.8, 90.0, -32.8, -6.9, 13.3]


# Light on eye and skin. No number here is computed by the module's functions but the one that is
# checked.

POINT = {"intensity_w_sr": 1.0, "half_angle_deg": 5.0, "source_mm": 0.1, "forward_v": 20.0}


@pytest.mark.parametrize(
    ("nm", "blue", "burn"),
    [  # IEC 62471:2006, table 4.2, as printed
        (380, 0.01, 0.1),
        (415, 0.80, 8.0),
        (440, 1.00, 10.0),
        (460, 0.80, 8.0),
        (490, 0.22, 2.2),
        (500, 0.10, 1.0),
        (550, 0.01, 1.0),
        (600, 0.001, 1.0),
        (810, 0.0, 0.603),
        (950, 0.0, 0.316),
        (1100, 0.0, 0.2),
        (1300, 0.0, 0.02),
        (1450, 0.0, 0.0),
    ],
)
def test_the_weighting_functions_are_the_tables(nm, blue, burn):
    assert safety.blue_weight(np.array([float(nm)]))[0] == pytest.approx(blue, rel=0.01)
    assert safety.burn_weight(np.array([float(nm)]))[0] == pytest.approx(burn, rel=0.005)


def named(hazards, clause):
    return next(hazard for hazard in hazards if hazard.clause == clause)


def test_hazards_by_hand():
    """A point of 1 W/sr at 20 cm: 25 W/m2; over 11 mrad (9.503e-5 sr) 263 kW/m2/sr, weighted by
    half at 850 nm."""
    burn = named(safety.band_hazards("nir", led("nir", **POINT), 0.1, 200.0), "4.3.6")
    assert burn.value == pytest.approx(25 / 9.503e-5 * 0.5027, rel=2e-3)
    assert burn.limit == pytest.approx(545_455, rel=1e-5)  # 545.5 mW/mm2/sr in ams OSRAM's note
    # 100 cd of 7900 K at 1 m are 100 lx and 0.103 W/m2 of blue; over 0.1 rad (7.854e-3 sr) 13.1
    # W/m2/sr
    lamp = led("white", intensity_cd=100.0, half_angle_deg=10.0, source_mm=20.0)
    blue = named(safety.band_hazards("white", lamp, 0.1, 1000.0), "4.3.3")
    assert blue.value == pytest.approx(100 * 1.03e-3 / 7.854e-3, rel=0.01) and blue.limit == 100.0
    # seven LEDs of each kind, 149.5 mm away
    stages = {band: design_stage(band, circuit()) for band in ("white", "nir")}
    hazards, over = safety.rig_hazards(default_rig(), stages), stages["nir"].current_a[2] / 0.1
    assert named(hazards, "4.3.7").value == pytest.approx(7 * 0.12 * over / 0.1495202**2, rel=1e-3)
    assert named(hazards, "4.3.8").value == pytest.approx(
        7 * (0.12 + 10.0 / 313.3) * over / 0.1495202**2, rel=2e-3
    )
    # (9.45 V - 1.4 V) over 27 + 33 ohms less 1 %
    assert stages["nir"].shorted_a == pytest.approx(8.05 / 59.4)


def test_light_above_a_limit_is_refused(tmp_path):
    narrow = {"intensity_w_sr": 2.0, "half_angle_deg": 3.0}
    for changes, words in (
        ({"nir": narrow}, r"the LEDs together would give 627 W/m2 .*above the 100 .*4\.3\.7"),
        ({"white": {"intensity_cd": 20.0}}, r"117 W/m2/sr \(retina, blue light\), above the 100"),
        ({"white": {"intensity_cd": 10_000.0}}, "cd, not mcd"),
        ({"nir": {"intensity_w_sr": 0.0}}, "must be given once"),
    ):
        with bad_input(words):
            write_circuit(tmp_path / "board", read_dimensions(changes={"circuit": changes}))
    assert not (tmp_path / "board").exists()


# What is printed.


def test_the_phantom_is_closed_and_as_high_as_stated():
    result, fields = phantom.phantom()
    vertices, faces = phantom.phantom_mesh(result)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    forth, back = (np.sort(edges[:, k] * len(vertices) + edges[:, 1 - k]) for k in (0, 1))
    np.testing.assert_array_equal(forth, back)  # every edge once in each direction
    assert {field["height_um"] for field in fields} == set(HEIGHTS_UM)
    high = float(np.nanmax(result.ridge_mm))
    assert 0.1 < high < 0.3


@pytest.fixture(scope="module")
def parts():
    pytest.importorskip("build123d", reason="build123d (group hardware) is not installed")
    s = read_dimensions(changes={"rig": {"films": "servo", "side": 7}})
    d = dimensions_of(films.rig_of(s), s)
    return d, draw.draw_parts(d)


def shared_volume(first, second):
    common = first.intersect(second)
    return 0.0 if common is None else sum(solid.volume for solid in common.solids())


@pytest.mark.slow
@pytest.mark.filterwarnings("default::DeprecationWarning")  # of build123d and what it imports
def test_parts_are_whole_and_do_not_cut_each_other(parts):
    d, solids = parts
    assert all(solid.is_valid for solid in solids.values())
    names = ("lid", "nail", "calibration_disc", "mirror_holder")  # as in the reference rig
    for name in names:
        volume = PARTS["parts"][name]["mass_g"] / 1.24
        assert solids[name].volume / 1000 == pytest.approx(volume, rel=0.01, abs=0.1), name
    stack = ("base", "cylinder", "analyser_plate", "analyser", "film_ring", "frame", "box", "lid")
    for first, second in itertools.combinations(stack, 2):
        assert shared_volume(solids[first], solids[second]) < 1e-6, (first, second)
    from build123d import Plane, Solid

    for hole in d.holes[::3]:  # a beam's way to the finger is free
        way = Plane(origin=tuple(hole.light_mm), z_dir=tuple(-hole.back))
        beam = Solid.make_cylinder(1.0, float(np.linalg.norm(hole.light_mm)) - 15.0, way)
        for name in stack[1:]:
            assert shared_volume(beam, solids[name]) < 1e-6, (hole.index, name)
