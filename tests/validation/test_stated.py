"""The error of fingers over what is stated, beside what a right statement would give."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

import splitknit
import splitknit_simulator
from script_folder import VALIDATION, scripts_of


def test_what_a_right_statement_gives() -> None:
    with scripts_of(VALIDATION / "path_traced") as script:
        stated = script("stated")
        assert stated.summary(np.array([0.7, 0.75, 1.2, 1.5])) == (2, 1, 1, 1.5)
        assert (
            stated.expected(np.zeros(3)) == "3 [3, 3], 0 [0, 0], 0 [0, 0], 1 [1, 1]; all within: 1"
        )
        # of a factor alone: |z| lies within 0.75 to 1.2 for 22 % of fingers, below for 55 %
        words = stated.expected(np.ones(100))
        assert words.startswith("22 [")
        assert ", 55 [" in words
        assert words.endswith("all within: 0")


@pytest.mark.slow
def test_a_small_finger_and_no_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    capture, truth = splitknit_simulator.simulate_capture(3, settings={"scale": 0.4})
    splitknit.write_capture(capture, tmp_path / "drawn_0_0")
    names = ("height_mm", "shape_mm", "mask", "px_mm", "pitch_mm")
    known = {name: truth[name] for name in names if name in truth}
    np.savez(tmp_path / "drawn_0_0_truth.npz", **known)
    with scripts_of(VALIDATION / "path_traced") as script:
        stated = script("stated")
        monkeypatch.setattr(stated, "TABLE", tmp_path / "stated.csv")
        assert stated.main([str(tmp_path)]) == 0
        assert "measured: " in capsys.readouterr().out
        with (tmp_path / "stated.csv").open(encoding="utf-8") as stream:
            (row,) = csv.DictReader(stream)
        assert row["finger"] == "drawn_0_0"
        assert 0.8 < float(row["ridge_gain"]) < 1.2
        assert 0 < float(row["factor_share"]) < 1
        assert stated.main([str(tmp_path / "none")]) == 2
        assert "give folders" in capsys.readouterr().err
