"""The thesis's author's own finger, from the film on his public page: our steps beside his on the
same pixels."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy import ndimage

from splitknit.finger.contrast import clahe
from splitknit.model import BoolArray, FloatArray
from splitknit.separation.direct import direct_light

pytestmark = pytest.mark.external
FINGER_MM = 16.0  # assumed: the film states no scale


@pytest.fixture(scope="module")
def film(data_dir: Path) -> dict[str, FloatArray]:
    """Grey picture, his contrast enhancement and his network's output of it, in the film's code
    from 0 to 1."""
    folder = data_dir / "author_film"
    if not folder.is_dir():
        pytest.skip(f"{folder} is absent")
    names = ("grey_crop", "clahe", "direct")
    return {
        name: cv2.imread(str(folder / f"{name}.png"), cv2.IMREAD_GRAYSCALE).astype(np.float32) / 255
        for name in names
    }


@pytest.fixture(scope="module")
def inside(film: dict[str, FloatArray]) -> BoolArray:
    finger = ndimage.binary_opening(film["clahe"] > 0.08, iterations=3)
    return np.asarray(ndimage.binary_erosion(finger, iterations=25))


def ridges(image: FloatArray, inside: BoolArray) -> FloatArray:
    """Values in the band of the ridges, whose period is about 12 px here."""
    band = ndimage.gaussian_filter(image, 1.0) - ndimage.gaussian_filter(image, 8.0)
    return np.asarray(band[inside])


def agreement(ours: FloatArray, his: FloatArray, inside: BoolArray) -> tuple[float, float]:
    """Correlation of the ridges, and their gain over his."""
    a, b = ridges(ours, inside), ridges(his, inside)
    return float(np.corrcoef(a, b)[0, 1]), float(a @ b / (b @ b))


def test_clahe_shows_the_ridges_of_the_author_s_enhancement(film, inside):
    """Half as strong beside its mean: ours makes the brightest skin white before it equalises."""
    code, finger = film["grey_crop"], film["clahe"] > 0.08
    linear = np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4).astype(
        np.float32
    )
    columns = np.flatnonzero(finger.any(axis=0))
    ours = clahe(linear, float(np.ptp(columns)) / FINGER_MM, mask=finger)
    correlation, gain = agreement(ours, film["clahe"], inside)
    assert correlation > 0.97 and 0.9 < gain < 1.3
    contrast = [
        float(np.std(ridges(image, inside)) / image[inside].mean())
        for image in (ours, film["clahe"])
    ]
    assert contrast == pytest.approx([0.060, 0.128], abs=0.005)


def test_the_direct_network_agrees_with_the_author_s_network(film, inside):
    ours = direct_light(film["clahe"][None], "direct")[0]
    correlation, gain = agreement(ours, film["direct"], inside)
    assert correlation > 0.95 and 0.8 < gain < 1.1
