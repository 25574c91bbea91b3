"""The experiment on moving fingers, small."""

from __future__ import annotations

import json

import pytest

from script_folder import VALIDATION, Script

FOLDER = VALIDATION / "motion"


def _moved(seed: int, amplitude: float, corrected: float) -> dict:
    figures = {"ridge_correlation": corrected, "shape_rms_mm": 0.1}
    return {
        "seed": seed,
        "amplitude_mm": amplitude,
        "uncorrected": {**figures, "ridge_correlation": 0.6},
        "corrected": figures,
        "oracle": {**figures, "ridge_correlation": 0.94},
        "undone": True,
        "error_um": {"white": 10.0, "nir": 20.0},
    }


def test_tables_give_losses_against_the_same_still_finger(script: Script):
    still = [
        {
            "seed": s,
            "still": {"ridge_correlation": c, "shape_rms_mm": 0.1},
            "left_alone": True,
            "same": True,
        }
        for s, c in ((1, 0.95), (2, 0.91))
    ]
    moved = [_moved(1, 0.5, 0.94), _moved(2, 0.5, 0.90)]
    moved.append({**_moved(1, 0.8, 0.9), "undone": False, "refused": "it moved"})
    del moved[-1]["corrected"]
    text = "\n".join(script("run").tables({"scale": 0.35, "still": still, "moved": moved}))
    assert "| 0.5 | 2 | 0.330 [0.310, 0.350] | 0.010 [0.010, 0.010] |" in text
    assert "| 0.8 | 1 | 0.350 [0.350, 0.350] | - |" in text
    assert "| 0.8 | 0 | 1 |" in text


def test_the_committed_results_are_whole():
    results = json.loads((VALIDATION / "motion" / "results.json").read_text())
    still = {row["seed"] for row in results["still"]}
    assert results["scale"] >= 0.35
    for row in results["moved"]:
        assert row["seed"] in still
        assert "corrected" in row or "refused" in row
        assert row["oracle"]["ridge_correlation"] > row["uncorrected"]["ridge_correlation"] - 0.01


@pytest.mark.slow
def test_a_finger_is_measured_and_not_twice(script: Script, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(script("measure"), "capture_folder", _smaller(script, tmp_path))
    file = tmp_path / "results.json"
    command = f"--seeds 3 --amplitudes 0.5 --scale 0.35 --out {file}".split()
    script("run").main(command)
    results = json.loads(file.read_text())
    (row,) = results["moved"]
    assert row["undone"]
    assert row["corrected"]["ridge_correlation"] > row["uncorrected"]["ridge_correlation"]
    capsys.readouterr()
    script("run").main(command)
    assert not capsys.readouterr().out.startswith(("still", "moved"))


def _smaller(script: Script, out):
    folder = script("captures").capture_folder
    return lambda seed, amplitude, scale: folder(seed, amplitude, 0.2, out)
