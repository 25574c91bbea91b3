"""Where the pixels of a print lie in the image, and the other way round.

A map is made of a coarse grid of nodes whose places are known in the input and on the print, read
by cubic splines; its inverse is stored densely. Points are (column, row), as everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import scipy

from splitknit.checks import check_mask
from splitknit.errors import require
from splitknit.finger.ridges import MM_PER_INCH, upright_from_print
from splitknit.imaging.geometry import bounding_box, gaussian_mean, sampled_at
from splitknit.imaging.pixels import bin_mean
from splitknit.model import Array, BoolArray, FloatArray
from splitknit_match.prints.unroll import SurfaceGrid, Unrolled, extrapolated, moved
from splitknit_match.rolled.chart import surface_normals

NOWHERE = -1e6
"""Where a print's pixel lies in the input if it shows nothing. Source: definition."""


def _read(values: Array, places: Array) -> Array:
    """Values (..., 2) of a grid (n, m, 2) at `places` (..., 2; column, row), by cubic splines; NaN
    beside its nodes."""
    column, row = np.moveaxis(np.nan_to_num(places, nan=-1.0), -1, 0)
    at = column.astype(np.float32), row.astype(np.float32)
    whole = np.nan_to_num(extrapolated(values, 8))  # splines swing where zeros begin
    lines = np.arange(whole.shape[0]), np.arange(whole.shape[1])
    return np.stack(
        [
            scipy.interpolate.RectBivariateSpline(*lines, filled).ev(row, column)
            + 0.0 * sampled_at(known.astype(np.float32), *at, outside=np.nan)
            for filled, known in zip(
                np.moveaxis(whole, 2, 0), np.moveaxis(values, 2, 0), strict=True
            )
        ],
        axis=-1,
    )


@dataclass(frozen=True, slots=True, eq=False)
class PrintMap:
    """Between the input's pixels and a print's."""

    surface: str
    """``plane``, or the kind of unrolling."""
    ppi: float
    columns: FloatArray
    """(h, w) column of the input that each pixel of the print shows; :data:`NOWHERE` if none."""
    rows: FloatArray
    """(h, w) row, likewise."""
    input_from_grid: Array
    """(3, 3) where the nodes lie in the input."""
    print_of_grid: Array
    """(n, m, 2) where the nodes lie on the print, pixels; NaN where nowhere."""

    def print_from_input(self, points: Array) -> Array:
        """Places (N, 2) on the print of places (N, 2) in the input; NaN beside the finger."""
        return _read(self.print_of_grid, moved(np.linalg.inv(self.input_from_grid), points))

    def input_from_print(self, points: Array) -> Array:
        """Places (N, 2) in the input of places (N, 2) on the print; NaN where the print shows
        nothing."""
        columns, rows = np.nan_to_num(points, nan=-1.0).T.astype(np.float32)
        known = self.columns > 0.5 * NOWHERE
        fields = (np.where(known, field, np.float32(np.nan)) for field in (self.columns, self.rows))
        return np.stack(
            [sampled_at(field, columns, rows, outside=np.nan) for field in fields], axis=1
        ).astype(float)


def plane_map(
    pitch_mm: float, input_from_upright: Array, upright_size: tuple[int, int], ppi: float = 500.0
) -> PrintMap:
    """Return the map of the finger plane, seen straight from above: the frame of
    :func:`relief_print`.

    Raises BadInput if the resolution is not positive.
    """
    _check_ppi(ppi)
    step = MM_PER_INCH / ppi / pitch_mm
    size = _checked_size(*(max(1, round(side / step)) for side in upright_size))
    input_from_print = input_from_upright @ upright_from_print(size, upright_size, step)
    column, row = np.meshgrid(np.arange(size[1], dtype=float), np.arange(size[0], dtype=float))
    columns, rows = (line[0] * column + line[1] * row + line[2] for line in input_from_print[:2])
    # a grid of nodes wider than any input: straight lines are read exactly
    reach = 4.0 * max(size)
    print_from_grid = np.array(
        [[reach, 0.0, -2.0 * reach], [0.0, reach, -2.0 * reach], [0.0, 0.0, 1.0]]
    )
    node = np.stack(np.meshgrid(np.arange(6.0), np.arange(6.0)), axis=2)
    return PrintMap(
        "plane",
        ppi,
        columns.astype(np.float32),
        rows.astype(np.float32),
        input_from_print @ print_from_grid,
        moved(print_from_grid, node),
    )


_MARGIN_MM = 0.5  # margin of a print around all that it holds
_SLANT_DEG = 70.0  # skin steeper than this is left out of a print: the camera hardly sees it


