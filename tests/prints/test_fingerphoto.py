"""A photograph of a finger: drawn here, an elliptic cylinder with ridges at known distances along the skin."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.special import ellipeinc

from splitknit.cli.main import main
from splitknit.errors import BadInput
from splitknit.prints.fingerphoto import is_fingerphoto, read_fingerphoto, source_of_photo
from splitknit.prints.make import make_print

HALF, PX_PER_MM, PERIOD_MM = 110.0, 220.0 / 17.0, 0.5
SKIN, PAPER = (215.0, 160.0, 140.0), (120.0, 130.0, 140.0)


def drawn(turn_deg: float = 0.0, *, across: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Photograph (520, 460, 3) uint8 and mask; ridges run along the finger (`across` is their distance) or round it."""
    row, column = np.indices((520, 460)).astype(np.float64)
    angle = np.deg2rad(turn_deg)
    x = np.cos(angle) * (column - 230) - np.sin(angle) * (row - 250)
    y = np.sin(angle) * (column - 230) + np.cos(angle) * (row - 250)
    inside = (np.abs(x) < HALF) & ((y > -60) | ((x / HALF) ** 2 + ((y + 60) / HALF) ** 2 < 1))
    polar = np.arcsin(np.clip(x / HALF, -1, 1))
    along = HALF * ellipeinc(polar, 1 - 0.8**2) if across else y
    ridges = 1 + 0.12 * np.cos(2 * np.pi * along / (PERIOD_MM * PX_PER_MM))
    light = (0.45 + 0.55 * np.cos(polar)) * ridges
    picture = np.where(inside[..., None], light[..., None] * SKIN, np.array(PAPER))
    noisy = picture + np.random.default_rng(0).normal(0, 2, picture.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8), inside


def spacings(image: np.ndarray) -> np.ndarray:
    """Distances of the ridges across the middle of a print, pixels."""
    rows = image.shape[0] // 2
    line = cv2.GaussianBlur(image[rows : rows + 60].mean(axis=0).astype(np.float32), (1, 5), 1.0).ravel()
    darker = (line[1:-1] < line[:-2]) & (line[1:-1] <= line[2:]) & (line[1:-1] < 128)
    return np.diff(np.flatnonzero(darker))


@pytest.mark.parametrize("turn_deg", [0.0, 35.0, -80.0])
def test_the_finger_is_found_and_turned_upright(turn_deg: float) -> None:
    photo, inside = drawn(turn_deg)
    source = source_of_photo(photo, PX_PER_MM)
    frame = source.input_from_upright
    assert np.rad2deg(np.arctan2(frame[0, 1], frame[1, 1])) == pytest.approx(turn_deg, abs=2.0)
    assert 25.4 * PX_PER_MM * source.pitch_mm == pytest.approx(25.4)  # nothing was reduced
    kept = 1.5 * 2 * HALF * 2 * HALF - (2 - np.pi / 2) * HALF**2  # one and a half widths, less what the tip lacks
    assert 0.9 * kept < source.mask.sum() < 1.1 * min(kept, float(inside.sum()))
    assert source.shape_mm is not None
    assert source.shape_mm.max() == pytest.approx(0.8 * HALF / PX_PER_MM, rel=0.03)
    assert re.search("(16.9|17.0) mm wide", source.scale)


def test_unrolled_ridges_lie_as_far_apart_as_on_the_skin() -> None:
    source = source_of_photo(drawn()[0], PX_PER_MM)
    expected = PERIOD_MM / 25.4 * 500
    plane, unrolled = (spacings(make_print(source, "photo", place).image) for place in (None, "free"))
    assert unrolled.size >= 35  # 1.43 widths along the skin, 34 mm wide at most
    assert np.median(unrolled) == pytest.approx(expected, abs=0.6)
    assert np.abs(unrolled[3:-3] - expected).max() < 2.5
    assert plane[3:-3].min() < 0.75 * expected < 0.9 * unrolled[3:-3].min()


def test_an_unknown_scale_is_that_of_usual_widths_and_ridges() -> None:
    source = source_of_photo(drawn(across=False)[0])
    assert PX_PER_MM * source.pitch_mm == pytest.approx((0.46 / PERIOD_MM) ** 0.69, rel=0.03)  # 17 mm wide is usual
    assert "assumed, to about 8 %" in source.scale


def test_other_pictures_are_refused() -> None:
    nothing = np.full((300, 300, 3), 120, np.uint8)
    nothing[..., 2] = np.random.default_rng(0).integers(100, 140, (300, 300))
    with pytest.raises(BadInput, match="no finger was found"):
        source_of_photo(nothing)
    for few, words in (
        (nothing[..., :1], "in colour"),
        (nothing[:90, :90], "too small"),
        (drawn()[0][::2, ::2], "nearer"),
    ):
        with pytest.raises(BadInput, match=words):
            source_of_photo(np.ascontiguousarray(few))
    with pytest.raises(BadInput, match="touches"):
        source_of_photo(np.ascontiguousarray(drawn()[0][:, 130:335]))
    with pytest.raises(BadInput, match="nothing is redder"):
        source_of_photo(np.ascontiguousarray(drawn()[0][200:, 130:335]))
    with pytest.raises(BadInput, match="the finger's width is"):
        source_of_photo(drawn()[0], 1.0)


def test_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    photo, grey = tmp_path / "photo.jpg", tmp_path / "print.png"
    pixels = drawn(20.0)[0]
    cv2.imwrite(str(photo), pixels[..., ::-1])
    cv2.imwrite(str(grey), pixels[..., 1])
    assert is_fingerphoto(photo)
    assert not is_fingerphoto(grey)
    assert not is_fingerphoto(tmp_path / "none.jpg")
    assert read_fingerphoto(photo, PX_PER_MM).hashes.keys() == {"photo.jpg"}
    assert main(["match", str(photo), str(photo), "--input-ppi", str(25.4 * PX_PER_MM)]) == 0
    said = capsys.readouterr().out
    assert "photo.jpg: taken for a photograph of a finger" in said
    assert "photographs of" in said  # what false match rates were measured on
    assert main(["print", str(photo), "--out", str(tmp_path / "out"), "--method", "relief"]) == 2
    assert "photograph of a finger: its --method is photo" in capsys.readouterr().err
    assert main(["print", str(photo), "--out", str(tmp_path / "out")]) == 0
    assert "on the skin laid flat" in capsys.readouterr().out
    assert (tmp_path / "out" / "minutiae.iso").is_file()
