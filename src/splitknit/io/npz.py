"""Deterministic ``.npz`` archives, compressed on all cores.

:func:`numpy.savez_compressed` uses one core and a slow engine. Here blocks of fixed size are deflated side by side and
joined into one stream, as pigz does; so the bytes do not depend on the number of threads. Measured numbers, which
deflate makes 10 % smaller in most of the time that writing a result takes, are stored, and only what is the same over
long runs is packed.

Source: APPNOTE.TXT, .ZIP File Format Specification 6.3, sections 4.3.7, 4.3.12 and 4.3.16; RFC 1951 (deflate), section
3.2.4: a sync flush ends on a byte, so that streams can be joined.
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
from itertools import pairwise
from typing import IO, Any, BinaryIO, Literal

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, open_file, refusing, require
from splitknit.io.atomic import atomic_file
from splitknit.io.deflate import engine

_BLOCK = 1 << 20
_PAGE = 128
"""Bytes in which a run of one value is looked for."""
_SAMPLED = 192
"""Pages of a block that are deflated to see whether the rest is worth it."""
_HARDLY = 0.85
"""Numbers whose pages do not shrink to this are stored: a finger's heights keep 90 % at six times the time."""
_STORED = 65535
"""Bytes of a stored block at most (RFC 1951, section 3.2.4)."""
_LIMIT = (1 << 32) - 1
_DATE = (0, (0 << 9) | (1 << 5) | 1)  # 1980-01-01 00:00, the first date a ZIP archive knows
_DEFLATE = 8
_ALL_TRUE = np.uint64(0x0101010101010101)
"""Eight booleans."""
RESULT_BYTES = 600_000_000
"""Of arrays that are read at once: those that a use needs of a result of 25 million pixels, three times the rig's."""
_MAX_ARRAYS = 1000
_LONGEST_HEADER = 4096
_HEADER = re.compile(
    rb"\{'descr': '(?P<dtype>[<>|][biufcSU]\d{1,7})', 'fortran_order': (?P<order>True|False), "
    rb"'shape': \((?P<shape>[\d, ]{0,200})\), \} *\n"
)
"""What numpy writes before the values of an array of numbers or text."""


def write_npz(path: str | os.PathLike[str], arrays: Mapping[str, Any]) -> None:
    """Write arrays and numbers, in the order given, as an ``.npz`` file; equal input gives equal bytes. Raises BadInput
    if a name or an array cannot be stored (objects, 4 GB or more), or the file cannot be written.
    """
    workers = min(8, os.cpu_count() or 1)
    with atomic_file(path) as stream, ThreadPoolExecutor(workers) as pool:
        entries = []
        for name, value in arrays.items():
            require(
                bool(name) and name.isascii() and not set(name) & set("/\\\0"), f"an array cannot be named {name!r}."
            )
            array = np.asarray(value)
            require(not array.dtype.hasobject, f"the array '{name}' holds objects; only numbers and text are stored.")
            require(array.nbytes < _LIMIT - 65536, f"the array '{name}' has {array.nbytes} bytes; at most 4 GB fit.")
            entries.append(_write_member(stream, f"{name}.npy".encode("ascii"), array, pool))
        _write_directory(stream, entries)


def read_npz(
    path: str | os.PathLike[str], names: Collection[str] | None = None, max_bytes: int = RESULT_BYTES
) -> dict[str, np.ndarray[Any, Any]]:
    """Read arrays of an ``.npz`` file, those of `names` that are there, or all; pickled objects are refused. Raises
    BadInput if the file is missing or damaged, or its arrays together are larger than `max_bytes`.
    """
    name = os.fspath(path)
    damaged = f"{name} cannot be read as arrays: it is damaged, or no .npz file of numbers; write it again."
    with open_file(path, _LIMIT) as (stream, _), refusing(damaged), zipfile.ZipFile(stream) as archive:
        members = archive.infolist()
        require(len({one.filename for one in members}) == len(members) <= _MAX_ARRAYS, damaged)
        chosen = {one.filename.removesuffix(".npy"): one for one in members if one.filename.endswith(".npy")}
        if names is not None:
            chosen = {key: one for key, one in chosen.items() if key in names}
        plain = all(one.compress_type in (zipfile.ZIP_STORED, _DEFLATE) for one in chosen.values())
        require(plain and not any(one.flag_bits & 1 for one in chosen.values()), damaged)
        size = sum(one.file_size for one in chosen.values())
        require(size <= max_bytes, f"{name} holds arrays of {size} bytes, but at most {max_bytes} are read.")
        with ThreadPoolExecutor(min(4, os.cpu_count() or 1)) as pool:
            jobs = {key: pool.submit(_read_member, archive, one, damaged) for key, one in chosen.items()}
            return {key: job.result() for key, job in jobs.items()}


def map_npy(path: str | os.PathLike[str], damaged: str | None = None) -> np.ndarray[Any, Any]:
    """Map an ``.npy`` file into memory, read-only: it may be larger than the memory. Raises BadInput if the file is
    missing or damaged, then with `damaged`, the whole message with the remedy.
    """
    damaged = damaged or f"'{os.fspath(path)}' is damaged or no .npy file of numbers; make it again."
    with open_file(path, 1 << 50) as (stream, size), refusing(damaged):
        dtype, shape, order, start = _header(stream, damaged)
        require(0 < size - start == dtype.itemsize * math.prod(shape), damaged)
        return np.memmap(stream, dtype, "r", start, shape, order)


