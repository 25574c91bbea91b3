"""Local comparison of two ridge bands that lie about on each other: patches, each with its own small shift.

Patches lie on a grid on B. The warped A is searched around each; a shift counts only as far as the patches around agree
with it, because skin stretches smoothly, while ridges of different fingers fit better anywhere by chance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from splitknit.model import BoolArray, FloatArray

Affine = NDArray[np.float64]
"""(2, 3): place (column, row, 1) in B to place in A."""

_ONE_MAP = np.empty(0, dtype=np.float32)
"""In place of cv2.remap's second map, where columns and rows are together in the first."""
_MIN_OVERLAP = 0.6
"""Fraction of a patch that must be valid on both sides."""
np.empty(1 << 21)
"""16 MB that are never touched, freed at once: from then on glibc keeps freed memory up to this size for the next pair
instead of returning it. Without it a pair spends half its time on the pages of its own arrays (no effect elsewhere)."""


def spectrum_of(values: NDArray[Any], size: tuple[int, int] | None = None) -> NDArray[np.complex64]:
    """Transform (..., rows, columns // 2 + 1) of the last two axes, over the root of their number.

    numpy's transforms load a fifth of a second sooner than scipy's; without a factor they run in double precision.
    """
    return np.asarray(np.fft.rfft2(values, s=size, norm="ortho"), dtype=np.complex64)


_SPAN_MM, _NEAR_MM = 5.0, 0.2
"""Affine fit: length over which a linear part of 1 is penalised, and residual at which a patch counts half."""


PATCH_MM, STEP_MM, SEARCH_MM = 2.4, 1.6, 0.4
"""Side of a patch, distance between the middles of two, and largest shift of one along either axis."""


@dataclass(frozen=True, slots=True, eq=False)
class PatchGrid:
    """The patches of B with their spectra."""

    rows: NDArray[np.int64]
    """(P,) first row of each."""
    columns: NDArray[np.int64]
    """(P,) first column of each."""
    place: NDArray[np.int64]
    """(P, 2) place in the grid."""
    grid: tuple[int, int]
    """Rows and columns of the grid of patches."""
    first: tuple[int, int]
    """Row and column at which the grid begins."""
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


@dataclass(frozen=True, slots=True, eq=False)
class Agreement:
    """Shifts and correlations of the patches."""

    used: NDArray[np.int64]
    """(N,) numbers of the patches that lie on both."""
    correlation: FloatArray
    """(N,) at the supported shift, -1 to 1."""
    shift: NDArray[np.float64]
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


def patch_grid(
    value: FloatArray, valid: BoolArray, pitch_mm: float, step_mm: float = STEP_MM, search_mm: float = SEARCH_MM
) -> PatchGrid:
    """Cut the band (H, W) into patches; those with too little valid skin are left out."""
    side = max(4, round(PATCH_MM / pitch_mm))
    step = max(1, round(step_mm / pitch_mm))
    reach = max(1, round(search_mm / pitch_mm))
    shape = value.shape
    starts = [_starts(length, side, step) for length in shape]
    rows, columns = (part.ravel() for part in np.meshgrid(*starts, indexing="ij"))
    places = np.stack([part.ravel() for part in np.meshgrid(*(np.arange(len(s)) for s in starts), indexing="ij")], 1)
    padded = np.zeros((max(shape[0], side), max(shape[1], side)), dtype=np.float32)
    padded[: shape[0], : shape[1]] = value
    known = np.zeros(padded.shape, dtype=np.uint8)
    known[: shape[0], : shape[1]] = valid
    fraction = _sums(known, side)[rows, columns] / (side * side)
    kept = fraction >= _MIN_OVERLAP
    rows, columns, places, fraction = rows[kept], columns[kept], places[kept], fraction[kept]
    patches = sliding_window_view(padded, (side, side))[rows, columns]
    window = side + 2 * reach
    return PatchGrid(
        rows=rows,
        columns=columns,
        place=places,
        grid=(len(starts[0]), len(starts[1])),
        first=(int(starts[0][0]), int(starts[1][0])),
        step=step,
        spectrum=(window * window) * spectrum_of(patches, (window, window)).conj(),
        side=side,
        reach=reach,
        pitch_mm=pitch_mm,
        energy=(patches * patches).sum(axis=(1, 2)),
        fraction=fraction,
    )


