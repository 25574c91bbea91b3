"""Light through polarising films: specular and diffuse light."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from splitknit.observation.films import (
    findings_on_series,
    separate_polarised,
    specular_picture,
)


def test_specular_light_is_parallel_less_crossed():
    rng = np.random.default_rng(0)
    diffuse, mirrored = rng.random((3, 5, 6)), rng.random((3, 5, 6))
    specular, crossed = separate_polarised(diffuse + mirrored, diffuse)
    assert_allclose(specular, mirrored)
    assert_array_equal(crossed, diffuse)


def test_the_specular_picture_is_even_where_the_light_is_not():
    rows, columns = np.mgrid[:120, :120]
    ridges = np.sin(2 * np.pi * columns / 9)
    lit = (1 + 0.3 * ridges) * (0.1 + columns / 40.0)
    mask = np.hypot(rows - 60, columns - 60) < 50
    picture = specular_picture(np.stack([lit, 2 * lit]), mask, 9.0)
    assert np.isnan(picture[~mask]).all()
    for side in (np.s_[40:80, 25:55], np.s_[40:80, 65:95]):
        assert picture[side].std() == pytest.approx(1.0, abs=0.15)
        assert np.corrcoef(picture[side].ravel(), ridges[side].ravel())[0, 1] > 0.97
    assert np.isnan(specular_picture(lit[None], np.zeros_like(mask), 9.0)).all()


def test_series_that_do_not_belong_together_are_doubted():
    rows, columns = np.mgrid[-1:1:30j, -1:1:30j]

    def lit_from(angles):
        angles = angles[:, None, None]
        light = 1 + 0.4 * (columns * np.cos(angles) + rows * np.sin(angles))
        return light.astype(np.float32)

    sides = 2 * np.pi * np.arange(7) / 7
    crossed = lit_from(sides)
    noise = np.random.default_rng(0).normal(0, 0.02, crossed.shape).astype(np.float32)
    parallel, mask = crossed + 0.3 + noise, np.hypot(rows, columns) < 0.9
    assert findings_on_series(parallel, crossed, mask) == ()
    # LEDs halfway to the next ones
    assert findings_on_series(parallel, lit_from(sides + np.pi / 7), mask) == ()
    assert "were their folders exchanged" in str(findings_on_series(crossed, parallel, mask)[0])
    (words,) = findings_on_series(parallel, crossed[[1, 2, 3, 4, 5, 6, 0]], mask)
    assert words.code == "series-order"
    assert str(words).startswith("crossed image 0 is lit as parallel image 1 is, not as image 0")
