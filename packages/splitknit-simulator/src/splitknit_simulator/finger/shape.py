"""The smooth finger: an implicit body, and the chart that lays its skin flat.

Finger frame, mm: y along the finger, 0 at the first flexion crease and `length_mm` at the tip; z
out of the pad; x to the right as a camera above the pad sees it. The body is where its implicit
function is not positive.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from splitknit.errors import require
from splitknit.model import Array, BoolArray


@dataclass(frozen=True, slots=True)
class FingerShape:
    """Size and form of a distal phalanx and the middle phalanx below it (one finger, without pose
    or ridges).

    The cross-section is a superellipse-like curve ``h(X^2) + h(Z^2) = 1`` with ``h(q) = (1 - k) q +
    k q^2``; towards the tip the same curve is revolved about the pad's top, so the cap is smooth.
    """

    length_mm: float = 25.0
    """Tip to first crease; people: 22-28."""
    width_mm: float = 16.8
    """Breadth of the pad; people: 14-20."""
    thickness_mm: float = 13.5
    """Twice the height of the pad over the widest line of the section."""
    squareness: float = 0.2
    """k of the cross-section: 0 an ellipse, towards 0.45 a flatter pad with rounder shoulders."""
    tip_length_mm: float = 8.5
    """Length of the rounded cap; short is blunt."""
    tip_squareness: float = 0.15
    """0 an elliptic outline of the tip, towards 0.5 a squarer one."""
    taper: float = 0.06
    """Relative growth of the breadth from the crease to 20 mm further proximal."""
    pad_bulge: float = 0.05
    """Relative rise of the pad over its neck, in thickness; half of it in breadth."""
    pad_center: float = 0.5
    """Where the bulge is highest, as a fraction of the length."""
    neck: float = 0.03
    """Relative dip of the palmar side at the first crease."""
    arching_per_mm: float = 0.0015
    """Curvature of the finger's axis in the vertical plane."""
    sideways_mm: float = 0.0
    """How far the axis bends to the side over 25 mm."""
    skew: float = 0.0
    """Shear of the sections: the pad's top lies off the middle by this fraction of the height."""
    tip_drop_mm: float = 0.0
    """How far the rounded cap bends away from the camera, towards the nail: the outline's tip lies
    that much lower than its sides, so that a roll moves it sideways."""


