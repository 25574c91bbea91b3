from dataclasses import replace

import numpy as np
import pytest

from refusals import bad_input
from splitknit.capture import Ambient
from splitknit.io import content
from splitknit.io.content import check_content


def changed(band, k, pixels, **changes):
    stack = band.pixels.copy()
    stack[k] = pixels
    return replace(band, pixels=stack, **changes)


@pytest.fixture(params=[(np.uint8, 3), (np.uint8, 1), (np.uint16, 3)])
def band(request, build_capture):
    band = build_capture(*request.param, shape=(200, 150)).bands["white"]
    check_content(band)
    return band


def full(band):
    return int(np.iinfo(band.pixels.dtype).max)


def test_black_images_name_their_file_and_led(band):
    for dark in (0, int(0.009 * full(band))):
        with bad_input(r"white_2\.png is black: .*check LED 2 and capture it again"):
            check_content(changed(band, 2, dark))
    hot = np.zeros_like(band.pixels[0])
    hot[50, 40] = full(band)  # a hot pixel is not light
    with bad_input(r"white_1\.png is black"):
        check_content(changed(band, 1, hot))


def test_black_images_are_judged_above_black_level_and_ambient_light(band):
    grey = full(band) // 4
    noise = np.random.default_rng(0).integers(0, 2, band.pixels[0].shape)
    with bad_input(r"white_3\.png is black"):
        check_content(changed(band, 3, grey + noise, black_level=np.array([0.0, 0, 0, grey])))
    raised = (band.pixels // 2 + grey).astype(band.pixels.dtype)
    lit = replace(
        band, pixels=raised, ambient=Ambient(np.full_like(band.pixels[0], grey // 2), 0.5)
    )
    check_content(lit)
    with bad_input(r"white_3\.png is black: .* above the ambient image"):
        check_content(changed(lit, 3, grey + noise))


def test_an_image_far_darker_than_the_others_is_refused(band):
    dark = (band.pixels[3] // 50).astype(band.pixels.dtype)
    with bad_input(r"white_3\.png is almost black beside the other images"):
        check_content(changed(band, 3, dark))
    check_content(changed(band, 3, dark, exposure=np.array([1.0, 1.0, 1.0, 0.02])))
    check_content(replace(band, exposure=np.array([0.001, 0.001, 0.001, 1.0])))


def test_an_image_without_structure_is_refused(band):
    with bad_input(r"white_0\.png shows nothing: every pixel is"):
        check_content(changed(band, 0, full(band) // 2))


def test_an_overexposed_image_is_refused_but_not_small_highlights(band):
    image = band.pixels[1].astype(float)
    over = np.clip(image * 2.0, 0, full(band)).astype(band.pixels.dtype)
    with bad_input(r"white_1\.png is overexposed: \d+ % of its lit pixels"):
        check_content(changed(band, 1, over))
    check_content(changed(band, 1, np.clip(image * 1.3, 0, full(band)).astype(band.pixels.dtype)))
    glare = band.pixels[1].copy()
    glare[100:110, 70:80] = full(band)
    check_content(changed(band, 1, glare))
    dim = band.pixels[1] // 40  # a dark object with a small highlight
    dim[100:105, 70:80] = full(band)
    check_content(changed(band, 1, dim))


def test_only_one_clipped_channel_is_accepted(build_capture):
    band = build_capture(shape=(200, 150)).bands["white"]
    red = band.pixels[1].copy()
    red[60:140, 40:110, 0] = 255
    check_content(changed(band, 1, red))
    red[60:140, 40:110, 1] = 255
    with bad_input("overexposed"):
        check_content(changed(band, 1, red))


def test_large_images_are_judged_by_a_sample(build_capture, monkeypatch):
    band = build_capture(channels=1, shape=(700, 600)).bands["white"]
    monkeypatch.setattr(content, "SAMPLE_PIXELS", 5000)
    check_content(band)
    with bad_input("black"):
        check_content(changed(band, 0, 0))
