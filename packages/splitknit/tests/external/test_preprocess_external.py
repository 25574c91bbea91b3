"""Preprocessing on images that nobody on this project made."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from splitknit.finger.contrast import clahe
from splitknit.finger.mask import finger_mask, touched_borders
from splitknit.finger.motion import motion_findings, shot_motion
from splitknit.finger.orientation import find_upright
from splitknit.finger.phalange import find_crease, phalange_mask
from splitknit.finger.quality import capture_quality, photometric_mask

pytestmark = pytest.mark.external


@pytest.fixture(scope="module")
def phalange(data_dir):
    folder = data_dir / "blender_finger" / "phalange"
    files = sorted(folder.glob("light_*.png"))
    stack = (
        np.stack([cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in files]).astype(np.float32)
        / 255
    )
    mask = cv2.imread(str(folder / "mask.png"), cv2.IMREAD_GRAYSCALE) > 127
    return stack, mask


@pytest.mark.parametrize("px_per_mm", [75.7, 37.0])
def test_sculpted_phalange_on_a_grey_backdrop(phalange, px_per_mm):
    stack, given = phalange
    mask = finger_mask(stack.mean(axis=0), px_per_mm)
    assert touched_borders(mask) == ("top", "bottom")
    assert (mask & given).sum() / (mask | given).sum() > 0.94


def test_given_mask_through_all_steps(phalange):
    stack, given = phalange
    grey = stack.mean(axis=0)
    upright = find_upright(given)
    assert abs(upright.yaw_rad) < np.deg2rad(8)
    crease = find_crease(grey, given, upright, 37.0)
    assert not crease.found
    assert phalange_mask(given, crease, upright) is given
    refined = photometric_mask(stack, given, 37.0)
    assert refined.sum() > 0.95 * given.sum()
    quality = capture_quality(stack, given, 37.0)
    assert quality["ridge_contrast"] > 0.02
    assert motion_findings(shot_motion(stack, given, 37.0)) == ()
    equalised = clahe(stack[0], 37.0, mask=given)
    assert equalised[given].std() > 2 * stack[0][given].std() / stack[0][given].max() * 0.5
