"""``splitknit calibrate lights``: what it prints, writes, refuses, and in which words."""

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from enrolled import facts_of, refusal_of, words_of
from refusals import bad_input
from splitknit.cli.main import main
from splitknit.imaging.pixels import srgb_code
from splitknit.io.images import read_image, write_image
from splitknit.io.light_list import write_light_list
from splitknit.io.rig import read_rig, write_rig
from splitknit.model import Mirror
from splitknit.nominal import default_rig, nominal_rig
from splitknit_rig.calibration.light_sources import check_lights_file
from splitknit_simulator.calibration_set.bench import photograph_bench, well_exposed
from splitknit_simulator.calibration_set.solids import NailScene, SphereScene
from splitknit_simulator.rigs import built_rig, with_side_lights

THESIS = Path(__file__).resolve().parents[4] / "examples" / "thesis_tips.csv"
SIZE = ("--px-per-cm", "757", "--led-height-cm", "14", "--image-size", "2200,3200")
RIG = ("--led-radius-cm", "5", "--led-centre-px", "1575,1174", *SIZE)
GOOD = ("--led-radius-cm", "5.25", *SIZE)
MIRROR = Mirror(
    "right",
    ((12.0, -10.0, -15.0), (12.0, 20.0, -15.0), (26.0, 20.0, -1.0), (26.0, -10.0, -1.0)),
    0.85,
)


def cast_table(path, places, *, height=15.0, bands=("white", "nir"), skip=()):
    """Shadows of the drawn rig by hand."""
    lines = ["band,led,nail,nail_x_px,nail_y_px,tip_x_px,tip_y_px"]
    for k, led in enumerate(default_rig().leds):
        for number, place in enumerate(np.asarray(places, float), start=1):
            if led.band not in bands or (led.band, k % 7, number) in skip:
                continue
            at = np.asarray(led.position_mm)
            end = at[:2] + (place - at[:2]) * at[2] / (at[2] - height)
            pixels = [(1599.5 + 75.7 * x, 1099.5 - 75.7 * y) for x, y in (place, end)]
            lines.append(",".join(map(str, (led.band, k % 7, number, *pixels[0], *pixels[1]))))
    path.write_text("\n".join(lines) + "\n")
    return path


def run(capsys, command, *words):
    code = main([*f"calibrate lights {command}".split(), *map(str, words)])
    out, err = capsys.readouterr()
    return code, out, err


def facts_with(capsys, command, *words):
    return facts_of(capsys, f"calibrate lights {command}", *words)


def refused(capsys, command, *words):
    return refusal_of(capsys, f"calibrate lights {command}", *words)


def test_a_refusal_prints_the_facts_of_every_led(capsys, tmp_path):
    code, out, err = run(
        capsys, f"--table {THESIS}", *RIG, "--out", tmp_path / "rig.json", "--json"
    )
    assert code == 2 and err.count("\n") == 1
    facts = json.loads(out)
    assert facts["method"] == "circle" and facts["written"] is False
    assert list(tmp_path.iterdir()) == []
    verdicts = [led["verdict"] for led in facts["leds"]]
    assert [verdicts.count(word) for word in ("ok", "disagrees", "copied")] == [3, 5, 6]
    names = [(led["band"], led["led"]) for led in facts["leds"]]
    assert names == [(band, k) for band in ("white", "nir") for k in range(7)]
    for led in facts["leds"]:
        assert np.linalg.norm(led["direction"]) == pytest.approx(1.0)
        assert led["direction"][2] > 0.9
        assert led["kept"] == (led["verdict"] == "ok")
    assert facts["leds"][0]["disagreement_deg"] == pytest.approx(8.94, abs=0.005)


def test_keep_writes_copied_and_disagreeing_leds(capsys, tmp_path):
    out = tmp_path / "rig.json"
    facts = facts_with(capsys, f"--table {THESIS}", *RIG, "--out", out, "--keep")
    assert facts["written"] and all(led["kept"] for led in facts["leds"])
    rig = read_rig(out)
    assert len(rig.leds) == 14
    assert rig.camera.px_per_mm == 75.7 and rig.camera.image_size == (2200, 3200)
    for led, stated in zip(rig.leds, facts["leds"], strict=True):
        assert led.band == stated["band"]
        assert led.position_mm == pytest.approx(stated["position_mm"])
    verdicts = [led["verdict"] for led in rig.provenance["lights"]["leds"]]
    assert verdicts.count("copied") == 6 and verdicts.count("disagrees") == 5


