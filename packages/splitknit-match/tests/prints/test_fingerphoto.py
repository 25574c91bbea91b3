"""Drawn photographs of a finger: an elliptic cylinder with ridges at known distances."""

import json
import re

import cv2
import numpy as np
import pytest

from drawn_photo import PAPER, PERIOD_MM, PX_PER_MM, SKIN, drawn
from refusals import bad_input
from splitknit.cli.main import main
from splitknit_match.prints.fingerphoto import finger_of_photo, fingerphoto, read_fingerphoto
from splitknit_match.prints.photo_finger import PhotoFinger
from splitknit_match.prints.photo_mask import finger_in_photo


def spacings(image):
    """Distances of the ridges across the middle of a print, pixels."""
    rows = image.shape[0] // 2
    line = image[rows : rows + 60].mean(axis=0).astype(np.float32)
    line = cv2.GaussianBlur(line, (1, 5), 1.0).ravel()
    darker = (line[1:-1] < line[:-2]) & (line[1:-1] <= line[2:]) & (line[1:-1] < 128)
    return np.diff(np.flatnonzero(darker))


@pytest.mark.parametrize("turn_deg", [0.0, 35.0, -80.0])
def test_a_turned_finger_is_made_upright(turn_deg):
    photo, _ = drawn(turn_deg)
    source = finger_of_photo(photo, PX_PER_MM)
    frame = source.map.input_from_grid
    assert np.rad2deg(np.arctan2(frame[0, 1], frame[1, 1])) == pytest.approx(turn_deg, abs=2.0)
    assert PX_PER_MM * source.pitch_mm == pytest.approx(1.0)  # nothing was reduced
    assert re.search("(16.9|17.0) mm wide", str(source.findings[0]))


def test_unrolled_ridges_lie_as_far_apart_as_on_the_skin():
    source = finger_of_photo(drawn()[0], PX_PER_MM)
    expected = PERIOD_MM / 25.4 * 500
    unrolled = spacings(source.flat)
    assert unrolled.size >= 30
    assert np.median(unrolled) == pytest.approx(expected, abs=0.6)
    assert np.abs(unrolled[3:-3] - expected).max() < 2.5


def test_an_unknown_scale_is_that_of_usual_widths_and_ridges():
    source = finger_of_photo(drawn(across=False)[0])
    # 17 mm wide is usual
    assert PX_PER_MM * source.pitch_mm == pytest.approx((0.46 / PERIOD_MM) ** 0.69, rel=0.03)
    assert "assumed, to about 8 %" in str(source.findings[0])


def test_skin_without_ridges_does_not_change_the_scale():
    photo, inside = drawn(across=False)
    partly, flat = photo.copy(), cv2.GaussianBlur(photo, (0, 0), 5)
    # out of focus above, and as noisy as telephones are
    noise = np.random.default_rng(1).normal(0, 6, photo.shape[:2])
    noisy = flat + cv2.GaussianBlur(noise, (0, 0), 1.5)[..., None] * 3
    partly[:240] = np.clip(noisy, 0, 255).astype(np.uint8)[:240]
    sharp, half_sharp = (finger_of_photo(image, mask=inside) for image in (photo, partly))
    assert half_sharp.pitch_mm == pytest.approx(sharp.pitch_mm, rel=0.02)
    assert half_sharp.quality < sharp.quality - 15


@pytest.mark.slow
def test_photographs_without_a_whole_finger_in_colour_are_refused():
    empty, photo = np.full((300, 300, 3), 120, np.uint8), drawn()[0]
    empty[..., 2] = np.random.default_rng(0).integers(100, 140, (300, 300))
    for image, words in (
        (empty, "no finger was found"),
        (empty[..., :1], "in colour"),
        (empty[:90, :90], "too small"),
        (photo[::2, ::2], "nearer"),
        (photo[:, 130:335], "its tip in view"),  # its sides are out of view
        (photo[200:, 130:335], "its tip in view"),
    ):
        with bad_input(words):
            finger_of_photo(np.ascontiguousarray(image))
    with bad_input("the finger's width is"):
        finger_of_photo(photo, 1.0)


@pytest.mark.parametrize("scale", [1.0, 1.7])
def test_skin_to_the_edges_of_a_picture_is_flat(scale):
    photo, _ = drawn(20.0, minutiae=40)
    crop = cv2.resize(np.ascontiguousarray(photo[180:420, 150:310]), None, fx=scale, fy=scale)
    source = finger_of_photo(crop)
    assert "skin to its edges" in str(source.findings[0])
    assert source.quality > 80
    assert source.map.surface == "plane"
    # ridges of the middle lie 0.50 mm apart, those of the curved sides closer
    assert PX_PER_MM * scale * source.pitch_mm == pytest.approx(0.46 / PERIOD_MM, rel=0.06)
    px = crop.shape[1] / source.flat.shape[1]
    assert px * 500 / 25.4 * source.pitch_mm == pytest.approx(1.0, rel=0.02)
    assert source.map.columns[0, 0] > source.map.columns[0, -1]  # mirrored, as paper shows it
    with bad_input("no finger was found"):  # smooth skin is none
        finger_of_photo(cv2.GaussianBlur(crop, (0, 0), 8 * scale))


