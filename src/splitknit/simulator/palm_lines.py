"""Lines of the palm: principal lines and wrinkles, wide, tapering and branching, as grooves on a map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STEP_MM = 0.25
"""Distance between the points of a line."""
TOGETHER = 3.0
"""Exponent of the norm that joins grooves: deeper than each where they cross, less than their sum."""


@dataclass(frozen=True, slots=True, eq=False)
class PalmLine:
    """One groove."""

    points_mm: Array
    """(N, 2) x and y along its bottom."""
    depth_mm: Array
    """(N,) depth; it fades out at the ends."""
    width_mm: Array
    """(N,) standard deviation of its profile."""


def draw_lines(
    rng: np.random.Generator,
    half_size_mm: tuple[float, float],
    *,
    principal: int,
    wrinkles: int,
    principal_depth_mm: float,
    wrinkle_depth_mm: float,
) -> tuple[PalmLine, ...]:
    """Draw the lines of one palm, each through a place inside the map, branches after their stems.

    Parameters
    ----------
    rng : source of all draws
    half_size_mm : half width and half height of the map
    principal, wrinkles : how many stems of each kind
    principal_depth_mm, wrinkle_depth_mm : typical depths; every line varies about them by about a third
    """
    lines: list[PalmLine] = []
    main = rng.uniform(0.0, np.pi)
    for _ in range(principal):
        through = rng.uniform(-0.75, 0.75, 2) * half_size_mm
        heading = main + 0.35 * rng.standard_normal()
        depth = principal_depth_mm * np.exp(0.3 * np.clip(rng.standard_normal(), -2, 2))
        length = rng.uniform(0.9, 1.8) * max(half_size_mm) * 2.0
        lines += _stem(
            rng,
            through,
            heading,
            length=length,
            depth=min(depth, 0.3),
            width=rng.uniform(0.28, 0.5),
            generations=2,
        )
    # wrinkles keep to two directions, as folds of the skin do
    folds = rng.uniform(0.0, np.pi, 2)
    for _ in range(wrinkles):
        through = rng.uniform(-1.0, 1.0, 2) * half_size_mm
        heading = folds[int(rng.random() < 0.35)] + 0.3 * rng.standard_normal()
        depth = wrinkle_depth_mm * np.exp(0.5 * np.clip(rng.standard_normal(), -2, 2))
        length = float(np.clip(7.0 * np.exp(0.6 * rng.standard_normal()), 2.0, 25.0))
        width = max(rng.uniform(0.09, 0.2), 1.3 * depth)
        lines += _stem(rng, through, heading, length=length, depth=depth, width=width, generations=1)
    return tuple(lines)


def _stem(
    rng: np.random.Generator,
    through: Array,
    heading: float,
    *,
    length: float,
    depth: float,
    width: float,
    generations: int,
    start: bool = False,
) -> list[PalmLine]:
    """One line through (or from) a place and its branches."""
    count = max(int(length / STEP_MM), 8)
    # the heading wanders smoothly: noise of a few millimetres on top of a steady bend
    wander = _wander(np.cumsum(rng.standard_normal(count // 12 + 2)), 12, count)
    angle = heading + rng.normal(0.0, 0.015) * STEP_MM * np.arange(count) + 0.09 * wander
    points = np.cumsum(STEP_MM * np.stack([np.cos(angle), np.sin(angle)], 1), axis=0)
    points += through - (points[0] if start else points[count // 2])
    along = np.linspace(0.0, 1.0, count)
    ends = rng.uniform(0.1, 0.35, 2)
    rise = np.ones(count) if start else np.clip(along / ends[0], 0.0, 1.0)
    fade = np.sqrt(rise * np.clip((1.0 - along) / ends[1], 0.0, 1.0))
    uneven = _wander(rng.uniform(0.7, 1.15, count // 8 + 2), 8, count)
    line = PalmLine(points, depth * fade * uneven, width * (0.6 + 0.4 * fade))
    lines = [line]
    if generations == 0:
        return lines
    for _ in range(int(rng.poisson(length / 9.0))):
        at = int(rng.uniform(0.12, 0.88) * count)
        aside = angle[at] + rng.choice((-1.0, 1.0)) * rng.uniform(0.25, 0.8) + (np.pi if rng.random() < 0.3 else 0.0)
        share = rng.uniform(0.3, 0.75)
        lines += _stem(
            rng,
            points[at],
            float(aside),
            length=length * rng.uniform(0.15, 0.4),
            depth=float(line.depth_mm[at]) * share,
            width=float(line.width_mm[at]) * (0.4 + 0.6 * share),
            generations=generations - 1,
            start=True,
        )
    return lines


def _wander(knots: Array, step: int, count: int) -> Array:
    """(count,) values between `knots`, which are `step` points apart."""
    return np.asarray(np.interp(np.arange(count), step * np.arange(knots.size), knots), dtype=np.float64)


def groove_map(lines: tuple[PalmLine, ...], x_mm: Array, y_mm: Array) -> Array:
    """(H, W) depth in mm of all lines together on regular axes; y falls with the row.

    Every line is a row of Gaussian dips a third of its width apart; the deepest counts.
    """
    pitch = float(x_mm[1] - x_mm[0])
    powers = np.zeros((y_mm.size, x_mm.size))
    for line in lines:
        x, y, depth, width = _dense(line)
        column, row = (x - x_mm[0]) / pitch, (y_mm[0] - y) / pitch
        reach = int(np.ceil(3.5 * width.max() / pitch))
        seen = (column > -reach) & (column < x_mm.size + reach) & (row > -reach) & (row < y_mm.size + reach)
        if not seen.any():
            continue
        column, row, depth, width = column[seen], row[seen], depth[seen], width[seen] / pitch
        top, left = int(row.min()) - reach - 1, int(column.min()) - reach - 1
        size = (int(row.max()) + reach + 2 - top, int(column.max()) + reach + 2 - left)
        own = np.zeros(size)
        for r, c, d, w in zip(row - top, column - left, depth, width, strict=True):
            n = int(np.ceil(3.5 * w))
            r0, c0 = max(int(r) - n, 0), max(int(c) - n, 0)
            part = own[r0 : int(r) + n + 2, c0 : int(c) + n + 2]
            down = np.exp(-0.5 * ((np.arange(part.shape[0]) + r0 - r) / w) ** 2)
            across = np.exp(-0.5 * ((np.arange(part.shape[1]) + c0 - c) / w) ** 2)
            np.maximum(part, (d * down)[:, None] * across[None, :], out=part)
        rows = slice(max(top, 0), min(top + size[0], y_mm.size))
        columns = slice(max(left, 0), min(left + size[1], x_mm.size))
        inside = own[rows.start - top : rows.stop - top, columns.start - left : columns.stop - left]
        powers[rows, columns] += inside**TOGETHER
    return np.asarray(powers ** (1.0 / TOGETHER))


def _dense(line: PalmLine) -> tuple[Array, Array, Array, Array]:
    """Points at a third of the line's least width: x, y, depth, width."""
    length = STEP_MM * np.arange(len(line.points_mm))
    fine = np.arange(0.0, float(length[-1]), float(line.width_mm.min()) / 3.0)
    values = (line.points_mm[:, 0], line.points_mm[:, 1], line.depth_mm, line.width_mm)
    x, y, depth, width = (np.interp(fine, length, value) for value in values)
    return x, y, depth, width
