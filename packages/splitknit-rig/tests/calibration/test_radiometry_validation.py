"""The script behind the figures of docs/experiments/calibration.md: it runs, and its goal is met on
a small rig."""

import importlib
import json
import sys
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).resolve().parents[4] / "validation" / "calibration"


@pytest.fixture
def script(monkeypatch):
    names = {file.stem for file in SCRIPTS.glob("*.py")}
    for name in names & set(sys.modules):
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.syspath_prepend(str(SCRIPTS))
    yield importlib.import_module("radiometry")
    for name in names & set(sys.modules):
        del sys.modules[name]


@pytest.mark.slow
def test_flat_fielded_intensities_reach_the_aim(script):
    """1 %, on the plane and above it, where division by the card does not reach it."""
    cases = importlib.import_module("radiometry_cards").CASES
    case = next(each for each in cases if each.name == "LEDs 1 mm off")
    calibrated, error, residual = script.measure(101, 0.06, case)
    assert error["worst"] < 0.6 and error["mean"] < 0.15
    assert residual < 0.5
    assert len(calibrated.rig.leds) == 14
    rows = {(row["height_mm"], row["way"]): row for row in script.heights([101], 0.06)}
    assert rows[10.0, "model"]["worst_percent"]["mean"] < 1.0
    assert (
        rows[10.0, "division by the card"]["lights_percent"]["mean"]
        > 4 * rows[10.0, "model"]["lights_percent"]["mean"]
    )
    assert rows[0.0, "no flat field"]["lights_percent"]["mean"] > 5


def test_stored_figures_reach_the_aim_and_fill_the_tables(script, tmp_path):
    """The tables that the page links hold what the script measured."""
    stored = json.loads((SCRIPTS / "radiometry.json").read_text())
    rows = {row["case"]: row for row in stored["plane"]}
    for name in ("places exact", "LEDs 0.5 mm off", "LEDs 1 mm off"):
        assert rows[name]["refused"] == []
        assert rows[name]["worst_percent"]["largest"] < 1.0
    script.write_tables(stored, tmp_path)
    for table in ("radiometry.csv", "radiometry_heights.csv"):
        assert (tmp_path / table).read_text() == (SCRIPTS / "tables" / table).read_text(), (
            f"{table} is old"
        )