def compare_patches(
    patches: PatchGrid, a_value: FloatArray, a_valid: BoolArray, b_from: Affine, bend: FloatArray | None = None
) -> Agreement:
    """Lay A (H, W) on B's patches by `b_from`, bent by what :func:`bent` adds, and search around each."""
    reach, side = patches.reach, patches.side
    if not len(patches.rows):
        return _nothing()
    bottom, right = int(patches.rows.max()) + side + 2 * reach, int(patches.columns.max()) + side + 2 * reach
    moved = b_from.copy()
    moved[:, 2] -= b_from[:, :2] @ np.array([reach, reach])  # a border of the search's reach around B
    if bend is None:
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        value = cv2.warpAffine(a_value, moved, (right, bottom), flags=flags)
        nearest = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
        valid = cv2.warpAffine(a_valid.view(np.uint8), moved, (right, bottom), flags=nearest)
    else:
        there = bent_places(patches, (bottom, right), moved, bend, reach)
        value = cv2.remap(a_value, there, _ONE_MAP, cv2.INTER_LINEAR)
        valid = cv2.remap(a_valid.view(np.uint8), there, _ONE_MAP, cv2.INTER_NEAREST)
    fraction = _sums(valid, side) / (side * side)
    seen = np.minimum(fraction[patches.rows + reach, patches.columns + reach], patches.fraction)
    used = np.flatnonzero(seen >= _MIN_OVERLAP)
    if not len(used):
        return _nothing()
    rows, columns = patches.rows[used], patches.columns[used]
    window = side + 2 * reach
    parts = sliding_window_view(value, (window, window))[rows, columns]
    count = 2 * reach + 1
    product = spectrum_of(parts)
    product *= patches.spectrum if len(used) == len(patches.rows) else patches.spectrum[used]
    # of the window only the first shifts are wanted: rows first, then these alone
    surface = np.fft.irfft(np.fft.ifft(product, axis=1)[:, :count], n=window, axis=2)[:, :, :count]
    energy = _sums(value * value, side)
    around = sliding_window_view(energy, (count, count))[rows, columns]
    floor = 0.05 * side * side
    surface = surface / np.sqrt(np.maximum(around, floor) * np.maximum(patches.energy[used], floor)[:, None, None])
    support = _supported(surface, patches.place[used], patches.grid, seen[used])
    shift, correlation = _peak(support, surface)
    return Agreement(used, correlation, shift, seen[used].astype(np.float32))


def better_affine(patches: PatchGrid, agreement: Agreement, b_from: Affine) -> Affine:
    """Affine map that follows the patches' shifts, robustly; patches that correlate weakly count little."""
    weight = np.maximum(agreement.correlation - 0.2, 0.0) ** 2 * agreement.weight
    if int((weight > 0.01).sum()) < 6:
        return b_from
    middle = (patches.side - 1) / 2
    place = np.stack([patches.columns[agreement.used] + middle, patches.rows[agreement.used] + middle], axis=1)
    centre = place.mean(axis=0)
    span, near = _SPAN_MM / patches.pitch_mm, _NEAR_MM / patches.pitch_mm
    design = np.column_stack([(place - centre) / span, np.ones(len(place))])
    robust = weight.astype(float)
    solution: NDArray[np.float64] = np.zeros((3, 2))
    # the linear part is held back: a few patches must not shear the finger
    hold = np.diag([0.09, 0.09, 0.0])
    for _ in range(4):
        weighted = design.T * robust
        solution = np.linalg.solve(weighted @ design + robust.sum() * hold, weighted @ agreement.shift)
        miss = np.linalg.norm(design @ solution - agreement.shift, axis=1)
        robust = weight / (1.0 + (miss / near) ** 2)
    # A's content must move by s(p): B's place p then shows A at b_from(p - s(p))
    linear = solution[:2].T / span
    offset = solution[2] - linear @ centre
    back = np.eye(2) - linear
    return np.hstack([b_from[:, :2] @ back, (b_from[:, 2] - b_from[:, :2] @ offset)[:, None]])