def test_several_positions_are_fitted_together(capsys, tmp_path):
    table = cast_table(tmp_path / "tips.csv", [(-6, -4), (6, 5), (6, -4)], skip={("nir", 2, 1)})
    facts = facts_with(capsys, f"--table {table}", *GOOD)
    assert facts["method"] == "joint" and facts["written"] is False
    assert facts["nail_height_mm"] == pytest.approx(15.0, abs=0.01)
    for led, truth in zip(facts["leds"], default_rig().leds, strict=True):
        assert led["position_mm"] == pytest.approx(truth.position_mm, abs=0.01)
        assert 0 < led["interval_deg"] < 1.0 and 0 < led["interval_mm"] < 4.0


def test_calibration_keeps_the_rest_of_the_rig(capsys, tmp_path):
    """Camera, intensities and other facts come from the rig, whose LEDs move."""
    table = cast_table(tmp_path / "tips.csv", [(-6, -4), (6, 5)])
    known = replace(default_rig(seed=3), mirrors=(MIRROR,))
    write_rig(known, tmp_path / "old.json")
    words = "--rig", tmp_path / "old.json", "--out", tmp_path / "new.json"
    assert facts_with(capsys, f"--table {table}", *words)["method"] == "joint"
    rig = read_rig(tmp_path / "new.json")
    assert [led.intensity for led in rig.leds] == [led.intensity for led in known.leds]
    assert rig.provenance["source"] == known.provenance["source"]
    assert rig.mirrors == known.mirrors


def test_the_same_table_gives_the_same_bytes(capsys, tmp_path):
    table = cast_table(tmp_path / "tips.csv", [(-6, -4), (6, 5), (6, -4)])
    for name in ("a.json", "b.json"):
        assert run(capsys, f"--table {table}", *GOOD, "--out", tmp_path / name)[0] == 0
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--table", THESIS, "--images", "nail"), "--table and --images"),
        (("--table", THESIS), "--px-per-cm and --image-size and --led-height-cm"),
        (("--table", THESIS, *SIZE), "--led-radius-cm"),
        (("--table", THESIS, *RIG[:-1], "2200"), "rows,columns"),
        (("--table", THESIS, *RIG[:-1], "1100,1600"), "outside the image"),
        (("--table", "absent.csv", *RIG), "absent.csv"),
        (("--table", THESIS, *RIG, "--out", "lights.lp"), "an .lp file holds directions"),
        (("--sphere", "grey", *RIG), "--images"),
    ],
)
def test_options_that_cannot_be_used_are_refused(capsys, words, expected):
    assert expected in refused(capsys, *words)


@pytest.fixture(scope="module")
def nail_photographs(tmp_path_factory):
    """Two positions of the nail under white LEDs, at a tenth of the scale; the rig file knows the
    built camera."""
    folder = tmp_path_factory.mktemp("nail")
    true = built_rig(6, scale=0.1)
    write_rig(replace(nominal_rig(0.1), camera=true.camera), folder / "nominal.json")
    tilt = tuple(true.provenance["base_tilt_deg"])
    for name, place in (("nail_2", (-5.0, -3.0)), ("nail_10", (5.0, 3.0))):
        scene = NailScene(camera=true.camera, leds=true.leds, position_mm=place, tilt_deg=tilt)
        exposure = well_exposed(scene, [[k] for k in range(7)])
        (folder / "photographs" / name).mkdir(parents=True)
        for k in range(7):
            image = photograph_bench(scene, [k], k, exposure=exposure)
            write_image(folder / "photographs" / name / f"white_{k}.png", image)
    return folder, true


@pytest.mark.slow
def test_photographs_of_a_nail_give_the_directions_of_the_lights(
    capsys, tmp_path, nail_photographs
):
    folder, true = nail_photographs
    out, rig = tmp_path / "rig.json", ("--rig", folder / "nominal.json")
    facts = facts_with(capsys, f"--images {folder}/photographs", *rig, "--out", out)
    assert facts["method"] == "joint" and facts["nail_positions"] == 2
    assert len(read_rig(out).leds) == 14
    for led, truth in zip(read_rig(out).leds[:7], true.leds[:7], strict=True):
        measured, known = (
            np.array(each.position_mm) / np.linalg.norm(each.position_mm) for each in (led, truth)
        )
        assert np.degrees(np.linalg.norm(measured - known)) < 0.6
        assert led.lobe_exponent > 0
    assert read_image(facts["show"]).shape[2] == 3
    # the table that was written gives the same
    again = facts_with(capsys, "--table", facts["tips_out"], *rig)
    for led, before in zip(again["leds"], facts["leds"], strict=True):
        assert led["direction"] == pytest.approx(before["direction"], abs=2e-3)


