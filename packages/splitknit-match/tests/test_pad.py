"""Presentation attack detection: features, the shipped model, the verb."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from script_folder import VALIDATION, scripts_of
from splitknit.cli.main import main
from splitknit.errors import BadInput
from splitknit.io.capture import write_capture
from splitknit.model import Capture, Reconstruction
from splitknit.pad import judge, not_covered, pad_features, pad_images, shipped_model
from splitknit.pipeline import reconstruct
from splitknit_match import pad as verb
from splitknit_simulator.twin import twin_settings

with scripts_of(VALIDATION / "pad") as script:
    simulate_attack = script("attacks").simulate_attack
    as_jpeg = script("run").as_jpeg

MODEL = shipped_model()
USUAL = dict(zip(MODEL["names"], MODEL["mean"], strict=True))
SCALE = dict(zip(MODEL["names"], MODEL["scale"], strict=True))


def simulated(kind: str) -> tuple[Capture, Reconstruction]:
    capture, _ = simulate_attack(2, kind, twin_settings(0.1, {"render.workers": 1}))
    return capture, reconstruct(capture, "ea")


@pytest.fixture(scope="module")
def photograph() -> tuple[Capture, Reconstruction]:
    """A printed photograph, and its result."""
    return simulated("photo-matt")


@pytest.fixture
def folder(photograph, tmp_path) -> str:
    write_capture(photograph[0], tmp_path / "capture")
    return str(tmp_path / "capture")


def with_white(capture: Capture, **changes) -> Capture:
    white = replace(capture.bands["white"], **changes)
    return replace(capture, bands=capture.bands | {"white": white})


def shifted(**scales: float) -> dict[str, float]:
    """The usual features, moved by so many standard deviations."""
    return USUAL | {name: USUAL[name] + scale * SCALE[name] for name, scale in scales.items()}


def test_usual_skin_is_live():
    judgement = judge(USUAL)
    assert judgement.answer == "live"
    assert judgement.probability > 0.9


def test_a_flat_print_is_an_attack():
    judgement = judge(shifted(relief_rms=-6, shape_across=6, spread_fixed=6))
    assert judgement.answer == "attack"
    assert judgement.probability < 0.06
    assert min(judgement.suspicion.values()) >= 0
    assert np.min(MODEL["weights"]) >= 0


def test_features_beyond_those_of_training_are_unknown():
    judgement = judge(shifted(relief_coherence=-12))
    assert judgement.answer == "unknown"
    assert "unlike everything" in judgement.reason
    assert judgement.distance > judgement.covered


def test_a_finger_rounder_than_those_of_training_is_live():
    assert judge(shifted(shape_along=-12)).answer == "live"  # copies are flatter, never rounder


def test_a_missing_feature_is_unknown():
    judgement = judge({name: value for name, value in USUAL.items() if name != "spread_nir"})
    assert (judgement.answer, judgement.probability) == ("unknown", None)
    assert "spread_nir" in judgement.reason


def test_features_between_live_skin_and_copies_are_unknown():
    answers = [judge(shifted(spread_nir=scale)).answer for scale in (0, 2.5, 3, 6)]
    assert answers[0] == "live"
    assert "unknown" in answers
    assert answers == sorted(answers, key=("live", "unknown", "attack").index)


def test_a_photograph_has_no_relief_that_turns_with_the_light(photograph):
    capture, result = photograph
    features = pad_features(pad_images(capture), result)
    for name in ("spread_fixed", "shape_across"):
        assert features[name] > USUAL[name] + 2 * SCALE[name]
    with pytest.raises(BadInput, match="known scale"):
        pad_features(pad_images(capture), replace(result, scale_known=False))


@pytest.mark.slow
def test_brightness_changes_no_feature(photograph):
    capture, result = photograph
    features = pad_features(pad_images(capture), result)
    bright = with_white(capture, exposure=3 * capture.bands["white"].exposure)
    for name, value in pad_features(pad_images(bright), result).items():
        assert value == pytest.approx(features[name], abs=1e-3), name


@pytest.mark.slow
def test_jpeg_changes_no_feature_much():
    finger, result = simulated("live")
    features = pad_features(pad_images(finger), result)
    for name, value in pad_features(pad_images(as_jpeg(finger)), result).items():
        # coarser than what the model covers
        assert abs(value - features[name]) < 0.7 * SCALE[name], name


def test_coarse_or_unusual_captures_are_not_covered(photograph):
    coarse, _ = photograph
    assert "pixels a millimetre" in not_covered(coarse)
    camera = replace(coarse.rig.camera, px_per_mm=20.0)
    fine = replace(coarse, rig=replace(coarse.rig, camera=camera))
    assert not_covered(fine) == ""
    assert "near-infrared" in not_covered(replace(fine, bands={"white": fine.bands["white"]}))
    assert "not of skin" in not_covered(replace(fine, material="opaque"))


@pytest.mark.slow
def test_the_verb_has_three_answers_and_three_exit_codes(folder, tmp_path, capsys, monkeypatch):
    words = ["pad", folder, "--preset", "ea"]
    assert main([*words, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["answer"] == "unknown"
    assert "pixels a millimetre" in facts["reason"]
    assert [finding["code"] for finding in facts["findings"]] == ["simulated-attacks"]
    assert main([*words, "--exit-code"]) == 11
    assert "Unknown: " in capsys.readouterr().out
    attack = facts | {"answer": "attack", "probability": None}
    with monkeypatch.context() as patch:
        patch.setattr(verb, "_presented", lambda *_: attack)
        assert main([*words, "--exit-code"]) == 10
        assert main(words) == 0
    assert "Presentation attack." in capsys.readouterr().out
    assert main(["pad", str(tmp_path / "nothing")]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_a_capture_that_cannot_be_reconstructed_is_unknown(photograph, tmp_path, capsys):
    pixels = photograph[0].bands["white"].pixels
    bright = np.where(pixels > 20, 255, pixels).astype(np.uint8)
    write_capture(with_white(photograph[0], pixels=bright), tmp_path / "screen")
    assert main(["pad", str(tmp_path / "screen"), "--preset", "ea", "--exit-code"]) == 11
    assert "it cannot be reconstructed (" in capsys.readouterr().out


def enrolled_as(answer: str, folder: str, gallery: Path, patch: pytest.MonkeyPatch) -> int:
    facts = {"answer": answer, "reason": "it is coarse."}
    patch.setattr(verb, "_presented", lambda *_: facts)
    whose = ["--person", "a", "--finger", "left_index"]
    return main(["enroll", str(gallery), folder, *whose, "--pad", "--preset", "ea", "--json"])


@pytest.mark.slow
def test_enrolment_refuses_attacks(folder, tmp_path, capsys, monkeypatch):
    gallery = tmp_path / "people.skg"
    assert enrolled_as("attack", folder, gallery, monkeypatch) == 2
    assert "suspected to be a presentation attack" in capsys.readouterr().err
    assert not gallery.exists()


@pytest.mark.slow
def test_enrolment_takes_an_unknown_presentation_as_such(folder, tmp_path, capsys, monkeypatch):
    code = enrolled_as("unknown", folder, tmp_path / "people.skg", monkeypatch)
    output = capsys.readouterr()
    if code == 0:
        assert json.loads(output.out)["presentation"] == "unknown"
    else:  # a photograph has few ridges
        assert "failure to acquire" in output.err


@pytest.mark.slow
def test_a_report_does_not_call_skin_live(folder, tmp_path):
    out = tmp_path / "out"
    assert main(["reconstruct", folder, "--out", str(out), "--preset", "ea"]) == 0
    assert "live" not in (out / "report.json").read_text()
