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


def ellipse(rows: int, columns: int) -> np.ndarray:
    y, x = np.mgrid[0:rows, 0:columns]
    return ((x - (columns - 1) / 2) / (columns / 2)) ** 2 + ((y - (rows - 1)) / rows) ** 2 < 1


@settings(max_examples=20, deadline=None, derandomize=True)
@given(right=st.integers(-30, 30), rows=st.integers(60, 160), columns=st.integers(60, 120))
def test_lateral_search_finds_the_shift(right: int, rows: int, columns: int) -> None:
    """A query that is the database's finger with empty columns on one side."""
    mask = ellipse(rows, columns)
    query = np.pad(mask, ((0, 0), (max(0, -right), max(0, right))))
    assert align_masks(mask, query) == (-max(0, -right), 1.0)


def test_overlap_by_hand() -> None:
    a, b = np.ones((4, 6), np.bool_), np.ones((4, 6), np.bool_)
    assert [best_shift(a, b, range(k, k + 1))[1] for k in range(-7, 1)] == [
        0,
        0,
        4,
        8,
        12,
        16,
        20,
        24,
    ]
    assert best_shift(a, b, range(-7, 8)) == (0, 24)
    assert align_masks(a, b[:2])[1] == pytest.approx(12 / 24)


def test_the_gate_keeps_unlike_outlines_apart() -> None:
    wide, slim = pictured(ellipse(120, 100)), pictured(ellipse(120, 70))
    found = thesis_match(wide, slim)
    assert not found.compared
    assert found.ratio < 0.9
    assert found.dissimilarity["normals"] == pytest.approx(np.exp(2 - found.ratio))
    assert found.similarity == pytest.approx(1 - np.exp(2 - found.ratio))
    assert found.distances == {}
    assert thesis_match(wide, slim, ThesisSettings(gate=0.0)).compared


def test_same_fingers_are_more_similar(impressions) -> None:
    """Poses that differ little: that is what this matcher can take."""
    chosen = ThesisSettings(gate=0.0)
    fingers = [impressions[k].images() for k in (0, 3, 6)]
    for k, one in zip((0, 3, 6), fingers, strict=True):
        again = finger_images(
            np.roll(impressions[k].normals, 2, axis=1), np.roll(impressions[k].ridge_mm, 2, axis=1),
            np.roll(impressions[k].mask, 2, axis=1), impressions[k].pitch_mm,
        )  # fmt: skip
        same = thesis_match(one, again, chosen).similarity
        others = [
            thesis_match(other, again, chosen).similarity for other in fingers if other is not one
        ]
        assert same > max(others)


def test_equal_fingers_give_one_and_known_features_change_nothing(impressions) -> None:
    one, other = impressions[0].images(), impressions[3].images()
    found = thesis_match(one, one)
    assert found.similarity == 1.0
    assert set(found.distances.values()) == {0.0}
    chosen = ThesisSettings(gate=0.0)
    known = thesis_match(replace(one, channels={}), other, chosen, finger_features(one, chosen))
    assert thesis_match(one, other, chosen) == known


def test_the_score_is_that_of_the_distances(impressions) -> None:
    found = thesis_match(impressions[0].images(), impressions[3].images(), ThesisSettings(gate=0.0))
    total = sum(found.distances[name] for name in ("normal_x", "normal_y", "normal_z"))
    assert found.dissimilarity["normals"] == pytest.approx(np.exp(-(found.ratio**4) / total))
    assert found.dissimilarity["relief"] == pytest.approx(
        np.exp(-(found.ratio**4) / found.distances["relief"])
    )
    assert found.similarity == pytest.approx(1 - np.mean(list(found.dissimilarity.values())))


def test_upright_images_turn_their_normals() -> None:
    """A tilted plane, turned by 90 deg: what pointed right points up, as the picture does."""
    normals = np.zeros((30, 40, 3), np.float32)
    normals[:] = (0.6, 0.0, 0.8)
    mask = np.zeros((30, 40), np.bool_)
    mask[10:20, 12:26] = True
    relief = np.zeros((30, 40), np.float32)
    # upright content is the input turned counter-clockwise
    turn = rotation_about((19.5, 14.5), -np.pi / 2)
    found = finger_images(normals, relief, mask, 0.1, turn, upright_size=(60, 60))
    assert found.mask.shape == pytest.approx((14, 10), abs=1)
    middle = tuple(float(found.channels[f"normal_{axis}"][7, 5]) for axis in "xyz")
    assert middle == pytest.approx((0.0, 0.6, 0.8), abs=1e-5)


def test_boxes_are_made_equal_in_size() -> None:
    ramp = np.broadcast_to(np.arange(20, dtype=np.float32), (10, 20))
    assert to_box(ramp, (10, 20)) is ramp
    wide = to_box(ramp, (15, 40))
    assert wide.shape == (15, 40)
    assert wide[7, 20] == pytest.approx(9.75, abs=0.01)


def test_scales_and_settings_are_checked(impressions) -> None:
    for change in ({"gate": 2}, {"attributes": ("colour",)}, {"attributes": ()}):
        with pytest.raises(BadInput):
            ThesisSettings(**change)
    one = impressions[0].images()
    with pytest.raises(BadInput, match="px/mm"):
        thesis_match(one, FingerImages(one.channels, one.mask, 75.7))
    with pytest.raises(BadInput, match="no channel"):
        thesis_match(one, one, ThesisSettings(attributes=("shape_normals",)))


def pictured(mask: np.ndarray) -> FingerImages:
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(*mask.shape, 3)).astype(np.float32)
    return finger_images(normals, normals[..., 0], mask, 0.05)