def test_photographs_without_a_shadow_or_of_another_size_are_refused(
    capsys, tmp_path, nail_photographs
):
    folder, _ = nail_photographs
    copy = tmp_path / "copy"
    shutil.copytree(folder / "photographs", copy)
    words = ("--images", copy, "--rig", folder / "nominal.json", "--out", tmp_path / "rig.json")
    image = copy / "nail_2" / "white_4.png"
    lit = read_image(image)
    write_image(image, np.full_like(lit, 90))
    assert "white_4.png shows no shadow" in refused(capsys, *words)
    image.unlink()
    assert "lacks the image white_4" in refused(capsys, *words)
    write_image(image, lit[:-4])
    assert "white_4.png has 216 x 320 pixels" in refused(capsys, *words)
    assert not (tmp_path / "rig.json").exists()
    assert "is not a folder" in refused(capsys, f"--images {tmp_path}/absent", *words[2:])


def from_ball(scene):
    """(440, 640) x and y from the middle of the outline of a ball, in its radii."""
    edge = scene.outline_px()
    (column, row), radius = edge.mean(axis=0), np.ptp(edge[:, 0]) / 2
    rows, columns = np.mgrid[:440, :640]
    return (columns - column) / radius, (row - rows) / radius


def write_mask(scene, file):
    write_image(file, np.where(np.hypot(*from_ball(scene)) < 1, 255, 0).astype(np.uint8))


@pytest.mark.slow
def test_a_ball_gives_the_places_of_side_lights(capsys, tmp_path):
    rig = with_side_lights(nominal_rig(0.2), 7)
    write_rig(rig, tmp_path / "rig.json")
    scene = SphereScene(
        camera=rig.camera, leds=rig.leds, chrome=False, radius_mm=5.0, position_mm=(2.0, 1.0)
    )
    (tmp_path / "ball").mkdir()
    white = [*range(7), *range(14, 21)]
    for number, k in enumerate(white):
        image = photograph_bench(scene, [k], k, exposure=well_exposed(scene, [[k]]))
        write_image(tmp_path / "ball" / f"white_{number}.png", image)
    write_mask(scene, tmp_path / "mask.png")
    words = "--sphere", "grey", "--images", tmp_path / "ball", "--mask", tmp_path / "mask.png"
    words += "--led-height-cm", "14"
    facts_with(capsys, *words, "--rig", tmp_path / "rig.json", "--out", tmp_path / "found.json")
    for k, led in zip(white, read_rig(tmp_path / "found.json").leds, strict=True):
        assert math.dist(led.position_mm, rig.leds[k].position_mm) < 2.0
    words += "--px-per-cm", "151.4", "--image-size", "440,640", "--out", tmp_path / "no.json"
    assert "white_7.png shows a side light" in refused(capsys, *words)
    assert not (tmp_path / "no.json").exists()


