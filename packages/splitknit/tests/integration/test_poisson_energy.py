"""Weighted integration reaches the least energy: random masks, rims and weights against a sparse
direct solver."""

import logging

import cv2
import numpy as np
import pytest

from direct_integration import solved
from splitknit.integration.poisson import poisson


def random_mask(rng, rows, columns):
    i, j = np.mgrid[0:rows, 0:columns].astype(np.float32)
    size = min(rows, columns)
    row, column = rows * rng.uniform(0.3, 0.7), columns * rng.uniform(0.3, 0.7)
    radius, angle = np.hypot(i - row, j - column), np.arctan2(i - row, j - column)
    sigma = float(rng.uniform(0.8, max(1.0, size / 6)))
    noise = cv2.GaussianBlur(rng.standard_normal((rows, columns)).astype(np.float32), (0, 0), sigma)
    shapes = (
        radius < 0.48 * size,
        noise > np.quantile(noise, rng.uniform(0.2, 0.7)),
        np.ones((rows, columns), dtype=bool),
        (radius - angle * 12 / (2 * np.pi)) % 12 < rng.uniform(2, 9),
        (j % rng.integers(3, 9) < 2) | (i < rng.integers(1, 4)),
        (radius < 0.48 * size) & (radius > 0.3 * size),
        (np.abs(i - j * rows / columns) < rng.uniform(1, 5)) | (radius < 0.15 * size),
    )
    mask = shapes[rng.integers(len(shapes))]
    for _ in range(rng.integers(0, 5)):  # holes
        mask = mask & (
            np.hypot(i - rng.uniform(0, rows), j - rng.uniform(0, columns))
            > rng.uniform(0, 0.2) * size
        )
    if rng.random() < 0.3:
        mask = mask & (rng.random((rows, columns)) > rng.uniform(0, 0.4))
    mask[rows // 2, columns // 2] = True
    return mask


def random_slopes(rng, mask):
    """Slopes of a surface with rims of 60 to 89.9 deg, noise and gross errors; weights down to the
    floor and zero."""
    rows, columns = mask.shape
    size = min(rows, columns)
    rim = np.tan(np.deg2rad(rng.uniform(60, 89.9)))
    hills = cv2.GaussianBlur(
        rng.standard_normal((rows, columns)).astype(np.float32), (0, 0), max(1.0, size / 8)
    )
    depth = cv2.distanceTransform(np.pad(mask, 1).astype(np.uint8), cv2.DIST_L2, 3)[1:-1, 1:-1]
    height = 0.1 * size * hills / np.abs(hills).max() + rim * np.minimum(depth, rng.uniform(1, 6))
    down, right = np.gradient(height)
    slopes = np.stack([right, -down]) + 10 ** rng.uniform(-6, 0) * rng.standard_normal(
        (2, rows, columns)
    )
    if rng.random() < 0.6:
        wrong = rng.random((rows, columns)) < rng.uniform(0, 0.1)
        angle = rng.uniform(0, 2 * np.pi, (rows, columns))
        slopes[:, wrong] = rim * np.stack([np.cos(angle), np.sin(angle)])[:, wrong]
    longest = (6.0, 1e9)[rng.integers(2)]
    slopes *= np.minimum(1, longest / np.maximum(np.hypot(*slopes), 1e-9))
    weights = [
        1 / (1 + (slopes**2).sum(axis=0)) ** 2,
        np.maximum(1 / (1 + (slopes**2).sum(axis=0)) ** 2, 0.01),
        10 ** rng.uniform(-5, 0, (rows, columns)),
        np.where(hills > np.quantile(hills, rng.uniform(0.1, 0.95)), 1.0, 0.0),
    ][rng.integers(4)]
    return slopes.astype(np.float32), weights.astype(np.float32)


def energy_above_the_least(seed, largest):
    """Energy of `poisson` and of a direct solution, and that of the slopes themselves."""
    rng = np.random.default_rng(seed)
    rows = np.exp(rng.uniform(np.log(10), np.log(largest)))
    mask = random_mask(rng, int(rows), int(np.clip(rows * np.exp(rng.uniform(-1, 1)), 10, largest)))
    slopes, weights = random_slopes(rng, mask)
    best, operator, weight, target = solved(slopes, weights, mask)
    height = poisson(*slopes, mask, weights)[mask].astype(float)
    energies = (float(weight @ (target - operator @ solution) ** 2) for solution in (height, best))
    return *energies, float(weight @ target**2)


def assert_least(seeds, largest, caplog):
    with caplog.at_level(logging.WARNING):
        for seed in seeds:
            energy, least, power = energy_above_the_least(seed, largest)
            # heights are in single precision
            assert energy <= 1.001 * least + 1e-10 * power, (seed, energy, least)
    assert not caplog.records


@pytest.mark.slow
def test_weighted_integration_reaches_the_least_energy(caplog):
    assert_least(range(150), 120, caplog)


@pytest.mark.slow
def test_large_weighted_integration_reaches_the_least_energy(caplog):
    assert_least((20_036, 20_039), 600, caplog)


@pytest.mark.slow
@pytest.mark.timeout(1200)  # four minutes alone
def test_ten_thousand_weighted_integrations_reach_the_least_energy(caplog):
    assert_least(range(1_000, 10_980), 200, caplog)
    assert_least(range(20_000, 20_020), 600, caplog)