def unrolled_map(
    unrolled: Unrolled, kind: str, ppi: float = 500.0, slant_deg: float | None = _SLANT_DEG
) -> PrintMap:
    """Return the map of skin that was laid flat; the print holds all that is less steep than
    `slant_deg`, and a margin.

    Without a `slant_deg` it holds all of the skin, however it is turned: a sheet around a finger.
    Raises BadInput if the resolution is not positive.
    """
    _check_ppi(ppi)
    px_per_mm = ppi / MM_PER_INCH
    flat = unrolled.flat_mm
    grid = unrolled.grid
    facing = (
        grid.inside
        if slant_deg is None
        else grid.inside & (_facing(grid) > np.cos(np.deg2rad(slant_deg)))
    )
    require(
        facing.any(),
        "the finger hardly faces the camera; capture it again with its pad towards it.",
    )
    low = flat[facing].min(axis=0) - _MARGIN_MM
    high = flat[facing].max(axis=0) + _MARGIN_MM
    size = _checked_size(*(int(np.ceil(length)) for length in (high - low)[::-1] * px_per_mm))
    # mirrored, as paper shows it
    print_of_grid = 0.5 * (np.array(size[::-1]) - 1) - (flat - 0.5 * (low + high)) * px_per_mm
    columns, rows = _inverse(print_of_grid, grid, size, slant_deg)
    return PrintMap(kind, ppi, columns, rows, grid.input_from_grid, print_of_grid)


def _checked_size(rows: int, columns: int) -> tuple[int, int]:
    require(
        rows * columns <= 25_000_000,  # largest print: 250 x 250 mm at 500 ppi
        f"the print would have {rows} x {columns} pixels, more than any finger's; check the scale"
        " of its input.",
    )
    return rows, columns


def _check_ppi(ppi: float) -> None:
    require(
        np.isfinite(ppi) and 10 <= ppi <= 10_000,
        f"ppi must lie between 10 and 10000, but it is {ppi}.",
    )


def _inverse(
    print_of_grid: Array, grid: SurfaceGrid, size: tuple[int, int], slant_deg: float | None
) -> tuple[FloatArray, FloatArray]:
    """Columns and rows of the input for every pixel of the print.

    Source: P. Alfeld 1984, A trivariate Clough-Tocher scheme for tetrahedral data (as scipy has it
    in the plane): smooth, and straight lines are read exactly.
    """
    near = np.isfinite(print_of_grid).all(axis=2)
    near &= cv2.dilate(grid.inside.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    nodes = np.argwhere(near)[:, ::-1].astype(float)
    inverse = scipy.interpolate.CloughTocher2DInterpolator(print_of_grid[near], nodes)
    pixel = np.stack(np.meshgrid(*map(np.arange, size[::-1])), axis=2)
    target = pixel.astype(float)
    for _ in range(2):  # farther by what it misses
        target += pixel - _read(print_of_grid, inverse(target))
    node = inverse(target)
    column, row = np.moveaxis(np.nan_to_num(node, nan=-1.0).astype(np.float32), 2, 0)
    facing = cv2.remap(
        _facing(grid), column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    least = -1.0 if slant_deg is None else np.cos(np.deg2rad(slant_deg))
    known = np.isfinite(node[..., 0]) & (facing > least)
    columns, rows = np.moveaxis(moved(grid.input_from_grid, node), 2, 0)
    whole = np.where(known, (columns, rows), NOWHERE).astype(np.float32)
    return whole[0], whole[1]


def _facing(grid: SurfaceGrid) -> FloatArray:
    """(n, m) cosine of the slant, evened out over neighbours so that its contours are smooth;
    continued outwards."""
    cosine = np.where(grid.inside, np.abs(surface_normals(grid.points_mm)[..., 2]), np.nan)[
        ..., None
    ]
    cosine = np.clip(np.nan_to_num(extrapolated(cosine, 4)[..., 0]), 0.0, 1.0).astype(np.float32)
    return np.asarray(cv2.GaussianBlur(cosine, (0, 0), 0.8))


# A field of the input, read at a print's pixels.


def resample(
    field: FloatArray, mask: BoolArray, pitch_mm: float, print_map: PrintMap
) -> tuple[FloatArray, FloatArray]:
    """Read `field` (H, W), ignored outside `mask`, on a print: values (h, w), and how much of a
    pixel is on the finger.

    `pitch_mm`: of the input. Where the print is coarser than the input, a Gaussian takes out what
    it cannot show.
    """
    mask = check_mask(mask, field.shape)
    step = MM_PER_INCH / print_map.ppi / pitch_mm
    rows, columns = bounding_box(mask, int(4 * step) + 2)
    inside = mask[rows, columns]
    # averaging whole blocks first costs a fraction and takes out next to nothing
    factor = max(1, int(step / 1.9))
    weight = bin_mean(inside.astype(np.float32), factor)
    values = bin_mean(np.where(inside, field[rows, columns], 0.0).astype(np.float32), factor)
    if step > 1.0:
        sigma = float(np.sqrt(max((0.5 * step) ** 2 - (factor**2 - 1) / 12, 0.01))) / factor
        weight = gaussian_mean(weight, sigma)
        values = gaussian_mean(values, sigma) / np.maximum(weight, 1e-3) * (weight > 1e-3)
    x = (print_map.columns - columns.start + 0.5) / factor - 0.5
    y = (print_map.rows - rows.start + 0.5) / factor - 0.5
    read, fraction = (
        sampled_at(part, x, y, cv2.INTER_CUBIC, outside=0.0) for part in (values, weight)
    )
    return read, np.clip(fraction, 0.0, 1.0)
