"""Ranges of what people type."""

import pytest

from refusals import bad_input
from splitknit import plausible
from splitknit.plausible import CAMERA_HEIGHT, RELIEF, _Plausible

QUANTITIES = [value for value in vars(plausible).values() if isinstance(value, _Plausible)]


@pytest.mark.parametrize("quantity", QUANTITIES, ids=lambda quantity: quantity.what)
def test_usual_values_are_possible_and_get_no_note(quantity):
    low, high = quantity.usual
    assert quantity.possible[0] <= low < high <= quantity.possible[1]
    assert quantity.notes(high, "x") == ()


def test_unusual_values_get_a_note():
    assert CAMERA_HEIGHT.notes(140.0, "check `square_mm`") == ()
    (note,) = CAMERA_HEIGHT.notes(500.0, "check `square_mm`")
    assert str(note).endswith("is 500 mm, where 40 to 400 mm is usual: check `square_mm`.")
    assert "is 4000 um" in str(RELIEF.notes(4000.0, "give `material` opaque")[0])


def test_impossible_values_are_refused():
    words = "is 1401 mm, where only 15 to 1000 mm is possible: check `square_mm`"
    with bad_input(words):
        CAMERA_HEIGHT.notes(1401.0, "check `square_mm`")
    with bad_input():
        CAMERA_HEIGHT.notes(float("nan"), "check `square_mm`")
