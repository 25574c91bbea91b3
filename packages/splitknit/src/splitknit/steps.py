"""What wraps the steps of a reconstruction from outside: time, progress, shared results, and
memory."""

from __future__ import annotations

import ctypes
import functools
import math
import mmap
import os
import tempfile
import time
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Any, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, require
from splitknit.model import Capture, FloatArray, Progress
from splitknit.parameters import IN_MEMORY

P = ParamSpec("P")
T = TypeVar("T")

BEGINS = {"finger": 0.0, "light": 0.1, "normals": 0.2, "surface": 0.25, "result": 0.9}
"""Fraction of the work that is done when a stage begins."""


class Memory:
    """Intermediate results of one capture, by the steps and arguments that they follow from.

    Give the same memory to :func:`splitknit.reconstruct` for every case of a capture: what two
    cases share (the finger, normals of direct light) is computed once, and every result is the same
    as without it. Nine presets of a full frame take 25 s with it and 58 s without, two cores. It
    keeps some ten images of the finger's window.
    """

    def __init__(self, capture: Capture) -> None:
        """Remember nothing yet of `capture`."""
        self._capture: Capture | None = capture
        self._known: dict[Hashable, Any] = {}

    def check(self, capture: Capture) -> None:
        """Refuse, by BadInput, another capture than the one whose results are remembered."""
        require(
            capture is self._capture or self._capture is None,
            "a memory serves one capture; make another for this one.",
        )

    @property
    def capture(self) -> Capture:
        """The capture whose results are remembered."""
        assert self._capture is not None  # until it was handed over
        return self._capture

    def hand_over(self) -> Capture:
        """The capture, for its last case: the memory lets go of it, and of its results once the
        images are read."""
        capture, self._capture = self.capture, None
        return capture

    def images_are_read(self) -> None:
        """Forget everything if the capture was handed over."""
        if self._capture is None:
            self._known.clear()

    def __call__(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return what was made for `key`, or make it; errors are not remembered."""
        if key not in self._known:
            self._known[key] = make()
        return self._known[key]  # type: ignore[no-any-return]


@dataclass
class _Run:
    """One reconstruction under way."""

    progress: Progress | None
    memory: Memory | None
    kept: dict[str, FloatArray] | None
    """Images of steps, by name, where they are kept."""
    seconds: dict[str, float] = field(default_factory=dict)
    stage: str = ""
    """Stage under way."""
    done: float = 0.0
    """Fraction that was reported last: a stage may be entered again, but progress never goes
    back."""


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


def large_array(shape: tuple[int, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
    """An array for stored images; beyond :data:`IN_MEMORY` in a nameless file in ``TMPDIR``, by
    default ``/var/tmp``, which is on disk, that ends with it. Call :func:`let_go` after each part
    read or written. Raises BadInput if the disk is full.
    """
    size = math.prod(shape) * dtype.itemsize
    if size <= IN_MEMORY or not hasattr(os, "posix_fallocate"):
        return np.empty(shape, dtype)
    place = os.environ.get("TMPDIR") or ("/var/tmp" if os.access("/var/tmp", os.W_OK) else None)
    try:
        with tempfile.TemporaryFile(dir=place) as file:  # of mode 0600, and unlinked at once
            # a full disk shows here, not as a signal later
            os.posix_fallocate(file.fileno(), 0, size)
            return np.frombuffer(mmap.mmap(file.fileno(), size), dtype).reshape(shape)
    except OSError as error:
        raise BadInput(
            f"the photographs take {size / 1e9:.1f} GB of disk while they are worked on"
            f" ({error.strerror}); name a folder with room in the environment variable TMPDIR, or"
            " fewer or smaller photographs."
        ) from error


def let_go(images: NDArray[Any]) -> None:
    """Give the memory of an array of :func:`large_array` back to the system; what it holds stays in
    its file."""
    owner: Any = images
    while isinstance(owner, np.ndarray):
        owner = owner.base
    if isinstance(owner, memoryview):
        owner = owner.obj
    if isinstance(owner, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
        owner.madvise(mmap.MADV_DONTNEED)


_RUN: ContextVar[_Run | None] = ContextVar("run", default=None)


@contextmanager
def timed_run(
    progress: Progress | None,
    memory: Memory | None,
    kept: dict[str, FloatArray] | None = None,
) -> Iterator[dict[str, float]]:
    """Time the steps inside, report them to `progress`, share results by `memory`, and put images
    into `kept`; yield the seconds of stages."""
    run = _Run(progress, memory, kept)
    token = _RUN.set(run)
    try:
        yield run.seconds
    finally:
        _RUN.reset(token)


def images_are_read() -> None:
    """Let the run's memory forget a capture that was handed over."""
    run = _RUN.get()
    if run is not None and run.memory is not None:
        run.memory.images_are_read()


def keep(name: str, make: Callable[[], FloatArray]) -> None:
    """Keep images (L, h, w), or one picture, of a step, where the run keeps them."""
    run = _RUN.get()
    if run is not None and run.kept is not None:
        run.kept[name] = make()


def report(stage: str, within: float) -> None:
    """Report that a fraction `within` of a stage is done."""
    run = _RUN.get()
    if run is not None and run.progress is not None:
        following = [done for done in (*BEGINS.values(), 1.0) if done > BEGINS[stage]]
        run.done = max(run.done, BEGINS[stage] + within * (following[0] - BEGINS[stage]))
        run.progress(stage, run.done)


def step(stage: str) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Decorator of a step of a stage: outside of a run it changes nothing."""

    def wrap(function: Callable[P, T]) -> Callable[P, T]:
        @functools.wraps(function)
        def timed(*args: P.args, **kwargs: P.kwargs) -> T:
            run = _RUN.get()
            if run is None or run.stage == stage:
                return function(*args, **kwargs)
            report(stage, 0.0)
            outer, run.stage, started = run.stage, stage, time.perf_counter()
            try:
                return function(*args, **kwargs)
            finally:
                run.stage = outer
                run.seconds[stage] = run.seconds.get(stage, 0.0) + time.perf_counter() - started

        return timed

    return wrap


def shared(function: Callable[P, T]) -> Callable[P, T]:
    """Decorator of a step that follows from its arguments alone (hashable, positional): cases share
    its result."""

    @functools.wraps(function)
    def once(*args: P.args, **kwargs: P.kwargs) -> T:
        run = _RUN.get()
        if run is None or run.memory is None:
            return function(*args, **kwargs)
        key = (function.__qualname__, *args, *sorted(kwargs.items()))
        return run.memory(key, functools.partial(function, *args, **kwargs))

    return once
