"""Local binary patterns: codes against scikit-image, histograms against counting."""

from __future__ import annotations

import warnings

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splitknit.errors import BadInput
from splitknit_match.matching import features
from splitknit_match.matching.features import (
    LbpSettings,
    _cell_counts,
    _far_codes,
    _histograms,
    lbp_codes,
    lbp_features,
    uniform_bins,
)


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
@pytest.mark.parametrize("interpolation", ["linear", "nearest"])
def test_codes_do_not_depend_on_the_strips(shape: tuple[int, int], radius: float, interpolation: str) -> None:
    """Against whole images, one neighbour after the other."""
    image = np.random.default_rng(5).normal(size=shape).astype(np.float32)
    image[:, : shape[1] // 3] = 0.0
    diagonal, straight = radius * float(np.sqrt(0.5)), radius
    if interpolation == "nearest":
        diagonal, straight = round(diagonal), round(straight)
    code = np.zeros(shape, np.uint8)
    for bit in range(8):
        size = diagonal if bit % 2 else straight
        across, up = (round(float(f(bit * np.pi / 4))) * size for f in (np.cos, np.sin))
        code |= (from_afar(from_afar(np.pad(image, 9, "edge"), across, 1), -up, 0)[9:-9, 9:-9] >= image).astype(
            np.uint8
        ) << bit
    np.testing.assert_array_equal(lbp_codes(image, radius, interpolation), code)


def from_afar(image: np.ndarray, shift: float, axis: int) -> np.ndarray:
    """Linear interpolation, weights as the exact shift gives them."""
    first = int(np.floor(shift + 1e-9))
    part = shift - first
    near = np.roll(image, -first, axis)
    if part <= 1e-9:
        return near
    # rows as long as the image's: the last columns of a row round differently in opencv
    core, far = np.ascontiguousarray(near[:, 9:-9]), np.ascontiguousarray(np.roll(image, -first - 1, axis)[:, 9:-9])
    mixed = near.copy()
    mixed[:, 9:-9] = cv2.addWeighted(core, 1.0 - part, far, part, 0.0)
    return mixed


def test_uniform_bins_are_those_of_scikit_image() -> None:
    """58 uniform patterns, one bin for the rest."""
    bins = uniform_bins()
    assert bins.max() == 58
    assert np.bincount(bins)[:58].tolist() == [1] * 58
    for code in range(256):
        bits = [(code >> k) & 1 for k in range(8)]
        changes = sum(bits[k] != bits[k - 1] for k in range(8))
        assert (bins[code] == 58) == (changes > 2)


def test_codes_by_hand() -> None:
    image = np.array([[1, 2, 3], [8, 5, 4], [7, 6, 5]], np.float32)
    # counter-clockwise from the right: 4, 3, 2, 1, 8, 7, 6, 5 against 5
    assert lbp_codes(image, interpolation="nearest")[1, 1] == 0b11110000


@settings(max_examples=25, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 1000),
    gain=st.floats(0.01, 100.0),
    offset=st.floats(-50, 50),
    power=st.sampled_from([1, 3]),
    rows=st.integers(8, 30),
    columns=st.integers(8, 30),
)
def test_monotone_changes_of_a_channel_change_nothing(  # noqa: PLR0917
    seed: int, gain: float, offset: float, power: int, rows: int, columns: int
) -> None:
    image = np.random.default_rng(seed).integers(-20, 20, (rows, columns)).astype(np.float32)
    changed = (np.float64(gain) * image.astype(np.float64) ** power + offset).astype(np.float32)
    same = lbp_codes(image, interpolation="nearest") == lbp_codes(changed, interpolation="nearest")
    assert same.all()


def test_interpolated_codes_keep_under_gain_and_offset() -> None:
    image = np.random.default_rng(1).random((40, 50)).astype(np.float32)
    assert np.mean(lbp_codes(image, 1.5) == lbp_codes(4.0 * image + 2.0, 1.5)) > 0.999


