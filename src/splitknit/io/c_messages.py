"""What a C library prints to ``stderr`` while it decodes, by thread.

libjpeg inside OpenCV decodes a damaged image to the end and reports the damage in one printed line alone. Python cannot
reach its handler. Redirecting file descriptor 2 would concern all threads and every process started meanwhile, and a
lock around it would have JPEG files decoded one at a time. So for as long as some thread listens, C's variable
``stderr`` refers to a stream whose writer is ours: lines of a listening thread are kept for it, others go to file
descriptor 2 as before. That needs glibc; elsewhere nothing is heard, and the lines are printed.

References
----------
fopencookie(3), Linux man-pages.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import os
import threading
from collections.abc import Iterator

_UNBUFFERED = 2
"""_IONBF of glibc."""
_WRITER = ctypes.CFUNCTYPE(ctypes.c_ssize_t, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t)
_THREAD = threading.local()
"""``heard``: what this thread listens with."""


class _Functions(ctypes.Structure):
    """cookie_io_functions_t."""

    _fields_ = (("read", ctypes.c_void_p), ("write", _WRITER), ("seek", ctypes.c_void_p), ("close", ctypes.c_void_p))


class _Stream:
    """C's variable ``stderr``, our stream and the usual one."""

    def __init__(self, variable: ctypes.c_void_p, ours: int) -> None:
        self._variable, self._ours, self._usual = variable, ours, variable.value
        self._reset()
        os.register_at_fork(after_in_child=self._reset)  # the other threads are not there to end their listening

    def _reset(self) -> None:
        self._lock, self._listeners = threading.Lock(), 0
        self._variable.value = self._usual

    def listen(self, more: int) -> None:
        """Count a listener in (1) or out (-1); the first and the last exchange the streams."""
        with self._lock:
            self._listeners = max(0, self._listeners + more)
            self._variable.value = self._ours if self._listeners else self._usual


@contextlib.contextmanager
def c_messages() -> Iterator[list[bytes]]:
    """Yield a list that gets what C code of this thread prints to ``stderr`` within the block."""
    heard: list[bytes] = []
    stream = c_stream()
    if stream is None:
        yield heard
        return
    earlier, _THREAD.heard = getattr(_THREAD, "heard", None), heard
    stream.listen(1)
    try:
        yield heard
    finally:
        stream.listen(-1)
        _THREAD.heard = earlier


def _write(_cookie: int | None, place: int | None, size: int) -> int:
    data = ctypes.string_at(place or 0, size)
    heard = getattr(_THREAD, "heard", None)
    if heard is not None:
        heard.append(data)
    else:
        with contextlib.suppress(OSError):
            os.write(2, data)
    return size


_WRITE = _WRITER(_write)
"""Lives as long as the stream."""


@functools.cache
def c_stream() -> _Stream | None:
    """Make the stream; None where C's variable may not be changed."""
    try:
        if not (os.confstr("CS_GNU_LIBC_VERSION") or "").startswith("glibc"):
            return None
        libc = ctypes.CDLL(None)
        variable = ctypes.c_void_p.in_dll(libc, "stderr")
        libc.fopencookie.restype = ctypes.c_void_p
        libc.fopencookie.argtypes = (ctypes.c_void_p, ctypes.c_char_p, _Functions)
        ours = libc.fopencookie(None, b"w", _Functions(None, _WRITE, None, None))
        if not ours or libc.setvbuf(ctypes.c_void_p(ours), None, _UNBUFFERED, ctypes.c_size_t(0)) != 0:
            return None
    except (AttributeError, OSError, ValueError):
        return None
    return _Stream(variable, ours)