def test_ridges_of_0_73_mm_need_a_known_scale():
    inside = drawn()[1]
    wave = 1 + 0.1 * np.sin(np.indices(inside.shape)[0] * (2 * np.pi / 9.4))
    skin = np.where(inside[..., None], SKIN, PAPER) * np.where(inside, wave, 1.0)[..., None]
    wide = np.clip(skin, 0, 255).astype(np.uint8)
    # 0.73 mm, if it is 17 mm wide
    with bad_input("too far apart or close for its width"):
        finger_of_photo(wide, mask=inside)
    assert finger_of_photo(wide, PX_PER_MM, inside).quality


@pytest.fixture
def photo(tmp_path):
    file = tmp_path / "photo.jpg"
    cv2.imwrite(str(file), drawn(20.0, minutiae=40)[0][..., ::-1])
    return file


def test_only_files_in_colour_are_photographs(photo, tmp_path, monkeypatch):
    grey = tmp_path / "print.png"
    cv2.imwrite(str(grey), cv2.imread(str(photo), cv2.IMREAD_GRAYSCALE))
    assert fingerphoto(photo) is not None
    with monkeypatch.context() as change:
        change.setattr("splitknit_match.prints.fingerphoto.decode_photo", None)
        assert fingerphoto(grey) is None  # by its header
    assert fingerphoto(tmp_path / "none.jpg") is None


@pytest.mark.slow
def test_photographs_are_matched_by_rates_of_photographs(photo, capsys):
    assert read_fingerphoto(photo, PX_PER_MM).hashes.keys() == {"photo.jpg"}
    assert main([*f"match {photo} {photo} --resolution-ppi".split(), str(25.4 * PX_PER_MM)]) == 0
    printed = capsys.readouterr().out
    assert "photo.jpg: taken for a photograph of a finger" in printed
    assert "photographs of" in printed


@pytest.mark.slow
def test_a_photograph_is_printed_with_its_quality(photo, tmp_path, capsys):
    out = tmp_path / "out"
    assert main(f"print {photo} --out {out} --method relief".split()) == 2
    assert "photograph of a finger: its --method is photo" in capsys.readouterr().err
    assert main(f"print {photo} --out {out}".split()) == 0
    assert "on the skin laid flat" in capsys.readouterr().out
    assert (out / "minutiae.iso").is_file()
    report = json.loads((out / "report.json").read_text("utf-8"))
    assert report["quality"]["nfiq2"] is None  # it is not for contactless pictures
    assert report["quality"]["photo"] > 10
    # the last is the advice
    codes = [finding["code"] for finding in report["findings"]]
    assert codes == ["fingerphoto", "fingerphoto-quality"]


@pytest.mark.parametrize("turn_deg", [25.0, 35.0])
def test_a_finger_whose_side_leaves_the_picture_is_segmented_whole(turn_deg):
    photo, inside = (np.ascontiguousarray(image[:420, :300]) for image in drawn(turn_deg))
    assert overlap(finger_in_photo(photo).mask, inside) > 0.96


def overlap(mask, true):
    """Intersection over union."""
    return float((mask & true).sum() / (mask | true).sum())


def two_fingers():
    """Two fingers beside each other, before leaves of two greens, and their masks."""
    (photo, inside), (row, column) = drawn(), np.indices((520, 460))
    dark = (np.sin(row / 9.0) * np.sin(column / 13.0) > 0)[..., None]
    leaves = np.where(dark, (60, 110, 40), (110, 130, 50))
    fingers = photo, photo // 2 + photo // 3
    both = np.hstack([np.where(inside[..., None], finger, leaves) for finger in fingers])
    masks = [np.pad(inside, ((0, 0), pad))[:, 20:-20] for pad in ((0, 460), (460, 0))]
    return np.ascontiguousarray(both[:, 20:-20].astype(np.uint8)), masks


def test_of_two_fingers_among_leaves_either_can_be_chosen():
    pixels, masks = two_fingers()
    finger = finger_in_photo(pixels)
    assert finger.others == 1
    overlaps = [overlap(finger.mask, true) for true in masks]
    assert max(overlaps) > 0.95
    second = int(np.argmin(overlaps))
    chosen = finger_in_photo(pixels, (440 * second, 0, 440, 520)).mask
    assert overlap(chosen, masks[second]) > 0.95


def test_a_blurred_photograph_is_refused_with_its_quality():
    photo, inside = drawn()
    sharp = finger_of_photo(photo, PX_PER_MM, inside)
    assert sharp.quality > 80
    blurred = cv2.GaussianBlur(photo, (0, 0), 8)
    with bad_input(r"quality is \d+ of 100, below 10; "):
        finger_of_photo(blurred, PX_PER_MM, inside)


