"""A finger between mirrors, rolled from the true masks and mirrors, against its formulas."""

from dataclasses import replace

import numpy as np
import pytest

import rolled_scene as scene
from refusals import bad_input
from splitknit.capture import Capture
from splitknit.finger.locate import FingerSettings
from splitknit.skin.images import MetricSettings
from splitknit_match.prints.rolled import _coverage_deg
from splitknit_match.rolled.finger import rolled_finger
from splitknit_match.rolled.register import ridges_of
from splitknit_match.rolled.views import find_mirror_views


@pytest.fixture(scope="module", autouse=True)
def quick():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("splitknit_match.rolled.finger.PITCH_MM", 0.07)
        yield


@pytest.fixture(scope="module")
def finger():
    capture, masks = scene.capture()
    return rolled_finger(capture, scene.views_of(capture, masks), MetricSettings())


def truth_of(finger):
    """True relief at the finger's points, and the slant of the skin there (deg)."""
    points = finger.points_mm.astype(np.float64) - np.array([0.0, 2.0, 0.0])
    normals, _ = scene.bumped(points)
    return scene.ridges(points), np.rad2deg(np.arctan2(normals[..., 0], normals[..., 2]))


def ridges_and_slant(finger):
    """Measured and true ridges, and the slant of the skin (deg, positive to the right)."""
    true, slant = truth_of(finger)
    blended, pitch = finger.blended, finger.chart.pitch_mm
    measured, there = (
        ridges_of(f.astype(np.float32), blended.known, pitch) for f in (blended.relief_mm, true)
    )
    return measured, there, slant


def straight_rows(finger):
    return (finger.chart.length_mm < 0) & (finger.chart.length_mm > -12)


def assert_true_ridges(finger, least):
    measured, true, slant = ridges_and_slant(finger)
    straight = finger.blended.known & straight_rows(finger)[:, None]
    for low, high in ((-90, -60), (-60, -30), (-30, 0), (0, 30), (30, 60), (60, 90)):
        where = straight & (slant > low) & (slant < high)
        assert where.sum() > 1000, (low, high)
        # places count, too: a tenth of a millimetre beside its place a ridge of 0.6 mm correlates
        # by a half; a mirror image read the wrong way round would not correlate at all
        assert np.corrcoef(measured[where], true[where])[0, 1] > least, (low, high)


def assert_covers_both_sides(finger):
    normals, rows, blended = (
        finger.normals.astype(np.float64),
        straight_rows(finger),
        finger.blended,
    )
    around = _coverage_deg(finger.chart, blended.known, normals)[rows]
    front = _coverage_deg(finger.chart, blended.fractions[0] > 0.001, normals)[rows]
    assert np.median(around) > 180
    assert np.median(front) < 150
    assert finger.names == ("front", "left", "right")
    assert np.allclose(blended.fractions.sum(axis=0)[blended.known], 1.0, atol=1e-4)


@pytest.mark.slow
def test_ridges_around_the_finger_are_true(finger):
    assert_true_ridges(finger, 0.6)


@pytest.mark.slow
def test_the_mirrors_add_the_sides_to_the_front(finger):
    assert_covers_both_sides(finger)


@pytest.mark.slow
def test_a_capture_of_a_perspective_camera_is_rolled():
    capture, masks = scene.perspective()
    # under spreading rays outlines leave the height open by a millimetre
    parallel = scene.views_of(*scene.capture())
    views = tuple(replace(view, mask=masks[view.name]) for view in parallel)
    finger = rolled_finger(capture, replace(parallel, views=views), MetricSettings())
    assert_true_ridges(finger, 0.5)  # a mirror's view has 14.8 pixels a millimetre, not 18
    assert_covers_both_sides(finger)


@pytest.mark.slow
def test_the_surface_is_the_finger(finger):
    rows = (finger.chart.length_mm < 4) & (finger.chart.length_mm > -12)
    off = scene.off_surface_mm(finger.points_mm[rows].astype(np.float64))
    assert np.sqrt((off**2).mean()) < 0.15


@pytest.mark.slow
def test_one_mirror_shows_its_side():
    capture, masks = scene.capture()
    # the left mirror's light counts, its view does not
    both = scene.views_of(capture, masks)
    views = (replace(view, mask=None) if view.name == "left" else view for view in both)
    finger = rolled_finger(capture, replace(both, views=tuple(views)), MetricSettings())
    assert finger.names == ("front", "right")
    measured, true, slant = ridges_and_slant(finger)
    known, chart = finger.blended.known, finger.chart
    left = known & (slant > -55) & (slant < -20) & (chart.length_mm[:, None] < 0)
    assert np.corrcoef(measured[left], true[left])[0, 1] > 0.75
    degrees = np.rad2deg(chart.angle_rad)
    covered = known[straight_rows(finger)].mean(axis=0) > 0.9
    assert covered[np.abs(degrees - 95).argmin()]
    assert not covered[np.abs(degrees + 95).argmin()]


def test_captures_without_white_light_or_mirrors_are_refused():
    rig = scene.rig()
    for mirrors, words in (
        (rig.mirrors, "no band 'white'"),
        ((), "has no mirrors beside the finger"),
    ):
        capture = Capture(replace(rig, mirrors=mirrors), {}, material="opaque")
        with bad_input(words):
            find_mirror_views(capture, FingerSettings())
