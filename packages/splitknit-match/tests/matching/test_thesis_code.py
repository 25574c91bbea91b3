"""The matcher of the thesis author's program, beside the slowest way to write it."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from refusals import bad_input
from splitknit_match.matching.thesis import NORMALS, FingerImages
from splitknit_match.matching.thesis_code import NEIGHBOURS, code_match, code_side, pattern_labels


def finger(seed, px_per_mm=75.7, columns=100):
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:130, 0:columns]
    mask = ((x - columns / 2) / (columns / 2)) ** 2 + ((y - 129) / 129) ** 2 < 1
    names = ("relief", *NORMALS, *(f"shape_{name}" for name in NORMALS))
    channels = {
        name: np.where(mask, rng.standard_normal(mask.shape), 0).astype(np.float32)
        for name in names
    }
    return FingerImages(channels, mask, px_per_mm)


@pytest.mark.parametrize("neighbours", sorted(set(NEIGHBOURS.values())))
def test_labels_are_those_of_single_pixels(neighbours):
    image = np.random.default_rng(0).standard_normal((9, 11)).astype(np.float32)
    labels = pattern_labels(image, neighbours)
    label_of = {}
    for row in range(9):
        for column in range(11):
            angle = 2 * np.pi * np.arange(neighbours) / neighbours
            places = np.stack([row - np.sin(angle), column + np.cos(angle)])
            around = map_coordinates(image.astype(float), places, order=1, mode="nearest")
            if np.min(np.abs(around - image[row, column])) < 1e-5:
                continue
            bits = around > image[row, column]
            if np.count_nonzero(bits != np.roll(bits, 1)) > 2:
                assert labels[row, column] == neighbours * (neighbours - 1) + 2
            else:
                assert label_of.setdefault(tuple(bits), labels[row, column]) == labels[row, column]
    assert len(set(label_of.values())) == len(label_of)
    flat = pattern_labels(np.zeros((3, 3), np.float32), neighbours)
    assert flat.max() == neighbours * (neighbours - 1) + 1


def test_a_finger_equals_itself():
    side = code_side(finger(1))
    same = code_match(side, side)
    assert (same.similarity, same.ratio, same.shift_px) == (1.0, 1.0, 0)


def test_empty_columns_beside_a_finger_change_little():
    image, columns = finger(3), ((0, 0), (0, 25))
    channels = {name: np.pad(channel, columns) for name, channel in image.channels.items()}
    wider = FingerImages(channels, np.pad(image.mask, columns), image.px_per_mm)
    match = code_match(code_side(image), code_side(wider))
    assert match.shift_px == 0
    assert match.ratio == 1.0
    assert match.similarity == pytest.approx(1.0, abs=0.02)


def test_sides_of_two_scales_are_refused():
    with bad_input("need one scale"):
        code_match(code_side(finger(1)), code_side(finger(1, px_per_mm=30)))
