from __future__ import annotations

import struct
import tracemalloc
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.io.images import decode_image, encode_image, image_size, read_image, write_image
from splitknit.io.images import decode_image as decode_png

SIGNATURE = b'\x89PNG\r\n\x1a\n'


def chunk(kind: bytes, body: bytes) -> bytes:
    return len(body).to_bytes(4, "big") + kind + body + zlib.crc32(kind + body).to_bytes(4, "big")


def make(header: tuple[int, ...], lines: bytes, *extra: bytes) -> bytes:
    """PNG of filtered rows, made without any library."""
    ihdr = chunk(b"IHDR", struct.pack(">IIBBBBB", *header))
    return SIGNATURE + ihdr + b"".join(extra) + chunk(b"IDAT", zlib.compress(lines)) + chunk(b"IEND", b"")


def smooth(shape: tuple[int, ...], dtype: type) -> np.ndarray:
    noise = np.random.default_rng(1).integers(0, np.iinfo(dtype).max, shape).astype(dtype)
    return cv2.GaussianBlur(noise, (0, 0), 1.5)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(31, 43), (31, 43, 3), (31, 43, 4), (700, 611, 3), (1, 1), (1, 5, 3)])
@pytest.mark.parametrize("strategy", [cv2.IMWRITE_PNG_STRATEGY_DEFAULT, cv2.IMWRITE_PNG_STRATEGY_FIXED])
def test_pixels_come_as_stored_in_rgb_order(shape: tuple[int, ...], dtype: type, strategy: int) -> None:
    image = smooth(shape, dtype)
    data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_STRATEGY, strategy])[1].tobytes()
    expected = image[..., None] if image.ndim == 2 else image[..., 2::-1]
    np.testing.assert_array_equal(decode_png(data, "x"), expected)


