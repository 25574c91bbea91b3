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
from splitknit.pad import distances, is_judged, judge, pad_features, pad_images, shipped_model, with_probability
from splitknit.pipeline import reconstruct
from splitknit.simulator.twin import twin_settings

with scripts_of(VALIDATION / "pad") as script:
    simulate_attack = script("attacks").simulate_attack

USUAL = dict(zip(shipped_model()["names"], shipped_model()["mean"], strict=True))


@pytest.fixture(scope="module")
def photograph():
    """A printed photograph, and its result."""
    capture, _ = simulate_attack(2, "photo-matt", twin_settings(0.1, {"render.workers": 1}))
    return capture, reconstruct(capture, "ea")


def test_usual_skin_is_live_and_what_lies_far_from_it_is_not():
    assert judge(USUAL).live and judge(USUAL).probability > 0.9
    far = {
        name: value + 20 * np.sqrt(shipped_model()["covariance"][k][k]) for k, (name, value) in enumerate(USUAL.items())
    }
    assert not judge(far).live and judge(far).probability < 1e-3
    assert min(judge(far).suspicion.values()) >= 0


def test_no_distance_counts_in_favour_and_parts_may_be_absent():
    model = shipped_model()
    assert min(model["weights"].values()) >= 0 and 0 < model["threshold"] < 1
    few = {name: USUAL[name] for name in ("relief_rms", "shape_across")}
    assert set(distances(model, few)) == {"relief", "shape", "all"}
    assert judge(few).live


def test_a_photograph_has_no_relief_that_turns_with_the_light(photograph):
    capture, result = photograph
    found = pad_features(pad_images(capture), result)
    assert found["spread_fixed"] > USUAL["spread_fixed"] and found["spread_blue"] < USUAL["spread_blue"] - 1
    assert "colour_nir" in found and "polarised_share" not in found
    assert not judge(found).live
    bare = replace(
        capture,
        bands={"white": replace(capture.bands["white"], pixels=capture.bands["white"].pixels[..., 1:2], ambient=None)},
    )
    grey = pad_features(pad_images(bare), result)
    assert "colour_red" not in grey and not judge(grey).live
    with pytest.raises(BadInput, match="known scale"):
        pad_features(pad_images(capture), replace(result, scale_known=False))


def test_a_report_states_the_probability_where_the_model_applies(photograph):
    capture, result = photograph
    assert not is_judged(capture)  # coarser than what the model was fitted to
    assert "live_probability" not in with_probability(result, None).facts
    assert with_probability(result, pad_images(capture)).facts["live_probability"] < 0.5


def test_the_verb_and_refusal_at_enrolment(photograph, tmp_path, capsys):
    write_capture(photograph[0], tmp_path / "capture")
    assert main(["pad", str(tmp_path / "capture"), "--preset", "ea", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["live"] is False and facts["probability"] < facts["threshold"] and "simulated" in facts["basis"]
    words = [
        "enroll",
        str(tmp_path / "people.skg"),
        str(tmp_path / "capture"),
        "--person",
        "a",
        "--finger",
        "left_index",
    ]
    assert main([*words, "--pad", "--preset", "ea"]) == 2
    assert "no live skin" in capsys.readouterr().err and not (tmp_path / "people.skg").exists()
    assert main(["pad", str(tmp_path / "nothing")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
