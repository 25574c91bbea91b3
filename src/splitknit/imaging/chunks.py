"""Work on fixed chunks of rows in threads: bounded memory, and results that no thread count can change."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from splitknit.model import BoolArray, FloatArray


def _row_chunks(rows: int, columns: int, lights: int) -> Iterator[slice]:
    """Slices of whole rows, a few thousand pixels each; they depend on the sizes alone."""
    step = max(1, _pixels_per_chunk(lights) // columns)
    for start in range(0, rows, step):
        yield slice(start, min(rows, start + step))


def _pixels_per_chunk(lights: int) -> int:
    """Pixels whose images and vectors stay in a core's cache."""
    return max(2048, 131072 // max(lights, 8))


def for_each_chunk(work: Callable[[slice], None], rows: int, columns: int, lights: int) -> None:
    """Call `work` on every chunk; each call writes its own rows of the result and nothing else."""
    threads = min(8, os.cpu_count() or 1)
    with ThreadPoolExecutor(threads) as pool:
        for _ in pool.map(work, _row_chunks(rows, columns, lights)):
            pass


def gather(images: FloatArray, chunk: slice, here: BoolArray) -> FloatArray:
    """Pixels (L, n) of some rows of `images` (L, H, W) where the mask (h, W) of these rows is true."""
    part = images[:, chunk].reshape(images.shape[0], -1)
    return part if here.all() else np.compress(here.ravel(), part, axis=1)
