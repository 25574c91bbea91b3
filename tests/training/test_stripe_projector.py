"""A real projector on a paper board: stripes and their inverses, half of the projector lit.

The files are linear: a pattern and its inverse, black taken off, add up to white within 2 %. With
the sRGB curve undone they would miss it by a quarter.
"""

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from splitknit.io.images import read_image
from splitknit.observation.stored import linear_image

sys.path.append(str(Path(__file__).resolve().parents[2] / "training"))

from patterns import checkerboard

pytestmark = pytest.mark.external
PAIRS = ("stripes_14", "stripes_16", "rows_34")


def pairs(data_dir, names, encoding="linear"):
    """Patterns, each before its inverse."""
    return [
        light(data_dir, name + inverse, encoding) for name in names for inverse in ("", "_inverse")
    ]


def light(data_dir, name, encoding="linear"):
    folder = data_dir / "stripe_projector"
    if not folder.is_dir():
        pytest.skip(f"{folder} is absent")
    black = linear_image(read_image(folder / "black.png"), encoding)[..., 0]
    return linear_image(read_image(folder / f"{name}.png"), encoding)[..., 0] - black


@pytest.mark.parametrize("names", [*[(pair,) for pair in PAIRS], PAIRS])
def test_direct_and_global_light_add_up_to_white(data_dir, names):
    parts = checkerboard(pairs(data_dir, names))
    white = light(data_dir, "white")
    lit = white > 0.1
    ratio = (parts.white / np.where(lit, white, 1.0))[lit]
    assert lit.mean() > 0.7
    assert abs(np.median(ratio) - 1) < 0.03
    assert np.median(np.abs(ratio - 1)) < 0.03
    assert np.median(parts.global_[lit]) > 0


def test_patterns_and_their_inverses_add_up_in_linear_light(data_dir):
    """Whatever the optics, light adds up: this tells the camera's curve without a model of the
    scene."""
    for encoding, miss in (("linear", 0.02), ("srgb", 0.25)):
        white = light(data_dir, "white", encoding)
        both, lit = sum(pairs(data_dir, ["stripes_14"], encoding)), white > 0.1
        error = abs(float(np.median(both[lit] / white[lit])) - 1)
        assert miss / 2 < error < miss


def test_adhesive_tape_has_more_global_light_than_paper(data_dir):
    """Translucent adhesive tape sends back light that went through it: more of it is global than on
    bare paper."""
    parts = checkerboard(pairs(data_dir, PAIRS))
    fraction = parts.global_ / np.maximum(parts.white, 0.02)
    fraction = cv2.blur(fraction, (9, 9))
    tape, paper = fraction[240, 80], fraction[240, 530]
    assert tape > paper + 0.15
