"""Local binary patterns: codes against scikit-image and loops, histograms against counting."""

import warnings

import numpy as np
import pytest

from refusals import bad_input
from splitknit_match.matching.features import cells, lbp_codes, lbp_features, uniform_bins


def test_codes_are_those_of_scikit_image():
    feature = pytest.importorskip("skimage.feature")
    image = np.random.default_rng(4).random((90, 110)).astype(np.float32)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # it prefers whole numbers
        expected = feature.local_binary_pattern(image.astype(np.float64), 8, 1.0)
    edge = 5  # it takes zeros beyond the border, we repeat the edge
    inner = slice(edge, -edge), slice(edge, -edge)
    assert np.mean(lbp_codes(image)[inner] == expected[inner]) > 0.9999


def test_uniform_patterns_have_bins_of_their_own():
    """58 uniform patterns, one bin for the rest."""
    bins = uniform_bins()
    assert bins.max() == 58
    assert np.bincount(bins)[:58].tolist() == [1] * 58
    for code in range(256):
        bits = [(code >> k) & 1 for k in range(8)]
        assert (bins[code] == 58) == (sum(bits[k] != bits[k - 1] for k in range(8)) > 2)


def test_gain_and_offset_do_not_change_codes():
    image = np.random.default_rng(1).random((40, 50)).astype(np.float32)
    assert np.mean(lbp_codes(image) == lbp_codes(4.0 * image + 2.0)) > 0.999
    assert (lbp_codes(np.full((9, 8), 0.3, np.float32)) == 255).all()


@pytest.mark.parametrize(
    ("px_per_mm", "size", "cell"),
    [(75.7, (200, 150), 64), (37.85, (133, 100), 32), (20.0, (35, 90), 17), (5.0, (9, 600), 4)],
)
def test_features_are_histograms_of_whole_cells(px_per_mm, size, cell):
    image = np.random.default_rng(7).random(size).astype(np.float32)
    assert cells(image, px_per_mm)[0] == cell
    bins = uniform_bins()[lbp_codes(image)]
    counted = [
        np.bincount(bins[row : row + cell, column : column + cell].ravel(), minlength=59)
        for row in range(0, size[0] - cell + 1, cell)
        for column in range(0, size[1] - cell + 1, cell)
    ]
    expected = np.array([counts / np.linalg.norm(counts) for counts in counted]).ravel()
    np.testing.assert_allclose(lbp_features(image, px_per_mm), expected, rtol=1e-6)


def test_nan_and_images_below_a_cell_are_refused():
    with bad_input("NaN"):
        lbp_codes(np.full((5, 5), np.nan, np.float32))
    with bad_input("smaller than a cell"):
        lbp_features(np.zeros((20, 20), np.float32), 75.7)
