"""A result as the viewer needs it: heights and relief on the finger's part of the grid, places in the upright frame.

Places are those of ``phalange.ply``: x right, y to the fingertip, z to the camera, mm.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.io.npz import read_npz
from splitknit.model import NO_SCALE, BoolArray, FloatArray

_LONGEST = 20_000
_LONGEST_MM = 1000.0
"""No place of a finger is as far from the origin."""
_NEEDED = ("height_mm", "ridge_mm", "mask", "pitch_mm", "input_from_upright", "upright_size")
_RAYS = ("x_mm", "y_mm")


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
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


def read_surface(folder: Path) -> Surface:
    """Read the heights of a result folder.

    Raises
    ------
    BadInput
        If ``height.npz`` is missing or damaged, or an array is missing or of another kind than a result's.
    """
    path = folder / "height.npz"
    arrays = read_members(path, _NEEDED, _RAYS)
    again = f"{path} is not a result's: reconstruct the capture again"
    mask = arrays["mask"].astype(np.bool_, copy=False)
    shape = mask.shape
    wanted = {"height_mm": shape, "ridge_mm": shape, "pitch_mm": (), "input_from_upright": (3, 3), "upright_size": (2,)}
    wanted |= {name: shape for name in _RAYS if name in arrays}
    for name, size in wanted.items():
        fits = arrays[name].shape == size and arrays[name].dtype.kind in "fiu"
        require(fits and len(shape) == 2, f"{again} ('{name}' has another shape or kind).")
    pitch_mm, matrix = float(arrays["pitch_mm"]), arrays["input_from_upright"].astype(np.float64)
    rows, columns = (int(side) for side in arrays["upright_size"])
    usable = np.isfinite(matrix).all() and abs(float(np.linalg.det(matrix[:2, :2]))) > 1e-9
    usable = usable and 0 < rows <= _LONGEST and 0 < columns <= _LONGEST and 1e-6 < pitch_mm < 100
    require(bool(usable), f"{again} (its scale or its frame cannot be used).")
    mask = mask & np.isfinite(arrays["height_mm"])
    require(bool(mask.any()), f"{again} (it holds no heights).")
    box = _box(mask)
    inside = np.ascontiguousarray(mask[box])
    turn = _turn(matrix)
    require(bool(np.abs(turn @ turn.T - np.eye(2)).max() < 1e-3), f"{again} (its frame is no rotation).")
    with np.errstate(over="ignore", invalid="ignore"):  # what is too large is refused below
        height = np.where(inside, arrays["height_mm"][box], np.nan).astype(np.float32)
        ridge = np.where(inside, np.nan_to_num(arrays["ridge_mm"][box]), 0.0).astype(np.float32)
        x, y = _places(arrays, shape, box, pitch_mm, turn)
    corner = (box[0].start, box[1].start)
    low, high = zip(*(_range(values, inside) for values in (x, y, height)), strict=True)
    relief = max(float(ridge.max()), -float(ridge.min()))
    within = max(*np.abs([*low, *high]), relief) < _LONGEST_MM  # not of NaN either
    require(bool(within), f"{again} (it holds places beyond {_LONGEST_MM:g} mm, which are no finger's).")
    return Surface(
        height, ridge, x, y, inside, corner, (shape[0], shape[1]), pitch_mm, turn, matrix, (rows, columns),
        low, high, relief,
    )  # fmt: skip


def _range(values: FloatArray, mask: BoolArray) -> tuple[float, float]:
    known = values[mask]
    return float(np.fmin.reduce(known)), float(np.fmax.reduce(known))


def _box(mask: BoolArray) -> tuple[slice, slice]:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


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


def read_members(path: Path, needed: Sequence[str], wanted: Sequence[str] = ()) -> dict[str, NDArray[Any]]:
    """Read some arrays of a result's ``height.npz``.

    Parameters
    ----------
    path : Path
    needed : names that must be there
    wanted : names that may be there

    Raises
    ------
    BadInput
        If the file is missing, a link, damaged, too large, or lacks an array.
    """
    require(path.is_file() and not path.is_symlink(), f"'{path.parent}' is not a result: it holds no height.npz.")
    arrays = read_npz(path, (*needed, *wanted, "height_px"))
    require("height_px" not in arrays, f"{path}: {NO_SCALE}")
    missing = [name for name in needed if name not in arrays]
    require(not missing, f"{path} holds no '{''.join(missing[:1])}'; reconstruct the capture again.")
    return arrays


TILE = 96
_FIRST_VIEW = 70_000
"""Points of the first view."""
_HEAD = struct.Struct("<8i")


def _root_stride(surface: Surface) -> int:
    """Stride of the first view, a power of two."""
    stride = 1
    while surface.count / stride**2 > _FIRST_VIEW:
        stride *= 2
    return stride


def strides(surface: Surface) -> list[int]:
    """Strides of all levels, the coarsest first."""
    stride = _root_stride(surface)
    return [stride >> k for k in range(stride.bit_length())]


def filled_tiles(surface: Surface, stride: int) -> list[tuple[int, int]]:
    """Row and column of each tile of a level that holds a piece of the surface."""
    mask = surface.mask[::stride, ::stride]
    pad = [(0, -side % TILE) for side in mask.shape]
    blocks = np.pad(mask, pad)
    blocks = blocks.reshape(blocks.shape[0] // TILE, TILE, -1, TILE)
    return [(int(row), int(column)) for row, column in np.argwhere(blocks.any(axis=(1, 3)))]


def tile_bytes(surface: Surface, stride: int, row: int, column: int) -> bytes:
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
    values = np.stack([_taken(field[place], inside) for field in _fields(surface)]).astype("<f4")
    first = (int(rows[0]) + surface.corner[0], int(columns[0]) + surface.corner[1])
    total = _HEAD.size + values.nbytes
    return _HEAD.pack(total, stride, row, column, len(rows), len(columns), *first) + values.tobytes()


def first_view(surface: Surface) -> Iterator[bytes]:
    """Tiles of the coarsest level, one after the other."""
    stride = _root_stride(surface)
    for row, column in filled_tiles(surface, stride):
        yield tile_bytes(surface, stride, row, column)


def _fields(surface: Surface) -> tuple[NDArray[np.float32], ...]:
    return surface.x_mm, surface.y_mm, surface.height_mm, surface.ridge_mm


def _taken(values: NDArray[np.float32], inside: NDArray[np.bool_]) -> NDArray[np.float32]:
    return np.where(inside, values, np.float32(np.nan))
