"""The shape from one mirror as the thesis has it (section 3.3.2.3, steps 2 to 7): lateral and frontal
masks aligned row by row, one ellipse a row; mirrors at exactly 45 deg."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splitknit.errors import require
from splitknit.imaging.view import view_of
from splitknit.mirrors.outline import OutlineRows, finger_axis, is_cut, medial_line, pad_side
from splitknit.mirrors.views import Views
from splitknit.model import Array, Camera, FloatArray, Rig


@dataclass(frozen=True, slots=True, eq=False)
class Ellipses:
    """One ellipse for each row that both views have."""

    camera: Camera
    axis: Array  # (2,) of the front view's medial line, towards the tip
    from_tip_mm: Array  # (n,) distance of the rows from the tip, growing
    tip_mm: float  # where the tip lies on the axis
    middle_mm: Array  # (n,) middle of the front view's row, to the right of the axis
    half_width_mm: Array  # (n,) of the front view
    half_height_mm: Array  # (n,) of the lateral view
    centre_mm: Array  # (n,) height of the lateral view's middle, beside its medial line

    def points(self, rows: slice, columns: slice) -> tuple[FloatArray, FloatArray, FloatArray]:
        """x, y, z (h, w), mm, of the surface that a window's pixels see; NaN beside it."""
        x, y = np.broadcast_arrays(*view_of(self.camera, rows, columns).on_plane())
        p = self.axis[0] * x + self.axis[1] * y
        q = self.axis[1] * x - self.axis[0] * y
        back = self.tip_mm - p

        def at(values: Array) -> Array:
            return np.asarray(np.interp(back, self.from_tip_mm, values))

        place = (q - at(self.middle_mm)) / np.maximum(at(self.half_width_mm), 1e-9)
        z = at(self.centre_mm) + at(self.half_height_mm) * np.sqrt(
            np.clip(1.0 - place**2, 0.0, None)
        )
        inside = (
            (np.abs(place) <= 1) & (back >= self.from_tip_mm[0]) & (back <= self.from_tip_mm[-1])
        )
        return x, y, np.where(inside, z, np.nan)


def paired(
    camera: Camera, front: OutlineRows, lateral: OutlineRows, tip_is_outward: float
) -> Ellipses:
    """Align the views as the thesis does, and pair their rows.

    Medial lines are turned to one direction, tips put into one row, and each row's half-widths
    become half axes of an ellipse; a plane mirror keeps lengths. `front`, `lateral`: outlines
    across their medial lines; `tip_is_outward`: +1 where the pad is on the right of the lateral
    view's axis, -1 on its left. Source: the thesis, section 3.3.2.3, steps 2 to 7.
    """
    front_back, middle, _, half_width = rows_from_tip(front)
    back, lateral_middle, line, half_height = rows_from_tip(lateral)
    common = (front_back <= back[-1]) & (front_back >= back[0])
    require(
        common.any(),
        "the views of the finger have no row in common: it does not lie along the mirror.",
    )
    rows = front_back[common]
    return Ellipses(
        camera=camera,
        axis=front.axis,
        from_tip_mm=rows,
        tip_mm=front.tip_mm,
        middle_mm=middle[common],
        half_width_mm=half_width[common],
        half_height_mm=np.interp(rows, back, half_height),
        centre_mm=tip_is_outward * np.interp(rows, back, lateral_middle - line),
    )


def rows_from_tip(rows: OutlineRows) -> tuple[Array, Array, Array, Array]:
    """Of whole rows, from the tip on: distance from it, middle, medial line and half width."""
    known = np.isfinite(rows.width_mm)
    require(int(known.sum()) >= 8, "a view of the finger is too small to show how it lies.")
    slope, offset = medial_line(rows)
    back = rows.tip_mm - rows.along_mm
    middle = 0.5 * (rows.left_mm + rows.right_mm)
    line = slope * rows.along_mm + offset
    half = 0.5 * rows.width_mm
    return back[known][::-1], middle[known][::-1], line[known][::-1], half[known][::-1]


def ellipses(views: Views, rig: Rig) -> Ellipses:
    """The shape by the one lateral view of `views`."""
    ((name, mask),) = views.mirrors.items()
    (mirror,) = (mirror for mirror in rig.mirrors if mirror.name == name)
    axis, front = finger_axis(views.front, rig.camera, views.binning, np.array([0.0, 1.0]))
    _, lateral = finger_axis(mask, rig.camera, views.binning, axis)
    side = pad_side(mirror, lateral)
    require(not is_cut(lateral, side), f"the view in the {name} mirror is cut off.")
    return paired(rig.camera, front, lateral, 1.0 if side == "right" else -1.0)
