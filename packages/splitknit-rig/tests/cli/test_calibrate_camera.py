"""``splitknit calibrate camera`` on photographs of a rig of the twin: files in, a rig file out, or
one sentence."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from enrolled import facts_of, refusal_of, words_of
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


@pytest.fixture(scope="session")
def photos(tmp_path_factory):
    """Folder `boards` of photographs by hand, plane.png, plane2.png, oblique.png; and the rig that
    took them."""
    place = tmp_path_factory.mktemp("photos")
    (place / "boards").mkdir()
    rig = built_rig(SEED, scale=SCALE)

    def write(name, number, **pose):
        scene = flat.BoardScene(camera=rig.camera, leds=rig.leds, board=PRINTED, **pose)
        image = bench.photograph_bench(
            scene, LIT, number, exposure=bench.well_exposed(scene, [LIT])
        )
        write_image(place / f"{name}.png", image)

    for k, pose in enumerate(flat.board_poses(SEED, COUNT, rig.camera, PRINTED)):
        write(f"boards/{k}", k, **pose)
    tilt = rig.provenance["base_tilt_deg"]
    for number, name, tilt_deg in (
        (100, "plane", tilt),
        (101, "plane2", tilt),
        (102, "oblique", (2.0, 0.0)),
    ):
        write(name, number, rotation_vector=(*np.deg2rad(tilt_deg), 0.0))
    return place, rig


def facts(capsys, command, *words):
    return facts_of(capsys, f"calibrate camera {command}", *words)


def refused(capsys, out, command="", *words):
    """The one sentence with which a command is refused; nothing is written."""
    message = refusal_of(capsys, f"calibrate camera {command}", *words, "--out", out)
    assert message.startswith("splitknit: error: ")
    assert not out.exists()
    return message


@pytest.fixture
def known(photos, tmp_path):
    """File of the rig that took the photographs."""
    write_rig(photos[1], tmp_path / "known.json")
    return tmp_path / "known.json"


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


def test_the_camera_that_took_the_photographs_is_measured(photos, calibrated):
    _, rig = photos
    stated, out = calibrated
    measured, true = read_rig(out).camera, rig.camera
    assert measured.model == "perspective"
    assert measured.image_size == true.image_size
    assert measured.matrix[0, 0] == pytest.approx(true.matrix[0, 0], rel=0.003)
    assert np.abs(measured.matrix[:2, 2] - true.matrix[:2, 2]).max() < 0.004 * true.image_size[1]
    assert measured.px_per_mm == pytest.approx(true.px_per_mm, rel=0.001)
    assert measured.height_mm == pytest.approx(true.height_mm, rel=0.003)
    assert measured.matrix[0, 0] / measured.height_mm == pytest.approx(measured.px_per_mm)
    tilt = np.array(rig.provenance["base_tilt_deg"])
    assert np.abs(np.array(stated["plane"]["tilt_xy_deg"]) - tilt).max() < 0.1
    assert abs(measured.matrix[0, 0] - true.matrix[0, 0]) < 4 * stated["fit"]["deviations"]["fx"]


def test_the_rig_file_states_what_was_measured(calibrated):
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


def test_the_summary_is_printed_and_the_rest_of_the_rig_kept(photos, tmp_path, capsys):
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
    words = "--rig", before, "--plane", place / "plane.png", "--out", out
    printed = words_of(capsys, f"calibrate camera {folder}", *words)
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
    assert "`plane`" not in refused(capsys, out, f"--plane {place}/plane.png")
    write_rig(replace(rig, camera=replace(rig.camera, height_mm=150.0, px_per_mm=11.0)), moved)
    stated = facts(capsys, f"--plane {place}/plane.png --rig {moved} --out {out}")
    assert stated["height_mm"] == pytest.approx(rig.camera.height_mm, rel=1e-3)
    assert stated["px_per_mm"] == pytest.approx(rig.camera.px_per_mm, rel=1e-3)
    assert np.array_equal(stated["matrix"], rig.camera.matrix)
    assert stated["measured"] == ["camera.px_per_mm", "camera.height_mm"]


def test_an_oblique_camera_gets_a_finding(photos, known, tmp_path, capsys):
    place, _ = photos
    words = "--plane", place / "oblique.png", "--rig", known, "--out", tmp_path / "rig.json"
    stated = facts(capsys, *words)
    assert stated["plane"]["tilt_xy_deg"] == pytest.approx([2.0, 0.0], abs=0.1)
    assert stated["plane"]["nearer_at"] == "top"
    oblique = stated["findings"][-1]
    assert oblique["code"] == "oblique-camera"
    assert "obliquely by 2.0" in oblique["message"]
    assert "8 mm high leans by 0.28 mm" in oblique["message"]
    disagreeing = facts(capsys, *words, "--plane", place / "plane.png")["findings"][0]
    assert (disagreeing["code"], disagreeing["severity"]) == ("planes-disagree", "doubt")


def test_a_height_that_was_not_measured_gets_a_finding(photos, tmp_path, capsys):
    place, rig = photos
    stated = facts(capsys, f"{place}/boards --out {tmp_path}/rig.json")
    assert stated["nominal"] == ["camera.px_per_mm", "camera.height_mm", "leds"]
    assert stated["height_mm"] == 140.0
    assert stated["px_per_mm"] == pytest.approx(rig.camera.matrix[0, 0] / 140, rel=0.003)
    assert "unmeasured-height" in [finding["code"] for finding in stated["findings"]]


def test_photographs_in_capture_folders_are_chosen_by_a_pattern(photos, tmp_path, capsys):
    place, _ = photos
    for k, file in enumerate(sorted((place / "boards").glob("*.png"))):
        (tmp_path / f"board_{k}").mkdir()
        shutil.copy(file, tmp_path / f"board_{k}" / "white_0.png")
        shutil.copy(place / "boards" / "0.png", tmp_path / f"board_{k}" / "white_1.png")
    plain, inside = tmp_path / "plain.json", tmp_path / "inside.json"
    facts(capsys, f"{place}/boards --out {plain}")
    stated = facts(capsys, f"{tmp_path} --pattern", "board_*/white_0.png", "--out", inside)
    np.testing.assert_array_equal(read_rig(inside).camera.matrix, read_rig(plain).camera.matrix)
    assert "board_3/white_0.png" in str(stated)


def test_folders_without_enough_photographs_are_refused(photos, tmp_path, capsys):
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
    (few / "9.png").write_bytes((few / "9.png").read_bytes()[:50])  # what its header states
    assert "9.png has 100 x 200 pixels (rows x columns), but 0.png has 330 x 480" in refused(
        capsys, out, few
    )


def test_images_and_numbers_that_cannot_be_used_are_refused(photos, known, tmp_path, capsys):
    out, plane = tmp_path / "rig.json", photos[0] / "plane.png"
    grey, black, small = (tmp_path / f"{name}.png" for name in ("grey", "black", "small"))
    write_image(grey, np.tile(np.arange(480, dtype=np.uint8), (330, 1)))
    assert "grey.png shows no checkerboard of 9x6" in refused(capsys, out, f"--plane {grey}")
    assert "does not exist" in refused(capsys, out, f"--plane {tmp_path}/none.png")
    write_image(black, np.zeros((330, 480), np.uint8))
    assert "black.png: an image is of one brightness all over" in refused(
        capsys, out, "--plane", black
    )
    write_image(small, np.zeros((100, 200), np.uint8))
    assert f"but {known} has 330 x 480" in refused(capsys, out, f"--plane {small} --rig {known}")
    assert "such as 9x6" in refused(capsys, out, f"--plane {plane} --board nine")
    assert "side of a square" in refused(capsys, out, f"--plane {plane} --square-mm 0")


def test_a_height_far_from_that_of_the_rig_gets_a_note(photos, known, tmp_path, capsys):
    plane = "--plane", photos[0] / "plane.png", "--square-mm", 6
    words = "calibrate", "camera", *plane, "--rig", known, "--out", tmp_path / "r.json"
    assert "check the side of the board's squares (--square-mm)" in words_of(capsys, *words)