def test_a_nail_leaves_side_lights_where_they_are_drawn(capsys, tmp_path):
    rig = with_side_lights(default_rig(), 7)
    write_rig(rig, tmp_path / "rig.json")
    table = cast_table(tmp_path / "tips.csv", [(-6, -4), (7, 5), (5, -6)])
    out = tmp_path / "found.json"
    words = "--table", table, "--rig", tmp_path / "rig.json", "--out", out
    printed = words_of(capsys, "calibrate", "lights", *words)
    assert "the side lights white 7, white 8" in printed and "a ball measures them" in printed
    leds = read_rig(out).leds
    assert [led.position_mm for led in leds[14:]] == [led.position_mm for led in rig.leds[14:]]
    for led, drawn in zip(leds[:14], rig.leds, strict=False):
        assert math.dist(led.position_mm, drawn.position_mm) < 0.1


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    """JPEG files of a ball on the bench, its mask, and x and y in its radii."""
    folder = tmp_path_factory.mktemp("ball")
    rig = default_rig(0.2)
    scene = SphereScene(camera=rig.camera, leds=rig.leds, chrome=False, ground=0.0)
    (folder / "ball").mkdir()
    for k in range(7):
        image = photograph_bench(scene, [k], k, exposure=well_exposed(scene, [[k]]))
        code = np.rint(255.0 * srgb_code(image / np.iinfo(image.dtype).max)).astype(np.uint8)
        Image.fromarray(code[..., 0] if code.shape[2] == 1 else code).save(
            folder / "ball" / f"{k}.jpg", quality=95
        )
    write_mask(scene, folder / "mask.png")
    return folder / "ball", folder / "mask.png", from_ball(scene)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "options"),
    [("lights.txt", ()), ("rig.json", ()), ("places.txt", ("--led-height-cm", "14"))],
)
def test_the_lights_of_a_ball_serve_to_reconstruct_its_surface(
    capsys, tmp_path, ball, name, options
):
    """First the ball, then the lights of other photographs."""
    photographs, mask, (x, y) = ball
    out, result = tmp_path / name, tmp_path / "result"
    words = ("--sphere", "grey", "--images", photographs, "--mask", mask, "--out", out, *options)
    printed = words_of(capsys, "calibrate", "lights", *words)
    assert "encoding srgb is assumed of the .jpg files (--encoding changes it)" in printed
    assert f"splitknit reconstruct --images PHOTOS --lights {out}" in printed
    lights = "--rig" if name == "rig.json" else "--lights", out
    scale = "--px-per-mm", default_rig(0.2).camera.px_per_mm
    surface = "--images", photographs, "--mask", mask, *lights, *scale, "--out", result
    words_of(capsys, "reconstruct", *surface)
    with np.load(result / "height.npz") as arrays:
        normals = arrays["normals"].astype(float)
    truth = np.stack([x, y, np.sqrt(np.clip(1 - x * x - y * y, 0, 1))], axis=-1)
    middle = np.hypot(x, y) < 0.7
    errors = np.degrees(np.arccos(np.clip((normals * truth).sum(axis=-1)[middle], -1, 1)))
    assert errors.mean() < 3.6  # near LEDs taken as distant seem 2.4 deg further out
    # a list of lights is replaced by another one only
    assert run(capsys, *words)[0] == 0
    (tmp_path / "words.txt").write_text("mine")
    assert "not a list of lights" in refused(capsys, *words[:7], tmp_path / "words.txt")


def test_a_misplaced_mask_is_replaced_by_the_rim_of_the_ball(capsys, tmp_path, ball):
    photographs, mask, _ = ball
    words = ("--sphere", "grey", "--images", photographs, "--mask")
    sound = facts_with(capsys, *words, mask)
    beside = np.roll(cv2.imread(str(mask), cv2.IMREAD_GRAYSCALE), 5, axis=1)
    write_image(tmp_path / "mask.png", beside)
    corrected = facts_with(capsys, *words, tmp_path / "mask.png")
    assert [finding["code"] for finding in sound["findings"]] == ["assumed-encoding"]
    (finding,) = (each for each in corrected["findings"] if each not in sound["findings"])
    assert finding["code"] == "corrected-mask"
    assert "the outline lies 5" in finding["message"] and "deg off" in finding["message"]
    for led, known in zip(corrected["leds"], sound["leds"], strict=True):
        assert math.degrees(math.dist(led["direction"], known["direction"])) < 0.3


@pytest.mark.parametrize("name", ["a.txt", "a.lp", "a.dome"])
def test_a_list_of_lights_replaces_another_one_only(name, tmp_path):
    write_light_list(default_rig().leds[:7], tmp_path / name, [f"{k}.png" for k in range(7)])
    check_lights_file(tmp_path / name)
    (tmp_path / name).write_text("mine")
    with bad_input("not a list of lights"):
        check_lights_file(tmp_path / name)


def test_a_list_of_lights_of_two_bands_is_refused(capsys, tmp_path):
    table = cast_table(tmp_path / "tips.csv", [(-6, -4), (6, 5), (6, -4)])
    message = refused(capsys, "--table", table, *GOOD, "--out", tmp_path / "lights.txt")
    assert "2 bands" in message and "rig.json" in message and list(tmp_path.iterdir()) == [table]


@pytest.mark.slow
def test_exchanged_photographs_are_refused_and_shown(capsys, tmp_path, nail_photographs):
    """Those of two LEDs, in one position of the nail."""
    folder, _ = nail_photographs
    copy = tmp_path / "copy"
    shutil.copytree(folder / "photographs", copy)
    first, second = copy / "nail_10" / "white_1.png", copy / "nail_10" / "white_4.png"
    second.rename(copy / "kept.png")
    first.rename(second)
    (copy / "kept.png").rename(first)
    words = "--images", copy, "--rig", folder / "nominal.json", "--out", tmp_path / "rig.json"
    code, printed, message = run(capsys, *words, "--method", "circle", "--json")
    assert code == 2 and message.count("\n") == 1
    assert "white 1" in message and "white 4" in message and "white 2" not in message
    facts = json.loads(printed)
    assert facts["show"] in message
    assert Path(facts["show"]).is_file() and Path(facts["tips_out"]).is_file()
    assert not (tmp_path / "rig.json").exists()
