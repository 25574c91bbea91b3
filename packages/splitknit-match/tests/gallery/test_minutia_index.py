"""The index of minutiae: it finds what comparing all by minutiae finds, in whatever steps it was
made."""

from pathlib import Path

import numpy as np
import pytest

import splitknit_match
from refusals import bad_input
from splitknit_match.gallery.file import Entry, NewCapture
from splitknit_match.gallery.identify import TEMPLATES_HASH
from splitknit_match.gallery.minutia_index import MinutiaIndex, kept_minutiae
from splitknit_match.matching.fusion import fused_match
from splitknit_match.matching.inputs import held
from splitknit_match.matching.minutia_pairs import pair_minutiae
from splitknit_match.matching.ridge import Prepared
from splitknit_match.matching.template import Template, pack, print_size, unpack
from splitknit_match.records.minutiae_record import Minutiae

from test_open_gallery import PPI, press  # isort: skip

CAPTURES = 300


def seen(seed, turned=0.0, shift=(0.0, 0.0), again=None):
    """Template of random minutiae; of another press of the same finger, turned and shifted by
    pixels of 500 ppi."""
    rng = np.random.default_rng(seed)
    valid = np.ones((170, 170), dtype=bool)
    size = print_size(Template(np.zeros(valid.shape, np.uint8), valid, 0.1))
    place = rng.uniform(-150, 150, (40, 2)) @ np.array([1, 1j])
    turn = rng.uniform(0, 2 * np.pi, 40)
    if again is not None:
        rng = np.random.default_rng(again)
        kept = rng.random(40) > 0.25
        place, turn = (
            place[kept] + rng.normal(0, 2, (kept.sum(), 2)) @ np.array([1, 1j]),
            turn[kept],
        )
        place, turn = (
            place * np.exp(1j * turned) + complex(*shift),
            turn - turned + rng.normal(0, 0.1, kept.sum()),
        )
    x, y = (
        np.rint(place.real + size[1] / 2).astype(np.int32),
        np.rint(place.imag + size[0] / 2).astype(np.int32),
    )
    inside = (x >= 0) & (x < size[1]) & (y >= 0) & (y < size[0])
    kinds = np.zeros(inside.sum(), np.uint8)
    minutiae = Minutiae(
        x[inside], y[inside], turn[inside] % (2 * np.pi), kinds, kinds + np.uint8(80), size
    )
    return pack(Template(np.zeros(valid.shape, np.uint8), valid, 0.1, minutiae))


def cylinders(payload):
    return Prepared(unpack(payload)).cylinders


@pytest.fixture(scope="module")
def gallery():
    return {10 * k: seen(k) for k in range(CAPTURES)}


def test_it_finds_what_comparing_all_finds(gallery):
    index = MinutiaIndex(gallery, Path("g.skg"), {})
    assert len(index) == CAPTURES and not index.others
    for k in range(0, CAPTURES, 25):
        probe = cylinders(seen(k, 0.3 * k, (12.0, -9.0), again=k + 1))
        assert index.nearest(probe, 5)[0] == 10 * k
    # the reference, which compares with each
    probe = cylinders(seen(7, 1.0, (5.0, 5.0), again=1))
    support = {
        row: max(
            (pair.support for pair in pair_minutiae(probe, cylinders(gallery[row]))), default=0.0
        )
        for row in list(gallery)[:60]
    }
    assert max(support, key=support.__getitem__) == index.nearest(probe, 1)[0] == 70


@pytest.mark.slow
def test_steps_make_no_difference(gallery):
    rows = list(gallery)
    first = {}
    MinutiaIndex({row: gallery[row] for row in rows[:200]}, Path("g.skg"), first)
    changed = {row: gallery[row] for row in rows[50:]} | {rows[60]: seen(5000), 9999: b""}
    same = set(rows[50:200]) - {rows[60]}
    known = {row: minutiae for row, minutiae in first.items() if row in same}
    stepwise = MinutiaIndex(changed, Path("g.skg"), known)
    whole = MinutiaIndex(changed, Path("g.skg"), {})
    assert set(stepwise.rows.tolist()) == set(whole.rows.tolist()) == set(rows[50:])
    for k in (20, 60, 130, 250):
        probe = cylinders(seen(k, 0.5, again=3))
        assert stepwise.nearest(probe, 20) == whole.nearest(probe, 20)
    assert stepwise.nearest(cylinders(seen(5000, 2.0, again=8)), 1) == [rows[60]]


def test_damaged_minutiae_are_found_anew_or_harm_nothing(gallery):
    some = {row: gallery[row] for row in list(gallery)[:20]}
    whole = {}
    MinutiaIndex(some, Path("g.skg"), whole)
    entry = whole[30]
    known = whole | {10: b"", 20: b"\x02" + entry[1:], 30: entry[:-1]}
    MinutiaIndex(some, Path("g.skg"), known)
    assert known == whole
    known[30] = entry[:1] + b"\xff" * (len(entry) - 1)
    probe = cylinders(seen(7, 0.5, again=3))
    assert MinutiaIndex(some, Path("g.skg"), known).nearest(probe, 1) == [70]


