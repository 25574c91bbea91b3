"""Outlines of a view's mask: where each row across the finger enters and leaves it, on the finger
plane, in mm."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from splitknit.errors import require
from splitknit.imaging.geometry import bounding_box
from splitknit.imaging.robust import robust_line
from splitknit.imaging.view import pixels_of, plane_points
from splitknit.mirrors.reflection import Touching, touching
from splitknit.model import Array, BoolArray, Camera, FloatArray, Mirror


@dataclass(frozen=True, slots=True, eq=False)
class OutlineRows:
    """A view's outline, row by row across an axis of the picture."""

    axis: Array  # (2,) unit vector on the finger plane along which rows follow each other
    along_mm: Array  # (n,) place of each row on the axis, growing
    # (n,) where the row enters the finger, towards the right; NaN where it does not or is cut
    left_mm: Array
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
        """Position of the fingertip on the axis: the square of the width, extrapolated to zero."""
        last = np.flatnonzero(np.isfinite(self.width_mm))[-6:]
        squared = self.width_mm[last] ** 2
        slope, level = np.polyfit(self.along_mm[last] - self.along_mm[last[-1]], squared, 1)
        step = self.along_mm[1] - self.along_mm[0]
        ahead = -level / slope if slope < 0 else 0.5 * step
        return float(self.along_mm[last[-1]] + np.clip(ahead, 0.0, 2.0 * step))

    def beyond(self, start_mm: float) -> OutlineRows:
        """The rows from `start_mm` on."""
        kept = self.along_mm >= start_mm
        return OutlineRows(self.axis, self.along_mm[kept], self.left_mm[kept], self.right_mm[kept])

    def edge(self, side: str) -> Array:
        """(n,) of the side ``left`` or ``right``."""
        return self.left_mm if side == "left" else self.right_mm

    def lower_part(self) -> slice:
        """Rows along the pad, where its outline bulges: not the base, nor the tip."""
        known = np.flatnonzero(np.isfinite(self.left_mm) | np.isfinite(self.right_mm))
        length = known[-1] - known[0]
        return slice(int(known[0] + 0.1 * length), int(known[0] + 0.6 * length))

    def places(self, side: str) -> tuple[Array, Array, Array]:
        """Of one side: `places_mm` on the finger plane, directions `along` it and `outward`, off
        the finger, (m, 2) each."""
        edge = self.edge(side)
        row = np.flatnonzero(np.isfinite(edge))
        if row.size < 3:
            return np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 2))
        slope = np.gradient(_smooth(edge[row]), self.along_mm[row])
        places = np.outer(self.along_mm[row], self.axis) + np.outer(edge[row], self.across)
        along = self.axis + np.outer(slope, self.across)
        outward = np.tile(self.across * (-1.0 if side == "left" else 1.0), (row.size, 1))
        return places, along, outward


ROW_MM = 0.15
"""Distance of the rows in which the outlines are measured. Range: 0.075 to 0.3
(validation/parameters)."""


def rows_of(
    mask: BoolArray, camera: Camera, binning: int, axis: Array, *, trust_ends: bool = False
) -> OutlineRows:
    """Measure the outline of `mask` (h, w) of one view, in blocks of `binning` pixels a side of the
    camera's image. `axis`: (2,) direction on the finger plane from row to row, towards the
    fingertip; `trust_ends`: keep what looks like the straight end of a cut finger. Raises BadInput
    if the mask is empty.
    """
    require(mask.any(), "a view of the finger is empty.")
    axis = axis / float(np.hypot(*axis))
    across = np.array([axis[1], -axis[0]])
    box = bounding_box(mask)
    low = np.array([box[1].start, box[0].start]) - 2
    high = np.array([box[1].stop, box[0].stop]) + 2
    corners = np.array([low, (high[0], low[1]), high, (low[0], high[1])], dtype=np.float64)
    on_plane = plane_points(camera, corners * binning + 0.5 * (binning - 1))
    p = on_plane @ axis
    q = on_plane @ across
    pitch = binning / camera.px_per_mm
    along = np.arange(p.min(), p.max() + ROW_MM, ROW_MM)
    side = np.arange(q.min() - 2 * pitch, q.max() + 3 * pitch, pitch)
    part = np.pad(mask, 3)[low[1] + 3 : high[1] + 4, low[0] + 3 : high[0] + 4].astype(np.float32)
    smooth = cv2.GaussianBlur(part, (0, 0), 1.2)
    p, q = (places.ravel() for places in np.meshgrid(along, side, indexing="ij"))
    full = pixels_of(camera, np.outer(p, axis) + np.outer(q, across))
    where = ((full - 0.5 * (binning - 1)) / binning - low).astype(np.float32)
    columns, rows = where.reshape(along.size, side.size, 2).transpose(2, 0, 1)
    left, right = _edges(np.asarray(cv2.remap(smooth, columns, rows, cv2.INTER_LINEAR)), side)
    outline = OutlineRows(axis, along, left, right)
    return _without_cuts(outline, mask.shape, camera, binning, trust_ends=trust_ends)


