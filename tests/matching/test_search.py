"""Search among many: the index of codes, and identification in stages."""

from __future__ import annotations

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.matching.code import ProbeSettings, code_of, code_size, probe_codes
from splitknit.matching.minutiae_record import no_minutiae
from splitknit.matching.ridge import Prepared, ridge_match
from splitknit.matching.search import PRESSED_MM, CodeIndex, SearchSettings, identify
from splitknit.matching.template import _failed_template, with_minutiae


def noise_codes(count: int, seed: int = 0) -> np.ndarray:
    """Codes of nobody."""
    return np.random.default_rng(seed).integers(-60, 61, (count, code_size())).astype(np.int8)


def test_search_is_the_best_product_over_all_variants(templates) -> None:
    codes = noise_codes(3000)
    codes[1234] = code_of(templates[1])
    index = CodeIndex([f"f{n}" for n in range(3000)], codes)
    ids, scores = index.search(templates[0], 20)
    expected = (codes.astype(np.float64) @ probe_codes(templates[0]).T.astype(np.float64)).max(axis=1)
    order = np.argsort(-expected)[:20]
    assert ids == [f"f{n}" for n in order]
    assert ids[0] == "f1234"
    assert scores.tolist() == expected[order].tolist(), "single precision holds these sums without rounding"


def test_adding_and_removing_in_any_order_gives_one_answer(templates) -> None:
    codes = noise_codes(700)
    names = [f"f{n:03d}" for n in range(700)]
    plain = CodeIndex(names[:500], codes[:500])
    other = CodeIndex()
    for n in np.random.default_rng(1).permutation(700).tolist():
        other.add(names[n], codes[n])
    for n in range(500, 700):
        other.remove(names[n])
    assert len(other) == len(plain) == 500
    assert set(other.ids) == set(names[:500])
    assert "f600" not in other
    assert "f100" in other
    for k in (1, 7, 500, 900):
        found, expected = other.search(templates[0], k), plain.search(templates[0], k)
        assert found[0] == expected[0]
        assert found[1].tolist() == expected[1].tolist()
    assert other.nbytes <= 2 * 700 * code_size()


def test_equal_codes_come_in_the_order_of_their_ids(templates) -> None:
    codes = np.repeat(code_of(templates[0])[None], 4, axis=0)
    index = CodeIndex(["d", "b", "a", "c"], codes)
    assert index.search(templates[0], 3)[0] == ["a", "b", "c"]


def test_a_removed_code_is_gone() -> None:
    index = CodeIndex(["a", "b", "c"], noise_codes(3))
    index.remove("a")
    index.remove("c")
    assert index.ids == ("b",)
    assert (index.codes[0] == noise_codes(3)[1]).all()
    assert not index._codes[1:].any()
    with pytest.raises(ValueError, match="read-only"):
        index.codes[0, 0] = 1


def test_an_index_refuses_what_it_cannot_hold() -> None:
    index = CodeIndex(["a"], noise_codes(1))
    with pytest.raises(BadInput, match="already"):
        index.add("a", noise_codes(1)[0])
    with pytest.raises(BadInput, match="already"):
        index.add_many(["b", "b"], noise_codes(2))
    with pytest.raises(BadInput, match="int8"):
        index.add("b", noise_codes(1)[0].astype(np.float32))
    with pytest.raises(BadInput, match="shape"):
        index.add("b", noise_codes(1)[0, :-1])
    with pytest.raises(BadInput, match="no 'b'"):
        index.remove("b")
    assert index.ids == ("a",)
    with pytest.raises(BadInput, match="already"):
        index.add_many(["c", "a"], noise_codes(2))
    assert len(index) == 1


def gallery_of(impressions, templates) -> dict[str, object]:
    """First impression of each finger."""
    return {f"finger {i.finger}": t for i, t in reversed(list(zip(impressions, templates, strict=True)))}


def test_identify_finds_the_finger_among_strangers_without_their_templates(impressions, templates) -> None:
    gallery = gallery_of(impressions, templates)
    index = CodeIndex(gallery, np.stack([code_of(template) for template in gallery.values()]))
    index.add_many([f"stranger {n}" for n in range(2000)], noise_codes(2000))
    asked = []

    def fetch(identity: str):
        asked.append(identity)
        return gallery.get(identity, _failed_template())

    for impression, template in list(zip(impressions, templates, strict=True))[1::3]:
        asked.clear()
        found = identify(template, fetch, index, 20, settings=SearchSettings(finalists=2))
        assert len(asked) == 20
        assert len(found) == 2
        assert found[0].id == f"finger {impression.finger}"
        assert found[0].similarity == ridge_match(template, gallery[found[0].id]).similarity
        assert found[0].similarity > 0.6 > found[1].similarity
        assert found[0].code_similarity > found[1].code_similarity


def test_exhaustive_search_needs_no_codes(impressions, templates) -> None:
    gallery = gallery_of(impressions, templates)
    index = CodeIndex(gallery, noise_codes(len(gallery)))  # codes that say nothing
    found = identify(Prepared(templates[1]).template, gallery, index, len(gallery))
    assert found[0].id == "finger 0"
    assert len(found) == len(gallery)
    assert np.isnan([candidate.code_similarity for candidate in found]).all()
    assert found == sorted(found, key=lambda candidate: -candidate.similarity)


def test_nobody_is_found_by_nothing_or_in_nothing(templates) -> None:
    assert identify(_failed_template(), {}, CodeIndex(["a"], noise_codes(1))) == []
    assert identify(templates[0], {}, CodeIndex()) == []
    assert CodeIndex().search(templates[0], 5)[0] == []
    with pytest.raises(BadInput, match="at least 1"):
        identify(templates[0], {}, CodeIndex(["a"], noise_codes(1)), 0)
    with pytest.raises(BadInput, match="at least 1"):
        SearchSettings(finalists=0)


def test_prints_are_searched_with_wider_shifts(templates) -> None:
    settings, surface = SearchSettings(), templates[0]
    pressed = with_minutiae(surface, surface.valid, no_minutiae(surface.valid.shape))
    assert settings.variants_of(surface) is settings.probe
    assert settings.variants_of(pressed).right_mm == settings.variants_of(pressed).down_mm == PRESSED_MM
    wider = SearchSettings(probe=ProbeSettings(down_mm=3.0))
    assert wider.variants_of(pressed).down_mm == 3.0
