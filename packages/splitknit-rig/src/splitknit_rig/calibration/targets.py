"""Printed targets in photographs: checkerboards (inner corners, which board) and the calibration disc (black dots)."""

from __future__ import annotations

import re
from collections import deque
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit import Array, FloatArray, require

_WORDS = re.compile(r"\s*(\d{1,4})\s*[xX×]\s*(\d{1,4})\s*")


@dataclass(frozen=True, slots=True)
class Board:
    """A printed checkerboard."""

    columns: int  # inner corners along one side: one less than squares
    rows: int  # inner corners along the other side
    square_mm: float  # side of a square, as measured on the print

    def __post_init__(self) -> None:
        require(
            3 <= self.columns <= 200 and 3 <= self.rows <= 200,
            f"a checkerboard must have 3 to 200 inner corners each way, but it is {self.columns} x {self.rows}; "
            "count the corners at which four squares meet.",
        )
        require(
            0.01 <= self.square_mm <= 10_000,
            f"the side of a square must be from 0.01 to 10000 mm, but it is {self.square_mm:g}.",
        )

    @classmethod
    def named(cls, text: str, square_mm: float) -> Board:
        """Read a size such as ``9x6``."""
        found = _WORDS.fullmatch(text)
        require(
            found is not None,
            f"'{text}' is not the size of a checkerboard; write the inner corners each way, such as 9x6.",
        )
        assert found is not None
        return cls(int(found.group(1)), int(found.group(2)), square_mm)

    @property
    def size(self) -> tuple[int, int]:
        """Columns, rows of inner corners."""
        return self.columns, self.rows

    @property
    def points_mm(self) -> Array:
        """(columns * rows, 2) places of the corners on the board, x first, in the order of :func:`find_board`."""
        y, x = np.mgrid[: self.rows, : self.columns]
        return np.stack([x.ravel(), y.ravel()], axis=1) * float(self.square_mm)


_SEARCH_PX = 1200  # longer side of the image in which the board is sought; corners are then refined in the full image
_WINDOW = 0.3  # half the window in which a corner is refined, as a part of the shortest side of a square in the image
_WINDOW_PX = (3, 40)  # smallest and largest half window
_SMOOTH_PX = 1.5
"""Blur (sigma, at most 5 % of a side) before corners are refined: edges sharp as a pixel draw corners to its middle."""
_CONTRAST = 0.4
"""Contrast, relative to the board's corners, from which a place one square further is a corner of the board too."""


