"""A finger that moves from shot to shot: its path, its pictures, and the truth of where its skin
went."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit_simulator.finger.motion import HandMotion, draw_path
from splitknit_simulator.rigs import MirrorSettings, coloured_rig
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import simulate_capture

SCALE = 0.08


def twin(**motion: float) -> TwinSettings:
    return TwinSettings(scale=SCALE, motion=HandMotion(**motion))


@pytest.fixture(scope="module")
def still():
    return simulate_capture(5, None, TwinSettings(scale=SCALE))


@pytest.fixture(scope="module")
def moved():
    return simulate_capture(5, None, twin(amplitude_mm=0.5))


@pytest.mark.parametrize("seed", range(4))
def test_the_amplitude_is_the_largest_distance_between_shots(seed):
    settings = HandMotion(amplitude_mm=0.4)
    path = draw_path(np.random.default_rng(seed), 14, settings, 3)
    between = np.linalg.norm(path.shift_mm[:, None] - path.shift_mm[None], axis=-1)
    assert between.max() == pytest.approx(0.4)
    assert path.reference == 3
    assert (
        not path.shift_mm[3].any()
        and not path.slip[3].any()
        and path.yaw_rad[3] == path.roll_rad[3] == 0
    )
    assert np.rad2deg(np.ptp(path.yaw_rad)) == pytest.approx(0.6)
    slips = np.linalg.norm(path.slip[:, None] - path.slip[None], axis=-1)
    assert slips.max() == pytest.approx(0.04)


@pytest.mark.slow
def test_the_reference_shot_shows_the_finger_as_if_still(still, moved):
    (capture, truth), (moved_capture, moved_truth) = still, moved
    np.testing.assert_array_equal(moved_truth["height_mm"], truth["height_mm"])
    ratio = float(moved_truth["exposure_white"] / truth["exposure_white"])
    still_image, moved_image = (
        c.bands["white"].pixels[3].astype(float) for c in (capture, moved_capture)
    )
    # noise, and the blur of the tremor
    assert np.abs(moved_image - ratio * still_image)[truth["mask"]].mean() < 2.0
    still_image, moved_image = (
        c.bands["white"].pixels[6].astype(float) for c in (capture, moved_capture)
    )
    assert np.abs(moved_image - ratio * still_image)[truth["mask"]].mean() > 3.0


@pytest.mark.slow
def test_undoing_the_true_flow_sharpens_the_mean_of_shots(moved):
    capture, truth = moved
    flow, rows, columns = truth["motion_flow_px"], truth["motion_rows"], truth["motion_columns"]
    assert flow.shape == (14, 2, len(rows), len(columns))
    inside = np.isfinite(flow[3, 0])
    assert np.abs(flow[3][:, inside]).max() < 1e-3
    # undone, a shot with about the same light as the reference looks like it: by far more than it
    # does as it is
    height, width = truth["mask"].shape
    at = np.meshgrid(np.arange(width), np.arange(height))
    step = rows[1] - rows[0]
    grid = [
        ((a - first) / step).astype(np.float32)
        for a, first in zip(at, (columns[0], rows[0]), strict=True)
    ]
    shots = capture.bands["white"].pixels[..., 1].astype(np.float32)
    mean = np.zeros((2, height, width), dtype=np.float32)
    for k, shot in enumerate(shots):
        u, v = (cv2.remap(np.nan_to_num(part), *grid, cv2.INTER_LINEAR) for part in flow[k])
        there = [(a + d).astype(np.float32) for a, d in zip(at, (u, v), strict=True)]
        mean += np.stack([shot, cv2.remap(shot, *there, cv2.INTER_CUBIC)]) / len(shots)
    core = cv2.erode(truth["mask"].astype(np.uint8), np.ones((25, 25))) > 0
    detail = [m - cv2.GaussianBlur(m, (0, 0), 2.0) for m in mean]
    assert detail[1][core].std() > 1.15 * detail[0][core].std()


@pytest.mark.slow
def test_coloured_leds_that_share_an_exposure_show_the_finger_at_one_place():
    rig = coloured_rig(0.12, 0)
    rig = replace(rig, leds=rig.leds[:6])
    (still, _), (moved, truth) = (
        simulate_capture(5, None, replace(twin(amplitude_mm=a), rig=rig)) for a in (0.0, 0.5)
    )
    assert truth["motion_shift_mm"].shape == (2, 2) and int(truth["motion_reference"]) == 1
    assert np.hypot(*truth["motion_shift_mm"][0]) == pytest.approx(0.5)
    first, second = still.bands["white"], moved.bands["white"]
    assert second.leds == first.leds
    inside = cv2.erode(truth["mask"].astype(np.uint8), np.ones((5, 5))) > 0
    changed = [
        np.abs(b.astype(float) - a)[inside].mean(axis=0)
        for a, b in zip(first.pixels, second.pixels, strict=True)
    ]
    assert changed[1].max() < 2.0  # the reference: noise and tremor
    assert changed[0].min() > 5 * changed[1].max()  # every colour has moved


def test_motion_between_mirrors_is_refused():
    with pytest.raises(BadInput, match="mirrors"):
        simulate_capture(
            5, None, replace(twin(amplitude_mm=0.2), mirrors=MirrorSettings(names=("left",)))
        )
