"""Prints from files of any format and resolution, brought to 500 ppi with the drawn minutiae."""

import io
import re

import cv2
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

from fmr_samples import three_minutiae
from refusals import bad_input
from spiral_prints import PLACES, spiral_print
from splitknit_match import enroll, identify, match
from splitknit_match.matching.inputs import held, read_side
from splitknit_match.prints.from_file import (
    minutiae_of,
    pressed_print,
    print_at_500_ppi,
    read_one_finger,
    read_print_file,
    resolution_doubt,
    ridge_period_px,
)
from splitknit_match.prints.make import enhance, minutiae_by_phase
from splitknit_match.records.pictures import PrintFile


def saved(image, kind, ppi, **more):
    """As Pillow writes it."""
    stream, dpi = io.BytesIO(), {} if ppi is None else {"dpi": (ppi, ppi)}
    Image.fromarray(image).save(stream, kind, **dpi | more)
    return stream.getvalue()


def assert_drawn_minutiae(image):
    """All but one are extracted within 0.25 mm, and at most three others."""
    pressed = pressed_print(PrintFile(image, 500.0, {}))
    minutiae = minutiae_by_phase(pressed, enhance(pressed))
    x, y = PLACES.T
    apart = np.hypot(minutiae.x_px[:, None] - x, minutiae.y_px[:, None] - y)
    assert (apart.min(axis=0) < 5).sum() >= len(PLACES) - 1
    assert (apart.min(axis=1) >= 5).sum() <= 3


EXIF = Image.Exif()
EXIF[282] = EXIF[283] = 600.0
EXIF[296] = 2


def coloured(*seeds):
    return np.stack([spiral_print(seed=seed) for seed in seeds], axis=-1)


@pytest.mark.parametrize(
    ("scale", "data"),
    [
        (1.0, lambda: saved(spiral_print(), "PNG", 500)),
        (2.0, lambda: saved(spiral_print(scale=2.0), "PNG", 1000)),
        (0.6, lambda: saved(spiral_print(scale=0.6), "TIFF", 300)),
        (1.2, lambda: saved(spiral_print(scale=1.2), "JPEG", 600, quality=90)),
        (1.2, lambda: saved(spiral_print(scale=1.2), "JPEG", None, quality=90, exif=EXIF)),
        (1.6, lambda: saved(spiral_print(scale=1.6), "BMP", 800)),
        (1.0, lambda: saved(coloured(1, 1, 1), "PNG", 500)),
        (1.0, lambda: saved(coloured(1, 1, 1), "JPEG", 500, quality=80)),
        (1.0, lambda: saved(spiral_print().astype(np.uint16) * 257, "PNG", 500)),
    ],
    ids=[
        "png",
        "png 1000",
        "tiff 300",
        "jpeg 600",
        "exif 600",
        "bmp 800",
        "rgb",
        "rgb jpeg",
        "16 bits",
    ],
)
def test_every_format_and_resolution_gives_the_same_print(tmp_path, scale, data):
    file = tmp_path / "scan.of.a.print"  # the bytes show the format
    file.write_bytes(data())
    (stored,) = read_print_file(file)
    assert isinstance(stored, PrintFile)
    assert stored.resolution_ppi == pytest.approx(500 * scale, rel=1e-3)
    image = print_at_500_ppi(stored).image
    assert image.shape == (500, 380)
    assert_drawn_minutiae(image)


@pytest.mark.parametrize(
    ("scale", "low", "high"), [(0.6, 210, 410), (1.0, 350, 680), (2.0, 700, 1370)]
)
def test_a_print_without_resolution_is_refused_with_an_estimate(tmp_path, scale, low, high):
    file = tmp_path / "scan.png"
    file.write_bytes(saved(spiral_print(scale=scale), "PNG", None))
    with bad_input(r"does not state its resolution; .* fits (\d+) to (\d+) pixels") as refused:
        read_one_finger(file)
    message = str(refused.value)
    assert "\n" not in message
    assert "`resolution_ppi` 500" in message
    stated = [int(ppi) for ppi in re.findall(r"fits (\d+) to (\d+)", message)[0]]
    assert_allclose(stated, [low, high], rtol=0.08)
    stored = read_one_finger(file, 500 * scale)
    assert isinstance(stored, PrintFile)
    assert print_at_500_ppi(stored).image.shape == (500, 380)


@pytest.mark.parametrize("kind", ["PNG", "TIFF", "JPEG", "BMP"])
def test_pixels_that_are_not_square_are_made_so(kind, tmp_path):
    # 375 ppi along the columns
    narrow = cv2.resize(spiral_print(), (285, 500), interpolation=cv2.INTER_AREA)
    quality = {"quality": 95} if kind == "JPEG" else {}
    (tmp_path / "scan").write_bytes(saved(narrow, kind, None, dpi=(375, 500), **quality))
    stored = read_one_finger(tmp_path / "scan")
    assert isinstance(stored, PrintFile)
    assert stored.image.shape == (500, 380)
    assert stored.resolution_ppi == pytest.approx(500, rel=1e-3)
    assert "375 by 500 ppi were made square" in str(stored.findings[0])
    assert_drawn_minutiae(stored.image)


