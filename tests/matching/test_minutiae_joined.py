"""Minutiae and ridges as one score."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from splitknit.errors import BadInput
from splitknit.matching.score import JoinedSettings, joined_similarity


def test_it_is_the_mean_of_both_z_scores() -> None:
    settings = JoinedSettings(10, 20, 0.2, 0.1)
    assert joined_similarity(50, 0.5, settings) == pytest.approx((2 + 3) / 2)
    assert joined_similarity(math.nan, 0.5, settings) == pytest.approx(3)
    assert joined_similarity(50, math.nan, settings) == pytest.approx(2)
    assert math.isnan(joined_similarity(math.nan, math.nan))


def test_constants_are_those_that_were_fitted() -> None:
    file = Path(__file__).resolve().parents[2] / "validation" / "match" / "real_prints.json"
    fitted, used = json.loads(file.read_text())["fitted"], JoinedSettings()
    assert [used.minutiae_mean, used.ridge_mean] == fitted["mean"]
    assert [used.minutiae_deviation, used.ridge_deviation] == fitted["deviation"]


def test_deviations_are_checked() -> None:
    with pytest.raises(BadInput, match="positive"):
        JoinedSettings(ridge_deviation=0.0)
