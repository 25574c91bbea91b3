"""Drawn objects without a mask: what lies behind is left out only where that is certain."""

import cv2
import numpy as np
import pytest

from refusals import bad_input
from splitknit.pipeline import reconstruct_images

ROWS, COLUMNS = 200, 240
SLANT_AZIMUTH = [(0.5, k * np.pi / 4) for k in range(8)] + [(0.25, 0.3), (0.25, 2.4), (0.25, 4.5)]
LIGHTS = np.array(
    [(np.sin(t) * np.cos(a), np.sin(t) * np.sin(a), np.cos(t)) for t, a in SLANT_AZIMUTH]
)
ROW, COLUMN = np.indices((ROWS, COLUMNS)).astype(np.float32)
EVERYTHING = np.ones((ROWS, COLUMNS), np.bool_)


def lit(height, albedo):
    """Matt photographs (L, H, W) with attached and cast shadows."""
    down, right = np.gradient(height)
    normals = np.dstack([-right, down, np.ones_like(right)])
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    rng = np.random.default_rng(0)
    photographs = []
    for x, y, z in LIGHTS:
        flat = np.hypot(x, y)
        free = np.ones(height.shape, np.bool_)
        for step in range(1, int(height.max() * flat / z) + 1):
            there = (COLUMN + step * np.float32(x / flat), ROW - step * np.float32(y / flat))
            before = cv2.remap(
                height.astype(np.float32), *there, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
            )
            free &= before < height + step * z / flat + 0.5
        shading = np.clip(normals @ np.array([x, y, z]), 0, None) * free
        photographs.append(albedo * cv2.GaussianBlur(shading, (0, 0), 0.7))
    return np.clip(photographs + rng.normal(0, 0.002, (len(LIGHTS), ROWS, COLUMNS)), 0, 1)


def ball(column, row, radius):
    squared = radius**2 - (COLUMN - column) ** 2 - (ROW - row) ** 2
    return np.sqrt(np.maximum(squared, 0.0))


def coin():
    edge = 60 - np.hypot(COLUMN - 120, ROW - 100)
    relief = 0.6 * np.sin(COLUMN / 3) * np.sin(ROW / 4)
    return np.clip(3 * edge, 0, 6) + np.where(edge > 12, relief, 0)


BALL, COIN = ball(120, 100, 60), coin()
AT_BORDER = ball(120, 10, 60)
RELIEF = cv2.GaussianBlur(np.random.default_rng(3).normal(0, 1, EVERYTHING.shape), (0, 0), 5) * 30
LUMP = cv2.GaussianBlur(np.maximum(BALL - 40, 0), (0, 0), 3)
WALL_ABOVE = np.where(ROW < 70, 0.08, 0.005)
HALF_WHITE = np.where(COLUMN > 120, 0.8, 0.35)


def codes_and_overlap(height, inside, albedo, behind):
    """Codes of the findings, and intersection over union with `inside`."""
    photographs = lit(height, np.where(inside, albedo, behind))
    result = reconstruct_images(photographs.astype(np.float32), LIGHTS)
    overlap = float((result.mask & inside).sum() / (result.mask | inside).sum())
    return {finding.code for finding in result.findings}, overlap


@pytest.mark.parametrize(
    ("height", "albedo"), [(BALL, 0.8), (BALL, HALF_WHITE)], ids=["plain", "two-tone"]
)
def test_a_wall_that_reaches_the_border_is_left_out_with_a_finding(height, albedo):
    codes, overlap = codes_and_overlap(height, height > 0, albedo, WALL_ABOVE)
    assert overlap > 0.95
    assert "background-left-out" in codes
    assert "outline-at-border" not in codes


@pytest.mark.parametrize(
    ("height", "albedo", "behind"),
    [(BALL, 0.8, 0.12), (BALL, 0.8, 0.0), (COIN, 0.7, 0.1), (BALL, HALF_WHITE, 0.06)],
    ids=["dim wall", "black", "coin on a dim table", "two-tone"],
)
def test_an_object_whose_outline_is_clear_needs_no_finding(height, albedo, behind):
    codes, overlap = codes_and_overlap(height, height > 0, albedo, behind)
    assert overlap > 0.95
    assert not codes & {"background-left-out", "outline-at-border"}


def test_an_object_at_the_border_is_kept_whole_with_a_finding():
    codes, overlap = codes_and_overlap(AT_BORDER, AT_BORDER > 0, 0.8, 0.12)
    assert overlap > 0.95
    assert "outline-at-border" in codes


@pytest.mark.parametrize(
    ("height", "inside", "albedo", "behind"),
    [
        (BALL, BALL > 0, 0.8, 0.4),
        (BALL, BALL > 0, 0.7, 0.7),
        (COIN, COIN > 0, 0.6, 0.6),
        (BALL, BALL > 0, 0.1, 0.8),
        (RELIEF, EVERYTHING, 0.7, 0.0),
        (LUMP, EVERYTHING, 0.5, 0.0),
    ],
    ids=["bright wall", "same albedo", "coin", "dark ball", "relief", "lump in a flat"],
)
def test_what_brightness_cannot_part_is_refused_rather_than_cut(height, inside, albedo, behind):
    with bad_input(r"no object was found|the object touches"):
        codes_and_overlap(height, inside, albedo, behind)


def test_a_whole_object_is_meant_beside_a_larger_one_that_reaches_the_border():
    """The white case in a corner of a stranger's photographs was measured, not the fossil."""
    small = ball(150, 70, 40)
    card = (COLUMN < 110) & (ROW > 110) & (COLUMN - 110 < ROW - 150)
    height = np.where(card, 8.0, small)
    codes, overlap = codes_and_overlap(height, small > 0, 0.4, np.where(card, 0.7, 0.02))
    assert "background-left-out" in codes
    assert overlap > 0.9
