"""``splitknit calibrate radiometry``: a folder in, a rig or a verdict out, one sentence where it
cannot."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from enrolled import facts_of, refusal_of
from small_capture import edit, repaint
from splitknit.cli.main import main
from splitknit.io.images import write_image
from splitknit.io.rig import read_rig, write_rig
from splitknit_simulator.camera.sensor import SensorSettings
from splitknit_simulator.rigs import built_rig
from white_cards import as_placed, card_folder

SCALE = 0.08


@pytest.fixture(scope="module")
def card(tmp_path_factory):
    folder = tmp_path_factory.mktemp("card") / "card"
    card_folder(folder, seed=2, scale=SCALE)
    return folder


@pytest.fixture(scope="module")
def calibrated(card, tmp_path_factory):
    out = tmp_path_factory.mktemp("rigs") / "rig.json"
    assert run(card, "--out", out) == 0
    return out


@pytest.fixture
def own(card, tmp_path):
    """A copy of the folder to change."""
    return Path(shutil.copytree(card, tmp_path / "own"))


def run(*words):
    return main(["calibrate", "radiometry", *map(str, words)])


def refusal(capsys, *words):
    """Return the one sentence with which a run is refused."""
    capsys.readouterr()
    return refusal_of(capsys, "calibrate", "radiometry", *words)


def facts_with(capsys, *words):
    return facts_of(capsys, "calibrate", "radiometry", *words)


@pytest.mark.slow
def test_a_card_calibrates_brightness_beam_and_lens(card, tmp_path, capsys):
    placed, out = tmp_path / "placed.json", tmp_path / "new" / "rig.json"
    truth = built_rig(2, scale=SCALE)
    write_rig(as_placed(truth), placed)
    facts = facts_with(capsys, card, "--rig", placed, "--out", out)
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
    assert facts["out"] == str(out)
    assert facts["findings"] == []


@pytest.mark.slow
def test_the_tilt_of_the_base_comes_from_the_camera_calibration(card, tmp_path, capsys):
    def tilt_of(deviation, *words):
        plane = {"tilt_xy_deg": [0.3, -0.2], "tilt_deg_deviation": deviation}
        rig = replace(
            as_placed(built_rig(2, scale=SCALE)),
            provenance={"camera": {"residuals": {"plane": plane}}},
        )
        write_rig(rig, tmp_path / "placed.json")
        options = "--rig", tmp_path / "placed.json", "--out", tmp_path / "rig.json"
        return facts_with(capsys, card, *options, *words)["card"]["tilt_deg"]

    assert tilt_of(0.1) == [0.3, -0.2]
    assert tilt_of(0.2) == [0, 0]
    assert tilt_of(0.1, "--card-tilt-deg", "0,0.1") == [0, 0.1]


@pytest.mark.slow
def test_the_same_folder_gives_the_same_bytes(card, calibrated, tmp_path):
    assert run(card, "--out", tmp_path / "rig.json") == 0
    assert (tmp_path / "rig.json").read_bytes() == calibrated.read_bytes()


@pytest.mark.slow
def test_srgb_files_that_state_linear_are_refused(tmp_path, capsys):
    folder = tmp_path / "srgb"
    card_folder(folder, seed=2, scale=SCALE, sensor=SensorSettings(encoding="srgb"))
    assert run(folder, "--out", tmp_path / "rig.json") == 0
    edit(folder / "capture.json", lambda document: document.update(encoding="linear"))
    printed = refusal(capsys, folder, "--out", tmp_path / "other.json")
    assert 'are sRGB, but capture.json states "encoding": "linear"' in printed
    assert not (tmp_path / "other.json").exists()


def test_processed_pictures_are_refused(own, tmp_path, capsys):
    def contrast(pixels):
        light = pixels / 65535
        return np.round(65535 * (light - 0.03 * np.sin(2 * np.pi * light))).astype(np.uint16)

    for k in range(4):
        repaint(own / f"step_{k}.png", contrast)
    printed = refusal(capsys, own, "--out", tmp_path / "rig.json")
    assert "neither linear" in printed and "switch off the camera's picture processing" in printed
    assert "radiometry.json" in printed


@pytest.mark.slow
def test_a_card_without_exposures_has_no_response(own, tmp_path, capsys):
    (own / "radiometry.json").unlink()
    assert facts_with(capsys, own, "--out", tmp_path / "rig.json")["response"] is None


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
def test_wrong_documents_of_exposures_are_refused(own, tmp_path, capsys, change, sentence):
    write_image(own / "small.png", np.zeros((8, 9), dtype=np.uint8))
    edit(own / "radiometry.json", lambda document: document.update(change))
    assert sentence in refusal(capsys, own, "--out", tmp_path / "rig.json")
    assert not (tmp_path / "rig.json").exists()


def test_options_that_cannot_be_used_are_refused(card, tmp_path, capsys):
    out = tmp_path / "rig.json"
    assert "is not a capture folder" in refusal(capsys, tmp_path, "--out", out)
    assert "does not exist" in refusal(capsys, tmp_path / "none", "--out", out)
    assert "is a folder" in refusal(capsys, card, "--out", tmp_path)
    for words in (
        [],
        ["--out", out, "--limit", "-1"],
        ["--out", out, "--card-tilt-deg", "1"],
        ["--out", out, "--card-height-mm", "nan"],
    ):
        assert run(card, *words) == 2
        assert capsys.readouterr().err.startswith("splitknit: error: ")
    assert not out.exists()
