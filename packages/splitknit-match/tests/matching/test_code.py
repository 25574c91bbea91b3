"""Codes of fixed length: what they do not depend on, what they tell apart, and the model behind them."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit_match.matching.code import (
    CELLS,
    CHANNELS,
    COLUMNS,
    ROWS,
    SCALE,
    FactorModel,
    ProbeSettings,
    code_field,
    code_model,
    code_of,
    code_size,
    laid_on,
    origin_of,
    probe_codes,
    sampled,
)
from splitknit_match.matching.ridge_band import RidgeBand
from splitknit_match.matching.template import Template, failed_template, make_template


def straight(period_mm: float, direction_deg: float, shape: tuple[int, int] = (220, 200)) -> Template:
    """Straight ridges; the direction across them counter-clockwise from x."""
    rows, columns = np.mgrid[: shape[0], : shape[1]].astype(np.float64)
    angle = np.deg2rad(direction_deg)
    value = np.sin(2 * np.pi * 0.1 / period_mm * (np.cos(angle) * columns - np.sin(angle) * rows))
    everywhere = np.ones(shape, dtype=np.bool_)
    empty = np.zeros(shape, dtype=np.float32)
    return make_template(RidgeBand((1.4 * value).astype(np.float32), everywhere, empty, empty, 0.1))


def moved(template: Template, turn_deg: float, right_mm: float, down_mm: float) -> Template:
    """The content turned counter-clockwise about a point 10 mm below the origin, and shifted; cut as it then is."""
    origin = np.add(origin_of(template), (0.0, 100.0))
    matrix = cv2.getRotationMatrix2D((float(origin[0]), float(origin[1])), turn_deg, 1.0)
    matrix[:, 2] += [10 * right_mm + 30, 10 * down_mm + 30]
    size = template.valid.shape[1] + 60, template.valid.shape[0] + 60
    value = cv2.warpAffine(template.value(), matrix, size)
    valid = cv2.warpAffine(template.valid.astype(np.float32), matrix, size) > 0.9
    empty = np.zeros(valid.shape, dtype=np.float32)
    return make_template(RidgeBand(np.where(valid, value, 0.0).astype(np.float32), valid, empty, empty, 0.1))


@pytest.mark.parametrize("direction_deg", [-60.0, 0.0, 25.0, 70.0])
def test_field_knows_direction_and_frequency(direction_deg: float) -> None:
    field = code_field(straight(0.5, direction_deg))
    still = np.zeros(1)
    channels, weights = sampled(field, still, still, still + 2.0)
    inner = weights[0] > 0.95
    assert channels.shape == (1, CHANNELS, CELLS)
    assert inner.sum() > 0.5 * CELLS
    angle = np.deg2rad(2 * direction_deg)
    assert np.allclose(channels[0, 0, inner], np.cos(angle), atol=0.06)
    assert np.allclose(channels[0, 1, inner], np.sin(angle), atol=0.06)
    assert np.median(channels[0, 2, inner]) == pytest.approx(np.log(2 * np.pi * 0.1 / 0.5), abs=0.05)


def test_wider_ridges_have_lower_frequency() -> None:
    found = [np.median(code_field(straight(period, 20.0)).maps[2]) for period in (0.38, 0.42, 0.46, 0.5, 0.6)]
    assert (np.diff(found) < -0.03).all()


def test_variant_undoes_a_turn_and_a_shift(templates) -> None:
    template, still = templates[0], np.zeros(1)
    other = moved(template, 7.0, 0.6, -0.4)
    shown, seen = sampled(code_field(template), np.deg2rad([7.0]), still, still)
    wrong, _ = sampled(code_field(template), np.deg2rad([-7.0]), still, still)
    # the origin follows the outline, which turns too: the shift is looked for
    steps = np.arange(-2.0, 2.1, 0.25)
    right, down = (part.ravel() for part in np.meshgrid(steps, steps))
    here, weights = sampled(code_field(other), np.zeros(right.size), right, down)
    both = np.minimum(weights, seen)

    def apart(reference: np.ndarray) -> float:
        squares = ((here[:, :2] - reference[:, :2]) ** 2).sum(axis=1)
        return float(((squares * both).sum(axis=1) / both.sum(axis=1)).min())

    assert apart(shown) < 0.01
    assert apart(wrong) > 3 * apart(shown)


def test_laid_on_agrees_with_sampled() -> None:
    template = straight(0.45, 10.0)
    variant = np.deg2rad(8.0), 1.0, -2.0
    matrix = laid_on(template, template, *variant)
    field = code_field(template)
    rows, columns = np.mgrid[: field.maps.shape[1], : field.maps.shape[2]].astype(np.float32)
    cells = np.arange(CELLS).reshape(ROWS, COLUMNS)[3:12, 3:14].ravel()
    places = np.stack([cells % COLUMNS - COLUMNS // 2, cells // COLUMNS + 1], axis=1) * 10.0 + origin_of(template)
    # by the matrix, what lies in a cell comes from here
    source = np.linalg.solve(matrix[:, :2], (places - matrix[:, 2]).T).T
    for axis, ramp in enumerate((columns, rows)):
        maps = field.maps.copy()
        maps[2] = ramp
        shown, _ = sampled(replace(field, maps=maps), *(np.array([value]) for value in variant))
        assert np.allclose((shown[0, 2, cells] + 0.5) * 2 - 0.5, source[:, axis], atol=0.1)


def test_codes_tell_fingers_apart(impressions, templates) -> None:
    codes = [code_of(template).astype(np.float32) for template in templates]
    genuine, impostor = [], []
    for i, template in enumerate(templates):
        variants = probe_codes(template)
        for j, code in enumerate(codes):
            if i != j:
                same = impressions[i].finger == impressions[j].finger
                (genuine if same else impostor).append(float((variants @ code).max()))
    assert np.median(genuine) > 0.75
    assert np.median(impostor) < 0.5
    assert np.median(genuine) - np.median(impostor) > 0.4


def test_a_code_is_a_direction_of_bytes(templates) -> None:
    code = code_of(templates[0])
    assert code.dtype == np.int8
    assert code.shape == (code_size(),)
    assert np.linalg.norm(code.astype(float)) == pytest.approx(SCALE, rel=0.01)
    assert (code_of(templates[0]) == code).all()
    own = probe_codes(templates[0], ProbeSettings(0, 0, 0))
    assert own.shape == (1, code_size())
    assert float(own[0] @ code.astype(np.float32)) == pytest.approx(1.0, abs=0.01)


def test_failures_to_acquire() -> None:
    assert not code_of(failed_template()).any()
    with pytest.raises(BadInput, match="failure to acquire"):
        probe_codes(failed_template())
    with pytest.raises(BadInput, match="failure to acquire"):
        code_field(failed_template())


@pytest.mark.parametrize("wrong", [{"turn_deg": -1.0}, {"right_mm": float("nan")}, {"right_mm": 1e4}])
def test_settings_are_checked(wrong: dict[str, float]) -> None:
    with pytest.raises(BadInput):
        ProbeSettings(**wrong)


def test_variants_hold_the_plain_one() -> None:
    turns, right, down = ProbeSettings().variants()
    assert len(turns) == ProbeSettings().count
    assert ((turns == 0) & (right == 0) & (down == 0)).sum() == 1


def test_shipped_model_fits_the_grid() -> None:
    model = code_model()
    assert model.mean.shape == (CHANNELS, CELLS)
    assert ROWS * COLUMNS == CELLS
    assert model.size == code_size()


def test_posterior_finds_the_latent_numbers_from_a_part() -> None:
    rng = np.random.default_rng(1)
    loading = rng.standard_normal((2, 30, 3)).astype(np.float32)
    z = rng.standard_normal((5, 3)).astype(np.float32)
    model = FactorModel(np.full((2, 30), 0.5, np.float32), loading, np.full((2, 30), 0.01, np.float32))
    fields = (0.5 + np.einsum("cmk,nk->ncm", loading, z)).astype(np.float32)
    weights = np.ones((5, 30), dtype=np.float32)
    weights[:, :15] = 0
    fields[:, :, :15] = 100.0  # unseen: must not matter
    found = model.latent(fields, weights)
    assert np.allclose(found, z, atol=0.02)
    # by hand, for one
    noise = float(np.float32(0.01))
    half = loading[:, 15:].reshape(-1, 3).astype(float)
    seen = (fields[0, :, 15:] - 0.5).ravel()
    by_hand = np.linalg.solve(np.eye(3) + half.T @ half / noise, half.T @ seen / noise)
    assert np.allclose(found[0], by_hand, rtol=1e-6)
    assert np.allclose(model.latent(fields, np.zeros((5, 30), dtype=np.float32)), 0.0)


def test_rounding_of_the_precisions_does_not_reach_a_code() -> None:
    """It differs with the number of threads and the processor."""
    rng, template = np.random.default_rng(2), straight(0.5, 25.0)
    expected = code_of(template), probe_codes(template)
    model = code_model()
    exact = model._upper
    other = [(a, b, band * (1 + 2e-7 * rng.uniform(-1, 1, band.shape)).astype(np.float32)) for a, b, band in exact]
    try:
        model.__dict__["_upper"] = other
        found = code_of(template), probe_codes(template)
    finally:
        model.__dict__["_upper"] = exact
    assert all(one.tobytes() == two.tobytes() for one, two in zip(found, expected, strict=True))


def test_model_is_checked() -> None:
    one = np.ones((2, 3), dtype=np.float32)
    with pytest.raises(BadInput):
        FactorModel(one, np.ones((2, 4, 1), dtype=np.float32), one)
    with pytest.raises(BadInput):
        FactorModel(one, np.ones((2, 3, 1), dtype=np.float32), 0 * one)