@pytest.mark.parametrize("radius", [0.3, 0.8, 1.0])
def test_close_neighbours_are_those_of_any_distance(radius: float) -> None:
    """The fast way against the general one."""
    image = np.random.default_rng(6).normal(size=(70, 51)).astype(np.float32)
    image[20:40, 10:30] = 0.0
    padded = cv2.copyMakeBorder(image, 2, 2, 2, 2, cv2.BORDER_REPLICATE)
    straight = 1.0  # nearer, it is interpolated with the pixel itself, and no larger or smaller for that
    general = _far_codes(padded, 2, radius * float(np.sqrt(0.5)), straight)
    np.testing.assert_array_equal(lbp_codes(image, radius), general)
    assert (lbp_codes(np.full((9, 8), 0.3, np.float32), radius) == 255).all()


def test_histograms_count() -> None:
    codes = np.random.default_rng(2).integers(0, 256, (70, 45)).astype(np.uint8)
    counts = _cell_counts(codes, 20)
    assert counts.shape == (3, 2, 256)
    for row in range(3):
        for column in range(2):
            part = codes[20 * row : 20 * row + 20, 20 * column : 20 * column + 20]
            assert counts[row, column].tolist() == [int((part == code).sum()) for code in range(256)]
    np.testing.assert_array_equal(_histograms(counts, LbpSettings(uniform=False, normalisation="none")), counts)
    joined = _histograms(counts, LbpSettings(normalisation="none"))
    assert joined[1, 1].tolist() == np.bincount(uniform_bins()[codes[20:40, 20:40]].ravel(), minlength=59).tolist()
    many = _cell_counts(np.tile(codes, (3, 30)), 4)
    assert many.shape == (52, 337, 256)  # more columns than fit into one count
    assert (
        many[17, 300].tolist() == np.bincount(np.tile(codes, (3, 30))[68:72, 1200:1204].ravel(), minlength=256).tolist()
    )
    fractions = _histograms(counts, LbpSettings(normalisation="l1"))
    assert fractions.shape == (3, 2, 59)
    np.testing.assert_allclose(fractions.sum(axis=2), 1.0, rtol=1e-6)
    lengths = np.linalg.norm(_histograms(counts, LbpSettings()), axis=2)
    np.testing.assert_allclose(lengths, 1.0, rtol=1e-6)


@pytest.mark.parametrize(
    ("px_per_mm", "size"), [(75.7, (200, 150)), (37.85, (133, 100)), (20.0, (35, 90)), (5.0, (9, 600))]
)
def test_features_are_those_of_all_codes(px_per_mm: float, size: tuple[int, int]) -> None:
    """Strips end with cells, and what lies beyond whole cells is left out."""
    image = np.random.default_rng(7).random(size).astype(np.float32)
    chosen = LbpSettings(normalisation="none")
    cell = features.cell_px(px_per_mm)
    counts = _cell_counts(lbp_codes(image), cell)
    assert lbp_features(image, px_per_mm, chosen).tolist() == _histograms(counts, chosen).ravel().tolist()


def test_a_pixel_is_described_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Work that is counted: pixels of the strips, their borders included, and of what is counted."""
    seen = []
    close = features._close_codes
    monkeypatch.setattr(features, "_close_codes", lambda strip, *given: seen.append(strip.size) or close(strip, *given))
    lbp_features(np.random.default_rng(8).random((330, 230), dtype=np.float32), 75.7)  # 5 x 3 cells of 64 pixels
    assert sum(seen) <= 1.08 * 5 * 3 * 64 * 64


def test_sizes_scale_with_the_image() -> None:
    settings_of = LbpSettings(radius_px=4.0)
    assert features.cell_px(75.7) == 64
    assert features.cell_px(37.85) == 32
    assert settings_of.radius(37.85) == pytest.approx(2.0)
    assert LbpSettings().radius(20.0) == 1.0
    image = np.random.default_rng(3).random((130, 70)).astype(np.float32)
    assert lbp_features(image, 37.85).shape == (4 * 2 * 59,)


@pytest.mark.parametrize("change", [{"radius_px": 0}, {"normalisation": "max"}, {"interpolation": "cubic"}])
def test_settings_are_checked(change) -> None:
    with pytest.raises(BadInput, match=next(iter(change))):
        LbpSettings(**change)


def test_bad_images_are_refused() -> None:
    with pytest.raises(BadInput, match="NaN"):
        lbp_codes(np.full((5, 5), np.nan, np.float32))
    with pytest.raises(BadInput, match="smaller than a cell"):
        lbp_features(np.zeros((20, 20), np.float32), 75.7)
