from __future__ import annotations

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.integration.knit import KnitSettings, add, crossover


def waves(shape: tuple[int, int], period: float) -> np.ndarray:
    """Mirror-symmetric along columns: whole half-waves between the borders."""
    rows, columns = np.mgrid[0 : shape[0], 0 : shape[1]]
    return np.cos(2 * np.pi * (columns + 0.5) / period) + 0 * rows


def keep_fine(omega: np.ndarray) -> np.ndarray:
    return (omega > 2 * np.pi / 20).astype(float)


def test_addition_is_the_sum_inside_the_mask() -> None:
    rng = np.random.default_rng(0)
    ridge, shape = rng.normal(size=(2, 6, 7))
    mask = np.zeros((6, 7), dtype=bool)
    mask[1:4, 2:6] = True
    knitted = add(ridge, shape, mask)
    assert knitted.dtype == np.float32
    np.testing.assert_allclose(knitted[mask], (ridge + shape)[mask], rtol=1e-6)
    assert np.isnan(knitted[~mask]).all()
    np.testing.assert_allclose(add(ridge, shape), ridge + shape, rtol=1e-5, atol=1e-6)


def test_crossover_takes_fine_from_one_and_coarse_from_the_other() -> None:
    size = (32, 80)
    fine_1, coarse_1 = waves(size, 8.0), 3.0 * waves(size, 80.0)
    fine_2, coarse_2 = 0.2 * waves(size, 8.0), 2.0 * waves(size, 80.0) + 5.0
    knitted = crossover(fine_1 + coarse_1 - 7.0, fine_2 + coarse_2, keep_fine)
    np.testing.assert_allclose(knitted, fine_1 + coarse_2, atol=1e-5)


@pytest.mark.parametrize("gain", [0.0, 0.3, 1.0])
def test_what_both_surfaces_agree_on_is_kept_whatever_the_response(gain: float) -> None:
    """Each frequency counts once, with a mask too, where addition would count it twice."""
    rng = np.random.default_rng(1)
    surface = rng.normal(size=(24, 31)).cumsum(axis=0)
    mask = np.hypot(*(np.mgrid[0:24, 0:31] - np.array([[[12]], [[15]]]))) < 10
    knitted = crossover(surface + 4.0, surface, lambda omega: np.full(omega.shape, gain), mask)
    np.testing.assert_allclose(knitted[mask], surface[mask], atol=1e-5)
    assert np.isnan(knitted[~mask]).all()


def test_response_is_asked_for_radians_per_pixel() -> None:
    asked = []

    def response(omega: np.ndarray) -> np.ndarray:
        asked.append(omega)
        return np.zeros(omega.shape)

    crossover(np.ones((8, 10)), np.zeros((8, 10)), response)
    assert asked[0].min() == 0.0
    assert asked[0].max() == pytest.approx(np.sqrt(2) * np.pi)


def test_values_outside_the_mask_do_not_matter() -> None:
    rng = np.random.default_rng(2)
    visible, shape = rng.normal(size=(2, 16, 16))
    mask = np.zeros((16, 16), dtype=bool)
    mask[3:12, 4:14] = True
    dirty = np.where(mask, visible, np.nan)
    np.testing.assert_array_equal(
        crossover(visible, shape, keep_fine, mask), crossover(dirty, shape, keep_fine, mask)
    )


def test_what_is_refused() -> None:
    good = np.zeros((4, 5))
    with pytest.raises(BadInput, match="one shape"):
        add(good, np.zeros((5, 4)))
    with pytest.raises(BadInput, match="NaN"):
        add(good, np.full((4, 5), np.nan))
    with pytest.raises(BadInput, match="mask is empty"):
        crossover(good, good, keep_fine, np.zeros((4, 5), dtype=bool))
    with pytest.raises(BadInput, match=r"knit\.method"):
        KnitSettings(method="glue")
