"""Presentation attack detection: features, the shipped model, the verb."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from script_folder import VALIDATION, scripts_of
from splitknit.cli.main import main
from splitknit.errors import BadInput
from splitknit.io.capture import write_capture
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


@pytest.fixture(scope="module")
def photograph():
    """A printed photograph, and its result."""
    capture, _ = simulate_attack(2, "photo-matt", twin_settings(0.1, {"render.workers": 1}))
    return capture, reconstruct(capture, "ea")


def test_usual_skin_is_live_and_a_flat_print_is_an_attack():
    assert judge(USUAL).answer == "live" and judge(USUAL).probability > 0.9
    flat = USUAL | {
        "relief_rms": USUAL["relief_rms"] - 6 * SCALE["relief_rms"],
        "shape_across": USUAL["shape_across"] + 6 * SCALE["shape_across"],
        "spread_fixed": USUAL["spread_fixed"] + 6 * SCALE["spread_fixed"],
    }
    assert judge(flat).answer == "attack" and judge(flat).probability < 0.06
    assert min(judge(flat).suspicion.values()) >= 0 and np.min(MODEL["weights"]) >= 0


def test_what_training_did_not_cover_is_unknown():
    odd = judge(
        USUAL | {"relief_coherence": USUAL["relief_coherence"] - 12 * SCALE["relief_coherence"]}
    )
    assert (
        odd.answer == "unknown" and "unlike everything" in odd.reason and odd.distance > odd.covered
    )
    curved = judge(USUAL | {"shape_along": USUAL["shape_along"] - 12 * SCALE["shape_along"]})
    assert curved.answer == "live"  # copies are flatter than fingers, never rounder
    lacking = judge({name: value for name, value in USUAL.items() if name != "spread_nir"})
    assert (lacking.answer, lacking.probability) == (
        "unknown",
        None,
    ) and "spread_nir" in lacking.reason


def test_odds_between_live_skin_and_copies_are_unknown():
    steps = [
        judge(USUAL | {"spread_nir": USUAL["spread_nir"] + k * SCALE["spread_nir"]}).answer
        for k in (0, 2.5, 3, 6)
    ]
    assert (
        steps[0] == "live"
        and "unknown" in steps
        and steps == sorted(steps, key=("live", "unknown", "attack").index)
    )


def test_a_photograph_has_no_relief_that_turns_with_the_light(photograph):
    capture, result = photograph
    found = pad_features(pad_images(capture), result)
    assert found["spread_fixed"] > USUAL["spread_fixed"] + 2 * SCALE["spread_fixed"]
    assert found["shape_across"] > USUAL["shape_across"] + 2 * SCALE["shape_across"]
    with pytest.raises(BadInput, match="known scale"):
        pad_features(pad_images(capture), replace(result, scale_known=False))


@pytest.mark.slow
def test_neither_brightness_nor_colour_nor_jpeg_changes_a_feature(photograph):
    capture, result = photograph
    found = pad_features(pad_images(capture), result)
    white = capture.bands["white"]
    dim = replace(
        capture, bands={**capture.bands, "white": replace(white, exposure=3 * white.exposure)}
    )
    for name, value in pad_features(pad_images(dim), result).items():
        assert value == pytest.approx(found[name], abs=1e-3), name
    finger, _ = simulate_attack(2, "live", twin_settings(0.1, {"render.workers": 1}))
    shape = reconstruct(finger, "ea")
    found = pad_features(pad_images(finger), shape)
    for name, value in pad_features(pad_images(as_jpeg(finger)), shape).items():
        # coarser than what the model covers
        assert abs(value - found[name]) < 0.7 * SCALE[name], name


def test_coarse_or_unusual_captures_are_not_covered(photograph):
    # coarser than what the model was fitted to
    assert "pixels a millimetre" in not_covered(photograph[0])
    camera = replace(photograph[0].rig.camera, px_per_mm=20.0)
    fine = replace(photograph[0], rig=replace(photograph[0].rig, camera=camera))
    assert not_covered(fine) == ""
    assert "near-infrared" in not_covered(replace(fine, bands={"white": fine.bands["white"]}))
    assert "not of skin" in not_covered(replace(fine, material="opaque"))


@pytest.mark.slow
def test_the_verb_has_three_answers_and_three_exit_codes(photograph, tmp_path, capsys, monkeypatch):
    write_capture(photograph[0], tmp_path / "capture")
    words = ["pad", str(tmp_path / "capture"), "--preset", "ea"]
    assert main([*words, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert (
        facts["answer"] == "unknown"
        and "pixels a millimetre" in facts["reason"]
        and [finding["code"] for finding in facts["findings"]] == ["simulated-attacks"]
    )
    assert main([*words, "--exit-code"]) == 11
    assert "Unknown: " in capsys.readouterr().out
    monkeypatch.setattr(
        verb, "_presented", lambda *_: {**facts, "answer": "attack", "probability": None}
    )
    assert main([*words, "--exit-code"]) == 10 and main(words) == 0
    assert "Presentation attack." in capsys.readouterr().out
    assert main(["pad", str(tmp_path / "nothing")]) == 0  # the answer above
    monkeypatch.undo()
    assert main(["pad", str(tmp_path / "nothing")]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_a_capture_that_cannot_be_reconstructed_is_unknown(photograph, tmp_path, capsys):
    white = photograph[0].bands["white"]
    bright = replace(
        photograph[0],
        bands={
            **photograph[0].bands,
            "white": replace(
                white, pixels=np.where(white.pixels > 20, 255, white.pixels).astype(np.uint8)
            ),
        },
    )
    write_capture(bright, tmp_path / "screen")
    assert main(["pad", str(tmp_path / "screen"), "--preset", "ea", "--exit-code"]) == 11
    assert "it cannot be reconstructed (" in capsys.readouterr().out


@pytest.mark.slow
def test_enrolment_refuses_attacks_and_takes_the_unknown_as_such(
    photograph, tmp_path, capsys, monkeypatch
):
    write_capture(photograph[0], tmp_path / "capture")
    whose = [
        str(tmp_path / "capture"),
        "--person",
        "a",
        "--finger",
        "left_index",
        "--pad",
        "--preset",
        "ea",
        "--json",
    ]
    for answer in ("attack", "unknown"):
        facts = {"answer": answer, "reason": "it is coarse."}
        monkeypatch.setattr(verb, "_presented", lambda *_: facts)  # noqa: B023
        code = main(["enroll", str(tmp_path / "people.skg"), *whose])
        said = capsys.readouterr()
        if answer == "attack":
            assert code == 2 and "suspected to be a presentation attack" in said.err
            assert not (tmp_path / "people.skg").exists()
        elif code == 0:  # a photograph has few ridges
            assert json.loads(said.out)["presentation"] == "unknown"
        else:
            assert "failure to acquire" in said.err


@pytest.mark.slow
def test_a_report_says_nothing_of_live_skin(photograph, tmp_path):
    write_capture(photograph[0], tmp_path / "capture")
    assert (
        main(
            [
                "reconstruct",
                str(tmp_path / "capture"),
                "--out",
                str(tmp_path / "out"),
                "--preset",
                "ea",
            ]
        )
        == 0
    )
    assert "live" not in (tmp_path / "out" / "report.json").read_text()
