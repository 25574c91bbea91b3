"""When motion is undone: it must be as large as what is seen, and explain the shots better than they are."""

from __future__ import annotations

import pytest

from splitknit.finger.steady import _Registered, _worth_undoing


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
