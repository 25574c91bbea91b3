"""A finger between mirrors, rolled: against formulas of its own, by its views' true masks and mirrors."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import rolled_scene as scene
from splitknit.errors import BadInput
from splitknit.finger.locate import FingerSettings
from splitknit.mirrors.settings import MirrorShapeSettings
from splitknit.model import Capture
from splitknit.skin.grid import Grid
from splitknit.skin.light import Lighting
from splitknit_match.prints.rolled import _coverage_deg
from splitknit_match.rolled.blend import RolledSettings
from splitknit_match.rolled.finger import Rolled, _apart, _base, rolled_finger
from splitknit_match.rolled.register import RidgeSearchSettings, ridges_of
from splitknit_match.rolled.views import _notes, find_mirror_views
from splitknit_match.rolled.work import ReliefSettings, _lit

QUICK = RolledSettings(
    pitch_mm=0.07, search=RidgeSearchSettings(across_mm=(0.6, 0.06), along_mm=(0.06, 0.06), candidates=3)
)


@pytest.fixture(scope="module")
def finger() -> Rolled:
    capture, masks = scene.capture()
    return rolled_finger(capture, scene.views_of(capture, masks), ReliefSettings(), QUICK)


def truth_of(finger: Rolled) -> tuple[np.ndarray, np.ndarray]:
    """True relief at the finger's points, and the slant of the skin there (deg, positive to the right)."""
    points = finger.points_mm.astype(np.float64) - np.array([0.0, 2.0, 0.0])
    normals, _ = scene.bumped(points)
    return scene.ridges(points), np.rad2deg(np.arctan2(normals[..., 0], normals[..., 2]))


def ridges_are_right(finger: Rolled, least: float) -> None:
    truth, slant = truth_of(finger)
    pitch = finger.chart.pitch_mm
    known = finger.blended.known
    seen, there = (ridges_of(f.astype(np.float32), known, pitch) for f in (finger.blended.relief_mm, truth))
    straight = (finger.chart.length_mm[:, None] < 0) & (finger.chart.length_mm[:, None] > -12)
    for low, high in ((-90, -60), (-60, -30), (-30, 0), (0, 30), (30, 60), (60, 90)):
        where = known & straight & (slant > low) & (slant < high)
        assert where.sum() > 1000, (low, high)
        # places count, too: a tenth of a millimetre beside its place a ridge of 0.6 mm correlates by a half; a mirror
        # image read the wrong way round would not correlate at all
        assert np.corrcoef(seen[where], there[where])[0, 1] > least, (low, high)


@pytest.mark.slow
def test_ridges_are_found_around_the_finger_the_right_way_round(finger: Rolled) -> None:
    ridges_are_right(finger, 0.6)


@pytest.mark.slow
def test_a_perspective_camera_is_rolled_as_well() -> None:
    capture, masks = scene.perspective()
    known = scene.views_of(*scene.capture())  # under spreading rays outlines leave the height open by a millimetre
    views = replace(known, views=tuple(replace(view, mask=masks[view.name]) for view in known))
    finger = rolled_finger(capture, views, ReliefSettings(), QUICK)
    ridges_are_right(finger, 0.5)  # a mirror's view is of 14.8 pixels a millimetre, not of 18
    test_it_reaches_further_than_the_front(finger)


@pytest.mark.slow
def test_it_reaches_further_than_the_front(finger: Rolled) -> None:
    normals = finger.normals.astype(np.float64)
    rows = (finger.chart.length_mm < 0) & (finger.chart.length_mm > -12)
    around = _coverage_deg(finger.chart, finger.blended.known, normals)[rows]
    front = _coverage_deg(finger.chart, finger.blended.fractions[0] > 0.001, normals)[rows]
    assert np.median(around) > 180
    assert np.median(front) < 150
    assert finger.names == ("front", "left", "right")
    assert np.allclose(finger.blended.fractions.sum(axis=0)[finger.blended.known], 1.0, atol=1e-4)


@pytest.mark.slow
def test_the_surface_is_the_finger(finger: Rolled) -> None:
    points = finger.points_mm.astype(np.float64) - np.array([0.0, 2.0, 0.0])
    x, y, z = np.moveaxis(points, -1, 0)
    value = (x / scene.A) ** 2 + (np.maximum(y, 0) / scene.CAP) ** 2 + ((z - scene.TOP + scene.B) / scene.B) ** 2
    off = (np.sqrt(value) - 1.0) * 7.0
    rows = (finger.chart.length_mm < 4) & (finger.chart.length_mm > -12)
    assert np.sqrt((off[rows] ** 2).mean()) < 0.15


