"""The accuracy experiment runs and says what it should; this finger's figures are those of
before."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

ACCURACY = Path(__file__).resolve().parents[2] / "validation" / "accuracy"
Script = Callable[[str], ModuleType]


def run(out: Path, *arguments: str) -> dict:
    command = [
        sys.executable,
        "-W",
        "error",
        str(ACCURACY / "run.py"),
        "--scale",
        "0.2",
        "--workers",
        "1",
    ]
    command += [*f"--out {out}/results.json --scratch {out}/scratch".split(), *arguments]
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONWARNINGS": "error"},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stderr == ""
    return json.loads((out / "results.json").read_text())


@pytest.mark.slow
def test_one_tiny_finger(tmp_path: Path) -> None:
    results = run(tmp_path, "--fingers", "1", "--presets", "metric", "ea")
    population = results["population"]
    assert set(population["presets"]) == {"metric", "ea"}
    measured = {"metric": (0.0961, 0.9570, 1.024, 1.0), "ea": (0.6634, 0.8122, 0.1533, 0.0)}
    for name, preset in population["presets"].items():
        names = ("surface_rms_mm", "ridge_correlation", "ridge_gain")
        figures = [preset["figures"][figure_name]["mean"] for figure_name in names]
        assert figures == pytest.approx(measured[name][:3], rel=0.02)
        assert [preset["figures"][figure_name]["meets_least"] for figure_name in names] == [
            measured[name][3]
        ] * 3
        assert preset["captures"] == 1 and preset["refused"] == []
        for figure_name in (*names, "ridge_good_area", "yaw_error_deg"):
            figure = preset["figures"][figure_name]
            assert np.isfinite(figure["mean"]) and figure["interval"] == [figure["mean"]] * 2
    assert len(population["singles"]) == 1
    (single,) = (tmp_path / "scratch").glob("*/population_0_*.json")

    # a second run takes the finger from the disk
    stamp = single.stat().st_mtime_ns
    assert run(tmp_path, "--fingers", "1", "--presets", "metric", "ea")["population"] == population
    assert single.stat().st_mtime_ns == stamp


def test_statistics(accuracy: Script) -> None:
    summary = accuracy("summary")
    values = {1: 0.05, 2: 0.10, 3: 0.12, 4: 0.20}
    measured = [
        {
            "seed": seed,
            "presets": {
                "metric": {
                    "figures": {"surface_rms_mm": value, "ridge_gain": 1 + value},
                    "seconds": 1.0,
                }
            },
        }
        for seed, value in values.items()
    ]
    measured.append({"seed": 5, "presets": {"metric": {"refused": "no finger"}}})
    of = summary.summarise(measured, ["metric"])["metric"]
    assert of["captures"] == 5 and of["refused"] == ["no finger"]
    figure = of["figures"]["surface_rms_mm"]
    assert figure["n"] == 4
    assert figure["mean"] == pytest.approx(0.1175)
    assert figure["median"] == pytest.approx(0.11)
    assert figure["worst"] == 0.20
    assert figure["meets_least"] == pytest.approx(3 / 5)  # the refused capture counts against
    assert figure["meets_aim"] == pytest.approx(1 / 5)
    low, high = figure["interval"]
    assert 0.05 < low < 0.1175 < high < 0.20
    assert of["figures"]["ridge_gain"]["worst"] == pytest.approx(1.20)


def test_intervals_resample_whole_fingers(accuracy: Script) -> None:
    interval = accuracy("summary").interval
    few = [(finger, float(finger % 2)) for finger in range(8) for _ in range(25)]
    many = [(k, value) for k, (_, value) in enumerate(few)]
    assert interval(few)[1] - interval(few)[0] > 3 * (interval(many)[1] - interval(many)[0])
    assert interval(few) == interval(few)  # seeded


def test_crease_distance(accuracy: Script) -> None:
    distance = accuracy("measure").crease_distance_mm
    points = np.stack([np.linspace(0, 100, 50), np.full(50, 40.0)], axis=1)
    facts = {"crease_found": True, "crease_line": [[0.0, 30.0], [100.0, 30.0]]}
    assert distance(facts, points, 0.1) == pytest.approx(1.0)
    below = {**facts, "crease_line": [[100.0, 45.0], [0.0, 45.0]]}
    assert distance(below, points, 0.1) == pytest.approx(-0.5)
    assert distance({"crease_found": False}, points, 0.1) is None


def test_page_is_filled_between_its_marks(accuracy: Script) -> None:
    filled = accuracy("report").filled
    page = "a\n<!-- one -->\nold\n<!-- /one -->\nb\n"
    assert filled(page, {"one": "new\nlines"}) == "a\n<!-- one -->\nnew\nlines\n<!-- /one -->\nb\n"
    with pytest.raises(ValueError, match="two"):
        filled(page, {"two": "x"})
