"""The thesis's matchers, step by step against plain loops."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from refusals import bad_input
from splitknit.imaging.geometry import rotation_about
from splitknit.reconstruction import Surface
from splitknit_match.matching import features
from splitknit_match.matching.surface import MatchingSettings, surface_images, surface_template
from splitknit_match.matching.thesis import (
    ATTRIBUTES,
    NORMALS,
    FingerImages,
    ImageMatch,
    ThesisSettings,
    align_masks,
    best_shift,
    check_scales,
    finger_features,
    finger_images,
    thesis_match,
    tip_column,
    to_box,
)
from splitknit_match.matching.thesis_code import code_match, code_side, pattern_labels

PX_PER_MM = 20.0
NAMES = ("relief", *NORMALS, *(f"shape_{name}" for name in NORMALS))


def ellipse(rows, columns, middle):
    y, x = np.mgrid[:rows, :columns]
    return ((x - middle) / (columns / 2)) ** 2 + ((y - rows) / rows) ** 2 < 1


def finger(seed, rows=90, columns=70, px_per_mm=PX_PER_MM):
    mask = ellipse(rows, columns, columns / 2)
    rng = np.random.default_rng(seed)
    channels = {
        name: np.where(mask, cv2.GaussianBlur(rng.normal(size=mask.shape), (0, 0), 1), 0).astype(
            np.float32
        )
        for name in NAMES
    }
    return FingerImages(channels, mask, px_per_mm)


@pytest.mark.parametrize("middle", [160.0, 120.0])
def test_masks_are_laid_where_most_overlaps(middle):
    """The search on reduced masks finds what a search of all shifts finds."""
    database, query = ellipse(300, 320, 160), ellipse(280, 300, middle)
    query[:8, :] = False
    query = query[8:]
    right, ratio = align_masks(database, query)
    padded = np.pad(database[:272], ((0, 0), (100, 100)))
    overlaps = {
        shift: int(np.count_nonzero(padded[:, 100 + shift : 400 + shift] & query))
        for shift in range(-60, 61)
    }
    assert overlaps[right] == max(overlaps.values())
    union = database.sum() + query.sum() - overlaps[right]
    assert ratio == pytest.approx(overlaps[right] / union)


def test_the_tip_is_the_middle_of_the_first_row():
    mask = np.zeros((4, 9), bool)
    mask[1, [2, 3, 7]] = True
    mask[2] = True
    assert tip_column(mask) == 4


def test_equal_overlaps_take_the_shift_nearest_to_the_middle():
    a = np.ones((3, 10), bool)
    b = np.ones((5, 4), bool)
    assert best_shift(a, b, range(-20, 20)) == (0, 12)
    assert best_shift(a, b, range(-20, 20), 4) == (4, 12)
    assert best_shift(a, b, range(-20, 20), 9) == (6, 12)
    assert best_shift(a, b, range(20, 30), 22) == (22, 0)
    assert best_shift(a, b, range(-9, -2), -9) == (-3, 3)


def test_images_are_brought_to_a_box_as_their_sizes_ask():
    image = np.random.default_rng(1).normal(size=(40, 30)).astype(np.float32)
    assert to_box(image, (40, 30)) is image
    for size, method in (
        ((39, 30), cv2.INTER_LINEAR),
        ((10, 8), cv2.INTER_AREA),
        ((10, 40), cv2.INTER_AREA),
        ((60, 14), cv2.INTER_AREA),
        ((15, 15), cv2.INTER_LINEAR),  # half of the smaller side
        ((80, 60), cv2.INTER_LINEAR),
    ):
        box = to_box(image, size)
        assert box.shape == size
        assert box.dtype == np.float32
        np.testing.assert_array_equal(box, cv2.resize(image, size[::-1], interpolation=method))


def test_fingers_are_cut_upright():
    """Channels of a ramp keep their places, and vectors turn with the picture."""
    side, angle = 101, 0.4
    frame = rotation_about((50, 50), angle)
    y, x = np.mgrid[:side, :side].astype(np.float32)
    mask = np.hypot(x - 50, y - 50) < 40
    normals = np.dstack([np.full_like(x, 0.3), np.full_like(x, 0.2), np.full_like(x, 0.9)])
    surface = normals, 2 * normals, x, mask, 0.05
    images = finger_images(*surface, input_from_upright=frame, upright_size=mask.shape)
    assert set(images.channels) == set(NAMES)
    assert images.px_per_mm == 20
    assert images.mask.shape == images.channels["relief"].shape
    assert abs(images.mask.shape[0] - 79) <= 2
    middle = np.array(images.mask.shape) // 2
    back = np.linalg.inv(frame[:2, :2])
    vector = back @ [0.3, -0.2]  # rows run down
    at = tuple(middle)
    assert images.channels["normal_x"][at] == pytest.approx(vector[0], abs=1e-5)
    assert images.channels["normal_y"][at] == pytest.approx(-vector[1], abs=1e-5)
    assert images.channels["normal_z"][at] == pytest.approx(0.9, abs=1e-5)
    assert images.channels["shape_normal_x"][at] == pytest.approx(2 * vector[0], abs=1e-5)
    assert images.channels["shape_normal_y"][at] == pytest.approx(-2 * vector[1], abs=1e-5)
    relief = images.channels["relief"]
    assert relief[middle[0], middle[1] + 10] - relief[at] == pytest.approx(
        10 * frame[0, 0], abs=0.1
    )
    assert relief[middle[0] + 10, middle[1]] - relief[at] == pytest.approx(
        10 * frame[0, 1], abs=0.1
    )
    for channel in images.channels.values():
        assert channel.dtype == np.float32
        assert not channel[~images.mask].any()
    half = 0.5 * np.eye(3) + np.diag([0, 0, 0.5])
    larger = finger_images(*surface, input_from_upright=half, upright_size=(202, 202))
    assert abs(larger.mask.shape[0] - 158) <= 3
    assert larger.channels["normal_x"][80, 80] == pytest.approx(0.3, abs=1e-5)
    assert larger.channels["shape_normal_x"][80, 80] == pytest.approx(0.6, abs=1e-5)
    with bad_input(r"the mask lies outside the upright frame\."):
        beyond = np.array([[1, 0, 500], [0, 1, 0], [0, 0, 1.0]])
        finger_images(*surface, input_from_upright=beyond, upright_size=mask.shape)
    holes = x.copy()
    holes[50, 50] = np.nan
    surface = normals, 2 * normals, holes, mask, 0.05
    upright = finger_images(*surface, input_from_upright=np.eye(3), upright_size=mask.shape)
    assert upright.channels["relief"][39, 39] == 0
    assert upright.channels["relief"][39, 40] == 51


def test_scales_may_differ_by_two_percent():
    check_scales(20.39, 20.0)
    check_scales(20.0, 20.3)
    with bad_input() as caught:
        check_scales(20.5, 20.0)
    assert str(caught.value) == (
        "the fingers have 20.5 and 20.0 px/mm; the thesis's matchers need one scale."
    )
    with bad_input():
        check_scales(19.5, 20.0)


def test_the_score_is_that_of_its_steps():
    database, query = finger(1), finger(2, 84, 72)
    settings = ThesisSettings(gate=0.5, attributes=("normals", "relief", "shape_normals"))
    match = thesis_match(database, query, settings)
    right, ratio = align_masks(database.mask, query.mask)
    assert (match.shift_px, match.ratio, match.compared) == (right, ratio, True)
    scores = {}
    for attribute, names in ATTRIBUTES.items():
        total = 0.0
        for name in names:
            box = cv2.resize(query.channels[name], (70, 90), interpolation=cv2.INTER_LINEAR)
            distance = np.linalg.norm(
                features.lbp_features(database.channels[name], PX_PER_MM)
                - features.lbp_features(box, PX_PER_MM)
            )
            assert match.distances[name] == pytest.approx(distance)
            total += distance
        scores[attribute] = math.exp(-(ratio**4) / total)
    assert match.dissimilarity == pytest.approx(scores)
    assert match.similarity == pytest.approx(1 - np.mean(list(scores.values())))
    kept = finger_features(database, settings)
    assert set(kept) == set(NAMES)
    assert thesis_match(database, query, settings, kept).similarity == match.similarity
    bare = replace(database, channels={})
    assert thesis_match(bare, query, settings, kept).similarity == match.similarity
    with bad_input(r"a finger has no channel 'normal_x'\."):
        thesis_match(bare, query, settings)


def test_a_gated_pair_is_worse_than_any_other():
    database, query = finger(1), finger(2, 40, 70)
    ratio = align_masks(database.mask, query.mask)[1]
    assert 0.2 < ratio < 0.6
    match = thesis_match(database, query, ThesisSettings(gate=0.9))
    gated = math.exp(2 - ratio)
    assert match.similarity == pytest.approx(1 - gated)
    assert match.dissimilarity == pytest.approx({"normals": gated, "relief": gated})
    assert (match.distances, match.compared) == ({}, False)
    assert thesis_match(database, query, ThesisSettings(gate=ratio)).compared
    assert thesis_match(database, query, ThesisSettings(gate=0.0)).compared


def test_settings_name_known_attributes():
    for attributes in ((), ("normals", "colour")):
        with bad_input() as caught:
            ThesisSettings(attributes=attributes)
        assert str(caught.value) == ("thesis.attributes must be of normals, relief, shape_normals.")
    with bad_input():
        ThesisSettings(gate=1.1)


def test_the_authors_score_counts_labels_of_cells():
    """Counted again for each cell, at a scale where a cell has 13 pixels."""
    px_per_mm = 30.0
    database, query = finger(1, px_per_mm=px_per_mm), finger(2, 84, 76, px_per_mm)
    match = code_match(code_side(database), code_side(query))
    cell = round(32 * px_per_mm / 75.7)
    assert cell == 13
    tip = tip_column(database.mask) - tip_column(query.mask)
    reach, step = round(100 * px_per_mm / 75.7), round(5 * px_per_mm / 75.7)
    assert (reach, step) == (40, 2)
    shift, both = best_shift(
        database.mask, query.mask, range(tip - reach, tip + reach + 1, step), tip
    )
    assert match.shift_px == shift
    assert match.ratio == both / (database.mask.sum() + query.mask.sum() - both)
    neighbours = {"normals": 15, "relief": 15, "shape_normals": 4}
    for attribute, names in ATTRIBUTES.items():
        n = neighbours[attribute]
        bins = n * (n - 1) + 3
        channels = []
        for name in names:
            ours = pattern_labels(database.channels[name], n).astype(int)
            theirs = np.full((90, 70), bins - 2)
            labels = pattern_labels(query.channels[name], n)
            for row in range(84):
                for column in range(76):
                    if 0 <= column + shift < 70:
                        theirs[row, column + shift] = labels[row, column]
            total = 0
            for top in range(0, 13 * (90 // 13), 13):
                for left in range(0, 13 * (70 // 13), 13):
                    square = np.s_[top : top + 13, left : left + 13]
                    total += np.abs(
                        np.bincount(ours[square].ravel(), minlength=bins)
                        - np.bincount(theirs[square].ravel(), minlength=bins)
                    ).sum()
            channels.append(total / (6 * 5 * bins))
        expected = (32 / 13) ** 2 * np.mean(channels)
        assert match.distances[attribute] == pytest.approx(expected)
    assert match.similarity == pytest.approx(1 - np.mean(list(match.distances.values())))


def test_the_authors_matcher_refuses_what_it_cannot_compare():
    side = code_side(finger(1))
    few = replace(side, labels={k: v for k, v in side.labels.items() if k != "relief"})
    for pair in ((side, few), (few, side)):
        with bad_input(r"^one finger has no channel 'relief'\.$"):
            code_match(*pair)
    assert set(code_match(few, few).distances) == {"normals", "shape_normals"}
    for rows, columns in ((7, 70), (70, 7)):
        small = code_side(finger(1, rows, columns))
        with bad_input(r"is smaller than a cell of 8 pixels\.$"):
            code_match(small, side)
    assert code_match(code_side(finger(1, 8, 8)), side).compared


def surface(whole):
    side = 240
    y, x = np.mgrid[:side, :side] * 0.05
    ridge = (0.03 * np.sin(2 * np.pi * (x * 0.9 + y * 0.4) / 0.5)).astype(np.float32)
    shape = (-0.02 * (x - 6) ** 2 + 0.1 * y).astype(np.float32)
    mask = np.zeros((side, side), bool)
    mask[20:220, 30:180] = True
    normals = np.dstack([0 * ridge, 0 * ridge + 0.6, 0 * ridge + 0.8]).astype(np.float32)
    frame = np.array([[1.0, 0, 10], [0, 1, 5], [0, 0, 1]])
    return Surface(ridge, shape, normals, mask, 0.05, frame, (250, 200), whole)


def test_a_surface_is_matched_upright():
    """Its masks are 200 x 150 pixels; the frame shows columns 10 to 209 and rows 5 to 254."""
    for whole in (False, True):
        taken = surface(whole)
        images = surface_images(taken)
        assert images.mask.shape == (200, 150)
        assert images.mask.all()
        assert images.px_per_mm == 20
        height = taken.ridge_mm + taken.shape_mm if whole else taken.ridge_mm
        np.testing.assert_allclose(
            images.channels["relief"][5:-5, 5:-5], height[25:215, 35:175], atol=1e-5
        )
        assert images.channels["normal_y"][50, 50] == pytest.approx(0.6)
        slope = 0.04 * ((30 + 50) * 0.05 - 6)  # -dz/dx
        up = 0.1  # -dz/dup, rows run down
        length = math.sqrt(slope**2 + up**2 + 1)
        assert images.channels["shape_normal_x"][50, 50] == pytest.approx(slope / length, abs=1e-3)
        assert images.channels["shape_normal_y"][50, 50] == pytest.approx(up / length, abs=1e-3)
    low = replace(surface(False), upright_size=(120, 200))
    assert surface_images(low).mask.shape == (105, 150)
    assert MatchingSettings().thesis == ThesisSettings()
    assert ImageMatch(1.0, {}, 1.0, 0).dissimilarity == {}
    template = surface_template(surface(False))
    assert template.area_mm2 == pytest.approx(10 * 7.5, rel=0.06)
    narrow = replace(surface(False), upright_size=(120, 200))
    assert surface_template(narrow).area_mm2 == pytest.approx(5.25 * 7.5, rel=0.1)
    shifted = replace(
        surface(False), input_from_upright=np.array([[1.0, 0, 80], [0, 1, 5], [0, 0, 1]])
    )
    assert surface_template(shifted).valid.shape[1] == pytest.approx(50, abs=4)
    steep = surface(False)
    steep = replace(steep, shape_mm=40 * steep.shape_mm)
    assert surface_template(steep).area_mm2 < 60


def blunt(tip):
    """A mask of 100 x 100 pixels whose first row has one alone."""
    mask = np.ones((100, 100), bool)
    mask[0] = False
    mask[0, tip] = True
    return mask


def test_tips_are_believed_to_a_quarter_of_the_width():
    assert align_masks(blunt(30), blunt(54)) == (0, pytest.approx(9900 / 9902))
    assert align_masks(blunt(30), blunt(70))[0] != 0


def test_the_authors_shift_is_found_to_the_pixel_on_small_scales():
    """At 15 px/mm five pixels of 75.7 px/mm are one."""
    zero = {"relief": np.zeros((100, 100), np.float32)}
    pair = (code_side(FingerImages(zero, blunt(tip), 15.0)) for tip in (30, 31))
    assert code_match(*pair).shift_px == 0
