"""Side lights: where they stand, their board and their light, their lamps, their film, and what they gain."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace

import numpy as np
import pytest

from splitknit.cli.main import main
from splitknit.errors import BadInput
from splitknit.io.rig import read_rig, write_rig
from splitknit.model import default_rig
from splitknit_rig.capture.pins import NIR_PINS, SECOND_PINS, WHITE_PINS, pins_of
from splitknit_rig.rig.candidates import BuildSettings, RigCandidate, candidate_rig, grid
from splitknit_rig.rig.circuit import CircuitSettings
from splitknit_rig.rig.circuit_files import circuit_to_folder
from splitknit_rig.rig.dimension_checks import check_dimensions
from splitknit_rig.rig.dimensions import dimensions_of, side_lamp
from splitknit_rig.rig.films import side_film_deg, with_films, with_side_lights
from splitknit_rig.rig.optimise import Study, evaluate_candidate
from splitknit_simulator.light.films import FilmSettings, reflected_through, side_lights, turned_film_rad
from splitknit_simulator.light.lighting import towards
from splitknit_simulator.scene import TwinSettings, films_of


def test_seven_stand_where_those_of_the_path_traced_finger_do() -> None:
    rig = with_side_lights(default_rig(), 7)
    plain = default_rig()
    assert with_side_lights(plain, 0) is plain
    assert side_lights(rig.leds) == tuple(range(14, 21))
    places = np.array([rig.leds[k].position_mm for k in range(14, 21)])
    assert np.allclose(places[0], (81.56770, -38.03564, 30.0), atol=1e-4)
    assert np.allclose(places[3], (0.0, 90.0, 30.0), atol=1e-9)
    assert (places[:, 1] > -40).all()  # the hand comes from -y
    far, near = math.hypot(52.5, 140.0), math.hypot(90.0, 30.0)
    assert rig.leds[14].intensity / near**2 == pytest.approx(rig.leds[0].intensity / far**2, rel=1e-5)
    assert pins_of(rig) == (*WHITE_PINS, *NIR_PINS, *SECOND_PINS)
    for one, count, words in (
        (rig, 7, "none of them at the side"),
        (default_rig(), 1, "from 2 to 7"),
        (default_rig(), 8, "from 2 to 7"),
        (with_films(default_rig(), "neighbours"), 7, "second LED board"),
    ):
        with pytest.raises(BadInput, match=words):
            with_side_lights(one, count)
    with pytest.raises(BadInput, match="side lights' lines"):
        with_films(with_side_lights(default_rig(), 7), "neighbours")


def test_the_second_board_drives_them_as_bright_as_the_ring(tmp_path, capsys) -> None:
    out = tmp_path / "board"
    assert main(["rig", "circuit", "--out", str(out), "--side", "7", "--films", "servo"]) == 0
    said = capsys.readouterr().out
    assert "Two LED boards of 21 stages" in said and "side  40 mA (36 to 44" in said
    facts = json.loads((out / "circuit.json").read_text())
    assert [one["gpio"] for one in facts["leds"] if one.get("board") == 2] == list(SECOND_PINS)
    assert facts["stages"]["side"]["current_ma"][1] == pytest.approx(100 * 0.4026, rel=0.01)
    bill = list(csv.reader((out / "parts.csv").read_text(encoding="utf-8").splitlines()))
    refs = {ref: line[1] for line in bill if line[-1].startswith("second board") for ref in line[-1].split()[2:]}
    assert refs["R406"] == refs["R407"] == "4k7 0.25 W"
    assert refs["R201"] == "62R 0.25 W" and refs["D7"] == "white, 0.5 W LED"
    blue = {one["leds"]: one for one in facts["safety"] if one["hazard"] == "retina, blue light"}
    assert blue["side"]["margin"] > 3 and blue["side"]["margin_without_films"] > 1.5
    # light falls with the squared distance: they give an eye in the finger plane what the ring gives it
    assert blue["side"]["value"] == pytest.approx(blue["white"]["value"], rel=0.12)
    written = read_rig(out / "rig.json")
    assert side_lights(written.leds) == tuple(range(14, 21)) and pins_of(written)[14:] == SECOND_PINS
    again = circuit_to_folder(tmp_path / "again", written, CircuitSettings())
    assert again["stages"] == facts["stages"]


def test_side_lights_at_the_full_current_are_refused_for_the_eye(tmp_path) -> None:
    rig = with_side_lights(default_rig(), 7)
    bright = replace(rig, leds=(*rig.leds[:14], *(replace(led, intensity=1.0) for led in rig.leds[14:])))
    with pytest.raises(BadInput, match=r"the side LEDs would give .* blue light.*above the 100"):
        circuit_to_folder(tmp_path / "board", bright, CircuitSettings())
    assert not (tmp_path / "board").exists()
    first = replace(rig, leds=(*rig.leds[14:], *rig.leds[:14]))
    with pytest.raises(BadInput, match="must be the last white ones"):
        circuit_to_folder(tmp_path / "board", first, CircuitSettings())


@pytest.mark.parametrize("analyser", [0.0, 0.6])
def test_turned_film_keeps_the_reflection_out_of_the_crossed_image(analyser: float) -> None:
    """Film along the analyser would leak up to half of what a facet half way between light and camera mirrors."""
    leaks = []
    for led in with_side_lights(default_rig(), 7).leds[14:]:
        light = np.array(led.position_mm) / np.linalg.norm(led.position_mm)
        turned = turned_film_rad(led.position_mm, analyser)
        ways = [(axis, analyser + quarter) for axis in (turned, analyser) for quarter in (0.0, np.pi / 2)]
        parallel, crossed, plain, leaked = (
            float(reflected_through(light, (0.0, 0.0, 1.0), film, camera, 0.0)) for film, camera in ways
        )
        assert crossed < 1e-9 * parallel
        leaks.append(leaked / (plain + leaked))
    assert max(leaks) > 0.4


def test_the_twin_mounts_the_film_so() -> None:
    rig = with_side_lights(default_rig(0.1), 7)
    films = films_of(TwinSettings(rig=rig, films=FilmSettings(kind="analyser")), rig)
    assert films is not None and films.polariser_rad.shape == (2, 14)
    assert not films.polariser_rad[:, :7].any()
    turned = [turned_film_rad(led.position_mm) for led in rig.leds[14:]]
    assert np.allclose(films.polariser_rad[:, 7:], turned)
    angles = [round(side_film_deg(led.position_mm), 1) for led in rig.leds[14:]]
    assert angles == [-13.3, 6.9, 32.8, 90.0, -32.8, -6.9, 13.3]


def moved(rig, radius=90.0, height=30.0, turn=0.0):
    def place(led):
        azimuth = math.atan2(led.position_mm[1], led.position_mm[0]) + math.radians(turn)
        return replace(led, position_mm=(radius * math.cos(azimuth), radius * math.sin(azimuth), height))

    return replace(rig, leds=(*rig.leds[:14], *map(place, rig.leds[14:])))


def test_lamps_that_do_not_fit_are_named() -> None:
    rig = with_side_lights(default_rig(), 7)
    d = dimensions_of(rig)
    check_dimensions(d)
    plain = dimensions_of(default_rig())
    assert (d.bore_mm, d.frame_z_mm, d.nail_mm, d.holes[3].index) == (
        plain.bore_mm, plain.frame_z_mm, plain.nail_mm, 3)  # fmt: skip
    assert 5 < side_lamp(d).film_mm < 10
    one = replace(rig, leds=(*rig.leds[:-1], replace(rig.leds[-1], position_mm=(-81.0, -38.0, 34.0))))
    for other, words in (
        (moved(rig, radius=70.0, height=25.0), "outside the tube of 63.9 mm"),
        (moved(rig, height=3.0), "does not fit into the cylinder's wall"),
        (moved(rig, turn=-20.0), "hand's niche|hides a screw"),
        (one, "they differ by 4.0 mm"),
    ):
        with pytest.raises(BadInput, match=words):
            check_dimensions(dimensions_of(other))


@pytest.mark.slow
@pytest.mark.filterwarnings("default::DeprecationWarning")
def test_lamps_print_fit_and_light_the_finger() -> None:
    build123d = pytest.importorskip("build123d", reason="build123d (extra 'cad') is not installed")
    from splitknit_rig.rig import assembly, parts
    from splitknit_rig.rig.part_reports import report_part

    d = dimensions_of(with_side_lights(default_rig(), 7))
    kinds = {kind.name: kind for kind in assembly.kinds_of(d)}
    lamp = assembly.RigPart(kinds["side_lamp"], parts.MAKERS["side_lamp"](d), tuple(parts.side_places(d)))
    report = report_part(lamp.kind, assembly.as_printed(lamp, assembly.triangles_of(lamp)), d.settings.printer)
    assert report["quantity"] == 7 and all(check["ok"] for check in report["checks"].values())
    around = {name: parts.MAKERS[name](d) for name in ("base", "window_base", "cylinder")}
    half = d.settings.finger.widest_mm / 2
    ends = [
        (x, y, z) for x in (-half, half) for y in (-14.0, 14.0) for z in (0.0, -d.settings.finger.pad_height_mm / 4)
    ]
    for hole, solid in list(zip(d.sides, assembly.placed(lamp), strict=True))[::3]:
        for name, other in around.items():
            shared = solid.intersect(other)
            assert shared is None or sum(one.volume for one in shared.solids()) < 1e-6, name
        start = tuple(hole.at(-0.1))
        for end in ends:
            ray = build123d.Edge.make_line(start, end)
            assert ray.distance_to(solid) > 0.05 and ray.distance_to(around["cylinder"]) > 0.05
        pressed = build123d.Pos(*(-0.3 * hole.back)) * solid
        assert sum(one.volume for one in pressed.intersect(around["cylinder"]).solids()) > 1  # the collar stops it


def test_seven_side_lights_measure_steep_slopes() -> None:
    """The issue's figures: 0.24 and 1.2 fall to 0.05 and 0.09 (medians; seven around the whole circle)."""
    study = Study("information", 1)
    figures = {}
    for candidate in grid((140.0,), (52.5,), (1.0,), (None,), (12.0,), (0, 4, 7)):
        record = evaluate_candidate(candidate, study)
        assert record["status"] == "done", record
        figures[candidate.side] = record["mean"]
    ring, four, seven = (figures[k] for k in (0, 4, 7))
    assert ring["slope_median_30_45"] == pytest.approx(0.24, rel=0.1)
    assert ring["slope_median_45_60"] == pytest.approx(1.2, rel=0.15)
    assert seven["slope_median_30_45"] < 0.05 and seven["slope_median_45_60"] < 0.13
    for band in ("0_15", "15_30", "30_45", "45_60"):
        assert seven[f"slope_{band}"] <= four[f"slope_{band}"] <= ring[f"slope_{band}"]
    near = RigCandidate(140.0, 52.5, 1.0, side=7, side_radius_mm=70.0)
    refused = evaluate_candidate(near, study)
    assert refused["status"] == "refused" and "outside this box" in refused["reason"]
    leds = candidate_rig(near, BuildSettings(), {"white": 1.0, "nir": 1.0}).leds
    assert [led.band for led in leds[14:]] == ["white"] * 7


