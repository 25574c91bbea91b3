"""Separation by measurement: what must hold whatever the scene."""

import sys
from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from checkerboards import checkerboard_patterns

sys.path.append(str(Path(__file__).resolve().parents[2] / "training"))

from patterns import checkerboard

quick = settings(max_examples=15, deadline=None, derandomize=True)
seeds = st.integers(0, 2**32 - 1)
fractions = st.floats(0.0, 0.5)
SIZE = (20, 20)
PATTERNS = checkerboard_patterns(SIZE, 2, [(i, j) for i in range(4) for j in range(2)])


def scene(seed):
    rng = np.random.default_rng(seed)
    return rng.uniform(0.05, 0.3, SIZE), rng.uniform(0.05, 0.5, SIZE)


def methods(seed, dark):
    """All methods that work on a stack, each with an ideal stack of the same scene."""
    direct, global_ = scene(seed)
    board = (dark + (1 - dark) * PATTERNS) * direct + (1 + dark) / 2 * global_
    return [
        (board, lambda stack, order: checkerboard(stack, dark=dark)),
        (board, lambda stack, order: checkerboard(stack, dark=dark, patterns=PATTERNS[order])),
    ], direct + global_


@quick
@given(seeds, fractions)
def test_direct_and_global_light_add_up_to_white(seed, dark):
    cases, white = methods(seed, dark)
    for stack, method in cases:
        assert np.abs(method(stack, slice(None)).white - white).max() < 1e-6


@quick
@given(seeds, fractions, st.sampled_from([0.125, 0.5, 2.0, 1024.0]))
def test_brighter_images_scale_both_lights(seed, dark, scale):
    for full, method in methods(seed, dark)[0]:
        stack = 0.4 * full  # no value clips at twice that
        before, after = method(stack, slice(None)), method(stack * scale, slice(None))
        assert np.allclose(after.direct, scale * before.direct, rtol=1e-4, atol=1e-6 * scale)
        assert np.allclose(after.global_, scale * before.global_, rtol=1e-4, atol=1e-6 * scale)


@quick
@given(seeds, fractions)
def test_order_of_the_images_does_not_matter(seed, dark):
    for stack, method in methods(seed, dark)[0]:
        order = np.random.default_rng(seed + 1).permutation(len(stack))
        before, after = method(stack, slice(None)), method(stack[order], order)
        assert np.allclose(before.direct, after.direct, atol=1e-6)
        assert np.allclose(before.global_, after.global_, atol=1e-6)


@quick
@given(seeds, st.floats(0.0, 0.2))
def test_ambient_light_is_global_alone(seed, extra):
    """Twice of it is in the global part, none in the direct one."""
    for stack, method in methods(seed, 0.0)[0]:
        before, after = method(stack, slice(None)), method(stack + extra, slice(None))
        assert np.allclose(before.direct, after.direct, atol=1e-6)
        assert np.all(after.global_ >= before.global_ - 1e-6)
