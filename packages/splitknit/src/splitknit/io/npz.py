"""Deterministic ``.npz`` archives, compressed on all cores.

:func:`numpy.savez_compressed` uses one core, and :mod:`zipfile` takes nothing that is packed already.
So the arrays are packed side by side, and the archive around them is written here.

Source: APPNOTE.TXT, .ZIP File Format Specification 6.3, sections 4.3.7, 4.3.12 and 4.3.16; RFC 1951 (deflate), section
3.2.4: a stored block ends on a byte, so that another stream can follow.
"""

from __future__ import annotations

import io
import math
import os
import re
import struct
import zipfile
import zlib
from collections.abc import Collection, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import IO, Any, Literal

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, open_file, refusing, require
from splitknit.io.atomic import atomic_file

_LIMIT = (1 << 32) - 1
_DATE = (0, (0 << 9) | (1 << 5) | 1)  # 1980-01-01 00:00, the first date a ZIP archive knows
_DEFLATE = 8
RESULT_BYTES = 600_000_000  # arrays read at once, at most: a result of 25 million pixels, three times the rig's
_PIECE, _LONGEST_RUN, _LONGEST_STORED = 256, 1024, 65535  # bytes, pieces, bytes (the most of a stored block)
_MAX_FILES, _LIMIT_OF_END = 1000, 22 + 65535  # files of an archive, and the bytes of its end, comment included
_LONGEST_HEADER = 4096
_HEADER = re.compile(
    rb"\{'descr': '(?P<dtype>[<>|][biufcSU]\d{1,7})', 'fortran_order': (?P<order>True|False), "
    rb"'shape': \((?P<shape>[\d, ]{0,200})\), \} *\n"
)
"""What numpy writes before the values of an array of numbers or text."""


def write_npz(path: str | os.PathLike[str], arrays: Mapping[str, Any]) -> None:
    """Write arrays and numbers, in order, as ``.npz``; equal input gives equal bytes. Raises BadInput if a name or an
    array cannot be stored (objects, 4 GB or more), or on writing.
    """
    members = {}
    for name, value in arrays.items():
        require(bool(name) and name.isascii() and not set(name) & set("/\\\0"), f"an array cannot be named {name!r}.")
        array = members[f"{name}.npy".encode("ascii")] = np.asarray(value)
        require(not array.dtype.hasobject, f"the array '{name}' holds objects; only numbers and text are stored.")
        require(array.nbytes < _LIMIT - 65536, f"the array '{name}' has {array.nbytes} bytes; at most 4 GB fit.")
    with atomic_file(path) as stream, ThreadPoolExecutor(min(4, os.cpu_count() or 1)) as pool:
        entries = []
        for file, (common, content) in zip(members, pool.map(_packed, members.values()), strict=True):
            offset = stream.tell()
            require(offset <= _LIMIT, "the arrays do not fit into a ZIP archive of 4 GB.")
            rest = struct.pack("<HHHHHII", len(file), 0, 0, 0, 0, 0, offset) + file
            entries.append(b"PK\x01\x02" + struct.pack("<H", 20) + common + rest)
            stream.write(b"PK\x03\x04" + common + struct.pack("<HH", len(file), 0) + file)
            stream.writelines(content)
        start, directory = stream.tell(), b"".join(entries)
        require(start <= _LIMIT, "the arrays do not fit into a ZIP archive of 4 GB.")
        end = struct.pack("<HHHHIIH", 0, 0, len(entries), len(entries), len(directory), start, 0)
        stream.write(directory + b"PK\x05\x06" + end)


def _packed(array: np.ndarray[Any, Any]) -> tuple[bytes, list[bytes | memoryview]]:
    """What both headers of an archive's file have in common, and its packed content."""
    head = io.BytesIO()
    array = array if array.flags.c_contiguous or array.flags.f_contiguous else np.ascontiguousarray(array)
    np.lib.format.write_array_header_1_0(head, np.lib.format.header_data_from_array_1_0(array))
    first = head.getvalue()
    body = (array if array.flags.c_contiguous else array.T).reshape(-1).view(np.uint8)
    content = [_stored_block(0, len(first)), first, *_deflated(body, array.dtype)]
    sizes = sum(map(len, content)), len(first) + len(body)
    crc = zlib.crc32(body.data, zlib.crc32(first))
    return struct.pack("<HHHHHIII", 20, 0, _DEFLATE, *_DATE, crc, *sizes), content


