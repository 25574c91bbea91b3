import os
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from refusals import bad_input
from splitknit.networks.unet import (
    NO_TELEMETRY,
    load_network,
    network_threads,
    run_network,
    use_network_threads,
)
from splitknit.separation.direct import direct_light, exposure_level, local_level

TINY = Path(__file__).parent / "tiny.onnx"
"""A U-Net of width 2 with random weights; its card tells how it was made."""


@pytest.fixture(scope="module")
def network():
    return load_network(TINY)


@pytest.fixture(scope="module")
def images():
    return np.random.default_rng(5).random((2, 3, 203, 150), dtype=np.float32)


@pytest.fixture(params=["0", "", None])
def telemetry(request, monkeypatch):
    """The environment variable does not turn telemetry off."""
    monkeypatch.delenv(NO_TELEMETRY, raising=False)
    if request.param is not None:
        monkeypatch.setenv(NO_TELEMETRY, request.param)


@pytest.mark.usefixtures("telemetry")
def test_onnxruntime_is_imported_without_telemetry(monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)  # as if it were not installed
    with bad_input("pip install onnxruntime"):
        load_network(TINY)
    assert os.environ[NO_TELEMETRY] == "1"


@pytest.mark.usefixtures("network", "telemetry")
def test_onnxruntime_imported_with_telemetry_is_refused():
    assert "onnxruntime" in sys.modules
    with bad_input("ORT_DISABLE_TELEMETRY=1 before"):
        load_network(TINY)


@pytest.mark.parametrize("tile", [40, 64, 120])
def test_the_output_in_tiles_equals_that_in_one_piece(network, images, tile):
    whole = run_network(network, images, tile=4096)
    assert whole.shape == images.shape
    assert np.ptp(whole) > 0.05
    assert_allclose(run_network(network, images, tile=tile), whole, atol=2e-6)


def test_onnxruntime_keeps_no_memory_pattern_of_each_shape(network):
    assert not network.session.get_session_options().enable_mem_pattern


def test_no_margin_smaller_than_the_reach_would_do(network, images):
    """A pixel at the reach's end still changes the result, so that a smaller margin would be
    wrong."""
    reach = network.card.reach
    image = images[:1, :, :200, :144].copy()
    before = run_network(network, image)
    for row, reached in ((80 - reach, True), (80 - reach - 1, False)):  # row 80 is a tile's first
        changed = image.copy()
        changed[0, :, row] += 100.0
        difference = np.abs(run_network(network, changed) - before)[0, :, 80].max()
        assert (difference > 0) == reached


@pytest.mark.parametrize("name", ["direct", "relief", "shape"])
def test_outputs_have_the_same_bytes_on_one_two_and_four_threads(name):
    outputs = []
    before = network_threads()
    for threads in (1, 2, 4):
        use_network_threads(threads)
        network = load_network(name)
        fields = np.random.default_rng(0).random(
            (1, network.card.channels_in, 203, 150), dtype=np.float32
        )
        outputs.append(run_network(network, fields, tile=96).tobytes())
    use_network_threads(before)
    assert outputs[0] == outputs[1] == outputs[2]


def test_sides_that_are_no_multiple_of_the_stride_are_reflected(network, images):
    padded = np.pad(images, ((0, 0), (0, 0), (0, 5), (0, 2)), mode="reflect")
    expected = run_network(network, padded)[:, :, :203, :150]
    assert_array_equal(run_network(network, images), expected)


def test_a_grey_image_fills_every_input_channel(network, images):
    grey = images[:, 0]
    expected = run_network(network, np.repeat(grey[:, None], 3, axis=1))
    assert_array_equal(run_network(network, grey), expected)
    assert_array_equal(run_network(network, grey[:, None]), expected)


def test_each_image_is_processed_independently(network, images):
    assert_array_equal(run_network(network, images[1:]), run_network(network, images)[1:])


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        ((1, 3, 7, 100), "stride is 8 pixels"),
        ((1, 2, 64, 64), "3 channels, but these have 2"),
        ((64, 64), "shape"),
        ((0, 3, 64, 64), "shape"),
    ],
)
def test_images_of_a_wrong_shape_are_refused(network, shape, words):
    with bad_input(words):
        run_network(network, np.ones(shape, dtype=np.float32))


def test_an_image_with_nan_is_refused(network):
    image = np.ones((1, 16, 16), dtype=np.float32)
    image[0, 3, 3] = np.nan
    with bad_input("NaN"):
        run_network(network, image)


def test_direct_light_does_not_depend_on_the_exposure(network, images):
    once = direct_light(images, network)
    assert_allclose(
        direct_light(images * np.float32(0.125), network), 0.125 * once, rtol=1e-4, atol=1e-6
    )
    assert once.shape == images.shape and (once >= 0).all() and (once <= images).all()


def test_direct_light_of_grey_images_is_grey(network, images):
    grey = images[:, 0]
    direct = direct_light(grey, network)
    assert direct.shape == grey.shape
    level = local_level(grey[0])
    raw = run_network(network, grey[:1] / level).mean(axis=1)[0] * level
    assert_allclose(direct[0], np.clip(raw, 0, grey[0]), rtol=1e-5, atol=1e-6)


def test_the_exposure_level_is_that_of_the_skin():
    image = np.zeros((3, 100, 100), dtype=np.float32)
    image[:, 40:60, 40:60] = 0.25  # a quarter of the picture's ten per cent: black does not count
    assert exposure_level(image) == pytest.approx(0.25)
    assert exposure_level(0 * image) == 1.0


def test_the_local_level_is_the_skin_s_own_brightness_up_to_its_outline():
    image = np.zeros((3, 120, 163), dtype=np.float32)
    image[0, :, 60:], image[1, :, 60:], image[2, :, 60:] = 0.6, 0.3, 0.3
    assert_allclose(local_level(image)[:, 60:], 0.4, rtol=0.02)
    image[:, :, 60:] *= np.linspace(0.5, 1.5, 103, dtype=np.float32)
    expected = 0.4 * np.linspace(0.5, 1.5, 103)[20:-20]
    assert_allclose(local_level(image)[60, 80:-20], expected, rtol=0.05)
    dark = np.full((64, 64), 1e-4, dtype=np.float32)
    dark[:, 40:] = 1.0
    assert local_level(dark)[:, 0].max() == pytest.approx(0.05)  # not the noise's own level


def test_direct_light_of_a_black_image_is_black(network):
    assert (direct_light(np.zeros((1, 3, 16, 16), dtype=np.float32), network) == 0).all()
