"""Where the pixels of a print lie in the image, and the other way round.

A map is made of a coarse grid of nodes whose places are known in the input and on the print, read
by cubic interpolation (Catmull and Rom 1974); its inverse is found by Newton's method and stored
densely. Points are (column, row), as everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import scipy
from numpy.polynomial.polynomial import polyder, polyval
from numpy.typing import NDArray

from splitknit.checks import check_mask
from splitknit.errors import require
from splitknit.finger.ridges import MM_PER_INCH, upright_from_print
from splitknit.imaging.band import bin_mean
from splitknit.imaging.geometry import bounding_box, gaussian_mean, sampled_at
from splitknit.model import Array, BoolArray, FloatArray
from splitknit_match.prints.parameters import (
    LARGEST_PX,
    MAP_STEP_MM,
    MARGIN_MM,
    NEWTON_STEPS,
    SIGMA_PX,
    SLANT_DEG,
)
from splitknit_match.prints.unroll import SurfaceGrid, Unrolled, extrapolated, moved, slant_cos

NOWHERE = -1e6
"""Where a print's pixel lies in the input if it shows nothing. Source: definition."""

# Smooth functions on coarse grids: read anywhere, read densely, and inverted.
#
# Source: E. Catmull and R. Rom 1974, A class of local interpolating splines: straight lines are
# read exactly.

_CATMULL_ROM = np.array([[0, -1, 2, -1], [2, 0, -5, 3], [0, 1, 4, -3], [0, 0, -1, 1]]) / 2
"""Weights of the four values around, as polynomials of the place between the middle two, constant
term first. Source: E. Catmull and R. Rom, 1974."""


def _dense(
    values: NDArray[Any], size: tuple[int, ...], step: float, *, linear: bool = False
) -> FloatArray:
    """Read a coarse grid, its first pixel two steps before the fine one's, at every pixel of a fine
    grid."""

    def interpolation(pixels: int, nodes: int) -> FloatArray:
        """(pixels, nodes) matrix that interpolates a line."""
        places = np.arange(pixels) / step + 2.0
        first = np.floor(places).astype(np.intp)
        rest = places - first
        weights = [0.0 * rest, 1.0 - rest, rest] if linear else polyval(rest, _CATMULL_ROM.T)
        matrix = np.zeros((pixels, nodes), dtype=np.float32)
        for k, weight in enumerate(weights):
            matrix[np.arange(pixels), np.clip(first + k - 1, 0, nodes - 1)] += weight
        return matrix

    down, across = map(interpolation, size, values.shape)
    return down @ values.astype(np.float32) @ across.T


def _cubic(values: Array, places: Array) -> tuple[Array, Array]:
    """Values (N, 2) of a grid (n, m, 2) at `places` (N, 2; column, row), and their slopes (N, 2,
    2); NaN outside."""
    n, m = values.shape[:2]
    result = np.full((len(places), 2), np.nan)
    slope = np.full((len(places), 2, 2), np.nan)
    good = ((places >= 1) & (places <= [m - 2, n - 2])).all(axis=1)
    where = places[good]
    first = np.minimum(np.floor(where).astype(np.intp), [m - 3, n - 3])
    rest = (where - first).T
    around = np.arange(-1, 3)
    # (N, 4, 4, 2)
    patch = values[
        (first[:, 1, None] + around)[:, :, None], (first[:, 0, None] + around)[:, None, :]
    ]
    across, down = polyval(rest, _CATMULL_ROM.T).swapaxes(0, 1)  # (4, N) each
    across_slope, down_slope = polyval(rest, polyder(_CATMULL_ROM.T)).swapaxes(0, 1)
    result[good] = np.einsum("nijk,jn,in->nk", patch, across, down)
    slope[good, :, 0] = np.einsum("nijk,jn,in->nk", patch, across_slope, down)
    slope[good, :, 1] = np.einsum("nijk,jn,in->nk", patch, across, down_slope)
    return result, slope


