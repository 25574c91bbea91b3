"""Minutiae and ridges of two prints as one score."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit_match.matching import parameters
from splitknit_match.matching.elastic import bent, compare_patches, patch_grid, shown_in_a
from splitknit_match.matching.fusion import (
    can_fuse,
    fused_match,
    fused_photo,
    fused_score,
    with_fusion,
)
from splitknit_match.matching.minutia_pairs import Cylinders, minutia_cylinders, pair_minutiae
from splitknit_match.matching.ridge import Prepared, ridge_match
from splitknit_match.matching.ridge_band import RidgeBand
from splitknit_match.matching.template import Template, pack, print_size, scaled, unpack
from splitknit_match.prints.minutiae_record import Minutiae, no_minutiae


def test_constants_are_those_that_were_fitted() -> None:
    file = Path(__file__).resolve().parents[4] / "validation" / "match" / "fvc.json"
    fitted = json.loads(file.read_text())["fitted"]
    for name, used in (
        ("both", parameters.BY_BOTH),
        ("minutiae_alone", parameters.BY_MINUTIAE),
    ):
        assert list(used) == fitted[name]


def test_constants_of_small_prints_are_those_that_were_fitted() -> None:
    file = Path(__file__).resolve().parents[4] / "validation" / "match" / "windows.json"
    fitted = json.loads(file.read_text())["fitted"]
    assert list(parameters.BY_OVERLAP) == fitted["overlap"]
    assert list(parameters.BY_OVERLAP_AND_MINUTIAE) == fitted["overlap_and_minutiae"]


def test_either_method_alone_counts_where_the_other_failed() -> None:
    none = math.nan
    assert fused_score(none, none, 12, none) > 0 > fused_score(none, none, 2, none)
    assert fused_score(none, 0.8, none, 60) > 0 > fused_score(none, 0.2, none, 60)
    assert fused_score(2, 0.6, 3, none) > max(
        fused_score(2, 0.2, 3, none), fused_score(0.4, 0.6, 3, none)
    )


def test_what_overlaps_counts() -> None:
    """The same agreement of ridges says less where less overlaps, and nothing more beyond a small
    print."""
    none = math.nan
    scores = [
        fused_score(none, 0.6, none, overlap) for overlap in (10, 30, 90, parameters.SMALL_MM2, 300)
    ]
    assert scores[0] < scores[1] < scores[2] < scores[3] == scores[4]
    assert (
        fused_score(none, none, none, none)
        == fused_score(none, none, 0.0, none)
        == parameters.BY_BOTH[2]
    )


def test_a_photograph_is_compared_at_the_scale_that_fits(templates) -> None:
    one = templates[0]
    one = Template(one.level, one.valid, one.pitch_mm, some_minutiae(30, one))
    photo, print_of_it = Prepared(scaled(one, 1.1)), Prepared(one)
    assert photo.template.minutiae is not None
    assert photo.template.minutiae.size == print_size(photo.template)
    assert photo.template.area_mm2 == pytest.approx(1.21 * one.area_mm2, rel=0.02)
    found, scale, number = fused_photo(photo, print_of_it, (True, False))
    assert (scale, number) == (pytest.approx(1 / 1.1, abs=0.02), 0)
    assert found.similarity > fused_match(photo, print_of_it).similarity + 5
    again, other_scale, number = fused_photo(print_of_it, photo, (False, True))
    assert (again.similarity, other_scale, number) == (found.similarity, scale, 1)
    both = [
        fused_photo(*sides, (True, True))[0].similarity
        for sides in ((photo, print_of_it), (print_of_it, photo))
    ]
    assert both[0] == both[1]


def test_minutiae_come_back_with_their_template() -> None:
    template = Template(np.full((200, 190), 2, np.uint8), np.ones((200, 190), np.bool_), 0.1)
    template = replace(template, minutiae=some_minutiae(12, template))
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
    a, b = (Template(t.level, t.valid, t.pitch_mm, some_minutiae(30, t)) for t in templates[:2])
    assert can_fuse(a, b)
    assert not can_fuse(a, templates[0])
    found = fused_match(a, b)
    assert found.minutiae is not None
    assert not any(map(math.isnan, found.evidence[:3]))
    assert fused_match(b, a).similarity == found.similarity
    itself = fused_match(a, a)
    assert itself.similarity > found.similarity + 5
    few = Template(a.level, a.valid, a.pitch_mm, some_minutiae(5, a))
    alone = fused_match(few, b)
    assert alone.minutiae is None
    assert math.isnan(alone.evidence[0])
    assert alone.ridge == ridge_match(*templates[:2])
    assert alone.similarity > 0  # impressions of one finger


def test_minutiae_of_another_grid_are_left_out(templates) -> None:
    """Earlier versions kept them on the grid of the whole print."""
    now = Template(templates[0].level, templates[0].valid, 0.1, some_minutiae(12, templates[0]))
    assert unpack(pack(now)).minutiae is not None
    earlier = Template(templates[0].level, templates[0].valid, 0.1, some_minutiae(12))
    assert unpack(pack(earlier)).minutiae is None
    assert with_fusion([now, now]) == (True, ())
    assert with_fusion([templates[0]]) == (False, ())
    assert with_fusion([now], templates[0]) == (False, ())
    fused, findings = with_fusion([now, templates[0]])
    assert fused
    assert str(findings[0]).startswith("1 of 2 templates hold no minutiae")


def test_nothing_to_compare_is_the_lowest_score(templates) -> None:
    none = Template(np.zeros((0, 0), np.uint8), np.zeros((0, 0), np.bool_), 0.1, no_minutiae())
    whole = Template(templates[0].level, templates[0].valid, 0.1, some_minutiae(30, templates[0]))
    found = fused_match(none, whole)
    assert not found.compared
    assert found.similarity < -5


def some_minutiae(count: int, template: Template | None = None) -> Minutiae:
    """Minutiae at random places of one print, or on a template's grid."""
    rng = np.random.default_rng(3)
    size = (388, 374) if template is None else print_size(template)
    x, y = (rng.permutation(side - 1)[:count].astype(np.int32) for side in size[::-1])
    order = np.lexsort((y, x))
    kind = np.ones(count, np.uint8)
    return Minutiae(
        x[order], y[order], rng.integers(0, 32, count) * (np.pi / 16), kind, kind * 50, size
    )


