"""Balls shaded and mirrored by hand, and those of the twin's bench."""

import cv2
import numpy as np
import pytest

from refusals import bad_input
from splitknit.nominal import default_rig
from splitknit_rig.calibration.sphere import (
    Ball,
    balls_of_mask,
    chrome_directions,
    find_ball,
    glints_of,
    grey_directions,
    rim_of,
    smear_px,
)
from splitknit_simulator.calibration_set.solids import SphereScene

BALL = Ball(81.3, 58.6, 41.5)
SIZE = (120, 160)


def lights(count=6):
    angles = 2 * np.pi * np.arange(count) / count
    return np.column_stack(
        [0.4 * np.cos(angles), 0.4 * np.sin(angles), np.full(count, np.sqrt(1 - 0.16))]
    )


def errors_deg(estimated, truth):
    return np.degrees(
        np.linalg.norm(estimated - truth / np.linalg.norm(truth, axis=1, keepdims=True), axis=1)
    )


def shaded(directions, strengths):
    normals = np.nan_to_num(BALL.normals(SIZE))
    light = np.einsum("hwc,lc->lhw", normals, directions) * np.asarray(strengths)[:, None, None]
    return np.clip(light, 0, 1).astype(np.float32)


def test_shading_gives_direction_and_strength():
    strengths = np.linspace(0.4, 0.8, 6)
    estimated, strong = grey_directions(shaded(lights(), strengths), BALL)
    assert errors_deg(estimated, lights()).max() < 1e-3
    assert strong == pytest.approx(strengths, rel=1e-4)


def test_directions_tolerate_gloss_clipping_and_noise():
    stack = shaded(lights(), np.full(6, 1.15))
    stack += np.random.default_rng(0).normal(0, 0.01, stack.shape).astype(np.float32)
    stack[:, 40:46, 80:86] = 1.0
    estimated, _ = grey_directions(np.clip(stack, 0, 1), BALL)
    assert errors_deg(estimated, lights()).max() < 0.3


def test_highlights_give_directions():
    """The highlight lies where the normal halves the angle to the view."""
    stack = np.zeros((6, *SIZE), np.float32)
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    for k, light in enumerate(lights()):
        half = light + np.array([0, 0, 1])
        half /= np.linalg.norm(half)
        column, row = BALL.column + half[0] * BALL.radius_px, BALL.row - half[1] * BALL.radius_px
        stack[k] = 0.02 + 0.9 * np.exp(-((columns - column) ** 2 + (rows - row) ** 2) / 8)
    assert errors_deg(chrome_directions(stack, BALL), lights()).max() < 0.2
    stack[2] = 0.02
    without = np.isnan(chrome_directions(stack, BALL)).all(axis=1)
    assert np.flatnonzero(without).tolist() == [2]


def test_a_highlight_stands_out_from_pale_ground_that_the_ball_mirrors():
    """Under a low lamp both are clipped: once apart, once the ground reaches to the highlight."""
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    out = np.hypot(columns - BALL.column, rows - BALL.row) / BALL.radius_px
    place = BALL.column + 25.0, BALL.row - 4.0
    spot = 3.0 * np.exp(-((columns - place[0]) ** 2 + (rows - place[1]) ** 2) / 5)
    low, high = (np.where(out > 0.72, columns * sign > BALL.column * sign, 0) for sign in (1, -1))
    stack = np.clip(0.01 + spot + np.array([1.2 * high, 0.45 * low]), 0, 1).astype(np.float32)
    for found in glints_of(stack, BALL):
        assert found == pytest.approx(place, abs=0.5)


def test_the_outline_is_found_in_a_mask_and_in_an_image():
    inside = np.isfinite(BALL.normals(SIZE)[..., 2])
    for outline in (
        balls_of_mask(inside)[0],
        find_ball(np.where(inside, 0.5, 0.02)[None].astype(np.float32)),
    ):
        assert (outline.column, outline.row) == pytest.approx((BALL.column, BALL.row), abs=0.2)
        assert outline.radius_px == pytest.approx(BALL.radius_px, abs=0.5)


