"""Presentation attack detection: features, the model, the answer for a folder."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from script_folder import VALIDATION, scripts_of
from splitknit.capture import Capture
from splitknit.cli.main import main
from splitknit.errors import BadInput
from splitknit.io.capture import write_capture
from splitknit.pipeline import reconstruct
from splitknit.reconstruction import Reconstruction
from splitknit_simulator.twin import twin_settings

with scripts_of(VALIDATION / "pad") as script:
    simulate_attack = script("attacks").simulate_attack
    as_jpeg = script("run").as_jpeg
    detector = script("detector")

judge, not_covered, shipped_model = detector.judge, detector.not_covered, detector.shipped_model
pad_features, pad_images = detector.pad_features, detector.pad_images
presentation = detector.presentation

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


def test_a_coarse_capture_is_unknown_and_a_file_no_capture(photograph, tmp_path):
    write_capture(photograph[0], tmp_path / "capture")
    answer = presentation(tmp_path / "capture", "ea")
    assert answer.answer == "unknown"
    assert "pixels a millimetre" in answer.reason
    with pytest.raises(BadInput):
        presentation(tmp_path / "nothing")


def test_a_capture_that_cannot_be_reconstructed_is_unknown(photograph, tmp_path):
    pixels = photograph[0].bands["white"].pixels
    bright = np.where(pixels > 20, 255, pixels).astype(np.uint8)
    write_capture(with_white(photograph[0], pixels=bright), tmp_path / "screen")
    answer = presentation(tmp_path / "screen", "ea")
    assert answer.answer == "unknown"
    assert "it cannot be reconstructed (" in answer.reason


@pytest.mark.slow
def test_a_report_does_not_call_skin_live(photograph, tmp_path):
    write_capture(photograph[0], tmp_path / "capture")
    out = tmp_path / "out"
    assert (
        main(["reconstruct", str(tmp_path / "capture"), "--out", str(out), "--preset", "ea"]) == 0
    )
    assert "live" not in (out / "report.json").read_text()
