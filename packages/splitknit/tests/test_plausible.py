"""Ranges of what people type."""

from __future__ import annotations

import pytest

from splitknit import plausible
from splitknit.errors import BadInput
from splitknit.plausible import CAMERA_HEIGHT, RELIEF, _Plausible

ALL = [one for one in vars(plausible).values() if isinstance(one, _Plausible)]


@pytest.mark.parametrize("one", ALL, ids=lambda one: one.what)
def test_the_usual_is_possible(one: _Plausible) -> None:
    assert one.possible[0] <= one.usual[0] < one.usual[1] <= one.possible[1]
    assert one.notes(one.usual[1], "x") == ()


def test_the_odd_is_noted_and_the_impossible_refused() -> None:
    assert CAMERA_HEIGHT.notes(140.0, "check `square_mm`") == ()
    (note,) = CAMERA_HEIGHT.notes(500.0, "check `square_mm`")
    assert str(note).endswith("is 500 mm, where 40 to 400 mm is usual: check `square_mm`.")
    with pytest.raises(
        BadInput, match="is 1401 mm, where only 15 to 1000 mm is possible: check `square_mm`"
    ):
        CAMERA_HEIGHT.notes(1401.0, "check `square_mm`")
    with pytest.raises(BadInput):
        CAMERA_HEIGHT.notes(float("nan"), "check `square_mm`")
    assert "is 4000 um" in str(RELIEF.notes(4000.0, "give `material` opaque")[0])