def test_pairs_of_minutiae_find_any_turn() -> None:
    """Half of them missing on either side, the rest turned by 130 deg, moved and stretched by 3
    %."""
    rng = np.random.default_rng(5)
    count, valid = 60, np.ones((240, 240), np.bool_)
    place = rng.uniform(-7, 7, count) + 1j * rng.uniform(-7, 7, count)
    turn = rng.uniform(0, 2 * np.pi, count)

    def side(places: np.ndarray, turns: np.ndarray) -> Cylinders:
        pixels = [
            np.rint(235 + one * 500 / 25.4).astype(np.int32) for one in (-places.real, -places.imag)
        ]
        small = np.ones(len(turns), np.uint8)
        return minutia_cylinders(
            Minutiae(*pixels, (np.pi - turns) % (2 * np.pi), small, small, (471, 471)), valid, 0.1
        )

    angle, moved = np.deg2rad(130), 0.8 - 0.5j
    a = side(place[:45], turn[:45])
    b = side(1.03 * place[15:] * np.exp(1j * angle) + moved, turn[15:] + angle)
    found = pair_minutiae(a, b)[0]
    assert found.angle_rad == pytest.approx(angle, abs=0.03)
    assert (found.right_mm, found.up_mm) == pytest.approx((0.8, -0.5), abs=0.3)
    assert found.support > 10
    other = side(
        rng.uniform(-7, 7, 45) + 1j * rng.uniform(-7, 7, 45), rng.uniform(0, 2 * np.pi, 45)
    )
    assert max((one.support for one in pair_minutiae(a, other)), default=0) < 6


def test_a_bent_print_is_laid_back() -> None:
    """Ridges stretched by a smooth shift of a ridge's width correlate after bending, and not
    without."""
    rng = np.random.default_rng(2)
    noise = cv2.GaussianBlur(rng.normal(size=(200, 200)).astype(np.float32), (0, 0), 1.6)
    value = ((noise - cv2.GaussianBlur(noise, (0, 0), 3)) / noise.std()).astype(np.float32)
    down, right = np.mgrid[0:200, 0:200].astype(np.float32)
    aside = 7 * np.sin(right / 200 * 2 * np.pi).astype(np.float32)
    moved = cv2.remap(value, right + aside, down, cv2.INTER_LINEAR)
    valid = np.ones((200, 200), np.bool_)
    grid, band = patch_grid(RidgeBand(moved, valid, 0.1)), RidgeBand(value, valid, 0.1)
    still = np.eye(2, 3)
    found, bend = compare_patches(grid, band, still), None
    plain = found.mean
    for _ in range(3):
        bend = bent(grid, found, bend)
        found = compare_patches(grid, band, still, bend)
    assert found.mean > 0.9 > plain + 0.05
    assert bend is not None
    middle = shown_in_a(grid, still, bend, np.array([[50.0, 100.0], [150.0, 100.0]]))
    assert middle[:, 0] == pytest.approx([57, 143], abs=1.5)
