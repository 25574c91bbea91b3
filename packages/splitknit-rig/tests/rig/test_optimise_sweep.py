"""A sweep: kept rig by rig, taken up again, the same for any number of processes."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import splitknit_rig.rig.optimise as module
from splitknit.errors import BadInput
from splitknit_rig.rig.candidates import RigCandidate, grid
from splitknit_rig.rig.optimise import (
    Study,
    _compare_with_best,
    _mean_interval,
    _pareto_front,
    evaluate_candidate,
    summarise,
    sweep_rigs,
)

STUDY = Study(fingers=2)
RIGS = grid((100.0, 140.0), (52.5, 80.0), (1.0,), (None,), (6.0,))


class Counted:
    """A quick stand-in for the measurement: a figure that follows from the rig alone."""

    def __init__(self, stop_at=None, fail=()):
        self.asked, self.stop_at, self.fail = [], stop_at, fail

    def __call__(self, candidate: RigCandidate, study: Study):
        self.asked.append(candidate.name)
        if self.stop_at is not None and len(self.asked) > self.stop_at:
            raise KeyboardInterrupt
        values = [{"seed": s, "surface_rms_mm": candidate.radius_mm / 50 + 0.001 * s} for s in study.seeds]
        record = {
            "candidate": {
                **{name: getattr(candidate, name) for name in RigCandidate.__dataclass_fields__},
                "name": candidate.name,
            },
            "status": "done",
            "reason": None,
            "constraints": [],
            "fingers": values,
            "mean": {"surface_rms_mm": sum(one["surface_rms_mm"] for one in values) / len(values)},
        }
        if candidate.name in self.fail:
            record |= {"status": "failed", "reason": "it broke", "fingers": [], "mean": None}
        return record


def _tree(folder):
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_sweep_that_was_stopped_goes_on(tmp_path, monkeypatch):
    whole = Counted()
    monkeypatch.setattr(module, "evaluate_candidate", whole)
    expected = sweep_rigs(tmp_path / "whole", RIGS, STUDY)
    stopped = Counted(stop_at=2)
    monkeypatch.setattr(module, "evaluate_candidate", stopped)
    with pytest.raises(KeyboardInterrupt):
        sweep_rigs(tmp_path / "out", RIGS, STUDY)
    assert len(list((tmp_path / "out" / "candidates").iterdir())) == 2
    left = tmp_path / "out" / "candidates" / ".splitknit-0123456789ab.tmp"
    left.mkdir()
    (left / "new").write_text("{")  # a kill leaves this
    (tmp_path / "out" / "candidates" / f"{RIGS[1].name}.json").write_text("{half")  # a disk left this
    again = Counted()
    monkeypatch.setattr(module, "evaluate_candidate", again)
    seen = []
    found = sweep_rigs(tmp_path / "out", RIGS, STUDY, progress=lambda stage, fraction: seen.append((stage, fraction)))
    assert again.asked == [RIGS[1].name, RIGS[2].name, RIGS[3].name]
    assert seen[0] == ("resuming", 0.25) and seen[-1] == (RIGS[3].name, 1.0)
    assert found == expected
    shutil.rmtree(left)
    assert _tree(tmp_path / "out") == _tree(tmp_path / "whole")
    sweep_rigs(tmp_path / "out", RIGS, STUDY)
    assert len(again.asked) == 3, "nothing is done twice"
    stray = tmp_path / "out" / "candidates" / f"{RIGS[2].name}.json"
    stray.write_text(stray.read_text().replace('"study_sha256": "', '"study_sha256": "of another study, '))
    sweep_rigs(tmp_path / "out", RIGS, STUDY)
    assert again.asked[3:] == [RIGS[2].name], "a file that was copied here from another sweep"


def test_failed_rigs_are_tried_again_and_more_may_be_asked(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "evaluate_candidate", Counted(fail=(RIGS[0].name,)))
    found = sweep_rigs(tmp_path / "out", RIGS[:2], STUDY)
    assert [one["status"] for one in found] == ["failed", "done"]
    again = Counted()
    monkeypatch.setattr(module, "evaluate_candidate", again)
    found = sweep_rigs(tmp_path / "out", RIGS, STUDY)
    assert again.asked == [RIGS[0].name, RIGS[2].name, RIGS[3].name]
    assert [one["status"] for one in found] == ["done"] * 4


def test_changed_settings_and_foreign_folders_are_noticed(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "evaluate_candidate", Counted())
    sweep_rigs(tmp_path / "out", RIGS, STUDY)
    with pytest.raises(BadInput, match=r"other settings \(fingers, method\)"):
        sweep_rigs(tmp_path / "out", RIGS, replace(STUDY, fingers=3, method="metric"))
    (tmp_path / "out" / "thesis.pdf").write_text("mine")
    with pytest.raises(BadInput, match=r"'thesis\.pdf'"):
        sweep_rigs(tmp_path / "out", RIGS, STUDY)
    other = tmp_path / "other"
    other.mkdir()
    (other / "notes.txt").write_text("mine")
    with pytest.raises(BadInput, match=r"notes\.txt"):
        sweep_rigs(other, RIGS, STUDY)
    assert _tree(other) == {"notes.txt": b"mine"}
    with pytest.raises(BadInput, match="is a file"):
        sweep_rigs(other / "notes.txt", RIGS, STUDY)
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "sweep.json").write_text("{")
    with pytest.raises(BadInput, match="damaged"):
        sweep_rigs(tmp_path / "broken", RIGS, STUDY)


def test_rigs_that_cannot_be_built_are_refused_before_anything_is_written(tmp_path):
    with pytest.raises(BadInput, match=r"not one of the 2 rigs can be built.*printer"):
        sweep_rigs(tmp_path / "out", grid((300.0, 400.0), (52.5,), (1.0,)), STUDY)
    assert not (tmp_path / "out").exists()
    with pytest.raises(BadInput, match="no candidates"):
        sweep_rigs(tmp_path / "out", (), STUDY)
    with pytest.raises(BadInput, match="workers"):
        sweep_rigs(tmp_path / "out", RIGS, STUDY, workers=0)


def test_summary_names_the_best():
    records = [Counted()(rig, STUDY) for rig in RIGS]
    found = summarise(records, "surface_rms_mm")
    assert found["best"] == RIGS[0].name and found["counts"] == {"done": 4, "refused": 0, "failed": 0}
    assert found["as_good"] == [RIGS[0].name, RIGS[2].name], "the same figure as the best"
    assert found["pareto"] == [RIGS[0].name], "the smallest box of the best figure"
    failed = [Counted(fail=(rig.name,))(rig, STUDY) for rig in RIGS]
    with pytest.raises(BadInput, match=r"not one of the 4 rigs.*it broke"):
        summarise(failed, "surface_rms_mm")


@pytest.mark.slow
def test_the_result_does_not_depend_on_the_processes(tmp_path):
    rigs = grid((140.0,), (20.0, 52.5, 80.0), (1.0,), (None,), (5.0,))
    study = Study(fingers=1)
    sweep_rigs(tmp_path / "one", rigs, study, workers=1)
    sweep_rigs(tmp_path / "two", rigs, study, workers=2)
    assert _tree(tmp_path / "one") == _tree(tmp_path / "two")
    statuses = [
        json.loads(data)["record"]["status"] for name, data in _tree(tmp_path / "one").items() if "cand" in name
    ]
    assert sorted(statuses) == ["done", "done", "refused"]


def test_front_is_what_nothing_beats_everywhere():
    costs = np.array([[1.0, 5.0], [2.0, 2.0], [5.0, 1.0], [3.0, 3.0], [2.0, 2.0], [1.0, 6.0]])
    assert _pareto_front(costs).tolist() == [True, True, True, False, True, False]
    rng = np.random.default_rng(0)
    many = rng.integers(0, 6, (60, 3)).astype(float)
    front = _pareto_front(many)
    for k, row in enumerate(many):
        beaten = any(
            all(o <= r for o, r in zip(other, row, strict=True)) and tuple(other) != tuple(row) for other in many
        )
        assert front[k] == (not beaten)
    with pytest.raises(BadInput, match="finite"):
        _pareto_front(np.array([[np.nan]]))


def test_interval_is_students():
    values = [1.0, 2.0, 4.0, 3.5]
    mean, low, high = _mean_interval(values)
    expected = stats.t.interval(0.95, 3, loc=np.mean(values), scale=stats.sem(values))
    assert (mean, low, high) == pytest.approx((np.mean(values), *expected))
    assert _mean_interval([2.0]) == (2.0, -np.inf, np.inf)


def _record(name, values):
    return {"candidate": {"name": name}, "fingers": [{"rms_mm": value} for value in values]}


def test_candidates_are_compared_finger_by_finger():
    # "near" is hardly worse on each finger, and always; "lucky" is worse on average but not surely
    records = [
        _record("best", [1.0, 2.0, 3.0, 4.0]),
        _record("near", [1.1, 2.11, 3.1, 4.09]),
        _record("lucky", [1.5, 1.6, 3.9, 3.8]),
    ]
    found = _compare_with_best(records, "rms_mm")
    assert found["best"]["best"] and found["best"]["as_good"] and found["best"]["worse_by"] == 0.0
    assert found["near"]["worse_by"] == pytest.approx(0.1)
    assert not found["near"]["as_good"]
    assert found["lucky"]["as_good"]
    assert found["near"]["low"] < found["best"]["value"] < found["near"]["high"], (
        "unpaired, they could not be told apart"
    )
    alone = _compare_with_best([_record("best", [1.0]), _record("worse", [9.0])], "rms_mm")
    assert alone["worse"]["low"] is None


def test_a_broken_candidate_is_a_result(monkeypatch):
    def breaks(*unused, **named):
        raise ZeroDivisionError("somewhere deep")

    monkeypatch.setattr(module, "reconstruct", breaks)
    record = evaluate_candidate(RIGS[0], STUDY)
    assert record["status"] == "failed" and record["reason"] == "ZeroDivisionError: somewhere deep"
    assert record["mean"] is None and record["constraints"]
    refused = evaluate_candidate(replace(RIGS[0], radius_mm=15.0), STUDY)
    assert refused["status"] == "refused" and "free" in refused["reason"]
