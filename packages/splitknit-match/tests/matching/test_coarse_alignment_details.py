"""Coarse alignment: near alignments, every pose, the likely one."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose

from splitknit_match.matching import coarse
from splitknit_match.matching.coarse import (
    POSES,
    CoarseViews,
    every_pose,
    inverse,
    likely_alignments,
)
from splitknit_match.matching.elastic import rigid
from splitknit_match.matching.ridge_band import RidgeBand


def texture(seed, rows, columns):
    """Ridges of two waves whose directions change, so that each place is its own."""
    noise = np.random.default_rng(seed).normal(size=(rows, columns)).astype(np.float32)
    value = cv2.GaussianBlur(noise, (0, 0), 1.5) - cv2.GaussianBlur(noise, (0, 0), 2.5)
    return RidgeBand(value / value.std(), np.ones(value.shape, bool), 0.1)


def test_no_band_makes_no_numbers_that_are_not_finite():
    nothing = RidgeBand(np.zeros((60, 50), np.float32), np.ones((60, 50), bool), 0.1)
    assert not CoarseViews(nothing).ridges().any()
    assert np.isfinite(CoarseViews(nothing).directions).all()


def turned_band(band, angle_deg, right_mm, up_mm):
    """The band, turned about its middle and moved."""
    rows, columns = band.value.shape
    matrix = cv2.getRotationMatrix2D(((columns - 1) / 2, (rows - 1) / 2), angle_deg, 1.0)
    matrix[:, 2] += 10 * np.array([right_mm, -up_mm])
    value = cv2.warpAffine(band.value, matrix, (columns, rows), flags=cv2.INTER_CUBIC)
    valid = cv2.warpAffine(band.valid.astype(np.float32), matrix, (columns, rows)) > 0.99
    return replace(band, value=np.where(valid, value, np.float32(0)), valid=valid)


@pytest.mark.parametrize(
    ("angle_deg", "right_mm", "down_mm", "expected"),
    [
        (6.0, 0, 0, True),
        (6.1, 0, 0, False),
        (-6.0, 0, 0, True),
        (354.0, 0, 0, True),
        (353.0, 0, 0, False),
        (180.0, 0, 0, False),
        (0.0, 0.59, 0, True),
        (0.0, 0, -0.61, False),
        (0.0, 0.5, 0.5, False),
    ],
)
def test_near_alignments_are_one(angle_deg, right_mm, down_mm, expected):
    first = coarse._Peak(1.0, 3.0, 1.0, -2.0)
    second = coarse._Peak(1.0, 3.0 + angle_deg, 1.0 + right_mm, -2.0 + down_mm)
    assert first.near(second) is expected
    assert second.near(first) is expected


@pytest.mark.parametrize(
    ("angle_deg", "right_mm", "up_mm"), [(0, 1.2, 0.9), (-17.5, 0, -2), (195, 0.6, 0)]
)
def test_the_likely_alignment_is_the_true_one(angle_deg, right_mm, up_mm):
    """Curved ridges, as on a finger: directions alone tell rotations."""
    a = circles()
    b = turned_band(a, angle_deg, right_mm, up_mm)
    alignments = likely_alignments(CoarseViews(a), CoarseViews(b))
    assert len(alignments) <= 2
    true = rigid(a, b, np.deg2rad(angle_deg), right_mm, -up_mm)
    corners = np.array([[60, 60, 1], [120, 60, 1], [60, 140, 1]])
    assert_allclose(corners @ alignments[0].T, corners @ true.T, atol=2.0)


def circles():
    """Ridges around a centre that is off the middle, some of them broken."""
    y, x = np.mgrid[:200, :180]
    phase = 1.4 * np.hypot(x - 70, 0.7 * (y - 120)) + np.arctan2(y - 60, x - 110)
    value = 1.4 * np.sin(phase)
    return RidgeBand(value.astype(np.float32), np.ones(value.shape, bool), 0.1)


@pytest.mark.parametrize(
    ("rows", "columns", "turn"), [((30, 91), (95, 160), 0), ((100, 171), (20, 90), 22)]
)
def test_every_pose_of_a_part_is_tried(rows, columns, turn):
    whole = texture(6, 200, 180)
    part = replace(
        whole,
        value=whole.value[slice(*rows), slice(*columns)],
        valid=whole.valid[slice(*rows), slice(*columns)],
    )
    part = turned_band(part, 4.0 * turn, 0, 0)
    poses = every_pose(CoarseViews(whole), CoarseViews(part))
    assert len(poses) == POSES
    middle = np.array([(np.diff(columns)[0] - 1) / 2, (np.diff(rows)[0] - 1) / 2])
    cos, sin = np.cos(np.deg2rad(4 * turn)), np.sin(np.deg2rad(4 * turn))
    for place in middle + np.array([[0, 0], [20, 0], [0, 20]]):
        right, down = place - middle
        expected = (
            middle[0] + columns[0] + cos * right - sin * down,
            middle[1] + rows[0] + sin * right + cos * down,
        )
        assert_allclose(poses[0] @ np.append(place, 1), expected, atol=1.5)
    for number, pose in enumerate(poses):
        assert abs(np.linalg.det(pose[:, :2]) - 1) < 1e-9
        for better in poses[:number]:
            assert np.abs(pose - better).max() > 0.05


def test_the_inverse_leads_back():
    affine = np.array([[0.9, 0.2, 3.0], [-0.25, 1.1, -4.0]])
    place = np.array([7.0, -2.0])
    there = affine @ np.append(place, 1)
    assert_allclose(inverse(affine) @ np.append(there, 1), place)


def test_a_part_that_occurs_twice_is_found_twice():
    """Two peaks of each rotation count."""
    whole = texture(6, 200, 180)
    value = whole.value.copy()
    value[120:181, 20:85] = value[30:91, 95:160]
    part = replace(whole, value=value[30:91, 95:160], valid=whole.valid[30:91, 95:160])
    poses = every_pose(CoarseViews(replace(whole, value=value)), CoarseViews(part))
    corners = sorted(tuple(np.round(pose[:, 2]).astype(int)) for pose in poses[:2])
    assert_allclose(corners, [(20, 120), (95, 30)], atol=2)
    for pose in poses[:2]:
        assert_allclose(pose[:, :2], np.eye(2), atol=1e-9)
