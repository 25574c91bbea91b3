from __future__ import annotations

import io
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile

from splitknit.check import BadInput
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
    np.testing.assert_array_equal(decode_image(planes, "x"), image[..., :3])
    alpha = tiff_bytes(image, photometric="rgb", extrasamples=["unassalpha"])
    np.testing.assert_array_equal(decode_image(alpha, "x"), image[..., :3])
    inverted = tiff_bytes(image[..., 0], photometric="miniswhite")
    np.testing.assert_array_equal(decode_image(inverted, "x")[..., 0], 255 - image[..., 0])


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
