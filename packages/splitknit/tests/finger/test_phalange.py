"""The first flexion crease: found where it is, never where there is none."""

import numpy as np
import pytest

from splitknit.finger.orientation import find_upright
from splitknit.finger.phalange import find_crease, phalange_mask


def search(scene):
    upright = find_upright(scene.mask)
    return upright, find_crease(scene.grey, scene.mask, upright, scene.px_per_mm)


@pytest.mark.parametrize("tone", ["very dark", "dark", "medium", "very light"])
@pytest.mark.parametrize("shadow", ["", "step", "side"])
def test_a_crease_is_found_for_every_tone_and_in_shadow(draw_finger, tone, shadow):
    _, crease = search(draw_finger(tone, shadow=shadow))
    assert crease.detected
    assert crease.distance_mm == pytest.approx(25.0, abs=0.5)
    assert "cut at" in str(crease.verdict)


@pytest.mark.parametrize("shadow", ["", "step", "gradient", "side"])
@pytest.mark.parametrize("seed", range(4))
def test_a_finger_without_a_crease_is_not_cut(draw_finger, shadow, seed):
    scene = draw_finger("medium", creases=(), shadow=shadow, seed=seed, yaw_deg=5.0 * seed)
    upright, crease = search(scene)
    assert not crease.detected
    assert crease.line is None
    assert "no flexion crease" in str(crease.verdict)
    np.testing.assert_array_equal(phalange_mask(scene.mask, crease, upright), scene.mask)


def test_the_edge_of_a_shadow_is_not_taken_for_a_crease(draw_finger):
    # the shadow begins 14 mm below the tip
    scene = draw_finger("medium", creases=((18.5, 0.15),), shadow="step")
    _, crease = search(scene)
    assert crease.distance_mm == pytest.approx(18.5, abs=0.5)


@pytest.mark.parametrize("yaw", [0.0, 25.0, -50.0])
def test_crease_line_and_cut_follow_the_finger(draw_finger, yaw):
    tip = (-0.12 * yaw, 15.0 - 0.1 * abs(yaw))
    scene = draw_finger(
        "medium", yaw_deg=yaw, tip_at=tip, creases=((20.0, 0.2),), crease_tilt_deg=6.0
    )
    upright, crease = search(scene)
    assert crease.distance_mm == pytest.approx(20.0, abs=0.5)
    cut = phalange_mask(scene.mask, crease, upright)
    assert not (cut & ~scene.mask).any()
    rows, columns = np.nonzero(scene.mask)
    angle = np.deg2rad(yaw)
    x, y = columns - scene.tip[0], scene.tip[1] - rows
    below = (x * np.sin(angle) - y * np.cos(angle)) / scene.px_per_mm
    kept = cut[rows, columns]
    assert kept[below < 19.3].all()
    assert not kept[below > 20.7].any()
    (x0, y0), (x1, y1) = crease.line
    assert np.hypot(x1 - x0, y1 - y0) == pytest.approx(16.0 * scene.px_per_mm, rel=0.15)
    lean = -np.rad2deg(np.arctan2(y1 - y0, x1 - x0)) - yaw
    assert lean == pytest.approx(-6.0, abs=4.0)


def test_of_two_creases_the_first_clear_one_is_taken(draw_finger):
    far = draw_finger(
        "medium", size_mm=(60.0, 29.0), tip_at=(0.0, 28.0), creases=((23.0, 0.12), (46.0, 0.2))
    )
    _, crease = search(far)
    # the deeper second joint is not taken
    assert crease.distance_mm == pytest.approx(23.0, abs=0.5)
    long = draw_finger(
        "medium", size_mm=(60.0, 29.0), tip_at=(0.0, 28.0), creases=((22.0, 0.14), (36.0, 0.2))
    )
    # the usual place outweighs some depth
    assert search(long)[1].distance_mm == pytest.approx(22.0, abs=0.5)
    doublet = draw_finger("medium", creases=((23.0, 0.15), (26.5, 0.15)))
    assert search(doublet)[1].distance_mm == pytest.approx(23.0, abs=0.5)
    faint = draw_finger("medium", creases=((22.0, 0.06), (25.5, 0.2)))
    assert search(faint)[1].distance_mm == pytest.approx(25.5, abs=0.5)


def test_a_line_too_near_the_tip_is_no_first_crease(draw_finger):
    _, crease = search(draw_finger("medium", creases=((10.0, 0.2),)))
    assert not crease.detected
    assert "none where the first flexion crease" in str(crease.verdict)


def test_half_a_line_is_no_crease(draw_finger):
    scene = draw_finger("medium", creases=())
    stack = scene.stack.copy()
    middle = stack.shape[2] // 2
    row = int(scene.tip[1] + 25 * scene.px_per_mm)
    stack[:, row - 6 : row + 6, :middle] *= 0.8
    upright = find_upright(scene.mask)
    assert not find_crease(stack.mean(axis=0), scene.mask, upright, scene.px_per_mm).detected
