"""``splitknit calibrate lights``: what it prints, writes, refuses, and in which words."""

from __future__ import annotations

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from splitknit.cli.main import main
from splitknit.imaging.band import srgb_code
from splitknit.io.images import read_image, write_image
from splitknit.io.rig import read_rig, write_rig
from splitknit.model import Mirror, default_rig, nominal_rig
from splitknit_simulator.calibration_set.bench import photograph_bench, well_exposed
from splitknit_simulator.calibration_set.solids import NailScene, SphereScene
from splitknit_simulator.rigs import built_rig, with_side_lights

THESIS = Path(__file__).resolve().parents[4] / "examples" / "thesis_tips.csv"
RIG = (
    *("--px-per-cm", "757", "--led-height-cm", "14", "--led-radius-cm", "5"),
    *("--led-centre-px", "1575,1174", "--image-size", "2200,3200"),
)
MIRROR = Mirror(
    "right",
    ((12.0, -10.0, -15.0), (12.0, 20.0, -15.0), (26.0, 20.0, -1.0), (26.0, -10.0, -1.0)),
    0.85,
)
GOOD = (
    *("--px-per-cm", "757", "--led-height-cm", "14", "--led-radius-cm", "5.25"),
    "--image-size",
    "2200,3200",
)


def cast_table(path: Path, places, *, height=15.0, bands=("white", "nir"), skip=()) -> Path:
    """Shadows of the drawn rig by hand."""
    lines = ["band,led,nail,nail_x_px,nail_y_px,tip_x_px,tip_y_px"]
    for k, led in enumerate(default_rig().leds):
        for number, place in enumerate(np.asarray(places, float), start=1):
            if led.band not in bands or (led.band, k % 7, number) in skip:
                continue
            at = np.asarray(led.position_mm)
            end = at[:2] + (place - at[:2]) * at[2] / (at[2] - height)
            pixels = [(1599.5 + 75.7 * x, 1099.5 - 75.7 * y) for x, y in (place, end)]
            lines.append(
                f"{led.band},{k % 7},{number},{pixels[0][0]},{pixels[0][1]},{pixels[1][0]},{pixels[1][1]}"
            )
    path.write_text("\n".join(lines) + "\n")
    return path


def run(capsys, *words) -> tuple[int, str, str]:
    code = main(["calibrate", "lights", *map(str, words)])
    out, err = capsys.readouterr()
    return code, out, err


def refused(capsys, *words) -> str:
    code, out, err = run(capsys, *words)
    assert code == 2, err
    assert out == ""
    assert err.startswith("splitknit: error: ") and err.count("\n") == 1
    return err


def test_the_thesiss_table_is_refused(capsys, tmp_path):
    out = tmp_path / "rig.json"
    message = refused(capsys, "--table", THESIS, *RIG, "--out", out)
    for name in (
        "white 0",
        "white 2",
        "white 5",
        "white 6",
        *(f"NIR {k}" for k in range(7)),
        "--keep",
    ):
        assert name in message
    assert "white 1" not in message
    assert list(tmp_path.iterdir()) == []


def test_the_facts_are_printed_all_the_same(capsys, tmp_path):
    code, out, err = run(capsys, "--table", THESIS, *RIG, "--out", tmp_path / "rig.json", "--json")
    assert code == 2 and err.count("\n") == 1
    facts = json.loads(out)
    assert (
        facts["method"] == "circle" and facts["written"] is False and list(tmp_path.iterdir()) == []
    )
    verdicts = [one["verdict"] for one in facts["leds"]]
    assert [verdicts.count(word) for word in ("ok", "disagrees", "copied")] == [3, 5, 6]
    names = [(one["band"], one["led"]) for one in facts["leds"]]
    assert names == [(band, k) for band in ("white", "nir") for k in range(7)]
    for one in facts["leds"]:
        assert np.linalg.norm(one["direction"]) == pytest.approx(1.0)
        assert one["direction"][2] > 0.9
        assert one["kept"] == (one["verdict"] == "ok")
    assert facts["leds"][0]["disagreement_deg"] == pytest.approx(8.94, abs=0.005)


def test_keep_keeps_both_kinds(capsys, tmp_path):
    out = tmp_path / "rig.json"
    code, printed, _ = run(capsys, "--table", THESIS, *RIG, "--out", out, "--keep", "--json")
    facts = json.loads(printed)
    assert code == 0 and facts["written"] and all(one["kept"] for one in facts["leds"])
    rig = read_rig(out)
    assert (
        len(rig.leds) == 14
        and rig.camera.px_per_mm == 75.7
        and rig.camera.image_size == (2200, 3200)
    )
    for led, one in zip(rig.leds, facts["leds"], strict=True):
        assert led.band == one["band"] and led.position_mm == pytest.approx(one["position_mm"])
    verdicts = [one["verdict"] for one in rig.provenance["lights"]["leds"]]
    assert verdicts.count("copied") == 6 and verdicts.count("disagrees") == 5