def _inverted(values: Array, targets: Array, start: Array) -> Array:
    """Places (N, 2) at which the grid has the values `targets`, by Newton steps from `start`; NaN
    where none is."""
    places = start.copy()
    for _ in range(NEWTON_STEPS):
        here, slope = _cubic(values, places)
        miss = targets - here
        determinant = slope[:, 0, 0] * slope[:, 1, 1] - slope[:, 0, 1] * slope[:, 1, 0]
        determinant = np.where(np.abs(determinant) > 1e-12, determinant, 1e-12)
        right = (miss[:, 0] * slope[:, 1, 1] - miss[:, 1] * slope[:, 0, 1]) / determinant
        down = (slope[:, 0, 0] * miss[:, 1] - slope[:, 1, 0] * miss[:, 0]) / determinant
        move = np.clip(np.stack([right, down], axis=1), -1.5, 1.5)
        done = np.abs(miss).max(axis=1, keepdims=True) <= 1e-5
        places = np.where(done, places, places + move)
    here, _ = _cubic(values, places)
    places[~(np.abs(here - targets).max(axis=1) < 1e-3)] = np.nan
    return places


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
        return _cubic(self.print_of_grid, moved(np.linalg.inv(self.input_from_grid), points))[0]

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


def unrolled_map(
    unrolled: Unrolled, kind: str, ppi: float = 500.0, slant_deg: float | None = SLANT_DEG
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
    low = flat[facing].min(axis=0) - MARGIN_MM
    high = flat[facing].max(axis=0) + MARGIN_MM
    size = _checked_size(*(int(np.ceil(length)) for length in (high - low)[::-1] * px_per_mm))
    # mirrored, as paper shows it
    print_of_grid = 0.5 * (np.array(size[::-1]) - 1) - (flat - 0.5 * (low + high)) * px_per_mm
    columns, rows = _dense_inverse(print_of_grid, grid, size, MAP_STEP_MM * px_per_mm, slant_deg)
    return PrintMap(kind, ppi, columns, rows, grid.input_from_grid, print_of_grid)


def _checked_size(rows: int, columns: int) -> tuple[int, int]:
    require(
        rows * columns <= LARGEST_PX,
        f"the print would have {rows} x {columns} pixels, more than any finger's; check the scale"
        " of its input.",
    )
    return rows, columns


def _check_ppi(ppi: float) -> None:
    require(
        np.isfinite(ppi) and 10 <= ppi <= 10_000,
        f"ppi must lie between 10 and 10000, but it is {ppi}.",
    )


def _dense_inverse(
    print_of_grid: Array,
    grid: SurfaceGrid,
    size: tuple[int, int],
    step: float,
    slant_deg: float | None,
) -> tuple[FloatArray, FloatArray]:
    """Columns and rows of the input for every pixel of the print."""
    lines = [np.arange(-2, int(np.ceil((n - 1) / step)) + 3) * step for n in size]
    coarse = np.stack(np.meshgrid(lines[1], lines[0]), axis=2)
    targets = coarse.reshape(-1, 2)
    near = np.isfinite(print_of_grid).all(axis=2)
    near &= cv2.dilate(grid.inside.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    _, nearest = scipy.spatial.cKDTree(print_of_grid[near]).query(targets)
    start = np.argwhere(near)[nearest, ::-1].astype(float)
    nodes = _inverted(print_of_grid, targets, start).reshape(coarse.shape)
    filled = extrapolated(nodes, 3)
    input_of_coarse = np.nan_to_num(moved(grid.input_from_grid, filled))
    trusted = _dense(np.isfinite(nodes[..., 0]), size, step, linear=True) > 0.999
    if slant_deg is not None:
        column, row = np.moveaxis(np.nan_to_num(nodes, nan=-1.0).astype(np.float32), 2, 0)
        cosine = cv2.remap(
            _facing(grid), column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        trusted &= _dense(cosine, size, step, linear=True) > np.float32(
            np.cos(np.deg2rad(slant_deg))
        )
    columns, rows = (
        np.where(trusted, _dense(part, size, step), NOWHERE).astype(np.float32)
        for part in np.moveaxis(input_of_coarse, 2, 0)
    )
    return columns, rows


def _facing(grid: SurfaceGrid) -> FloatArray:
    """(n, m) cosine of the slant, evened out over neighbours so that its contours are smooth;
    continued outwards."""
    cosine = np.where(grid.inside, slant_cos(grid.points_mm), np.nan)[..., None]
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
        sigma = float(np.sqrt(max((SIGMA_PX * step) ** 2 - (factor**2 - 1) / 12, 0.01))) / factor
        weight = gaussian_mean(weight, sigma)
        values = gaussian_mean(values, sigma) / np.maximum(weight, 1e-3) * (weight > 1e-3)
    x = (print_map.columns - columns.start + 0.5) / factor - 0.5
    y = (print_map.rows - rows.start + 0.5) / factor - 0.5
    read, fraction = (
        sampled_at(part, x, y, cv2.INTER_CUBIC, outside=0.0) for part in (values, weight)
    )
    return read, np.clip(fraction, 0.0, 1.0)
