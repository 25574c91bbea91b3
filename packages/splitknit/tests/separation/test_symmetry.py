"""Checkerboards by symmetry: four times the phases, and no more direct light than there is."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from checkerboards import checkerboard_patterns
from splitknit.errors import BadInput
from splitknit.separation.binary import checkerboard
from splitknit.separation.stacks import StackSettings
from splitknit.separation.symmetry import by_symmetry

SIZE = (60, 72)
SIDE = 8.0
SHIFTS = [(3.2 * i, 3.2 * j) for i in range(5) for j in range(5)]
"""Fifths of a period of 16 pixels, row by row."""
ROWS, COLUMNS = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
DIRECT = 0.2 * (1 + 0.3 * np.sin(ROWS / 9))
GLOBAL = 0.4 + 0.1 * np.cos(COLUMNS / 17)
TINT = np.array([1.0, 0.6, 0.3])


def spreading(shifts, amount=0.25):
    """Images (N, H, W) under patterns whose light reaches a pixel with the weight cos cos over a period.

    The response to the pattern at a shift is smooth: amount cos(pi (y - a) / side) cos(pi (x - b) / side), where the
    middle of a lit check lies at (a, b).
    """
    wave = [
        np.cos(np.pi * (ROWS - a - SIDE / 2) / SIDE) * np.cos(np.pi * (COLUMNS - b - SIDE / 2) / SIDE)
        for a, b in shifts
    ]
    return 0.5 * (DIRECT + GLOBAL) + 0.5 * amount * np.stack(wave)


def test_a_smooth_response_is_found_between_the_phases():
    """Its peak lies up to a tenth of a period from a phase; maximum and minimum over 25 images fall short of it."""
    stack = spreading(SHIFTS)
    found = by_symmetry(stack)
    assert np.abs(found.direct / 0.25 - 1).max() < 0.01
    assert np.abs(found.white - DIRECT - GLOBAL).max() < 1e-6
    plain = checkerboard(stack).direct / 0.25
    assert plain.min() < 0.91
    assert plain.mean() < 0.94


@pytest.mark.parametrize("dark", [0.0, 0.2])
@pytest.mark.parametrize("tint", [None, TINT])
def test_sharp_checks_are_not_overshot(dark, tint):
    """Opaque matter: a flat top, and rims across which a parabola would add a quarter."""
    patterns = dark + (1 - dark) * checkerboard_patterns(SIZE, SIDE, SHIFTS)
    direct, global_ = (part if tint is None else np.multiply.outer(part, tint) for part in (DIRECT, GLOBAL))
    states = patterns if tint is None else patterns[..., None]
    stack = states * direct + (0.5 + 0.5 * dark) * global_
    parts = by_symmetry(stack, white=direct + global_, dark=dark)
    assert parts.direct.shape == direct.shape
    assert parts.direct.dtype == np.float32
    assert np.abs(parts.direct - direct).max() < 1e-6
    assert np.abs(parts.global_ - global_).max() < 1e-6
    # without the white image the pattern's fifth harmonics stay in the mean
    found = by_symmetry(stack, dark=dark)
    assert np.abs(found.direct - direct).max() < 0.05 * direct.max()


def test_the_white_image_takes_the_harmonics_out():
    patterns = checkerboard_patterns(SIZE, SIDE, SHIFTS)
    stack = patterns * DIRECT + 0.5 * GLOBAL
    without, with_white = (by_symmetry(stack, white=white).direct - DIRECT for white in (None, DIRECT + GLOBAL))
    assert without.std() > 100 * with_white.std()


@pytest.mark.parametrize("count", [3, 7])
def test_other_numbers_of_steps(count):
    shifts = [(16 / count * i, 16 / count * j) for i in range(count) for j in range(count)]
    found = by_symmetry(spreading(shifts))
    assert np.abs(found.direct / 0.25 - 1).max() < (0.07 if count == 3 else 0.003)


def test_order_unit_and_origin_of_the_shifts_do_not_matter():
    stack = spreading(SHIFTS)
    expected = by_symmetry(stack)
    order = np.random.default_rng(3).permutation(25)
    table = np.array(SHIFTS)[order] * 0.1 + (0.37, -1.0)
    found = by_symmetry(stack[order], shifts=table, period=1.6)
    assert np.abs(found.direct - expected.direct).max() < 1e-6
    assert np.abs(found.global_ - expected.global_).max() < 1e-6
    first_axis_fastest = by_symmetry(stack.reshape(5, 5, *SIZE).swapaxes(0, 1).reshape(25, *SIZE))
    assert np.abs(first_axis_fastest.direct - expected.direct).max() < 1e-6


def test_noise_is_for_other_methods():
    """It invents direct light, as maximum and minimum do, and its own errors are larger: the page warns of it."""
    sigma = 0.004
    stack = checkerboard_patterns(SIZE, SIDE, SHIFTS) * DIRECT + 0.5 * GLOBAL
    noisy = stack + np.random.default_rng(1).normal(0, sigma, stack.shape)
    error, plain = (method(noisy).direct - method(stack).direct for method in (by_symmetry, checkerboard))
    assert error.mean() > 2 * sigma
    assert error.std() > 1.5 * plain.std()


def test_mask_and_strips_of_rows():
    stack: NDArray[np.float64] = spreading(SHIFTS)
    mask = ROWS < 30
    stack[:, ~mask] = 0.6
    parts = by_symmetry(stack, mask=mask)
    assert np.isnan(parts.direct[~mask]).all()
    assert np.abs(parts.direct[mask] / 0.25 - 1).max() < 0.01
    wide = np.tile(stack[:, :30], (1, 1, 10))  # so wide that it is worked off in strips
    again = by_symmetry(wide)
    assert np.array_equal(again.direct[:, :72], parts.direct[:30])
    assert np.array_equal(again.direct[:, -72:], parts.direct[:30])


@pytest.mark.parametrize(
    ("words", "change", "options"),
    [
        ("odd number of images", lambda s: s[:16], {}),
        ("at least 9 images", lambda s: s[:4], {}),
        ("checks of 5 pixels or more", lambda s: s, {"check_px": 4.2}),
        ("needs the period", lambda s: s, {"shifts": SHIFTS}),
        ("equal steps", lambda s: s, {"shifts": SHIFTS, "period": 17}),
        ("pair for each image", lambda s: s, {"shifts": range(25), "period": 25}),
        ("24 shifts for 25 images", lambda s: s, {"shifts": SHIFTS[:24], "period": 16}),
        ("have the same shift", lambda s: s, {"shifts": [*SHIFTS[:24], SHIFTS[2]], "period": 16}),
        ("out of order", lambda s: s[np.random.default_rng(0).permutation(25)], {}),
        ("too much noise", lambda s: s + np.random.default_rng(0).normal(0, 0.2, s.shape), {}),
        ("show the same pattern", lambda s: s[[*range(24), 11]], {}),
        ("never lit or never dark", lambda s: np.broadcast_to(s[:1], s.shape), {}),
        ("2.00 times what the mean", lambda s: s, {"white": 2 * (DIRECT + GLOBAL)}),
        ("white must have the shape", lambda s: s, {"white": DIRECT[:-1]}),
        ("white contains NaN", lambda s: s, {"white": np.full(SIZE, np.nan)}),
        ("dark must lie", lambda s: s, {"dark": 1.0}),
        ("saturated", lambda s: np.minimum(3 * s, 1.0), {}),
    ],
)
def test_what_does_not_fit_is_refused(words, change, options):
    with pytest.raises(BadInput) as caught:
        by_symmetry(change(spreading(SHIFTS)), **options)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_half_a_period_is_refused():
    """25 shifts that stop at half of the period contradict the symmetry."""
    with pytest.raises(BadInput, match="do not fill one period"):
        by_symmetry(spreading([(a / 2, b / 2) for a, b in SHIFTS]), settings=StackSettings(repeat=0.0))
