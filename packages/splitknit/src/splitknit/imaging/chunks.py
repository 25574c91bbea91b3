"""Work on fixed chunks of rows in threads: bounded memory, and results that no thread count can
change."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from splitknit.model import BoolArray, FloatArray


def for_each_chunk(work: Callable[[slice], None], rows: int, columns: int, lights: int) -> None:
    """Call `work` on every chunk of whole rows (a slice by the sizes alone, for a cache); each
    writes its own rows."""
    step = max(1, _pixels_per_chunk(lights) // columns)
    with ThreadPoolExecutor(min(8, os.cpu_count() or 1)) as pool:
        list(
            pool.map(
                work, (slice(start, min(rows, start + step)) for start in range(0, rows, step))
            )
        )


def _pixels_per_chunk(lights: int) -> int:
    return max(2048, 131072 // max(lights, 8))


def gather(images: FloatArray, chunk: slice, here: BoolArray) -> FloatArray:
    """Pixels (L, n) of some rows of `images` (L, H, W) where the mask (h, W) of these rows is
    true."""
    part = images[:, chunk].reshape(images.shape[0], -1)
    return part if here.all() else np.compress(here.ravel(), part, axis=1)
