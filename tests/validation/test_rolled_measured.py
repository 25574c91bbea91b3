"""The scripts that measure rolled fingers: against the truth of a drawn finger, and their
tables."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from script_folder import scripts_of
from splitknit.errors import BadInput
from splitknit.skin.images import MetricSettings
from splitknit_match.rolled.finger import rolled_finger

TESTS = Path(__file__).resolve().parents[1]
FOLDER = TESTS.parent / "validation" / "mirror"


@pytest.fixture(scope="module")
def scene():
    sys.path.insert(0, str(TESTS / "mirrors"))
    import rolled_scene

    sys.path.pop(0)
    return rolled_scene


@pytest.mark.slow
def test_every_point_is_held_against_the_pixel_it_came_from(scene, monkeypatch) -> None:
    monkeypatch.setattr("splitknit_match.rolled.finger.PITCH_MM", 0.07)  # quicker
    capture, masks = scene.capture(("right",))
    rolled = rolled_finger(capture, scene.views_of(capture, masks), MetricSettings())
    x = (np.arange(scene.SIZE[1]) - (scene.SIZE[1] - 1) / 2) / scene.PX
    y = ((scene.SIZE[0] - 1) / 2 - np.arange(scene.SIZE[0])) / scene.PX
    x, y = np.meshgrid(x, y - 2.0)
    truth = {"mask": masks["front"], "view_right_mask": masks["right"]}
    for name, lines, axis in (
        ("relief_um", x, "z"),
        ("view_right_relief_um", x - scene.LEAN, "+x"),
    ):
        points = scene.on_finger(lines, y, axis)[0]
        truth[name] = 1e3 * scene.ridges(points)
        # the skin's own coordinates: length around the finger, place along it
        around = 7.2 * np.arctan2(points[..., 0], points[..., 2] - scene.TOP + scene.B)
        skin = np.stack([around, points[..., 1]], axis=-1).astype(np.float32)
        truth["chart_mm" if name == "relief_um" else "view_right_chart_mm"] = skin
    with scripts_of(FOLDER) as script:
        measured = script("rolled_measure")
        front = measured.front_alone(rolled)
        figures = measured.against_truth(rolled, front, truth)
        wrong = measured.against_truth(
            rolled, front, {**truth, "view_right_relief_um": -truth["view_right_relief_um"]}
        )
        apart = measured.ridges_apart(rolled, truth)["right"]
        moved = measured.ridges_apart(
            rolled, {**truth, "chart_mm": truth["chart_mm"] + np.float32([0.0, 0.5])}
        )["right"]
    assert apart < 250  # not half a ridge
    assert moved == pytest.approx(500, abs=apart)
    assert front.blended.known.sum() < 0.85 * rolled.blended.known.sum()
    assert figures["rolled"]["0-30"] > 0.9
    assert figures["rolled"]["60-90"] > 0.8
    assert wrong["rolled"]["60-90"] < 0.5  # the mirror's truth counts there
    assert wrong["front"] == figures["front"]


def test_a_table_of_captures() -> None:
    bands = {"0-30": 0.9, "30-60": None}
    captures = [
        {
            "seed": k,
            "coverage_deg": 200.0 + k,
            "coverage_front_deg": 140.0,
            "rolled": bands,
            "front": bands,
            "surface_rms_mm": 0.2,
            "cut": ["left"] * (k == 1),
            "ridges_apart_um": {"left": 50.0, "right": None},
        }
        for k in range(3)
    ]
    with scripts_of(FOLDER) as script:
        whole = script("rolled").summary(captures)
    assert whole["coverage_deg"] == [201.0, 200.0, 202.0]
    assert whole["views_cut"] == 1
    assert whole["ridges_apart_um"] == [50.0, 50.0, 50.0]
    assert whole["rolled"] == {"0-30": [0.9, 0.9, 0.9], "30-60": None}


def test_a_capture_that_is_refused_is_kept_as_such(tmp_path: Path, monkeypatch, capsys) -> None:
    with scripts_of(FOLDER) as script:
        module = script("rolled")

        def refuse(capture: Path) -> None:
            raise BadInput(f"{capture.name} shows no finger.")

        monkeypatch.setattr(module, "measure", refuse)
        (tmp_path / "7_1").mkdir()
        (tmp_path / "7_1" / "capture.json").write_text("{}")
        for _ in range(2):  # made, and read again
            row = module.kept(tmp_path, 7, 1, True, 0.6, "orthographic")
            assert row == {"seed": 7, "roll_deg": 20, "refused": "7_1 shows no finger."}
