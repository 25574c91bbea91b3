"""Local binary patterns: codes against scikit-image and loops, histograms against counting."""

from __future__ import annotations

import warnings

import cv2
import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit_match.matching.features import cell_px, lbp_codes, lbp_features, uniform_bins


@pytest.mark.parametrize("radius", [1.0, 1.5, 2.0, 3.3])
def test_codes_are_those_of_scikit_image(radius: float) -> None:
    feature = pytest.importorskip("skimage.feature")
    image = np.random.default_rng(4).random((90, 110)).astype(np.float32)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # it prefers whole numbers
        expected = feature.local_binary_pattern(image.astype(np.float64), 8, radius)
    edge = 5  # it takes zeros beyond the border, we repeat the edge
    inner = slice(edge, -edge), slice(edge, -edge)
    assert np.mean(lbp_codes(image, radius)[inner] == expected[inner]) > 0.9999


@pytest.mark.parametrize("shape", [(3, 5), (128, 31), (300, 190)])
@pytest.mark.parametrize("radius", [1.0, 2.5, 4.3])
def test_codes_do_not_depend_on_the_strips(shape: tuple[int, int], radius: float) -> None:
    """Against whole images, one neighbour after the other."""
    image = np.random.default_rng(5).normal(size=shape).astype(np.float32)
    image[:, : shape[1] // 3] = 0.0
    code = np.zeros(shape, np.uint8)
    for bit in range(8):
        size = radius * float(np.sqrt(0.5)) if bit % 2 else radius
        across, up = (round(float(f(bit * np.pi / 4))) * size for f in (np.cos, np.sin))
        there = from_afar(from_afar(np.pad(image, 9, "edge"), across, 1), -up, 0)[9:-9, 9:-9]
        code |= (there >= image).astype(np.uint8) << bit
    np.testing.assert_array_equal(lbp_codes(image, radius), code)


def from_afar(image: np.ndarray, shift: float, axis: int) -> np.ndarray:
    """Linear interpolation, weights as the exact shift gives them."""
    first = int(np.floor(shift + 1e-9))
    part = shift - first
    near = np.roll(image, -first, axis)
    if part <= 1e-9:
        return near
    # rows as long as the image's: the last columns of a row round differently in opencv
    far = np.roll(image, -first - 1, axis)[:, 9:-9]
    core, far = np.ascontiguousarray(near[:, 9:-9]), np.ascontiguousarray(far)
    mixed = near.copy()
    mixed[:, 9:-9] = cv2.addWeighted(core, 1.0 - part, far, part, 0.0)
    return mixed


def test_uniform_patterns_have_bins_of_their_own() -> None:
    """58 uniform patterns, one bin for the rest."""
    bins = uniform_bins()
    assert bins.max() == 58
    assert np.bincount(bins)[:58].tolist() == [1] * 58
    for code in range(256):
        bits = [(code >> k) & 1 for k in range(8)]
        assert (bins[code] == 58) == (sum(bits[k] != bits[k - 1] for k in range(8)) > 2)


def test_codes_keep_under_gain_and_offset() -> None:
    image = np.random.default_rng(1).random((40, 50)).astype(np.float32)
    assert np.mean(lbp_codes(image, 1.5) == lbp_codes(4.0 * image + 2.0, 1.5)) > 0.999
    assert (lbp_codes(np.full((9, 8), 0.3, np.float32)) == 255).all()


@pytest.mark.parametrize(
    ("px_per_mm", "size", "cell"),
    [(75.7, (200, 150), 64), (37.85, (133, 100), 32), (20.0, (35, 90), 17), (5.0, (9, 600), 4)],
)
def test_features_are_histograms_of_whole_cells(px_per_mm: float, size: tuple[int, int], cell: int) -> None:
    image = np.random.default_rng(7).random(size).astype(np.float32)
    assert cell_px(px_per_mm) == cell
    bins = uniform_bins()[lbp_codes(image)]
    counted = [
        np.bincount(bins[row : row + cell, column : column + cell].ravel(), minlength=59)
        for row in range(0, size[0] - cell + 1, cell)
        for column in range(0, size[1] - cell + 1, cell)
    ]
    expected = np.array([one / np.linalg.norm(one) for one in counted]).ravel()
    np.testing.assert_allclose(lbp_features(image, px_per_mm), expected, rtol=1e-6)


def test_bad_images_are_refused() -> None:
    with pytest.raises(BadInput, match="NaN"):
        lbp_codes(np.full((5, 5), np.nan, np.float32))
    with pytest.raises(BadInput, match="smaller than a cell"):
        lbp_features(np.zeros((20, 20), np.float32), 75.7)
