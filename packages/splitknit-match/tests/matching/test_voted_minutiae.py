"""Votes for minutiae: what enough pictures show is kept, once, and the order of the pictures plays no part."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splitknit.errors import BadInput
from splitknit_match.matching.minutiae_record import Minutiae, no_minutiae
from splitknit_match.matching.voted_minutiae import VoteSettings, vote

SIZE = (300, 260)


def listed(rows: list[tuple[float, float, float, int]]) -> Minutiae:
    table = np.array(rows, dtype=np.float64).reshape(-1, 4)
    return Minutiae(
        np.rint(table[:, 0]).astype(np.int32),
        np.rint(table[:, 1]).astype(np.int32),
        table[:, 2] % (2 * np.pi),
        table[:, 3].astype(np.uint8),
        np.full(len(table), 50, np.uint8),
        SIZE,
    )


def seen(seed: int, pictures: int = 28, missing: float = 0.2, noise: int = 40) -> tuple[np.ndarray, list[Minutiae]]:
    """True places 20 px apart, and pictures that move them by 1 px, miss some, and add false ones."""
    rng = np.random.default_rng(seed)
    grid = np.stack(np.meshgrid(np.arange(30, 240, 30), np.arange(30, 280, 30)), 2).reshape(-1, 2).astype(float)
    direction, kind = rng.uniform(0, 2 * np.pi, len(grid)), rng.integers(1, 3, len(grid))
    found = []
    for _ in range(pictures):
        shown = rng.uniform(size=len(grid)) > missing
        rows = [
            (x + rng.normal(), y + rng.normal(), d + 0.1 * rng.normal(), t)
            for (x, y), d, t, s in zip(grid, direction, kind, shown, strict=True)
            if s
        ]
        rows += [(*rng.uniform(5, 250, 2), rng.uniform(0, 6), 1) for _ in range(noise)]
        found.append(listed(rows))
    return np.column_stack([grid, direction, kind]), found


def test_true_minutiae_win_and_false_ones_lose() -> None:
    truth, pictures = seen(1)
    found = vote(pictures, VoteSettings(least_share=0.5))
    apart = np.hypot(found.x_px[:, None] - truth[:, 0], found.y_px[:, None] - truth[:, 1])
    assert found.count == len(truth)
    nearest = apart.argmin(axis=1)
    assert len(set(nearest.tolist())) == len(truth)
    assert apart.min(axis=1).max() <= 1.5
    turn = np.angle(np.exp(1j * (found.direction_rad - truth[nearest, 2])))
    assert np.abs(turn).max() < 0.15
    np.testing.assert_array_equal(found.type, truth[nearest, 3])
    assert 65 < found.quality.mean() < 95  # the fraction that saw them: 80 %


def test_quality_is_the_share_and_the_limit_is_met_exactly() -> None:
    there, empty = listed([(100, 100, 1.0, 1)]), no_minutiae(SIZE)
    assert vote([there, there, empty, empty, empty], VoteSettings(least_share=0.4)).quality.tolist() == [40]
    assert vote([there, there, empty, empty, empty], VoteSettings(least_share=0.41)).count == 0
    assert vote([empty, empty]).count == 0


def test_a_picture_has_one_vote_and_directions_count() -> None:
    twice = listed([(100, 100, 1.0, 1), (103, 100, 1.0, 1)])
    assert vote([twice, no_minutiae(SIZE)], VoteSettings(least_share=0.6)).count == 0
    both = vote([twice], VoteSettings(least_share=1.0))
    assert both.count == 2  # each with its own vote
    turned = listed([(100, 100, 1.0 + np.pi, 1)])
    assert vote([turned, listed([(100, 100, 1.0, 1)])], VoteSettings(least_share=0.6)).count == 0


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 1000))
def test_the_order_of_the_pictures_changes_nothing(seed: int) -> None:
    _, pictures = seen(seed, pictures=6)
    rng = np.random.default_rng(seed)
    one, other = vote(pictures), vote([pictures[k] for k in rng.permutation(len(pictures))])
    for name in ("x_px", "y_px", "direction_rad", "type", "quality"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name))


def test_what_cannot_vote_is_refused() -> None:
    with pytest.raises(BadInput, match="at least one picture"):
        vote([])
    with pytest.raises(BadInput, match="of one size"):
        vote([no_minutiae((10, 10)), no_minutiae((10, 12))])
    with pytest.raises(BadInput, match="least_share"):
        VoteSettings(least_share=0.0)