@pytest.mark.slow
def test_one_mirror_is_enough_and_none_is_refused() -> None:
    capture, masks = scene.capture()
    settings = ReliefSettings()
    # the left mirror's light counts, its view does not
    whole = scene.views_of(capture, masks)
    views = replace(whole, views=tuple(replace(view, mask=None) if view.name == "left" else view for view in whole))
    one = rolled_finger(capture, views, settings, QUICK)
    assert one.names == ("front", "right")
    truth, slant = truth_of(one)
    pitch, known = one.chart.pitch_mm, one.blended.known
    seen, there = (ridges_of(f.astype(np.float32), known, pitch) for f in (one.blended.relief_mm, truth))
    left = known & (slant > -55) & (slant < -20) & (one.chart.length_mm[:, None] < 0)
    assert np.corrcoef(seen[left], there[left])[0, 1] > 0.75
    degrees = np.rad2deg(one.chart.angle_rad)
    seen = one.blended.known[(one.chart.length_mm < 0) & (one.chart.length_mm > -12)].mean(axis=0) > 0.9
    assert seen[np.abs(degrees - 95).argmin()]
    assert not seen[np.abs(degrees + 95).argmin()]
    with pytest.raises(BadInput, match="no mirror beside the finger shows it"):
        rolled_finger(capture, replace(whole, views=whole.views[:1]), settings, QUICK)
    with pytest.raises(BadInput, match="front view"):
        rolled_finger(capture, replace(whole, views=whole.views[1:]), settings, QUICK)


def test_captures_that_cannot_be_rolled_are_told_so() -> None:
    rig = scene.rig()
    capture = Capture(rig, {}, material="opaque")
    with pytest.raises(BadInput, match="no band 'white'"):
        find_mirror_views(capture, FingerSettings(), MirrorShapeSettings())
    with pytest.raises(BadInput, match="has no mirrors beside the finger"):
        find_mirror_views(replace(capture, rig=replace(rig, mirrors=())), FingerSettings(), MirrorShapeSettings())


def test_settings_are_checked() -> None:
    for wrong in ({"around_deg": 170.0}, {"pitch_mm": 0.0}):
        with pytest.raises(BadInput, match="rolled"):
            RolledSettings(**wrong)


def test_what_became_of_a_view_is_told_in_a_sentence_each() -> None:
    told = _notes(["left"], ["right"], [])
    assert len(told) == 2
    assert told[0].startswith("the view in the left mirror is cut off")
    assert "left out" in told[1]
    assert "no finger was found in the right mirror" in _notes([], [], ["right"])[0]
    assert _notes([], [], [], ["tip"]) == ("the tip mirror gives light only: its view is not used for the print.",)
    work = SimpleNamespace(correlation={"left": [0.5, 0.1], "right": [0.2, 0.6]})
    (said,) = _apart(work)  # type: ignore[arg-type]
    assert said.startswith("ridges of the left mirror's view do not lie on the front's (correlation 0.10)")
    (said,) = _apart(SimpleNamespace(correlation={"left": [0.5, 0.35], "right": [0.2, 0.41]}))  # type: ignore[arg-type]
    assert said.startswith("ridges of the left mirror's view may not lie on the front's (correlation 0.35)")


def test_all_views_end_where_the_front_does() -> None:
    front = np.zeros((40, 60), dtype=bool)
    front[5:30, 10:50] = True
    front[30:34, 10:30] = True  # a slanted crease
    assert _base(front) == 30
    assert _base(np.zeros((40, 60), dtype=bool)) == 40


def test_skin_with_fewer_than_three_lights_is_not_trusted() -> None:
    grid = Grid(np.ones((50, 80), dtype=bool), np.arange(80) * 0.05, -np.arange(50) * 0.05, 0.05, (False,) * 4)
    trust = np.ones((6, 50, 80), dtype=np.float32)
    trust[2:, :, 40:] = 0.1
    found = _lit(Lighting(np.zeros((6, 3, 50, 80), np.float32), np.ones_like(trust), trust), grid)
    assert (found[:, :25] > 0.99).all()
    assert not found[:, 55:].any()