def _read_member(archive: zipfile.ZipFile, info: zipfile.ZipInfo, damaged: str) -> np.ndarray[Any, Any]:
    """Read an array of an archive; its header must fit the size that the archive gives."""
    with archive.open(info) as member:
        dtype, shape, order, start = _header(member, damaged)
        require(info.file_size - start == dtype.itemsize * math.prod(shape), damaged)
        array = np.empty(shape, dtype, order)
        body = (array.T if order == "F" else array).reshape(-1).view(np.uint8)
        done = 0
        while done < len(body):
            block = member.read(min(_BLOCK, len(body) - done))
            require(len(block) > 0, damaged)
            body[done : done + len(block)] = np.frombuffer(block, np.uint8)
            done += len(block)
        require(member.read(1) == b"", damaged)  # the end, where the checksum is compared
        return array


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


def _write_member(
    stream: BinaryIO, name: bytes, array: np.ndarray[Any, Any], pool: ThreadPoolExecutor
) -> tuple[bytes, bytes, int]:
    """Write one file of the archive; return its name, the common part of its headers, and its offset."""
    head = io.BytesIO()
    array = array if array.flags.c_contiguous or array.flags.f_contiguous else np.ascontiguousarray(array)
    np.lib.format.write_array_header_1_0(head, np.lib.format.header_data_from_array_1_0(array))
    flat = array if array.flags.c_contiguous else array.T
    body = flat.reshape(-1).view(np.uint8).data
    offset = stream.tell()
    stream.write(bytes(30 + len(name)))  # place of the header, written when the sizes are known
    blocks = [memoryview(head.getvalue()), *(body[k : k + _BLOCK] for k in range(0, len(body), _BLOCK))]
    crc, size, stored = 0, 0, 0
    for group in range(0, len(blocks), 32):
        chosen = blocks[group : group + 32]
        jobs = [pool.submit(_deflate, block, group + k == len(blocks) - 1) for k, block in enumerate(chosen)]
        for block, job in zip(chosen, jobs, strict=True):
            crc = engine.crc32(block, crc)
            size += len(block)
            stored += stream.write(job.result())
    require(stored <= _LIMIT, f"the array '{name.decode()}' does not fit into a ZIP archive of 4 GB.")
    common = struct.pack("<HHHHHIIIHH", 20, 0, _DEFLATE, *_DATE, crc, stored, size, len(name), 0)
    end = stream.tell()
    stream.seek(offset)
    stream.write(b"PK\x03\x04" + common + name)
    stream.seek(end)
    return name, common, offset


def _deflate(block: memoryview, last: bool) -> bytes:
    """Deflate a block: level 1, but measured numbers that hardly shrink are stored between runs that do."""
    words = np.frombuffer(block[: len(block) // _PAGE * _PAGE], np.uint64).reshape(-1, _PAGE // 8)
    constant = _constant(words)
    if len(block) == _BLOCK and not last and constant.all() and (words[:, 0] == words[0, 0]).all():
        return _run(words[0, :1].tobytes(), _BLOCK)
    mixed = np.flatnonzero(~constant)
    sample = words[mixed[:: max(1, len(mixed) // _SAMPLED)]].tobytes()
    if len(mixed) < _SAMPLED or len(zlib.compress(sample, 1)) < _HARDLY * len(sample):
        return _packed(block, last)
    ends = [0, *(np.flatnonzero(np.diff(constant)) + 1).tolist(), len(constant)]
    parts: list[bytes | memoryview] = []
    for first, end in pairwise(ends):
        if constant[first]:
            parts.append(_run(words[first, :1].tobytes(), (end - first) * _PAGE))
            continue
        for start in range(first * _PAGE, end * _PAGE, _STORED):
            piece = block[start : min(start + _STORED, end * _PAGE)]
            parts += [b"\0" + struct.pack("<HH", len(piece), len(piece) ^ 0xFFFF), piece]
    return b"".join([*parts, _packed(block[len(constant) * _PAGE :], last)])


def _constant(words: NDArray[np.uint64]) -> NDArray[np.bool_]:
    """Rows (n, 16) of one value throughout, (n,)."""
    same = np.ones(words.shape, dtype=np.bool_)
    flat = words.reshape(-1)
    np.equal(flat[1:], flat[:-1], out=same.reshape(-1)[:-1])
    same[:, -1] = True  # compared with the next row
    pairs = same.view(np.uint64)
    return np.asarray((pairs[:, 0] & pairs[:, 1]) == _ALL_TRUE)


def _packed(block: bytes | memoryview, last: bool) -> bytes:
    job = zlib.compressobj(1, zlib.DEFLATED, -15)
    return job.compress(block) + job.flush(zlib.Z_FINISH if last else zlib.Z_SYNC_FLUSH)


@lru_cache(maxsize=1024)
def _run(word: bytes, length: int) -> bytes:
    """So many bytes of the same eight, such as the NaN beside a finger."""
    return _packed(word * (length // 8), last=False)


def _write_directory(stream: BinaryIO, entries: list[tuple[bytes, bytes, int]]) -> None:
    start = stream.tell()
    require(start <= _LIMIT, "the arrays do not fit into a ZIP archive of 4 GB.")
    for name, common, offset in entries:
        stream.write(b"PK\x01\x02" + struct.pack("<H", 20) + common + struct.pack("<HHHII", 0, 0, 0, 0, offset) + name)
    size = stream.tell() - start
    stream.write(b"PK\x05\x06" + struct.pack("<HHHHIIH", 0, 0, len(entries), len(entries), size, start, 0))
