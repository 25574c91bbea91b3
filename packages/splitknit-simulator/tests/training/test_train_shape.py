from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.skin.learned import SHAPE_COUNT
from splitknit_simulator.training.fields import FIELDS, draw_batch, draw_patch, field_scale
from splitknit_simulator.training.shape import (
    CHANNELS,
    OF_NIR,
    SLOPES,
    SYMMETRY,
    TASK,
    WEIGHT,
    ShapeNetSettings,
    _judge_whole,
    _judged,
)

SMALL = ShapeNetSettings(widths=(2, 3), patch_px=16, batch=3, beyond_px=4)


def sample_of(seed: int, shape: tuple[int, int] = (24, 20)) -> np.ndarray:
    rng = np.random.default_rng(seed)
    sample = rng.standard_normal((CHANNELS, *shape)).astype(np.float32)
    sample[WEIGHT] = rng.uniform(0.5, 1.0, shape)
    return sample


def test_an_unturned_patch_is_a_piece_of_a_sample_or_reaches_over_its_edge() -> None:
    sample = sample_of(2, (40, 50))
    rng = np.random.default_rng(0)
    framed = np.pad(sample, ((0, 0), (16, 16), (16, 16)))
    over = 0
    for _ in range(40):
        patch = draw_patch(TASK, [sample], SMALL, rng)
        assert patch.shape == (CHANNELS, 16, 16) and patch[WEIGHT].mean() >= 0.15
        there = np.argwhere(patch[0] != 0)[0]
        row, column = np.argwhere(framed[0] == patch[0, there[0], there[1]])[0] - there
        np.testing.assert_array_equal(patch, framed[:, row : row + 16, column : column + 16])
        assert 12 <= row <= 44 and 12 <= column <= 54  # four pixels over the edge at most
        over += bool((patch[WEIGHT] == 0).any())
    assert 5 < over < 35


def test_a_small_sample_lies_somewhere_in_the_patch() -> None:
    sample = sample_of(3, (9, 30)).astype(np.float16)
    patch = draw_patch(TASK, [sample], SMALL, np.random.default_rng(0))
    assert patch.shape == (CHANNELS, 16, 16) and patch.dtype == np.float32
    rows = (patch[WEIGHT] > 0).any(axis=1)
    assert 5 <= rows.sum() <= 9


def test_samples_without_skin_are_refused() -> None:
    sample = sample_of(4)
    sample[WEIGHT] = 0.0
    with pytest.raises(BadInput, match="enough skin"):
        draw_patch(TASK, [sample], SMALL, np.random.default_rng(0))


def test_without_near_infrared_only_its_fields_are_gone() -> None:
    seen, blind = (draw_batch(TASK, [sample_of(5)], replace(SMALL, no_nir_share=part), 0) for part in (0.0, 0.9999))
    assert (blind[:, list(OF_NIR)] == 0).all() and seen[:, list(OF_NIR)].any(axis=(2, 3)).all()
    others = [number for number in range(CHANNELS) if number not in OF_NIR]
    np.testing.assert_array_equal(blind[:, others], seen[:, others])


def test_a_fraction_of_the_patches_is_shown_without_near_infrared() -> None:
    settings = replace(SMALL, batch=400)
    batch = draw_batch(TASK, [sample_of(6)], settings, 0)
    blind = sum(bool((patch[list(OF_NIR)] == 0).all()) for patch in batch)
    assert 40 <= blind <= 80  # 15 %
    assert (
        not (draw_batch(TASK, [sample_of(6)], replace(settings, no_nir_share=0.0), 0)[:, 30] == 0)
        .all(axis=(1, 2))
        .any()
    )


def test_batches_follow_from_seed_and_number_and_turn_all_ways() -> None:
    samples = [sample_of(5), sample_of(6)]
    batch = draw_batch(TASK, samples, SMALL, 7)
    assert batch.shape == (3, CHANNELS, 16, 16) and batch.dtype == np.float32
    np.testing.assert_array_equal(batch, draw_batch(TASK, samples, SMALL, 7))
    assert not np.array_equal(batch, draw_batch(TASK, samples, SMALL, 8))
    assert not np.array_equal(batch, draw_batch(TASK, samples, replace(SMALL, seed=1), 7))
    marked = np.zeros((CHANNELS, 16, 16), dtype=np.float32)
    marked[WEIGHT], marked[0], marked[22] = 1.0, 1.0, np.arange(256).reshape(16, 16)
    settings = replace(SMALL, batch=64, beyond_px=0)
    corners = {(patch[22, 0, 0], patch[22, 0, -1]) for patch in draw_batch(TASK, [marked], settings, 0)}
    assert len(corners) == 8
    for way in range(8):
        assert not np.array_equal(SYMMETRY.oriented(marked, way), SYMMETRY.oriented(marked, (way + 1) % 8))


def test_fields_are_scaled_by_what_they_vary() -> None:
    sample = sample_of(7, (60, 60))
    sample[5] *= 10
    sample[31] = 3.0  # constant: not amplified
    scale = field_scale(TASK, [sample], replace(SMALL, beyond_px=0))
    assert scale.shape == (FIELDS,) == (SHAPE_COUNT,) and scale.dtype == np.float32
    np.testing.assert_allclose(scale[[0, 5, 31]], [1.0, 0.1, 20.0], rtol=0.1)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"widths": (4,)}, "widths"),
        ({"patch_px": 100}, "multiple of 16"),
        ({"no_nir_share": 1.0}, "no_nir_share"),
        ({"weight_decay": -1.0}, "weight_decay"),
        ({"wide_share": float("inf")}, "wide_share"),
        ({"patch_px": 16}, r"patch_px must be larger than beyond_px \(20\)"),
        ({"learning_rate": 0.0}, "learning_rate"),
        ({"device": "tpu"}, "device"),
    ],
)
def test_settings_out_of_range_are_refused(change, words) -> None:
    with pytest.raises(BadInput, match=words):
        ShapeNetSettings(**change)


def test_a_network_is_judged_by_the_slopes_that_are_left() -> None:
    sample = np.zeros((CHANNELS, 60, 66), dtype=np.float32)
    sample[WEIGHT, :, 6:] = 0.8
    ripple = (-1.0) ** np.arange(66)
    sample[SLOPES] = 2.0 + 0.0 * sample[SLOPES]
    found = _judged(np.stack([1.5 + ripple, 1.5 - ripple] * 60).reshape(60, 2, 66).swapaxes(0, 1), sample)
    assert found["before"] == pytest.approx(2.0) and found["after"] == pytest.approx(np.sqrt(0.25 + 1.0), rel=1e-3)
    assert found["wide_before"] == pytest.approx(2.0, rel=1e-2)
    assert found["wide_after"] == pytest.approx(0.5, rel=2e-2)  # ripples are gone
    exact = _judge_whole(lambda fields: np.full((2, 60, 64), 2.0), sample, 4)
    assert exact["after"] == exact["wide_after"] == 0
    sample[WEIGHT] = 0.0
    assert all(np.isnan(value) for value in _judged(sample[SLOPES], sample).values())
