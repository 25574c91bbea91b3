"""Light through polarising films: mosaics of films, specular and diffuse light."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from refusals import bad_input
from splitknit.observation.films import (
    findings_on_series,
    separate_polarised,
    specular_picture,
    split_mosaic,
)

FILMS = {90: (0, 0), 45: (0, 1), 135: (1, 0), 0: (1, 1)}
"""Row and column of each in its block."""


def mosaic_of(total, polarised, angle_deg):
    """16-bit frame (H, W) of light of which a part is polarised at an angle, sampled where each
    pixel is."""
    frame = np.zeros(total.shape)
    for film, (row, column) in FILMS.items():
        own = np.s_[row::2, column::2]
        passing = np.cos(np.deg2rad(film - angle_deg)) ** 2
        frame[own] = 0.5 * (total - polarised)[own] + polarised[own] * passing
    return np.rint(frame).astype(np.uint16)


@pytest.mark.parametrize("film", [0.0, 30.0, 90.0, 135.0])
def test_light_along_the_film_passes_the_parallel_analyser_alone(film):
    rows, columns = np.mgrid[:64, :80]
    total = 20000 + 100.0 * columns + 50.0 * rows
    parallel, crossed = split_mosaic(mosaic_of(total, 0.4 * total, film), film)
    assert parallel.shape == crossed.shape == (32, 40, 1)
    middle = total.reshape(32, 2, 40, 2).mean(axis=(1, 3))
    inner = np.s_[1:-1, 1:-1]
    assert_allclose(parallel[..., 0][inner], 0.7 * middle[inner], atol=2)
    assert_allclose(crossed[..., 0][inner], 0.3 * middle[inner], atol=2)


def test_unpolarised_ridges_hardly_appear_polarised():
    """Without interpolation a tenth of the contrast of ridges of 16 pixels would seem polarised."""
    columns = np.arange(128)
    total = np.broadcast_to(30000 + 8000 * np.sin(2 * np.pi * columns / 16), (64, 128))
    frame = mosaic_of(total, np.zeros_like(total), 0.0)
    parallel, crossed = split_mosaic(frame, 0.0)
    false = np.abs(parallel.astype(float) - crossed)[2:-2, 2:-2].max()
    plain = np.abs(frame[1::2, 1::2].astype(float) - frame[0::2, 0::2])[2:-2, 2:-2].max()
    assert false < 0.05 * 4000
    assert plain > 0.1 * 4000
    assert false < 0.1 * plain


def test_a_quad_bayer_mosaic_gives_the_colours_of_its_blocks():
    """Blocks behind red, green / green, blue."""
    frame = np.zeros((32, 32), np.uint16)
    for (row, column), level in {
        (0, 0): 30000,
        (0, 2): 20000,
        (2, 0): 20000,
        (2, 2): 10000,
    }.items():
        for i, j in np.ndindex(2, 2):
            frame[row + i :: 4, column + j :: 4] = level
    parallel, crossed = split_mosaic(frame, 90.0, colour=True)
    assert parallel.shape == (16, 16, 3)
    # of unpolarised light each analyser passes what its pixels saw
    for image in (parallel, crossed):
        assert_allclose(
            image[4:-4, 4:-4], np.broadcast_to([30000, 20000, 10000], (8, 8, 3)), atol=1
        )


def test_what_clips_behind_one_film_clips_in_the_parallel_image():
    frame = np.full((16, 16), 100, np.uint8)
    frame[8, 9] = 255
    parallel, crossed = split_mosaic(frame, 90.0)
    assert parallel[4, 4, 0] == 255
    assert np.count_nonzero(parallel == 255) == 9
    assert crossed.max() < 255


@pytest.mark.parametrize(
    ("mosaic", "colour"),
    [
        (np.zeros((5, 4), np.uint8), False),
        (np.zeros((6, 6), np.uint8), True),
        (np.zeros((4, 4, 3), np.uint8), False),
        (np.zeros((4, 4), np.float32), False),
    ],
)
def test_frames_that_are_no_mosaic_of_films_are_refused(mosaic, colour):
    with bad_input("a mosaic of films has one channel"):
        split_mosaic(mosaic, 0.0, colour=colour)


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