def test_rig_optimise_ranks_side_lights(tmp_path, capsys) -> None:
    out = tmp_path / "sweep"
    words = ["--objective", "slopes", "--heights-mm", "140", "--radii-mm", "52.5", "--powers-w", "1", "--side", "0,4,7"]
    assert main(["rig", "optimise", "--out", str(out), *words, "--workers", "1"]) == 0
    assert "7 side lights, 90 / 30 mm" in capsys.readouterr().out
    best = json.loads((out / "results.json").read_text())["best"]
    assert best["side"] == 7 and best["slope_deviation"] < 0.05
    assert main(["rig", "optimise", "--out", str(tmp_path / "no"), *words[:-1], "2.5"]) == 2
    assert "it holds '2.5'" in capsys.readouterr().err
    assert main(["rig", "optimise", "--out", str(tmp_path / "no"), *words, "--fingers", "2"]) == 2
    assert "leave --fingers out" in capsys.readouterr().err


def test_a_rig_file_with_side_lights_is_drawn_as_it_is(tmp_path, capsys) -> None:
    """Nothing is added to a rig that has side lights."""
    write_rig(with_side_lights(default_rig(), 4), tmp_path / "rig.json")
    words = ["rig", "circuit", "--rig", str(tmp_path / "rig.json"), "--out", str(tmp_path / "board")]
    assert main([*words, "--side", "7"]) == 2
    assert "leave --side out" in capsys.readouterr().err
    assert main(words) == 0
    assert "of 18 stages" in capsys.readouterr().out


@pytest.mark.parametrize("axis_deg", [0.0, 20.0])
def test_film_before_a_side_light_faces_the_finger(axis_deg: float) -> None:
    """What passes hardly varies over a finger; under film that lay level it varied by a factor of up to six."""
    rig = with_side_lights(default_rig(0.1), 7)
    films = films_of(TwinSettings(rig=rig, films=FilmSettings(kind="analyser", axis_deg=axis_deg)), rig)
    assert films is not None
    x, y = np.meshgrid(np.linspace(-7, 7, 15), np.linspace(-12, 12, 25))
    for k, led in enumerate(led for led in rig.leds if led.band == "white"):
        way = towards(led, x, y, -(x**2) / 14)[:3]
        passed = films.specular(0, k, way, (0.0, 0.0, 1.0)) - films.specular(1, k, way, (0.0, 0.0, 1.0))
        assert passed.std() < 0.05 * passed.mean()
