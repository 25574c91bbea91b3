"""The experiment on wet, dry, dusty, scarred and glossy fingers, small."""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path

import numpy as np
import pytest

from script_folder import VALIDATION, Script

FOLDER = VALIDATION / "conditions"


def _row(seed: int, kind: str, severity: float, correlation: float, **more: object) -> dict:
    figures = {
        "ridge_gain": 0.9,
        "normals_mean_deg": 5.0,
        "shape_rms_mm": 0.1,
        "surface_rms_mm": 0.1,
        "ridge_good_area": 0.9,
        "mask_overlap": 0.9,
        "print_quality": 90.0,
        "nfiq2": 50,
        "similarity": 0.9,
        "fmr": 1e-5,
        "saturated": 0.0,
        "ridge_contrast": 0.03,
    }
    row = {
        "seed": seed,
        "impression": 0,
        "kind": kind,
        "severity": severity,
        "preset": "metric",
        "exit": 0,
    }
    return {
        **row,
        **figures,
        "warnings": [],
        "advice": [],
        "ridge_correlation": correlation,
        **more,
    }


def test_the_first_figure_to_leave_the_clean_range_is_found(
    script: Script, tmp_path: Path, monkeypatch
) -> None:
    summary = script("summary")
    rows = [_row(seed, "none", 0.0, 0.90 + 0.01 * seed) for seed in range(3)]
    rows += [_row(seed, "wet", 0.5, 0.905) for seed in range(3)]
    words = [
        "white band: 12 % of the finger is saturated in image 3: shorten the exposure or dry the"
        " finger."
    ]
    rows += [
        _row(seed, "wet", 1.0, 0.6, print_quality=20.0, warnings=words, fmr=0.1)
        for seed in range(2)
    ]
    rows.append(
        {
            "seed": 2,
            "impression": 0,
            "kind": "wet",
            "severity": 1.0,
            "preset": "metric",
            "exit": 2,
            "refused": "no 7.",
        }
    )
    (tmp_path / "rows.jsonl").write_text("\n".join(json.dumps(row) for row in rows))
    monkeypatch.setattr(sys, "argv", ["summary.py", str(tmp_path), "--out", str(tmp_path)])
    summary.main()
    document = json.loads((tmp_path / "conditions.json").read_text())
    first = document["first"]["metric"]["wet"]
    assert first["severity"] == 1.0
    assert {figure["figure"] for figure in first["figures"]} == {
        "ridge_correlation",
        "print_quality",
    }
    answers = document["said"]["metric"]["wet 1"]
    assert answers["captures"] == 3 and answers["refused: no N."] == 1
    assert (
        answers[
            "reconstruct: N % of the finger is saturated in image N: shorten the exposure or dry"
            " the finger."
        ]
        == 2
    )
    assert answers["not the same finger at a false match rate of 1e-4"] == 2
    table = list(csv.DictReader((tmp_path / "conditions.csv").read_text().splitlines()))
    assert {row["figure"] for row in table if float(row["beyond"]) > 0} == {
        "ridge_correlation",
        "print_quality",
    }


def test_both_directions_count_where_both_are_wrong(script: Script) -> None:
    summary = script("summary")
    clean = np.array([0.8, 1.0])
    assert summary.outside("ridge_gain", 1.2, clean) == pytest.approx(1.0)
    assert summary.outside("ridge_gain", 0.7, clean) == pytest.approx(0.5)
    assert summary.outside("ridge_correlation", 1.2, clean) == 0.0
    assert summary.outside("normals_mean_deg", 0.2, clean) == 0.0


def test_the_committed_results_are_of_six_fingers() -> None:
    document = json.loads((VALIDATION / "conditions" / "conditions.json").read_text())
    assert len(document["fingers"]) >= 6
    assert set(document["first"]["metric"]) == {"wet", "dry", "dusty", "scarred", "glossy"}


@pytest.mark.slow
def test_a_small_run_goes_on_where_it_stopped(script: Script, tmp_path: Path, monkeypatch) -> None:
    run = script("run")
    command = f"run.py {tmp_path} --seeds 5 --presets ea-split --scale 0.12 --most".split()
    for most in ("1", "2"):
        monkeypatch.setattr(sys, "argv", [*command, most])
        run.main()
    rows = [json.loads(line) for line in (tmp_path / "rows.jsonl").read_text().splitlines()]
    assert [(row["impression"], row["kind"], row["severity"]) for row in rows] == [
        (1, "none", 0.0),
        (0, "none", 0.0),
        (0, "wet", 1.0),
    ]
    assert "similarity" not in rows[0] and 0 <= rows[1]["similarity"] <= 1
