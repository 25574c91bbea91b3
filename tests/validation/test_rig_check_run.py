"""The script of the acceptance test's table runs on a small twin, and sums its rows up."""

from __future__ import annotations

from pathlib import Path

import pytest

from script_folder import scripts_of

FOLDER = Path(__file__).resolve().parents[2] / "validation" / "rig_check"


@pytest.mark.slow
def test_a_sound_twin_and_one_whose_finger_moves(monkeypatch: pytest.MonkeyPatch) -> None:
    with scripts_of(FOLDER) as script:
        monkeypatch.setattr(script("twins"), "SCALE", 0.15)
        moves = "the finger moves by 0.2 mm"
        run = script("run")
        rows = run.rows_of(100, [moves])
        lines = {line[0]: line for line in run.summary(rows)}
    assert lines["sound"][1:3] == ["1", "0"]
    assert lines[moves][1:3] == ["1", "1"]
    assert "motion of the finger (1)" in lines[moves][3]
