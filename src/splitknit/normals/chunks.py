"""Work on fixed chunks of rows in threads: bounded memory, and results that no thread count can change."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

_PIXELS = 16384
"""Pixels a chunk: a dozen float32 vectors of it stay in a core's cache."""


def row_chunks(rows: int, columns: int, pixels: int = _PIXELS) -> Iterator[slice]:
    """Slices of whole rows, about `pixels` pixels each; they depend on the image size alone."""
    step = max(1, pixels // columns)
    for start in range(0, rows, step):
        yield slice(start, min(rows, start + step))


def for_each_chunk(work: Callable[[slice], None], rows: int, columns: int, pixels: int = _PIXELS) -> None:
    """Call `work` on every chunk; each call writes its own rows of the result and nothing else."""
    threads = min(8, os.cpu_count() or 1)
    with ThreadPoolExecutor(threads) as pool:
        for _ in pool.map(work, row_chunks(rows, columns, pixels)):
            pass
