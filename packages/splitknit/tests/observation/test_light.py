import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from refusals import bad_input
from splitknit.capture import Ambient, Band
from splitknit.imaging.pixels import GREY_WEIGHTS, bin_mean, pick_channel
from splitknit.io import paging
from splitknit.model import Camera, Led, Rig
from splitknit.observation import stored
from splitknit.observation.light import Light
from splitknit.observation.stored import decode_table, linear_image


def light_of(pixels, encoding="linear", **changes):
    count = len(pixels)
    fields = {"exposure": np.ones(count), "black_level": np.zeros(count), **changes}
    band = Band("white", pixels, tuple((k,) for k in range(count)), **fields)
    angles = 2 * np.pi * np.arange(count) / count
    leds = tuple(Led("white", direction=(np.cos(a), np.sin(a), 2.0)) for a in angles.tolist())
    return Light(band, Rig(Camera(10.0, pixels.shape[1:3]), leds), encoding)


def random_pixels(dtype=np.uint8, channels=3, shape=(7, 9)):
    return np.random.default_rng(3).integers(20, 200, (3, *shape, channels)).astype(dtype)


def test_srgb_is_the_standards_curve():
    table = decode_table(np.dtype(np.uint8), "srgb")
    assert (table[0], table[255]) == (0.0, 1.0)
    assert table[188] == pytest.approx(0.5029, abs=1e-4)  # mid grey
    assert table[10] == pytest.approx(10 / 255 / 12.92)  # the straight foot
    assert (np.diff(table) > 0).all()
    fine = decode_table(np.dtype(np.uint16), "srgb")
    assert_allclose(fine[::257], table, atol=1e-7)


def test_linear_code_is_the_fraction_of_the_full_scale():
    assert_allclose(decode_table(np.dtype(np.uint16), "linear")[[0, 13107, 65535]], [0, 0.2, 1])
    with bad_input("rec709"):
        decode_table(np.dtype(np.uint8), "rec709")


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("encoding", ["linear", "srgb"])
def test_the_black_level_is_subtracted_and_the_exposure_divided_out(dtype, encoding):
    pixels = random_pixels(dtype)[0]
    table = decode_table(np.dtype(dtype), encoding)
    light = linear_image(pixels, encoding, exposure=0.25, black_level=10.0)
    assert_allclose(light, (table[pixels] - table[10]) * 4.0, rtol=1e-5, atol=1e-7)
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
    stack = light_of(
        images,
        exposure=exposure,
        black_level=np.full(3, 1000.0),
        ambient=Ambient(ambient, 1.5, 700.0),
    ).grey
    assert stack.shape == (3, 4, 5)
    assert stack.dtype == np.float32
    assert_allclose(stack, np.broadcast_to(light[..., 0], (3, 4, 5)), atol=5e-5)


@pytest.mark.parametrize("channels", [1, 3])
def test_clipped_values_count_as_clipped_whatever_the_ambient_light(channels):
    pixels = random_pixels(channels=channels)
    pixels[1, 2, 3] = 255
    ambient = np.full_like(pixels[0], 60)
    light = light_of(pixels, ambient=Ambient(ambient, 1.0, 0.0))
    clipped = light.grey >= light.clips_at[:, None, None]
    assert np.argwhere(clipped).tolist() == [[1, 2, 3]]


def test_channels_of_a_window_are_linear_red_green_and_blue():
    pixels = random_pixels()
    light = light_of(pixels).at(1, (slice(2, 6), slice(1, 8)))
    part = pixels[:, 2:6, 1:8] / 255
    assert light.shape == (4, 7)
    assert light.channels == ("red", "green", "blue")
    assert_allclose(light.stack, np.moveaxis(part, -1, 0), rtol=1e-6)
    assert_allclose(light.grey, part @ GREY_WEIGHTS, rtol=1e-5)
    assert_array_equal(light.grey_and_stack[0], light.grey)
    assert_array_equal(light.grey_and_stack[1:], light.stack)
    assert pick_channel(np.ones((2, 3, 3), dtype=np.float32), "grey").shape == (2, 3)


def test_images_of_one_channel_have_no_colour():
    assert light_of(random_pixels()).has_colour
    grey = light_of(random_pixels()[..., :1])
    assert not grey.has_colour
    assert grey.channels == ("grey",)
    assert_array_equal(grey.stack[0], grey.grey)


@pytest.mark.parametrize("encoding", ["linear", "srgb"])
def test_binning_averages_linear_light(encoding):
    light = light_of(random_pixels(), encoding)
    full, small = light.stack[1], light.at(2).stack[1]
    assert small.shape == (3, 3, 4)  # the odd row and column are dropped
    assert light.at(2).pitch_mm == pytest.approx(0.2)
    expected = full[:, :6, :8].reshape(3, 3, 2, 4, 2).mean(axis=(2, 4))
    assert_allclose(small, expected, rtol=1e-5)
    assert_allclose(bin_mean(full, 2), expected, rtol=1e-5)
    assert_array_equal(bin_mean(full, 1), full)


def test_light_clips_by_exposure_and_black_level():
    light = light_of(
        random_pixels(), exposure=np.array([1.0, 2.0, 0.5]), black_level=np.array([0.0, 0.0, 51.0])
    )
    assert_allclose(light.clips_at, [0.985, 0.4925, 2 * (0.985 - 0.2)], rtol=1e-6)


def test_clipped_pixels_are_those_of_any_channel():
    pixels = random_pixels()
    pixels[1, 3, 4, 2] = 255
    clipped = light_of(pixels).clipped
    assert (clipped.sum(), clipped[1, 3, 4]) == (1, True)


