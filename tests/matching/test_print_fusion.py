"""Minutiae and ridges of two prints as one score."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.matching import fusion
from splitknit.matching.fusion import can_fuse, fused_match, fused_similarity
from splitknit.matching.minutiae_record import Minutiae, no_minutiae
from splitknit.matching.ridge import ridge_match
from splitknit.matching.template import Template, pack, unpack


def test_constants_are_those_that_were_fitted() -> None:
    file = Path(__file__).resolve().parents[2] / "validation" / "match" / "real_prints.json"
    fitted = json.loads(file.read_text())["fitted"]
    for name, used in (
        ("both", fusion._BOTH),
        ("minutiae_alone", fusion._MINUTIAE_ALONE),
        ("ridges_alone", fusion._RIDGES_ALONE),
    ):
        assert list(used) == fitted[name]


def test_either_method_alone_counts_where_the_other_failed() -> None:
    assert fused_similarity(60, math.nan) > 0 > fused_similarity(5, math.nan)
    assert fused_similarity(math.nan, 0.6) > 0 > fused_similarity(math.nan, 0.2)
    assert fused_similarity(60, 0.6) > max(fused_similarity(60, 0.2), fused_similarity(5, 0.6))
    assert math.isnan(fused_similarity(math.nan, math.nan))


def test_minutiae_come_back_with_their_template() -> None:
    template = Template(np.full((9, 7), 2, np.uint8), np.ones((9, 7), np.bool_), 0.1, some_minutiae(12))
    again = unpack(pack(template))
    assert np.array_equal(again.level, template.level)
    assert again.minutiae is not None
    assert template.minutiae is not None
    assert np.array_equal(again.minutiae.x_px, template.minutiae.x_px)
    plain = pack(Template(template.level, template.valid, 0.1))
    assert pack(template).startswith(plain)
    assert unpack(plain).minutiae is None
    for damaged in (pack(template)[:-1], plain + b"x", plain + b"SKMI" + bytes(20)):
        with pytest.raises(BadInput):
            unpack(damaged)


def test_prints_are_compared_by_both(templates) -> None:
    pytest.importorskip("nbis")
    a, b = (Template(t.level, t.valid, t.pitch_mm, some_minutiae(30)) for t in templates[:2])
    assert can_fuse(a, b)
    assert not can_fuse(a, templates[0])
    found = fused_match(a, b)
    assert found.ridge == ridge_match(*templates[:2])
    assert found.minutiae is not None
    assert found.similarity == fused_similarity(found.minutiae, found.ridge.similarity)
    assert fused_match(b, a).similarity == found.similarity
    few = Template(a.level, a.valid, a.pitch_mm, some_minutiae(5))
    assert fused_match(few, b).minutiae is None
    assert fused_match(few, b).similarity == fused_similarity(math.nan, found.ridge.similarity)


def test_nothing_to_compare_is_the_lowest_score(templates) -> None:
    pytest.importorskip("nbis")
    none = Template(np.zeros((0, 0), np.uint8), np.zeros((0, 0), np.bool_), 0.1, no_minutiae())
    whole = Template(templates[0].level, templates[0].valid, 0.1, some_minutiae(30))
    found = fused_match(none, whole)
    assert not found.compared
    assert found.similarity < fused_similarity(0, 0)


def some_minutiae(count: int) -> Minutiae:
    """Minutiae at random places of one print."""
    rng = np.random.default_rng(3)
    x, y = (rng.permutation(370)[:count].astype(np.int32) for _ in range(2))
    order = np.lexsort((y, x))
    kind = np.ones(count, np.uint8)
    return Minutiae(x[order], y[order], rng.integers(0, 32, count) * (np.pi / 16), kind, kind * 50, (388, 374))
