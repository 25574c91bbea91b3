"""Outlines of a view's mask: where each row across the finger enters and leaves it, on the finger plane, in mm."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from splitknit.errors import require
from splitknit.imaging.view import pixels_of, plane_points
from splitknit.mirrors.reflection import Touching, touching
from splitknit.mirrors.settings import ROW_MM
from splitknit.model import Array, BoolArray, Camera, FloatArray, Mirror

_EVERY = 2  # rows that are averaged to one point of an outline in the fit
STRAIGHT_MM, STRAIGHT_TIP_MM = 0.012, 0.05  # rms below which an outline is a mirror's edge: pads bulge, ends are round
BLUR_PX = 1.2  # a mask is smoothed by this much before its outline is measured between the pixels


@dataclass(frozen=True, slots=True, eq=False)
class OutlineRows:
    """A view's outline, row by row across an axis of the picture."""

    axis: Array  # (2,) unit vector on the finger plane along which rows follow each other
    along_mm: Array  # (n,) place of each row on the axis, growing
    left_mm: Array  # (n,) where the row enters the finger, towards the right; NaN where it does not or is cut
    right_mm: Array  # (n,) where it leaves

    @property
    def across(self) -> Array:
        """(2,) unit vector to the right of the axis."""
        return np.array([self.axis[1], -self.axis[0]])

    @property
    def width_mm(self) -> Array:
        """(n,) NaN where an edge is missing."""
        return self.right_mm - self.left_mm

    @property
    def tip_mm(self) -> float:
        """Where the finger ends on the axis: its width's square goes to zero there."""
        known = np.flatnonzero(np.isfinite(self.width_mm))
        last = known[-6:]
        squared = self.width_mm[last] ** 2
        slope, level = np.polyfit(self.along_mm[last] - self.along_mm[last[-1]], squared, 1)
        step = self.along_mm[1] - self.along_mm[0]
        ahead = -level / slope if slope < 0 else 0.5 * step
        return float(self.along_mm[last[-1]] + np.clip(ahead, 0.0, 2.0 * step))

    def beyond(self, start_mm: float) -> OutlineRows:
        """The rows from `start_mm` on."""
        kept = self.along_mm >= start_mm
        return OutlineRows(self.axis, self.along_mm[kept], self.left_mm[kept], self.right_mm[kept])

    def places(self, side: str) -> tuple[Array, Array, Array]:
        """Of one side: `places_mm` on the finger plane, `along` it and `outward`, off the finger, (m, 2) each."""
        edge = self.left_mm if side == "left" else self.right_mm
        row = np.flatnonzero(np.isfinite(edge))
        if row.size < 3:
            nothing = np.zeros((0, 2))
            return nothing, nothing, nothing
        slope = np.gradient(_smooth(edge[row]), self.along_mm[row])
        places = np.outer(self.along_mm[row], self.axis) + np.outer(edge[row], self.across)
        along = self.axis + np.outer(slope, self.across)
        outward = np.tile(self.across * (-1.0 if side == "left" else 1.0), (row.size, 1))
        return places, along, outward


def rows_of(mask: BoolArray, camera: Camera, binning: int, axis: Array, *, trust_ends: bool = False) -> OutlineRows:
    """Measure the outline of `mask` (h, w) of one view, in blocks of `binning` pixels a side of the camera's image.
    `axis`: (2,) direction on the finger plane from row to row, towards the fingertip; `trust_ends`: keep what looks
    like the straight end of a cut finger. Raises BadInput if the mask is empty.
    """
    require(mask.any(), "a view of the finger is empty.")
    axis = axis / float(np.hypot(*axis))
    across = np.array([axis[1], -axis[0]])
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    low, high = np.array([columns[0], rows[0]]) - 2, np.array([columns[-1], rows[-1]]) + 3
    corners = np.array([low, (high[0], low[1]), high, (low[0], high[1])], dtype=np.float64)
    on_plane = plane_points(camera, corners * binning + 0.5 * (binning - 1))
    p, q = on_plane @ axis, on_plane @ across
    pitch = binning / camera.px_per_mm
    along = np.arange(p.min(), p.max() + ROW_MM, ROW_MM)
    side = np.arange(q.min() - 2 * pitch, q.max() + 3 * pitch, pitch)
    part = np.pad(mask, 3)[low[1] + 3 : high[1] + 4, low[0] + 3 : high[0] + 4].astype(np.float32)
    smooth = np.asarray(cv2.GaussianBlur(part, (0, 0), BLUR_PX), dtype=part.dtype)
    field = _resampled(smooth, low, camera, binning, (along, side, axis, across))
    left, right = _edges(field, side)
    found = OutlineRows(axis, along, left, right)
    return _without_cuts(found, mask.shape, camera, binning, trust_ends=trust_ends)


