"""Pictures: pixels come as stored, and what is damaged, too large or of another kind is refused in
a sentence."""

import io
import struct
import tracemalloc
import zlib

import cv2
import numpy as np
import pytest
import tifffile
from numpy.testing import assert_array_equal
from PIL import Image

from png_files import PNG, chunk
from refusals import bad_input
from splitknit.io.images import decode_image, encode_image, read_image, write_image
from written_files import read_by_all


def png(header, lines, *extra):
    """PNG of filtered rows, made without any library."""
    ihdr = chunk(b"IHDR", struct.pack(">IIBBBBB", *header))
    data = chunk(b"IDAT", zlib.compress(lines))
    return b"".join((PNG, ihdr, *extra, data, chunk(b"IEND", b"")))


def smooth(shape, dtype=np.uint8, sigma=1.5):
    noise = np.random.default_rng(1).integers(0, np.iinfo(dtype).max, shape).astype(dtype)
    return cv2.GaussianBlur(noise, (0, 0), sigma)


def tiff(image, **options):
    stream = io.BytesIO()
    tifffile.imwrite(stream, image, metadata=None, **options)
    return stream.getvalue()


def test_a_picture_without_its_palette_is_refused():
    with bad_input("damaged"):
        decode_image(png((3, 4, 8, 3, 0, 0, 0), b"\0\1\2\3" * 4), "x")


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize(
    "encode", [encode_image, lambda image, suffix: cv2.imencode(suffix, image)[1].tobytes()]
)
def test_png_cut_anywhere_or_with_a_changed_byte_is_refused(dtype, encode, capfd):
    data = encode(smooth((9, 11, 3), dtype), ".png")
    for position in range(len(data)):
        damaged = bytearray(data)
        damaged[position] ^= 0x40
        with bad_input(r"^shot\.png "):
            decode_image(data[:position], "shot.png")
        if position < len(data) - 4:  # the checksum of nothing
            with bad_input():
                decode_image(bytes(damaged), "x")
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("lines", [b"\0\1\2\3" * 3, b"\7\1\2\3" * 4, b""])
@pytest.mark.parametrize("interlaced", [0, 1])
def test_wrong_image_data_under_valid_checksums_is_refused(lines, interlaced):
    """Too little of it, a row filter that does not exist."""
    with bad_input("image data cannot be decoded"):
        decode_image(png((3, 4, 8, 0, 0, 0, interlaced), lines), "x")


@pytest.mark.parametrize(
    "header",
    [
        (0, 4, 8, 0, 0, 0, 0),
        (3, 4, 3, 0, 0, 0, 0),
        (3, 4, 8, 1, 0, 0, 0),
        (3, 4, 8, 0, 0, 1, 0),
        (3, 4, 8, 0, 0, 0, 2),
    ],
)
def test_impossible_png_headers_are_refused(header):
    with bad_input():
        decode_image(png(header, b"\0\1\2\3" * 4), "x")


@pytest.mark.parametrize(
    ("extra", "sound"),
    [
        (chunk(b"iCCP", b"broken\0\0nonsense"), True),
        (chunk(b"eXIf", b"MM\0*rubbish"), True),
        (chunk(b"tEXt", b"Comment\0x"), True),
        (chunk(b"tRNS", b"\0\1"), True),
        (chunk(b"gAMA", b"\0"), False),
        (chunk(b"ABCD", b""), False),
        (chunk(b"IHDR", struct.pack(">IIBBBBB", 3, 4, 8, 0, 0, 0, 0)), False),
    ],
)
def test_other_chunks_are_ignored_or_refused_silently(extra, sound, capfd):
    data = png((3, 4, 8, 0, 0, 0, 0), b"\0\1\2\3" * 4, extra)
    if sound:
        assert decode_image(data, "x")[0, :, 0].tolist() == [1, 2, 3]
    else:
        with bad_input():
            decode_image(data, "x")
    assert capfd.readouterr().err == ""


def test_written_files_keep_their_pixels_and_bytes(tmp_path):
    image = smooth((12, 17, 3), np.uint16)
    for suffix in ("png", "tif", "TIFF"):
        path = tmp_path / f"image.{suffix}"
        write_image(path, image)
        np.testing.assert_array_equal(read_image(path), image)
        if suffix != "png":
            assert_array_equal(read_by_all(path), image)
        first = path.read_bytes()
        write_image(path, image)
        assert path.read_bytes() == first


