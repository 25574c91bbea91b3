"""The thesis's matcher: alignment, gate, score."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splitknit.errors import BadInput
from splitknit.imaging.geometry import rotation_about
from splitknit_match.matching.thesis import (
    FingerImages,
    ThesisSettings,
    align_masks,
    best_shift,
    finger_features,
    finger_images,
    thesis_match,
    to_box,
)

NO_GATE = ThesisSettings(gate=0.0)


def ellipse(rows: int, columns: int) -> np.ndarray:
    y, x = np.mgrid[0:rows, 0:columns]
    return ((x - (columns - 1) / 2) / (columns / 2)) ** 2 + ((y - (rows - 1)) / rows) ** 2 < 1


@settings(max_examples=20, deadline=None, derandomize=True)
@given(right=st.integers(-30, 30), rows=st.integers(60, 160), columns=st.integers(60, 120))
def test_lateral_search_recovers_the_shift(right: int, rows: int, columns: int) -> None:
    """A query that is the database's finger with empty columns on one side."""
    mask = ellipse(rows, columns)
    query = np.pad(mask, ((0, 0), (max(0, -right), max(0, right))))
    assert align_masks(mask, query) == (-max(0, -right), 1.0)


def test_the_shift_of_the_largest_overlap_is_chosen() -> None:
    a = b = np.ones((4, 6), np.bool_)
    overlaps = [best_shift(a, b, range(k, k + 1))[1] for k in range(-7, 1)]
    assert overlaps == [0, *range(0, 25, 4)]
    assert best_shift(a, b, range(-7, 8)) == (0, 24)
    assert align_masks(a, b[:2])[1] == pytest.approx(12 / 24)


def test_dissimilar_outlines_are_not_compared() -> None:
    wide, slim = random_images(ellipse(120, 100)), random_images(ellipse(120, 70))
    match = thesis_match(wide, slim)
    assert not match.compared
    assert match.ratio < 0.9
    assert match.dissimilarity["normals"] == pytest.approx(np.exp(2 - match.ratio))
    assert match.similarity == pytest.approx(1 - np.exp(2 - match.ratio))
    assert match.distances == {}
    assert thesis_match(wide, slim, NO_GATE).compared


@pytest.mark.parametrize("index", [0, 3, 6])
def test_a_finger_is_most_similar_to_itself_moved(impressions, index: int) -> None:
    """By two pixels: this matcher needs poses that differ little."""
    impression = impressions[index]
    fields = impression.normals, impression.ridge_mm, impression.mask
    moved = finger_images(*(np.roll(field, 2, axis=1) for field in fields), impression.pitch_mm)
    similarities = {
        k: thesis_match(impressions[k].images(), moved, NO_GATE).similarity for k in (0, 3, 6)
    }
    genuine = similarities.pop(index)
    assert genuine > max(similarities.values())


def test_a_finger_equals_itself(impressions) -> None:
    finger = impressions[0].images()
    match = thesis_match(finger, finger)
    assert match.similarity == 1.0
    assert set(match.distances.values()) == {0.0}


def test_features_computed_earlier_change_nothing(impressions) -> None:
    a, b = impressions[0].images(), impressions[3].images()
    with_features = thesis_match(replace(a, channels={}), b, NO_GATE, finger_features(a, NO_GATE))
    assert thesis_match(a, b, NO_GATE) == with_features


def test_the_score_is_that_of_the_distances(impressions) -> None:
    match = thesis_match(impressions[0].images(), impressions[3].images(), NO_GATE)
    totals = {
        "normals": sum(match.distances[name] for name in ("normal_x", "normal_y", "normal_z")),
        "relief": match.distances["relief"],
    }
    for name, total in totals.items():
        assert match.dissimilarity[name] == pytest.approx(np.exp(-(match.ratio**4) / total))
    assert match.similarity == pytest.approx(1 - np.mean(list(match.dissimilarity.values())))


def test_normals_turn_with_the_upright_image() -> None:
    """A tilted plane, turned by 90 deg: what pointed right points up."""
    normals = np.full((30, 40, 3), (0.6, 0.0, 0.8), np.float32)
    mask = np.zeros((30, 40), np.bool_)
    mask[10:20, 12:26] = True
    relief = np.zeros((30, 40), np.float32)
    # upright content is the input turned counter-clockwise
    turn = rotation_about((19.5, 14.5), -np.pi / 2)
    upright = finger_images(normals, relief, mask, 0.1, turn, upright_size=(60, 60))
    assert upright.mask.shape == pytest.approx((14, 10), abs=1)
    middle = tuple(float(upright.channels[f"normal_{axis}"][7, 5]) for axis in "xyz")
    assert middle == pytest.approx((0.0, 0.6, 0.8), abs=1e-5)


def test_a_channel_is_resized_to_its_box() -> None:
    ramp = np.broadcast_to(np.arange(20, dtype=np.float32), (10, 20))
    assert to_box(ramp, (10, 20)) is ramp
    wide = to_box(ramp, (15, 40))
    assert wide.shape == (15, 40)
    assert wide[7, 20] == pytest.approx(9.75, abs=0.01)


def test_two_scales_and_impossible_settings_are_refused(impressions) -> None:
    for change in ({"gate": 2}, {"attributes": ("colour",)}, {"attributes": ()}):
        with pytest.raises(BadInput):
            ThesisSettings(**change)
    finger = impressions[0].images()
    with pytest.raises(BadInput, match="px/mm"):
        thesis_match(finger, replace(finger, px_per_mm=75.7))
    with pytest.raises(BadInput, match="no channel"):
        thesis_match(finger, finger, ThesisSettings(attributes=("shape_normals",)))


def random_images(mask: np.ndarray) -> FingerImages:
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(*mask.shape, 3)).astype(np.float32)
    return finger_images(normals, normals[..., 0], mask, 0.05)
