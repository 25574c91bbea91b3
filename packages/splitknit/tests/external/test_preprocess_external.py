"""Preprocessing on images that nobody on this project made."""

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
def test_a_sculpted_phalange_on_a_grey_background_is_segmented(phalange, px_per_mm):
    stack, known_mask = phalange
    mask = finger_mask(stack.mean(axis=0), px_per_mm)
    assert touched_borders(mask) == ("top", "bottom")
    assert (mask & known_mask).sum() / (mask | known_mask).sum() > 0.94


def test_a_given_mask_passes_all_steps_of_preprocessing(phalange):
    stack, known_mask = phalange
    upright = find_upright(known_mask)
    assert abs(upright.yaw_rad) < np.deg2rad(8)
    crease = find_crease(stack.mean(axis=0), known_mask, upright, 37.0)
    assert not crease.detected
    assert phalange_mask(known_mask, crease, upright) is known_mask
    refined = photometric_mask(stack, known_mask, 37.0)
    assert refined.sum() > 0.95 * known_mask.sum()
    quality = capture_quality(stack, known_mask, 37.0)
    assert quality["ridge_contrast"] > 0.02
    assert motion_findings(shot_motion(stack, known_mask, 37.0)) == ()
    equalised = clahe(stack[0], 37.0, mask=known_mask)
    assert (
        equalised[known_mask].std()
        > 2 * stack[0][known_mask].std() / stack[0][known_mask].max() * 0.5
    )
