"""Prints whose minutiae are known: rings of ridges, and a turn of the phase by 2 pi about each
minutia."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray


def _places(seed: int) -> NDArray[np.float64]:
    """(N, 2) column and row of minutiae at 500 ppi: a grid, disturbed."""
    column, row = np.meshgrid(np.arange(40, 360, 44), np.arange(50, 470, 44))
    grid = np.stack([column, row], axis=-1).reshape(-1, 2).astype(np.float64)
    grid += np.random.default_rng(seed).uniform(-13, 13, grid.shape)
    return grid[np.hypot((grid[:, 0] - 190) / 150, (grid[:, 1] - 250) / 205) < 1]


PLACES = _places(1)


@lru_cache(maxsize=8)
def spiral_print(
    shift: tuple[int, int] = (0, 0), scale: float = 1.0, seed: int = 1
) -> NDArray[np.uint8]:
    """(500, 380) uint8 at 500 ppi, times `scale`; ridges 9 pixels apart, dark; another finger for
    each `seed`."""
    rows, columns = np.mgrid[: round(500 * scale), : round(380 * scale)] / scale
    phase = 2 * np.pi / 9 * np.hypot(0.9 * (columns - 190 - shift[0]), rows - 620 - shift[1])
    signs = np.random.default_rng([seed, 2]).choice([-1, 1], len(_places(seed)))
    for sign, (column, row) in zip(signs, _places(seed), strict=True):
        phase += sign * np.arctan2(rows - row - shift[1], columns - column - shift[0])
    inside = np.hypot((columns - 190) / 175, (rows - 250) / 235) < 1
    image = np.where(inside, 127 + 110 * np.cos(phase), 255).astype(np.uint8)
    image.setflags(write=False)
    return image
