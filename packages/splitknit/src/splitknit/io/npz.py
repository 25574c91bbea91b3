"""Deterministic ``.npz`` archives, whose sizes are known before memory is taken.

Measured single-precision numbers hardly shrink: to deflate them takes eight times as long and saves
a tenth of the size of a finger's surface, so that they are stored as they are.
"""

from __future__ import annotations

import io
import math
import os
import zipfile
from collections.abc import Collection, Mapping
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy

from splitknit.errors import refusing, require
from splitknit.files import AnyPath, open_file
from splitknit.io.atomic import atomic_file


def write_npz(path: AnyPath, arrays: Mapping[str, Any]) -> None:
    """Write arrays and numbers, in order, as ``.npz``; equal input gives equal bytes. Raises
    BadInput if a name or an array cannot be stored (objects), or on writing.
    """
    for name, value in arrays.items():
        require(
            name and name.isascii() and not set(name) & set("/\\\0"),
            f"an array cannot be named {name!r}.",
        )
        objects = np.asarray(value).dtype.hasobject
        require(not objects, f"the array '{name}' holds objects; only numbers and text are stored.")
    with atomic_file(path) as stream, zipfile.ZipFile(stream, "w") as archive:
        for name, value in arrays.items():
            array = np.asarray(value)
            member = zipfile.ZipInfo(f"{name}.npy")  # of 1980, the first date that an archive knows
            member.compress_type = (
                zipfile.ZIP_STORED if array.dtype == np.float32 else zipfile.ZIP_DEFLATED
            )
            # the format's longer fields
            with archive.open(member, "w", force_zip64=array.nbytes > 1 << 30) as content:
                npy.write_array(content, array, allow_pickle=False)


def read_npz(
    path: AnyPath,
    names: Collection[str] | None = None,
    max_bytes: int = 600_000_000,
) -> dict[str, np.ndarray[Any, Any]]:
    """Arrays of an ``.npz`` file, those of `names` that are there, or all; no pickled objects.
    Raises BadInput if the file is missing or damaged, or larger than `max_bytes` in all (by
    default, a result of 25 million pixels, three times the rig's).
    """
    name = os.fspath(path)
    damaged = (
        f"{name} cannot be read as arrays: it is damaged, or no .npz file of numbers; write it"
        " again."
    )
    with (
        open_file(path, 1 << 32) as (stream, _),
        refusing(damaged),
        zipfile.ZipFile(stream) as archive,
    ):
        members = (member for member in archive.infolist() if member.filename.endswith(".npy"))
        chosen = {member.filename.removesuffix(".npy"): member for member in members}
        if names is not None:
            chosen = {key: member for key, member in chosen.items() if key in names}
        size = sum(member.file_size for member in chosen.values())
        require(
            size <= max_bytes,
            f"{name} holds arrays of {size} bytes, but at most {max_bytes} are read.",
        )
        arrays = {}
        for key, member in chosen.items():
            with archive.open(member) as content:
                arrays[key] = _array(content, member.file_size, damaged)
        return arrays


def read_npy(data: bytes, name: str) -> np.ndarray[Any, Any]:
    """The array of the bytes of an ``.npy`` file, no pickled objects. Raises BadInput if they are
    damaged."""
    damaged = f"{name} is damaged, or no .npy file of numbers; write it again."
    with refusing(damaged):
        return _array(io.BytesIO(data), len(data), damaged)


def _array(content: IO[bytes], size: int, damaged: str) -> np.ndarray[Any, Any]:
    """The array of a file of `size` bytes, which its header must fit."""
    first = npy.read_magic(content) == (1, 0)
    shape, _, dtype = (npy.read_array_header_1_0 if first else npy.read_array_header_2_0)(content)
    bytes_of_array = dtype.itemsize * math.prod(shape)
    require(min(shape, default=1) >= 0 and content.tell() + bytes_of_array == size, damaged)
    content.seek(0)
    array = npy.read_array(content, allow_pickle=False)
    require(not content.read(1), damaged)  # of an archive, its checksum is compared
    return array