def touching_planes(rows: OutlineRows, camera: Camera, sides: tuple[str, ...] = ("left", "right")) -> Touching:
    """Planes that touch the finger along these sides of a view's outline."""
    parts = [touching(camera, *(part[::_EVERY] for part in rows.places(side))) for side in sides]
    return Touching(*(np.concatenate([getattr(p, name) for p in parts]) for name in Touching.__dataclass_fields__))


def medial_line(rows: OutlineRows) -> tuple[float, float]:
    """Slope (to the right, per mm along the axis) and offset in mm of the straight line through the rows' middles, by
    Tukey's biweight, over rows of full width, so that tip and base do not turn it. Source: the thesis, sections 3.3.1.1
    and 3.3.2.3, step 3; reading notes 2.
    """
    width = rows.width_mm
    known = np.isfinite(width)
    require(int(known.sum()) >= 8, "a view of the finger is too small to show how it lies.")
    wide = known & (width > 0.8 * np.nanquantile(width, 0.9))
    y, middle = rows.along_mm[wide], 0.5 * (rows.left_mm + rows.right_mm)[wide]
    weight = np.ones_like(y)
    slope, offset = 0.0, float(np.median(middle))
    for _ in range(12):
        root = np.sqrt(weight)
        design = np.column_stack([y, np.ones_like(y)]) * root[:, None]
        slope, offset = (float(v) for v in np.linalg.lstsq(design, middle * root, rcond=None)[0])
        away = middle - slope * y - offset
        scale = max(1.4826 * float(np.median(np.abs(away))), 1e-3)
        weight = np.clip(1.0 - (away / (4.685 * scale)) ** 2, 0.0, None) ** 2
    return slope, offset


def pad_side(mirror: Mirror, rows: OutlineRows) -> str:
    """On which side of the rows a mirror shows the finger's pad: the one away from the finger."""
    return "left" if float(mirror.normal[:2] @ rows.across) > 0 else "right"


def is_cut(rows: OutlineRows, side: str, *, from_tip: bool = False) -> bool:
    """Whether a view ends at its mirror's edge rather than at the pad: its outline is a straight line, or not there.
    `side`: of the pad; `from_tip`: whether the rows run across the finger.
    """
    known = np.flatnonzero(np.isfinite(rows.left_mm) | np.isfinite(rows.right_mm))
    edge = rows.left_mm if side == "left" else rows.right_mm
    low, high = (0.3, 0.7) if from_tip else (0.1, 0.6)
    part = slice(*(int(known[0] + fraction * (known[-1] - known[0])) for fraction in (low, high)))
    along, edge = rows.along_mm[part], edge[part]
    there = np.isfinite(edge)
    if float(there.mean()) < 0.6:
        return True
    away = edge[there] - np.polyval(np.polyfit(along[there], edge[there], 1), along[there])
    return bool(float(np.std(away)) < (STRAIGHT_TIP_MM if from_tip else STRAIGHT_MM))


def finger_axis(mask: BoolArray, camera: Camera, binning: int, hint: Array) -> tuple[Array, OutlineRows]:
    """Direction (2,) of the finger towards its tip, within about 75 deg of `hint` (2,), and its outline across it."""
    axis = hint / float(np.hypot(*hint))
    rows = rows_of(mask, camera, binning, axis)
    for _ in range(4):
        slope, _ = medial_line(rows)
        axis = axis + slope * rows.across
        axis = axis / np.hypot(*axis)
        rows = rows_of(mask, camera, binning, axis)
        if abs(slope) < 2e-3:
            break
    return axis, rows