def on_paper(image):
    return np.pad(image, 60, constant_values=255)


def test_white_ridges_are_turned_dark_and_reported(tmp_path):
    file = tmp_path / "scan.png"
    down, right = np.mgrid[-1:1:500j, -1:1:380j]
    # it fades out, as where a finger touches less
    touching = np.clip(3 - 3 * np.hypot(down, right), 0, 1)
    image = on_paper(np.round(255 - (255.0 - spiral_print()) * touching).astype(np.uint8))
    file.write_bytes(saved(255 - image, "PNG", 500))
    stored = read_one_finger(file)
    assert isinstance(stored, PrintFile)
    assert [finding.code for finding in stored.findings] == ["white-ridges"]
    assert_array_equal(stored.image, image)


def test_ridges_are_turned_only_where_they_are_surely_light(tmp_path):
    """A wet print has a ground that is darker than its middle."""
    file, ground = tmp_path / "scan.png", 60
    down, right = np.mgrid[-1:1:500j, -1:1:380j]
    touching = np.clip(3 - 3 * np.hypot(down, right), 0, 1)
    print_ = ground + (255.0 - spiral_print() - ground) * touching
    wet = np.pad(np.round(print_).astype(np.uint8), 60, constant_values=ground)
    file.write_bytes(saved(wet, "PNG", 500))
    found = read_one_finger(file)
    assert isinstance(found, PrintFile)
    assert_array_equal(found.image, wet)
    assert [finding.code for finding in found.findings] == ["unknown-polarity"]


@pytest.mark.parametrize("ridges", ["dark", "light"])
def test_stated_ridges_are_taken_as_stated(ridges, tmp_path):
    image = spiral_print()
    file, other = tmp_path / "scan.png", 255 - image
    for picture in (image, other):
        file.write_bytes(saved(picture, "PNG", 500))
        found = read_one_finger(file, ridges=ridges)
        assert isinstance(found, PrintFile)
        assert not found.findings
        assert_array_equal(found.image, picture if ridges == "dark" else 255 - picture)


def test_ridges_of_arrays_are_dark_unless_stated():
    down, right = np.mgrid[-1:1:500j, -1:1:380j]
    touching = np.clip(3 - 3 * np.hypot(down, right), 0, 1)
    light = on_paper(np.round((255.0 - spiral_print()) * touching).astype(np.uint8))
    light[:60], light[-60:], light[:, :60], light[:, -60:] = 0, 0, 0, 0
    for ridges, picture in ((None, light), ("light", 255 - light)):
        side = read_side(held(light, 500, ridges), "metric")
        assert side.findings == ()
        assert_array_equal(side.picture, picture)


@pytest.mark.slow
def test_both_readings_are_compared_where_nothing_shows_which_is_right(tmp_path):
    small = spiral_print()[100:200, 100:200]
    files = [tmp_path / name for name in ("whole.png", "negative.png", "impostor.png")]
    pictures = (spiral_print(), 255 - small, 255 - small[:, ::-1])
    for file, picture in zip(files, pictures, strict=True):
        file.write_bytes(saved(picture, "PNG", 500))
    whole, negative, impostor = files
    light = match(negative, whole)
    assert light.answer == "match"
    assert [finding.code for finding in light.findings] == ["white-ridges"]
    upright = match(np.ascontiguousarray(small), whole, resolution_ppi=500)
    assert light.similarity == pytest.approx(upright.similarity, abs=0.5)
    assert match(negative, whole, ridges="dark").answer != "match"
    gallery = tmp_path / "people.skg"
    enroll(gallery, whole, person="Ann", finger="left_index", ridges="dark")
    found = identify(gallery, negative)
    assert found.answer == "match"
    assert found.candidates[0].similarity == light.similarity
    for result in (match(impostor, whole), identify(gallery, impostor)):
        assert result.answer != "match"
        assert not result.findings


def test_ridges_that_end_abruptly_are_of_unknown_polarity(tmp_path):
    file, window = tmp_path / "scan.png", spiral_print()[120:380, 90:290]
    for image in (window, 255 - window, 255 - on_paper(spiral_print())):
        file.write_bytes(saved(image, "PNG", 500))
        codes = [finding.code for finding in read_one_finger(file).findings]
        assert codes == ["unknown-polarity"]


def test_ridges_that_lie_close_at_the_stated_resolution_get_a_note():
    usual = resolution_doubt(PrintFile(spiral_print(), 560.0, {}))
    close = resolution_doubt(PrintFile(spiral_print(), 640.0, {}))
    assert usual is None
    assert close is not None
    assert (close.code, close.severity) == ("odd-resolution", "note")
    assert "at 640 ppi its ridges are 0.3" in str(close)


