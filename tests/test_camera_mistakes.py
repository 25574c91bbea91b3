"""A camera that does not answer in proportion to the light is named, on simulated fingers."""

from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
import pytest

import splitknit_simulator
from splitknit.methods.photographs import findings_for, photographs_of
from splitknit.presets import PRESETS

GAINS = 1 + np.random.default_rng(61).uniform(-0.15, 0.15, (8, 3)).astype(np.float32)


@lru_cache(maxsize=2)
def sound(equal):
    """A finger under seven lights, whose brightness differs by 10 % or not."""
    settings = {"scale": 0.1} | ({"rig_seed": None} if equal else {})
    return splitknit_simulator.simulate_capture(6101, settings=settings)[0]


def stored(change, *, ambient=True, equal=False):
    """The capture with every image (H, W, 3) in [0, 1], and its number, changed; the ambient one is
    -1, or left out."""

    def bytes_of(image, k):
        return np.clip(np.rint(255 * change(image.astype(np.float32) / 255, k)), 0, 255).astype(
            np.uint8
        )

    bands = {}
    for name, band in sound(equal).bands.items():
        pixels = np.stack([bytes_of(image, k) for k, image in enumerate(band.pixels)])
        room = band.ambient if ambient else None
        if room is not None:
            room = replace(room, pixels=bytes_of(room.pixels, -1))
        bands[name] = replace(band, pixels=pixels, ambient=room)
    return replace(sound(equal), bands=bands)


def local_contrast(image, _):
    """Divided by the root of what surrounds each pixel, in 2 mm."""
    around = cv2.GaussianBlur(image.mean(axis=2), (0, 0), 15)[..., None]
    return np.asarray(image * np.sqrt(0.3 / np.maximum(around, 0.05)))


MISTAKES = {
    "sound": (lambda x, _: x, ""),
    "BGR": (lambda x, _: x[..., ::-1], "swapped-colours"),
    "white balance": (lambda x, k: x * GAINS[k], "white-balance"),
    "gamma 0.8": (lambda x, _: x**0.8, "tone-curve"),
    "sRGB": (lambda x, _: 1.055 * np.maximum(x, 0.0031) ** (1 / 2.4) - 0.055, "tone-curve"),
    "S curve": (lambda x, _: x * x * (3 - 2 * x), "tone-curve"),
    "local contrast": (local_contrast, "tone-curve"),
    "lamp": (lambda x, _: x + 0.15 * (x > 0.02), "tone-curve"),
    "haze": (lambda x, _: 0.8 * cv2.GaussianBlur(x, (0, 0), 1.2) + 0.12, "tone-curve"),
    "clipped": (lambda x, _: 1.6 * x, "clipped-photograph"),
}


def doubts_of(capture):
    """Codes of what is wrong with the photographs, first what is worst."""
    metric = PRESETS["metric"]
    findings = findings_for(photographs_of(capture, metric.finding()), metric)
    return [finding.code for finding in findings if finding.severity != "note"]


@pytest.mark.slow
@pytest.mark.parametrize("name", MISTAKES)
def test_the_cause_is_named(name):
    """First of all doubts; of the sound capture there is none."""
    change, code = MISTAKES[name]
    capture = stored(change, ambient=name not in {"lamp", "haze"})
    codes = doubts_of(capture)
    assert codes[0] == code if code else not codes


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sound", "gamma 0.8", "S curve", "local contrast"])
def test_equal_lights_show_a_curve_by_their_shading(name):
    """Light that is added to all images does not show there."""
    change, code = MISTAKES[name]
    codes = doubts_of(stored(change, equal=True))
    assert codes[0] == "tone-curve" if code else not codes
