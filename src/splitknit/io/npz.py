"""Deterministic ``.npz`` archives, compressed on all cores.

:func:`numpy.savez_compressed` uses one core and a slow level. Here an array is cut into blocks of fixed size that are
deflated side by side and joined into one deflate stream, as pigz does; so the bytes do not depend on the number of
threads, and any ``.npz`` reader reads them.

References
----------
APPNOTE.TXT, .ZIP File Format Specification 6.3, sections 4.3.7, 4.3.12 and 4.3.16; RFC 1951 (deflate), section 3.2.4:
a sync flush ends on a byte, so that streams can be joined.
"""

from __future__ import annotations

import io
import os
import struct
import zlib
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from splitknit.check import BadInput, require
from splitknit.io.atomic import atomic_file

_BLOCK = 1 << 20
_LIMIT = (1 << 32) - 1
_DATE = (0, (0 << 9) | (1 << 5) | 1)  # 1980-01-01 00:00, the first date a ZIP archive knows
_DEFLATE = 8


def write_npz(path: str | os.PathLike[str], arrays: Mapping[str, Any], compresslevel: int = 1) -> None:
    """Write arrays and scalars as an ``.npz`` file that :func:`numpy.load` reads; equal input gives equal bytes.

    Parameters
    ----------
    arrays : name to array or number; names are written in the order given
    compresslevel : 0 (stored) to 9, of zlib

    Raises
    ------
    BadInput
        If a name or an array cannot be stored (objects, 4 GB or more), or the file cannot be written.
    """
    require(0 <= compresslevel <= 9, f"compresslevel must be 0 to 9, but it is {compresslevel}.")
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
            entries.append(_write_member(stream, f"{name}.npy".encode("ascii"), array, compresslevel, pool))
        _write_directory(stream, entries)


def read_npz(path: str | os.PathLike[str]) -> dict[str, np.ndarray[Any, Any]]:
    """Read all arrays of an ``.npz`` file; pickled objects are refused.

    Raises
    ------
    BadInput
        If the file is missing or damaged.
    """
    try:
        with Path(path).open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except Exception as error:  # zipfile, zlib and numpy each have their own
        missing = isinstance(error, FileNotFoundError)
        reason = "it does not exist" if missing else "it is damaged, or no .npz file of numbers"
        raise BadInput(f"{os.fspath(path)} cannot be read as arrays: {reason}; write it again.") from error


def _write_member(
    stream: BinaryIO, name: bytes, array: np.ndarray[Any, Any], level: int, pool: ThreadPoolExecutor
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
        jobs = [pool.submit(_deflate, block, level, group + k == len(blocks) - 1) for k, block in enumerate(chosen)]
        for block, job in zip(chosen, jobs, strict=True):
            crc = zlib.crc32(block, crc)
            size += len(block)
            stored += stream.write(job.result())
    require(stored <= _LIMIT, f"the array '{name.decode()}' does not fit into a ZIP archive of 4 GB.")
    common = struct.pack("<HHHHHIIIHH", 20, 0, _DEFLATE, *_DATE, crc, stored, size, len(name), 0)
    end = stream.tell()
    stream.seek(offset)
    stream.write(b"PK\x03\x04" + common + name)
    stream.seek(end)
    return name, common, offset


def _deflate(block: memoryview, level: int, last: bool) -> bytes:
    engine = zlib.compressobj(level, zlib.DEFLATED, -15)
    return engine.compress(block) + engine.flush(zlib.Z_FINISH if last else zlib.Z_SYNC_FLUSH)


def _write_directory(stream: BinaryIO, entries: list[tuple[bytes, bytes, int]]) -> None:
    start = stream.tell()
    require(start <= _LIMIT, "the arrays do not fit into a ZIP archive of 4 GB.")
    for name, common, offset in entries:
        stream.write(b"PK\x01\x02" + struct.pack("<H", 20) + common + struct.pack("<HHHII", 0, 0, 0, 0, offset) + name)
    size = stream.tell() - start
    stream.write(b"PK\x05\x06" + struct.pack("<HHHHIIH", 0, 0, len(entries), len(entries), size, start, 0))