@dataclass(frozen=True, slots=True, eq=False)
class FingerBody:
    """A :class:`FingerShape` ready to be evaluated."""

    shape: FingerShape
    _arc: Array = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_arc", _arc_coefficients(self.shape.squareness))

    def value_and_gradient(self, x: Array, y: Array, z: Array) -> tuple[Array, Array, Array, Array]:
        """Return the implicit function and its derivatives along x, y and z."""
        form = self._sections(y)
        return self._gradient(form, *self._scaled(form, x, z))

    def distance_and_chart(self, x: Array, y: Array, z: Array) -> tuple[Array, Array, Array]:
        """Return the distance from the smooth skin (mm, positive outside) and the chart (u, v) in
        arc length, mm.

        The distance is the first-order one, value over length of gradient. The chart is exact on
        the middle line and around the straight part of the finger; on the rounded cap it is
        azimuthal about the pad's top.
        """
        form = self._sections(y)
        side, reach, up = self._scaled(form, x, z)
        value, gx, gy, gz = self._gradient(form, side, reach, up)
        distance = value / np.sqrt(gx * gx + gy * gy + gz * gz)
        lateral, forward = side * form.half, reach * self.shape.tip_length_mm
        physical = np.sqrt(lateral * lateral + forward * forward)
        radius = np.sqrt(np.maximum(self._radius2(side, reach), 1e-24))
        # half axis of the section through the pad's top and this point
        ratio = physical / (radius * form.rise)
        angle = np.arctan2(radius, up)
        norm = 1.0 / (radius * radius + up * up)
        double_sine, double_cosine = 2.0 * radius * up * norm, (up * up - radius * radius) * norm
        c = [((p[3] * ratio + p[2]) * ratio + p[1]) * ratio + p[0] for p in self._arc]
        bend = double_sine * (
            c[1] + double_cosine * (2.0 * c[2] + 4.0 * c[3] * double_cosine) - c[3]
        )
        stretch = form.rise * (c[0] * angle + bend) / np.maximum(physical, 1e-12)
        return distance, stretch * lateral, (y - forward) + stretch * forward

    def encloses(self, x: Array, y: Array, z: Array) -> BoolArray:
        """Whether points may belong to the finger: far beside a square tip the implicit function
        falls again."""
        s = self.shape
        return (np.abs(x) < 0.9 * s.width_mm) & (y < s.length_mm + 0.3 * s.tip_length_mm)

    def top(self, x: Array, y: Array) -> Array:
        """Return z of the palmar skin over (x, y) of an unskewed section frame; NaN beside the
        finger."""
        form = self._sections(y)
        side, reach = x / form.half, form.cap / self.shape.tip_length_mm
        k, radius2 = self.shape.squareness, self._radius2(side, reach)
        rest = 1.0 - radius2 * ((1.0 - k) + k * radius2)
        up2 = 2.0 * rest / ((1.0 - k) + np.sqrt((1.0 - k) ** 2 + 4.0 * k * np.maximum(rest, 0.0)))
        return np.where(rest >= 0, form.drop + form.rise * np.sqrt(np.maximum(up2, 0.0)), np.nan)

    def axis_line(self, y: Array) -> tuple[Array, Array]:
        """Return x and z of the finger's axis over `y`."""
        form = self._sections(y)
        return form.axis, form.drop

    def _gradient(
        self, form: _Sections, side: Array, reach: Array, up: Array
    ) -> tuple[Array, Array, Array, Array]:
        s = self.shape
        side2, reach2, up2 = side * side, reach * reach, up * up
        radius2 = side2 + reach2 - s.tip_squareness * side2 * reach2
        flat = 1.0 - s.squareness
        outer = 2.0 * flat + 4.0 * s.squareness * radius2
        on_up = (2.0 * flat + 4.0 * s.squareness * up2) * up / form.rise
        on_side = outer * side * (1.0 - s.tip_squareness * reach2) / form.half
        on_reach = outer * reach * (1.0 - s.tip_squareness * side2) / s.tip_length_mm
        value = radius2 * (flat + s.squareness * radius2) + up2 * (flat + s.squareness * up2) - 1.0
        along_y = (
            on_side * (s.skew * form.drop_slope - form.axis_slope - side * form.half_slope)
            + on_reach * form.cap_slope
            - on_up * (form.drop_slope + up * form.rise_slope)
        )
        return value, on_side, along_y, on_up - on_side * s.skew

    def _radius2(self, side: Array, reach: Array) -> Array:
        side2, reach2 = side * side, reach * reach
        return side2 + reach2 - self.shape.tip_squareness * side2 * reach2

    def _scaled(self, form: _Sections, x: Array, z: Array) -> tuple[Array, Array, Array]:
        above = z - form.drop
        side = (x - form.axis - self.shape.skew * above) / form.half
        return side, form.cap / self.shape.tip_length_mm, above / form.rise

    def _sections(self, y: Array) -> _Sections:
        """Half breadth, rise and axis of the section at `y`, with their slopes."""
        s = self.shape
        pad = np.exp(-0.5 * ((y - s.pad_center * s.length_mm) / (0.27 * s.length_mm)) ** 2)
        pad_slope = -pad * (y - s.pad_center * s.length_mm) / (0.27 * s.length_mm) ** 2
        neck = np.exp(-0.5 * (y / 2.6) ** 2)
        neck_slope = -neck * y / 2.6**2
        joint = np.exp(-0.5 * ((y + 3.0) / 4.0) ** 2)
        joint_slope = -joint * (y + 3.0) / 4.0**2
        grown, grown_slope = _softplus(-(y - 1.0), 3.0)
        grown, grown_slope = grown / 20.0, -grown_slope / 20.0
        a, b = 0.5 * s.width_mm, 0.5 * s.thickness_mm
        half = a * (1.0 + s.taper * grown + 0.5 * s.pad_bulge * (pad - 0.8) + 0.02 * joint)
        half_slope = a * (
            s.taper * grown_slope + 0.5 * s.pad_bulge * pad_slope + 0.02 * joint_slope
        )
        rise = b * (1.0 + s.taper * grown + s.pad_bulge * (pad - 0.8) - s.neck * neck)
        rise_slope = b * (s.taper * grown_slope + s.pad_bulge * pad_slope - s.neck * neck_slope)
        turn = s.sideways_mm / 25.0**2
        lean = y - 8.0
        width = 0.12 * s.tip_length_mm
        cap, cap_slope = _softplus(
            y - s.length_mm + s.tip_length_mm - width * width / s.tip_length_mm, width
        )
        drop, drop_slope = -0.5 * s.arching_per_mm * lean * lean, -s.arching_per_mm * lean
        if s.tip_drop_mm:
            bend = s.tip_drop_mm / s.tip_length_mm**2
            drop, drop_slope = drop - bend * cap * cap, drop_slope - 2.0 * bend * cap * cap_slope
        return _Sections(
            half,
            half_slope,
            rise,
            rise_slope,
            turn * y * y,
            2.0 * turn * y,
            drop,
            drop_slope,
            cap,
            cap_slope,
        )