@pytest.mark.parametrize("kind", range(5))
@pytest.mark.parametrize(("colour", "width"), [(0, 1), (2, 3), (4, 2), (6, 4)])
@pytest.mark.parametrize("depth", [8, 16])
def test_every_filter_and_colour_type_against_a_slow_reference(kind: int, colour: int, width: int, depth: int) -> None:
    rng = np.random.default_rng(kind)
    rows, columns, step = 11, 9, width * depth // 8
    filtered = rng.integers(0, 256, (rows, columns * step)).astype(np.uint8)
    raw = np.zeros((rows + 1, columns + 1, step), dtype=np.int64)  # one row above, one pixel to the left
    values = filtered.reshape(rows, columns, step).astype(np.int64)
    for i in range(1, rows + 1):
        for j in range(1, columns + 1):
            left, up, corner = raw[i, j - 1], raw[i - 1, j], raw[i - 1, j - 1]
            guess = left + up - corner
            near = np.abs(np.stack([guess - left, guess - up, guess - corner])).argmin(axis=0)
            paeth = np.choose(near, [left, up, corner])
            raw[i, j] = (values[i - 1, j - 1] + [0, left, up, (left + up) // 2, paeth][kind]) % 256
    pixels = raw[1:, 1:].astype(np.uint8)
    lines = np.concatenate([np.full((rows, 1), kind, np.uint8), filtered], axis=1).tobytes()
    stored = pixels if depth == 8 else np.ascontiguousarray(pixels).view(">u2").astype(np.uint16)
    keep = 1 if colour in (0, 4) else 3
    decoded = decode_png(make((columns, rows, depth, colour, 0, 0, 0), lines), "x")
    np.testing.assert_array_equal(decoded, stored[..., :keep])


@pytest.mark.parametrize("depth", [1, 2, 4, 8])
def test_palettes_are_expanded_and_few_bits_stretched(depth: int) -> None:
    count = 2**depth
    index = np.arange(count).reshape(1, -1).repeat(2, axis=0)
    packed = b"".join(b"\0" + _pack(row, depth) for row in index)
    palette = np.random.default_rng(0).integers(0, 256, (count, 3), dtype=np.uint8)
    header = (count, 2, depth, 3, 0, 0, 0)
    data = make(header, packed, chunk(b"PLTE", palette.tobytes()), chunk(b"tRNS", bytes(count)))
    np.testing.assert_array_equal(decode_png(data, "x"), palette[index])
    grey = decode_png(make((count, 2, depth, 0, 0, 0, 0), packed), "x")
    np.testing.assert_array_equal(grey[..., 0], index * (255 // (count - 1)))
    with pytest.raises(BadInput, match="image data cannot be decoded"):
        decode_png(make(header, packed), "x")


def _pack(row: np.ndarray, depth: int) -> bytes:
    bits = "".join(format(value, f"0{depth}b") for value in row)
    bits += "0" * (-len(bits) % 8)
    return bytes(int(bits[k : k + 8], 2) for k in range(0, len(bits), 8))


def test_interlaced() -> None:
    image = np.arange(5 * 7, dtype=np.uint8).reshape(5, 7)
    lines = b""
    for r, c, dr, dc in (
        (0, 0, 8, 8),
        (0, 4, 8, 8),
        (4, 0, 8, 4),
        (0, 2, 4, 4),
        (2, 0, 4, 2),
        (0, 1, 2, 2),
        (1, 0, 2, 1),
    ):
        for row in image[r::dr, c::dc]:
            lines += b"\0" + row.tobytes() if row.size else b""
    data = make((7, 5, 8, 0, 0, 0, 1), lines)
    np.testing.assert_array_equal(decode_png(data, "x")[..., 0], image)


def test_truncation_anywhere_is_found(capfd: pytest.CaptureFixture[str]) -> None:
    data = cv2.imencode(".png", smooth((20, 30, 3), np.uint8))[1].tobytes()
    for length in range(len(data)):
        with pytest.raises(BadInput, match=r"^shot\.png "):
            decode_image(data[:length], "shot.png")
    assert capfd.readouterr().err == ""


def test_every_flipped_byte_is_found(capfd: pytest.CaptureFixture[str]) -> None:
    data = cv2.imencode(".png", smooth((9, 11), np.uint8))[1].tobytes()
    for position in range(len(data)):
        damaged = bytearray(data)
        damaged[position] ^= 0x40
        with pytest.raises(BadInput):
            decode_image(bytes(damaged), "x")
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(9, 11), (1, 1), (9, 11, 3)])
def test_files_of_our_own_are_checked_as_others(
    shape: tuple[int, ...], dtype: type, capfd: pytest.CaptureFixture[str]
) -> None:
    image = smooth(shape, dtype)
    data = encode_image(image, ".png")
    for position in range(len(data)):
        damaged = bytearray(data)
        damaged[position] ^= 0x40
        with pytest.raises(BadInput):
            decode_image(bytes(damaged), "x")
        with pytest.raises(BadInput):
            decode_image(data[:position], "x")
    np.testing.assert_array_equal(decode_image(data, "x").reshape(image.shape), image)
    assert capfd.readouterr().err == ""


def test_another_filter_after_many_rows_is_decoded() -> None:
    rows = [b"\2\1\1\1"] * 20 + [b"\1\5\1\1"]
    decoded = decode_png(make((3, 21, 8, 0, 0, 0, 0), b"".join(rows)), "x")[..., 0]
    np.testing.assert_array_equal(decoded, [*([k, k, k] for k in range(1, 21)), [5, 6, 7]])


@pytest.mark.parametrize("lines", [b"\0\1\2\3" * 3, b"\7\1\2\3" * 4])
def test_sound_checksums_do_not_hide_wrong_image_data(lines: bytes) -> None:
    """Too little of it, a row filter that does not exist."""
    with pytest.raises(BadInput, match="image data cannot be decoded"):
        decode_png(make((3, 4, 8, 0, 0, 0, 0), lines), "x")


def test_wrong_filter_in_every_row_of_an_interlaced_image() -> None:
    lines = [2, 2, 3, 2, 2, 4, 4]  # bytes of the rows of seven passes over 4 rows of 3 pixels, two of them empty
    for start in np.cumsum([0, *lines[:-1]]):
        stored = bytearray(sum(lines))
        stored[start] = 5
        with pytest.raises(BadInput, match="image data cannot be decoded"):
            decode_png(make((3, 4, 8, 0, 0, 0, 1), bytes(stored)), "x")


def test_damaged_stream_with_sound_checksums() -> None:
    ihdr = chunk(b"IHDR", struct.pack(">IIBBBBB", 3, 4, 8, 0, 0, 0, 0))
    stream = bytearray(zlib.compress(b"\0\1\2\3" * 4))
    stream[-1] ^= 1  # the Adler-32 at the end
    for body in (bytes(stream), b"no deflate stream", b"", bytes(stream[:-2])):
        data = SIGNATURE + ihdr + chunk(b"IDAT", body) + chunk(b"IEND", b"")
        with pytest.raises(BadInput, match="image data"):
            decode_png(data, "x")


@pytest.mark.parametrize(
    "header",
    [
        (0, 4, 8, 0, 0, 0, 0),
        (3, 0, 8, 0, 0, 0, 0),
        (3, 4, 3, 0, 0, 0, 0),
        (3, 4, 8, 1, 0, 0, 0),
        (3, 4, 4, 2, 0, 0, 0),
        (3, 4, 8, 0, 1, 0, 0),
        (3, 4, 8, 0, 0, 1, 0),
        (3, 4, 8, 0, 0, 0, 2),
    ],
)
def test_impossible_headers(header: tuple[int, ...]) -> None:
    with pytest.raises(BadInput, match="header is damaged"):
        decode_png(make(header, b"\0\1\2\3" * 4), "x")


def test_a_file_that_claims_a_huge_image_is_refused_before_decoding() -> None:
    bomb = make((40_000, 40_000, 8, 0, 0, 0, 0), b"")
    with pytest.raises(BadInput, match="claims 40000 x 40000"):
        decode_image(bomb, "x")


def test_ancillary_chunks_stay_silent(capfd: pytest.CaptureFixture[str]) -> None:
    extra = chunk(b"iCCP", b"broken\0\0nonsense"), chunk(b"gAMA", b"\0"), chunk(b"eXIf", b"MM\0*rubbish")
    data = make((3, 4, 8, 0, 0, 0, 0), b"\0\1\2\3" * 4, *extra)
    assert decode_png(data, "x")[0, :, 0].tolist() == [1, 2, 3]
    with pytest.raises(BadInput, match="not known"):
        decode_png(make((3, 4, 8, 0, 0, 0, 0), b"\0\1\2\3" * 4, chunk(b"ABCD", b"")), "x")
    assert capfd.readouterr().err == ""


def test_files(tmp_path: Path) -> None:
    image = smooth((12, 17, 3), np.uint16)
    for suffix in ("png", "tif", "TIFF"):
        path = tmp_path / f"image.{suffix}"
        write_image(path, image)
        assert image_size(path) == (12, 17)
        np.testing.assert_array_equal(read_image(path), image)
        first = path.read_bytes()
        write_image(path, image)
        assert path.read_bytes() == first
    with pytest.raises(BadInput, match=r"not as '\.bmp'"):
        write_image(tmp_path / "image.bmp", image)
    with pytest.raises(BadInput, match="uint8 or uint16"):
        write_image(tmp_path / "image.png", image.astype(np.float32))
    with pytest.raises(BadInput, match="does not exist"):
        read_image(tmp_path / "no.png")
    with pytest.raises(BadInput, match="not a file"):
        read_image(tmp_path)
    with pytest.raises(BadInput, match="more than the 10 that are read"):
        decode_image((tmp_path / "image.png").read_bytes(), "image.png", max_pixels=10)
    (tmp_path / "empty.png").touch()
    with pytest.raises(BadInput, match="is empty"):
        read_image(tmp_path / "empty.png")
    (tmp_path / "text.png").write_text("not an image")
    with pytest.raises(BadInput, match="not a PNG, TIFF or JPEG"):
        read_image(tmp_path / "text.png")


@pytest.mark.parametrize(
    ("columns", "rows", "depth", "colour", "interlaced", "words"),
    [
        (20_000, 20_001, 8, 0, 0, "more than the 400000000 that are read"),
        (20_000, 20_000, 8, 0, 0, "cannot be in"),
        (10_000, 10_000, 16, 2, 1, "more than the 400000000 that are read"),
        (10_000, 10_000, 8, 2, 1, "cannot be in"),
    ],
)
def test_a_small_file_cannot_claim_a_large_image(columns, rows, depth, colour, interlaced, words) -> None:  # noqa: PLR0917
    data = make((columns, rows, depth, colour, 0, 0, interlaced), bytes(1000))
    tracemalloc.start()
    with pytest.raises(BadInput, match=words):
        decode_image(data, "x")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1_000_000
