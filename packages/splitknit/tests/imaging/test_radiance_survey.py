"""The survey is the mean and the grey images that the plain functions give, whatever the chunks."""

from __future__ import annotations

import numpy as np
import pytest

from splitknit.imaging import band as band_module
from splitknit.imaging.band import linear_channels, linear_image, linear_stack, linear_survey
from splitknit.model import Band


def band(channels: int, count: int, ambient: bool) -> Band:
    rng = np.random.default_rng(3)
    pixels = rng.integers(0, 256, (count, 151, 75, channels), dtype=np.uint8)
    return Band(
        name="white",
        pixels=pixels,
        leds=tuple((k,) for k in range(count)),
        exposure=np.linspace(0.5, 2.0, count),
        black_level=np.full(count, 4.0),
        ambient=pixels[0] // 8 if ambient else None,
        ambient_exposure=0.7,
        ambient_black_level=2.0,
    )


@pytest.mark.parametrize(
    ("channels", "count", "ambient"), [(3, 7, True), (1, 3, False), (3, 4, False)]
)
@pytest.mark.parametrize("binning", [1, 2, 3])
def test_the_survey_is_the_mean_and_the_grey_images(channels, count, ambient, binning):
    images = band(channels, count, ambient)
    mean, grey = linear_survey(images, "srgb", binning)
    names = ("red", "green", "blue") if channels == 3 else ("grey",)
    expected = np.moveaxis(
        linear_channels(images, "srgb", names, binning=binning).mean(axis=1), 0, -1
    )
    np.testing.assert_array_equal(mean, expected)
    np.testing.assert_array_equal(grey, linear_stack(images, "srgb", "grey", binning=binning))


@pytest.mark.parametrize("encoding", ["linear", "srgb"])
@pytest.mark.parametrize("binning", [1, 2, 3])
def test_the_size_of_chunks_does_not_change_the_image(monkeypatch, encoding, binning):
    pixels = band(3, 1, False).pixels[0]
    monkeypatch.setattr(band_module, "CHUNK_ROWS", 10**6)
    whole = linear_image(pixels, encoding, 1.5, 3.0, binning)
    for rows in (1, 7, 64):
        monkeypatch.setattr(band_module, "CHUNK_ROWS", rows)
        np.testing.assert_array_equal(linear_image(pixels, encoding, 1.5, 3.0, binning), whole)
    blocks = linear_image(
        pixels[: 151 // binning * binning, : 75 // binning * binning], encoding, 1.5, 3.0
    )
    blocks = blocks.reshape(151 // binning, binning, 75 // binning, binning, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(whole, blocks, atol=1e-6)