@pytest.mark.parametrize("ppi", [250, pytest.param(1000, marks=pytest.mark.slow)])
def test_a_resolution_that_the_ridges_contradict_gives_no_answer(ppi, tmp_path):
    sound, file, gallery = tmp_path / "sound.png", tmp_path / "scan.png", tmp_path / "people.skg"
    sound.write_bytes(saved(spiral_print(), "PNG", 500))
    enroll(gallery, sound, person="Ann", finger="left_index")
    file.write_bytes(saved(spiral_print(), "PNG", ppi))
    reason = f"{file}: at {ppi} ppi its ridges are"
    for result in (match(file, sound), match(sound, file), identify(gallery, file)):
        assert result.answer == "undecided"
        assert result.undecided.startswith(reason)
    with bad_input(reason):
        enroll(gallery, file, person="Bea", finger="left_index")
    with bad_input(reason):
        match(file, sound, template=tmp_path / "scan.skt")
    assert not (tmp_path / "scan.skt").exists()
    array = match(spiral_print(), sound, resolution_ppi=ppi)
    assert array.answer == "undecided"
    assert array.findings[0].code == "odd-resolution"
    assert match(sound, sound).answer == "match"


@pytest.mark.slow
def test_a_resolution_that_only_the_other_print_contradicts_gives_no_answer(tmp_path):
    """Ridges at 385 for 500 ppi are as wide as some people's, and more than minutiae drift on a
    print's upper part, but at one scale both prints match."""
    sound, file, impostor = (tmp_path / name for name in ("sound.png", "scan.png", "impostor.png"))
    sound.write_bytes(saved(spiral_print(), "PNG", 500))
    part = spiral_print()[:300]
    file.write_bytes(saved(part, "PNG", 385))
    impostor.write_bytes(saved(np.ascontiguousarray(part[:, ::-1]), "PNG", 385))
    gallery = tmp_path / "people.skg"
    enroll(gallery, sound, person="Ann", finger="left_index")
    reason = r"the ridges of one lie 2\d % farther apart, and at one scale both match"
    for result in (match(file, sound), match(sound, file), identify(gallery, file)):
        assert (result.answer, result.decision) == ("undecided", None)
        assert re.match(reason, result.undecided)
    assert match(impostor, sound).answer == "no match"


def test_resolutions_that_no_print_has_are_refused(tmp_path):
    file = tmp_path / "scan.jpg"
    file.write_bytes(saved(spiral_print(), "JPEG", 72))
    with bad_input(r"states 72 ppi, too few for ridges; .* `resolution_ppi` 500"):
        read_one_finger(file)
    file.write_bytes(saved(np.full((200, 200), 255, np.uint8), "PNG", None))
    with bad_input(r"no ridges to measure it by: .* `resolution_ppi` 500"):
        read_one_finger(file)
    file.write_bytes(saved(spiral_print(), "PNG", 9000))
    with bad_input("more than 5080"):
        read_one_finger(file)
    with bad_input("200 to 5080"):
        read_one_finger(file, 100)


def test_pictures_without_ridges_have_no_period():
    noise = np.random.default_rng(1).integers(0, 256, (400, 400)).astype(np.uint8)
    squares, plain = np.kron(noise[:20, :20], np.ones((20, 20), np.uint8)), np.full_like(noise, 9)
    too_small = spiral_print()[200:240]
    assert [ridge_period_px(image) for image in (noise, plain, squares, too_small)] == [None] * 4


def test_a_touch_of_a_small_sensor_shows_its_resolution():
    touch = spiral_print()[200:252, 100:203]
    whole = ridge_period_px(spiral_print())
    assert whole is not None
    assert ridge_period_px(touch) == pytest.approx(whole, rel=0.1)
    assert resolution_doubt(PrintFile(touch, 500.0, {})) is None
    doubt = resolution_doubt(PrintFile(touch, 500 * 1.8, {}))
    assert doubt is not None
    assert "pixels per inch would fit" in str(doubt)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (lambda: b"", "is empty"),
        (lambda: b"hello", "of another kind"),
        (lambda: b"%PDF-1.4 and more", "prints and minutiae are read from PNG"),
        (lambda: saved(coloured(1, 2, 1), "PNG", 500), "colour image"),
        (lambda: saved(spiral_print(), "PNG", 500)[:-40], "damaged|truncated"),
        (lambda: saved(spiral_print(), "BMP", 500)[:-4000], "damaged"),
    ],
    ids=["empty", "text", "pdf", "colour", "cut png", "cut bmp"],
)
def test_files_that_are_no_print_are_refused_in_one_sentence(tmp_path, data, words):
    file = tmp_path / "scan.png"
    file.write_bytes(data())
    with bad_input(words):
        read_one_finger(file)


def test_minutiae_of_records_lie_on_the_grid_of_500_ppi():
    same = minutiae_of(three_minutiae())
    assert_array_equal(same.x_px, three_minutiae().x_px)
    fine = three_minutiae(resolution_ppcm=(394, 394), quality=np.array([80, 0, 0]))
    half = minutiae_of(fine)
    assert np.abs(half.x_px - fine.x_px / 2).max() <= 0.51
    assert half.size == (round(fine.size[0] / 2), round(fine.size[1] / 2))
    assert half.quality.tolist() == [80, 0, 0]
