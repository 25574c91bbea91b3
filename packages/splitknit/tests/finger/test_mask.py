"""Finger masks on drawn fingers of every tone and disturbance, and refusal where there is no
finger."""

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from refusals import bad_input
from splitknit.finger.mask import check_borders, finger_mask, touched_borders
from splitknit.finger.quality import photometric_mask
from splitknit.finger.regions import (
    depth_inside,
    dilate,
    distance_outside,
    erode,
    fill_holes,
    largest_component,
    remove_spurs,
)

TONES = ("very dark", "dark", "medium", "very light")


def overlap(a, b):
    return float((a & b).sum() / (a | b).sum())


@pytest.mark.parametrize("tone", TONES)
@pytest.mark.parametrize(
    ("disturbance", "least"),
    [
        ({}, 0.995),
        ({"shadow": "step"}, 0.985),
        ({"shadow": "side"}, 0.985),
        ({"shadow": "gradient"}, 0.98),
        ({"specks": 60}, 0.99),
        ({"glare": True}, 0.99),
        ({"infrared": 0.15}, 0.99),
        ({"paper": 0.04, "paper_slope": 0.6}, 0.99),
        ({"paper": 0.0, "noise": 0.004}, 0.985),
        ({"yaw_deg": 40.0, "tip_at": (-8.0, 8.0)}, 0.99),
    ],
)
def test_a_finger_of_any_tone_is_segmented(draw_finger, tone, disturbance, least):
    scene = draw_finger(tone, **disturbance)
    mask = finger_mask(scene.rgb, scene.px_per_mm)
    assert mask.shape == scene.mask.shape
    assert mask.dtype == np.bool_
    assert overlap(mask, scene.mask) > least
    assert_array_equal(mask, fill_holes(largest_component(mask)))


@pytest.mark.parametrize("tone", ["medium", "very light"])
def test_grey_images_are_segmented_by_brightness(draw_finger, tone):
    scene = draw_finger(tone, specks=20)
    assert overlap(finger_mask(scene.grey, scene.px_per_mm), scene.mask) > 0.985
    assert overlap(finger_mask(scene.grey[..., None], scene.px_per_mm), scene.mask) > 0.985


@pytest.mark.parametrize("colour", [(0.08, 0.30, 0.12), (0.06, 0.14, 0.40), (0.25, 0.08, 0.32)])
@pytest.mark.parametrize("tone", ["dark", "medium", "very light"])
def test_a_finger_on_coloured_paper_is_segmented(draw_finger, tone, colour):
    scene = draw_finger(tone)
    falling = np.linspace(0.7, 1.3, scene.rgb.shape[1], dtype=np.float32)[None, :, None]
    # with the background's own noise
    paper = falling * np.asarray(colour, dtype=np.float32) + (scene.rgb - 0.03)
    mask = finger_mask(np.where(scene.mask[..., None], scene.rgb, paper), scene.px_per_mm)
    assert overlap(mask, scene.mask) > 0.985


def test_the_mask_does_not_depend_on_scale_and_brightness(draw_finger):
    scene = draw_finger("medium", px_per_mm=22.0)
    mask = finger_mask(scene.rgb, 22.0)
    assert overlap(mask, scene.mask) > 0.99
    assert overlap(finger_mask(scene.rgb * np.float32(0.05), 22.0), mask) > 0.998
    assert_array_equal(mask, finger_mask(scene.rgb, 22.0))


def test_a_stick_across_the_finger_is_cut_off(draw_finger):
    scene = draw_finger("medium")
    rgb = scene.rgb.copy()
    rgb[250:270, :] = rgb[300, 170]  # a band of skin colour from side to side
    mask = finger_mask(rgb, scene.px_per_mm)
    assert overlap(mask, scene.mask) > 0.97
    assert not mask[:, :20].any()


def test_dust_on_the_outline_is_cut_off(draw_finger):
    scene = draw_finger("medium", px_per_mm=20.0)
    rgb = scene.rgb.copy()
    height, width = scene.mask.shape
    y, x = np.mgrid[0:height, 0:width]
    for row in (400, 500, 600):
        edge = int(np.flatnonzero(scene.mask[row])[-1])
        # specks of 1 mm that touch the finger
        rgb[((x - edge - 8) ** 2 + (y - row) ** 2 < 100) & ~scene.mask] = 0.5
    assert (finger_mask(rgb, 20.0) ^ finger_mask(scene.rgb, 20.0)).sum() < 250  # of some 740


def _empty(kind, rng):
    y, x = np.mgrid[0:500, 0:350] / 350
    noise = rng.standard_normal((500, 350, 3))
    images = {
        "black": np.zeros((500, 350, 3)),
        "noise": 0.01 * noise,
        "paper": 0.03 + 0.003 * noise,
        "vignette": (0.05 * (1 - (x - 0.5) ** 2 - (y - 0.7) ** 2))[..., None] + 0.002 * noise,
        "ramp": (0.02 + 0.1 * y)[..., None] + 0.001 * noise,
        "bright patch": (0.02 + 0.3 * np.exp(-((x - 0.5) ** 2 + (y - 0.7) ** 2) / 0.25))[..., None]
        + 0.001 * noise,
        "saturated": np.ones((500, 350, 3)),
        "all skin": np.array([0.4, 0.3, 0.2]) + 0.01 * noise,
    }
    return images[kind].astype(np.float32)


