"""Which captures are compared: all of them, or a fraction that grows without changing, in
blocks."""

from collections import Counter

from splitknit_match.batch.population import CaptureRef, all_pairs, blocks_of

CAPTURES = [
    CaptureRef(f"S{s:02d}/session_{k}/{f}", f"S{s:02d}", f"S{s:02d}/{f}", str(k), n)
    for n, (s, f) in enumerate((s, f) for s in range(1, 8) for f in ("right_index", "left_thumb"))
    for k in (1, 2, 3)
]


def test_all_fingers_of_all_pairs_of_sessions():
    pairs = all_pairs(CAPTURES, 1.0, 0)
    assert pairs.a.size == 3 * 14 * 14
    assert pairs.genuine.sum() == 3 * 14
    assert all(
        CAPTURES[a].session < CAPTURES[b].session for a, b in zip(pairs.a, pairs.b, strict=True)
    )


def test_a_share_keeps_all_genuine_ones_and_grows_without_changing():
    few, more = all_pairs(CAPTURES, 0.2, 7), all_pairs(CAPTURES, 0.5, 7)
    named = [set(zip(pairs.a.tolist(), pairs.b.tolist(), strict=True)) for pairs in (few, more)]
    assert named[0] < named[1]
    assert few.genuine.sum() == 3 * 14
    assert 0.13 < (~few.genuine).sum() / (3 * 14 * 13) < 0.27
    of_fingers = Counter(
        frozenset((CAPTURES[a].finger, CAPTURES[b].finger))
        for a, b, same in zip(few.a.tolist(), few.b.tolist(), few.genuine.tolist(), strict=True)
        if not same
    )
    assert set(of_fingers.values()) == {2 * 3}  # both ways round in all three pairs of sessions
    reseeded = all_pairs(CAPTURES, 0.2, 8)
    assert set(zip(reseeded.a.tolist(), reseeded.b.tolist(), strict=True)) != named[0]


def test_blocks_hold_every_comparison_once_and_stay_small(monkeypatch):
    monkeypatch.setattr("splitknit_match.batch.population.PAIRS", 50)
    pairs = all_pairs(CAPTURES, 1.0, 0)
    blocks = blocks_of(pairs, CAPTURES, 5)
    held = Counter(
        pair for block in blocks for pair in zip(block.a.tolist(), block.b.tolist(), strict=True)
    )
    assert held == Counter(zip(pairs.a.tolist(), pairs.b.tolist(), strict=True))
    for block in blocks:
        assert len(set(block.a.tolist())) <= 5 and block.a.size <= 50
        assert len({CAPTURES[a].session for a in block.a.tolist()}) == 1
        assert block.b.tolist() == sorted(block.b.tolist())  # one query after the other
