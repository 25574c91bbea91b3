"""The finger's shape from the outlines of its views: against the truth, with mirrors off their
place, and refused."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from mirrored import scene, turned
from refusals import bad_input
from splitknit.mirrors.mirror import mirror_shape
from splitknit.mirrors.views import Views


@pytest.fixture(scope="module")
def finger():
    return scene(9002)


def only(views, *names):
    return replace(views, mirrors={name: views.mirrors[name] for name in names})


def test_one_mirror_gives_the_shape(finger):
    shape = mirror_shape(only(finger.views, "left"), finger.rig)
    assert finger.rms_mm(shape) < 0.2
    pose = shape.facts["poses"]["left"]
    # the mirror stands where the rig file says
    assert abs(pose["turn_deg"]) < 0.3 and abs(pose["lean_deg"]) < 1.0
    x, y, z = shape.points(slice(None), slice(None))
    inside = np.isfinite(z)
    assert 0.9 < inside.sum() / finger.mask.sum() < 1.02
    assert (
        np.allclose(np.diff(x[0]), 1 / finger.rig.camera.px_per_mm, rtol=1e-3)
        and y[0, 0] > y[-1, 0]
    )


@pytest.mark.parametrize(("turn", "lean", "shift"), [(3.0, 0.0, 2.0), (-2.0, -2.2, -2.0)])
def test_a_misplaced_mirror_is_located(finger, turn, lean, shift):
    """The rig file is wrong by up to 3 deg and 2 mm; the view is the true mirror's."""
    wrong = replace(
        finger.rig,
        mirrors=tuple(turned(mirror, turn, lean, shift) for mirror in finger.rig.mirrors),
    )
    for names in (("left",), ("left", "right")):
        shape = mirror_shape(only(finger.views, *names), wrong)
        assert finger.rms_mm(shape) < 0.25
        for name in names:
            assert shape.facts["poses"][name]["turn_deg"] == pytest.approx(-turn, abs=0.3)


def test_views_of_two_fingers_are_refused(finger):
    """The mirror shows a finger at another place along the mirror, or one of another thickness."""
    elsewhere = np.roll(finger.views.mirrors["left"], 60, axis=0)
    elsewhere[:60] = False
    with bad_input("do not fit one finger"):
        mirror_shape(Views(finger.views.front, {"left": elsewhere}, 1), finger.rig)
    mask = finger.views.mirrors["left"]
    middle = int(np.flatnonzero(mask.any(axis=0)).mean())
    size = (mask.shape[1], mask.shape[0])
    thin = (
        cv2.warpAffine(
            mask.astype(np.uint8), np.array([[0.3, 0.0, 0.7 * middle], [0.0, 1.0, 0.0]]), size
        )
        > 0
    )
    with bad_input("times as thick as it is broad"):
        mirror_shape(Views(finger.views.front, {"left": thin}, 1), finger.rig)


@pytest.mark.slow
def test_a_perspective_camera_sees_the_same_finger():
    seen = scene(9002, ("left",), model="perspective")
    assert seen.rig.camera.model == "perspective"
    assert seen.rms_mm(mirror_shape(seen.views, seen.rig)) < 0.2
