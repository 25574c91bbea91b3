"""A photograph of a finger: drawn here, an elliptic cylinder with ridges at known distances along
the skin."""

from __future__ import annotations

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.special import ellipeinc

from splitknit.cli.main import main
from splitknit.errors import BadInput
from splitknit_match.prints.fingerphoto import finger_of_photo, fingerphoto, read_fingerphoto
from splitknit_match.prints.photo_mask import finger_in_photo

HALF, PX_PER_MM, PERIOD_MM = 110.0, 220.0 / 17.0, 0.5
SKIN, PAPER = (215.0, 160.0, 140.0), (120.0, 130.0, 140.0)


def drawn(
    turn_deg: float = 0.0, *, across: bool = True, minutiae: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Photograph (520, 460, 3) uint8 and mask; ridges run along the finger (`across` is their
    distance) or round it.

    `minutiae`: so many ridge endings at random places of the pad, as phase dislocations.
    """
    row, column = np.indices((520, 460)).astype(np.float64)
    angle = np.deg2rad(turn_deg)
    x = np.cos(angle) * (column - 230) - np.sin(angle) * (row - 250)
    y = np.sin(angle) * (column - 230) + np.cos(angle) * (row - 250)
    inside = (np.abs(x) < HALF) & ((y > -60) | ((x / HALF) ** 2 + ((y + 60) / HALF) ** 2 < 1))
    polar = np.arcsin(np.clip(x / HALF, -1, 1))
    along = HALF * ellipeinc(polar, 1 - 0.8**2) if across else y
    phase = 2 * np.pi * along / (PERIOD_MM * PX_PER_MM)
    rng = np.random.default_rng(1)
    for sign in rng.choice((-1, 1), minutiae):
        phase += sign * np.arctan2(y - rng.uniform(-100, 160), x - rng.uniform(-80, 80))
    ridges = 1 + 0.12 * np.cos(phase)
    light = (0.45 + 0.55 * np.cos(polar)) * ridges
    picture = np.where(inside[..., None], light[..., None] * SKIN, np.array(PAPER))
    noisy = picture + np.random.default_rng(0).normal(0, 2, picture.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8), inside


def spacings(image: np.ndarray) -> np.ndarray:
    """Distances of the ridges across the middle of a print, pixels."""
    rows = image.shape[0] // 2
    line = cv2.GaussianBlur(
        image[rows : rows + 60].mean(axis=0).astype(np.float32), (1, 5), 1.0
    ).ravel()
    darker = (line[1:-1] < line[:-2]) & (line[1:-1] <= line[2:]) & (line[1:-1] < 128)
    return np.diff(np.flatnonzero(darker))


@pytest.mark.parametrize("turn_deg", [0.0, 35.0, -80.0])
def test_the_finger_is_found_and_turned_upright(turn_deg: float) -> None:
    photo, _ = drawn(turn_deg)
    source = finger_of_photo(photo, PX_PER_MM)
    frame = source.map.input_from_grid
    assert np.rad2deg(np.arctan2(frame[0, 1], frame[1, 1])) == pytest.approx(turn_deg, abs=2.0)
    assert PX_PER_MM * source.pitch_mm == pytest.approx(1.0)  # nothing was reduced
    assert re.search("(16.9|17.0) mm wide", str(source.findings[0]))


def test_unrolled_ridges_lie_as_far_apart_as_on_the_skin() -> None:
    source = finger_of_photo(drawn()[0], PX_PER_MM)
    expected = PERIOD_MM / 25.4 * 500
    unrolled = spacings(source.flat)
    assert unrolled.size >= 30
    assert np.median(unrolled) == pytest.approx(expected, abs=0.6)
    assert np.abs(unrolled[3:-3] - expected).max() < 2.5


def test_an_unknown_scale_is_that_of_usual_widths_and_ridges() -> None:
    source = finger_of_photo(drawn(across=False)[0])
    # 17 mm wide is usual
    assert PX_PER_MM * source.pitch_mm == pytest.approx((0.46 / PERIOD_MM) ** 0.69, rel=0.03)
    assert "assumed, to about 8 %" in str(source.findings[0])


def test_skin_without_ridges_does_not_change_the_scale() -> None:
    photo, inside = drawn(across=False)
    partly, flat = photo.copy(), cv2.GaussianBlur(photo, (0, 0), 5)
    # out of focus above, and as noisy as telephones are
    noise = np.random.default_rng(1).normal(0, 6, photo.shape[:2])
    flat = np.clip(flat + cv2.GaussianBlur(noise, (0, 0), 1.5)[..., None] * 3, 0, 255).astype(
        np.uint8
    )
    partly[:240] = flat[:240]
    clear, some = (finger_of_photo(one, mask=inside) for one in (photo, partly))
    assert some.pitch_mm == pytest.approx(clear.pitch_mm, rel=0.02)
    assert clear.quality is not None
    assert some.quality is not None
    assert some.quality < clear.quality - 15


@pytest.mark.slow
def test_other_pictures_are_refused() -> None:
    nothing = np.full((300, 300, 3), 120, np.uint8)
    nothing[..., 2] = np.random.default_rng(0).integers(100, 140, (300, 300))
    with pytest.raises(BadInput, match="no finger was found"):
        finger_of_photo(nothing)
    for few, words in (
        (nothing[..., :1], "in colour"),
        (nothing[:90, :90], "too small"),
        (drawn()[0][::2, ::2], "nearer"),
    ):
        with pytest.raises(BadInput, match=words):
            finger_of_photo(np.ascontiguousarray(few))
    for close in (drawn()[0][:, 130:335], drawn()[0][200:, 130:335]):  # sides or tip out of view
        with pytest.raises(BadInput, match="its tip in view"):
            finger_of_photo(np.ascontiguousarray(close))
    inside = drawn()[1]
    stripes = np.where(
        inside, 1 + 0.1 * np.sin(np.indices(inside.shape)[0] * (2 * np.pi / 9.4)), 1.0
    )[..., None]
    wide = np.clip(np.where(inside[..., None], SKIN, PAPER) * stripes, 0, 255).astype(np.uint8)
    # 0.73 mm, if it is 17 mm wide
    with pytest.raises(BadInput, match="too far apart or close for its width"):
        finger_of_photo(wide, mask=inside)
    assert finger_of_photo(wide, PX_PER_MM, inside).quality
    with pytest.raises(BadInput, match="the finger's width is"):
        finger_of_photo(drawn()[0], 1.0)


@pytest.mark.slow
def test_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    photo, grey = tmp_path / "photo.jpg", tmp_path / "print.png"
    pixels = drawn(20.0, minutiae=40)[0]
    cv2.imwrite(str(photo), pixels[..., ::-1])
    cv2.imwrite(str(grey), pixels[..., 1])
    assert fingerphoto(photo) is not None
    assert fingerphoto(grey) is None
    assert fingerphoto(tmp_path / "none.jpg") is None
    assert read_fingerphoto(photo, PX_PER_MM).hashes.keys() == {"photo.jpg"}
    assert main(["match", str(photo), str(photo), "--resolution-ppi", str(25.4 * PX_PER_MM)]) == 0
    said = capsys.readouterr().out
    assert "photo.jpg: taken for a photograph of a finger" in said
    assert "photographs of" in said  # what false match rates were measured on
    assert main(["print", str(photo), "--out", str(tmp_path / "out"), "--method", "relief"]) == 2
    assert "photograph of a finger: its --method is photo" in capsys.readouterr().err
    assert main(["print", str(photo), "--out", str(tmp_path / "out")]) == 0
    assert "on the skin laid flat" in capsys.readouterr().out
    assert (tmp_path / "out" / "minutiae.iso").is_file()
    report = json.loads((tmp_path / "out" / "report.json").read_text("utf-8"))
    quality = report["quality"]
    assert quality["nfiq2"] is None  # it is not for contactless pictures
    assert quality["photo"] > 10
    # the last has the one thing to change
    codes = [finding["code"] for finding in report["findings"]]
    assert codes == ["fingerphoto", "fingerphoto-quality"]


@pytest.mark.parametrize("turn_deg", [25.0, 35.0])
def test_a_finger_whose_side_leaves_the_picture_is_found_whole(turn_deg: float) -> None:
    photo, inside = (np.ascontiguousarray(one[:420, :300]) for one in drawn(turn_deg))
    mask = finger_in_photo(photo).mask
    assert (mask & inside).sum() > 0.96 * (mask | inside).sum()


def two() -> np.ndarray:
    """Two fingers beside each other, before leaves of two greens."""
    (one, inside), row = drawn(), np.indices((520, 460))
    leaves = np.where(
        (np.sin(row[0] / 9.0) * np.sin(row[1] / 13.0) > 0)[..., None], (60, 110, 40), (110, 130, 50)
    )
    left, right = (
        np.where(inside[..., None], picture, leaves) for picture in (one, one // 2 + one // 3)
    )
    return np.ascontiguousarray(np.hstack([left, right])[:, 20:-20].astype(np.uint8))


def test_a_finger_among_leaves_and_beside_another_is_found_and_said_or_chosen() -> None:
    pixels, inside = two(), drawn()[1]
    found = finger_in_photo(pixels)
    assert found.others == 1
    truths = [np.pad(inside, ((0, 0), pad))[:, 20:-20] for pad in ((0, 460), (460, 0))]
    covers = [
        np.count_nonzero(found.mask & true) / np.count_nonzero(found.mask | true) for true in truths
    ]
    assert max(covers) > 0.95
    other = 1 - int(np.argmax(covers))
    chosen = finger_in_photo(pixels, (440 * other, 0, 440, 520)).mask
    assert (
        np.count_nonzero(chosen & truths[other]) / np.count_nonzero(chosen | truths[other]) > 0.95
    )


def test_quality_is_that_of_the_ridges_and_says_what_to_change() -> None:
    photo, inside = drawn()
    sharp = finger_of_photo(photo, PX_PER_MM, inside)
    assert sharp.quality is not None
    assert sharp.quality > 80
    blurred = cv2.GaussianBlur(photo, (0, 0), 8)
    with pytest.raises(BadInput, match=r"quality is \d+ of 100, below 10; "):
        finger_of_photo(blurred, PX_PER_MM, inside)


@pytest.mark.parametrize("kind", ["noise", "stripes", "black"])
def test_what_is_no_photograph_of_a_finger_is_refused_in_one_sentence(kind: str) -> None:
    shape = (1200, 900, 3)
    pixels = {
        "noise": lambda: np.random.default_rng(0).integers(0, 256, shape).astype(np.uint8),
        "stripes": lambda: np.where((np.arange(900) // 8 % 2)[:, None], SKIN, 0) * np.ones(shape),
        "black": lambda: np.zeros(shape),
    }[kind]()
    with pytest.raises(BadInput, match=r"no finger was found|in colour"):
        finger_of_photo(np.ascontiguousarray(pixels, dtype=np.uint8))


@pytest.mark.slow
def test_box_and_mask_are_refused_where_they_cannot_be_meant(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    photo, grey, mask = (tmp_path / name for name in ("photo.png", "grey.png", "mask.png"))
    pixels, inside = drawn()
    cv2.imwrite(str(photo), pixels[..., ::-1])
    cv2.imwrite(str(grey), pixels[..., 1])
    cv2.imwrite(str(mask), inside[:-1].astype(np.uint8) * 255)
    for command, words in (
        (["match", photo, photo, "--box", "1,2,3"], "must be four whole numbers X,Y,W,H"),
        (
            ["match", photo, photo, "--box", "0,0,900,90"],
            "must lie in the picture of 460 x 520 pixels",
        ),
        (["print", photo, "--out", tmp_path / "out", "--mask", mask], "mask"),
        (["print", grey, "--out", tmp_path / "out", "--box", "0,0,99,99"], f"'{grey}' is none"),
        (
            [
                "enroll",
                tmp_path / "a.skg",
                grey,
                "--person",
                "A",
                "--finger",
                "left_index",
                "--box",
                "0,0,99,99",
            ],
            "is none",
        ),
    ):
        assert main([str(word) for word in command]) == 2
        assert words in capsys.readouterr().err
        assert not (tmp_path / "out").exists()
        assert not (tmp_path / "a.skg").exists()
