from __future__ import annotations

import contextlib
import io
import struct
import tracemalloc
import zlib
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile

from splitknit.errors import BadInput
from splitknit.io.images import decode_image


def smooth(shape: tuple[int, ...], dtype: type = np.uint8) -> np.ndarray:
    noise = np.random.default_rng(1).integers(0, np.iinfo(dtype).max, shape).astype(dtype)
    return cv2.GaussianBlur(noise, (0, 0), 4.0)


def tiff_bytes(image: np.ndarray, **options: Any) -> bytes:
    stream = io.BytesIO()
    tifffile.imwrite(stream, image, metadata=None, **options)
    return stream.getvalue()


@pytest.mark.parametrize("progressive", [0, 1])
@pytest.mark.parametrize("shape", [(40, 56), (40, 56, 3)])
def test_jpeg(shape: tuple[int, ...], progressive: int, capfd: pytest.CaptureFixture[str]) -> None:
    image = smooth(shape)
    options = [cv2.IMWRITE_JPEG_PROGRESSIVE, progressive, cv2.IMWRITE_JPEG_RST_INTERVAL, 3]
    data = cv2.imencode(".jpg", image, options)[1].tobytes()
    expected = image[..., None] if image.ndim == 2 else image[..., ::-1]
    decoded = decode_image(data, "x")
    assert decoded.shape == expected.shape
    assert np.abs(decoded.astype(int) - expected).max() < 12
    for length in range(len(data)):
        with pytest.raises(BadInput, match=r"^shot\.jpg "):
            decode_image(data[:length], "shot.jpg")
    assert capfd.readouterr().err == ""


def test_jpeg_orientation_is_ignored() -> None:
    data = cv2.imencode(".jpg", smooth((40, 56)))[1].tobytes()
    entry = b"\x01\x12\0\3\0\0\0\1\0\6\0\0"  # orientation 6: turn by 90 degrees
    exif = b"Exif\0\0MM\0*\0\0\0\x08\0\1" + entry + b"\0\0\0\0"
    turned = data[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + data[2:]
    assert decode_image(turned, "x").shape == (40, 56, 1)


def test_jpeg_of_other_kinds() -> None:
    data = cv2.imencode(".jpg", smooth((40, 56, 3)))[1].tobytes()
    frame = data.index(b"\xff\xc0")
    with pytest.raises(BadInput, match="CMYK"):
        decode_image(data[: frame + 9] + b"\4" + data[frame + 10 :], "x")
    with pytest.raises(BadInput, match="12 bits"):
        decode_image(data[: frame + 4] + b"\x0c" + data[frame + 5 :], "x")
    with pytest.raises(BadInput, match="not supported"):
        decode_image(data[: frame + 1] + b"\xc3" + data[frame + 2 :], "x")
    with pytest.raises(BadInput, match="holds no image"):
        decode_image(data[:2] + b"\xff\xd9" + data[2:], "x")


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize(
    ("shape", "options"),
    [
        ((20, 30), {"photometric": "minisblack"}),
        ((20, 30, 3), {"photometric": "rgb"}),
        ((20, 30, 3), {"photometric": "rgb", "compression": "zlib", "predictor": True}),
        ((20, 30, 3), {"photometric": "rgb", "tile": (16, 16)}),
        ((20, 30, 3), {"photometric": "rgb", "byteorder": ">", "rowsperstrip": 7}),
        ((20, 30, 3), {"photometric": "rgb", "bigtiff": True}),
    ],
)
def test_tiff(shape: tuple[int, ...], options: dict[str, Any], dtype: type, capfd: pytest.CaptureFixture[str]) -> None:
    image = smooth(shape, dtype)
    options = {key: value for key, value in options.items() if key != "predictor"}
    data = tiff_bytes(image, **options)
    np.testing.assert_array_equal(decode_image(data, "x"), image[..., None] if image.ndim == 2 else image)
    for length in range(0, len(data), 97):
        with pytest.raises(BadInput, match=r"^shot\.tif"):
            decode_image(data[:length], "shot.tif")
    assert capfd.readouterr().err == ""


def test_tiff_layouts() -> None:
    image = smooth((20, 30, 4))
    planes = tiff_bytes(np.moveaxis(image[..., :3], -1, 0), photometric="rgb", planarconfig="separate")
    with pytest.raises(BadInput, match="unsupported storage"):
        decode_image(planes, "x")
    alpha = tiff_bytes(image, photometric="rgb", extrasamples=["unassalpha"])
    np.testing.assert_array_equal(decode_image(alpha, "x"), image[..., :3])
    for compression in (None, "zlib"):
        for grey in (image[..., 0], image[..., 0].astype(np.uint16) * 257):
            inverted = tiff_bytes(grey, photometric="miniswhite", compression=compression)
            np.testing.assert_array_equal(decode_image(inverted, "x")[..., 0], np.iinfo(grey.dtype).max - grey)


def test_tiff_with_lzw(capfd: pytest.CaptureFixture[str]) -> None:
    image = smooth((20, 30, 3))
    options = [cv2.IMWRITE_TIFF_COMPRESSION, cv2.IMWRITE_TIFF_COMPRESSION_LZW]
    lzw = cv2.imencode(".tif", image, options)[1].tobytes()
    np.testing.assert_array_equal(decode_image(lzw, "x"), image[..., ::-1])
    offset = int.from_bytes(lzw[4:8], "little")  # the tags follow the data, so the strip is made to end too late
    assert offset > len(lzw) // 2
    with tifffile.TiffFile(io.BytesIO(lzw)) as file:
        place = file.pages[0].tags["StripByteCounts"].valueoffset
    longer = lzw[:place] + (len(lzw)).to_bytes(4, "little") + lzw[place + 4 :]
    with pytest.raises(BadInput, match="truncated"):
        decode_image(longer, "x")
    with contextlib.suppress(BadInput):
        decode_image(lzw[:8] + b"\xff" * (offset - 8) + lzw[offset:], "x")
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    ("image", "options", "words"),
    [
        (np.zeros((4, 5), np.float32), {}, "float32"),
        (np.zeros((4, 5), np.int16), {}, "int16"),
        (np.zeros((4, 5, 4), np.uint8), {"photometric": "separated"}, "CMYK"),
        (np.zeros((4, 5), np.uint8), {"photometric": "palette", "colormap": np.zeros((3, 256), np.uint16)}, "palette"),
    ],
)
def test_tiff_of_other_kinds(image: np.ndarray, options: dict[str, Any], words: str) -> None:
    with pytest.raises(BadInput, match=words):
        decode_image(tiff_bytes(image, **options), "x")


