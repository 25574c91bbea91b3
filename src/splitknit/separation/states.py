"""Which pixel a pattern lights in which image: made, found in the images, or given and checked."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, require
from splitknit.model import FloatArray
from splitknit.separation.stacks import (
    DEFAULTS,
    EDGE,
    LightStack,
    StackSettings,
    difference_products,
    light_stack,
    odd_twins,
    percent,
)

_DECIDED = 1 - 2 * 0.2
"""Part of half the range of its neighbours beyond which a pixel's state is decided."""


def checkerboard_patterns(size: tuple[int, int], check_px: float, shifts_px: Any) -> FloatArray:
    """States (N, H, W) in [0, 1] of a checkerboard along the camera's rows and columns, moved by (N, 2) `shifts_px`.

    Values are lit fractions of the pixel's area, so that shifts and checks (of a pixel or more) need not be whole
    pixels.
    """
    require(bool(np.isfinite(check_px)) and check_px >= 1, f"check_px must be at least 1, but it is {check_px}.")
    shifts = np.asarray(shifts_px, dtype=np.float64)
    require(
        shifts.ndim == 2 and shifts.shape[1] == 2 and bool(np.isfinite(shifts).all()),
        f"shifts_px must have the shape (N, 2) and be finite, but it has {shifts.shape}.",
    )
    rows = [_square_wave(size[0], check_px, float(shift)) for shift in shifts[:, 0]]
    columns = [_square_wave(size[1], check_px, float(shift)) for shift in shifts[:, 1]]
    waves = [row[:, None] * column[None, :] for row, column in zip(rows, columns, strict=True)]
    return np.asarray(0.5 + 0.5 * np.stack(waves), dtype=np.float32)


def _square_wave(count: int, half_period: float, shift: float) -> NDArray[np.float64]:
    """Mean over each pixel of the wave that is +1 on [0, half_period) and -1 on the next half."""
    edges = np.arange(count + 1) - shift
    phase = np.mod(edges, 2 * half_period)
    integral = np.where(phase < half_period, phase, 2 * half_period - phase)  # it returns to zero after each period
    return np.asarray(np.diff(integral))


def estimate_patterns(stack: Any, *, mask: Any = None, settings: StackSettings = DEFAULTS) -> FloatArray:
    """Find the states (N, H, W) of unknown patterns from the images themselves: 1 lit, 0 dark, 0.5 undecided.

    A pixel's state is read from the mean of its *neighbours* (a Gaussian of one pixel without its centre), relative
    to their own maximum and minimum over the images; in the middle three fifths of that range it is undecided. The
    neighbours share its state and not its noise, so that least squares with these states is unbiased in all but the
    faintest pixels; there it falls short, towards zero, where maximum and minimum would invent direct light. Checks
    must be wider than about five pixels.
    """
    images = light_stack(stack, least=2, mask=mask, settings=settings)
    kernel = cv2.getGaussianKernel(9, 1.0, cv2.CV_64F)
    around = kernel @ kernel.T
    around[4, 4] = 0.0
    around /= around.sum()
    means = np.stack(
        [
            cv2.filter2D(np.ascontiguousarray(image.mean(axis=-1)), cv2.CV_32F, around, borderType=cv2.BORDER_REFLECT)
            for image in images.light
        ]
    )
    low, high = means.min(axis=0), means.max(axis=0)
    middle = (high + low) / 2
    half = np.maximum((high - low) / 2, np.float32(1e-20))
    states = np.full(means.shape, 0.5, dtype=np.float32)
    states[means >= middle + _DECIDED * half] = 1.0
    states[means <= middle - _DECIDED * half] = 0.0
    return states


