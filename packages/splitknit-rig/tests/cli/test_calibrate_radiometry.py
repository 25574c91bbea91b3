"""``splitknit calibrate radiometry``: a folder in, a rig or a verdict out, one sentence where it
cannot."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from small_capture import edit, repaint
from splitknit.cli.main import main
from splitknit.io.images import read_image, write_image
from splitknit.io.rig import read_rig, write_rig
from splitknit_simulator.rigs import built_rig
from white_cards import as_placed, card_folder

SCALE = 0.08


@pytest.fixture(scope="module")
def card(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("card") / "card"
    card_folder(folder, seed=2, scale=SCALE)
    return folder


@pytest.fixture(scope="module")
def calibrated(card: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("rigs") / "rig.json"
    assert run(card, "--out", out) == 0
    return out


@pytest.fixture
def own(card: Path, tmp_path: Path) -> Path:
    """A copy of the folder to change."""
    return Path(shutil.copytree(card, tmp_path / "own"))


def run(*words: Any) -> int:
    return main(["calibrate", "radiometry", *map(str, words)])


def refusal(capsys: pytest.CaptureFixture[str], *words: Any) -> str:
    """Return the one sentence with which a run is refused."""
    capsys.readouterr()
    assert run(*words) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("splitknit: error: ")
    assert printed.err.count("\n") == 1
    return printed.err


@pytest.mark.slow
def test_a_rig_is_calibrated(
    card: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig_file, out, picture = (
        tmp_path / "placed.json",
        tmp_path / "new" / "rig.json",
        tmp_path / "residuals.png",
    )
    write_rig(as_placed(built_rig(2, scale=SCALE)), rig_file)
    assert run(card, "--rig", rig_file, "--out", out, "--residuals", picture, "--json") == 0
    printed = capsys.readouterr()
    facts = json.loads(printed.out)
    assert printed.err == ""
    truth = built_rig(2, scale=SCALE)
    rig = read_rig(out)
    scale = np.mean([led.intensity for led in truth.leds[:7]]) / np.mean(
        [led.intensity for led in rig.leds[:7]]
    )
    for led, true in zip(rig.leds[:7], truth.leds[:7], strict=True):
        assert led.intensity * scale == pytest.approx(true.intensity, rel=0.02)
        assert led.lobe_exponent == pytest.approx(true.lobe_exponent, abs=0.6)
        assert np.rad2deg(np.arccos(led.axis @ true.axis)) < 1
    assert sum(rig.camera.shading) == pytest.approx(sum(truth.camera.shading), abs=0.02)
    stored = rig.provenance["radiometry"]
    assert stored["response"]["encoding"] == "linear" == facts["response"]["encoding"]
    assert set(stored["inputs"]) >= {"white_0.png", "nir_6.png", "step_3.png", "radiometry.json"}
    assert facts["files"] == [str(out), str(picture)]
    assert facts["findings"] == []
    shown = read_image(picture)
    assert shown.shape[2] == 3 and shown.shape[1] > 3 * shown.shape[0]


@pytest.mark.slow
def test_the_base_lies_as_the_camera_found_it(
    card: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def tilt_of(deviation: float, *words: Any) -> Any:
        plane = {"tilt_xy_deg": [0.3, -0.2], "tilt_deg_deviation": deviation}
        rig = replace(
            as_placed(built_rig(2, scale=SCALE)),
            provenance={"camera": {"residuals": {"plane": plane}}},
        )
        write_rig(rig, tmp_path / "placed.json")
        assert (
            run(
                card,
                "--rig",
                tmp_path / "placed.json",
                "--out",
                tmp_path / "rig.json",
                "--json",
                *words,
            )
            == 0
        )
        return json.loads(capsys.readouterr().out)["card"]["tilt_deg"]

    assert tilt_of(0.1) == [0.3, -0.2]
    assert tilt_of(0.2) == [0, 0]
    assert tilt_of(0.1, "--card-tilt-deg", "0,0.1") == [0, 0.1]


@pytest.mark.slow
def test_same_folder_same_bytes(card: Path, calibrated: Path, tmp_path: Path) -> None:
    assert run(card, "--out", tmp_path / "rig.json") == 0
    assert (tmp_path / "rig.json").read_bytes() == calibrated.read_bytes()


def test_a_later_card(
    card: Path, calibrated: Path, own: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(card, "--check", calibrated) == 0
    assert "All LEDs are as calibrated, within 3 %." in capsys.readouterr().out
    repaint(own / "white_3.png", lambda pixels: (pixels * 0.88).astype(pixels.dtype))
    before = calibrated.read_bytes()
    assert run(own, "--check", calibrated) == 0
    assert (
        "Please note: LED white 3 is 12 % darker than at the calibration."
        in capsys.readouterr().out
    )
    assert run(own, "--check", calibrated, "--json") == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["verdict"] == "drifted"
    assert facts["leds"][3]["own_ratio"] == pytest.approx(0.88, abs=0.005)
    assert run(own, "--check", calibrated, "--limit", 15, "--json") == 0
    assert json.loads(capsys.readouterr().out)["verdict"] == "as calibrated"
    assert calibrated.read_bytes() == before


@pytest.mark.slow
def test_srgb_files_must_say_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from splitknit_simulator.camera.sensor import SensorSettings

    folder = tmp_path / "srgb"
    card_folder(folder, seed=2, scale=SCALE, sensor=SensorSettings(encoding="srgb"))
    assert run(folder, "--out", tmp_path / "rig.json") == 0
    edit(folder / "capture.json", lambda document: document.update(encoding="linear"))
    printed = refusal(capsys, folder, "--out", tmp_path / "other.json")
    assert (
        'are sRGB, but capture.json states "encoding": "linear"; write "encoding": "srgb"'
        in printed
    )
    assert not (tmp_path / "other.json").exists()


def test_processed_pictures_are_refused(
    own: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def contrast(pixels: Any) -> Any:
        light = pixels / 65535
        return np.round(65535 * (light - 0.03 * np.sin(2 * np.pi * light))).astype(np.uint16)

    for k in range(4):
        repaint(own / f"step_{k}.png", contrast)
    printed = refusal(capsys, own, "--out", tmp_path / "rig.json")
    assert "neither linear" in printed and "switch off the camera's picture processing" in printed
    assert "radiometry.json" in printed


@pytest.mark.slow
def test_the_card_alone_will_do(
    own: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (own / "radiometry.json").unlink()
    assert run(own, "--out", tmp_path / "rig.json", "--json") == 0
    assert json.loads(capsys.readouterr().out)["response"] is None


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"darks": "dark.png"}, "unknown field darks"),
        ({"version": 2}, "version: Expected int <= 1"),
        ({"format": "splitknit-rig"}, "format: Expected splitknit-radiometry"),
        (
            {"exposures": [{"file": "step_0.png", "exposure_s": 1}]},
            "names 1 images, but at least 4",
        ),
        (
            {"exposures": [{"file": f"step_{k}.png"} for k in range(4)]},
            "exposures[0]: Object missing required field exposure_s",
        ),
        (
            {"exposures": [{"file": f"step_{k}.png", "exposure_s": 1 + k // 2} for k in range(4)]},
            "2 different exposures",
        ),
    ],
)
def test_documents_that_are_wrong(
    own: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], change: Any, sentence: str
) -> None:
    write_image(own / "small.png", np.zeros((8, 9), dtype=np.uint8))
    edit(own / "radiometry.json", lambda document: document.update(change))
    assert sentence in refusal(capsys, own, "--out", tmp_path / "rig.json")
    assert not (tmp_path / "rig.json").exists()


def test_words_that_are_wrong(
    card: Path, calibrated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "rig.json"
    assert "is not a capture folder" in refusal(capsys, tmp_path, "--out", out)
    assert "does not exist" in refusal(capsys, tmp_path / "none", "--out", out)
    assert "is a folder" in refusal(capsys, card, "--out", tmp_path)
    assert "must end in .png" in refusal(capsys, card, "--out", out, "--residuals", "a.gif")
    assert "no radiometric calibration" in refusal(capsys, card, "--check", card / "rig.json")
    assert "--card-height-mm does not go with --check" in refusal(
        capsys, card, "--check", calibrated, "--card-height-mm", 1
    )
    for words in (
        [],
        ["--out", out, "--check", calibrated],
        ["--out", out, "--limit", "-1"],
        ["--out", out, "--card-tilt-deg", "1"],
        ["--out", out, "--card-height-mm", "nan"],
    ):
        assert run(card, *words) == 2
        assert capsys.readouterr().err.startswith("splitknit: error: ")
    assert not out.exists()
