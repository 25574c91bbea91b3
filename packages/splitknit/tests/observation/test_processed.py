"""Photographs that a camera or a program sharpened, before they were stored."""

import cv2
import numpy as np
import pytest

from splitknit.capture import Band
from splitknit.model import Camera, Led, Rig
from splitknit.observation.light import Light
from splitknit.observation.observe import Observation
from splitknit.observation.processed import findings_on_processing

ROWS, COLUMNS = 160, 200
Y, X = np.mgrid[:ROWS, :COLUMNS]
MASK = np.hypot((X - 100) / 70, (Y - 80) / 55) < 1


def observation(processed, *, background=0.01, encoding="linear", material="skin"):
    """A round thing before a dark background, seen by a lens and a noisy sensor."""
    rng = np.random.default_rng(1)
    angles = 2 * np.pi * np.arange(6) / 6
    images = []
    for angle in angles:
        slant = 1 + 0.6 * (np.cos(angle) * (X - 100) / 70 + np.sin(angle) * (Y - 80) / 55)
        light = cv2.GaussianBlur(np.where(MASK, 0.4 * slant, background), (0, 0), 0.7)
        light += 0.002 * rng.standard_normal(light.shape)
        if encoding == "srgb":
            light = np.where(
                light < 0.0031, 12.92 * light, 1.055 * np.abs(light) ** (1 / 2.4) - 0.055
            )
        images.append(np.clip(processed(255 * light), 0, 255))
    pixels = np.rint(images).astype(np.uint8)[..., None]
    leds = tuple(Led("white", direction=(np.cos(a), np.sin(a), 2.0)) for a in angles.tolist())
    rig = Rig(Camera(10.0, (ROWS, COLUMNS)), leds)
    count = len(images)
    band = Band(
        "white",
        pixels,
        tuple((k,) for k in range(count)),
        exposure=np.ones(count),
        black_level=np.zeros(count),
    )
    return Observation(rig, {"white": Light(band, rig, encoding)}, material)


def sharpened(amount, sigma):
    return lambda image: image + amount * (image - cv2.GaussianBlur(image, (0, 0), sigma))


def codes(seen):
    window = slice(0, ROWS), slice(0, COLUMNS)
    _, findings = findings_on_processing(seen, window, MASK)
    return [finding.code for finding in findings]


@pytest.mark.parametrize(
    ("encoding", "amount", "sigma"),
    [("linear", 0.5, 1.0), ("linear", 1.0, 3.0), ("srgb", 1.0, 1.5), ("srgb", 1.0, 3.0)],
)
def test_sharpened_photographs_are_named(encoding, amount, sigma):
    seen = observation(sharpened(amount, sigma), encoding=encoding)
    assert codes(seen) == ["sharpened-photographs"]
    assert codes(observation(lambda image: image, encoding=encoding)) == []


@pytest.mark.parametrize(
    "processed", [lambda image: cv2.GaussianBlur(image, (0, 0), 2), sharpened(-0.5, 2.0)]
)
def test_blur_is_no_sharpening(processed):
    assert codes(observation(processed)) == []
    assert codes(observation(processed, background=0.0)) == []


def test_an_object_may_shade_the_ground_it_lies_on():
    assert codes(observation(sharpened(1.0, 2.0), material="opaque")) == []
