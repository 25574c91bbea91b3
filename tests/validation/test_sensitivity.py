"""The experiment on the constants, on arrays instead of captures."""

from __future__ import annotations

import csv
from dataclasses import dataclass

import pytest

from script_folder import VALIDATION, Script
from splitknit.finger import regions, ridges

FOLDER = VALIDATION / "parameters"


def _rows(**results: str) -> dict[float, dict[str, str]]:
    factors = {"half": 0.5, "less": 0.7, "more": 1.4, "twice": 2.0}
    return {factors[name]: {"result": result} for name, result in results.items()}


def test_a_range_has_no_gap_around_one(script: Script):
    reach = script("sensitivity").hardly_from_to
    assert reach(_rows(half="hardly", less="changes", more="hardly", twice="raises")) == (1.0, 1.4)
    assert reach(_rows(half="hardly", less="same", more="hardly", twice="hardly")) == (0.5, 2.0)


def test_a_constant_has_its_value_back(script: Script):
    sensitivity = script("sensitivity")
    (steepness,) = (
        constant
        for constant in sensitivity.constants_of("finger")
        if constant.name == "INK_STEEPNESS"
    )
    with sensitivity.holding(steepness, 5.0):
        assert ridges.INK_STEEPNESS == 5.0
        assert not hasattr(regions, "INK_STEEPNESS")
    assert steepness.value == ridges.INK_STEEPNESS


def test_defaults_of_functions_change_too_and_come_back(script: Script):
    from splitknit.skin import relief

    sensitivity = script("sensitivity")
    constants = {c.name: c for c in sensitivity.constants_of("skin")}
    before = relief.high_pass.__defaults__
    with sensitivity.holding(constants["CROSSOVER_MM"], 0.5):
        assert relief.high_pass.__defaults__ == (0.5,)
    assert relief.high_pass.__defaults__ == before


def test_a_field_of_thresholds_changes_and_comes_back(script: Script):
    @dataclass(frozen=True, slots=True)
    class BallThresholds:
        radius_px: float = 8.5

    sensitivity, ball = script("sensitivity"), BallThresholds()
    with sensitivity.holding(sensitivity.Constant("", "radius_px", 8.5, ball), 17.0):
        assert ball.radius_px == 17.0
    assert ball.radius_px == 8.5


def test_a_change_counts_beyond_a_twentieth_of_a_figure_or_its_floor(script: Script):
    sensitivity, outcome = script("sensitivity"), script("cases").outcome
    before = outcome({"ridge_gain": 1.0, "crease_error_mm": 0.1}, [])
    by, name, _, after = sensitivity.change(
        before, outcome({"ridge_gain": 1.1, "crease_error_mm": 0.2}, [])
    )
    assert (round(by, 6), name, after) == (2.0, "ridge_gain", "1.1")
    by, name, *_ = sensitivity.change(before, outcome(before.figures, [], "dark-specks"))
    assert (by, name) == (float("inf"), "findings")


@pytest.mark.slow
def test_a_constant_is_measured_once(script: Script, tmp_path, capsys):
    sensitivity = script("sensitivity")
    out = tmp_path / "rows.csv"
    rows = [
        {"package": c.package, "constant": c.name, "factor": f"{factor:g}", "result": "same"}
        for c in sensitivity.constants_of("separation")
        for factor in sensitivity.OUTER
        if c.name != "_LEVEL_SIGMA_PX"
    ]
    with out.open("w", newline="") as file:
        writer = csv.DictWriter(file, sensitivity.COLUMNS)
        writer.writeheader()
        writer.writerows(rows)
    arguments = ["separation", "--out", str(out)]
    sensitivity.main(arguments)
    assert "LEVEL_SIGMA_PX = 16: ridge_" in capsys.readouterr().out
    written = out.read_bytes()
    sensitivity.main(arguments)
    assert out.read_bytes() == written


def test_the_committed_rows_are_whole(script: Script):
    sensitivity = script("sensitivity")
    rows = sensitivity.rows_of(sensitivity.OUT)
    assert {row["result"] for row in rows} == {"not read", "same", "hardly", "changes"}
    for tried in sensitivity.by_constant(rows).values():
        idle = all(tried[factor]["result"] in ("not read", "same") for factor in sensitivity.OUTER)
        assert set(tried) == {*sensitivity.OUTER, *(() if idle else sensitivity.INNER)}
