"""OpenCV's calibration photographs: corners, matrix and errors as its own files have them."""

import json
import re

import numpy as np
import pytest

from splitknit.cli.main import main
from splitknit.io.images import read_image
from splitknit.io.rig import read_rig
from splitknit_rig.calibration.targets import Board, find_board

pytestmark = pytest.mark.external


@pytest.fixture(scope="module")
def folder(data_dir):
    place = data_dir / "chessboard"
    if not place.is_dir():
        pytest.skip(f"{place} is absent")
    return place


def focal_length(folder, name):
    """First number of a matrix in one of OpenCV's files."""
    data = re.search(
        rf"{name}:.*?data: \[ ([\d.e+-]+),", (folder / "intrinsics.yml").read_text(), re.DOTALL
    )
    return float(data.group(1))


def test_the_left_camera(folder, tmp_path, capsys):
    out = tmp_path / "rig.json"
    words = [
        *f"calibrate camera {folder} --pattern".split(),
        "left*.jpg",
        "--board",
        "9x6",
        "--square-mm",
        "25",
    ]
    assert main([*words, "--out", str(out), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    fit = facts["fit"]
    assert fit["images"] == 13
    assert fit["rms_px"] <= 0.20
    assert max(fit["per_image_px"].values()) < 0.30
    assert fit["rejected_px"] == {}
    assert fit["fitted"][:2] == ["k1", "k2"]
    assert "k3" in fit["held"]
    # the file is of a pair of cameras that share one focal length, which the right one's
    # photographs raise
    assert fit["focal_length_px"][0] == pytest.approx(focal_length(folder, "M1"), rel=0.005)
    assert abs(fit["focal_length_px"][0] / focal_length(folder, "M1") - 1) < 0.0035
    camera = read_rig(out).camera
    assert camera.model == "perspective"
    assert camera.image_size == (480, 640)
    assert np.asarray(camera.matrix)[0, 0] == fit["focal_length_px"][0]


@pytest.mark.slow
def test_part_of_a_board_is_not_the_board(folder):
    """OpenCV finds 8 x 6 corners in a board of 9 x 6; a calibration with them would be one square
    off in places."""
    pixels = read_image(folder / "left01.jpg")
    assert find_board(pixels, Board(9, 6, 25.0)) is not None
    assert find_board(pixels, Board(8, 6, 25.0)) is None


@pytest.mark.slow
def test_the_right_camera_and_the_wrong_board(folder, tmp_path, capsys):
    out = tmp_path / "rig.json"
    words = [
        *f"calibrate camera {folder} --pattern".split(),
        "right*.jpg",
        "--square-mm",
        "25",
        "--out",
        str(out),
    ]
    # a board that is named the other way round is the same
    assert main([*words, "--board", "6x9", "--json"]) == 0
    fit = json.loads(capsys.readouterr().out)["fit"]
    assert fit["images"] >= 12
    assert fit["rms_px"] <= 0.20
    assert fit["focal_length_px"][0] == pytest.approx(focal_length(folder, "M2"), rel=0.005)
    out.unlink()
    assert main([*words, "--board", "8x5"]) == 2
    message = capsys.readouterr().err
    assert (
        "a checkerboard of 8x5 inner corners is in full view in 0 of" in message
        and "compare --board" in message
    )
    assert not out.exists()
