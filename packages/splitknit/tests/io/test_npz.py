"""Archives of arrays: what numpy writes is read, and sizes are checked before memory is taken."""

from __future__ import annotations

import lzma
import struct
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.io.npz import read_npz, write_npz

ARRAYS = {
    "plain": np.arange(12.0).reshape(3, 4),
    "by_columns": np.asfortranarray(np.arange(24, dtype=np.float32).reshape(2, 3, 4)),
    "one": np.float64(3.5),
    "text": np.array("höhe"),
    "bytes": np.array([b"ab", b"c"]),
    "mask": np.eye(3, dtype=bool),
    "empty": np.zeros((0, 5)),
    "big_endian": np.arange(5, dtype=">i2"),
}
HEAD = "{'descr': '<f4', 'fortran_order': False, 'shape': (3,), }"


def npy(header: str, body: bytes, version: bytes = b"\1\0") -> bytes:
    text = header.encode().ljust(117) + b"\n"
    return b"\x93NUMPY" + version + len(text).to_bytes(2, "little") + text + body


def archive(path: Path, *members: tuple[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> Path:
    with zipfile.ZipFile(path, "w", method) as stream:
        for name, content in members:
            stream.writestr(name, content)
    return path


@pytest.mark.parametrize(
    "write",
    [
        write_npz,
        lambda path, arrays: np.savez(path, **arrays),
        lambda path, arrays: np.savez_compressed(path, **arrays),
    ],
)
def test_arrays_of_numpy_and_of_ours_are_read(tmp_path: Path, write: Callable[..., None]) -> None:
    write(tmp_path / "a.npz", ARRAYS)
    found = read_npz(tmp_path / "a.npz")
    assert list(found) == list(ARRAYS)
    for name, array in ARRAYS.items():
        np.testing.assert_array_equal(found[name], array)
        assert found[name].dtype == np.asarray(array).dtype and found[name].shape == np.shape(array)
    assert list(read_npz(tmp_path / "a.npz", ("mask", "one", "none"))) == ["one", "mask"]


def test_a_bomb_is_refused_before_memory_is_taken(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez_compressed(path, small=np.ones(3), large=np.zeros(50_000_000, np.uint8))
    assert path.stat().st_size < 100_000
    tracemalloc.start()
    with pytest.raises(BadInput, match=r"50000\d+ bytes, but at most 40000000 are read"):
        read_npz(path, max_bytes=40_000_000)
    assert read_npz(path, ["small"], 10_000)["small"].size == 3
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 5_000_000


@pytest.mark.parametrize(
    "content",
    [
        npy(HEAD, b"\0" * 8),  # shorter than its shape
        npy(HEAD, b"\0" * 16),  # longer
        npy(HEAD.replace("3,", "9999999999, 9999999999,"), b"\0" * 12),
        npy(HEAD.replace("3,", "-3,"), b"\0" * 12),
        npy(HEAD.replace("<f4", "|O"), b"\0" * 12),
        npy(HEAD.replace("'<f4'", "[('a', '<f4')]"), b"\0" * 12),
        npy(HEAD.replace("(3,)", "(9**9**9,)"), b"\0" * 12),
        npy("(" * 100, b""),
        npy(HEAD, b"\0" * 12, b"\3\0"),
        b"\x93NUMPY",
        b"",
    ],
)
def test_headers_that_do_not_fit_are_refused(tmp_path: Path, content: bytes) -> None:
    with pytest.raises(BadInput, match="damaged"):
        read_npz(archive(tmp_path / "a.npz", ("a.npy", content)))


def test_archives_of_other_kinds_are_refused(tmp_path: Path) -> None:
    sound = npy(HEAD, b"\0" * 12)
    with pytest.warns(UserWarning, match="Duplicate"):
        archive(tmp_path / "twice.npz", ("a.npy", sound), ("a.npy", sound))
    archive(tmp_path / "lzma.npz", ("a.npy", sound), method=zipfile.ZIP_LZMA)
    archive(tmp_path / "many.npz", *((f"{k}.npy", sound) for k in range(1001)))
    locked = bytearray(archive(tmp_path / "locked.npz", ("a.npy", sound)).read_bytes())
    locked[6] |= 1
    locked[locked.index(b"PK\1\2") + 8] |= 1
    (tmp_path / "locked.npz").write_bytes(locked)
    changed = bytearray(archive(tmp_path / "changed.npz", ("a.npy", sound), method=zipfile.ZIP_STORED).read_bytes())
    changed[changed.index(sound) + len(sound) - 1] ^= 1
    (tmp_path / "changed.npz").write_bytes(changed)
    (tmp_path / "none.npz").write_bytes(lzma.compress(sound))
    for name in ("twice", "lzma", "many", "locked", "changed", "none"):
        with pytest.raises(BadInput, match=f"{name}.npz cannot be read as arrays"):
            read_npz(tmp_path / f"{name}.npz")


def test_an_archive_is_the_same_on_any_number_of_threads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    heights = np.full((700, 1000), np.nan, dtype=np.float32)
    heights[100:600, 333:777] = rng.standard_normal((500, 444), dtype=np.float32)
    inside = 4 * 500 * 444
    files = []
    for cores in (1, 4):
        monkeypatch.setattr("os.cpu_count", lambda cores=cores: cores)
        write_npz(tmp_path / f"{cores}.npz", {"heights": heights, "counts": np.arange(600_000) % 7})
        files.append((tmp_path / f"{cores}.npz").read_bytes())
    assert files[0] == files[1]
    with zipfile.ZipFile(tmp_path / "1.npz") as stream:
        assert stream.testzip() is None
        packed = {one.filename: one.compress_size for one in stream.infolist()}
    assert packed["heights.npy"] < inside  # NaN beside a finger take no room
    assert packed["counts.npy"] < 0.05 * 8 * 600_000  # what shrinks is still deflated
    with np.load(tmp_path / "1.npz") as found:
        np.testing.assert_array_equal(found["heights"], heights)
    np.testing.assert_array_equal(read_npz(tmp_path / "1.npz")["heights"], heights)


def test_a_long_list_of_files_takes_no_memory(tmp_path: Path) -> None:
    entry = struct.pack("<4sHHHHHHIIIHHHHHII", b"PK\1\2", 20, 20, 0, 0, 0, 33, 0, 0, 0, 2, 0, 0, 0, 0, 0, 0) + b"%02x"
    listed = entry * 100_000
    end = struct.pack("<4sHHHHIIH", b"PK\5\6", 0, 0, 0xFFFF, 0xFFFF, len(listed), 0, 0)
    (tmp_path / "a.npz").write_bytes(listed + end)
    tracemalloc.start()
    try:
        with pytest.raises(BadInput, match="damaged"):
            read_npz(tmp_path / "a.npz")
        assert tracemalloc.get_traced_memory()[1] < 1_000_000
    finally:
        tracemalloc.stop()


def test_files_of_an_archive_that_lie_on_each_other_are_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        for k in range(3):
            archive.writestr(f"{k}.npy", b"0" * 1000)
            archive.infolist()[k].header_offset = 0
        archive.infolist()[2].compress_size = 3000
    with pytest.raises(BadInput, match="damaged"):
        read_npz(tmp_path / "a.npz")