def check_shifts(shifts: Any, count: int, period: Any = None) -> None:
    """Refuse a table of shifts that is not a full grid with each shift once, one for each of `count` images."""
    table = np.asarray(shifts, dtype=np.float64)
    table = table[:, None] if table.ndim == 1 else table
    good = table.ndim == 2 and table.shape[1] in (1, 2) and bool(np.isfinite(table).all())
    require(good, f"shifts must have the shape (N,) or (N, 2) and be finite, but it has {np.shape(shifts)}.")
    require(
        len(table) == count,
        f"there are {len(table)} shifts for {count} images: a shift or an image is missing or extra.",
    )
    if period is not None:
        length = np.broadcast_to(np.asarray(period, dtype=np.float64), (table.shape[1],))
        require(bool((length > 0).all()), f"period must be positive, but it is {period}.")
        table = np.mod(np.round(table, 6), length)
    table = np.round(table, 6)
    seen: dict[tuple[float, ...], int] = {}
    for k, row in enumerate(map(tuple, table.tolist())):
        require(row not in seen, f"images {seen.get(row)} and {k} have the same shift {_words(row)}; remove one.")
        seen[row] = k
    axes = [np.unique(column) for column in table.T]
    for row in map(tuple, _grid(axes).tolist()):
        require(row in seen, f"the shift {_words(row)} is missing from the grid of shifts; capture it too.")
    for k, axis in enumerate(axes):
        ends = (
            axis if period is None else np.append(axis, axis[0] + length[k])
        )  # the last step leads round to the first
        gaps = np.diff(ends)
        gap = int(np.argmax(gaps)) if gaps.size > 1 else 0
        require(
            gaps.size < 2 or bool(gaps[gap] < 1.5 * np.median(gaps)),
            f"the shifts step by {np.median(gaps):g}, but from {ends[gap]:g} to {ends[gap + 1]:g} at once: the shifts "
            f"between are missing; capture them too."
            if gaps.size
            else "",
        )


def _grid(axes: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(axes))


def _words(row: tuple[float, ...]) -> str:
    return "(" + ", ".join(f"{value:g}" for value in row) + ")"


def check_patterns(patterns: Any, images: LightStack, *, distinct: bool = True) -> FloatArray:
    """Return known states (N, H, W), checked against the stack they belong to; `distinct`: none may come twice."""
    states = np.asarray(patterns, dtype=np.float32)
    shape = images.light.shape[:3]
    require(states.shape == shape, f"patterns must have the shape {shape} of the images, but it has {states.shape}.")
    good = bool(np.isfinite(states).all()) and float(states.min()) >= 0 and float(states.max()) <= 1
    require(good, "patterns must hold states from 0 (dark) to 1 (lit), without NaN.")
    lit, dark = (states >= 1 - EDGE), (states <= EDGE)
    for found, word in ((lit, "lit"), (dark, "dark")):
        never = images.mask & ~found.any(axis=0)
        if bool(never.any()):
            row, column = np.argwhere(never)[0]
            fraction = float(never.sum()) / float(images.mask.sum())
            raise BadInput(
                f"{percent(fraction)} of the pixels are never {word} by the patterns (first at row {row}, column "
                f"{column}): a shift is missing; capture it, or leave these pixels out with a mask."
            )
    if distinct:
        _check_order(images, states)
    return states


def _check_order(images: LightStack, states: FloatArray) -> None:
    """Each image must resemble its own pattern most."""
    step = max(1, int(np.count_nonzero(images.mask)) // 40_000)
    seen = images.light.mean(axis=-1)[:, images.mask][:, ::step].astype(np.float64)
    known = states[:, images.mask][:, ::step].astype(np.float64)
    decided = np.abs(known - 0.5) > 0.5 - EDGE  # the rest does not count in the result either
    number = np.maximum(decided.sum(axis=0), 1)
    known = np.where(decided, known - np.where(decided, known, 0.0).sum(axis=0) / number, 0.0)
    seen -= seen.mean(axis=0)
    apart = difference_products(known, known)
    twins = odd_twins(np.triu(apart <= 1e-4, 1))
    if twins is not None:
        raise BadInput(f"patterns {twins[0]} and {twins[1]} are the same: a shift is repeated; remove one of them.")
    likeness = (seen @ known.T) / np.maximum(np.linalg.norm(known, axis=1), 1e-12)
    likeness /= np.sqrt(np.maximum((seen * seen) @ decided.T.astype(np.float64), 1e-30))
    best = np.argmax(likeness, axis=1)
    for k, found in enumerate(best):
        require(
            likeness[k, k] > 0.02,
            f"image {k} does not show its pattern at all; check that images and patterns belong together.",
        )
        require(
            found == k or likeness[k, found] < likeness[k, k] + 0.02,
            f"image {k} shows pattern {found} instead of its own: a shift is repeated, missing or out of order.",
        )
