"""Search among many by codes."""

from __future__ import annotations

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit_match.matching.code import ProbeSettings, code_of, code_size, probe_codes
from splitknit_match.matching.minutiae_record import no_minutiae
from splitknit_match.matching.search import PRESSED_MM, SearchSettings, nearest_codes
from splitknit_match.matching.template import with_minutiae


def noise_codes(count: int, seed: int = 0) -> np.ndarray:
    """Codes of nobody."""
    return np.random.default_rng(seed).integers(-60, 61, (count, code_size())).astype(np.int8)


def test_search_is_the_best_product_over_all_variants(templates) -> None:
    codes = noise_codes(3000)
    codes[1234] = code_of(templates[1])
    variants = probe_codes(templates[0])
    places, scores = nearest_codes(codes, variants, 20)
    expected = (codes.astype(np.float64) @ variants.T.astype(np.float64)).max(axis=1)
    assert places == np.argsort(-expected)[:20].tolist() and places[0] == 1234
    assert scores.tolist() == expected[places].tolist(), "single precision holds these sums without rounding"


def test_equal_codes_come_in_their_order(templates) -> None:
    codes, variants = np.repeat(code_of(templates[0])[None], 4, axis=0), probe_codes(templates[0])
    assert nearest_codes(codes, variants, 3)[0] == [0, 1, 2]
    assert nearest_codes(codes[:0], variants, 3)[0] == []
    with pytest.raises(BadInput, match="at least 1"):
        nearest_codes(codes, variants, 0)


def test_prints_are_searched_with_wider_shifts(templates) -> None:
    settings, surface = SearchSettings(), templates[0]
    pressed = with_minutiae(surface, surface.valid, no_minutiae(surface.valid.shape))
    assert settings.variants_of(surface) is settings.probe
    assert settings.variants_of(pressed).right_mm == settings.variants_of(pressed).down_mm == PRESSED_MM
    wider = SearchSettings(probe=ProbeSettings(down_mm=3.0))
    assert wider.variants_of(pressed).down_mm == 3.0