def _grey(pixels: Any) -> FloatArray:
    """(H, W) float32 from 0 to 255 of an image (H, W) or (H, W, C): its darkest and brightest 0.5 % are cut off."""
    array = np.asarray(pixels)
    require(array.ndim in (2, 3) and array.size > 0, f"an image must be (H, W) or (H, W, C), but it is {array.shape}.")
    image = array.astype(np.float32) if array.ndim == 2 else array.mean(axis=2, dtype=np.float32)
    require(bool(np.isfinite(image).all()), "an image contains NaN or infinite values.")
    low, high = np.percentile(image[:: max(1, len(image) // 1000)], (0.5, 99.5))
    require(high > low, "an image is of one brightness all over; nothing can be found in it.")
    return np.asarray(np.clip((image - low) * (255.0 / (high - low)), 0, 255), dtype=np.float32)


def find_board(pixels: Any, board: Board, search_px: int = _SEARCH_PX) -> Array | None:
    """Inner corners of a checkerboard in an image (H, W) or (H, W, C): (columns * rows, 2) column and row in the order
    of `board.points_mm`, or None where no board of just this size (c x r and r x c are the same) is in full view. It is
    sought with the longer side reduced to `search_px`, and refined in the full image. Source: A. Duda, U. Frese,
    "Accurate detection and localization of checkerboard corners for calibration", BMVC 2018
    (``findChessboardCornersSB``); W. Foerstner, E. Guelch, "A fast operator for detection and precise location of
    distinct points, corners and centres of circular features", 1987 (``cornerSubPix``).
    """
    image = _grey(pixels)
    for small, factor in _reduced(image, search_px):
        for search in (_by_quads, _by_sector):  # the quick one first; what either finds is checked and refined
            grid = search(small, board)
            if grid is None:
                continue
            refined = _refined(image, (grid + 0.5) / factor - 0.5)
            if _is_board(image, refined) and _grown(image, refined, steps=1).shape == refined.shape:
                return np.asarray(refined.reshape(-1, 2), dtype=np.float64)
    return None


def size_in_view(pixels: Any) -> tuple[int, int] | None:
    """Inner corners (more, fewer) of the checkerboard in an image, whatever its size, or None where there is none."""
    image = _grey(pixels)
    for small, factor in _reduced(image, _SEARCH_PX):
        flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_LARGER
        found, corners, size = cv2.findChessboardCornersSBWithMeta(small, (3, 3), flags=flags)
        seeds = [_grid(corners, *size.shape) if found else None]
        seeds += [_by_quads(small, Board(columns, rows, 1.0)) for columns, rows in ((6, 5), (5, 4), (4, 3))]
        for seed in seeds:
            if seed is None:
                continue
            grid = _refined(image, (seed + 0.5) / factor - 0.5)
            if _is_board(image, grid):
                rows, columns = _grown(image, grid, steps=200).shape[:2]
                return max(rows, columns), min(rows, columns)
    return None


def _reduced(image: FloatArray, search_px: int) -> list[tuple[NDArray[np.uint8], float]]:
    factor = min(1.0, search_px / max(image.shape))
    sizes = [factor] if factor > 0.5 else [factor, min(1.0, 2 * factor)]
    small = (image if k == 1.0 else cv2.resize(image, None, fx=k, fy=k, interpolation=cv2.INTER_AREA) for k in sizes)
    return [(np.asarray(np.round(one), dtype=np.uint8), k) for one, k in zip(small, sizes, strict=True)]


def _by_sector(image: NDArray[np.uint8], board: Board) -> Array | None:
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    found, corners = cv2.findChessboardCornersSB(image, board.size, flags=flags)
    return _grid(corners, board.rows, board.columns) if found else None


def _by_quads(image: NDArray[np.uint8], board: Board) -> Array | None:
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
    found, corners = cv2.findChessboardCorners(image, board.size, flags=flags)
    return _grid(corners, board.rows, board.columns) if found else None


def _grid(corners: Any, rows: int, columns: int) -> Array:
    return np.asarray(corners, dtype=np.float64).reshape(rows, columns, 2)


def _refined(image: FloatArray, grid: Array) -> Array:
    """Corners (rows, columns, 2) to a small part of a pixel, with windows that stay within the four squares around."""
    side = min(float(np.linalg.norm(np.diff(grid, axis=axis), axis=2).min()) for axis in (0, 1))
    half = int(np.clip(round(_WINDOW * side), *_WINDOW_PX))
    blur = min(_SMOOTH_PX, 0.05 * side)
    if blur > 0.3:
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), blur), dtype=np.float32)
    corners = np.ascontiguousarray(grid.reshape(-1, 1, 2), dtype=np.float32)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-4)
    refined = cv2.cornerSubPix(image, corners, (half, half), (-1, -1), criteria)
    return np.asarray(refined, dtype=np.float64).reshape(grid.shape)


def _is_board(image: FloatArray, grid: Array) -> bool:
    """Whether four squares of changing brightness meet at every place."""
    contrast = _contrast(image, grid)
    return bool(contrast.min() > 0.2 * np.median(contrast) > 0)


def _grown(image: FloatArray, grid: Array, steps: int) -> Array:
    """The grid with all rows and columns that lie beyond it and are corners too, `steps` at most on each side."""
    least = _CONTRAST * float(np.median(_contrast(image, grid)))
    for _ in range(4):
        grid = np.rot90(grid, axes=(0, 1))
        for _ in range(steps):
            line = (2 * grid[-1] - grid[-2])[None]
            further = np.concatenate([grid[-1:], line])
            inside = np.all((line >= 2) & (line <= np.array(image.shape[::-1]) - 3))
            if not inside or np.median(_contrast(image, further)[1]) < least:
                break
            grid = np.concatenate([grid, _refined(image, further)[1:]])
    return grid


def _contrast(image: FloatArray, grid: Array) -> Array:
    """(rows, columns) contrast of the four squares that meet at each place: the smallest of four steps around it."""
    along, across = np.gradient(grid, axis=1) * 0.25, np.gradient(grid, axis=0) * 0.25
    around = [grid + along + across, grid - along + across, grid - along - across, grid + along - across]
    places = np.stack(around).astype(np.float32)  # (4, rows, columns, 2)
    x, y = np.moveaxis(places.reshape(4, -1, 2), -1, 0).copy()
    light = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    values = np.asarray(light, dtype=np.float64).reshape(places.shape[:3])
    steps = np.abs(values - np.roll(values, 1, axis=0))
    return np.asarray(steps.min(axis=0))


_STARTS = 8  # dots from which a grid is tried
_MIN_DOT_PX = 4.0  # smallest diameter
_MAX_DOT = 0.2  # largest diameter, as a part of the picture's shorter side
_MIN_ROUNDNESS = 0.75  # shortest over longest axis, at least: dots seen at 40 deg have 0.77
_MIN_FILL = 0.85  # area over that of the ellipse with the same moments, and its inverse
_MAX_MISS = 0.25  # how far from its expected place, in spacings, a dot of the grid may lie


