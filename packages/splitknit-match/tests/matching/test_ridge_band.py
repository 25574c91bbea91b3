"""The ridge band: pitch, direction, contrast, unrolling, skin without ridges."""

from __future__ import annotations

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.imaging.geometry import rotation_about
from splitknit_match.matching.ridge_band import print_band, ridge_band

PITCH = 0.05


def stripes(turn: float, period_mm: float = 0.45, side: int = 300) -> np.ndarray:
    """Ridges whose normal points `turn` counter-clockwise from x."""
    rows, columns = np.mgrid[0:side, 0:side]
    across = columns * np.cos(turn) - rows * np.sin(turn)
    return (0.03 * np.sin(2 * np.pi * PITCH / period_mm * across)).astype(np.float32)


@pytest.mark.parametrize("turn", [0.0, 0.5, 1.2, -0.9])
def test_ridges_of_any_direction_get_the_same_contrast(turn: float) -> None:
    gain = np.linspace(0.5, 2.0, 300, dtype=np.float32)  # contrast that changes over the finger
    band = ridge_band(stripes(turn) * gain, np.ones((300, 300), np.bool_), PITCH)
    assert band.value.shape == (150, 150)
    assert band.pitch_mm == 0.1
    inner = slice(30, -30), slice(30, -30)
    assert band.valid[inner].all()
    assert band.value[inner].std() == pytest.approx(1.0, abs=0.1)
    left, right = band.value[30:-30, 30:60].std(), band.value[30:-30, 90:120].std()
    assert left == pytest.approx(right, rel=0.1)


def test_wide_shapes_are_taken_out() -> None:
    _, columns = np.mgrid[0:300, 0:300]
    hill = (0.5 * np.cos((columns - 150) / 100)).astype(np.float32)
    mask = np.ones((300, 300), np.bool_)
    plain, hilly = (
        ridge_band(stripes(0.4) + extra, mask, PITCH).value for extra in (0 * hill, hill)
    )
    inner = slice(25, -25), slice(25, -25)
    assert np.corrcoef(plain[inner].ravel(), hilly[inner].ravel())[0, 1] > 0.99


def test_ridges_even_on_a_cylinder_are_even_in_the_band() -> None:
    radius, side = 8.0, 300
    x = (np.arange(side) - 149.5) * PITCH  # up to 69 deg of slant
    arc = radius * np.arcsin(x / radius)
    ridge = np.broadcast_to(0.03 * np.sin(2 * np.pi * arc / 0.5), (side, side)).astype(np.float32)
    shape = np.broadcast_to(np.sqrt(radius**2 - x**2), (side, side)).astype(np.float32)
    mask = np.ones((side, side), np.bool_)
    band = ridge_band(ridge, mask, PITCH, shape)
    line = band.value[75]
    known = np.flatnonzero(band.valid[75])
    assert np.ptp(known) * 0.1 > 2 * radius * np.deg2rad(58)
    crossings = known[:-1][(line[known[:-1]] < 0) & (line[known[:-1] + 1] >= 0)]
    places = crossings - line[crossings] / (line[crossings + 1] - line[crossings])
    # one crossing a period of 0.5 mm, nearly from side to side
    np.testing.assert_allclose(np.diff(places)[1:-1], 5.0, atol=0.25)
    np.testing.assert_allclose(np.diff(places)[8:-8], 5.0, atol=0.06)


def test_a_turned_finger_unrolls_as_an_upright_one() -> None:
    side, radius = 300, 8.0
    rows, columns = np.mgrid[0:side, 0:side].astype(float)
    bands = []
    for turn in (0.0, 0.5):
        frame = rotation_about((149.5, 149.5), turn)
        back = np.linalg.inv(frame)
        x = (back[0, 0] * columns + back[0, 1] * rows + back[0, 2] - 149.5) * PITCH
        y = (back[1, 0] * columns + back[1, 1] * rows + back[1, 2] - 149.5) * PITCH
        mask = (np.abs(x) < 5.5) & (np.abs(y) < 4.5)
        arc = radius * np.arcsin(np.clip(x / radius, -0.9, 0.9))
        ridge = (0.03 * np.sin(2 * np.pi * arc / 0.5 + y)).astype(np.float32)
        shape = np.sqrt(radius**2 - np.minimum(x * x, 40.0)).astype(np.float32)
        bands.append(ridge_band(ridge, mask, PITCH, shape, frame, (side, side)))
    inner = [band.value[40:110] for band in bands]
    width = min(part.shape[1] for part in inner)
    middles = [(part.shape[1] - width) // 2 for part in inner]
    parts = [part[:, m : m + width].ravel() for part, m in zip(inner, middles, strict=True)]
    assert np.corrcoef(*parts)[0, 1] > 0.9


def test_skin_without_ridges_is_left_out() -> None:
    rng = np.random.default_rng(0)
    relief = stripes(0.3)
    relief[:, 150:] = 0.0005 * rng.normal(size=(300, 150))
    band = ridge_band(relief, np.ones((300, 300), np.bool_), PITCH)
    assert band.valid[20:-20, 10:65].all()
    assert not band.valid[20:-20, 90:].any()


def test_prints_are_mirrored_and_inverted() -> None:
    ridge = stripes(0.5)
    # ink: ridges dark, mirrored
    picture = np.clip(128 - 3000 * ridge[:, ::-1], 0, 255).astype(np.uint8)
    from_print = print_band(picture, 25.4 / PITCH)
    band = ridge_band(ridge, np.ones((300, 300), np.bool_), PITCH)
    inner = slice(25, -25), slice(25, -25)
    assert np.corrcoef(from_print.value[inner].ravel(), band.value[inner].ravel())[0, 1] > 0.95


def test_impossible_pitches_heights_and_sizes_are_refused() -> None:
    relief, mask = np.zeros((20, 20), np.float32), np.ones((20, 20), np.bool_)
    with pytest.raises(BadInput, match="pitch"):
        ridge_band(relief, mask, 0.0)
    for pitch_mm, words in ((1e-300, "pitch_mm"), (1e9, "pitch_mm"), (9.0, "more than a finger's")):
        with pytest.raises(BadInput, match=words):
            ridge_band(np.zeros((60, 60), np.float32), np.ones((60, 60), bool), pitch_mm)
    with pytest.raises(BadInput, match="ridge_mm holds heights"):
        ridge_band(relief + np.float32(1e30), mask, 0.1)
    with pytest.raises(BadInput, match="shape_mm"):
        ridge_band(relief, mask, 0.1, np.zeros((5, 5), np.float32))
    with pytest.raises(BadInput, match="NaN"):
        ridge_band(np.full((20, 20), np.nan, np.float32), mask, 0.1)
    with pytest.raises(BadInput, match="uint8"):
        print_band(relief)  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="ppi"):
        print_band(np.zeros((5, 5), np.uint8), -1.0)
    with pytest.raises(BadInput, match="more than a finger's"):  # 2.4 GB from a small archive
        ridge_band(relief, mask, 0.05, relief, np.diag([0.01, 0.01, 1.0]), (10_000, 10_000))