def test_a_good_table(capsys, tmp_path):
    table = cast_table(tmp_path / "tips.csv", [(-6, -4), (6, 5)])
    code, printed, err = run(capsys, "--table", table, *GOOD, "--out", tmp_path / "rig.json")
    assert code == 0 and err == "" and "ok" in printed and "15.0 mm" in printed
    found = read_rig(tmp_path / "rig.json")
    for led, truth in zip(found.leds, default_rig().leds, strict=True):
        assert led.band == truth.band and led.position_mm == pytest.approx(
            truth.position_mm, abs=1e-3
        )


def test_several_positions_are_fitted_together(capsys, tmp_path):
    table = cast_table(tmp_path / "tips.csv", [(-6, -4), (6, 5), (6, -4)], skip={("nir", 2, 1)})
    code, printed, _ = run(capsys, "--table", table, *GOOD, "--json")
    facts = json.loads(printed)
    assert code == 0 and facts["method"] == "joint" and facts["written"] is False
    assert facts["nail_height_mm"] == pytest.approx(15.0, abs=0.01)
    for one, truth in zip(facts["leds"], default_rig().leds, strict=True):
        assert one["position_mm"] == pytest.approx(truth.position_mm, abs=0.01)
        assert 0 < one["interval_deg"] < 1.0 and 0 < one["interval_mm"] < 4.0


def test_a_rig_keeps_what_it_knows(capsys, tmp_path):
    """Camera, intensities and other facts come from the rig, whose LEDs move."""
    table = cast_table(tmp_path / "tips.csv", [(-6, -4), (6, 5)])
    known = replace(default_rig(seed=3), mirrors=(MIRROR,))
    write_rig(known, tmp_path / "old.json")
    code, printed, _ = run(
        capsys,
        "--table",
        table,
        "--rig",
        tmp_path / "old.json",
        "--out",
        tmp_path / "new.json",
        "--json",
    )
    assert code == 0 and json.loads(printed)["method"] == "joint"
    rig = read_rig(tmp_path / "new.json")
    assert [led.intensity for led in rig.leds] == [led.intensity for led in known.leds]
    assert rig.provenance["source"] == known.provenance["source"]
    assert rig.mirrors == known.mirrors


def test_the_same_table_gives_the_same_bytes(capsys, tmp_path):
    table = cast_table(tmp_path / "tips.csv", [(-6, -4), (6, 5), (6, -4)])
    for name in ("a.json", "b.json"):
        assert run(capsys, "--table", table, *GOOD, "--out", tmp_path / name)[0] == 0
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()


def test_geometry(capsys, tmp_path):
    out = tmp_path / "rig.json"
    assert run(capsys, "--geometry", *GOOD, "--out", out)[0] == 0
    for led, truth in zip(read_rig(out).leds, default_rig().leds, strict=True):
        assert led.band == truth.band and led.position_mm == pytest.approx(truth.position_mm)
    write_rig(default_rig(seed=2), tmp_path / "old.json")
    assert (
        run(
            capsys,
            "--geometry",
            "--rig",
            tmp_path / "old.json",
            "--led-radius-cm",
            "5",
            "--out",
            out,
        )[0]
        == 0
    )
    for led, old in zip(read_rig(out).leds, default_rig(seed=2).leds, strict=True):
        assert led.intensity == old.intensity
        assert np.hypot(*led.position_mm[:2]) == pytest.approx(50.0)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--table", THESIS, "--geometry"), "--table and --geometry"),
        (("--table", THESIS), "--px-per-cm and --image-size and --led-height-cm"),
        (
            (
                "--table",
                THESIS,
                "--px-per-cm",
                "757",
                "--image-size",
                "2200,3200",
                "--led-height-cm",
                "14",
            ),
            "--led-radius-cm",
        ),
        (("--table", THESIS, *RIG[:-1], "2200"), "rows,columns"),
        (("--table", THESIS, *RIG[:-1], "1100,1600"), "outside the image"),
        (("--table", "absent.csv", *RIG), "absent.csv"),
        (("--sphere", "grey", *RIG), "--images"),
        (("--geometry", *RIG), "--out"),
    ],
)
def test_bad_input_is_one_sentence(capsys, words, expected):
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
def test_photographs_of_a_nail(capsys, tmp_path, nail_photographs):
    folder, true = nail_photographs
    out = tmp_path / "rig.json"
    words = ("--images", folder / "photographs", "--rig", folder / "nominal.json", "--out", out)
    code, printed, err = run(capsys, *words, "--json")
    assert code == 0, err
    facts = json.loads(printed)
    assert facts["method"] == "joint" and facts["nail_positions"] == 2
    assert len(read_rig(out).leds) == 14
    for led, truth in zip(read_rig(out).leds[:7], true.leds[:7], strict=True):
        found, known = (
            np.array(one.position_mm) / np.linalg.norm(one.position_mm) for one in (led, truth)
        )
        assert np.degrees(np.linalg.norm(found - known)) < 0.6
        assert led.lobe_exponent > 0
    assert read_image(facts["show"]).shape[2] == 3
    # what was found goes in again as a table, and gives the same
    again = run(capsys, "--table", facts["tips_out"], "--rig", folder / "nominal.json", "--json")
    for one, other in zip(json.loads(again[1])["leds"], facts["leds"], strict=True):
        assert one["direction"] == pytest.approx(other["direction"], abs=2e-3)