def test_nothing_remains_of_the_minutiae_of_a_removed_finger(gallery, tmp_path):
    file = tmp_path / "g.skg"
    with splitknit_match.Gallery(file) as opened:
        captures = (
            NewCapture(Entry(person, "right_index", "1", "template", ""), gallery[row])
            for person, row in (("Ann", 10), ("Bob", 20))
        )
        opened.add(captures, TEMPLATES_HASH)
        minutiae = [kept_minutiae(unpack(gallery[row])) for row in (10, 20)]
        before = file.read_bytes()
        assert all(each[-200:] in before for each in minutiae)
        opened.remove("Ann")
    left = file.read_bytes()
    gone = minutiae[0]
    assert not any(gone[part : part + 16] in left for part in range(1, len(gone) - 16))
    assert minutiae[1][-200:] in left


def test_a_prepared_template_is_compared_as_the_template(gallery):
    a, b = gallery[10], gallery[20]
    ready = splitknit_match.prepare(a)
    prepared, plain = splitknit_match.match(ready, b), splitknit_match.match(a, b)
    assert (prepared.similarity, prepared.answer) == (plain.similarity, plain.answer)
    with bad_input("must be bytes"):
        splitknit_match.prepare("a.skt")


def test_few_minutiae_are_compared_always(gallery):
    bare = unpack(gallery[0])
    index = MinutiaIndex(
        {1: pack(Template(bare.level, bare.valid, 0.1)), 2: gallery[10]}, Path("g.skg"), {}
    )
    assert index.others == [1] and index.rows.tolist() == [2]
    empty = MinutiaIndex({}, Path("g.skg"), {})
    assert len(empty) == 0 and empty.nearest(cylinders(gallery[0]), 5) == []


def test_of_many_those_are_compared_whose_minutiae_agree_best(gallery, tmp_path, monkeypatch):
    """The exhaustive search, the reference, finds the same who is there."""
    monkeypatch.setattr("splitknit_match.gallery.identify.ALL_PRINTS", 1)
    with splitknit_match.Gallery(tmp_path / "g.skg") as opened:
        captures = (
            NewCapture(Entry(f"P{k}", "right_index", "1", "template", ""), gallery[10 * k])
            for k in range(20)
        )
        opened.add(captures, TEMPLATES_HASH)
        absent = opened.identify(seen(4000), top=2, fmr=1e-4)
        assert absent.searched.compared == 2
        assert "misses about 1 match in 100" in str(absent.findings[0])
        nearest = opened.identify(seen(7, 0.4, again=2), top=2)
        monkeypatch.setattr("splitknit_match.gallery.identify.ALL_PRINTS", 20)
        exhaustive = opened.identify(seen(7, 0.4, again=2), top=2)
    assert (nearest.searched.compared, exhaustive.searched.compared) == (2, 20)
    assert nearest.candidates[0].person == exhaustive.candidates[0].person == "P7"
    assert absent.candidates[0].similarity < nearest.candidates[0].similarity - 2
    assert nearest.candidates[0].similarity == exhaustive.candidates[0].similarity


def test_a_searched_gallery_that_is_changed_is_searched_again(gallery, tmp_path, monkeypatch):
    """Also beside a failure to acquire, of which there are no minutiae."""
    monkeypatch.setattr("splitknit_match.gallery.identify.ALL_PRINTS", 1)

    def new(k, template):
        return NewCapture(Entry(f"P{k}", "right_index", "1", "template", ""), template)

    with splitknit_match.Gallery(tmp_path / "g.skg") as opened:
        opened.add([new(k, gallery[10 * k]) for k in range(5)] + [new(5, b"")], TEMPLATES_HASH)
        probe = seen(3, 0.4, again=2)
        first = opened.identify(probe, top=1)
        opened.add([new(6, gallery[60])], TEMPLATES_HASH)
        second = opened.identify(probe, top=1)
        assert first.candidates[0].person == second.candidates[0].person == "P3"
        assert (second.searched.captures, second.searched.failures) == (6, 1)
        assert opened.identify(seen(6, again=4), top=1).candidates[0].person == "P6"


def test_where_minutiae_are_sure_ridges_propose_nothing(monkeypatch):
    sides = [
        unpack(held(splitknit_match.make_template(press(1, *how), resolution_ppi=PPI).payload))
        for how in ((), (9, 12.0))
    ]
    expected = fused_match(*sides).similarity
    monkeypatch.setattr("splitknit_match.matching.fusion.likely_alignments", None)
    assert fused_match(*sides).similarity == expected
    monkeypatch.setattr("splitknit_match.matching.fusion.SURE", 1000.0)
    with pytest.raises(TypeError):
        fused_match(*sides)
    assert fused_match(*sides, quick=True).similarity == expected  # as a search does
