"""Distances between surfaces, against brute force; fronts and intervals by hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from splitknit.errors import BadInput
from splitknit.rig.evaluate_rig import _both_ways, _surface_distances
from splitknit.rig.optimise import _compare_with_best, _mean_interval, _pareto_front


def _brute(first, second):
    apart = np.linalg.norm(first[:, None] - second[None], axis=2)
    return apart.min(axis=1), apart.min(axis=0)


@pytest.mark.parametrize("seed", range(5))
def test_distances_are_those_of_every_pair(seed):
    rng = np.random.default_rng(seed)
    first, second = rng.random((70, 3)), rng.random((90, 3)) + 0.2
    there, back = _both_ways(first, second)
    expected = _brute(first, second)
    np.testing.assert_allclose(there, expected[0])
    np.testing.assert_allclose(back, expected[1])
    found = _surface_distances(there, back)
    assert found["hausdorff_mm"] == pytest.approx(max(expected[0].max(), expected[1].max()))
    assert found["hausdorff95_mm"] == pytest.approx(max(np.percentile(expected[0], 95), np.percentile(expected[1], 95)))
    assert found["rms_mm"] == pytest.approx(np.sqrt(0.5 * np.mean(expected[0] ** 2) + 0.5 * np.mean(expected[1] ** 2)))


def test_distance_looks_both_ways():
    plane = np.stack([*np.meshgrid(np.arange(5.0), np.arange(5.0)), np.zeros((5, 5))], axis=-1).reshape(-1, 3)
    spike = np.concatenate([plane, [[2.0, 2.0, 3.0]]])
    there, back = _both_ways(plane, spike)
    assert there.max() == 0.0
    assert _surface_distances(there, back)["hausdorff_mm"] == 3.0
    assert _surface_distances(back, there)["hausdorff_mm"] == 3.0
    assert _surface_distances(there, there)["hausdorff_mm"] == 0.0


def test_a_lifted_surface_is_as_far_as_it_was_lifted():
    rng = np.random.default_rng(3)
    surface = np.concatenate([rng.random((400, 2)) * 10, np.zeros((400, 1))], axis=1)
    found = _surface_distances(*_both_ways(surface, surface + np.array([0.0, 0.0, 0.01])))
    assert found["hausdorff_mm"] == pytest.approx(0.01)
    assert found["rms_mm"] == pytest.approx(0.01)


def test_points_that_are_none_are_refused():
    points = np.zeros((4, 3))
    for wrong in (np.zeros((0, 3)), np.zeros((4, 2)), np.full((4, 3), np.nan)):
        with pytest.raises(BadInput, match="second"):
            _both_ways(points, wrong)
    with pytest.raises(BadInput, match="no distances"):
        _surface_distances(np.zeros(0), np.zeros(3))


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
