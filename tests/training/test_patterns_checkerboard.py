"""Checkerboards: exact where the pattern is ideal, unbiased where its states are known, closed to
sloppy stacks."""

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from checkerboards import checkerboard_patterns
from refusals import bad_input

sys.path.append(str(Path(__file__).resolve().parents[2] / "training"))

from patterns import checkerboard, estimate_patterns

SIZE = (60, 72)
SHIFTS = [(2 * i, 2 * j) for i in range(5) for j in range(5)]
"""25 shifts of checks of five pixels: every state is 0 or 1."""


def scene(channels=()):
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    direct = 0.2 * (1 + 0.3 * np.sin(rows / 9))
    global_ = 0.4 + 0.1 * np.cos(columns / 17)
    if channels:
        direct, global_ = (np.multiply.outer(part, channels) for part in (direct, global_))
    return direct, global_


DIRECT, GLOBAL = scene()


def stack_of(direct, global_, patterns, alpha=0.5, dark=0.0):
    states = dark + (1 - dark) * patterns
    if direct.ndim == 3:
        states = states[..., None]
    return states * direct + (alpha + dark * (1 - alpha)) * global_


def noise_of(seed, sigma, patterns):
    return np.random.default_rng(seed).normal(0, sigma, patterns.shape)


@pytest.fixture(scope="module")
def patterns():
    return checkerboard_patterns(SIZE, 5, SHIFTS)


@pytest.mark.parametrize("dark", [0.0, 0.2])
@pytest.mark.parametrize("channels", [(), (1.0, 0.6, 0.3)])
@pytest.mark.parametrize("known", [False, True])
def test_an_ideal_pattern_gives_the_truth(patterns, channels, dark, known):
    direct, global_ = scene(channels)
    stack = stack_of(direct, global_, patterns, dark=dark)
    parts = checkerboard(stack, dark=dark, patterns=patterns if known else None)
    assert parts.direct.shape == direct.shape
    assert parts.direct.dtype == np.float32
    assert np.abs(parts.direct - direct).max() < 1e-6
    assert np.abs(parts.global_ - global_).max() < 1e-6
    assert np.abs(parts.white - direct - global_).max() < 1e-6


