"""Motion between shots: measured in size and sign, none where the finger lay still."""

import cv2
import numpy as np
import pytest

from splitknit.finger.motion import motion_findings, shot_motion


def moved(stack, k, x_mm, y_mm, px_per_mm):
    stack = stack.copy()
    matrix = np.array([[1.0, 0.0, x_mm * px_per_mm], [0.0, 1.0, -y_mm * px_per_mm]])
    size = (stack.shape[2], stack.shape[1])
    stack[k] = cv2.warpAffine(
        stack[k], matrix, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
    )
    return stack


@pytest.fixture(scope="module")
def scene(draw_finger):
    return draw_finger("medium", px_per_mm=16.0, ridges=0.05)


def test_a_still_finger_shows_no_motion(scene):
    motion = shot_motion(scene.stack, scene.mask, 16.0)
    assert np.hypot(*motion.shift_mm.T).max() < 0.02
    assert motion.reliability.min() > 0.8
    assert motion_findings(motion) == ()


@pytest.mark.parametrize(("k", "x", "y"), [(0, 0.1, 0.0), (3, -0.08, 0.06), (6, 0.4, -0.3)])
def test_a_moved_shot_is_measured_and_named(scene, k, x, y):
    motion = shot_motion(moved(scene.stack, k, x, y, 16.0), scene.mask, 16.0)
    np.testing.assert_allclose(motion.shift_mm[k], [x, y], atol=0.03)
    (warning,) = motion_findings(motion)
    assert (
        f"image {k} by" in str(warning)
        and warning.code == "moved-finger"
        and warning.files == (f"image {k}",)
    )


def test_motion_does_not_depend_on_the_order_of_the_lights(scene):
    order = np.array([3, 0, 6, 1, 5, 2, 4])
    stack = moved(scene.stack, 3, 0.1, 0.0, 16.0)
    first = shot_motion(stack, scene.mask, 16.0).shift_mm
    np.testing.assert_allclose(
        shot_motion(stack[order], scene.mask, 16.0).shift_mm, first[order], atol=2e-3
    )


def test_four_shots_are_too_few_to_measure_motion(scene):
    motion = shot_motion(scene.stack[:4], scene.mask, 16.0)
    assert motion.shift_mm.shape == (4, 2)
    assert (motion.reliability == 0).all()
    assert motion_findings(motion) == ()