@pytest.mark.parametrize(
    "kind", ["black", "noise", "paper", "vignette", "ramp", "bright patch", "saturated", "all skin"]
)
@pytest.mark.parametrize("grey", [False, True])
def test_an_image_without_a_finger_is_refused(kind, grey):
    image = _empty(kind, np.random.default_rng(3))
    with bad_input(r"no finger was found|borders"):
        finger_mask(image.mean(axis=2) if grey else image, 12.0)


def test_a_finger_across_three_borders_is_refused(draw_finger):
    scene = draw_finger("medium", half_width=16.0, tip_at=(0.0, 12.0))
    with bad_input(r"touches 3 borders .*move it back"):
        finger_mask(scene.rgb, scene.px_per_mm)


def test_a_mask_may_touch_two_borders_at_most():
    mask = np.zeros((100, 80), dtype=bool)
    mask[30:, 20:60] = True
    assert touched_borders(mask) == ("bottom",)
    mask[60:, 20:] = True
    assert touched_borders(mask) == ("bottom", "right")
    check_borders(mask)
    mask[:, 30:50] = True
    with bad_input("top, bottom, right"):
        check_borders(mask)
    corner = np.zeros((100, 80), dtype=bool)
    corner[-2:, 10] = True
    assert touched_borders(corner) == ()


def test_small_images_are_refused():
    with bad_input("too small"):
        finger_mask(np.zeros((5, 5, 3), np.float32), 12.0)


@pytest.mark.parametrize(
    "box", [np.s_[20:50, 10:40], np.s_[0:25, 30:60], np.s_[30:64, 0:80], np.s_[:, :]]
)
@pytest.mark.parametrize("radius", [1.0, 1.5, 2.0, 3.7, 9.3])
def test_region_operations_agree_with_those_on_the_whole_image(box, radius):
    mask = np.zeros((64, 80), dtype=bool)
    mask[box] = np.random.default_rng(2).random(mask[box].shape) < 0.97
    inside, outside = (
        cv2.distanceTransform(part.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        for part in (mask, ~mask)
    )
    assert_allclose(depth_inside(mask), inside, rtol=1e-6)
    assert_array_equal(erode(mask, radius), inside > radius)
    assert_array_equal(dilate(mask, radius), outside <= radius)
    near = outside <= radius
    assert_allclose(distance_outside(mask, radius)[near], outside[near], rtol=1e-6)
    assert (distance_outside(mask, radius)[~near] > radius).all()
    count, labels, stats, _ = cv2.connectedComponentsWithStats(
        (~mask).astype(np.uint8), connectivity=4
    )
    at_border = {
        int(v) for line in (labels[0], labels[-1], labels[:, 0], labels[:, -1]) for v in line
    }
    small = [k for k in range(1, count) if k not in at_border and stats[k, cv2.CC_STAT_AREA] <= 2]
    assert_array_equal(fill_holes(mask, 2.0), mask | np.isin(labels, small))


def test_spurs_and_small_holes_are_removed():
    mask = np.zeros((120, 100), dtype=bool)
    mask[30:, 30:70] = True
    mask[50:56, 70:95] = True  # a spur
    mask[80:84, 45:50] = False  # a hole
    cleaned = remove_spurs(fill_holes(mask), 0.4)
    assert cleaned[81, 47]
    assert not cleaned[50:56, 80:].any()
    assert cleaned[-1, 30:70].all()
    assert fill_holes(mask, 10.0)[81, 47] == mask[81, 47]


def test_photometric_mask_drops_shadowed_and_saturated_pixels():
    stack = np.full((7, 200, 150), 0.4, np.float32)
    finger = np.zeros((200, 150), dtype=bool)
    finger[20:180, 20:130] = True
    stack[:5, 20:60, 20:130] = 0.0  # two lights left
    stack[:4, 100:120, 110:130] = 0.0  # three lights left
    stack[:, 90, 80] = 0.0  # a pinhole
    stack[:6, 150:180, 20:130] = 1.0
    mask = photometric_mask(stack, finger, 10.0)
    assert not mask[20:60].any()
    assert mask[60:150, 20:130].all()
    assert not mask[150:].any()
    assert not (mask & ~finger).any()
    kept = photometric_mask(stack, finger, 10.0, saturation=np.full(7, 2.0))
    assert kept[150:180, 20:130].all()


def test_a_finger_that_is_saturated_everywhere_is_refused():
    finger = np.ones((20, 15), dtype=bool)
    with bad_input("reached by 3 lights"):
        photometric_mask(np.ones((7, 20, 15), np.float32), finger, 10.0)
