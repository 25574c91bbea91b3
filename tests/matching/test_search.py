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


def test_any_order_gives_one_answer(templates) -> None:
    codes, names = noise_codes(500), [f"f{n:03d}" for n in range(500)]
    order = np.random.default_rng(1).permutation(500)
    plain, other = CodeIndex(names, codes), CodeIndex([names[n] for n in order], codes[order])
    for k in (1, 7, 500, 900):
        found, expected = other.search(templates[0], k), plain.search(templates[0], k)
        assert found[0] == expected[0]
        assert found[1].tolist() == expected[1].tolist()


def test_equal_codes_come_in_the_order_of_their_ids(templates) -> None:
    codes = np.repeat(code_of(templates[0])[None], 4, axis=0)
    index = CodeIndex(["d", "b", "a", "c"], codes)
    assert index.search(templates[0], 3)[0] == ["a", "b", "c"]


def test_an_index_refuses_what_it_cannot_hold() -> None:
    with pytest.raises(BadInput, match="twice"):
        CodeIndex(["b", "b"], noise_codes(2))
    with pytest.raises(BadInput, match="int8"):
        CodeIndex(["b"], noise_codes(1).astype(np.float32))
    with pytest.raises(BadInput, match="shape"):
        CodeIndex(["b"], noise_codes(1)[:, :-1])


def gallery_of(impressions, templates) -> dict[str, object]:
    """First impression of each finger."""
    return {f"finger {i.finger}": t for i, t in reversed(list(zip(impressions, templates, strict=True)))}


def test_identify_finds_the_finger_among_impostors_without_their_templates(impressions, templates) -> None:
    gallery = gallery_of(impressions, templates)
    codes = np.concatenate([[code_of(template) for template in gallery.values()], noise_codes(2000)])
    index = CodeIndex([*gallery, *(f"impostor {n}" for n in range(2000))], codes)
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
    assert identify(templates[0], {}, CodeIndex([], noise_codes(0))) == []
    assert CodeIndex([], noise_codes(0)).search(templates[0], 5)[0] == []
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
