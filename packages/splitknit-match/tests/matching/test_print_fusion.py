"""Minutiae and ridges of two prints as one score."""

import json
import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from refusals import bad_input
from splitknit_match.matching import fusion
from splitknit_match.matching.elastic import bent, compare_patches, patch_grid, shown_in_a
from splitknit_match.matching.fusion import (
    by_ridges,
    fused_match,
    fused_photo,
    fused_score,
    with_fusion,
)
from splitknit_match.matching.ridge import Prepared, ridge_match
from splitknit_match.matching.ridge_band import RidgeBand
from splitknit_match.matching.template import Template, pack, print_size, scaled, unpack
from splitknit_match.records.minutiae_record import Minutiae, no_minutiae


@pytest.mark.parametrize(
    ("file", "name", "constants"),
    [
        ("fvc.json", "both", fusion.BY_BOTH),
        ("fvc.json", "minutiae_alone", fusion.BY_MINUTIAE),
        ("windows.json", "overlap", fusion.BY_OVERLAP),
        ("windows.json", "overlap_and_minutiae", fusion.BY_OVERLAP_AND_MINUTIAE),
    ],
)
def test_constants_are_the_fitted_ones(file, name, constants):
    folder = Path(__file__).resolve().parents[4] / "validation" / "match"
    assert list(constants) == json.loads((folder / file).read_text())["fitted"][name]


NONE = math.nan


def test_either_method_alone_counts_where_the_other_failed():
    assert fused_score(NONE, NONE, 12, NONE) > 0 > fused_score(NONE, NONE, 2, NONE)
    assert fused_score(NONE, 0.8, NONE, 60) > 0 > fused_score(NONE, 0.2, NONE, 60)
    both = fused_score(2, 0.6, 3, NONE)
    assert both > fused_score(2, 0.2, 3, NONE)
    assert both > fused_score(0.4, 0.6, 3, NONE)
    neither = fused_score(NONE, NONE, NONE, NONE)
    assert neither == fused_score(NONE, NONE, 0.0, NONE) == fusion.BY_BOTH[2]


def test_ridges_count_more_where_more_overlaps_up_to_a_small_print():
    overlaps_mm2 = (10, 30, 90, fusion.SMALL_MM2, 300)
    scores = [fused_score(NONE, 0.6, NONE, overlap) for overlap in overlaps_mm2]
    assert scores[0] < scores[1] < scores[2] < scores[3] == scores[4]


@pytest.mark.parametrize(("factor", "off", "gain"), [(1.25, 0.02, 5), (1.1, 0.05, 0)])
def test_a_photograph_is_compared_at_the_scale_that_fits(templates, factor, off, gain):
    """Minutiae drift as far as a scale that is wrong by 5 % moves them."""
    template = with_minutiae(templates[0])
    photo, contact = Prepared(scaled(template, factor)), Prepared(template)
    assert photo.template.minutiae.size == print_size(photo.template)
    assert photo.template.area_mm2 == pytest.approx(factor**2 * template.area_mm2, rel=0.02)
    match, scale, number = fused_photo(photo, contact, (True, False))
    assert (scale, number) == (pytest.approx(1 / factor, abs=off), 0)
    assert match.similarity > fused_match(photo, contact).similarity + gain
    exchanged, scale_of_second, number = fused_photo(contact, photo, (False, True))
    assert (exchanged.similarity, scale_of_second, number) == (match.similarity, scale, 1)
    first, second = (
        fused_photo(*sides, (True, True))[0].similarity
        for sides in ((photo, contact), (contact, photo))
    )
    assert first == second


def test_minutiae_come_back_with_their_template():
    without = Template(np.full((200, 190), 2, np.uint8), np.ones((200, 190), np.bool_), 0.1)
    template = with_minutiae(without, 12)
    again = unpack(pack(template))
    assert np.array_equal(again.level, template.level)
    assert np.array_equal(again.minutiae.x_px, template.minutiae.x_px)
    plain = pack(without)
    assert pack(template).startswith(plain)
    assert unpack(plain).minutiae is None
    for damaged in (pack(template)[:-1], plain + b"x", plain + b"SKMI" + bytes(20)):
        with bad_input():
            unpack(damaged)


def test_prints_with_few_minutiae_are_compared_by_their_ridges(templates):
    match = fused_match(with_minutiae(templates[0], 5), with_minutiae(templates[1]))
    assert match.minutiae is None
    assert math.isnan(match.evidence[0])
    assert match.ridge == ridge_match(*templates[:2])
    assert match.similarity > 0  # impressions of one finger


def test_minutiae_of_another_grid_are_refused(templates):
    assert unpack(pack(with_minutiae(templates[0]))).minutiae is not None
    other = replace(templates[0], minutiae=random_minutiae(12, (388, 374)))
    with bad_input():
        unpack(pack(other))


def test_templates_without_minutiae_are_not_fused(templates):
    without, fusable = templates[0], with_minutiae(templates[0])
    assert with_fusion([fusable, fusable]) == (True, ())
    assert with_fusion([without]) == (False, ())
    assert by_ridges(fusable, without) and not by_ridges(fusable, fusable)
    fused, findings = with_fusion([fusable, without])
    assert fused
    assert str(findings[0]).startswith("1 of 2 templates hold no minutiae")


def test_nothing_to_compare_is_the_lowest_score(templates):
    empty = Template(np.zeros((0, 0), np.uint8), np.zeros((0, 0), np.bool_), 0.1, no_minutiae())
    match = fused_match(empty, with_minutiae(templates[0]))
    assert not match.compared
    assert match.similarity < -5


def with_minutiae(template, count=30):
    return replace(template, minutiae=random_minutiae(count, print_size(template)))


def random_minutiae(count, size):
    rng = np.random.default_rng(3)
    x, y = (rng.permutation(side - 1)[:count].astype(np.int32) for side in size[::-1])
    order = np.lexsort((y, x))
    direction_rad = rng.integers(0, 32, count) * (np.pi / 16)
    kind = np.ones(count, np.uint8)
    return Minutiae(x[order], y[order], direction_rad, kind, kind * 50, size)


def test_a_bent_print_is_laid_back():
    """Ridges stretched by a smooth shift of a ridge's width correlate after bending, and not
    without."""
    rng = np.random.default_rng(2)
    noise = cv2.GaussianBlur(rng.normal(size=(200, 200)).astype(np.float32), (0, 0), 1.6)
    value = ((noise - cv2.GaussianBlur(noise, (0, 0), 3)) / noise.std()).astype(np.float32)
    down, right = np.mgrid[0:200, 0:200].astype(np.float32)
    shift = 7 * np.sin(right / 200 * 2 * np.pi).astype(np.float32)
    moved = cv2.remap(value, right + shift, down, cv2.INTER_LINEAR)
    valid = np.ones((200, 200), np.bool_)
    grid, band = patch_grid(RidgeBand(moved, valid, 0.1)), RidgeBand(value, valid, 0.1)
    still = np.eye(2, 3)
    agreement, bend = compare_patches(grid, band, still), None
    plain = agreement.mean
    for _ in range(3):
        bend = bent(grid, agreement, bend)
        agreement = compare_patches(grid, band, still, bend)
    assert agreement.mean > 0.9 > plain + 0.05
    middle = shown_in_a(grid, still, bend, np.array([[50.0, 100.0], [150.0, 100.0]]))
    assert middle[:, 0] == pytest.approx([57, 143], abs=1.5)
