"""Memory: photographs that do not fit into it are paged from disk, and the command line uses one
heap."""

from __future__ import annotations

import ctypes
import math
import os
import tempfile
import weakref
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput
from splitknit.model import PixelArray

IN_MEMORY = 50_000_000
"""Bytes of a band's stored photographs that are kept in memory; a full frame takes 0.15 GB."""


class PagedStack:
    """Photographs (L, H, W, C) of which one at a time is in memory: `stack[k]` reads it.

    They lie in a file without a name in ``TMPDIR``, by default ``/var/tmp``, which is on disk; it
    ends with the stack. ``np.asarray`` reads all. Raises BadInput if the disk is full.
    """

    def __init__(self, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        """Reserve the disk for photographs, which are assigned one by one."""
        self.shape, self.dtype = shape, dtype
        self._each = math.prod(shape[1:]) * dtype.itemsize
        size = shape[0] * self._each
        place = os.environ.get("TMPDIR") or ("/var/tmp" if os.access("/var/tmp", os.W_OK) else None)
        try:
            self._file, name = tempfile.mkstemp(dir=place)  # of mode 0600
            weakref.finalize(self, os.close, self._file)
            Path(name).unlink()
            os.posix_fallocate(self._file, 0, size)  # a full disk shows here
        except OSError as error:
            raise BadInput(
                f"the photographs take {size / 1e9:.1f} GB of disk while they are worked on"
                f" ({error.strerror}); name a folder with room in the environment variable TMPDIR,"
                " or fewer or smaller photographs."
            ) from error

    def __setitem__(self, k: int, image: PixelArray) -> None:
        data = np.ascontiguousarray(image, dtype=self.dtype).data.cast("B")
        offset = k * self._each
        while data:
            written = os.pwrite(self._file, data, offset)
            data, offset = data[written:], offset + written

    def __getitem__(self, place: int | tuple[int, slice]) -> PixelArray:
        """Photograph k, or the rows of it that ``k, slice`` names."""
        k, rows = place if isinstance(place, tuple) else (place, slice(None))
        chosen_rows = range(self.shape[1])[rows]
        image = np.empty((len(chosen_rows), *self.shape[2:]), self.dtype)
        # rows that are skipped are not read
        for row, part in zip(
            chosen_rows, [image] if chosen_rows.step == 1 else image, strict=False
        ):
            data = part.data.cast("B")
            offset = range(len(self))[k] * self._each + row * image.strides[0]
            while data:
                read = os.preadv(self._file, [data], offset)
                data, offset = data[read:], offset + read
        return image

    def __len__(self) -> int:
        return self.shape[0]

    def __iter__(self) -> Iterator[PixelArray]:
        return (self[k] for k in range(len(self)))

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """All photographs in memory."""
        return np.stack(list(self)).astype(dtype or self.dtype, copy=False)


def new_stack(shape: tuple[int, ...], dtype: np.dtype[Any]) -> PixelArray:
    """Room for photographs (L, H, W, C): an array, or a :class:`PagedStack` beyond
    :data:`IN_MEMORY`, which serves in its place wherever photographs are taken one by one."""
    size = math.prod(shape) * dtype.itemsize
    if size <= IN_MEMORY or not hasattr(os, "posix_fallocate"):
        return np.empty(shape, dtype)
    return cast("PixelArray", PagedStack(shape, dtype))


def chosen(stack: PixelArray, rows: Sequence[int]) -> PixelArray:
    """Some photographs of a stack, in memory as long as they fit."""
    if not isinstance(stack, PagedStack):
        return stack[list(rows)]
    part = new_stack((len(rows), *stack.shape[1:]), stack.dtype)
    for number, k in enumerate(rows):
        part[number] = stack[k]
    return part


_HEAP = {-8: 1, -4: 0, -1: 512 << 20}
"""Parameters of glibc's ``mallopt``: M_ARENA_MAX, M_MMAP_MAX and M_TRIM_THRESHOLD (bytes)."""


def one_heap() -> None:
    """Let all threads of this process, a program of its own, allocate from one heap, which keeps up
    to 512 MB free. By default glibc gives each thread a heap, and returns an array's pages only to
    ask for them again; with other C libraries nothing happens. A full frame by ``metric`` takes
    0.93 GB at its peak with it (0.91 to 0.96, three runs) and 1.00 GB without (0.97 to 1.02), at
    the same processor time. Environment variables (``MALLOC_ARENA_MAX=1`` ...) give 0.92 GB, but
    glibc reads them before the program starts.
    """
    with suppress(AttributeError, OSError, ValueError):  # Windows, macOS, musl
        if os.confstr("CS_GNU_LIBC_VERSION"):
            libc = ctypes.CDLL(None)
            for parameter, value in _HEAP.items():
                libc.mallopt(parameter, value)
