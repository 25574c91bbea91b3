"""Prints of 500 and 1000 ppi as PNG and TIFF: pixels and resolution, also as other programs see
them."""

import struct

import cv2
import numpy as np
import pytest
import tifffile
from numpy.testing import assert_array_equal

from refusals import bad_input
from splitknit.errors import BadInput
from splitknit.io.prints import write_print_png
from splitknit_match.records.pictures import PrintFile, decode_print_image, encode_print_tiff
from splitknit_match.records.print_formats import read_prints
from written_files import read_by_all

IMAGE = np.random.default_rng(3).integers(0, 256, (31, 23)).astype(np.uint8)


def read(path):
    (print_file,) = read_prints(path)
    assert isinstance(print_file, PrintFile)
    return print_file


def write_tiff(path, *print_and_facts):
    path.write_bytes(encode_print_tiff(*print_and_facts))


@pytest.mark.parametrize("ppi", [500, 1000, 787.4])
def test_tiff_states_its_resolution(tmp_path, ppi):
    write_tiff(tmp_path / "a.tiff", IMAGE, ppi, {"software": "splitknit", "note": "Größe"})
    print_file = read(tmp_path / "a.tiff")
    assert_array_equal(print_file.image, IMAGE)
    assert print_file.resolution_ppi == pytest.approx(ppi, rel=1e-6)
    assert print_file.text == {"software": "splitknit", "note": "Größe"}
    write_tiff(tmp_path / "b.tiff", IMAGE, ppi, {"note": "Größe", "software": "splitknit"})
    assert (tmp_path / "b.tiff").read_bytes() == (tmp_path / "a.tiff").read_bytes()


def test_other_programs_see_it(tmp_path):
    pillow = pytest.importorskip("PIL.Image")
    write_tiff(tmp_path / "a.tiff", IMAGE, 1000)
    write_print_png(tmp_path / "a.png", IMAGE, 1000)
    for name in ("a.tiff", "a.png"):
        with pillow.open(tmp_path / name) as image:
            assert image.mode == "L"
            assert float(image.info["dpi"][0]) == pytest.approx(1000, abs=0.02)
            assert_array_equal(np.asarray(image), IMAGE)


def test_tiffs_of_others_are_read(tmp_path):
    file = tmp_path / "a.tiff"
    tifffile.imwrite(
        file,
        IMAGE,
        photometric="minisblack",
        metadata=None,
        resolution=(200, 200),
        resolutionunit=3,
    )
    assert read(file).resolution_ppi == pytest.approx(508)
    tifffile.imwrite(file, IMAGE, photometric="minisblack", metadata=None, description="a print")
    assert (read(file).resolution_ppi, read(file).text) == (None, {})
    tifffile.imwrite(
        file,
        IMAGE,
        photometric="minisblack",
        metadata=None,
        resolution=(500, 400),
        resolutionunit=2,
    )
    assert (read(file).resolution_ppi, read(file).image.shape) == (
        500,
        (round(IMAGE.shape[0] * 1.25), IMAGE.shape[1]),
    )
    tifffile.imwrite(file, np.stack([IMAGE] * 3, axis=-1), photometric="rgb", metadata=None)
    assert_array_equal(read(file).image, IMAGE)
    tifffile.imwrite(
        file, np.stack([IMAGE, IMAGE, IMAGE // 2], axis=-1), photometric="rgb", metadata=None
    )
    with bad_input("not an 8-bit grey image"):
        read(file)


@pytest.mark.parametrize(
    ("image", "ppi", "words"), [(IMAGE / 2, 500, "uint8"), (IMAGE, 5, "between 10 and 100000")]
)
def test_other_images_are_refused(tmp_path, image, ppi, words):
    with bad_input(words):
        write_tiff(tmp_path / "a.tiff", image, ppi)
    assert not (tmp_path / "a.tiff").exists()


@pytest.mark.parametrize(
    ("tag", "entry", "resolution"),
    [
        (282, struct.pack("<HII", 5, 1, 1 << 31), 0),  # a fraction beyond the file
        (282, struct.pack("<HIf", 11, 1, 500.0), 0),  # of another type: not known
        (270, struct.pack("<HII", 2, 4, 0xFFFFFFFF), 500),  # a text that is not text
        (296, struct.pack("<HII", 3, 1, 9), 0),  # no unit
    ],
)
def test_odd_tags_of_a_print_are_no_crash(tmp_path, tag, entry, resolution):
    """`resolution` is 0 where none is known."""
    path = tmp_path / "a.tiff"
    write_tiff(path, IMAGE, 500, {"note": "x"})
    with tifffile.TiffFile(path) as file:
        place = file.pages[0].tags[tag].offset
    data = path.read_bytes()
    path.write_bytes(data[: place + 2] + entry + data[place + 12 :])
    print_file = read(path)
    assert (print_file.resolution_ppi or 0) == pytest.approx(resolution)
    np.testing.assert_array_equal(print_file.image, IMAGE)


def test_a_print_as_tiff_is_read_by_all_whatever_its_texts_are_called(tmp_path):
    image = np.random.default_rng(0).integers(0, 256, (30, 20)).astype(np.uint8)
    text = {"shape": "oval", 'a"shape': '{"shape":[1]}'}
    path = tmp_path / "print.tiff"
    path.write_bytes(encode_print_tiff(image, 500, text))
    np.testing.assert_array_equal(read_by_all(path), image)
    assert decode_print_image(path.read_bytes(), "x").text == text


@pytest.mark.parametrize("suffix", ["png", "tif", "jpg", "bmp"])
def test_a_print_of_too_many_pixels_is_not_decoded(suffix, monkeypatch):
    def never(*_: object) -> None:
        raise AssertionError("it was decoded")

    monkeypatch.setattr("splitknit.io.photos.decode_pixels", never)
    data = cv2.imencode(f".{suffix}", np.zeros((8100, 8000), np.uint8))[1].tobytes()
    with pytest.raises(BadInput, match="x has 8100 x 8000 pixels, more than the 64000000"):
        decode_print_image(data, "x")