@pytest.mark.parametrize("offset", [(0.0, 0.0, 1.04), (5.0, -2.0, 1.0), (-3.0, 4.0, 0.97)])
def test_the_rim_replaces_a_misplaced_outline(offset):
    """On a chequered table, half of the ball as bright as it."""
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    table = 0.2 + 0.1 * ((rows // 9 + columns // 9) % 2)
    edge = np.clip(BALL.radius_px + 0.5 - np.hypot(columns - BALL.column, rows - BALL.row), 0, 1)
    stack = shaded(lights(), np.full(6, 0.8))
    stack = (edge * stack + (1 - edge) * table).astype(np.float32)
    off = Ball(BALL.column + offset[0], BALL.row + offset[1], offset[2] * BALL.radius_px)
    rim, agreed = rim_of(stack, off)
    assert agreed > 0.6
    assert (rim.column, rim.row, rim.radius_px) == pytest.approx(
        (BALL.column, BALL.row, BALL.radius_px), abs=0.4
    )
    noise = np.random.default_rng(0).random(stack.shape, dtype=np.float32)
    assert rim_of(noise, off)[1] < 0.5
    assert rim_of(stack, Ball(BALL.column, BALL.row, 20.0))[1] == 0.0


@pytest.mark.parametrize("towards_deg", [0.0, 30.0, 90.0])
def test_a_smear_is_measured_and_a_lens_out_of_focus_is_none(towards_deg):
    rows, columns = np.mgrid[:300, :300]
    inside = np.clip(100.5 - np.hypot(columns - 151.0, rows - 149.0), 0, 1).astype(np.float32)
    blurred = cv2.GaussianBlur(0.02 + inside, (0, 0), 1.5)
    ball = Ball(151.3, 148.8, 100.2)
    assert smear_px(blurred, ball) < 1.0
    turn = np.deg2rad(towards_deg)
    path = [(part * np.cos(turn), part * np.sin(turn)) for part in np.linspace(-2, 2, 25)]
    moved = [
        cv2.warpAffine(blurred, np.array([[1.0, 0.0, x], [0.0, 1.0, y]]), (300, 300))
        for x, y in path
    ]
    assert smear_px(np.mean(moved, axis=0, dtype=np.float32), ball) == pytest.approx(4.0, rel=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("chrome", [True, False])
def test_simulated_balls_give_the_directions_of_their_leds(chrome):
    """The LEDs are near, so that a highlight's direction holds at the ball's surface, and shading
    is biased."""
    rig = default_rig(0.15)
    scene = SphereScene(camera=rig.camera, leds=rig.leds, chrome=chrome)
    stack = np.stack([scene.light([k]).mean(axis=2) for k in range(7)])
    stack = (0.9 * stack / (np.percentile(stack, 99.9) if not chrome else stack.max())).astype(
        np.float32
    )
    edge = scene.outline_px()
    ball = Ball(*edge.mean(axis=0), float(np.ptp(edge[:, 0]) / 2))
    estimated = chrome_directions(stack, ball) if chrome else grey_directions(stack, ball)[0]
    place = scene.highlights_mm()[:7] if chrome else scene.middle_mm
    truth = np.array([led.position_mm for led in rig.leds[:7]]) - place
    assert errors_deg(estimated, truth).max() < (0.6 if chrome else 2.6)


def test_images_and_masks_without_a_ball_are_refused():
    with bad_input("empty"):
        balls_of_mask(np.zeros(SIZE, bool))
    bar = np.zeros(SIZE, bool)
    bar[50:60] = True
    with bad_input("not a disc"):
        balls_of_mask(bar)[0]
    with bad_input("`mask`"):
        find_ball(np.repeat(bar[None].astype(np.float32), 2, axis=0))
    with bad_input("image 0"):
        grey_directions(np.zeros((1, *SIZE), np.float32), BALL)
    with bad_input("outside"):
        chrome_directions(np.ones((1, *SIZE), np.float32), Ball(1000.0, 1000.0, 5.0))
