from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit_simulator.training.fields import FIELDS, draw_batch, draw_patch, field_scale
from splitknit_simulator.training.relief import (
    CHANNELS,
    GLARE,
    RELIEF,
    SYMMETRY,
    TASK,
    WEIGHT,
    ReliefSettings,
    _judged,
)

flipped, transposed, oriented = SYMMETRY.flipped, SYMMETRY.transposed, SYMMETRY.oriented

SMALL = ReliefSettings(widths=(2, 3), patch_px=16, batch=3)
OTHER_SEED = ReliefSettings(widths=(2, 3), patch_px=16, batch=3, seed=1)

MIRROR = np.array([[-1.0, 0.0], [0.0, 1.0]])
TRANSPOSE = np.array([[0.0, -1.0], [-1.0, 0.0]])


def sample_of(seed: int, shape: tuple[int, int] = (24, 20)) -> np.ndarray:
    rng = np.random.default_rng(seed)
    sample = rng.standard_normal((CHANNELS, *shape)).astype(np.float32)
    sample[WEIGHT] = rng.random(shape)
    return sample


def seen_from(sample: np.ndarray, azimuth: float) -> np.ndarray:
    """What the fields say of a light at this azimuth (n, h, w): four vectors, three fields of waves, glare, scalars."""
    first = np.array([np.cos(azimuth), np.sin(azimuth)])
    waves = np.array([f(n * azimuth) for n in (2, 3) for f in (np.cos, np.sin)])
    shown = [np.tensordot(first, sample[k : k + 2], 1) for k in (3, 5, 7, 21)]
    shown += [np.tensordot(waves, sample[k : k + 4], 1) for k in (9, 13, 17)]
    shown.append(np.tensordot(np.concatenate([[1.0], first, waves]), sample[GLARE], 1))
    scalars = [*range(3), *range(23, FIELDS), RELIEF, WEIGHT]
    return np.stack([*shown, *sample[scalars]])


@pytest.mark.parametrize(("turn", "matrix"), [(flipped, MIRROR), (transposed, TRANSPOSE)])
def test_a_turned_image_shows_under_the_turned_light_what_it_showed_before(turn, matrix) -> None:
    sample = sample_of(0)
    turned = turn(sample)
    for azimuth in (0.0, 0.4, 1.9, -2.6):
        x, y = matrix @ [np.cos(azimuth), np.sin(azimuth)]
        before = seen_from(sample, azimuth)
        moved = before[:, :, ::-1] if turn is flipped else before.swapaxes(1, 2)
        np.testing.assert_allclose(seen_from(turned, float(np.arctan2(y, x))), moved, atol=2e-6)


def test_rows_count_downwards_and_y_upwards() -> None:
    # a slope that rises to the right, in an image whose left column is marked
    sample = np.zeros((CHANNELS, 3, 4), dtype=np.float32)
    sample[3], sample[0, :, 0] = 1.0, 7.0
    turned = transposed(sample)  # the left column is the first row now: the slope rises downwards
    assert turned.shape == (CHANNELS, 4, 3)
    assert (turned[0, 0] == 7).all() and (turned[3] == 0).all() and (turned[4] == -1).all()
    across = flipped(sample)
    assert (across[0, :, -1] == 7).all() and (across[3] == -1).all()


def test_the_eight_turns_are_all_different_and_each_undoes_itself_in_time() -> None:
    sample = sample_of(1, (8, 8))
    turns = [oriented(sample, way) for way in range(8)]
    for one, other in itertools.combinations(turns, 2):
        assert not np.array_equal(one, other)
    for way in range(8):
        back = sample
        for _ in range(4):
            back = oriented(back, way)
        np.testing.assert_array_equal(back, sample)
    for one in turns:
        np.testing.assert_array_equal(np.sort(one[WEIGHT], axis=None), np.sort(sample[WEIGHT], axis=None))


def test_an_unturned_patch_is_a_piece_of_a_sample_with_enough_skin() -> None:
    sample = sample_of(2, (40, 50))
    sample[WEIGHT] = 0.0
    sample[WEIGHT, :, 30:] = 1.0
    rng = np.random.default_rng(0)
    for _ in range(20):
        patch = draw_patch(TASK, [sample], SMALL, rng)
        row, column = np.argwhere(sample[0] == patch[0, 0, 0])[0]
        np.testing.assert_array_equal(patch, sample[:, row : row + 16, column : column + 16])
        assert patch[WEIGHT].mean() >= 0.2


def test_what_a_small_sample_lacks_is_zero_and_counts_nothing() -> None:
    patch = draw_patch(TASK, [sample_of(3, (12, 30)).astype(np.float16)], SMALL, np.random.default_rng(0))
    assert patch.shape == (CHANNELS, 16, 16) and patch.dtype == np.float32
    assert (patch[:, 12:] == 0).all() and (patch[WEIGHT, :12] > 0).any()