def _resampled(
    smooth: FloatArray, low: Array, camera: Camera, binning: int, grid: tuple[Array, Array, Array, Array]
) -> FloatArray:
    """(rows, places) of the smoothed mask on the rows across the axis."""
    along, side, axis, across = grid

    def pixels(p: Array, q: Array) -> Array:
        places = np.outer(p, axis) + np.outer(q, across)
        full = pixels_of(camera, np.column_stack([places, np.zeros(len(places))]))
        return (full - 0.5 * (binning - 1)) / binning - low

    if camera.model == "perspective" and camera.distortion and any(camera.distortion):
        p, q = (part.ravel() for part in np.meshgrid(along, side, indexing="ij"))
        where = pixels(p, q).reshape(along.size, side.size, 2).astype(np.float32)
        return np.asarray(cv2.remap(smooth, where[..., 0], where[..., 1], cv2.INTER_LINEAR))
    three = pixels(along[[0, 0, -1]], side[[0, -1, 0]])
    right = (three[1] - three[0]) / (side.size - 1)
    down = (three[2] - three[0]) / (along.size - 1)
    turn = np.column_stack([right, down, three[0]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(smooth, turn, (side.size, along.size), flags=flags))


def _edges(field: FloatArray, side: Array) -> tuple[Array, Array]:
    """Where each row first and last crosses one half."""
    inside = field > 0.5
    some = inside.any(axis=1)
    some &= ~inside[:, 0] & ~inside[:, -1]
    left, right = np.full(len(field), np.nan), np.full(len(field), np.nan)
    row = np.flatnonzero(some)
    first = np.argmax(inside[row], axis=1)
    last = field.shape[1] - 1 - np.argmax(inside[row, ::-1], axis=1)
    step = side[1] - side[0]
    before, at = field[row, first - 1].astype(np.float64), field[row, first].astype(np.float64)
    left[row] = side[first - 1] + step * (0.5 - before) / (at - before)
    at, after = field[row, last].astype(np.float64), field[row, last + 1].astype(np.float64)
    right[row] = side[last] + step * (at - 0.5) / (at - after)
    return left, right


def _without_cuts(
    rows: OutlineRows, shape: tuple[int, ...], camera: Camera, binning: int, *, trust_ends: bool
) -> OutlineRows:
    """The outline without its parts at the image's border, and without the straight end at the finger's base."""
    edges = [rows.left_mm.copy(), rows.right_mm.copy()]
    known = np.flatnonzero(np.isfinite(rows.width_mm))
    if known.size == 0:
        return rows
    middle = 0.5 * (rows.along_mm[known[0]] + rows.along_mm[known[-1]])
    for edge in edges:
        row = np.flatnonzero(np.isfinite(edge))
        places = np.outer(rows.along_mm[row], rows.axis) + np.outer(edge[row], rows.across)
        pixel = pixels_of(camera, np.column_stack([places, np.zeros(len(places))])) / binning
        margin = 3.0
        beyond = (pixel < margin) | (pixel > np.array([shape[1], shape[0]]) - 1 - margin)
        near = beyond[:, 0] | beyond[:, 1]
        if not trust_ends and row.size > 4:
            steep = np.abs(np.gradient(edge[row], rows.along_mm[row])) > 1.2
            low = rows.along_mm[row] < middle
            worst = np.flatnonzero(steep & low)
            if worst.size:
                near[: min(int(worst[-1]) + 3, row.size)] |= low[: min(int(worst[-1]) + 3, row.size)]
            near[:2] = True
        edge[row[near]] = np.nan
    return OutlineRows(rows.axis, rows.along_mm, edges[0], edges[1])


def _smooth(values: Array) -> Array:
    """Values smoothed over a few neighbours, for their slopes."""
    kernel = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16.0
    padded = np.concatenate([2 * values[0] - values[2:0:-1], values, 2 * values[-1] - values[-2:-4:-1]])
    return np.convolve(padded, kernel, mode="valid")