_SMOOTH = 1.0
"""Sigma, in steps of the grid, over which shifts are averaged: skin stretches smoothly."""
_STILL = 0.05
"""Weight of no shift among them."""


def bent(patches: PatchGrid, agreement: Agreement, bend: FloatArray | None = None) -> FloatArray:
    """Smooth shifts (rows, columns, 2) of the grid's patches, columns and rows in pixels, added to those before.

    Patches that correlate weakly count little; where none is near, the shift fades out.
    """
    weight = np.maximum(agreement.correlation - 0.2, 0) ** 2 * agreement.weight
    step = _smoothed(patches.grid, patches.place[agreement.used], agreement.shift, weight)
    return step if bend is None else bend + step


def bent_by(patches: PatchGrid, place: NDArray[np.float64], shift: NDArray[np.float64]) -> FloatArray:
    """The same from shifts (N, 2) of places (N, 2): columns and rows of B."""
    grid = (place - (np.array(patches.first[::-1]) + (patches.side - 1) / 2)) / patches.step
    near = np.clip(np.rint(grid[:, ::-1]).astype(np.int64), 0, np.array(patches.grid) - 1)
    return _smoothed(patches.grid, near, shift, np.full(len(place), 0.16, dtype=np.float32))


def _smoothed(
    grid: tuple[int, int], place: NDArray[np.int64], shift: NDArray[np.float64], weight: FloatArray
) -> FloatArray:
    board = np.zeros((*grid, 3), dtype=np.float32)
    np.add.at(board, (place[:, 0], place[:, 1]), np.column_stack([shift * weight[:, None], weight]).astype(np.float32))
    board = np.asarray(cv2.GaussianBlur(board, (0, 0), _SMOOTH, borderType=cv2.BORDER_CONSTANT))
    return board[..., :2] / (board[..., 2:] + (_STILL * 0.16))