def touching_planes(rows: OutlineRows, camera: Camera) -> Touching:
    """Planes that touch the finger along both sides of a view's outline."""
    # every second row gives one point of the fit
    left, right = (
        touching(camera, *(part[::2] for part in rows.places(side))) for side in ("left", "right")
    )
    return Touching(*map(np.concatenate, zip(left, right, strict=True)))


def medial_line(rows: OutlineRows) -> tuple[float, float]:
    """Slope (to the right, per mm along the axis) and offset in mm of the straight line through the
    rows' middles, by Tukey's biweight, over rows of full width, so that tip and base do not turn
    it. Source: the thesis, sections 3.3.1.1 and 3.3.2.3, step 3; reading notes 2.
    """
    width = rows.width_mm
    known = np.isfinite(width)
    require(int(known.sum()) >= 8, "a view of the finger is too small to show how it lies.")
    wide = known & (width > 0.8 * np.nanquantile(width, 0.9))
    middle = 0.5 * (rows.left_mm + rows.right_mm)[wide]
    return robust_line(rows.along_mm[wide], middle, 1e-3)


def pad_side(mirror: Mirror, rows: OutlineRows) -> str:
    """The side of the rows on which a mirror shows the pad: away from the direct view."""
    return "left" if float(mirror.normal[:2] @ rows.across) > 0 else "right"


def is_cut(rows: OutlineRows, side: str) -> bool:
    """Whether a view ends at its mirror's edge rather than at the pad on that `side`: its outline
    is a straight line, or missing.
    """
    part = rows.lower_part()
    along = rows.along_mm[part]
    edge = rows.edge(side)[part]
    known = np.isfinite(edge)
    if float(known.mean()) < 0.6:
        return True
    line = np.polyfit(along[known], edge[known], 1)
    # rms below which an outline is a mirror's edge: pads bulge
    return bool(float(np.std(edge[known] - np.polyval(line, along[known]))) < 0.012)


def finger_axis(
    mask: BoolArray, camera: Camera, binning: int, hint: Array
) -> tuple[Array, OutlineRows]:
    """Direction (2,) of the finger towards its tip, within about 75 deg of `hint` (2,), and its
    outline across it."""
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


def _edges(field: FloatArray, side: Array) -> tuple[Array, Array]:
    """Where each row first and last crosses one half."""
    inside = field > 0.5
    row = np.flatnonzero(inside.any(axis=1) & ~inside[:, 0] & ~inside[:, -1])
    first = np.argmax(inside[row], axis=1)
    last = field.shape[1] - 1 - np.argmax(inside[row, ::-1], axis=1)
    step = side[1] - side[0]
    left = np.full(len(field), np.nan)
    right = np.full(len(field), np.nan)
    outer = field[row, first - 1].astype(np.float64)
    inner = field[row, first].astype(np.float64)
    left[row] = side[first - 1] + step * (0.5 - outer) / (inner - outer)
    inner = field[row, last].astype(np.float64)
    outer = field[row, last + 1].astype(np.float64)
    right[row] = side[last] + step * (inner - 0.5) / (inner - outer)
    return left, right


def _without_cuts(
    rows: OutlineRows, shape: tuple[int, ...], camera: Camera, binning: int, *, trust_ends: bool
) -> OutlineRows:
    """The outline without its parts at the image's border, and without the straight end at the
    finger's base."""
    known = np.flatnonzero(np.isfinite(rows.width_mm))
    if known.size == 0:
        return rows
    middle = 0.5 * (rows.along_mm[known[0]] + rows.along_mm[known[-1]])
    edges = [rows.left_mm.copy(), rows.right_mm.copy()]
    for edge in edges:
        row = np.flatnonzero(np.isfinite(edge))
        along = rows.along_mm[row]
        places = np.outer(along, rows.axis) + np.outer(edge[row], rows.across)
        pixel = pixels_of(camera, places) / binning
        last = np.array([shape[1], shape[0]]) - 1 - 3.0  # px from the image's border
        cut = np.any((pixel < 3.0) | (pixel > last), axis=1)
        if not trust_ends and row.size > 4:
            low = along < middle
            steep = np.flatnonzero((np.abs(np.gradient(edge[row], along)) > 1.2) & low)
            if steep.size:
                cut[: steep[-1] + 3] |= low[: steep[-1] + 3]
            cut[:2] = True
        edge[row[cut]] = np.nan
    return replace(rows, left_mm=edges[0], right_mm=edges[1])


def _smooth(values: Array) -> Array:
    """Values smoothed over a few neighbours, for their slopes."""
    kernel = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16.0
    padded = np.pad(values, 2, mode="reflect", reflect_type="odd")
    return np.convolve(padded, kernel, mode="valid")