def peak_bytes_of_refusal(data: bytes, words: str) -> int:
    tracemalloc.start()
    try:
        with pytest.raises(BadInput, match=words):
            decode_image(data, "x")
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_a_small_jpeg_cannot_claim_a_large_image() -> None:
    data = cv2.imencode(".jpg", np.zeros((8, 8, 3), np.uint8))[1].tobytes()
    assert len(data) < 700
    frame = data.index(b"\xff\xc0") + 5
    for side, words in ((11_000, "cannot be in"), (14_000, "more than the 400000000 that are read")):
        claim = side.to_bytes(2, "big") * 2
        assert peak_bytes_of_refusal(data[:frame] + claim + data[frame + 4 :], words) < 1_000_000


def test_jpeg_of_many_scans_or_impossible_sampling_is_refused() -> None:
    data = cv2.imencode(".jpg", smooth((40, 56, 3)), [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes()
    last = data.rindex(b"\xff\xda")
    with pytest.raises(BadInput, match="more than 100 JPEG scans"):
        decode_image(data[:last] + data[last:-2] * 101 + b"\xff\xd9", "x")
    frame = data.index(b"\xff\xc2")
    for factors in (0, 0x05, 0x51):
        with pytest.raises(BadInput, match="impossible sampling"):
            decode_image(data[: frame + 11] + bytes([factors]) + data[frame + 12 :], "x")


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("compression", [None, "zlib"])
@pytest.mark.parametrize(
    "options",
    [{"rowsperstrip": 7}, {"tile": (16, 32)}, {"byteorder": ">", "bigtiff": True}],
)
def test_tiff_against_tifffile(options: dict[str, Any], compression: str | None, dtype: type) -> None:
    image = smooth((41, 57, 3), dtype)
    image[5:30, 8:40] = 77  # runs
    data = tiff_bytes(image, photometric="rgb", compression=compression, **options)
    np.testing.assert_array_equal(decode_image(data, "x"), image)


@pytest.mark.parametrize("predictor", [1, 2])
@pytest.mark.parametrize("compression", [8, 32946, 5, 32773])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_packed_tiff_of_libtiff(dtype: type, compression: int, predictor: int) -> None:
    image = smooth((41, 57, 3), dtype)
    options = [cv2.IMWRITE_TIFF_COMPRESSION, compression, cv2.IMWRITE_TIFF_PREDICTOR, predictor]
    data = cv2.imencode(".tif", image[..., ::-1], options)[1].tobytes()
    with tifffile.TiffFile(io.BytesIO(data)) as file:
        assert file.pages[0].predictor == (1 if compression == 32773 else predictor)
    np.testing.assert_array_equal(decode_image(data, "x"), image)


def set_tag(data: bytes, tag: int, entry: bytes) -> bytes:
    """Replace type, count and value of a tag of a little-endian TIFF file by 10 bytes."""
    with tifffile.TiffFile(io.BytesIO(data)) as file:
        place = file.pages[0].tags[tag].offset
    return data[: place + 2] + entry + data[place + 12 :]


@pytest.mark.parametrize(
    ("tag", "entry", "words"),
    [
        (256, struct.pack("<HII", 3, 0, 0), "tags are damaged"),  # no value
        (256, struct.pack("<HII", 2, 4, 30), "tags are damaged"),  # a text
        (277, struct.pack("<HII", 5, 1, 0), "tags are damaged"),  # a fraction
        (256, struct.pack("<HII", 12, 1, 0), "tags are damaged"),  # a type that no width has
        (258, struct.pack("<HII", 3, 3, 1 << 31), "tags are damaged"),  # beyond the file
        (258, struct.pack("<HIHH", 3, 2, 8, 16), "8- or 16-bit"),
        (259, struct.pack("<HII", 3, 1, 50000), "compression 50000"),
        (262, struct.pack("<HII", 3, 1, 9), "neither grey nor RGB"),
        (273, struct.pack("<HII", 4, 2, 8), "tags are damaged"),
        (278, struct.pack("<HII", 4, 1, 1), "tags are damaged"),  # more strips than are named
        (279, struct.pack("<HII", 4, 1, 1 << 30), "truncated"),
        (257, struct.pack("<HII", 4, 1, 1 << 20), "cannot be in|tags are damaged"),
        (257, struct.pack("<HII", 4, 1, 1 << 30), "more than the 400000000"),
        (257, struct.pack("<HII", 4, 1, 0), "not a single flat image"),
    ],
)
def test_odd_tags_are_refused(tag: int, entry: bytes, words: str) -> None:
    data = tiff_bytes(smooth((20, 30)), rowsperstrip=20)
    assert peak_bytes_of_refusal(set_tag(data, tag, entry), words) < 1_000_000


def test_strips_may_not_share_their_bytes() -> None:
    data = tiff_bytes(smooth((20, 30)), rowsperstrip=5)
    with tifffile.TiffFile(io.BytesIO(data)) as file:
        page = file.pages[0]
        counts, first = page.tags[279], min(page.dataoffsets)
    assert counts.count == 4
    long = struct.pack("<4I", *[len(data) - first] * 4)
    again = data + long + struct.pack("<4I", *[first] * 4)
    again = set_tag(again, 279, struct.pack("<HII", 4, 4, len(data)))
    again = set_tag(again, 273, struct.pack("<HII", 4, 4, len(data) + 16))
    with pytest.raises(BadInput, match="tags are damaged"):
        decode_image(again, "x")


def test_a_strip_inflates_to_its_size_and_no_further() -> None:
    bomb = zlib.compress(bytes(50_000_000))
    data = tiff_bytes(np.zeros((300, 400), np.uint8), compression="zlib", rowsperstrip=300)
    bigger = data + bomb
    bigger = set_tag(bigger, 273, struct.pack("<HII", 4, 1, len(data)))
    bigger = set_tag(bigger, 279, struct.pack("<HII", 4, 1, len(bomb)))
    tracemalloc.start()
    assert decode_image(bigger, "x").shape == (300, 400, 1)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2_000_000
    short = set_tag(data, 257, struct.pack("<HII", 4, 1, 301))
    with pytest.raises(BadInput, match="damaged"):
        decode_image(set_tag(short, 278, struct.pack("<HII", 4, 1, 301)), "x")