@pytest.mark.parametrize("alpha", [0.25, 0.75])
def test_any_fraction_of_lit_checks_gives_the_truth(alpha):
    """Squares on a grid, a quarter of the plane lit or dark."""
    rows, columns = np.mgrid[: SIZE[0], : SIZE[1]]
    squares = np.stack(
        [((rows - i) // 4 % 2 == 0) & ((columns - j) // 4 % 2 == 0) for i in (0, 4) for j in (0, 4)]
    )
    patterns = squares.astype(float) if alpha == 0.25 else 1.0 - squares
    stack = stack_of(DIRECT, GLOBAL, patterns, alpha, 0.1)
    for known in (None, patterns):
        parts = checkerboard(stack, alpha=alpha, dark=0.1, patterns=known)
        assert np.abs(parts.direct - DIRECT).max() < 1e-6
        assert np.abs(parts.global_ - GLOBAL).max() < 1e-6


def test_noise_biases_extremes_but_not_known_states(patterns):
    sigma = 0.01
    noisy = stack_of(DIRECT, GLOBAL, patterns) + noise_of(1, sigma, patterns)
    errors = {
        name: checkerboard(noisy, patterns=known).direct - DIRECT
        for name, known in (
            ("extremes", None),
            ("known", patterns),
            ("estimated", estimate_patterns(noisy)),
        )
    }
    mean = {name: float(error.mean()) for name, error in errors.items()}
    # 25 images, 12 or 13 of them lit: the expected maximum of so many normals is 1.65 sigma, twice
    assert mean["extremes"] == pytest.approx(3.3 * sigma, rel=0.05)
    # standard error of the mean over 4320 pixels: 0.4 sigma / 66
    assert abs(mean["known"]) < 4 * 0.4 * sigma / 66
    assert abs(mean["estimated"]) < 0.05 * sigma
    assert errors["known"].std() < 0.45 * sigma  # least squares over 25 images: 0.40
    assert errors["known"].std() < 0.6 * errors["extremes"].std()


def test_known_checks_separate_light_that_spreads_from_neighbours(patterns):
    """A third of the light spreads over 0.8 checks: what counts is the middle of the checks, noise
    or none."""
    fraction = np.array([0.5, 1, 1, 1, 0.5]) / 4  # four of five pixels
    around = np.stack(
        [
            cv2.sepFilter2D(p, -1, fraction, fraction, borderType=cv2.BORDER_REFLECT)
            for p in patterns
        ]
    )
    stack = patterns * DIRECT + around * DIRECT / 2 + 0.5 * GLOBAL
    expected = DIRECT * (1 + np.ptp(around, axis=0) / 2)

    def direct(stack):
        return checkerboard(stack, patterns=patterns, check_px=5).direct

    assert np.abs(direct(stack) - expected).max() < 1e-5
    sigma = 0.02
    noisy = stack + noise_of(6, sigma, stack)
    error = direct(noisy) - expected
    assert abs(float(error.mean())) < 4 * sigma / np.sqrt(error.size)
    assert (checkerboard(noisy).direct - expected).mean() > sigma
    assert np.abs(direct(stack_of(DIRECT, GLOBAL, patterns)) - DIRECT).max() < 1e-6


def test_estimated_states_hardly_bias_weak_direct_light(patterns):
    """Where noise is as strong as the direct light, they fall a little short; extremes give four
    times too much."""
    direct = 0.1 * DIRECT
    noisy = stack_of(direct, GLOBAL, patterns) + noise_of(2, 0.02, patterns)
    estimated = checkerboard(noisy, patterns=estimate_patterns(noisy)).direct.mean()
    assert 0.8 < estimated / direct.mean() < 1.02
    assert checkerboard(noisy).direct.mean() / direct.mean() > 4


def test_estimated_states_are_the_true_ones_where_decided(patterns):
    states = estimate_patterns(stack_of(DIRECT, GLOBAL, patterns) + noise_of(3, 0.01, patterns))
    decided = states != 0.5
    assert 0.3 < decided.mean() < 0.9
    assert np.array_equal(states[decided], patterns[decided])


def test_half_lit_pixels_do_not_count():
    """They follow no model here."""
    patterns = checkerboard_patterns(
        SIZE, 8, [(3.2 * i, 3.2 * j) for i in range(5) for j in range(5)]
    )
    stack = stack_of(DIRECT, GLOBAL, patterns)
    rim = (patterns > 0.1) & (patterns < 0.9)
    assert 0.05 < rim.mean() < 0.5
    stack[rim] += np.random.default_rng(4).uniform(-0.05, 0.05, int(rim.sum()))
    assert np.abs(checkerboard(stack, patterns=patterns).direct - DIRECT).max() < 1e-6


def test_a_pattern_is_the_lit_fraction_of_each_pixel():
    fine = checkerboard_patterns((120, 120), 30, [(7, 11)])[0]
    coarse = checkerboard_patterns((12, 12), 3, [(0.7, 1.1)])[0]
    assert np.allclose(fine.reshape(12, 10, 12, 10).mean(axis=(1, 3)), coarse, atol=1e-6)
    assert fine[7, 11] == 1.0
    assert fine[6, 11] == 0.0


def test_light_outside_the_mask_is_undefined(patterns):
    stack = stack_of(DIRECT, GLOBAL, patterns)
    mask = np.zeros(SIZE, dtype=bool)
    mask[10:30, 20:50] = True
    stack[:, ~mask] = 0.5  # never changes
    direct = checkerboard(stack, mask=mask).direct
    assert np.isnan(direct[~mask]).all()
    assert np.abs(direct - DIRECT)[mask].max() < 1e-6


def refused(words, *arguments, **keywords):
    with bad_input() as caught:
        checkerboard(*arguments, **keywords)
    message = str(caught.value)
    assert words in message
    assert "\n" not in message
    return message


def test_inconsistent_stacks_are_refused(patterns):
    stack = stack_of(DIRECT, GLOBAL, patterns)
    noise = noise_of(5, 0.01, patterns)
    refused("image 24 shows pattern", (stack + noise)[[*range(24), 11]], patterns=patterns)
    refused("out of order", stack[::-1], patterns=patterns)
    refused("does not show its pattern", stack, patterns=1 - patterns)
    refused("never lit", stack[:2], patterns=patterns[:2])
    refused("at least 2 images", stack[:1])
    refused("image 3 has the shape", [*stack[:3], stack[3, :-1]])
    refused(
        "image 0 contains NaN", np.where(np.isnan(stack) | (stack == stack[0, 0, 0]), np.nan, stack)
    )
    refused("saturated", np.minimum(2.4 * stack, 1.0))
    refused("image 7 is black", np.where(np.arange(25)[:, None, None] == 7, 1e-4, stack))
    refused("every image is black", 0 * stack)
    refused("never lit or never dark", np.broadcast_to(stack[0], stack.shape))
    refused("the patterns never light the scene", np.broadcast_to(stack[0], stack.shape) + noise)
    refused("patterns must have the shape", stack, patterns=patterns[:, 1:])
    refused("from 0 (dark) to 1 (lit)", stack, patterns=2 * patterns)
    refused("check_px needs patterns", stack, check_px=5)
    refused("check_px must be at least 1", stack, patterns=patterns, check_px=0.5)
    refused("alpha", stack, alpha=0.0)
    refused("dark", stack, dark=1.0)
    refused("channels", stack[..., None] * np.ones(2))


def test_a_region_without_pattern_is_named(patterns):
    stack = stack_of(DIRECT, GLOBAL, patterns)
    stack[:, 40:] = 0.3
    message = refused("33.3 % of the bright pixels were never lit", stack)
    assert "row 40, column 0" in message


def test_a_black_background_is_no_fault_of_the_patterns(patterns):
    """Half of the picture, whose pixels never change."""
    stack = stack_of(DIRECT, GLOBAL, patterns)
    stack[:, :, 36:] = 0
    parts = checkerboard(stack)
    assert np.all(parts.direct[:, 36:] == 0)
    assert np.all(parts.global_[:, 36:] == 0)
