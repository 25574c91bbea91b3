"""The calibration disc: black dots on a square grid, found and numbered."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.calibration.board import grey
from splitknit.errors import require
from splitknit.model import FloatArray

Points = NDArray[np.float64]
_STARTS = 8
"""Dots from which a grid is tried."""


@dataclass(frozen=True, slots=True)
class DiscSettings:
    """What a dot looks like."""

    least_px: float = 4.0
    """Smallest diameter."""
    largest: float = 0.2
    """Largest diameter, as a part of the picture's shorter side."""
    roundness: float = 0.75
    """Shortest over longest axis, at least: dots seen at 40 deg have 0.77."""
    fill: float = 0.85
    """Area over that of the ellipse with the same moments, and its inverse."""
    near: float = 0.25
    """How far from its expected place, in spacings, a dot of the grid may lie."""

    def __post_init__(self) -> None:
        require(self.least_px >= 2, "DiscSettings: least_px must be at least 2.")
        require(0 < self.near < 0.5, "DiscSettings: near must lie between 0 and 0.5.")


DEFAULTS = DiscSettings()


def find_dots(pixels: Any, settings: DiscSettings = DEFAULTS) -> Points:
    """Centres (N, 2), column and row, of black round dots on a bright ground, in no order.

    Dots are what stays darker than half-way between ground and ink, round, whole (not cut by the picture's edge) and
    of one size. A centre is the dot's centre of darkness. Under a tilt that is not quite the picture of the dot's
    middle, but the difference, radius^2 * sin(tilt) / height, is 7e-5 mm at 1 deg and 140 mm.

    Parameters
    ----------
    pixels : (H, W) or (H, W, C) image
    settings : DiscSettings
    """
    image = grey(pixels)
    side = min(image.shape)
    ground = _ground(image, settings.largest * side)
    darkness = np.clip(1 - image / np.maximum(ground, 1e-3), 0, 1)
    ink = float(np.percentile(darkness, 99.9))
    if ink < 0.15:
        return np.zeros((0, 2))
    _, labels, boxes, _ = cv2.connectedComponentsWithStats(np.asarray(darkness > ink / 2, dtype=np.uint8))
    dots = []
    for label, (left, top, width, height, area) in enumerate(np.asarray(boxes).tolist()):
        inside = left > 0 and top > 0 and left + width < image.shape[1] and top + height < image.shape[0]
        if label == 0 or not inside or area < settings.least_px**2 / 2 or max(width, height) > settings.largest * side:
            continue
        pad = 2 + round(0.15 * max(width, height))
        rows = slice(max(top - pad, 0), top + height + pad)
        columns = slice(max(left - pad, 0), left + width + pad)
        others = (labels[rows, columns] > 0) & (labels[rows, columns] != label)
        dot = _dot(np.where(others, 0, darkness[rows, columns]), area, settings)
        if dot is not None:
            dots.append((dot[0] + columns.start, dot[1] + rows.start, area))
    if not dots:
        return np.zeros((0, 2))
    found = np.array(dots)
    alike = np.abs(np.log(found[:, 2] / _common(found[:, 2]))) < np.log(1.6)
    return found[alike, :2]


def number_dots(centres: Any, settings: DiscSettings = DEFAULTS) -> tuple[NDArray[np.int64], Points]:
    """Assign dots to the places of a square grid.

    A grid grows from a dot near the middle: each known dot expects its four neighbours one step away, with the steps as
    they are there, so that perspective and distortion do not accumulate. Several dots and steps are tried; the grid
    that takes in most dots is it.

    Parameters
    ----------
    centres : (N, 2) from :func:`find_dots`
    settings : DiscSettings

    Returns
    -------
    numbers : (M, 2) whole steps along both axes of the grid, zero at a dot near the middle
    places : (M, 2) their centres

    Raises
    ------
    BadInput
        If fewer than six dots form a grid.
    """
    dots = np.asarray(centres, dtype=np.float64).reshape(-1, 2)
    _require_grid(len(dots) >= 6, len(dots))
    apart = np.linalg.norm(dots[:, None] - dots, axis=2)
    by_middle = np.argsort(np.linalg.norm(dots - dots.mean(axis=0), axis=1))
    known: dict[tuple[int, int], int] = {}
    for first in by_middle[:_STARTS].tolist():
        for neighbour in np.argsort(apart[first])[1:4].tolist():
            grown = _grown(dots, first, dots[neighbour] - dots[first], settings)
            known = grown if len(grown) > len(known) else known
            if len(known) == len(dots):
                break
    _require_grid(len(known) >= 6, len(known))
    return np.array(list(known), dtype=np.int64), dots[list(known.values())]


