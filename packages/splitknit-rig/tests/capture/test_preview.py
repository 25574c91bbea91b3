"""The camera while the lens is turned: the twin's picture and its sharpness."""

from __future__ import annotations

from pathlib import Path

import cv2

from splitknit.cli.main import main
from splitknit_rig.capture.openers import opener_of
from splitknit_rig.capture.preview import look_again


def test_it_shows_sharpness_and_picture(tmp_path: Path):
    shown = []
    with opener_of("twin", {}, None, 0.1, target="board")(0, 0) as devices:
        count, best = look_again(
            devices, 2, 1.0, tmp_path / "a.png", lambda *each: shown.append(each)
        )
        assert devices.lights.lit == {2}
    assert len(shown) == count > 1
    assert best == shown[-1][1] == max(sharpness for sharpness, _ in shown) > 0
    picture = cv2.imread(str(tmp_path / "a.png"))
    assert picture.shape[2] == 3
    assert picture.max() > 100
    assert (picture == 255).mean() < 0.05  # the exposure was found


def test_it_is_sharpest_in_focus():
    def sharpness(aperture_mm):
        changes = {"render.aperture_mm": aperture_mm}
        shown = []
        with opener_of("twin", changes, None, 0.2, target="phantom")(0, 0) as devices:
            while len(shown) < 4:
                look_again(devices, 0, 1.0, None, lambda *each: shown.append(each[0]))
        return shown[-1]

    assert sharpness(0.0) > 1.1 * sharpness(20.0)  # half of it below the plane in focus


def test_the_command(tmp_path: Path, capsys):
    words = ["capture", "--device", "twin", "--preview", "--scale", "0.1", "--target", "board"]
    picture = tmp_path / "focus.png"
    assert main([*words, "--seconds", "0.3", "--out", str(picture)]) == 0
    printed = capsys.readouterr()
    assert "sharpness " in printed.err
    assert "pictures, best sharpness" in printed.out
    assert picture.is_file()
    assert main([*words, "--led", "white 99", "--seconds", "0.3"]) == 2
    assert "the rig has no LED 'white 99'" in capsys.readouterr().err
    assert main([*words, "--out", str(tmp_path / "there")]) == 2
    assert "must end in .png or .tif" in capsys.readouterr().err
    assert main([*words, "--enrolment", str(tmp_path / "there")]) == 2
    assert "preview" in capsys.readouterr().err
