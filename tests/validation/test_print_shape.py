"""A fingertip's shape from a rolled print's silhouettes."""

from __future__ import annotations

import numpy as np
import pytest

from script_folder import VALIDATION, scripts_of
from splitknit.errors import BadInput

with scripts_of(VALIDATION / "thesis") as script:
    fingertip_of_print = script("print_shape").fingertip_of_print

PITCH_MM = 0.1


def test_a_print_rolled_off_an_elliptic_cylinder_gives_it_back() -> None:
    half, aspect = 8.0, 0.7
    turn = np.linspace(-np.pi / 2, np.pi / 2, 20_001)
    arc = np.sum(np.hypot(half * np.cos(turn), aspect * half * np.sin(turn))) * (turn[1] - turn[0])
    points = fingertip_of_print(np.ones((200, round(arc / PITCH_MM)), dtype=bool), PITCH_MM, aspect=aspect)
    np.testing.assert_allclose((points[..., 0] / half) ** 2 + (points[..., 2] / (aspect * half)) ** 2, 1.0, atol=0.02)
    assert points[..., 1].max() == pytest.approx(199 * PITCH_MM)


def test_a_round_tip_falls_towards_the_nail_and_nothing_lies_beyond_the_ink() -> None:
    rows, columns = np.mgrid[:250, :240]
    ink = (rows >= 120) | ((rows - 120) ** 2 + (columns - 119.5) ** 2 < 119**2)
    points = fingertip_of_print(ink, PITCH_MM)
    top = np.nanmax(points[ink.any(axis=1)][..., 2], axis=1)
    assert top[0] < 0.5 * top[-1]
    assert (np.diff(top) > -1e-9).all()
    np.testing.assert_array_equal(np.isfinite(points[..., 0]), ink)


@pytest.mark.parametrize(
    ("ink", "options", "words"),
    [
        (np.zeros((9, 9), dtype=bool), {}, "empty"),
        (np.ones((9, 9), dtype=bool), {"aspect": 0.0}, "aspect"),
        (np.ones((9, 9), dtype=bool), {"turn_deg": 10.0}, "A roll must turn by 60 to 300 deg"),
    ],
)
def test_no_ink_and_odd_numbers_are_refused(ink, options, words) -> None:
    with pytest.raises(BadInput, match=words):
        fingertip_of_print(ink, PITCH_MM, **options)
