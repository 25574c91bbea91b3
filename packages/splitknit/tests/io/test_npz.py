"""Archives of arrays: what numpy writes is read, and sizes are checked before memory is taken."""

import lzma
import tracemalloc
import zipfile

import numpy as np
import pytest

from refusals import bad_input
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


def npy(header, body, version=b"\1\0"):
    text = header.encode().ljust(117) + b"\n"
    return b"\x93NUMPY" + version + len(text).to_bytes(2, "little") + text + body


def archive(path, *members, method=zipfile.ZIP_DEFLATED):
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
def test_archives_of_numpy_and_splitknit_are_read(tmp_path, write):
    write(tmp_path / "a.npz", ARRAYS)
    read = read_npz(tmp_path / "a.npz")
    assert list(read) == list(ARRAYS)
    for name, array in ARRAYS.items():
        np.testing.assert_array_equal(read[name], array)
        assert read[name].dtype == np.asarray(array).dtype and read[name].shape == np.shape(array)
    assert list(read_npz(tmp_path / "a.npz", ("mask", "one", "none"))) == ["one", "mask"]


def test_a_bomb_is_refused_before_memory_is_taken(tmp_path):
    path = tmp_path / "a.npz"
    np.savez_compressed(path, small=np.ones(3), large=np.zeros(50_000_000, np.uint8))
    assert path.stat().st_size < 100_000
    tracemalloc.start()
    with bad_input(r"50000\d+ bytes, but at most 40000000 are read"):
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
        npy(HEAD.replace("(3,)", "(9**9**9,)"), b"\0" * 12),
        npy("(" * 100, b""),
        b"\x93NUMPY",
        b"",
    ],
)
def test_headers_that_contradict_their_data_are_refused(tmp_path, content):
    with bad_input("damaged"):
        read_npz(archive(tmp_path / "a.npz", ("a.npy", content)))


def test_encrypted_damaged_and_foreign_archives_are_refused(tmp_path):
    sound = npy(HEAD, b"\0" * 12)
    locked = bytearray(archive(tmp_path / "locked.npz", ("a.npy", sound)).read_bytes())
    locked[6] |= 1
    locked[locked.index(b"PK\1\2") + 8] |= 1
    changed = bytearray(
        archive(tmp_path / "changed.npz", ("a.npy", sound), method=zipfile.ZIP_STORED).read_bytes()
    )
    changed[changed.index(sound) + len(sound) - 1] ^= 1
    for data in (locked, changed, lzma.compress(sound), b"", changed[:-30]):
        (tmp_path / "a.npz").write_bytes(data)
        with bad_input(r"a\.npz cannot be read as arrays"):
            read_npz(tmp_path / "a.npz")


def test_an_archive_is_the_same_each_time_and_states_no_date(tmp_path):
    write_npz(tmp_path / "a.npz", ARRAYS)
    first = (tmp_path / "a.npz").read_bytes()
    write_npz(tmp_path / "a.npz", ARRAYS)
    assert (tmp_path / "a.npz").read_bytes() == first
    with zipfile.ZipFile(tmp_path / "a.npz") as stream:
        assert stream.testzip() is None
        assert {member.date_time for member in stream.infolist()} == {(1980, 1, 1, 0, 0, 0)}


@pytest.mark.parametrize(
    ("arrays", "words"),
    [({"a/b": 1}, "named"), ({"": 1}, "named"), ({"a": np.array([None])}, "objects")],
)
def test_names_and_objects_that_cannot_be_stored_are_refused(tmp_path, arrays, words):
    with bad_input(words):
        write_npz(tmp_path / "a.npz", arrays)
    assert list(tmp_path.iterdir()) == []
