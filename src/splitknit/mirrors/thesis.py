"""The thesis's way: lateral and frontal masks aligned row by row, one ellipse a row; mirrors at exactly 45 deg."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.imaging.view import view_of
from splitknit.mirrors.outline import Rows, medial_line
from splitknit.model import Camera, FloatArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Ellipses:
    """One ellipse for each row that both views have."""

    axis: Array
    """(2,) of the front view's medial line, towards the tip."""
    from_tip_mm: Array
    """(n,) distance of the rows from the tip, growing."""
    tip_mm: float
    """Where the tip lies on the axis."""
    middle_mm: Array
    """(n,) middle of the front view's row, to the right of the axis."""
    half_width_mm: Array
    """(n,) of the front view."""
    half_height_mm: Array
    """(n,) of the lateral view."""
    centre_mm: Array
    """(n,) height of the lateral view's middle, beside its medial line."""

    def heights(
        self, camera: Camera, rows: slice, columns: slice, binning: int = 1
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """x, y and z (h, w) of a window's pixels, or blocks of pixels, z NaN beside the ellipses."""
        view = view_of(camera, rows, columns, binning=binning)
        x, y = view.on_plane()
        shape = np.broadcast_shapes(x.shape, y.shape)
        x, y = np.broadcast_to(x, shape), np.broadcast_to(y, shape)
        p = self.axis[0] * x + self.axis[1] * y
        q = self.axis[1] * x - self.axis[0] * y
        back = self.tip_mm - p

        def at(values: Array) -> Array:
            return np.asarray(np.interp(back, self.from_tip_mm, values))

        place = (q - at(self.middle_mm)) / np.maximum(at(self.half_width_mm), 1e-9)
        z = at(self.centre_mm) + at(self.half_height_mm) * np.sqrt(np.clip(1.0 - place**2, 0.0, None))
        outside = (np.abs(place) > 1) | (back < self.from_tip_mm[0]) | (back > self.from_tip_mm[-1])
        z = np.where(outside, np.nan, z).astype(np.float32)
        return np.asarray(x), np.asarray(y), z


def ellipses(front: Rows, lateral: Rows, tip_is_outward: float) -> Ellipses:
    """Align the views as the thesis does, and pair their rows.

    Both medial lines are turned to one direction, both tips put into one row, and each row's half-widths become the
    half axes of an ellipse. Lengths agree already: a plane mirror does not change them.

    Parameters
    ----------
    front, lateral : outlines of the views across their own medial lines
    tip_is_outward : +1 where the pad is on the right of the lateral view's axis, -1 where it is on its left

    References
    ----------
    The thesis, section 3.3.2.3, steps 2 to 7.
    """
    parts = []
    for rows in (front, lateral):
        known = np.isfinite(rows.width_mm)
        require(int(known.sum()) >= 8, "a view of the finger is too small to tell how it lies.")
        back = (rows.tip_mm - rows.along_mm[known])[::-1]
        slope, offset = medial_line(rows)
        line = (slope * rows.along_mm + offset)[known][::-1]
        middle = 0.5 * (rows.left_mm + rows.right_mm)[known][::-1]
        parts.append((back, middle, line, 0.5 * rows.width_mm[known][::-1]))
    (back, middle, _, half), (back_side, middle_side, line_side, half_side) = parts
    common = (back <= back_side[-1]) & (back >= back_side[0])
    require(bool(common.any()), "the views of the finger have no row in common: it does not lie along the mirror.")
    back, middle, half = back[common], middle[common], half[common]
    rise = np.interp(back, back_side, half_side)
    centre = tip_is_outward * np.interp(back, back_side, middle_side - line_side)
    return Ellipses(front.axis, back, front.tip_mm, middle, half, rise, np.asarray(centre))