def test_files_that_cannot_be_written_or_read_are_refused(tmp_path):
    image = smooth((12, 17, 3), np.uint16)
    with bad_input(r"not as '\.bmp'"):
        write_image(tmp_path / "image.bmp", image)
    with bad_input("uint8 or uint16"):
        write_image(tmp_path / "image.png", image.astype(np.float32))
    with bad_input("does not exist"):
        read_image(tmp_path / "no.png")
    with bad_input("more than the 10 that are read"):
        decode_image(encode_image(image, ".png"), "image.png", max_pixels=10)
    for content, words in ((b"", "is empty"), (b"not an image", "not a PNG, TIFF or JPEG")):
        (tmp_path / "other.png").write_bytes(content)
        with bad_input(words):
            read_image(tmp_path / "other.png")


def peak_bytes_of_refusal(data, words):
    tracemalloc.start()
    try:
        with bad_input(words):
            decode_image(data, "x")
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("side", "depth", "colour", "words"),
    [
        (40_000, 8, 0, "claims 40000 x 40000"),
        (12_000, 8, 2, "more than the 400000000 that are read"),
        (9_000, 16, 2, "more than the 400000000 that are read"),
        (9_000, 8, 2, "cannot be in"),
    ],
)
def test_a_small_png_cannot_claim_a_large_image(side, depth, colour, words):
    data = png((side, side, depth, colour, 0, 0, 1), bytes(1000))
    assert peak_bytes_of_refusal(data, words) < 1_000_000


def test_a_small_jpeg_cannot_claim_a_large_image():
    data = cv2.imencode(".jpg", np.zeros((8, 8, 3), np.uint8))[1].tobytes()
    frame = data.index(b"\xff\xc0") + 5
    for side, words in (
        (11_000, "cannot be in"),
        (14_000, "more than the 400000000 that are read"),
    ):
        claim = side.to_bytes(2, "big") * 2
        assert peak_bytes_of_refusal(data[:frame] + claim + data[frame + 4 :], words) < 1_000_000


@pytest.mark.parametrize("progressive", [0, 1])
@pytest.mark.parametrize("shape", [(40, 56), (40, 56, 3)])
def test_jpeg_is_decoded_and_refused_where_it_is_truncated(shape, progressive, capfd):
    image = smooth(shape, sigma=4.0)
    options = [cv2.IMWRITE_JPEG_PROGRESSIVE, progressive, cv2.IMWRITE_JPEG_RST_INTERVAL, 3]
    data = cv2.imencode(".jpg", image, options)[1].tobytes()
    expected = image[..., None] if image.ndim == 2 else image[..., ::-1]
    decoded = decode_image(data, "x")
    assert decoded.shape == expected.shape
    assert np.abs(decoded.astype(int) - expected).max() < 12
    for length in range(len(data)):
        with bad_input(r"^shot\.jpg "):
            decode_image(data[:length], "shot.jpg")
    assert capfd.readouterr().err == ""


