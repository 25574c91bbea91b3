"""When motion is undone: it must be as large as what is seen, and explain the shots better than they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splitknit.finger.steady import _apart_from_lights, _Registered, _worth_undoing


def registered(most_mm: float, before: float, after: float) -> _Registered:
    return _Registered({}, most_mm, before, after, {})


@pytest.mark.parametrize(
    ("most_mm", "before", "after", "seen_mm", "undone"),
    [
        (0.05, 0.20, 0.18, 0.03, True),  # a tenth of a millimetre, skin with much glare left over
        (0.05, 0.20, 0.199, 0.03, False),  # a still finger: nothing is explained better
        (0.015, 0.20, 0.10, 0.03, False),  # less than is worth a resampling
        (
            0.30,
            0.60,
            0.40,
            0.03,
            False,
        ),  # shots that do not fit together, and hardly any motion seen: no skin, wet skin
        (0.30, 0.60, 0.40, 0.06, True),  # the same with motion that would be warned of: to be refused
        (0.15, 0.47, 0.466, 0.06, False),  # a still finger with few ridges and much gloss: nothing to be undone
    ],
)
def test_what_is_undone(most_mm: float, before: float, after: float, seen_mm: float, undone: bool) -> None:
    assert _worth_undoing(registered(most_mm, before, after), seen_mm) is undone


def test_ridges_that_seem_to_follow_the_lights_did_not_move() -> None:
    """A shift of 0.044 mm against each light is shading; a steady drift, with it or alone, is motion."""
    angle = 2 * np.pi * np.arange(7) / 7
    towards = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    drift = np.outer(np.arange(7) - 3, (0.02, -0.01))
    shaded = -0.044 * towards + (0.04, -0.03)
    assert _apart_from_lights(shaded, towards) == pytest.approx(np.broadcast_to((0.04, -0.03), (7, 2)))
    assert np.ptp(_apart_from_lights(shaded + drift, towards), axis=0)[0] > 0.08
    moved = registered(0.10, 0.31, 0.28)
    assert _worth_undoing(moved, 0.09)
    for shifts, undone in ((shaded, False), (drift, True), (shaded + drift, True)):
        left = _apart_from_lights(shifts, towards).var(axis=0).sum() / shifts.var(axis=0).sum()
        assert _worth_undoing(replace(moved, apart=float(left)), 0.09) is undone
