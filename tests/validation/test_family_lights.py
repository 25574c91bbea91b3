"""The scripts that measure voted minutiae and coloured lights run, on little."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from script_folder import VALIDATION, scripts_of
from splitknit_match.matching.minutiae_record import Minutiae, pack_minutiae


def some(seed: int, count: int = 12) -> Minutiae:
    rng = np.random.default_rng(seed)
    return Minutiae(
        np.sort(rng.integers(20, 180, count)).astype(np.int32), rng.integers(20, 180, count).astype(np.int32),
        rng.uniform(0, 6, count), np.ones(count, np.uint8), np.full(count, 50, np.uint8), (200, 200),
    )  # fmt: skip


def test_every_way_of_voting_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(VALIDATION / "prints"))
    with scripts_of(VALIDATION / "family") as named:
        voted = named("voted")
        lists = {name: [pack_minutiae(some(3)).hex()] * 7 for name in ("x", "y", "z", "albedo")}
        found = voted.ways(lists, {"ea": some(3), "metric": None})
        assert "metric, relief print" not in found
        assert found["vote of all pictures"].count == 12
        assert set(found["vote of all pictures"].quality.tolist()) == {100}
        captures = {("S01", k, "f"): {"w": some(1, 40)} for k in (1, 2)} | {
            ("S02", k, "f"): {"w": some(2, 40)} for k in (1, 2)
        }
        pytest.importorskip("nbis")
        scores = voted.scores(captures, "w")
        assert scores["impostors"] == 2
        assert scores["genuine_above_all_impostors"] == 1.0


@pytest.mark.slow
def test_a_finger_under_three_kinds_of_light() -> None:
    with scripts_of(VALIDATION / "family") as named:
        lights = named("lights")
        record = lights.finger_record(4100, 0.1)
        assert record["cases"]["zheng"] == record["cases"]["ea"]
        contrast = record["ridge_contrast"]
        assert contrast["blue"] > contrast["red"]
        summary = lights.summary([record, record])
        assert summary["less_ea"]["ea"]["normals_mean_deg"] == [0.0, 0.0, 0.0]
        assert record["zheng"]["mean_of_sets_deg"] <= record["zheng"]["sets_mean_deg"] + 1e-6
    assert Path(lights.__file__).is_file()