def test_photographs_that_are_wrong(capsys, tmp_path, nail_photographs):
    folder, _ = nail_photographs
    copy = tmp_path / "copy"
    shutil.copytree(folder / "photographs", copy)
    words = ("--images", copy, "--rig", folder / "nominal.json", "--out", tmp_path / "rig.json")
    lit = read_image(copy / "nail_2" / "white_4.png")
    write_image(copy / "nail_2" / "white_4.png", np.full_like(lit, 90))
    assert "white_4.png shows no shadow" in refused(capsys, *words)
    (copy / "nail_2" / "white_4.png").unlink()
    assert "lacks the image white_4" in refused(capsys, *words)
    write_image(copy / "nail_2" / "white_4.png", lit[:-4])
    assert "white_4.png has 216 x 320 pixels" in refused(capsys, *words)
    assert not (tmp_path / "rig.json").exists()
    assert "is not a folder" in refused(capsys, "--images", tmp_path / "absent", *words[2:])


@pytest.mark.slow
def test_a_ball_places_side_lights_where_they_are(capsys, tmp_path):
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
    edge = scene.outline_px()
    rows, columns = np.mgrid[:440, :640]
    inside = (
        np.hypot(columns - edge[:, 0].mean(), rows - edge[:, 1].mean()) < np.ptp(edge[:, 0]) / 2
    )
    write_image(tmp_path / "mask.png", np.where(inside, 255, 0).astype(np.uint8))
    words = (
        "--sphere",
        "grey",
        "--images",
        tmp_path / "ball",
        "--mask",
        tmp_path / "mask.png",
        "--led-height-cm",
        "14",
    )
    code, _, err = run(
        capsys, *words, "--rig", tmp_path / "rig.json", "--out", tmp_path / "found.json"
    )
    assert code == 0, err
    for k, led in zip(white, read_rig(tmp_path / "found.json").leds, strict=True):
        assert math.dist(led.position_mm, rig.leds[k].position_mm) < 2.0
    scale = ("--px-per-cm", "151.4", "--image-size", "440,640")
    assert "white_7.png shows a side light" in refused(
        capsys, *words, *scale, "--out", tmp_path / "no.json"
    )
    assert not (tmp_path / "no.json").exists()


def test_a_nail_leaves_side_lights_where_they_are_drawn(capsys, tmp_path):
    rig = with_side_lights(default_rig(), 7)
    write_rig(rig, tmp_path / "rig.json")
    table = cast_table(tmp_path / "tips.csv", [(-6, -4), (7, 5), (5, -6)])
    out = tmp_path / "found.json"
    code, printed, _ = run(capsys, "--table", table, "--rig", tmp_path / "rig.json", "--out", out)
    assert (
        code == 0
        and "the side lights white 7, white 8" in printed
        and "a ball measures them" in printed
    )
    found = read_rig(out).leds
    assert [led.position_mm for led in found[14:]] == [led.position_mm for led in rig.leds[14:]]
    for led, drawn in zip(found[:14], rig.leds, strict=False):
        assert math.dist(led.position_mm, drawn.position_mm) < 0.1