def _find_dots(pixels: Any) -> Array:
    """Centres (N, 2), column and row, of black dots, round, whole and of one size, darker than half-way between ground
    and ink. A centre is that of darkness: a tilt moves it by radius^2 sin(tilt) / height, 7e-5 mm at 1 deg and 140 mm.
    """
    image = _grey(pixels)
    side = min(image.shape)
    # The picture without its dots
    factor = min(1.0, 200.0 / max(image.shape))
    small = cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    size = 2 * int(np.ceil((_MAX_DOT * side) * factor / 2)) + 1
    closed = cv2.morphologyEx(small, cv2.MORPH_CLOSE, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)))
    smooth = cv2.GaussianBlur(closed, (0, 0), size / 6)
    wide = cv2.resize(smooth, image.shape[::-1], interpolation=cv2.INTER_LINEAR)
    ground = np.asarray(wide, dtype=np.float32)
    darkness = np.clip(1 - image / np.maximum(ground, 1e-3), 0, 1)
    ink = float(np.percentile(darkness, 99.9))
    if ink < 0.15:
        return np.zeros((0, 2))
    _, labels, boxes, _ = cv2.connectedComponentsWithStats(np.asarray(darkness > ink / 2, dtype=np.uint8))
    dots = []
    for label, (left, top, width, height, area) in enumerate(np.asarray(boxes).tolist()):
        inside = left > 0 and top > 0 and left + width < image.shape[1] and top + height < image.shape[0]
        if label == 0 or not inside or area < _MIN_DOT_PX**2 / 2 or max(width, height) > _MAX_DOT * side:
            continue
        pad = 2 + round(0.15 * max(width, height))
        rows = slice(max(top - pad, 0), top + height + pad)
        columns = slice(max(left - pad, 0), left + width + pad)
        others = (labels[rows, columns] > 0) & (labels[rows, columns] != label)
        dot = _dot(np.where(others, 0, darkness[rows, columns]), area)
        if dot is not None:
            dots.append((dot[0] + columns.start, dot[1] + rows.start, area))
    if not dots:
        return np.zeros((0, 2))
    found = np.array(dots)
    near = np.abs(np.log(found[:, 2:] / found[:, 2])) < np.log(1.6)
    common = float(np.median(found[near[int(np.argmax(near.sum(axis=1)))], 2]))  # the area that most dots have
    similar = np.abs(np.log(found[:, 2] / common)) < np.log(1.6)
    return found[similar, :2]


def _number_dots(centres: Any) -> tuple[NDArray[np.int64], Array]:
    """Places of dots in a square grid: (M, 2) whole steps, zero near the middle, and (M, 2) centres. A grid grows from
    a dot there by local steps, so that perspective and distortion do not add up; the one with most dots is taken.
    """
    dots = np.asarray(centres, dtype=np.float64).reshape(-1, 2)
    _require_grid(len(dots) >= 6, len(dots))
    apart = np.linalg.norm(dots[:, None] - dots, axis=2)
    by_middle = np.argsort(np.linalg.norm(dots - dots.mean(axis=0), axis=1))
    known: dict[tuple[int, int], int] = {}
    for first in by_middle[:_STARTS].tolist():
        for neighbour in np.argsort(apart[first])[1:4].tolist():
            grown = _grown_dots(dots, first, dots[neighbour] - dots[first])
            known = grown if len(grown) > len(known) else known
            if len(known) == len(dots):
                break
    _require_grid(len(known) >= 6, len(known))
    return np.array(list(known), dtype=np.int64), dots[list(known.values())]


def _grown_dots(dots: Array, first: int, step: Array) -> dict[tuple[int, int], int]:
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
            if beyond in known or nearest in known.values() or miss > _MAX_MISS:
                continue
            found = sign * (dots[nearest] - here)
            known[beyond] = nearest
            steps[beyond] = (found, basis[1]) if axis == 0 else (basis[0], found)
            queue.append(beyond)
    return known


def find_disc(pixels: Any, spacing_mm: float) -> tuple[Array, Array]:
    """Dots of the calibration disc: (M, 2) places in mm, and (M, 2) columns and rows in the image. Raises BadInput if
    `spacing_mm` cannot be, or no grid is in view.
    """
    require(0.1 <= spacing_mm <= 1000, f"the dots' spacing must be from 0.1 to 1000 mm, but it is {spacing_mm:g}.")
    numbers, places = _number_dots(_find_dots(pixels))
    return np.asarray(numbers * float(spacing_mm), dtype=np.float64), places


def _require_grid(condition: bool, count: int) -> None:
    require(
        condition,
        f"{count or 'no'} black dots on a grid were found, but six are needed; show the disc evenly lit, bright and "
        "sharp, with nothing else on it.",
    )


def _dot(darkness: FloatArray, area: int) -> tuple[float, float] | None:
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
    if small < _MIN_ROUNDNESS * large or not _MIN_FILL < area / ellipse < 1 / _MIN_FILL:
        return None
    return moments["m10"] / total, moments["m01"] / total
