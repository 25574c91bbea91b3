"""The scripts of the acceptance test's tables run on a small twin and a few frames, sum their rows
up, and go on where they were."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import pytest

from script_folder import scripts_of

FOLDER = Path(__file__).resolve().parents[2] / "validation" / "rig_check"


@pytest.mark.slow
def test_a_sound_twin_and_one_whose_finger_moves() -> None:
    with scripts_of(FOLDER) as script:
        moves = "the finger moves by 0.2 mm"
        run = script("run")
        rows = run.rows_of(100, ["sound", moves])
        lines = {line[0]: line for line in run.summary(rows)}
    assert lines["sound"][1:3] == ["1", "0"]
    assert lines[moves][1:3] == ["1", "1"]
    assert "motion of the finger (1)" in lines[moves][4]


def test_two_defects_are_named_by_questions_of_their_own() -> None:
    pair = "an LED 2 mm off + camera turned by 1 deg"
    row = {"seed": 1, "rig": pair, "passed": 0}
    with scripts_of(FOLDER) as script:
        run = script("run")
        one = [{**row, "question": "direction of each LED"}]
        assert not run.names(one, pair)
        both = [*one, {**row, "question": "turn of all LEDs together"}]
        assert run.names(both, pair)
        assert run.summary(both)[1][1:4] == ["1", "1", "1"]


def test_a_run_goes_on_where_it_was(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    asked = []

    def rows_of(seed: int, rigs: list[str]) -> list[dict]:
        asked.append((seed, *rigs))
        row = {"seed": seed, "question": "q", "measured": 1, "limit": 2, "passed": 1, "note": ""}
        return [{**row, "rig": rig} for rig in rigs]

    out = str(tmp_path / "answers.csv")
    with scripts_of(FOLDER) as script:
        run = script("run")
        monkeypatch.setattr(run, "rows_of", rows_of)
        monkeypatch.setattr(run, "ProcessPoolExecutor", lambda workers: nullcontext(SERIAL))
        run.main(["--sound", "5:6", "--faulty", "5:5", "--out", out])
        run.main(["--sound", "5:7", "--faulty", "5:5", "--out", out])
    assert asked == [(5, "sound"), (6, "sound")]


SERIAL = SimpleNamespace(map=map)


@pytest.mark.parametrize("camera", ["as it should be", "all of them, one in 20"])
def test_no_wrong_frame_is_kept(camera: str) -> None:
    with scripts_of(FOLDER) as script:
        synchrony = script("synchrony")
        counts = synchrony.counted(*synchrony.CAMERAS[camera], 100, 7)
    assert counts["kept_wrong"] == 0
    assert counts["kept"] >= 40
    if camera == "as it should be":
        assert counts["good_captures"] == counts["captures"]
