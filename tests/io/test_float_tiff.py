from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import tifffile

from splitknit.errors import BadInput
from splitknit.io.float_tiff import _read_float_tiff, _write_float_tiff, read_height_tiff, read_light_tiff

FIELD = np.linspace(-1, 1, 24, dtype=np.float32).reshape(4, 6)


@pytest.mark.parametrize("field", [FIELD, np.dstack([FIELD, 2 * FIELD, 3 * FIELD])], ids=["grey", "colour"])
def test_what_was_written_is_read(field: np.ndarray, tmp_path: Path) -> None:
    path = tmp_path / "a.tiff"
    _write_float_tiff(path, field, {"unit": "rad", "by": [1, 2.5]})
    found, description = _read_float_tiff(path, "a field")
    np.testing.assert_array_equal(found, field)
    assert description == {"unit": "rad", "by": [1, 2.5]}


def test_other_files_are_refused_in_one_sentence(tmp_path: Path) -> None:
    path = tmp_path / "a.tiff"
    _write_float_tiff(path, FIELD, {"unit": "rad"})
    whole = path.read_bytes()
    for content in (b"", b"hello", whole[:40], whole[: len(whole) // 2]):
        path.write_bytes(content)
        with pytest.raises(BadInput) as caught:
            _read_float_tiff(path, "a field")
        assert "\n" not in str(caught.value) and str(path) in str(caught.value)
    for image, description in (
        (FIELD, "no object"),
        (FIELD, '{"unit": 3}'),
        (FIELD.astype(np.uint8), '{"unit": "mm"}'),
    ):
        tifffile.imwrite(path, image, description=description, metadata=None)
        with pytest.raises(BadInput, match="is not a field of splitknit"):
            _read_float_tiff(path, "a field")


def test_light_is_no_height(tmp_path: Path) -> None:
    path = tmp_path / "a.tiff"
    for description in (
        {"unit": "rad"},
        {"unit": "mm"},
        {"unit": "mm", "pitch_mm": "x"},
        {"unit": "mm", "pitch_mm": 0},
    ):
        _write_float_tiff(path, FIELD, description)
        assert read_light_tiff(path)[1] == description
        with pytest.raises(BadInput, match="is not a height map"):
            read_height_tiff(path)


def test_a_small_file_cannot_claim_a_large_field(tmp_path: Path) -> None:
    path = tmp_path / "a.tiff"
    _write_float_tiff(path, FIELD, {"unit": "rad"})
    whole = path.read_bytes()
    with tifffile.TiffFile(path) as file:
        places = [file.pages[0].tags[tag].valueoffset for tag in (256, 257, 278)]
    for side, words in ((9000, "cannot be in"), (30_000, "more than the 400000000 that are read")):
        data = bytearray(whole)
        for place in places:
            data[place : place + 4] = side.to_bytes(4, "little")
        path.write_bytes(data)
        tracemalloc.start()
        with pytest.raises(BadInput, match=words):
            _read_float_tiff(path, "a field")
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 1_000_000
