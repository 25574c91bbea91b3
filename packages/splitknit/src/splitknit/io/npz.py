"""Deterministic ``.npz`` archives, whose sizes are known before memory is taken.

Measured single-precision numbers hardly shrink: to deflate them takes eight times as long and saves
a tenth of the size of a finger's surface, so that they are stored as they are.
"""

from __future__ import annotations

import math
import os
import zipfile
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from numpy.lib import format as npy

from splitknit.errors import refusing, require
from splitknit.files import open_file
from splitknit.io.atomic import atomic_file

# arrays read at once, at most: a result of 25 million pixels, three times the rig's
RESULT_BYTES = 600_000_000
_FILE_BYTES = 1 << 32
_LARGE = 1 << 30  # bytes of an array from which a ZIP archive needs its longer fields


def write_npz(path: str | os.PathLike[str], arrays: Mapping[str, Any]) -> None:
    """Write arrays and numbers, in order, as ``.npz``; equal input gives equal bytes. Raises
    BadInput if a name or an array cannot be stored (objects), or on writing.
    """
    for name, value in arrays.items():
        require(
            bool(name) and name.isascii() and not set(name) & set("/\\\0"),
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
            with archive.open(member, "w", force_zip64=array.nbytes > _LARGE) as content:
                npy.write_array(content, array, allow_pickle=False)


def read_npz(
    path: str | os.PathLike[str],
    names: Collection[str] | None = None,
    max_bytes: int = RESULT_BYTES,
) -> dict[str, np.ndarray[Any, Any]]:
    """Arrays of an ``.npz`` file, those of `names` that are there, or all; no pickled objects.
    Raises BadInput if the file is missing or damaged, or larger than `max_bytes` in all.
    """
    name = os.fspath(path)
    damaged = (
        f"{name} cannot be read as arrays: it is damaged, or no .npz file of numbers; write it"
        " again."
    )
    with (
        open_file(path, _FILE_BYTES) as (stream, _),
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
        return {key: _array(archive, member, damaged) for key, member in chosen.items()}


def _array(archive: zipfile.ZipFile, member: zipfile.ZipInfo, damaged: str) -> np.ndarray[Any, Any]:
    """The array of a file of an archive; its header must fit the size that the archive gives."""
    with archive.open(member) as content:
        first = npy.read_magic(content) == (1, 0)
        shape, _, dtype = (npy.read_array_header_1_0 if first else npy.read_array_header_2_0)(
            content
        )
        bytes_of_array = dtype.itemsize * math.prod(shape)
        require(
            min(shape, default=1) >= 0 and content.tell() + bytes_of_array == member.file_size,
            damaged,
        )
        content.seek(0)
        array = npy.read_array(content, allow_pickle=False)
        require(not content.read(1), damaged)  # and its checksum is compared
    return array