@pytest.mark.parametrize("kind", ["noise", "stripes", "black"])
def test_large_images_of_no_finger_are_refused(kind):
    shape = (1200, 900, 3)
    pixels = {
        "noise": lambda: np.random.default_rng(0).integers(0, 256, shape).astype(np.uint8),
        "stripes": lambda: np.where((np.arange(900) // 8 % 2)[:, None], SKIN, 0) * np.ones(shape),
        "black": lambda: np.zeros(shape),
    }[kind]()
    with bad_input(r"no finger was found|in colour"):
        finger_of_photo(np.ascontiguousarray(pixels, dtype=np.uint8))


@pytest.mark.slow
def test_a_box_or_mask_that_does_not_fit_the_photograph_is_refused(tmp_path, capsys):
    photo, grey, mask = (str(tmp_path / name) for name in ("photo.png", "grey.png", "mask.png"))
    pixels, inside = drawn()
    cv2.imwrite(photo, pixels[..., ::-1])
    cv2.imwrite(grey, pixels[..., 1])
    cv2.imwrite(mask, inside[:-1].astype(np.uint8) * 255)
    out, gallery = tmp_path / "out", tmp_path / "a.skg"
    whose = ["--person", "A", "--finger", "left_index"]
    outside = "must lie in the picture of 460 x 520 pixels"
    for command, words in (
        (["match", photo, photo, "--box", "1,2,3"], "must be four whole numbers X,Y,W,H"),
        (["match", photo, photo, "--box", "0,0,900,90"], outside),
        (["print", photo, "--out", str(out), "--mask", mask], "mask"),
        (["print", grey, "--out", str(out), "--box", "0,0,99,99"], f"'{grey}' is none"),
        (["enroll", str(gallery), grey, *whose, "--box", "0,0,99,99"], "is none"),
    ):
        assert main(command) == 2
        assert words in capsys.readouterr().err
        assert not out.exists()
        assert not gallery.exists()


def on_pale_ground(ridge_contrast, *, finger=1.0, shadow=0.0):
    """Photograph by soft daylight, without flash, of a finger on a ground of nearly its colour, and
    its mask. `finger`: 0 leaves the ground alone; `shadow`: of a hand's finger on it, soft."""
    _, inside = drawn(8.0)
    inside = cv2.resize(inside.astype(np.uint8), (920, 1040), interpolation=cv2.INTER_NEAREST) > 0
    row, column = np.indices(inside.shape).astype(np.float32)
    depth = cv2.distanceTransform(inside.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    round_ = np.sqrt(1 - (1 - np.clip(depth / 220, 0, 1)) ** 2)
    ridges = 1 + ridge_contrast * np.cos(2 * np.pi * row / 12 + 1.5 * np.sin(column / 95))
    skin = ((0.75 + 0.25 * round_) * ridges)[..., None] * np.array([0.70, 0.62, 0.55])
    soft = cv2.GaussianBlur(inside.astype(np.float32), (0, 0), 12)[..., None]
    ground = np.array([0.72, 0.68, 0.62]) * (1 - shadow * soft)
    light = np.where(inside[..., None] & (finger > 0), skin, ground)
    vignette = 1 - 0.4 * ((row - 520) ** 2 + (column - 460) ** 2) / (520**2 + 460**2)
    light = cv2.GaussianBlur(0.8 * light * vignette[..., None], (0, 0), 1.0)
    light += np.random.default_rng(0).normal(0, 0.004, light.shape)
    return np.rint(255 * np.clip(light, 0, 1) ** (1 / 2.2)).astype(np.uint8), inside


@pytest.mark.parametrize("ridge_contrast", [0.03, 0.06])
def test_a_finger_on_a_ground_of_nearly_its_colour_is_segmented(ridge_contrast):
    photo, inside = on_pale_ground(ridge_contrast)
    assert overlap(finger_in_photo(photo).mask, inside) > 0.95


@pytest.mark.parametrize(
    ("ridge_contrast", "finger", "shadow"),
    [(0.0, 0.0, 0.0), (0.0, 0.0, 0.3), (0.0, 1.0, 0.0)],
    ids=["ground alone", "a hand's shadow", "a smooth strip"],
)
def test_a_pale_ground_without_a_finger_is_refused(ridge_contrast, finger, shadow):
    photo, _ = on_pale_ground(ridge_contrast, finger=finger, shadow=shadow)
    with bad_input("no finger was found"):
        finger_in_photo(photo)


def test_a_mask_of_another_size_is_refused_by_its_header(photo, tmp_path):
    mask = tmp_path / "mask.png"
    cv2.imwrite(str(mask), np.full((20, 30), 255, np.uint8))
    mask.write_bytes(mask.read_bytes()[:50])
    with bad_input("has 20 x 30 pixels"):
        read_fingerphoto(photo, PX_PER_MM, PhotoFinger(mask))
