"""A result as the viewer needs it: heights and relief on the finger's part of the grid, places in the upright frame.

Places are those of ``phalange.ply``: x right, y to the fingertip, z to the camera, mm; pixels where the scale of the
result is unknown.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.imaging.geometry import bounding_box
from splitknit.io.results import read_fields
from splitknit.model import BoolArray, FloatArray

_LONGEST_MM, _LONGEST_PX = 1000.0, 40_000.0
_RAYS = ("x_mm", "y_mm")


@dataclass(frozen=True, slots=True, eq=False)
class ShownSurface:
    """The finger's box of a result."""

    height_mm: FloatArray
    """(h, w), NaN outside the mask."""
    ridge_mm: FloatArray
    """(h, w), zero where it is not known."""
    x_mm: FloatArray
    """(h, w)."""
    y_mm: FloatArray
    """(h, w)."""
    mask: BoolArray
    """(h, w) where there is a height."""
    corner: tuple[int, int]
    """Row and column of the box in the input."""
    size: tuple[int, int]
    """Rows and columns of the input."""
    pitch_mm: float
    turn: NDArray[np.float64]
    """(2, 2): from (x, y) of the rig's frame to the upright one."""
    input_from_upright: NDArray[np.float64]
    """(3, 3) on (column, row, 1)."""
    upright_size: tuple[int, int]
    low_mm: tuple[float, float, float]
    """Least x, y, z."""
    high_mm: tuple[float, float, float]
    highest_relief_mm: float
    """Largest distance of the relief from zero."""
    scale_known: bool = True
    """If not, `pitch_mm` is 1 and all that is named ``_mm`` or ``_um`` here is in pixels."""

    @property
    def um(self) -> float:
        """Units of the relief in one of the heights: 1000 um a mm, or 1 where both are in pixels."""
        return 1000.0 if self.scale_known else 1.0

    @property
    def longest_mm(self) -> float:
        """No place of an object is as far from the origin."""
        return _LONGEST_MM if self.scale_known else _LONGEST_PX

    @property
    def nbytes(self) -> int:
        """Memory that its arrays take."""
        arrays = (self.height_mm, self.ridge_mm, self.x_mm, self.y_mm, self.mask)
        return sum(array.nbytes for array in arrays)

    @property
    def count(self) -> int:
        """Number of heights."""
        return int(self.mask.sum())

    def plan(self, column: NDArray[np.float64], row: NDArray[np.float64]) -> NDArray[np.float64]:
        """(2, N) x and y, mm, of places of the input's grid if the camera's rays were parallel."""
        x = (column - (self.size[1] - 1) / 2) * self.pitch_mm
        y = ((self.size[0] - 1) / 2 - row) * self.pitch_mm
        return np.asarray(self.turn @ np.stack([x, y]))

    def grid_of_plan(self, x_mm: NDArray[np.float64], y_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """(2, N) column and row in the box; the inverse of :meth:`plan`."""
        x, y = self.turn.T @ np.stack([x_mm, y_mm])
        column = x / self.pitch_mm + (self.size[1] - 1) / 2 - self.corner[1]
        row = (self.size[0] - 1) / 2 - y / self.pitch_mm - self.corner[0]
        return np.stack([column, row])


def read_shown_surface(folder: Path) -> ShownSurface:
    """Read the heights of a result folder; where their scale is unknown, all lengths are in pixels.

    Raises
    ------
    BadInput
        If ``height.npz`` is missing or damaged, or an array is missing or of another kind than a result's.
    """
    arrays = fields_of(folder, ("height_mm", "ridge_mm"), _RAYS, unscaled=True)
    again = f"{folder / 'height.npz'} is not a result's: reconstruct the capture again"
    mask, shape = arrays["mask"], arrays["mask"].shape
    pitch_mm, matrix = arrays["pitch_mm"], arrays["input_from_upright"]
    mask = mask & np.isfinite(arrays["height_mm"])
    require(bool(mask.any()), f"{again} (it holds no heights).")
    box = bounding_box(mask)
    inside = np.ascontiguousarray(mask[box])
    turn = _turn(matrix)
    require(bool(np.abs(turn @ turn.T - np.eye(2)).max() < 1e-3), f"{again} (its frame is no rotation).")
    with np.errstate(over="ignore", invalid="ignore"):  # what is too large is refused below
        x, y = _places(arrays, shape, box, pitch_mm, turn)
        inside &= np.isfinite(x) & np.isfinite(y)
        require(bool(inside.any()), f"{again} (its heights have no places).")
        height = np.where(inside, arrays["height_mm"][box], np.float32(np.nan))
        ridge = np.where(inside, np.nan_to_num(arrays["ridge_mm"][box]), np.float32(0.0))
    corner = (box[0].start, box[1].start)
    low, high = zip(*(_range(values, inside) for values in (x, y, height)), strict=True)
    relief = max(float(ridge.max()), -float(ridge.min()))
    surface = ShownSurface(
        height, ridge, x, y, inside, corner, (shape[0], shape[1]), pitch_mm, turn, matrix, arrays["upright_size"],
        low, high, relief, arrays["scale_known"],
    )  # fmt: skip
    within = max(*np.abs([*low, *high]), relief) < surface.longest_mm  # not of NaN either
    places = f"{surface.longest_mm:g} {'mm' if surface.scale_known else 'pixels'}"
    require(bool(within), f"{again} (it holds places beyond {places}, which are no finger's).")
    return surface


def fields_of(folder: Path, names: Sequence[str], optional: Sequence[str] = (), *, unscaled: bool = False) -> Any:
    """Fields of a result, as :func:`splitknit.io.results.read_fields`, but no link. Raises BadInput."""
    path = folder / "height.npz"
    require(path.is_file() and not path.is_symlink(), f"'{folder}' is not a result: it holds no height.npz.")
    return read_fields(path, names, optional, unscaled=unscaled)


def _range(values: FloatArray, mask: BoolArray) -> tuple[float, float]:
    known = values[mask]
    return float(known.min()), float(known.max())


def _turn(input_from_upright: NDArray[np.float64]) -> NDArray[np.float64]:
    """See :func:`splitknit.io.pictures.upright_turn`."""
    turn = np.linalg.inv(input_from_upright[:2, :2])
    flip = np.diag([1.0, -1.0])
    return np.asarray(flip @ (turn / np.sqrt(abs(np.linalg.det(turn)))) @ flip)


def _places(
    arrays: Mapping[str, NDArray[Any]],
    size: tuple[int, int],
    box: tuple[slice, slice],
    pitch_mm: float,
    turn: NDArray[np.float64],
) -> tuple[FloatArray, FloatArray]:
    """Upright x and y (h, w) of the pixels."""
    rows, columns = (np.arange(side.start, side.stop, dtype=np.float64) for side in box)
    x: NDArray[Any] = ((columns - (size[1] - 1) / 2) * pitch_mm)[None, :]
    y: NDArray[Any] = (((size[0] - 1) / 2 - rows) * pitch_mm)[:, None]
    if all(name in arrays for name in _RAYS):
        x, y = (arrays[name][box].astype(np.float32) for name in _RAYS)
    across = (turn[0, 0] * x + turn[0, 1] * y).astype(np.float32)
    along = (turn[1, 0] * x + turn[1, 1] * y).astype(np.float32)
    return across, along


TILE = 96
_FIRST_VIEW = 70_000
"""Points of the first view."""
_FINE = 1024
"""Values are sent as multiples of this part of their distance: 13 nm at the finest level of a full frame."""
_HEAD = struct.Struct("<8id")


def _root_stride(surface: ShownSurface) -> int:
    """Stride of the first view, a power of two."""
    stride = 1
    while surface.count / stride**2 > _FIRST_VIEW:
        stride *= 2
    return stride


def strides(surface: ShownSurface) -> list[int]:
    """Strides of all levels, the coarsest first."""
    stride = _root_stride(surface)
    return [stride >> k for k in range(stride.bit_length())]


def filled_tiles(surface: ShownSurface, stride: int) -> list[tuple[int, int]]:
    """Row and column of each tile of a level that holds a piece of the surface."""
    mask = surface.mask[::stride, ::stride]
    pad = [(0, -side % TILE) for side in mask.shape]
    blocks = np.pad(mask, pad)
    blocks = blocks.reshape(blocks.shape[0] // TILE, TILE, -1, TILE)
    return [(int(row), int(column)) for row, column in np.argwhere(blocks.any(axis=(1, 3)))]


def tile_bytes(surface: ShownSurface, stride: int, row: int, column: int) -> bytes:
    """Return one tile.

    Raises
    ------
    BadInput
        If there is no such stride or tile.
    """
    require(stride in strides(surface), f"there is no level of stride {stride}.")
    height, width = surface.mask.shape
    high, wide = math.ceil(height / stride), math.ceil(width / stride)
    require(0 <= row * TILE < high and 0 <= column * TILE < wide, f"there is no tile {row}, {column}.")
    # one value before the tile, and TILE, one shared with the next tile, one behind it
    rows = np.arange(row * TILE - 1, min(row * TILE + TILE + 2, high + 1)) * stride
    columns = np.arange(column * TILE - 1, min(column * TILE + TILE + 2, wide + 1)) * stride
    inside = ((rows >= 0) & (rows < height))[:, None] & ((columns >= 0) & (columns < width))[None, :]
    place = np.ix_(np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1))
    known = surface.mask[place] & inside
    quantum = max(surface.pitch_mm * stride / _FINE, 2.0**-20)  # 32 bits hold _LONGEST_PX
    first = (int(rows[0]) + surface.corner[0], int(columns[0]) + surface.corner[1])
    fields = (surface.x_mm, surface.y_mm, surface.height_mm, surface.ridge_mm)
    planes = [known.tobytes(), *(_packed(field[place], known, quantum) for field in fields)]
    total = _HEAD.size + sum(map(len, planes))
    head = _HEAD.pack(total, stride, row, column, len(rows), len(columns), *first, quantum)
    return head + b"".join(planes)


def first_view(surface: ShownSurface) -> bytes:
    """Tiles of the coarsest level, one after the other."""
    stride = _root_stride(surface)
    return b"".join(tile_bytes(surface, stride, row, column) for row, column in filled_tiles(surface, stride))


def _packed(values: FloatArray, known: BoolArray, quantum: float) -> bytes:
    """Whole numbers of quanta as what gzip packs well: differences along columns and rows, zigzag, byte by byte."""
    # what is unknown repeats the value before it
    before = np.maximum.accumulate(np.where(known, np.arange(known.shape[1]), 0), axis=1)
    whole = np.where(known, np.rint(np.nan_to_num(values) / quantum), 0.0).astype(np.int32)
    whole = np.take_along_axis(whole, before, axis=1)
    step = np.diff(np.diff(whole, axis=0, prepend=0), axis=1, prepend=0)
    zigzag = ((step << 1) ^ (step >> 31)).astype("<i4")
    return zigzag.reshape(-1, 1).view(np.uint8).T.tobytes()