def test_unsupported_kinds_of_jpeg_are_refused():
    data = cv2.imencode(".jpg", smooth((40, 56, 3)))[1].tobytes()
    frame = data.index(b"\xff\xc0")
    variants = (
        data[: frame + 9] + b"\4" + data[frame + 10 :],  # CMYK
        data[: frame + 4] + b"\x0c" + data[frame + 5 :],  # 12 bits
        data[: frame + 1] + b"\xc3" + data[frame + 2 :],  # lossless
        data[:2] + b"\xff\xd9" + data[2:],  # no image
        data[: frame + 11] + b"\5" + data[frame + 12 :],  # sampling
    )
    for variant in variants:
        with bad_input():
            decode_image(variant, "x")
    scans = cv2.imencode(".jpg", smooth((40, 56, 3)), [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[
        1
    ].tobytes()
    last = scans.rindex(b"\xff\xda")
    with bad_input("more than 100 JPEG scans"):
        decode_image(scans[:last] + scans[last:-2] * 101 + b"\xff\xd9", "x")


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("compression", [None, "zlib"])
@pytest.mark.parametrize(
    "options", [{}, {"rowsperstrip": 7}, {"tile": (16, 32)}, {"byteorder": ">", "bigtiff": True}]
)
def test_tiff_is_decoded_and_refused_where_it_is_truncated(options, compression, dtype, capfd):
    for image in (smooth((41, 57, 3), dtype), smooth((41, 57), dtype)):
        photometric = "rgb" if image.ndim == 3 else "minisblack"
        data = tiff(image, photometric=photometric, compression=compression, **options)
        assert_array_equal(decode_image(data, "x"), image.reshape(41, 57, -1))
        for length in range(0, len(data), 97):
            with bad_input(r"^shot\.tif"):
                decode_image(data[:length], "shot.tif")
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("predictor", [1, 2])
@pytest.mark.parametrize("compression", [8, 32946, 5, 32773])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_compressed_tiff_of_libtiff_is_decoded(dtype, compression, predictor):
    image = smooth((41, 57, 3), dtype)
    options = [cv2.IMWRITE_TIFF_COMPRESSION, compression, cv2.IMWRITE_TIFF_PREDICTOR, predictor]
    data = cv2.imencode(".tif", image[..., ::-1], options)[1].tobytes()
    assert_array_equal(decode_image(data, "x"), image)


@pytest.mark.parametrize("shape", [(40, 50), (40, 50, 1), (40, 50, 3)])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_compressed_tiff_keeps_pixels_and_bytes_and_is_refused_where_it_is_cut(dtype, shape, capfd):
    image = smooth(shape, dtype)
    data = encode_image(image, ".tiff", compress=True)
    assert encode_image(image, ".tiff", compress=True) == data
    assert_array_equal(decode_image(data, "x"), image.reshape(40, 50, -1))
    for length in range(8, len(data) - 200, 97):
        with bad_input(r"^shot\.tif"):
            decode_image(data[:length], "shot.tif")
    assert capfd.readouterr().err == ""


def zstd_tiff(image, **tags):
    stream = io.BytesIO()
    tiff_tags = {int(tag.removeprefix("tag")): value for tag, value in tags.items()}
    Image.fromarray(image).save(stream, "TIFF", compression="zstd", tiffinfo=tiff_tags)
    return stream.getvalue()


def test_kinds_of_tiff_by_zstandard_are_decoded_or_refused(capfd):
    image = smooth((30, 20, 4))
    assert_array_equal(decode_image(zstd_tiff(image), "x"), image[..., :3])
    with bad_input("or stored turned"):
        decode_image(zstd_tiff(image, tag274=6), "x")
    data = bytearray(zstd_tiff(np.zeros((300, 400), np.uint8)))
    with tifffile.TiffFile(io.BytesIO(data)) as file:
        tag = file.pages.first.tags["ImageWidth"]
        twice = tag.offset
        other = file.pages.first.tags["ImageLength"].offset
    data[other : other + 2] = data[twice : twice + 2]  # two widths, which readers may take apart
    with bad_input():
        decode_image(bytes(data), "x")
    assert capfd.readouterr().err == ""


@pytest.mark.slow
def test_a_bomb_of_zstandard_is_refused_before_memory_is_taken():
    data = bytearray(zstd_tiff(np.zeros((300, 400), np.uint8)))
    with tifffile.TiffFile(io.BytesIO(data)) as file:
        width = file.pages.first.tags["ImageWidth"]
    struct.pack_into("<HII", data, width.offset + 2, 4, 1, 500_000)
    assert peak_bytes_of_refusal(bytes(data), "which cannot be in") < 3_000_000


def test_tiff_with_alpha_or_white_as_zero_is_decoded():
    image = smooth((20, 30, 4))
    alpha = tiff(image, photometric="rgb", extrasamples=["unassalpha"])
    assert_array_equal(decode_image(alpha, "x"), image[..., :3])
    for compression in (None, "zlib"):
        for grey in (image[..., 0], image[..., 0].astype(np.uint16) * 257):
            inverted = tiff(grey, photometric="miniswhite", compression=compression)
            assert_array_equal(decode_image(inverted, "x")[..., 0], np.iinfo(grey.dtype).max - grey)


@pytest.mark.parametrize(
    ("image", "options", "words"),
    [
        (np.zeros((4, 5), np.float32), {}, "float32"),
        (np.zeros((4, 5), np.int16), {}, "int16"),
        (np.zeros((4, 5, 4), np.uint8), {"photometric": "separated"}, "CMYK"),
        (
            np.zeros((4, 5), np.uint8),
            {"photometric": "palette", "colormap": np.zeros((3, 256), np.uint16)},
            "palette",
        ),
        (
            np.zeros((3, 4, 5), np.uint8),
            {"photometric": "rgb", "planarconfig": "separate"},
            "grey nor RGB",
        ),
    ],
)
def test_unsupported_kinds_of_tiff_are_refused(image, options, words):
    with bad_input(words):
        decode_image(tiff(image, **options), "x")


def set_tag(data, tag, entry):
    """Replace type, count and value of a tag of a little-endian TIFF file by 10 bytes."""
    with tifffile.TiffFile(io.BytesIO(data)) as file:
        place = file.pages[0].tags[tag].offset
    return data[: place + 2] + entry + data[place + 12 :]


def jpeg(*segments):
    data = cv2.imencode(".jpg", smooth((20, 30)))[1].tobytes()
    return b"".join((data[:2], *segments, data[2:]))


@pytest.mark.parametrize(
    "data",
    [
        png((3, 4, 8, 0, 0, 0, 0), b"\0\1\2\3" * 4, chunk(b"tEXt", b"k\0v") * 2000),
        png((3, 4, 8, 0, 0, 0, 0), b"\0\1\2\3" * 4, chunk(b"prIv", b"") * 2000),
        png((3, 4, 8, 0, 0, 0, 0), b"\0\1\2\3" * 4)[:-12] + chunk(b"tEXt", b"k\0v") * 2000,
        png((3, 4, 8, 0, 0, 0, 0), b"\0\1\2\3" * 4)[:-12] + chunk(b"IDAT", b"") * 200_000,
        jpeg(b"\xff\xfe\0\2" * 2000),
        jpeg(b"\xff" * 2000),
        tiff(np.zeros((200_000, 1), np.uint8), rowsperstrip=1),
        tiff(np.zeros((200_000, 1), np.uint8), rowsperstrip=1, bigtiff=True, byteorder=">"),
        tiff(smooth((20, 30)), extratags=[(40_000 + k, 3, 1, 1, True) for k in range(2000)]),
    ],
)
def test_files_of_countless_parts_are_refused(data):
    assert peak_bytes_of_refusal(data, "x has more chunks, segments, tags") < 100_000


def test_files_of_many_parts_are_read():
    text, empty = chunk(b"tEXt", b"k\0v") * 900, chunk(b"IDAT", b"") * 50_000
    lines = b"\0\1\2\3" * 4
    assert decode_image(png((3, 4, 8, 0, 0, 0, 0), lines, text, empty), "x").shape == (4, 3, 1)
    assert decode_image(jpeg(b"\xff\xfe\0\2" * 900), "x").shape == (20, 30, 1)
    strips = tiff(np.zeros((50_000, 1), np.uint8), rowsperstrip=1)
    assert decode_image(strips, "x").shape == (50_000, 1, 1)


@pytest.mark.parametrize(
    ("tag", "entry"),
    [
        (256, struct.pack("<HII", 3, 0, 0)),  # no value
        (256, struct.pack("<HII", 2, 4, 30)),  # a text
        (258, struct.pack("<HII", 3, 3, 1 << 31)),  # beyond the file
        (259, struct.pack("<HII", 3, 1, 50000)),
        (262, struct.pack("<HII", 3, 1, 9)),
        (273, struct.pack("<HII", 4, 2, 8)),
        (278, struct.pack("<HII", 4, 1, 1)),  # more strips than are named
        (279, struct.pack("<HII", 4, 1, 1 << 30)),
        (257, struct.pack("<HII", 4, 1, 1 << 20)),
        (257, struct.pack("<HII", 4, 1, 0)),
    ],
)
def test_tiff_tags_that_contradict_the_file_are_refused(tag, entry, capfd):
    data = tiff(smooth((20, 30)), rowsperstrip=20)
    assert peak_bytes_of_refusal(set_tag(data, tag, entry), r"^x ") < 1_000_000
    assert capfd.readouterr().err == ""


def test_strips_may_not_share_their_bytes():
    data = tiff(smooth((20, 30)), rowsperstrip=5)
    with tifffile.TiffFile(io.BytesIO(data)) as file:
        first = min(file.pages[0].dataoffsets)
    again = data + struct.pack("<4I", *[len(data) - first] * 4) + struct.pack("<4I", *[first] * 4)
    again = set_tag(again, 279, struct.pack("<HII", 4, 4, len(data)))
    again = set_tag(again, 273, struct.pack("<HII", 4, 4, len(data) + 16))
    with bad_input("tags are damaged"):
        decode_image(again, "x")


def test_a_strip_inflates_to_its_size_and_no_further():
    bomb = zlib.compress(bytes(50_000_000))
    data = tiff(np.zeros((300, 400), np.uint8), compression="zlib", rowsperstrip=300)
    bigger = set_tag(data + bomb, 273, struct.pack("<HII", 4, 1, len(data)))
    bigger = set_tag(bigger, 279, struct.pack("<HII", 4, 1, len(bomb)))
    tracemalloc.start()
    assert decode_image(bigger, "x").shape == (300, 400, 1)
    assert tracemalloc.get_traced_memory()[1] < 2_000_000
    tracemalloc.stop()
