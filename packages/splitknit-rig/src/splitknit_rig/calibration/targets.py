"""The printed checkerboard in photographs: its size and inner corners."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from splitknit.errors import BadInput, require
from splitknit.model import Array, FloatArray


@dataclass(frozen=True, slots=True)
class Board:
    """A printed checkerboard."""

    columns: int  # inner corners along one side: one less than squares
    rows: int  # inner corners along the other side
    square_mm: float  # side of a square, as measured on the print

    def __post_init__(self) -> None:
        require(
            3 <= self.columns <= 200 and 3 <= self.rows <= 200,
            f"a checkerboard must have 3 to 200 inner corners each way, but it is {self.columns} x"
            f" {self.rows}; count the corners at which four squares meet.",
        )
        require(
            0.01 <= self.square_mm <= 10_000,
            f"the side of a square must be from 0.01 to 10000 mm, but it is {self.square_mm:g}.",
        )

    @classmethod
    def named(cls, text: str, square_mm: float) -> Board:
        """Read a size such as ``9x6``."""
        size = re.fullmatch(r"\s*(\d{1,4})\s*[xX×]\s*(\d{1,4})\s*", text)
        if size is None:
            raise BadInput(
                f"'{text}' is not the size of a checkerboard; write the inner corners each way,"
                " such as 9x6."
            )
        return cls(int(size[1]), int(size[2]), square_mm)

    @property
    def name(self) -> str:
        """Such as ``9x6``."""
        return f"{self.columns}x{self.rows}"

    @property
    def points_mm(self) -> Array:
        """(columns * rows, 2) places of the corners on the board, x first, in the order of
        :func:`find_board`."""
        y, x = np.mgrid[: self.rows, : self.columns]
        return np.stack([x.ravel(), y.ravel()], axis=1) * float(self.square_mm)


_BY_QUADS = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
_BY_SECTOR = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY


def _grey(pixels: Any) -> FloatArray:
    """(H, W) float32 from 0 to 255 of an image (H, W) or (H, W, C): its darkest and brightest 0.5 %
    are cut off."""
    array = np.asarray(pixels)
    require(
        array.ndim in (2, 3) and array.size > 0,
        f"an image must be (H, W) or (H, W, C), but it is {array.shape}.",
    )
    image = array.astype(np.float32) if array.ndim == 2 else array.mean(axis=2, dtype=np.float32)
    require(np.isfinite(image).all(), "an image contains NaN or infinite values.")
    low, high = np.percentile(image[:: max(1, len(image) // 1000)], (0.5, 99.5))
    require(high > low, "an image is of one brightness all over; nothing can be found in it.")
    return np.asarray(np.clip((image - low) * (255.0 / (high - low)), 0, 255), dtype=np.float32)


def find_board(pixels: Any, board: Board, search_px: int = 1200) -> Array | None:
    """Inner corners of a checkerboard in an image (H, W) or (H, W, C): (columns * rows, 2) column
    and row in the order of `board.points_mm`, or None where no board of just this size (c x r and r
    x c are the same) is in full view. It is sought with the longer side reduced to `search_px`, and
    refined in the full image. Source: A. Duda, U. Frese, "Accurate detection and localization of
    checkerboard corners for calibration", BMVC 2018 (``findChessboardCornersSB``); W. Foerstner, E.
    Guelch, "A fast operator for detection and precise location of distinct points, corners and
    centres of circular features", 1987 (``cornerSubPix``).
    """
    image = _grey(pixels)
    size = (board.columns, board.rows)
    factor = min(1.0, search_px / max(image.shape))
    for scale in [factor] if factor > 0.5 else [factor, min(1.0, 2 * factor)]:
        small = image
        if scale != 1.0:
            small = np.asarray(
                cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
            )
        codes = np.asarray(np.round(small), dtype=np.uint8)
        # the quick search first; what either finds is checked and refined
        for search, flags in (
            (cv2.findChessboardCorners, _BY_QUADS),
            (cv2.findChessboardCornersSB, _BY_SECTOR),
        ):
            complete, corners = search(codes, size, flags=flags)
            if not complete:
                continue
            grid = np.asarray(corners, dtype=np.float64).reshape(board.rows, board.columns, 2)
            refined = _refined(image, (grid + 0.5) / scale - 0.5)
            if _is_board(image, refined) and not _goes_on(image, refined):
                return np.asarray(refined.reshape(-1, 2), dtype=np.float64)
    return None


_CORNER_BLUR_PX = 1.5
"""Standard deviation: edges sharp as a pixel draw corners to its middle. Chosen on: simulated
objects (boards with squares of 57 px: corners 0.05 px off without it, 0.015 with it)."""


def _refined(image: FloatArray, grid: Array) -> Array:
    """Corners (rows, columns, 2) with subpixel accuracy, from windows that stay within the four
    squares around each."""
    side = min(float(np.linalg.norm(np.diff(grid, axis=axis), axis=2).min()) for axis in (0, 1))
    half = int(np.clip(round(0.3 * side), 3, 40))
    blur = min(_CORNER_BLUR_PX, 0.05 * side)
    if blur > 0.3:
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), blur), dtype=np.float32)
    corners = np.ascontiguousarray(grid.reshape(-1, 1, 2), dtype=np.float32)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-4)
    refined = cv2.cornerSubPix(image, corners, (half, half), (-1, -1), criteria)
    return np.asarray(refined, dtype=np.float64).reshape(grid.shape)


def _is_board(image: FloatArray, grid: Array) -> bool:
    """Whether four squares of alternating brightness meet at every corner."""
    contrast = _contrast(image, grid)
    return bool(contrast.min() > 0.2 * np.median(contrast) > 0)


def _goes_on(image: FloatArray, grid: Array) -> bool:
    """Whether the board has another row or column of corners beyond the grid."""
    least = 0.4 * float(np.median(_contrast(image, grid)))
    for side in (grid, grid[::-1], grid.swapaxes(0, 1), grid[:, ::-1].swapaxes(0, 1)):
        line = (2 * side[-1] - side[-2])[None]
        further = np.concatenate([side[-1:], line])
        inside = np.all((line >= 2) & (line <= np.array(image.shape[::-1]) - 3))
        if inside and np.median(_contrast(image, further)[1]) >= least:
            return True
    return False


def _contrast(image: FloatArray, grid: Array) -> Array:
    """(rows, columns) contrast of the four squares that meet at each place: the smallest of four
    steps around it."""
    along, across = np.gradient(grid, axis=1) * 0.25, np.gradient(grid, axis=0) * 0.25
    around = [
        grid + along + across,
        grid - along + across,
        grid - along - across,
        grid + along - across,
    ]
    places = np.stack(around).astype(np.float32)  # (4, rows, columns, 2)
    x, y = np.moveaxis(places.reshape(4, -1, 2), -1, 0).copy()
    light = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    values = np.asarray(light, dtype=np.float64).reshape(places.shape[:3])
    steps = np.abs(values - np.roll(values, 1, axis=0))
    return np.asarray(steps.min(axis=0))
