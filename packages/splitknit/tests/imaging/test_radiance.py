from __future__ import annotations

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.imaging.band import (
    GREY_WEIGHTS,
    bin_mean,
    decode_table,
    has_colour,
    linear_channels,
    linear_image,
    linear_stack,
    pick_channel,
    saturation_levels,
)
from splitknit.model import Band


def band_of(pixels: np.ndarray, **changes: object) -> Band:
    count = len(pixels)
    fields = {"exposure": np.ones(count), "black_level": np.zeros(count), **changes}
    return Band("white", pixels, tuple((k,) for k in range(count)), **fields)


def random_pixels(
    dtype: type = np.uint8, channels: int = 3, shape: tuple[int, int] = (7, 9)
) -> np.ndarray:
    return np.random.default_rng(3).integers(20, 200, (3, *shape, channels)).astype(dtype)


def test_srgb_is_the_standards_curve():
    table = decode_table(np.dtype(np.uint8), "srgb")
    assert (table[0], table[255]) == (0.0, 1.0)
    assert table[188] == pytest.approx(0.5029, abs=1e-4)  # mid grey
    assert table[10] == pytest.approx(10 / 255 / 12.92)  # the straight foot
    assert (np.diff(table) > 0).all()
    fine = decode_table(np.dtype(np.uint16), "srgb")
    np.testing.assert_allclose(fine[::257], table, atol=1e-7)


def test_linear_code_is_the_fraction_of_the_full_scale():
    np.testing.assert_allclose(
        decode_table(np.dtype(np.uint16), "linear")[[0, 13107, 65535]], [0, 0.2, 1]
    )
    with pytest.raises(BadInput, match="rec709"):
        decode_table(np.dtype(np.uint8), "rec709")


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("encoding", ["linear", "srgb"])
def test_the_black_level_is_subtracted_and_the_exposure_divided_out(dtype, encoding):
    pixels = random_pixels(dtype)[0]
    table = decode_table(np.dtype(dtype), encoding)
    light = linear_image(pixels, encoding, exposure=0.25, black_level=10.0)
    np.testing.assert_allclose(light, (table[pixels] - table[10]) * 4.0, rtol=1e-5, atol=1e-7)
    assert light.min() > 0
    # noise below black is not clipped
    assert linear_image(pixels, encoding, black_level=190.0).min() < 0


def test_ambient_light_is_subtracted_at_equal_exposure():
    """Also where the ambient frame has another exposure and black level."""
    rng = np.random.default_rng(0)
    light, room = rng.uniform(0.05, 0.2, (2, 4, 5, 1))
    exposure = np.array([1.0, 2.0, 0.5])
    images = np.stack([np.round(65535 * t * (light + room)) + 1000 for t in exposure]).astype(
        np.uint16
    )
    ambient = (np.round(65535 * 1.5 * room) + 700).astype(np.uint16)
    band = band_of(
        images,
        exposure=exposure,
        black_level=np.full(3, 1000.0),
        ambient=ambient,
        ambient_exposure=1.5,
        ambient_black_level=700.0,
    )
    stack = linear_stack(band, "linear")
    assert stack.shape == (3, 4, 5)
    assert stack.dtype == np.float32
    np.testing.assert_allclose(stack, np.broadcast_to(light[..., 0], (3, 4, 5)), atol=5e-5)


def test_channels_of_a_window_are_linear_and_in_the_requested_order():
    pixels = random_pixels()
    window = (slice(2, 6), slice(1, 8))
    channels = linear_channels(band_of(pixels), "linear", ("blue", "grey", "red"), window)
    assert channels.shape == (3, 3, 4, 7)
    part = pixels[:, 2:6, 1:8] / 255
    np.testing.assert_allclose(channels[0], part[..., 2], rtol=1e-6)
    np.testing.assert_allclose(channels[1], part @ GREY_WEIGHTS, rtol=1e-5)
    np.testing.assert_allclose(channels[2], part[..., 0], rtol=1e-6)
    grey = linear_channels(band_of(pixels[..., :1]), "linear", ("green", "grey"))
    np.testing.assert_array_equal(grey[0], grey[1])
    assert pick_channel(np.ones((2, 3, 3), dtype=np.float32), "grey").shape == (2, 3)


def test_an_unknown_channel_is_refused():
    with pytest.raises(BadInput, match="violet"):
        linear_channels(band_of(random_pixels()), "linear", ("violet",))


def test_images_of_one_channel_have_no_colour():
    assert has_colour(band_of(random_pixels()))
    assert not has_colour(band_of(random_pixels()[..., :1]))


@pytest.mark.parametrize("encoding", ["linear", "srgb"])
def test_binning_averages_linear_light(encoding):
    pixels = random_pixels()
    full = linear_stack(band_of(pixels), encoding, "green")
    small = linear_stack(band_of(pixels), encoding, "green", binning=2)
    assert small.shape == (3, 3, 4)  # the odd row and column are dropped
    expected = full[:, :6, :8].reshape(3, 3, 2, 4, 2).mean(axis=(2, 4))
    np.testing.assert_allclose(small, expected, rtol=1e-5)
    np.testing.assert_allclose(bin_mean(full, 2), expected, rtol=1e-5)
    np.testing.assert_array_equal(bin_mean(full, 1), full)


def test_saturation_levels_follow_exposure_and_black_level():
    band = band_of(
        random_pixels(), exposure=np.array([1.0, 2.0, 0.5]), black_level=np.array([0.0, 0.0, 51.0])
    )
    np.testing.assert_allclose(
        saturation_levels(band, "linear"), [0.985, 0.4925, 2 * (0.985 - 0.2)], rtol=1e-6
    )
