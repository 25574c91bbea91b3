"""Which captures are compared: all of them, or a fraction that grows without changing, in blocks."""

from __future__ import annotations

from collections import Counter

import numpy as np

from splitknit_match.batch.population import Blocks, CaptureRef, all_pairs, blocks_of, draw, missing_pairs

CAPTURES = [
    CaptureRef(f"S{s:02d}/session_{k}/{f}", f"S{s:02d}", f"S{s:02d}/{f}", str(k), n * 3 + k - 1, n)
    for n, (s, f) in enumerate((s, f) for s in range(1, 8) for f in ("right_index", "left_thumb"))
    for k in (1, 2, 3)
]


def test_all_fingers_of_all_pairs_of_sessions() -> None:
    pairs = all_pairs(CAPTURES, 1.0, 0)
    assert pairs.a.size == 3 * 14 * 14
    assert pairs.genuine.sum() == 3 * 14
    assert all(CAPTURES[a].session < CAPTURES[b].session for a, b in zip(pairs.a, pairs.b, strict=True))


def test_a_share_keeps_all_genuine_ones_and_grows_without_changing() -> None:
    few, more = all_pairs(CAPTURES, 0.2, 7), all_pairs(CAPTURES, 0.5, 7)
    named = [set(zip(one.a.tolist(), one.b.tolist(), strict=True)) for one in (few, more)]
    assert named[0] < named[1]
    assert few.genuine.sum() == 3 * 14
    assert 0.13 < (~few.genuine).sum() / (3 * 14 * 13) < 0.27
    of_fingers = Counter(
        frozenset((CAPTURES[a].finger, CAPTURES[b].finger))
        for a, b, same in zip(few.a.tolist(), few.b.tolist(), few.genuine.tolist(), strict=True)
        if not same
    )
    assert set(of_fingers.values()) == {2 * 3}  # both ways round in all three pairs of sessions
    other = all_pairs(CAPTURES, 0.2, 8)
    assert set(zip(other.a.tolist(), other.b.tolist(), strict=True)) != named[0]


def test_draws_are_even() -> None:
    drawn = [draw(f"a{k}", "b", 1) for k in range(2000)]
    assert abs(np.mean(drawn) - 0.5) < 0.03
    assert 0 <= min(drawn) < 0.01
    assert 0.99 < max(drawn) < 1


def test_blocks_hold_every_comparison_once_and_stay_small() -> None:
    pairs, blocks = all_pairs(CAPTURES, 1.0, 0), Blocks(5, 4)
    found = blocks_of(pairs, CAPTURES, blocks)
    named = Counter((a, b) for one in found for a, b in zip(one.pairs.a.tolist(), one.pairs.b.tolist(), strict=True))
    assert named == Counter(zip(pairs.a.tolist(), pairs.b.tolist(), strict=True))
    for one in found:
        assert len(set(one.pairs.a.tolist())) <= 5
        assert len(set(one.pairs.b.tolist())) <= 4
    assert len({one.number for one in found}) == len(found)


def test_blocks_do_not_depend_on_what_is_done() -> None:
    pairs = all_pairs(CAPTURES, 1.0, 0)
    found = blocks_of(pairs, CAPTURES, Blocks(5, 4))
    gone = found[3].pairs
    rest = missing_pairs(pairs, len(CAPTURES), gone.a * len(CAPTURES) + gone.b)
    again = {one.number: one.pairs for one in blocks_of(rest, CAPTURES, Blocks(5, 4))}
    assert sorted(again) == sorted(one.number for k, one in enumerate(found) if k != 3)
    for k, one in enumerate(found):
        if k != 3:
            np.testing.assert_array_equal(again[one.number].a, one.pairs.a)
            np.testing.assert_array_equal(again[one.number].b, one.pairs.b)
    assert (
        blocks_of(missing_pairs(pairs, len(CAPTURES), pairs.a * len(CAPTURES) + pairs.b), CAPTURES, Blocks(5, 4)) == []
    )
