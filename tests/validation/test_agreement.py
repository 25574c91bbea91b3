"""The agreement of prints with the truth: who is whose, where the truth lies, and one tiny capture
from end to end."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from script_folder import Script

FOLDER = Path(__file__).resolve().parents[2] / "validation" / "prints"


def test_pairs_are_as_many_and_as_near_as_can_be(script: Script) -> None:
    compare = script("agreement_compare")
    true = np.array([[0.0, 0.0], [4.0, 0.0], [50.0, 0.0]])
    detected = np.array([[3.0, 0.0], [6.0, 0.0], [58.0, 0.0]])
    # greedily, 3 would take 4 and leave 6 and 0 alone if the reach were larger; both pairs fit
    i, j = compare.paired(detected, true, 3.5)
    assert list(zip(i.tolist(), j.tolist(), strict=True)) == [(0, 0), (1, 1)]
    assert compare.paired(detected[:0], true, 3.5)[0].size == 0
    np.testing.assert_allclose(
        compare.turned(np.array([0.1, 0.0]), np.array([2 * np.pi - 0.1, np.pi])),
        [11.459, 180],
        atol=1e-3,
    )


def test_a_pair_across_the_border_counts_for_whichever_lies_inside(script: Script) -> None:
    compare = script("agreement_compare")

    def side(points: list[tuple[float, float]]) -> dict[str, Any]:
        place, zeros = np.array([[x, 0.0] for x, _ in points]), np.zeros(len(points))
        return {
            "place": place,
            "direction": zeros,
            "border": np.array([b for _, b in points]),
            "slant": zeros,
        }

    detected, true = (
        [(0.0, 20.0), (31.0, 12.0), (99.0, 50.0)],
        [(1.0, 20.0), (30.0, 14.0), (60.0, 50.0)],
    )
    record = compare.table(side(detected), side(true), 2.0)
    counted = compare.counts(record, 13)
    assert {k: counted[k] for k in ("true", "met", "found", "hit")} == {
        "true": 3,
        "met": 2,
        "found": 2,
        "hit": 1,
    }
    figures = compare.recall_precision([counted])
    assert figures["recall"] == pytest.approx(2 / 3) and figures["precision"] == 0.5
    assert compare.counts(record, 13, slant=(10.0, 90.0))["true"] == 0
    assert json.loads(json.dumps(record)) == record


@pytest.mark.slow
def test_true_minutiae_of_a_capture(script: Script, tmp_path: Path) -> None:
    """Directions run along the true ridges, with the right sign; ours of the true relief are mostly
    true ones."""
    from splitknit.io.npz import write_npz
    from splitknit_match.prints.sources import Source
    from splitknit_simulator.population.sessions import PopulationSettings, population_capture

    settings = PopulationSettings(seed=31, scale=0.3)
    capture = population_capture(settings, settings.person(1), "left_ring", 2)
    folder = tmp_path / "S01" / "session_2" / "left_ring"
    folder.mkdir(parents=True)
    write_npz(folder / "truth.npz", capture.truth)
    written = {"settings": {"seed": 31, "scale": 0.3, "rig_seed": 0}}
    (tmp_path / "population.json").write_text(json.dumps(written))

    truth = script("agreement_truth").read_truth(tmp_path, "S01", 2, "left_ring")
    known = np.isfinite(truth.directions_rad)
    assert len(known) > 30 and known.mean() > 0.9

    mask = np.isfinite(capture.truth["shape_mm"])
    rows, columns = mask.shape
    none = np.full(mask.shape, np.nan, dtype=np.float32)
    empty = Source(
        "result",
        mask,
        float(capture.truth["pitch_mm"]),
        np.eye(3),
        (rows, columns),
        none,
        none,
        none,
    )
    measure = script("agreement_measure")
    record = measure.prints_of(
        script("agreement_truth").true_source(truth, empty), truth, ("unroll",)
    )
    counted = script("agreement_compare").counts(record["unroll"]["print"], 13, (0.0, 60.0))
    figures = script("agreement_compare").recall_precision([counted])
    assert figures["recall"] > 0.65 and figures["precision"] > 0.65
    assert figures["direction_median_deg"] < 8 and figures["direction_p90_deg"] < 30


def test_phase_turns_where_a_ridge_ends(script: Script) -> None:
    """A wave with one dislocation has one minutia, there, towards the side with one more ridge."""
    from splitknit_match.prints.enhance import gabor_enhance

    y, x = np.mgrid[0:180, 0:180].astype(float)
    phase = 2 * np.pi * y / 9 + np.arctan2(-(y - 90), x - 90)
    image = np.round(127.5 + 110 * np.cos(phase)).astype(np.uint8)
    minutiae = script("agreement_phase").phase_minutiae(image, gabor_enhance(image, 500.0))
    inner = minutiae.taken((np.abs(minutiae.x_px - 90) < 60) & (np.abs(minutiae.y_px - 90) < 60))
    assert (
        inner.count == 1 and abs(int(inner.x_px[0]) - 90) <= 3 and abs(int(inner.y_px[0]) - 90) <= 3
    )
    ridges = [
        int((np.diff((image[20:160, column] < 127).astype(int)) == 1).sum()) for column in (30, 150)
    ]
    more_right = ridges[1] > ridges[0]
    assert ridges[0] != ridges[1]
    assert (
        np.cos(inner.direction_rad[0]) > 0.9
        if more_right
        else np.cos(inner.direction_rad[0]) < -0.9
    )
    assert inner.quality[0] > 60


def test_the_tables_show_the_figures(script: Script) -> None:
    assert script("agreement_report").main(["--check"]) == 0, (
        "run validation/prints/agreement_report.py"
    )