def _grown(dots: Points, first: int, step: Points, settings: DiscSettings) -> dict[tuple[int, int], int]:
    """The grid that grows from one dot with one step to a neighbour: index of the dot at each place."""
    along = step if abs(step[0]) >= abs(step[1]) else np.array([-step[1], step[0]])  # as near to the columns as it can
    along = along * np.sign(along[0])
    across = np.array([-along[1], along[0]])
    known: dict[tuple[int, int], int] = {(0, 0): first}
    steps = {(0, 0): (along, across)}
    queue = deque([(0, 0)])
    while queue:
        place = queue.popleft()
        here, basis = dots[known[place]], steps[place]
        for axis, sign in ((0, 1), (0, -1), (1, 1), (1, -1)):
            beyond = (place[0] + sign * (axis == 0), place[1] + sign * (axis == 1))
            expected = here + sign * basis[axis]
            nearest = int(np.argmin(np.linalg.norm(dots - expected, axis=1)))
            miss = float(np.linalg.norm(dots[nearest] - expected)) / float(np.linalg.norm(basis[axis]))
            if beyond in known or nearest in known.values() or miss > settings.near:
                continue
            found = sign * (dots[nearest] - here)
            known[beyond] = nearest
            steps[beyond] = (found, basis[1]) if axis == 0 else (basis[0], found)
            queue.append(beyond)
    return known


def find_disc(pixels: Any, spacing_mm: float, settings: DiscSettings = DEFAULTS) -> tuple[Points, Points]:
    """Dots of the calibration disc: (M, 2) places on it in mm, and (M, 2) columns and rows in the image.

    Raises
    ------
    BadInput
        If `spacing_mm` cannot be, or no grid of dots is in view.
    """
    require(0.1 <= spacing_mm <= 1000, f"the dots' spacing must be from 0.1 to 1000 mm, but it is {spacing_mm:g}.")
    numbers, places = number_dots(find_dots(pixels, settings), settings)
    return np.asarray(numbers * float(spacing_mm), dtype=np.float64), places


def _require_grid(condition: bool, count: int) -> None:
    require(
        condition,
        f"{count or 'no'} black dots on a grid were found, but six are needed; show the disc evenly lit, bright and "
        "sharp, with nothing else on it.",
    )


def _ground(image: FloatArray, reach_px: float) -> FloatArray:
    """The picture without its dots: what is bright over an area wider than a dot, smooth."""
    factor = min(1.0, 200.0 / max(image.shape))
    small = cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    size = 2 * int(np.ceil(reach_px * factor / 2)) + 1
    closed = cv2.morphologyEx(small, cv2.MORPH_CLOSE, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)))
    smooth = cv2.GaussianBlur(closed, (0, 0), size / 6)
    wide = cv2.resize(smooth, image.shape[::-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(wide, dtype=np.float32)


def _dot(darkness: FloatArray, area: int, settings: DiscSettings) -> tuple[float, float] | None:
    """Centre (column, row) of darkness if it is round, else None."""
    ink = darkness.max()
    weight = np.clip(darkness / ink, 0.1, None) - 0.1
    moments = cv2.moments(np.asarray(weight, dtype=np.float64))
    total = moments["m00"]
    if total <= 0:
        return None
    spread = np.array([[moments["mu20"], moments["mu11"]], [moments["mu11"], moments["mu02"]]]) / total
    small, large = np.sqrt(np.maximum(np.linalg.eigvalsh(spread), 1e-9))
    ellipse = 4 * np.pi * small * large  # the area of a filled ellipse with these moments
    if small < settings.roundness * large or not settings.fill < area / ellipse < 1 / settings.fill:
        return None
    return moments["m10"] / total, moments["m01"] / total


def _common(areas: NDArray[np.float64]) -> float:
    """The area that most dots have, within 60 %."""
    near = np.abs(np.log(areas[:, None] / areas)) < np.log(1.6)
    return float(np.median(areas[near[int(np.argmax(near.sum(axis=1)))]]))