def _deflated(body: NDArray[np.uint8], dtype: np.dtype[Any]) -> list[bytes | memoryview]:
    """A deflate stream of an array's bytes. Measured single-precision numbers hardly shrink: where a sample of them
    does not, they are stored, and only runs of one number are packed, in a fifth of the time.
    """
    words = body[: len(body) // _PIECE * _PIECE].view(np.uint32).reshape(-1, _PIECE // 4)
    same = (words[:, 1:] == words[:, :1]).all(axis=1)
    sample = words[~same][::16].reshape(-1).view(np.uint8)
    shrunk = len(_compressed(sample)) - 1000  # small arrays do not matter
    if dtype != np.float32 or shrunk <= 0.8 * len(sample):
        return [_compressed(body)]
    number = np.where(same, words[:, 0].astype(np.int64), -1)
    ends = [*(np.flatnonzero(np.diff(number)) + 1).tolist(), len(number)]
    pieces: list[bytes | memoryview] = []
    for start, end in zip([0, *ends], ends, strict=False):
        if same[start]:
            one = words[start, :1].tobytes()
            pieces += [_run(one, min(_LONGEST_RUN, end - k)) for k in range(start, end, _LONGEST_RUN)]
            continue
        for k in range(_PIECE * start, _PIECE * end, _LONGEST_STORED):
            part = body[k : min(k + _LONGEST_STORED, _PIECE * end)]
            pieces += [_stored_block(0, len(part)), part.data]
    rest = body[_PIECE * len(number) :]
    return [*pieces, _stored_block(1, len(rest)), rest.data]


def _compressed(body: NDArray[np.uint8]) -> bytes:
    packer = zlib.compressobj(1, zlib.DEFLATED, -15)
    return packer.compress(body.data) + packer.flush()


def _stored_block(last: int, length: int) -> bytes:
    """What stands before `length` bytes that are stored; the `last` block of a stream is marked by 1."""
    return struct.pack("<BHH", last, length, length ^ 0xFFFF)


@lru_cache(1024)
def _run(word: bytes, pieces: int) -> bytes:
    """Blocks of a deflate stream, to the end of a byte, for a number that is repeated over some pieces."""
    packer = zlib.compressobj(1, zlib.DEFLATED, -15)
    return packer.compress(word * (pieces * _PIECE // len(word))) + packer.flush(zlib.Z_SYNC_FLUSH)


def read_npz(
    path: str | os.PathLike[str], names: Collection[str] | None = None, max_bytes: int = RESULT_BYTES
) -> dict[str, np.ndarray[Any, Any]]:
    """Arrays of an ``.npz`` file, those of `names` that are there, or all; no pickled objects. Raises BadInput if the
    file is missing or damaged, or larger than `max_bytes` in all.
    """
    name = os.fspath(path)
    damaged = f"{name} cannot be read as arrays: it is damaged, or no .npz file of numbers; write it again."
    with open_file(path, _LIMIT) as (stream, whole), refusing(damaged), plain_zip(stream, whole, damaged) as archive:
        members = (one for one in archive.infolist() if one.filename.endswith(".npy"))
        chosen = {one.filename.removesuffix(".npy"): one for one in members}
        if names is not None:
            chosen = {key: one for key, one in chosen.items() if key in names}
        size = sum(one.file_size for one in chosen.values())
        require(size <= max_bytes, f"{name} holds arrays of {size} bytes, but at most {max_bytes} are read.")
        with ThreadPoolExecutor(min(4, os.cpu_count() or 1)) as pool:
            packed = ((key, _stored(stream, one, damaged), one) for key, one in chosen.items())
            jobs = {key: pool.submit(_unpacked, stored, one, damaged) for key, stored, one in packed}
            return {key: job.result() for key, job in jobs.items()}


def plain_zip(stream: IO[bytes], size: int, damaged: str) -> zipfile.ZipFile:
    """Open a ZIP archive of `size` bytes with at most a thousand files, each once and by deflate or stored, listed
    before memory is taken. Raises BadInput (`damaged`) for another.
    """
    stream.seek(max(0, size - _LIMIT_OF_END))
    end = stream.read()
    place = end.rfind(b"PK\x05\x06")
    require(place >= 0 and end[max(0, place - 20) :][:4] != b"PK\x06\x07", damaged)  # ZIP64 states its length elsewhere
    listed = int.from_bytes(end[place + 12 : place + 16], "little")
    require(listed <= _MAX_FILES * _LONGEST_HEADER, damaged)
    archive = zipfile.ZipFile(stream)
    members = archive.infolist()
    once = len({one.filename for one in members}) == len(members) <= _MAX_FILES
    plain = all(one.compress_type in (zipfile.ZIP_STORED, _DEFLATE) and not one.flag_bits & 1 for one in members)
    require(once and plain and sum(one.compress_size for one in members) <= size, damaged)
    return archive


def _stored(stream: IO[bytes], info: zipfile.ZipInfo, damaged: str) -> bytes:
    """The packed bytes of a file of an archive; no more than it can need are read."""
    require(info.compress_size <= info.file_size + info.file_size // 1000 + 1000, damaged)
    stream.seek(info.header_offset)
    head = stream.read(30)
    require(head[:4] == b"PK\x03\x04", damaged)
    stream.seek(sum(struct.unpack_from("<HH", head, 26)), os.SEEK_CUR)
    return stream.read(info.compress_size)


def _unpacked(stored: bytes, info: zipfile.ZipInfo, damaged: str) -> np.ndarray[Any, Any]:
    """The array of a file of an archive; its header must fit the size that the archive gives."""
    content = np.frombuffer(bytearray(stored), np.uint8)
    if info.compress_type == _DEFLATE:
        content = np.frombuffer(bytearray(zlib.decompressobj(-15).decompress(stored, info.file_size)), np.uint8)
    require(len(content) == info.file_size and zlib.crc32(content.data) == info.CRC, damaged)
    dtype, shape, order, start = _header(io.BytesIO(content[: _LONGEST_HEADER + 12].tobytes()), damaged)
    require(len(content) - start == dtype.itemsize * math.prod(shape), damaged)
    return content[start:].view(dtype).reshape(shape, order=order)


def _header(stream: IO[bytes], damaged: str) -> tuple[np.dtype[Any], tuple[int, ...], Literal["C", "F"], int]:
    """Type, shape, order and place of the values of an ``.npy`` file; a header is matched, never evaluated."""
    start = stream.read(10)
    require(start[:6] == b"\x93NUMPY" and start[6:8] in (b"\1\0", b"\2\0"), damaged)
    start += stream.read(2) if start[6] == 2 else b""
    length = int.from_bytes(start[8:], "little")
    require(length <= _LONGEST_HEADER, damaged)
    found = _HEADER.fullmatch(stream.read(length))
    if found is None:
        raise BadInput(damaged)
    shape = tuple(int(side) for side in found["shape"].replace(b" ", b"").split(b",") if side)
    dtype = np.dtype(found["dtype"].decode("ascii"))
    return dtype, shape, "F" if found["order"] == b"True" else "C", len(start) + length
