"""Two results beside each other: the second is laid on the first."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from perfect_results import write_perfect
from splitknit.finger.orientation import find_upright
from splitknit.imaging.geometry import rotation_about
from splitknit.model import default_rig
from splitknit.viewer.catalogue import make_catalogue
from splitknit.viewer.surface import read_surface
from splitknit_match.viewer.marks import Marks
from splitknit_match.viewer.pair import Alignment, _fitted, _turned, align_results, difference, matched_marks
from splitknit_simulator.finger.finger import FingerPose, draw_finger, finger_surface


@pytest.fixture(scope="module")
def fingers(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One finger, upright and turned by 7 deg in its upright frame, and another finger."""
    folder = tmp_path_factory.mktemp("pair")
    camera = default_rig(0.15).camera
    for seed, name, turn_deg in ((721, "a", 0.0), (721, "turned", 7.0), (722, "other", 0.0)):
        seen = finger_surface(draw_finger(seed, "right_loop"), FingerPose(insertion_mm=27.0), camera)
        upright = find_upright(seen.mask)
        middle = ((upright.size[1] - 1) / 2, (upright.size[0] - 1) / 2)
        matrix = upright.input_from_upright @ rotation_about(middle, np.deg2rad(turn_deg))
        write_perfect(folder / name, seen, camera, replace(upright, input_from_upright=matrix))
    return folder


def aligned(first: Path, second: Path) -> tuple[Alignment, np.ndarray, np.ndarray]:
    """Return how `second` is laid on `first`, and the places of the same pixels in both."""
    entries = make_catalogue([first, second]).entries
    surfaces = [read_surface(entry.folder) for entry in entries]
    found = align_results(entries[0], surfaces[0], entries[1], surfaces[1])
    points = [np.stack([s.x_mm, s.y_mm, s.height_mm], axis=-1)[s.mask][::50] for s in surfaces]
    return found, points[0], points[1]


def test_ridges_lay_one_impression_on_the_other(fingers: Path) -> None:
    found, here, there = aligned(fingers / "a", fingers / "turned")
    assert found.how == "ridges"
    assert found.similarity is not None and found.similarity > 0.8
    assert abs(np.rad2deg(found.turn_rad)) == pytest.approx(7.0, abs=0.7)
    apart = np.linalg.norm(found.moved(there) - here, axis=1)
    assert np.sqrt(np.mean(apart**2)) < 0.15
    back, _, _ = aligned(fingers / "turned", fingers / "a")
    assert back.turn_rad == pytest.approx(-found.turn_rad, abs=0.01)


@pytest.mark.slow
def test_other_fingers_are_told_by_their_similarity(fingers: Path) -> None:
    found, _, _ = aligned(fingers / "a", fingers / "other")
    assert found.similarity is not None and found.similarity < 0.5


def test_results_of_the_same_photographs_lie_exactly(shown: Path) -> None:
    found, here, there = aligned(shown / "metric", shown / "ea")
    assert found.how == "photographs"
    np.testing.assert_allclose(found.moved(there), here, atol=1e-5)


def test_minutiae_are_matched_where_place_and_direction_fit() -> None:
    place = np.array([[0.0, 0.0, 1.0], [3.0, 0.0, 1.0], [6.0, 0.0, 1.0], [9.0, 9.0, np.nan]])
    tail = place + np.array([0.6, 0.0, 0.0])
    marks = Marks(*np.zeros((3, 4)), ("ending",) * 4, np.zeros(4, int), place, tail)
    turn = Alignment("ridges", _turned(0.0, 0.0, 0.3), np.array([1.0, -2.0, 0.0]))
    back = Alignment("ridges", _turned(0.0, 0.0, -0.3))
    moved = [back.moved(points - np.array([1.0, -2.0, 0.0])) for points in (place, tail)]
    moved[0][0] += [0.3, 0.0, 0.0]  # near enough
    moved[1][0] += [0.3, 0.0, 0.0]
    moved[1][1] = moved[0][1] - (moved[1][1] - moved[0][1])  # the other way round
    other = Marks(*np.zeros((3, 4)), ("ending",) * 4, np.zeros(4, int), moved[0], moved[1])
    assert sorted(matched_marks(marks, other, turn)) == [(0, 0), (2, 2)]


def test_a_tilted_finger_is_laid_down_again(fingers: Path) -> None:
    """A finger is tilted and raised; what is found undoes it, and what is left of the difference is small."""
    surface = read_surface(fingers / "a")
    rotation = _turned(0.03, -0.06, 0.01)
    middle = np.array([field[surface.mask].mean() for field in (surface.x_mm, surface.y_mm, surface.height_mm)])
    motion = Alignment("ridges", rotation, middle - rotation @ middle + np.array([0.06, -0.05, 0.4]))
    height, ridge = motion.read(surface)(*(f[surface.mask].astype(float) for f in (surface.x_mm, surface.y_mm)))
    moved = replace(surface, height_mm=np.full_like(surface.height_mm, np.nan), ridge_mm=surface.ridge_mm.copy())
    moved.height_mm[surface.mask], moved.ridge_mm[surface.mask] = height, np.nan_to_num(ridge)
    before = difference(surface, moved, Alignment("ridges"))[1]
    found = _fitted(Alignment("ridges"), surface, moved)
    after = difference(surface, moved, found)[1]
    assert before["rms_um"] > 400
    assert after["rms_um"] < 15 and after["relief_rms_um"] < 0.4 * before["relief_rms_um"]
    assert after["area_mm2"] > 0.9 * surface.count * surface.pitch_mm**2
    np.testing.assert_allclose(found.rotation, motion.rotation.T, atol=0.002)
    assert found.tilt_rad == pytest.approx(np.hypot(0.03, 0.06), abs=0.002)


def test_a_difference_is_in_um_and_has_its_sign(shown: Path) -> None:
    surface = read_surface(shown / "metric")
    bump = np.zeros_like(surface.height_mm)
    rows, columns = np.argwhere(surface.mask).mean(axis=0).astype(int)
    bump[rows - 10 : rows + 10, columns - 10 : columns + 10] = 0.05
    other = replace(surface, height_mm=surface.height_mm + bump)
    picture, figures = difference(surface, other, Alignment("photographs"))
    height, width = picture.shape
    top, left = (rows + surface.corner[0]) / surface.size[0], (columns + surface.corner[1]) / surface.size[1]
    middle = int(picture[int(top * height), int(left * width)])
    assert (middle - 128) / 127 * figures["range_um"] == pytest.approx(min(50.0, figures["range_um"]), abs=1)
    assert picture[0, 0] == 0  # unknown
    inside = bump[surface.mask]
    assert figures["rms_um"] == pytest.approx(1000 * np.sqrt(np.mean(inside**2)), rel=0.05)
