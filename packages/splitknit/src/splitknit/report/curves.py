"""Curves over two axes as a grey picture."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

_LEFT, _TOP, _WIDE, _BOTTOM = 60, 28, 480, 28
_TALL = 200
_BLACK, _GREY, _GRID = (0,), (170,), (225,)
_SUBPIXEL = 4  # bits


def curve_picture(
    curves: Sequence[tuple[NDArray[Any], NDArray[Any]]], x_label: str, y_label: str, *, equal: bool = False
) -> NDArray[np.uint8]:
    """Curves (x, y), interrupted by NaN, the first black over grey ones; `equal` gives both axes the same scale."""
    x = np.concatenate([x for x, _ in curves]).astype(np.float64)
    y = np.concatenate([y for _, y in curves]).astype(np.float64)
    left, right = float(x[np.isfinite(y)].min()), float(x[np.isfinite(y)].max())
    low, high = float(np.nanmin(y)), float(np.nanmax(y))
    margin = 0.05 * (high - low) or 1.0
    low, high = low - margin, high + margin
    tall = int(np.clip(_WIDE * (high - low) / max(right - left, 1e-9), 100, 400)) if equal else _TALL
    picture = np.full((_TOP + tall + _BOTTOM, _LEFT + _WIDE + 20), 255, np.uint8)

    def places(xs: Any, ys: Any) -> NDArray[np.int32]:
        across = _LEFT + _WIDE * (np.asarray(xs) - left) / max(right - left, 1e-9)
        down = _TOP + tall * (high - np.asarray(ys)) / (high - low)
        return np.asarray(np.rint(np.stack([across, down], axis=-1) * 2**_SUBPIXEL), dtype=np.int32)

    def draw(line: NDArray[np.int32], shade: tuple[int, ...], width: int) -> None:
        cv2.polylines(picture, [line], False, shade, width, cv2.LINE_AA, _SUBPIXEL)

    def write(words: str, column: float, row: float) -> None:
        place = round(column), round(row)
        cv2.putText(picture, words.replace("µ", "u"), place, cv2.FONT_HERSHEY_SIMPLEX, 0.5, _BLACK, 1, cv2.LINE_AA)

    for mark in _marks(left, right, 6):
        line = places([mark, mark], [low, high])
        draw(line, _GRID, 1)
        write(f"{mark:g}", line[0, 0] / 2**_SUBPIXEL - 8, _TOP + tall + 18)
    for mark in _marks(low, high, max(2, tall // 30)):
        line = places([left, right], [mark, mark])
        draw(line, _GRID, 1)
        write(f"{mark:g}", _LEFT - 55, line[0, 1] / 2**_SUBPIXEL + 4)
    write(f"{y_label}, over {x_label}", _LEFT, _TOP - 10)
    for place, (xs, ys) in reversed(list(enumerate(curves))):
        known = np.flatnonzero(np.isfinite(ys))
        for run in np.split(known, np.flatnonzero(np.diff(known) > 1) + 1):
            draw(places(xs[run], ys[run]), *((_GREY, 3) if place else (_BLACK, 1)))
    return picture


def _marks(low: float, high: float, count: int) -> list[float]:
    """Round numbers from `low` to `high`, at most about `count` of them."""
    step = 10.0 ** np.floor(np.log10(max(high - low, 1e-9) / count))
    step *= next(factor for factor in (1, 2, 5, 10) if (high - low) / (factor * step) <= count or factor == 10)
    return [float(k * step) for k in range(int(np.ceil(low / step)), int(np.floor(high / step)) + 1)]