@pytest.fixture(scope="module")
def ball(tmp_path_factory):
    """A ball on the bench, as a camera writes JPEG files of it, its mask, and its outline in
    pixels."""
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
    edge = scene.outline_px()
    column, row = edge.mean(axis=0)
    rows, columns = np.mgrid[:440, :640]
    inside = np.hypot(columns - column, rows - row) < np.ptp(edge[:, 0]) / 2
    write_image(folder / "mask.png", np.where(inside, 255, 0).astype(np.uint8))
    return folder / "ball", folder / "mask.png", edge


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "options"),
    [("lights.txt", ()), ("rig.json", ()), ("places.txt", ("--led-height-cm", "14"))],
)
def test_a_ball_gives_the_lights_of_a_surface(capsys, tmp_path, ball, name, options):
    """First the ball, then the lights of other photographs."""
    photographs, mask, edge = ball
    out, result = tmp_path / name, tmp_path / "result"
    words = ("--sphere", "grey", "--images", photographs, "--mask", mask, "--out", out, *options)
    code, printed, err = run(capsys, *words)
    assert code == 0, err
    assert "encoding srgb is assumed of the .jpg files (--encoding changes it)" in printed
    assert f"splitknit reconstruct --images PHOTOS --lights {out}" in printed
    given = ["--rig" if name == "rig.json" else "--lights", str(out), "--mask", str(mask)]
    given += ["--px-per-mm", f"{default_rig(0.2).camera.px_per_mm}"]
    assert main(["reconstruct", "--images", str(photographs), *given, "--out", str(result)]) == 0
    with np.load(result / "height.npz") as arrays:
        normals = arrays["normals"].astype(float)
    radius = np.ptp(edge[:, 0]) / 2
    column, row = edge.mean(axis=0)
    rows, columns = np.mgrid[:440, :640]
    x, y = (columns - column) / radius, (row - rows) / radius
    truth = np.stack([x, y, np.sqrt(np.clip(1 - x * x - y * y, 0, 1))], axis=-1)
    middle = np.hypot(x, y) < 0.7
    errors = np.degrees(np.arccos(np.clip((normals * truth).sum(axis=-1)[middle], -1, 1)))
    assert errors.mean() < 3.6  # near LEDs taken as distant seem 2.4 deg further out
    # a list of lights is replaced by another one only
    assert run(capsys, *words)[0] == 0
    (tmp_path / "words.txt").write_text("mine")
    assert "not a list of lights" in refused(capsys, *words[:7], tmp_path / "words.txt")


def test_a_mask_beside_the_ball_gives_way_to_its_rim(capsys, tmp_path, ball):
    photographs, mask, _ = ball
    words = ("--sphere", "grey", "--images", photographs, "--mask")
    sound = json.loads(run(capsys, *words, mask, "--json")[1])
    beside = np.roll(cv2.imread(str(mask), cv2.IMREAD_GRAYSCALE), 5, axis=1)
    write_image(tmp_path / "mask.png", beside)
    found = json.loads(run(capsys, *words, tmp_path / "mask.png", "--json")[1])
    assert [finding["code"] for finding in sound["findings"]] == ["assumed-encoding"]
    (mask_found,) = set(map(json.dumps, found["findings"])) - set(
        map(json.dumps, sound["findings"])
    )
    assert json.loads(mask_found)["code"] == "corrected-mask"
    assert "the mask lies 5" in mask_found and "deg off" in mask_found
    for led, known in zip(found["leds"], sound["leds"], strict=True):
        assert math.degrees(math.dist(led["direction"], known["direction"])) < 0.3


def test_a_list_of_lights_is_of_one_band(capsys, tmp_path):
    message = refused(capsys, "--geometry", *GOOD, "--out", tmp_path / "lights.txt")
    assert "2 bands" in message and "rig.json" in message and list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_photographs_that_disagree(capsys, tmp_path, nail_photographs):
    """Two LEDs' photographs exchanged in one position: refused, and the picture says why."""
    folder, _ = nail_photographs
    copy = tmp_path / "copy"
    shutil.copytree(folder / "photographs", copy)
    first, second = copy / "nail_10" / "white_1.png", copy / "nail_10" / "white_4.png"
    second.rename(copy / "kept.png")
    first.rename(second)
    (copy / "kept.png").rename(first)
    words = (
        "--images",
        copy,
        "--rig",
        folder / "nominal.json",
        "--out",
        tmp_path / "rig.json",
        "--method",
        "circle",
    )
    code, printed, message = run(capsys, *words, "--json")
    assert code == 2 and message.count("\n") == 1
    assert "white 1" in message and "white 4" in message and "white 2" not in message
    facts = json.loads(printed)
    assert (
        facts["show"] in message
        and Path(facts["show"]).is_file()
        and Path(facts["tips_out"]).is_file()
    )
    assert not (tmp_path / "rig.json").exists()
