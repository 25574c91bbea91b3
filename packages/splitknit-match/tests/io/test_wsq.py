"""WSQ: what comes back, what is refused, and that nothing takes this process down."""

import signal
import subprocess

import cv2
import numpy as np
import pytest

from refusals import bad_input
from splitknit.errors import BadInput
from splitknit_match.records import wsq_image
from splitknit_match.records.wsq_image import _wsq_header, decode_wsq, encode_wsq

pytest.importorskip("_wsq")


def ridges(rows=200, columns=160):
    """Circular ridges of nine pixels, as at 500 ppi, fading towards the edges."""
    y, x = np.mgrid[:rows, :columns]
    wave = np.cos(2 * np.pi * np.hypot(x - columns / 3, y - rows * 0.7) / 9)
    inside = np.clip(1.2 - np.hypot((x - columns / 2) / columns, (y - rows / 2) / rows) * 2, 0, 1)
    return np.asarray(np.round(255 - 200 * inside * (0.5 + 0.5 * wave)), dtype=np.uint8)


@pytest.fixture(scope="module")
def sound():
    return encode_wsq(ridges())


def psnr_db(a, b):
    return float(10 * np.log10(255**2 / max(np.mean((a.astype(float) - b) ** 2), 1e-9)))


def test_prints_come_back_nearly_as_they_were():
    image = ridges()
    data = encode_wsq(image)
    read = decode_wsq(data)
    assert read.image.shape == image.shape
    assert psnr_db(read.image, image) > 30
    assert np.corrcoef(read.image.ravel(), image.ravel())[0, 1] > 0.99
    assert read.resolution_ppi == 500
    assert len(data) * 8 < 0.75 * image.size + 8 * 700  # tables and comment take 650 bytes


def test_rows_and_columns_are_not_exchanged(sound):
    assert _wsq_header(sound, "x") == (200, 160, 500)


def test_equal_prints_give_equal_bytes(sound):
    assert encode_wsq(ridges()) == sound


@pytest.mark.parametrize("shape", [(96, 96), (97, 127)])
def test_small_prints_are_sound(shape):
    smooth = cv2.GaussianBlur(ridges(*shape), (0, 0), 3)
    for image in (smooth, np.full(shape, 255, dtype=np.uint8)):
        assert psnr_db(decode_wsq(encode_wsq(image)).image, image) > 40


@pytest.mark.parametrize(
    ("image", "ppi", "words"),
    [
        (np.zeros((95, 100), np.uint8), 500, "96 to 5000 pixels each way, not 95 x 100"),
        (np.zeros((100, 100), np.uint8), 1000, "WSQ is for 500 ppi, but the print has 1000"),
        (np.zeros((100, 100)), 500, "uint8"),
        (np.zeros((100, 100, 1), np.uint8), 500, r"\(H, W\)"),
    ],
)
def test_other_images_are_refused(image, ppi, words):
    with bad_input(words):
        encode_wsq(image, ppi)


def changed(data, place, *values):
    result = bytearray(data)
    result[place : place + len(values)] = bytes(values)
    return bytes(result)


def test_what_is_damaged_is_named(sound):
    frame = sound.index(b"\xff\xa2")
    block = sound.index(b"\xff\xa3")
    for data, words in [
        (b"", "not a WSQ file"),
        (b"\x89PNG\r\n", "not a WSQ file"),
        (sound[:-1], "truncated"),
        (sound[: block + 10], "truncated"),
        (sound[: frame + 5], "truncated"),
        (sound[:2] + sound[-2:], "is not whole"),
        (changed(sound, frame, 0), "is not whole"),
        (changed(sound, frame + 6, 0xFF, 0xFF, 0xFF, 0xFF), "claims 65535 x 65535 pixels"),
        (changed(sound, frame + 6, 0, 0), "claims 0 x 160 pixels"),
        (sound[:frame] + sound[block:], "is not whole"),
        (changed(sound, frame + 6, 0, 100), "cannot be decoded|truncated"),
    ]:
        with bad_input(words) as refused:
            image = decode_wsq(data, "x.wsq").image
            assert image.shape == (100, 160)  # a changed size may give a picture, of that size
            raise BadInput("x.wsq cannot be decoded")
        assert "x.wsq" in str(refused.value)


def test_comments_without_resolution_are_read(sound):
    comment = 4 + int.from_bytes(sound[4:6], "big")
    assert decode_wsq(sound[:2] + sound[comment:]).resolution_ppi is None


def test_damaged_files_do_not_end_this_process(sound):
    """NIST's decoder ends its process on some of these; whichever, there is an image or a
    sentence."""
    random = np.random.default_rng(7)
    refused = 0
    for _ in range(12):
        data = bytearray(sound)
        for _ in range(random.integers(1, 5)):
            data[random.integers(0, len(data))] ^= random.integers(1, 256)
        try:
            assert decode_wsq(bytes(data)).image.dtype == np.uint8
        except BadInput:
            refused += 1
    assert 0 < refused < 12


def test_a_child_that_ends_hangs_or_talks_is_refused(sound, monkeypatch):
    for child in ("import os; os.abort()", "import time; time.sleep(60)", "print('hello')"):
        monkeypatch.setattr(wsq_image, "_CHILD", child)
        monkeypatch.setattr(wsq_image, "TIMEOUT_S", 0.5)
        with bad_input("cannot be decoded"):
            decode_wsq(sound)
        with bad_input(r"cannot be compressed|not a WSQ file"):
            encode_wsq(ridges())


def test_the_child_inherits_no_key(sound, monkeypatch):
    monkeypatch.setenv("SPLITKNIT_GALLERY_KEY", "0f" * 32)
    refuse = "import os\nif any(name.startswith('SPLITKNIT_') for name in os.environ): os.abort()\n"
    monkeypatch.setattr(wsq_image, "_CHILD", refuse + wsq_image._CHILD)
    assert decode_wsq(sound).image.size > 0


def test_without_the_package_the_remedy_is_named(sound, monkeypatch):
    monkeypatch.setattr(wsq_image.importlib.util, "find_spec", lambda name: None)
    with bad_input(r"pip install 'splitknit-match\[records\]'"):
        encode_wsq(ridges())

    def refuse(*_, **__):
        raise PermissionError("no")

    monkeypatch.undo()
    monkeypatch.setattr(subprocess, "run", refuse)
    with bad_input("could not be started"):
        decode_wsq(sound)


@pytest.mark.parametrize(
    ("work", "signals", "words"),
    [
        ("bytearray(2_000_000_000)", (), b"MemoryError"),
        ("sum(iter(int, 1))", (-signal.SIGXCPU, -signal.SIGKILL), b""),
    ],
)
def test_the_codec_may_take_no_more_memory_and_time_than_an_image_needs(
    sound, monkeypatch, work, signals, words
):
    monkeypatch.setattr(wsq_image, "_CHILD", wsq_image._CHILD.replace("import _wsq", work))
    monkeypatch.setattr(wsq_image, "CODEC_S", 1)
    run, ended = subprocess.run, []

    def spy(*arguments, **options):
        ended.append(run(*arguments, **options))
        return ended[-1]

    monkeypatch.setattr(subprocess, "run", spy)
    with bad_input("cannot be decoded"):
        decode_wsq(sound)
    assert words in ended[0].stderr and ended[0].returncode in (signals or (1,))


def test_the_resolution_in_a_comment_is_read(sound):
    assert decode_wsq(sound.replace(b"\nPPI 500\n", b"\nPPI 999\n")).resolution_ppi == 999
