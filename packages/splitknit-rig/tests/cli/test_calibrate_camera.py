"""``splitknit calibrate camera`` on photographs of a rig of the twin: files in, a rig file out, or
one sentence."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from splitknit.cli.main import main
from splitknit.io.images import write_image
from splitknit.io.rig import read_rig, write_rig
from splitknit.model import Mirror
from splitknit_rig.calibration.camera_photos import calibrate_to_rig
from splitknit_rig.calibration.targets import Board
from splitknit_simulator.calibration_set import bench, flat
from splitknit_simulator.rigs import built_rig

SCALE, SEED, COUNT = 0.15, 2, 7
PRINTED = flat.PrintedBoard(columns=9, rows=6, square_mm=3.0)
LIT = range(7)


def photograph(scene, number):
    return bench.photograph_bench(scene, LIT, number, exposure=bench.well_exposed(scene, [LIT]))


@pytest.fixture(scope="session")
def photos(tmp_path_factory):
    """Folder `boards` of photographs by hand, plane.png, plane2.png, oblique.png; and the rig that
    took them."""
    place = tmp_path_factory.mktemp("photos")
    (place / "boards").mkdir()
    rig = built_rig(SEED, scale=SCALE)
    common = {"camera": rig.camera, "leds": rig.leds}
    for k, pose in enumerate(flat.board_poses(SEED, COUNT, rig.camera, PRINTED)):
        write_image(
            place / f"boards/{k}.png",
            photograph(flat.BoardScene(**common, board=PRINTED, **pose), k),
        )
    tilt = rig.provenance["base_tilt_deg"]
    turn = (*np.deg2rad(tilt), 0.0)
    write_image(
        place / "plane.png",
        photograph(flat.BoardScene(**common, board=PRINTED, rotation_vector=turn), 100),
    )
    write_image(
        place / "plane2.png",
        photograph(flat.BoardScene(**common, board=PRINTED, rotation_vector=turn), 101),
    )
    slant = (*np.deg2rad((2.0, 0.0)), 0.0)
    write_image(
        place / "oblique.png",
        photograph(flat.BoardScene(**common, board=PRINTED, rotation_vector=slant), 102),
    )
    return place, rig


def run(capsys, *words):
    code = main(["calibrate", "camera", *map(str, words)])
    printed = capsys.readouterr()
    return code, printed.out, printed.err


def refused(capsys, out, *words):
    """The one sentence with which a command is refused; nothing is written."""
    code, printed, message = run(capsys, *words, "--out", out)
    assert (code, printed) == (2, "")
    assert message.startswith("splitknit: error: ")
    assert message.count("\n") == 1
    assert not out.exists()
    return message


def calibrated_once(place, out):
    planes = (place / "plane.png", place / "plane2.png")
    board = Board(9, 6, 3.0)
    return calibrate_to_rig(place / "boards", out, board, plane=planes, calibrated_at="2026-01-02")


@pytest.fixture(scope="module")
def calibrated(photos, tmp_path_factory):
    """Facts and rig of one calibration."""
    place, _ = photos
    out = tmp_path_factory.mktemp("calibrated") / "rig.json"
    return calibrated_once(place, out).facts, out


def test_the_camera_that_took_the_photographs_is_found(photos, calibrated):
    _, rig = photos
    facts, out = calibrated
    found, true = read_rig(out).camera, rig.camera
    assert found.model == "perspective"
    assert found.image_size == true.image_size
    assert found.matrix[0, 0] == pytest.approx(true.matrix[0, 0], rel=0.003)
    assert np.abs(found.matrix[:2, 2] - true.matrix[:2, 2]).max() < 0.004 * true.image_size[1]
    assert found.px_per_mm == pytest.approx(true.px_per_mm, rel=0.001)
    assert found.height_mm == pytest.approx(true.height_mm, rel=0.003)
    assert found.matrix[0, 0] / found.height_mm == pytest.approx(found.px_per_mm)
    tilt = np.array(rig.provenance["base_tilt_deg"])
    assert np.abs(np.array(facts["plane"]["tilt_xy_deg"]) - tilt).max() < 0.1
    assert abs(found.matrix[0, 0] - true.matrix[0, 0]) < 4 * facts["fit"]["deviations"]["fx"]


def test_the_rig_file_says_what_was_measured(calibrated):
    _, out = calibrated
    rig = read_rig(out)
    assert [led.band for led in rig.leds] == ["white"] * 7 + ["nir"] * 7
    origin = rig.provenance["camera"]
    assert origin["measured"] == [
        "camera.matrix",
        "camera.distortion",
        "camera.image_size",
        "camera.px_per_mm",
        "camera.height_mm",
    ]
    assert origin["nominal"] == ["leds"]
    assert origin["calibrated_at"] == "2026-01-02"
    assert origin["software"] == "splitknit"
    assert origin["version"]
    assert len(origin["inputs"]) == COUNT + 2
    assert all(len(digest) == 64 for digest in origin["inputs"].values())
    fit = origin["residuals"]["fit"]
    assert fit["images"] == COUNT == len(fit["per_image_px"])
    assert fit["rejected_px"] == {}
    assert fit["rms_px"] < 0.1
    assert origin["residuals"]["plane"]["per_image"].keys() == {"plane.png", "plane2.png"}


def test_same_photographs_same_bytes(photos, calibrated, tmp_path):
    place, _ = photos
    again = tmp_path / "rig.json"
    calibrated_once(place, again)
    assert again.read_bytes() == calibrated[1].read_bytes()


def test_words_for_people_and_a_rig_that_is_kept(photos, tmp_path, capsys):
    place, rig = photos
    before = tmp_path / "before.json"
    face = ((12.0, -10.0, -15.0), (12.0, 20.0, -15.0), (26.0, 20.0, -1.0), (26.0, -10.0, -1.0))
    mirrors = (Mirror("right", face, 0.85),)
    camera = replace(rig.camera, height_mm=150.0)
    old = replace(rig, camera=camera, provenance={"lights": {"method": "nail"}}, mirrors=mirrors)
    write_rig(old, before)
    out = tmp_path / "after.json"
    folder = tmp_path / "boards"
    shutil.copytree(place / "boards", folder)
    write_image(folder / "x.png", np.tile(np.arange(480, dtype=np.uint8), (330, 1)))
    words = (folder, "--rig", before, "--plane", place / "plane.png", "--out", out)
    code, printed, message = run(capsys, *words)
    assert (code, message) == (0, "")
    assert f"from {COUNT} of {COUNT + 1} photographs" in printed
    assert "left out: x.png, no board of 9x6 inner corners in full view" in printed
    assert "focal length 15" in printed
    assert "Finger plane: 1" in printed
    assert "deg obliquely; the base comes nearer towards the picture's" in printed
    assert "Taken over: nothing" in printed
    after = read_rig(out)
    assert after.leds == rig.leds and after.mirrors == mirrors
    assert after.camera.shading == rig.camera.shading
    assert after.camera.height_mm == pytest.approx(rig.camera.height_mm, rel=0.003)
    assert after.provenance["lights"] == {"method": "nail"}


def test_the_plane_alone_measures_the_height_again(photos, tmp_path, capsys):
    place, rig = photos
    out, moved = tmp_path / "flat.json", tmp_path / "moved.json"
    assert "`plane`" not in refused(capsys, out, "--plane", place / "plane.png")
    write_rig(replace(rig, camera=replace(rig.camera, height_mm=150.0, px_per_mm=11.0)), moved)
    _, printed, _ = run(
        capsys, "--plane", place / "plane.png", "--rig", moved, "--out", out, "--json"
    )
    facts = json.loads(printed)
    assert facts["height_mm"] == pytest.approx(rig.camera.height_mm, rel=1e-3)
    assert facts["px_per_mm"] == pytest.approx(rig.camera.px_per_mm, rel=1e-3)
    assert np.array_equal(facts["matrix"], rig.camera.matrix)
    assert facts["measured"] == ["camera.px_per_mm", "camera.height_mm"]


def test_an_oblique_camera_is_warned_about(photos, tmp_path, capsys):
    place, rig = photos
    known = tmp_path / "known.json"
    write_rig(rig, known)
    out = tmp_path / "rig.json"
    _, printed, _ = run(
        capsys, "--plane", place / "oblique.png", "--rig", known, "--out", out, "--json"
    )
    facts = json.loads(printed)
    assert facts["plane"]["tilt_xy_deg"] == pytest.approx([2.0, 0.0], abs=0.1)
    assert facts["plane"]["nearer_at"] == "top"
    oblique, words = facts["findings"][-1]["code"], facts["findings"][-1]["message"]
    assert oblique == "oblique-camera"
    assert "obliquely by 2.0" in words and "8 mm high leans by 0.28 mm" in words
    _, printed, _ = run(
        capsys,
        "--plane",
        place / "oblique.png",
        "--plane",
        place / "plane.png",
        "--rig",
        known,
        "--out",
        out,
        "--json",
    )
    findings = json.loads(printed)["findings"]
    assert findings[0]["code"] == "planes-disagree"
    assert findings[0]["severity"] == "doubt"


def test_a_height_that_was_not_measured_is_said(photos, tmp_path, capsys):
    place, rig = photos
    out = tmp_path / "rig.json"
    _, printed, _ = run(capsys, place / "boards", "--out", out, "--json")
    facts = json.loads(printed)
    assert facts["nominal"] == ["camera.px_per_mm", "camera.height_mm", "leds"]
    assert facts["height_mm"] == 140.0
    assert facts["px_per_mm"] == pytest.approx(rig.camera.matrix[0, 0] / 140, rel=0.003)
    assert "unmeasured-height" in [finding["code"] for finding in facts["findings"]]


def test_photographs_in_capture_folders_are_taken_by_their_pattern(photos, tmp_path, capsys):
    place, _ = photos
    for k, file in enumerate(sorted((place / "boards").glob("*.png"))):
        (tmp_path / f"board_{k}").mkdir()
        shutil.copy(file, tmp_path / f"board_{k}" / "white_0.png")
        shutil.copy(place / "boards" / "0.png", tmp_path / f"board_{k}" / "white_1.png")
    plain, inside = tmp_path / "plain.json", tmp_path / "inside.json"
    run(capsys, place / "boards", "--out", plain, "--json")
    _, printed, _ = run(
        capsys, tmp_path, "--pattern", "board_*/white_0.png", "--out", inside, "--json"
    )
    np.testing.assert_array_equal(read_rig(inside).camera.matrix, read_rig(plain).camera.matrix)
    assert "board_3/white_0.png" in printed


def test_folders_that_do_not_do(photos, tmp_path, capsys):
    place, _ = photos
    out = tmp_path / "rig.json"
    empty = tmp_path / "empty"
    empty.mkdir()
    (empty / "notes.txt").write_text("no image")
    assert "holds no images" in refused(capsys, out, empty)
    assert "is not a folder" in refused(capsys, out, tmp_path / "nowhere")
    assert "fits the pattern 'left*' (7 images are there)" in refused(
        capsys, out, place / "boards", "--pattern", "left*"
    )
    assert "there is nothing to calibrate from" in refused(capsys, out)
    few = tmp_path / "few"
    few.mkdir()
    for k in range(4):
        shutil.copy(place / f"boards/{k}.png", few)
    assert "in full view in 4 of 4 photographs, but 5 are needed" in refused(capsys, out, few)
    for k in range(4, 8):
        shutil.copy(place / "boards/0.png", few / f"{k}.png")
    assert "only 4 of 8 photographs of the board can be used (4 of them twice)" in refused(
        capsys, out, few
    )
    (few / "9.png").write_bytes(b"not a picture")
    assert "9.png is not a PNG, TIFF or JPEG image" in refused(capsys, out, few)
    (few / "9.png").unlink()
    write_image(few / "9.png", np.zeros((100, 200), np.uint8))
    assert "9.png has 100 x 200 pixels (rows x columns), but 0.png has 330 x 480" in refused(
        capsys, out, few
    )


def test_images_and_numbers_that_do_not_do(photos, tmp_path, capsys):
    place, rig = photos
    out, plane, known = tmp_path / "rig.json", place / "plane.png", tmp_path / "known.json"
    write_rig(rig, known)
    grey, black, small = (tmp_path / f"{name}.png" for name in ("grey", "black", "small"))
    write_image(grey, np.tile(np.arange(480, dtype=np.uint8), (330, 1)))
    assert "grey.png shows no checkerboard of 9x6" in refused(capsys, out, "--plane", grey)
    assert "does not exist" in refused(capsys, out, "--plane", tmp_path / "none.png")
    write_image(black, np.zeros((330, 480), np.uint8))
    assert "black.png: an image is of one brightness all over" in refused(
        capsys, out, "--plane", black
    )
    write_image(small, np.zeros((100, 200), np.uint8))
    assert f"but {known} has 330 x 480" in refused(capsys, out, "--plane", small, "--rig", known)
    assert "such as 9x6" in refused(capsys, out, "--plane", plane, "--board", "nine")
    assert "side of a square" in refused(capsys, out, "--plane", plane, "--square-mm", 0)


def test_a_height_far_from_the_rigs_is_noted(photos, tmp_path, capsys):
    place, rig = photos
    known = tmp_path / "known.json"
    write_rig(rig, known)
    _, printed, _ = run(
        capsys,
        "--plane",
        place / "plane.png",
        "--square-mm",
        6,
        "--rig",
        known,
        "--out",
        tmp_path / "r.json",
    )
    assert "check the side of the board's squares (--square-mm)" in printed