def bent_places(
    patches: PatchGrid, size: tuple[int, int], b_from: Affine, bend: FloatArray | None, border: int = 0
) -> FloatArray:
    """(*size, 2) column and row in A of each pixel of B, which begins `border` pixels inside."""
    places = np.empty((*size, 2), dtype=np.float32)
    places[..., 0] = np.arange(size[1])
    places[..., 1] = np.arange(size[0])[:, None]
    if bend is not None:
        middle = [first + (patches.side - 1) / 2 + border for first in patches.first]
        scale = 1 / patches.step
        to_grid = np.array([[scale, 0, -middle[1] * scale], [0, scale, -middle[0] * scale]])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        places -= cv2.warpAffine(bend, to_grid, size[::-1], flags=flags, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(cv2.transform(places, b_from))


def shown_in_a(patches: PatchGrid, b_from: Affine, bend: FloatArray, place: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N, 2) column and row in A of places (N, 2) in B."""
    grid = (place - (np.array(patches.first[::-1]) + (patches.side - 1) / 2)) / patches.step
    near = np.clip(np.rint(grid).astype(np.int64), 0, np.array(bend.shape[1::-1]) - 1)
    return (place - bend[near[:, 1], near[:, 0]]) @ b_from[:, :2].T + b_from[:, 2]


def overlap_correlation(
    patches: PatchGrid, a: tuple[FloatArray, BoolArray], b: tuple[FloatArray, BoolArray], b_from: Affine,
    bend: FloatArray | None = None,
) -> tuple[float, float]:  # fmt: skip
    """Correlation of all that both show where A, bent, is laid on B, without any further search; and its area, mm2.

    `a`, `b`: band (H, W) and where it is valid.
    """
    there = bent_places(patches, (b[1].shape[0], b[1].shape[1]), b_from, bend)
    both = (cv2.remap(a[1].view(np.uint8), there, _ONE_MAP, cv2.INTER_NEAREST) > 0) & b[1]
    one, other = cv2.remap(a[0], there, _ONE_MAP, cv2.INTER_LINEAR)[both], b[0][both]
    power = float(one @ one) * float(other @ other)
    return float(one @ other) / max(power, 1e-12) ** 0.5, float(both.sum()) * patches.pitch_mm**2


def rigid(
    a_shape: tuple[int, int], b_shape: tuple[int, int], angle_rad: float, shift_px: tuple[float, float]
) -> Affine:
    """B's place to A's, when A is turned counter-clockwise about its middle and its middle put beside B's.

    `shift_px` : columns, rows from B's middle to A's.
    """
    a = np.array([(a_shape[1] - 1) / 2, (a_shape[0] - 1) / 2])
    b = np.array([(b_shape[1] - 1) / 2, (b_shape[0] - 1) / 2]) + np.asarray(shift_px)
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    turn = np.array([[cos, -sin], [sin, cos]])
    return np.hstack([turn, (a - turn @ b)[:, None]])


def _starts(length: int, side: int, step: int) -> NDArray[np.int64]:
    """First pixels of patches, centred on the length."""
    count = max(1, (length - side) // step + 1)
    left = max(0, (length - side - (count - 1) * step) // 2)
    return left + step * np.arange(count, dtype=np.int64)


def _supported(surface: FloatArray, place: NDArray[np.int64], grid: tuple[int, int], weight: FloatArray) -> FloatArray:
    """Correlation of each patch and, half as much, of its eight neighbours, for each shift."""
    count = surface.shape[1]
    board = np.zeros((grid[0] + 2, grid[1] + 2, count, count), dtype=np.float32)
    board[place[:, 0] + 1, place[:, 1] + 1] = surface * weight[:, None, None]
    lines = board[:-2] + 2 * board[1:-1] + board[2:]
    total = lines[:, :-2] + 2 * lines[:, 1:-1] + lines[:, 2:]
    return np.asarray(total[place[:, 0], place[:, 1]])


def _peak(support: FloatArray, surface: FloatArray) -> tuple[NDArray[np.float64], FloatArray]:
    """Shift (columns, rows) of the best support, to a fraction of a pixel, and the own correlation there."""
    count = surface.shape[1]
    supports, own = (np.ascontiguousarray(part).reshape(-1) for part in (support, surface))
    middle = support.reshape(len(surface), -1).argmax(axis=1)
    row, column = np.divmod(middle, count)
    middle += np.arange(0, own.size, count * count)
    here, best = supports[middle], own[middle].astype(float)
    middle_own = best.copy()
    shift = np.stack([column, row], axis=1) - np.float64(count // 2)
    for axis, (at, step) in enumerate(((column, 1), (row, count))):
        inner = (at > 0) & (at < count - 1)
        beside = inner * step
        low, high = supports[middle - beside], supports[middle + beside]
        bend = low - 2 * here + high
        peaked = inner & (bend < 0)
        fraction = np.zeros(len(bend))
        np.divide(0.5 * (low - high), bend, out=fraction, where=peaked)
        np.clip(fraction, -0.5, 0.5, out=fraction)
        shift[:, axis] += fraction
        before, after = own[middle - beside], own[middle + beside]
        best += 0.5 * fraction * (after - before) + 0.5 * fraction**2 * (before - 2 * middle_own + after)
    # the search moved B's patch over A's content: A must move the other way
    return -shift, np.clip(best, -1.0, 1.0).astype(np.float32)


def _sums(image: NDArray[Any], side: int) -> FloatArray:
    """Sum over the square of `side` pixels that begins at each pixel."""
    total = cv2.boxFilter(
        image, cv2.CV_32F, (side, side), anchor=(0, 0), normalize=False, borderType=cv2.BORDER_CONSTANT
    )
    return np.asarray(total, dtype=np.float32)


def _nothing() -> Agreement:
    none = np.zeros(0, dtype=np.float32)
    return Agreement(np.zeros(0, dtype=np.int64), none, np.zeros((0, 2)), none)