def test_samples_without_skin_are_refused() -> None:
    sample = sample_of(4)
    sample[WEIGHT] = 0.0
    with pytest.raises(BadInput, match="enough skin"):
        draw_patch(TASK, [sample], SMALL, np.random.default_rng(0))


def test_a_fraction_of_the_patches_is_from_whole_fingers() -> None:
    pieces, fingers = ([np.full((CHANNELS, 20, 20), value, dtype=np.float32)] for value in (1.0, 2.0))
    rng = np.random.default_rng(0)
    from_whole = sum(draw_patch(TASK, pieces, SMALL, rng, fingers)[0, 0, 0] == 2 for _ in range(500))
    assert 70 < from_whole < 130  # a fifth
    assert (draw_patch(TASK, pieces, SMALL, rng)[0] == 1).all()
    batch = draw_batch(TASK, pieces, replace(SMALL, whole_share=1.0), 0, fingers)
    assert (batch[:, 0] == 2).all()
    assert field_scale(TASK, [sample_of(0)], replace(SMALL, whole_share=1.0), fingers)[0] == pytest.approx(50)


def test_batches_follow_from_seed_and_number() -> None:
    samples = [sample_of(5), sample_of(6)]
    batch = draw_batch(TASK, samples, SMALL, 7)
    assert batch.shape == (3, CHANNELS, 16, 16) and batch.dtype == np.float32
    np.testing.assert_array_equal(batch, draw_batch(TASK, samples, SMALL, 7))
    assert not np.array_equal(batch, draw_batch(TASK, samples, SMALL, 8))
    assert not np.array_equal(
        batch, draw_batch(TASK, samples, ReliefSettings(widths=(2, 3), patch_px=16, batch=3, seed=1), 7)
    )


def test_fields_are_scaled_by_what_they_vary() -> None:
    sample = sample_of(7, (60, 60))
    sample[WEIGHT] = 1.0
    sample[5] *= 10
    sample[6] = 3.0  # constant: not amplified
    scale = field_scale(TASK, [sample], SMALL)
    assert scale.shape == (FIELDS,) and scale.dtype == np.float32
    np.testing.assert_allclose(scale[[0, 5, 6]], [1.0, 0.1, 50.0], rtol=0.1)


def test_the_learning_rate_rises_and_falls() -> None:
    settings = ReliefSettings(iterations=1000, warm_up=100, learning_rate=1e-3)
    rates = [settings.rate(number) for number in range(1001)]
    assert rates[0] == pytest.approx(1e-5)
    assert max(rates) == pytest.approx(1e-3, rel=0.03) and 90 <= int(np.argmax(rates)) <= 110
    assert rates[550] == pytest.approx(1e-3 * (0.02 + 0.98 * 0.5 * (1 + np.cos(0.55 * np.pi))))
    assert rates[1000] == pytest.approx(2e-5)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"widths": (4,)}, "widths"),
        ({"widths": (4, 0)}, "widths"),
        ({"patch_px": 100}, "multiple of 16"),
        ({"iterations": 0}, "iterations"),
        ({"learning_rate": float("nan")}, "learning_rate"),
        ({"glare_share": -1.0}, "glare_share"),
        ({"whole_share": 1.5}, "whole_share"),
        ({"seed": -1}, "seed"),
        ({"device": "tpu"}, "device"),
        ({"precision": "half"}, "precision"),
    ],
)
def test_settings_out_of_range_are_refused(change, words) -> None:
    with pytest.raises(BadInput, match=words):
        ReliefSettings(**change)


def test_a_network_is_judged_where_there_is_skin() -> None:
    sample = sample_of(8)
    sample[RELIEF] -= sample[RELIEF][sample[WEIGHT] > 0.5].mean()
    made = np.zeros((9, *sample.shape[1:]), dtype=np.float32)
    made[0] = 0.8 * sample[RELIEF]
    made[1:8] = sample[GLARE]
    made[8] = np.log((0.2 * sample[RELIEF][sample[WEIGHT] > 0.5]).astype(np.float64).var())
    made[:, sample[WEIGHT] <= 0.5] = 99.0  # nobody asks
    found = _judged(made, sample)
    assert found["correlation"] == pytest.approx(1.0)
    assert found["gain"] == pytest.approx(0.8)
    assert found["rms"] == pytest.approx(0.2 * float(sample[RELIEF][sample[WEIGHT] > 0.5].std()), rel=1e-4)
    assert found["error_ratio"] == pytest.approx(1.0, rel=1e-4)
    assert found["glare_r2"] == pytest.approx(1.0)
    made[1:8] = 0.0
    assert _judged(made, sample)["glare_r2"] == pytest.approx(0.0, abs=1e-6)
    sample[WEIGHT] = 0.0
    assert all(np.isnan(value) for value in _judged(made, sample).values())