class _Sections(NamedTuple):
    half: Array
    half_slope: Array
    rise: Array
    rise_slope: Array
    axis: Array
    axis_slope: Array
    drop: Array
    drop_slope: Array
    cap: Array
    cap_slope: Array


def shape_of_rolled_print(inside: BoolArray, pitch_mm: float, shape: FingerShape) -> FingerShape:
    """`shape` with the width, thickness, length and tip that the outline of its rolled print gives.

    `inside`: (H, W), True from the first to the last ink of each row, tip up, rolled from nail to
    nail, and down to the first crease. A row is as long as the half section that it was rolled off,
    so that it gives the half width (the frontal silhouette) and, by the thickness over the width
    that `shape` has, the height (the lateral one). Raises BadInput if no finger has that size.

    References
    ----------
    The thesis, chapter 2, on Donida Labati et al. [18]: synthetic fingertips from a rolled print's
    two silhouettes.
    """
    ratio = shape.width_mm / shape.thickness_mm
    row_mm = inside.sum(axis=1)[inside.any(axis=1)] * pitch_mm
    require(row_mm.size > 2, "the print shows no ridges.")
    quarter = (
        0.5
        * np.pi
        * np.polynomial.polynomial.polyval(ratio, _arc_coefficients(shape.squareness)[0])
    )
    rise = gaussian_filter1d(row_mm, 0.5 / pitch_mm, mode="nearest") / (2.0 * quarter)
    fall = np.clip(np.gradient(rise, pitch_mm), -1.0, 1.0)
    from_tip = np.cumsum(np.sqrt(1.0 - fall * fall)) * pitch_mm
    thickness = 2.0 * float(np.quantile(rise, 0.9))  # torn rows are longer than the finger is round
    # an elliptic tip has the half width sqrt(3)/2 of the finger's where half of its length is left
    tip = float(
        np.clip(2.0 * from_tip[np.argmax(rise > 0.25 * np.sqrt(3.0) * thickness)], 4.0, 14.0)
    )
    width, length = ratio * thickness, float(from_tip[-1])
    require(
        10.0 <= width <= 30.0 and 15.0 <= length <= 40.0,
        f"the rolled print would be of a finger {width:.1f} mm broad and {length:.1f} mm long;"
        " check its resolution and that it was rolled from nail to nail.",
    )
    return replace(
        shape, width_mm=width, thickness_mm=thickness, length_mm=length, tip_length_mm=tip
    )


def _softplus(x: Array, width: float) -> tuple[Array, Array]:
    """Return a smooth max(x, 0) that turns within about `width`, and its slope."""
    root = np.sqrt(x * x + 4.0 * width * width)
    return 0.5 * (x + root), 0.5 * (1.0 + x / root)


def _arc_coefficients(squareness: float) -> Array:
    """(4, 4) polynomials in the ratio A / b of the Fourier coefficients of the arc length over the
    angle.

    Arc length of a section from its top, over its rise b: ``c0 t + c1 sin 2t + c2 sin 4t + c3 sin
    6t`` with ``tan t = X / Z`` in scaled coordinates; fitted by least squares for ratios of 0.6 to
    2.
    """
    t = np.linspace(0.0, np.pi / 2, 721)
    sine2, cosine2 = np.sin(t) ** 2, np.cos(t) ** 2
    k = squareness
    quartic = k * (sine2**2 + cosine2**2)
    radius = np.sqrt(2.0 / ((1.0 - k) + np.sqrt((1.0 - k) ** 2 + 4.0 * quartic)))
    side, up = radius * np.sin(t), radius * np.cos(t)
    basis = np.stack([t, np.sin(2 * t), np.sin(4 * t), np.sin(6 * t)], 1)
    ratios = np.linspace(0.6, 2.0, 15)
    fits = []
    for ratio in ratios:
        steps = np.hypot(ratio * np.diff(side), np.diff(up))
        arc = np.concatenate([[0.0], np.cumsum(steps)])
        fits.append(np.linalg.lstsq(basis, arc, rcond=None)[0])
    return np.stack([np.polynomial.polynomial.polyfit(ratios, c, 3) for c in np.array(fits).T])