def test_most_clipped_is_at_the_highest_value_of_its_channel():
    """Clipped images may have been darkened later."""
    pixels = random_pixels(shape=(40, 50))
    pixels[2, :10, :, 1] = 220
    inside = np.ones((40, 50), dtype=bool)
    part, image, channel = light_of(pixels).most_clipped(inside)
    assert (image, channel) == (2, 1)
    assert part == pytest.approx(0.25, abs=0.01)
    assert light_of(random_pixels(shape=(40, 50))).most_clipped(inside)[0] < 0.05


@pytest.mark.parametrize(
    ("channels", "count", "ambient"), [(3, 7, True), (1, 3, False), (3, 4, False)]
)
@pytest.mark.parametrize("binning", [1, 2, 3])
def test_a_survey_is_the_mean_and_the_grey_images(channels, count, ambient, binning):
    pixels = np.random.default_rng(3).integers(0, 256, (count, 51, 35, channels), dtype=np.uint8)
    light = light_of(
        pixels,
        "srgb",
        exposure=np.linspace(0.5, 2.0, count),
        black_level=np.full(count, 4.0),
        ambient=Ambient(pixels[0] // 8, 0.7, 2.0) if ambient else None,
    ).at(binning)
    mean, grey = light.survey()
    assert_allclose(mean, np.moveaxis(light.stack.mean(axis=1), 0, -1), rtol=1e-5)
    assert_array_equal(grey, light.grey)


@pytest.mark.parametrize("encoding", ["linear", "srgb"])
@pytest.mark.parametrize("binning", [1, 2, 3])
def test_the_size_of_chunks_does_not_change_the_image(monkeypatch, encoding, binning):
    pixels = np.random.default_rng(3).integers(0, 256, (151, 75, 3), dtype=np.uint8)
    monkeypatch.setattr(stored, "_ROWS_AT_ONCE", 10**6)
    whole = linear_image(pixels, encoding, 1.5, 3.0, binning)
    for rows in (1, 7, 64):
        monkeypatch.setattr(stored, "_ROWS_AT_ONCE", rows)
        assert_array_equal(linear_image(pixels, encoding, 1.5, 3.0, binning), whole)
    blocks = linear_image(
        pixels[: 151 // binning * binning, : 75 // binning * binning], encoding, 1.5, 3.0
    )
    blocks = blocks.reshape(151 // binning, binning, 75 // binning, binning, 3).mean(axis=(1, 3))
    assert_allclose(whole, blocks, atol=1e-6)


def test_sampled_light_is_that_of_every_so_many_pixels():
    light = light_of(random_pixels())
    assert light.sampled(2).shape == (4, 5)
    assert_array_equal(light.sampled(2).grey, light.grey[:, ::2, ::2])


def test_gains_are_divided_out_and_multiply():
    light = light_of(random_pixels())
    gains = np.array([[1.0, 2.0, 4.0]] * 3)
    once = light.divided_by(gains)
    assert_allclose(once.stack[2], light.stack[2] / 4, rtol=1e-6)
    assert_allclose(once.divided_by(gains).stack[2], light.stack[2] / 16, rtol=1e-6)


def test_moves_are_undone_where_light_is_asked_for():
    """Two moves after each other are one; windows and samples are those of the moved image."""
    rows, columns = np.mgrid[:40, :50]
    scene = 100 + 80 * np.sin(columns / 5) * np.cos(rows / 7)

    def seen(right, down):
        moved = 100 + 80 * np.sin((columns - right) / 5) * np.cos((rows - down) / 7)
        return np.rint(300 * moved)

    pixels = np.stack([seen(0, 0), seen(3, -2), seen(0, 0)])[..., None].astype(np.uint16)
    first, second = np.array([[1.0, 0, 1], [0, 1, 0]]), np.array([[1.0, 0, 2], [0, 1, -2]])
    light = light_of(pixels)
    steady = light.moved_by([None, first, None]).moved_by([None, second, None])
    inner = (slice(5, 35), slice(8, 42))
    assert_allclose(65535 * steady.grey[1][inner], 300 * scene[inner], atol=30)
    assert_array_equal(steady.grey[0], light.grey[0])
    assert_allclose(steady.at(1, inner).grey[1], steady.grey[1][inner], atol=1e-4)
    assert_allclose(steady.sampled(3).grey[1], steady.grey[1][::3, ::3], atol=1e-4)
    assert steady.of_images([1]).moves[0] is not None


def test_a_paged_stack_gives_the_same_light(monkeypatch):
    pixels = random_pixels(np.uint16)
    monkeypatch.setattr(paging, "IN_MEMORY", 100)
    stack = paging.new_stack(pixels.shape, pixels.dtype)
    for k, image in enumerate(pixels):
        stack[k] = image
    assert isinstance(stack, paging.PagedStack)
    assert_array_equal(np.asarray(stack), pixels)
    assert_array_equal(stack[1, 2:7:2], pixels[1, 2:7:2])
    light, paged = light_of(pixels), light_of(stack)
    window = (slice(1, 6), slice(2, 9))
    assert_array_equal(paged.at(2, window).stack, light.at(2, window).stack)
    assert_array_equal(paged.of_images([2, 0]).grey, light.grey[[2, 0]])


def test_a_full_disk_is_refused(monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(paging, "IN_MEMORY", 100)
    monkeypatch.setattr(paging.os, "posix_fallocate", full)
    with bad_input(r"of disk while they are worked on \(No space left"):
        paging.new_stack((3, 100, 100, 3), np.dtype(np.uint8))
