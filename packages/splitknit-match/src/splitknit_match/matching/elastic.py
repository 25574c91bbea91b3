"""Local comparison of two ridge bands that lie about on each other: patches, each with its own
small shift.

Patches lie on a grid on B. The warped A is searched around each; a shift counts only as far as the
patches around agree with it, because skin stretches smoothly, while ridges of different fingers fit
better anywhere by chance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from splitknit.model import Array, FloatArray
from splitknit_match.matching.ridge_band import RidgeBand

Affine = Array
"""(2, 3): position (column, row, 1) in B to position in A."""
Indices = NDArray[np.int64]
Positions = FloatArray
"""(N, 2) columns and rows."""

_ONE_MAP = np.empty(0, dtype=np.float32)
"""In place of cv2.remap's second map, where columns and rows are together in the first. Source:
definition."""
np.empty(1 << 21)
"""16 MB that are never touched, freed at once: from then on glibc keeps freed memory up to this
size for the next pair instead of returning it. Without it a pair spends half its time on the pages
of its own arrays (no effect elsewhere)."""


def spectrum_of(values: NDArray[Any], size: tuple[int, int] | None = None) -> NDArray[np.complex64]:
    """Transform (..., rows, columns // 2 + 1) of the last two axes, over the root of their number.

    numpy's transforms load a fifth of a second sooner than scipy's; without a factor they run in
    double precision.
    """
    return np.asarray(np.fft.rfft2(values, s=size, norm="ortho"), dtype=np.complex64)


@dataclass(frozen=True, slots=True, eq=False)
class PatchGrid:
    """The patches of B with their spectra."""

    cell: Indices
    """(P, 2) row and column of each patch in the grid."""
    corner: Indices
    """(P, 2) its first row and column in B."""
    grid: tuple[int, int]
    """Rows and columns of the grid of patches."""
    origin: Positions
    """(2,) column and row of the centre of the grid's first patch."""
    step: int
    """Pixels from patch to patch."""
    spectrum: NDArray[np.complex64]
    """(P, window, window // 2 + 1), conjugate, times the number of pixels of the window."""
    side: int
    reach: int
    """Pixels."""
    pitch_mm: float
    energy: FloatArray
    """(P,) sum of squares."""
    fraction: FloatArray
    """(P,) that is valid."""

    @property
    def centres(self) -> Positions:
        """(P, 2) columns and rows in B."""
        return self.corner[:, ::-1] + (self.side - 1) / 2

    @property
    def every_centre(self) -> Positions:
        """(rows * columns, 2) columns and rows in B of the whole grid's patches."""
        return self.origin + self.step * np.indices(self.grid)[::-1].reshape(2, -1).T

    def nearest(self, positions: Positions) -> tuple[Indices, ...]:
        """Rows (N,) and columns (N,) of the grid's cells nearest to positions (N, 2) in B."""
        cells = np.rint((positions - self.origin) / self.step)[:, ::-1].astype(np.int64)
        return tuple(np.clip(cells, 0, np.array(self.grid) - 1).T)


MIN_CORRELATION = 0.2  # patches that correlate less do not count in a fit


@dataclass(frozen=True, slots=True, eq=False)
class Agreement:
    """Shifts and correlations of the patches."""

    used: Indices
    """(N,) numbers of the patches that lie on both."""
    correlation: FloatArray
    """(N,) at the supported shift, -1 to 1."""
    shift: Positions
    """(N, 2) columns and rows by which A's content must still move."""
    weight: FloatArray
    """(N,) valid fraction of both."""

    @property
    def mean(self) -> float:
        """Mean correlation; 0 where nothing overlaps."""
        return float(np.average(self.correlation, weights=self.weight)) if len(self.used) else 0.0

    @property
    def evidence(self) -> float:
        """By which alignments are chosen."""
        return self.mean * float(np.sqrt(len(self.used)))

    @property
    def firmness(self) -> FloatArray:
        """(N,) weight of each shift in a fit."""
        return np.asarray(np.maximum(self.correlation - MIN_CORRELATION, 0.0) ** 2 * self.weight)


_PATCH_MM = 2.4
"""Side of a patch; 1.8 to 3.0 do as well (photographs against simulated presses;
docs/explain/tried.md)."""
STEP_MM = 1.6  # distance between the centres of two patches
_SEARCH_MM = 0.4
"""Largest shift of a patch along either axis; up to 0.7 does as well (photographs against
simulated presses; docs/explain/tried.md)."""
_MIN_OVERLAP = 0.6  # fraction of a patch that must be valid on both sides


def patch_grid(
    band: RidgeBand, step_mm: float = STEP_MM, search_mm: float = _SEARCH_MM
) -> PatchGrid:
    """Cut the band (H, W) into patches; those with too little valid skin are left out."""
    side = max(4, round(_PATCH_MM / band.pitch_mm))
    step = max(1, round(step_mm / band.pitch_mm))
    reach = max(1, round(search_mm / band.pitch_mm))
    spare = np.array(band.value.shape) - side
    grid = np.maximum(1, spare // step + 1)
    first = np.maximum(0, (spare - (grid - 1) * step) // 2)
    cell = np.indices(grid).reshape(2, -1).T
    corner = first + step * cell
    border = [(0, max(0, -int(missing))) for missing in spare]
    fraction = _sums(np.pad(band.valid.view(np.uint8), border), side)[tuple(corner.T)] / (
        side * side
    )
    kept = fraction >= _MIN_OVERLAP
    patches = sliding_window_view(np.pad(band.value, border), (side, side))[tuple(corner[kept].T)]
    window = side + 2 * reach
    return PatchGrid(
        cell=cell[kept],
        corner=corner[kept],
        grid=(int(grid[0]), int(grid[1])),
        origin=first[::-1] + (side - 1) / 2,
        step=step,
        spectrum=(window * window) * spectrum_of(patches, (window, window)).conj(),
        side=side,
        reach=reach,
        pitch_mm=band.pitch_mm,
        energy=(patches * patches).sum(axis=(1, 2)),
        fraction=fraction[kept],
    )


def compare_patches(
    patches: PatchGrid, a: RidgeBand, b_from: Affine, bend: FloatArray | None = None
) -> Agreement:
    """Lay A (H, W) on B's patches by `b_from`, bent by what :func:`bent` adds, and search around
    each."""
    side, reach = patches.side, patches.reach
    window = side + 2 * reach
    height, width = (patches.corner.max(axis=0, initial=0) + window).tolist()
    moved = b_from.copy()
    # a border of the search's reach around B
    moved[:, 2] -= b_from[:, :2] @ np.array([reach, reach])
    if bend is None:
        inverse = cv2.WARP_INVERSE_MAP
        value = cv2.warpAffine(a.value, moved, (width, height), flags=cv2.INTER_LINEAR | inverse)
        valid = cv2.warpAffine(
            a.valid.view(np.uint8), moved, (width, height), flags=cv2.INTER_NEAREST | inverse
        )
    else:
        source = bent_places(patches, (height, width), moved, bend, reach)
        value = cv2.remap(a.value, source, _ONE_MAP, cv2.INTER_LINEAR)
        valid = cv2.remap(a.valid.view(np.uint8), source, _ONE_MAP, cv2.INTER_NEAREST)
    fraction = _sums(valid, side) / (side * side)
    common = np.minimum(fraction[tuple((patches.corner + reach).T)], patches.fraction)
    used = np.flatnonzero(common >= _MIN_OVERLAP)
    if not len(used):
        none = np.zeros(0, dtype=np.float32)
        return Agreement(used, none, np.zeros((0, 2)), none)
    corner = tuple(patches.corner[used].T)
    count = 2 * reach + 1
    product = spectrum_of(sliding_window_view(value, (window, window))[corner])
    product *= patches.spectrum[used]
    # of the window only the first shifts are wanted: rows first, then these alone
    surface = np.fft.irfft(np.fft.ifft(product, axis=1)[:, :count], n=window, axis=2)[:, :, :count]
    energy = sliding_window_view(_sums(value * value, side), (count, count))[corner]
    floor = 0.05 * side * side
    surface = surface / np.sqrt(
        np.maximum(energy, floor) * np.maximum(patches.energy[used], floor)[:, None, None]
    )
    support = _supported(surface, patches.cell[used], patches.grid, common[used])
    shift, correlation = _peak(support, surface)
    return Agreement(used, correlation, shift, common[used])


def better_affine(patches: PatchGrid, agreement: Agreement, b_from: Affine) -> Affine:
    """Affine map that follows the patches' shifts, robustly; patches that correlate weakly count
    little."""
    weight = agreement.firmness
    if int((weight > 0.01).sum()) < 6:
        return b_from
    position = patches.centres[agreement.used]
    centre = position.mean(axis=0)
    span = 5.0 / patches.pitch_mm  # affine fit: length over which a linear part of 1 is penalised
    near = 0.2 / patches.pitch_mm  # affine fit: residual at which a patch counts half
    design = np.column_stack([(position - centre) / span, np.ones(len(position))])
    robust = weight.astype(float)
    # the linear part is held back: a few patches must not shear the finger
    ridge_penalty = np.diag([0.09, 0.09, 0.0])
    for _ in range(4):
        weighted = design.T * robust
        solution = np.linalg.solve(
            weighted @ design + robust.sum() * ridge_penalty, weighted @ agreement.shift
        )
        residual = np.linalg.norm(design @ solution - agreement.shift, axis=1)
        robust = weight / (1.0 + (residual / near) ** 2)
    # A's content must move by s(p): B's position p then shows A at b_from(p - s(p))
    linear = solution[:2].T / span
    offset = solution[2] - linear @ centre
    return np.hstack(
        [b_from[:, :2] @ (np.eye(2) - linear), (b_from[:, 2] - b_from[:, :2] @ offset)[:, None]]
    )


def bent(patches: PatchGrid, agreement: Agreement, bend: FloatArray | None = None) -> FloatArray:
    """Smooth shifts (rows, columns, 2) of the grid's patches, columns and rows in pixels, added to
    those before.

    Patches that correlate weakly count little; where none is near, the shift fades out.
    """
    weight = agreement.firmness[:, None]
    shifts = np.hstack([agreement.shift * weight, weight]).astype(np.float32)
    total = np.zeros((*patches.grid, 3), dtype=np.float32)
    np.add.at(total, tuple(patches.cell[agreement.used].T), shifts)
    total = np.asarray(cv2.GaussianBlur(total, (0, 0), _SMOOTH, borderType=cv2.BORDER_CONSTANT))
    step = total[..., :2] / (total[..., 2:] + STILL)
    return step if bend is None else bend + step


_SMOOTH = 1.0
"""Sigma over which the shifts of patches are averaged, in steps of their grid: skin stretches
smoothly."""
STILL = 0.008  # weight of no shift; a patch whose correlation is 0.6 has 0.16


def bent_places(
    patches: PatchGrid, size: tuple[int, int], b_from: Affine, bend: FloatArray, border: int = 0
) -> FloatArray:
    """(*size, 2) column and row in A of each pixel of B, which begins `border` pixels inside."""
    places = np.empty((*size, 2), dtype=np.float32)
    places[..., 0] = np.arange(size[1])
    places[..., 1] = np.arange(size[0])[:, None]
    scale = 1 / patches.step
    to_grid = np.column_stack([scale * np.eye(2), -(patches.origin + border) * scale])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    places -= cv2.warpAffine(
        bend, to_grid, size[::-1], flags=flags, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(cv2.transform(places, b_from))


def shown_in_a(
    patches: PatchGrid, b_from: Affine, bend: FloatArray | None, position: Positions
) -> Positions:
    """(N, 2) column and row in A of positions (N, 2) in B."""
    if bend is not None:
        position = position - bend[patches.nearest(position)]
    return position @ b_from[:, :2].T + b_from[:, 2]


def overlap_correlation(
    patches: PatchGrid, a: RidgeBand, b: RidgeBand, b_from: Affine, bend: FloatArray
) -> tuple[float, float]:
    """Correlation of all that both show where A, bent, is laid on B, without any further search;
    and its area, mm2."""
    source = bent_places(patches, (b.valid.shape[0], b.valid.shape[1]), b_from, bend)
    common = (cv2.remap(a.valid.view(np.uint8), source, _ONE_MAP, cv2.INTER_NEAREST) > 0) & b.valid
    in_a = cv2.remap(a.value, source, _ONE_MAP, cv2.INTER_LINEAR)[common]
    in_b = b.value[common]
    power = float(in_a @ in_a) * float(in_b @ in_b)
    return float(in_a @ in_b) / max(power, 1e-12) ** 0.5, float(common.sum()) * patches.pitch_mm**2


def rigid(a: RidgeBand, b: RidgeBand, angle_rad: float, right_mm: float, down_mm: float) -> Affine:
    """B's position to A's, when A is turned counter-clockwise about its centre, which then lies so
    far from B's."""
    centre_a = (np.array(a.valid.shape[::-1]) - 1) / 2
    centre_b = (np.array(b.valid.shape[::-1]) - 1) / 2 + (
        right_mm / a.pitch_mm,
        down_mm / a.pitch_mm,
    )
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    turn = np.array([[cos, -sin], [sin, cos]])
    return np.hstack([turn, (centre_a - turn @ centre_b)[:, None]])


def _supported(
    surface: FloatArray, cell: Indices, grid: tuple[int, int], weight: FloatArray
) -> FloatArray:
    """Correlation of each patch and, half as much, of its eight neighbours, for each shift."""
    board = np.zeros((grid[0] + 2, grid[1] + 2, *surface.shape[1:]), dtype=np.float32)
    board[cell[:, 0] + 1, cell[:, 1] + 1] = surface * weight[:, None, None]
    lines = board[:-2] + 2 * board[1:-1] + board[2:]
    total = lines[:, :-2] + 2 * lines[:, 1:-1] + lines[:, 2:]
    return np.asarray(total[cell[:, 0], cell[:, 1]])


def _peak(support: FloatArray, surface: FloatArray) -> tuple[Positions, FloatArray]:
    """Shift (columns, rows) of the best support, by parabolas to a fraction of a pixel, and the
    correlation there."""
    count = surface.shape[1]
    best = support.reshape(len(support), -1).argmax(axis=1)
    row, column = np.divmod(best, count)
    best += np.arange(0, support.size, count * count)
    supports, correlations = support.ravel(), surface.ravel()
    shift = np.stack([column, row], axis=1) - np.float64(count // 2)
    top = correlations[best].astype(float)
    peak = top.copy()
    for axis, (place, stride) in enumerate(((column, 1), (row, count))):
        beside = ((place > 0) & (place < count - 1)) * stride  # 0 at the border: no parabola
        low, high = supports[best - beside], supports[best + beside]
        curvature = low - 2 * supports[best] + high
        fraction = np.zeros(len(best))
        np.divide(0.5 * (low - high), curvature, out=fraction, where=curvature < 0)
        fraction = np.clip(fraction, -0.5, 0.5)
        shift[:, axis] += fraction
        before, after = correlations[best - beside], correlations[best + beside]
        peak += 0.5 * fraction * (after - before) + 0.5 * fraction**2 * (before - 2 * top + after)
    # the search moved B's patch over A's content: A must move the other way
    return -shift, np.clip(peak, -1.0, 1.0).astype(np.float32)


def _sums(image: NDArray[Any], side: int) -> FloatArray:
    """Sum over the square of `side` pixels that begins at each pixel."""
    total = cv2.boxFilter(
        image,
        cv2.CV_32F,
        (side, side),
        anchor=(0, 0),
        normalize=False,
        borderType=cv2.BORDER_CONSTANT,
    )
    return np.asarray(total, dtype=np.float32)
