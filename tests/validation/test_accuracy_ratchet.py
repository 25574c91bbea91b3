"""The ratchet notices what slips, and the page shows the committed figures."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

ACCURACY = Path(__file__).resolve().parents[2] / "validation" / "accuracy"
Script = Callable[[str], ModuleType]


@pytest.fixture
def results() -> dict:
    return json.loads((ACCURACY / "results.json").read_text())


def test_the_page_shows_the_figures(accuracy: Script) -> None:
    assert accuracy("report").main(["--check"]) == 0, "run validation/accuracy/report.py"


def test_slips_are_noticed(accuracy: Script, results: dict) -> None:
    ratchet = accuracy("ratchet")
    thresholds = ratchet.stored(results)
    assert ratchet.slipped(results, thresholds) == []
    for key, factor in (("surface_rms_mm", 1.02), ("ridge_correlation", 0.98)):
        worse = copy.deepcopy(results)
        worse["population"]["presets"]["metric"]["figures"][key]["mean"] *= factor
        assert len(ratchet.slipped(worse, thresholds)) == 1
        assert ratchet.tightened(worse, thresholds) == thresholds
        within = copy.deepcopy(results)
        within["population"]["presets"]["metric"]["figures"][key]["mean"] *= 1 + (factor - 1) / 4
        assert ratchet.slipped(within, thresholds) == []
    fewer = copy.deepcopy(results)
    fewer["population"]["fingers"] -= 1
    assert len(ratchet.slipped(fewer, thresholds)) == 1
    gone = copy.deepcopy(results)
    gone["population"]["presets"]["metric"]["refused"].append("no finger")
    assert len(ratchet.slipped(gone, thresholds)) == 1
