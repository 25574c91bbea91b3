"""Quality of a print: every figure on waves that are known, and the score."""

from dataclasses import asdict, replace

import numpy as np
import pytest

from splitknit.finger.ridges import ink
from splitknit_match.prints.print_quality import QualityFigures, print_quality, score_of
from splitknit_match.prints.ridge_field import ridge_field

PX_PER_MM = 500 / 25.4
ROWS, COLUMNS = 520, 360
GOOD = QualityFigures(0.8, 45.0, 0.95, 0.95, 0.5, 0.1, 280.0, 350.0, 19.0, 0.03, 1.2)


def waves(height_um=50.0, second=0.0, period_mm=0.5):
    """Horizontal ridges; `second` is the second harmonic, a fraction of the first."""
    phase = 2 * np.pi * np.arange(ROWS) / (period_mm * PX_PER_MM)
    line = 0.5 * height_um * (np.cos(phase) + second * np.cos(2 * phase + 0.4))
    return np.repeat(line[:, None], COLUMNS, axis=1).astype(np.float32)


def figures(values, weight=None, *, in_um=True):
    weight = np.ones(values.shape, np.float32) if weight is None else weight
    return print_quality(values, weight, ridge_field(ink(values, weight)), in_um=in_um).figures


def test_figures_are_those_of_the_waves():
    quality = figures(waves(40.0))
    assert quality.ridge_height_um == pytest.approx(40.0, rel=0.06)
    assert quality.period_mm == pytest.approx(0.5, rel=0.02)
    assert quality.ridge_share > 0.97
    area = ROWS * COLUMNS / PX_PER_MM**2
    assert quality.ridge_area_mm2 == pytest.approx(area, rel=0.05)
    assert quality.finger_area_mm2 == pytest.approx(area, rel=0.05)
    assert quality.ridge_length_mm == pytest.approx(ROWS / PX_PER_MM, rel=0.03)
    assert quality.coherence > 0.95
    assert quality.plausible_share > 0.98
    assert quality.gap_share < 0.02
    assert quality.centre_offset_mm < 0.2


def test_without_micrometres_there_is_no_height():
    dim = figures(1e-3 * waves(40.0), in_um=False)
    assert dim.ridge_height_um is None
    assert dim.ridge_share > 0.97
    assert figures(1e-3 * waves(40.0)).ridge_share == 0.0  # 0.04 um


def test_sharpness_is_the_second_harmonic_and_blind_to_noise():
    assert figures(waves(second=0.2)).sharpness == pytest.approx(0.2, abs=0.03)
    assert figures(waves()).sharpness < 0.02
    noisy = waves() + np.random.default_rng(5).normal(0, 15, (ROWS, COLUMNS)).astype(np.float32)
    assert figures(noisy).sharpness < 0.03


def without(*blank):
    """Of waves with a blank part."""
    values = waves()
    values[blank] = 0.0
    return figures(values)


def test_a_blank_half_is_no_ridge_area():
    quality = without(np.s_[:], np.s_[COLUMNS // 2 :])
    assert quality.ridge_share == pytest.approx(0.5, abs=0.06)
    assert quality.centre_offset_mm == pytest.approx(0.25 * COLUMNS / PX_PER_MM, abs=0.5)
    quality = without(np.s_[ROWS // 2 :])
    assert quality.ridge_length_mm == pytest.approx(0.5 * ROWS / PX_PER_MM, abs=1.0)


def test_an_outline_without_ridges_is_no_gap():
    inside = without(np.s_[200:280], np.s_[120:200])  # 4 mm wide, ridges around
    outline = without(np.s_[:], np.s_[:30])
    assert inside.gap_share > 0.02 + outline.gap_share
    assert outline.gap_share < 0.01


def test_values_beside_the_finger_do_not_count():
    weight = np.zeros((ROWS, COLUMNS), np.float32)
    weight[100:400, 60:300] = 1.0
    quality = figures(np.where(weight > 0, waves(), np.float32(1e6)), weight)
    assert quality.finger_area_mm2 == pytest.approx(300 * 240 / PX_PER_MM**2, rel=0.06)
    assert quality.ridge_height_um == pytest.approx(50.0, rel=0.1)
    assert quality.ridge_length_mm == pytest.approx(300 / PX_PER_MM, abs=0.9)


def test_the_score_is_a_product_of_powers():
    best = QualityFigures(1.0, 100.0, 1.0, 1.0, 0.5, 0.3, 600.0, 600.0, 30.0, 0.0, 0.0)
    assert score_of(best)[0] == pytest.approx(100.0)
    score, worth = score_of(replace(best, ridge_share=0.6, coherence=0.6))
    assert score == pytest.approx(100 * 0.5**0.3 * 0.2**0.15)
    assert worth["ridge_share"] == pytest.approx(0.5)
    assert score_of(replace(GOOD, ridge_area_mm2=0.0))[0] == 0.0


def test_an_unknown_figure_does_not_lower_the_score():
    score, worth = score_of(replace(GOOD, ridge_height_um=None))
    assert "ridge_height_um" not in worth
    assert score == pytest.approx(score_of(replace(GOOD, ridge_height_um=1000.0))[0])


def test_without_waves_the_score_is_zero():
    weight = np.ones((ROWS, COLUMNS), np.float32)
    field = ridge_field(ink(waves(), weight))
    quality = print_quality(waves(), weight, replace(field, mask=np.zeros_like(field.mask)))
    assert quality.score == 0.0
    assert all(map(np.isfinite, asdict(quality.figures).values()))
