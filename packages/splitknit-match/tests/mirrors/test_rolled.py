"""A finger between mirrors, rolled: against formulas of its own, by its views' true masks and
mirrors."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

import rolled_scene as scene
from splitknit.errors import BadInput
from splitknit.finger.locate import FingerSettings
from splitknit.mirrors.settings import MirrorShapeSettings
from splitknit.model import Capture
from splitknit.skin.images import MetricSettings
from splitknit_match.prints.rolled import _coverage_deg
from splitknit_match.rolled.finger import Rolled, rolled_finger
from splitknit_match.rolled.register import ridges_of
from splitknit_match.rolled.views import find_mirror_views


@pytest.fixture(scope="module", autouse=True)
def quick() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("splitknit_match.rolled.finger.PITCH_MM", 0.07)
        yield


@pytest.fixture(scope="module")
def finger() -> Rolled:
    capture, masks = scene.capture()
    return rolled_finger(capture, scene.views_of(capture, masks), MetricSettings())


def truth_of(finger: Rolled) -> tuple[np.ndarray, np.ndarray]:
    """True relief at the finger's points, and the slant of the skin there (deg, positive to the
    right)."""
    points = finger.points_mm.astype(np.float64) - np.array([0.0, 2.0, 0.0])
    normals, _ = scene.bumped(points)
    return scene.ridges(points), np.rad2deg(np.arctan2(normals[..., 0], normals[..., 2]))


def ridges_are_right(finger: Rolled, least: float) -> None:
    truth, slant = truth_of(finger)
    pitch = finger.chart.pitch_mm
    known = finger.blended.known
    seen, there = (
        ridges_of(f.astype(np.float32), known, pitch) for f in (finger.blended.relief_mm, truth)
    )
    straight = (finger.chart.length_mm[:, None] < 0) & (finger.chart.length_mm[:, None] > -12)
    for low, high in ((-90, -60), (-60, -30), (-30, 0), (0, 30), (30, 60), (60, 90)):
        where = known & straight & (slant > low) & (slant < high)
        assert where.sum() > 1000, (low, high)
        # places count, too: a tenth of a millimetre beside its place a ridge of 0.6 mm correlates
        # by a half; a mirror image read the wrong way round would not correlate at all
        assert np.corrcoef(seen[where], there[where])[0, 1] > least, (low, high)


@pytest.mark.slow
def test_ridges_are_found_around_the_finger_the_right_way_round(finger: Rolled) -> None:
    ridges_are_right(finger, 0.6)


@pytest.mark.slow
def test_a_perspective_camera_is_rolled_as_well() -> None:
    capture, masks = scene.perspective()
    # under spreading rays outlines leave the height open by a millimetre
    known = scene.views_of(*scene.capture())
    views = replace(known, views=tuple(replace(view, mask=masks[view.name]) for view in known))
    finger = rolled_finger(capture, views, MetricSettings())
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
    value = (
        (x / scene.A) ** 2
        + (np.maximum(y, 0) / scene.CAP) ** 2
        + ((z - scene.TOP + scene.B) / scene.B) ** 2
    )
    off = (np.sqrt(value) - 1.0) * 7.0
    rows = (finger.chart.length_mm < 4) & (finger.chart.length_mm > -12)
    assert np.sqrt((off[rows] ** 2).mean()) < 0.15


@pytest.mark.slow
def test_one_mirror_is_enough() -> None:
    capture, masks = scene.capture()
    settings = MetricSettings()
    # the left mirror's light counts, its view does not
    whole = scene.views_of(capture, masks)
    views = replace(
        whole,
        views=tuple(replace(view, mask=None) if view.name == "left" else view for view in whole),
    )
    one = rolled_finger(capture, views, settings)
    assert one.names == ("front", "right")
    truth, slant = truth_of(one)
    pitch, known = one.chart.pitch_mm, one.blended.known
    seen, there = (
        ridges_of(f.astype(np.float32), known, pitch) for f in (one.blended.relief_mm, truth)
    )
    left = known & (slant > -55) & (slant < -20) & (one.chart.length_mm[:, None] < 0)
    assert np.corrcoef(seen[left], there[left])[0, 1] > 0.75
    degrees = np.rad2deg(one.chart.angle_rad)
    seen = (
        one.blended.known[(one.chart.length_mm < 0) & (one.chart.length_mm > -12)].mean(axis=0)
        > 0.9
    )
    assert seen[np.abs(degrees - 95).argmin()]
    assert not seen[np.abs(degrees + 95).argmin()]


def test_captures_that_cannot_be_rolled_are_told_so() -> None:
    rig = scene.rig()
    capture = Capture(rig, {}, material="opaque")
    with pytest.raises(BadInput, match="no band 'white'"):
        find_mirror_views(capture, FingerSettings(), MirrorShapeSettings())
    with pytest.raises(BadInput, match="has no mirrors beside the finger"):
        find_mirror_views(
            replace(capture, rig=replace(rig, mirrors=())), FingerSettings(), MirrorShapeSettings()
        )
