"""A patch of a palm: the skin of fingers with flatter relief, coarser ridges and lines, gently
curved.

The thesis trains its separation on palms, whose skin is that of fingers and which fill the picture.
A palm here is a patch under an orthographic camera, its ridges displaced along the shape's normal.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline

from splitknit.errors import require
from splitknit.model import Array, Camera, FloatArray
from splitknit_simulator.finger.master_print import (
    MasterPrintSettings,
    ridge_profile,
    scatter_pores,
    twice_as_fine,
)
from splitknit_simulator.finger.ridges import grow_ridges, smooth_noise
from splitknit_simulator.surface import SimulatedSurface

STEP_MM = 0.25  # distance between the points of a line
# exponent of the norm that joins grooves: deeper than each where they cross, less than their sum
JOIN_EXPONENT = 3.0


# Lines of the palm: principal lines and wrinkles, wide, tapering and branching, as grooves on a
# map.


@dataclass(frozen=True, slots=True, eq=False)
class _PalmLine:
    """One groove."""

    points_mm: Array  # (N, 2) x and y along its bottom
    depth_mm: Array  # (N,) depth; it fades out at the ends
    width_mm: Array  # (N,) standard deviation of its profile


def _draw_lines(
    rng: np.random.Generator,
    half_size_mm: tuple[float, float],
    *,
    principal: int,
    wrinkles: int,
    principal_depth_mm: float,
    wrinkle_depth_mm: float,
) -> list[_PalmLine]:
    """Draw the lines of one palm, each through a place inside the map, branches after their stems;
    `principal` and `wrinkles` count the stems, and every line varies about the typical depths by
    about a third.
    """
    lines: list[_PalmLine] = []
    main = rng.uniform(0.0, np.pi)
    for _ in range(principal):
        through = rng.uniform(-0.75, 0.75, 2) * half_size_mm
        heading = main + 0.35 * rng.standard_normal()
        depth = principal_depth_mm * np.exp(0.3 * np.clip(rng.standard_normal(), -2, 2))
        length = rng.uniform(0.9, 1.8) * max(half_size_mm) * 2.0
        width, depth = rng.uniform(0.28, 0.5), min(depth, 0.3)
        lines += _stem(
            rng, through, heading, length=length, depth=depth, width=width, generations=2
        )
    # wrinkles keep to two directions, as folds of the skin do
    folds = rng.uniform(0.0, np.pi, 2)
    for _ in range(wrinkles):
        through = rng.uniform(-1.0, 1.0, 2) * half_size_mm
        heading = folds[int(rng.random() < 0.35)] + 0.3 * rng.standard_normal()
        depth = wrinkle_depth_mm * np.exp(0.5 * np.clip(rng.standard_normal(), -2, 2))
        length = float(np.clip(7.0 * np.exp(0.6 * rng.standard_normal()), 2.0, 25.0))
        width = max(rng.uniform(0.09, 0.2), 1.3 * depth)
        lines += _stem(
            rng, through, heading, length=length, depth=depth, width=width, generations=1
        )
    return lines


def _stem(
    rng: np.random.Generator,
    through: Array,
    heading: float,
    *,
    length: float,
    depth: float,
    width: float,
    generations: int,
    start: bool = False,
) -> list[_PalmLine]:
    """One line through (or from) a place and its branches."""
    count = max(int(length / STEP_MM), 8)
    # the heading wanders smoothly: noise of a few millimetres on top of a steady bend
    wander = _wander(np.cumsum(rng.standard_normal(count // 12 + 2)), 12, count)
    angle = heading + rng.normal(0.0, 0.015) * STEP_MM * np.arange(count) + 0.09 * wander
    points = np.cumsum(STEP_MM * np.stack([np.cos(angle), np.sin(angle)], 1), axis=0)
    points += through - (points[0] if start else points[count // 2])
    along = np.linspace(0.0, 1.0, count)
    ends = rng.uniform(0.1, 0.35, 2)
    rise = np.ones(count) if start else np.clip(along / ends[0], 0.0, 1.0)
    fade = np.sqrt(rise * np.clip((1.0 - along) / ends[1], 0.0, 1.0))
    uneven = _wander(rng.uniform(0.7, 1.15, count // 8 + 2), 8, count)
    line = _PalmLine(points, depth * fade * uneven, width * (0.6 + 0.4 * fade))
    lines = [line]
    for _ in range(int(rng.poisson(length / 9.0)) if generations else 0):
        at = int(rng.uniform(0.12, 0.88) * count)
        branch_angle = (
            angle[at]
            + rng.choice((-1.0, 1.0)) * rng.uniform(0.25, 0.8)
            + (np.pi if rng.random() < 0.3 else 0.0)
        )
        fraction = rng.uniform(0.3, 0.75)
        lines += _stem(
            rng,
            points[at],
            float(branch_angle),
            length=length * rng.uniform(0.15, 0.4),
            depth=float(line.depth_mm[at]) * fraction,
            width=float(line.width_mm[at]) * (0.4 + 0.6 * fraction),
            generations=generations - 1,
            start=True,
        )
    return lines


def _wander(knots: Array, step: int, count: int) -> Array:
    """(count,) values between `knots`, which are `step` points apart."""
    return np.asarray(
        np.interp(np.arange(count), step * np.arange(knots.size), knots), dtype=np.float64
    )


def _groove_map(lines: list[_PalmLine], x_mm: Array, y_mm: Array) -> Array:
    """(H, W) depth in mm of all lines together on regular axes; y falls with the row.

    Every line is a row of Gaussian dips a third of its width apart; the deepest counts.
    """
    pitch = float(x_mm[1] - x_mm[0])
    powers = np.zeros((y_mm.size, x_mm.size))
    for line in lines:
        x, y, depth, width = _dense(line)
        column, row = (x - x_mm[0]) / pitch, (y_mm[0] - y) / pitch
        reach = int(np.ceil(3.5 * width.max() / pitch))
        seen = (
            (column > -reach)
            & (column < x_mm.size + reach)
            & (row > -reach)
            & (row < y_mm.size + reach)
        )
        if not seen.any():
            continue
        column, row, depth, width = column[seen], row[seen], depth[seen], width[seen] / pitch
        top = int(row.min()) - reach - 1
        left = int(column.min()) - reach - 1
        size = (int(row.max()) + reach + 2 - top, int(column.max()) + reach + 2 - left)
        own = np.zeros(size)
        for r, c, d, w in zip(row - top, column - left, depth, width, strict=True):
            n = int(np.ceil(3.5 * w))
            r0 = max(int(r) - n, 0)
            c0 = max(int(c) - n, 0)
            part = own[r0 : int(r) + n + 2, c0 : int(c) + n + 2]
            down = np.exp(-0.5 * ((np.arange(part.shape[0]) + r0 - r) / w) ** 2)
            across = np.exp(-0.5 * ((np.arange(part.shape[1]) + c0 - c) / w) ** 2)
            np.maximum(part, (d * down)[:, None] * across[None, :], out=part)
        rows = slice(max(top, 0), min(top + size[0], y_mm.size))
        columns = slice(max(left, 0), min(left + size[1], x_mm.size))
        inside = own[rows.start - top : rows.stop - top, columns.start - left : columns.stop - left]
        powers[rows, columns] += inside**JOIN_EXPONENT
    return np.asarray(powers ** (1.0 / JOIN_EXPONENT))


def _dense(line: _PalmLine) -> tuple[Array, Array, Array, Array]:
    """Points at a third of the line's least width: x, y, depth, width."""
    length = STEP_MM * np.arange(len(line.points_mm))
    fine = np.arange(0.0, float(length[-1]), float(line.width_mm.min()) / 3.0)
    values = (line.points_mm[:, 0], line.points_mm[:, 1], line.depth_mm, line.width_mm)
    x, y, depth, width = (np.interp(fine, length, value) for value in values)
    return x, y, depth, width


# The palm without its skin relief: a gently curved sheet with the pads of thumb and little finger.


@dataclass(frozen=True, slots=True)
class _PalmShape:
    """Height of the sheet: a tilted quadric and round pads."""

    tilt: tuple[float, float]  # slopes along x and y in the middle
    curvature_per_mm: tuple[float, float]  # along the two principal axes; positive is domed
    axis_rad: float  # direction of the first principal axis, counter-clockwise from x
    # x, y, height (negative is a hollow) and standard deviation of each, all in mm
    pads: tuple[tuple[float, float, float, float], ...]
    top_mm: float = 0.0  # subtracted from the height

    def on_grid(self, x_mm: Array, y_mm: Array) -> tuple[Array, Array, Array]:
        """Height and its slopes along x and y, (H, W) on the axes `x_mm` (W,) and `y_mm` (H,)."""
        x, y = x_mm[None, :], y_mm[:, None]
        cosine = np.cos(self.axis_rad)
        sine = np.sin(self.axis_rad)
        u, v = cosine * x + sine * y, cosine * y - sine * x
        first, second = self.curvature_per_mm
        height = (
            self.tilt[0] * x + self.tilt[1] * y - 0.5 * (first * u**2 + second * v**2) - self.top_mm
        )
        slope_x = self.tilt[0] - first * u * cosine + second * v * sine
        slope_y = self.tilt[1] - first * u * sine - second * v * cosine
        for px, py, rise, sigma in self.pads:
            bump = (
                rise
                * np.exp(-0.5 * ((x - px) / sigma) ** 2)
                * np.exp(-0.5 * ((y - py) / sigma) ** 2)
            )
            height = height + bump
            slope_x = slope_x - bump * (x - px) / sigma**2
            slope_y = slope_y - bump * (y - py) / sigma**2
        return height, slope_x, slope_y


def _draw_shape(rng: np.random.Generator, half_size_mm: tuple[float, float]) -> _PalmShape:
    """Draw one sheet; its highest point within the patch lies on the finger plane, z = 0."""
    low, high = _RADIUS_MM
    radii = low * (high / low) ** rng.random(2)
    tilt = np.clip(0.06 * rng.standard_normal(2), -0.12, 0.12)
    pads = []
    for _ in range(int(rng.integers(2, 6))):
        sigma = float(rng.uniform(4.0, 11.0))
        # slopes of a pad stay below about 8 degrees
        rise = float(np.clip(0.1 * sigma * rng.standard_normal(), -0.2 * sigma, 0.22 * sigma))
        px, py = rng.uniform(-1.1, 1.1, 2) * half_size_mm
        pads.append((float(px), float(py), rise, sigma))
    shape = _PalmShape(
        (float(tilt[0]), float(tilt[1])),
        (float(1.0 / radii[0]), float(1.0 / radii[1])),
        float(rng.uniform(0.0, np.pi)),
        tuple(pads),
    )
    top = float(shape.on_grid(*(np.linspace(-half, half, 201) for half in half_size_mm))[0].max())
    return replace(shape, top_mm=top)


SIZE_MM = (44.0, 34.0)  # width and height of the patch
PITCH_MM = 0.05  # of the relief's grid
_PERIOD_MM = (0.48, 0.62)  # mean ridge period
_RIDGE_DEPTH_UM = (20.0, 60.0)  # mean height of ridges over valleys: flatter than on fingers
_DELTA_FRACTION = 0.15  # fraction of the patches that hold a triradius
_PRINCIPAL_COUNT = (0, 3)  # principal lines in the patch, inclusive
_WRINKLE_COUNT = (10, 60)  # finer lines in the patch, inclusive
_RADIUS_MM = (35.0, 150.0)  # radii of curvature along the patch's two axes
# relative standard deviation of the ridge period within a palm, over distances of about 5 mm
_PERIOD_VARIATION = 0.06
# standard deviation of the steady turn of the ridges' direction along each axis
_TURN_RAD_PER_MM = 0.02
_PRINCIPAL_DEPTH_UM = (90.0, 280.0)  # depth of the principal lines
_WRINKLE_DEPTH_UM = (18.0, 50.0)  # depth of the finer lines
_DARKENING = (0.05, 0.25)  # loss of diffuse reflectance at the bottom of a line of 0.2 mm
# standard deviation of the blotches' diffuse reflectance, over distances of about 2 mm
_MOTTLING = (0.01, 0.06)
FLATTENED_MM = 0.12  # ridges flatten inside grooves of about this depth


@dataclass(frozen=True, slots=True, eq=False)
class _Palm:
    """One patch, all of it drawn. Axes as in the camera's frame: x right, y up, origin in the
    middle."""

    period_mm: float  # mean ridge period
    ridge_depth_um: float  # mean height of ridges over valleys
    shape: _PalmShape
    x_mm: Array  # (W,) of the columns
    y_mm: Array  # (H,) of the rows; falls with the row
    # (H, W) displacement along the shape's normal: 0 at ridge tops, negative in valleys and lines
    relief_mm: FloatArray
    pigment: FloatArray  # (H, W) multiplier of the diffuse reflectance


def draw_palm(seed: int) -> _Palm:
    """Draw one patch of a palm; the same seed gives the same bytes.

    Ashbaugh 1999, Quantitative-qualitative friction ridge analysis (palmar ridges, flexion creases,
    white lines).
    """
    draws = [
        np.random.default_rng(child) for child in np.random.SeedSequence([seed, 0xBA1]).spawn(7)
    ]
    pick = draws[0]
    period = float(pick.uniform(*_PERIOD_MM))
    depth_um = float(pick.uniform(*_RIDGE_DEPTH_UM))
    darkening = float(pick.uniform(*_DARKENING))
    mottling = float(pick.uniform(*_MOTTLING))
    # of coarse axes, whose lengths suit the Fourier transform and cover the patch
    pitch = 2.0 * PITCH_MM
    width, height = (
        scipy.fft.next_fast_len(int(np.ceil(s / pitch)) + 1, real=True) for s in SIZE_MM
    )
    x_mm = _centred(width, pitch)
    y_mm = -_centred(height, pitch)
    angle = _direction(draws[1], x_mm, y_mm)
    wave = twice_as_fine(_ridges(draws[2], angle, period))
    fine_x = x_mm[0] + PITCH_MM * np.arange(wave.shape[1])
    fine_y = y_mm[0] - PITCH_MM * np.arange(wave.shape[0])
    skin = MasterPrintSettings(period_mm=period, pitch_mm=PITCH_MM)
    ridge = ridge_profile(draws[3], wave, skin)
    pores = scatter_pores(draws[3], wave, PITCH_MM, period, (0.8, 0.13))
    half = (0.5 * SIZE_MM[0], 0.5 * SIZE_MM[1])
    lines = _draw_lines(
        draws[4],
        half,
        principal=int(draws[4].integers(*_PRINCIPAL_COUNT, endpoint=True)),
        wrinkles=int(draws[4].integers(*_WRINKLE_COUNT, endpoint=True)),
        principal_depth_mm=1e-3 * float(draws[4].uniform(*_PRINCIPAL_DEPTH_UM)),
        wrinkle_depth_mm=1e-3 * float(draws[4].uniform(*_WRINKLE_DEPTH_UM)),
    )
    groove = _groove_map(lines, fine_x, fine_y)
    uneven = np.clip(1.0 + 0.15 * smooth_noise(draws[5], wave.shape, 4.0 / PITCH_MM), 0.5, 1.5)
    flatten = np.exp(-((groove / FLATTENED_MM) ** 2))
    relief = -groove - 1e-3 * depth_um * uneven * (1.0 - ridge) * (0.2 + 0.8 * flatten)
    relief -= 1e-3 * 0.35 * depth_um * pores * flatten
    blotches = 1.0 + mottling * np.clip(
        smooth_noise(draws[5], wave.shape, 2.0 / PITCH_MM), -2.5, 2.5
    )
    broad = cv2.GaussianBlur(groove, (0, 0), 0.1 / PITCH_MM)
    pigment = (
        blotches * (1.0 - darkening * np.minimum(broad / 0.2, 1.5)) * (1.0 - 0.04 * pores * flatten)
    )
    return _Palm(
        period,
        depth_um,
        _draw_shape(draws[6], half),
        fine_x,
        fine_y,
        relief.astype(np.float32),
        pigment.astype(np.float32),
    )


def palm_surface(palm: _Palm, camera: Camera) -> SimulatedSurface:
    """Show a palm to an orthographic camera, the middle of the patch in the middle of the picture.

    Normals are the derivatives of the splines that the heights are drawn from.
    """
    require(camera.model == "orthographic", "the simulated palm needs an orthographic camera.")
    rows, columns = camera.image_size
    x = _centred(columns, camera.pitch_mm)
    y = -_centred(rows, camera.pitch_mm)
    height, slope_x, slope_y = palm.shape.on_grid(x, y)
    # splines want rising axes: the patch is turned upside down, and so is what comes out
    spline = RectBivariateSpline(
        palm.y_mm[::-1], palm.x_mm, palm.relief_mm[::-1].astype(np.float64)
    )
    inside = (x >= palm.x_mm[0]) & (x <= palm.x_mm[-1])
    seen = ((y >= palm.y_mm[-1]) & (y <= palm.y_mm[0]))[:, None] & inside[None, :]

    def sample(of: RectBivariateSpline, dy: int = 0, dx: int = 0) -> Array:
        return np.asarray(of(y[::-1], x, dx=dy, dy=dx)[::-1])

    relief = sample(spline)
    # displacement along the shape's normal raises the height by 1 / nz, and the patch is gently
    # curved
    rise = np.sqrt(1.0 + slope_x**2 + slope_y**2)
    skin_x = slope_x + sample(spline, 0, 1) * rise
    skin_y = slope_y + sample(spline, 1, 0) * rise
    pigment = RectBivariateSpline(
        palm.y_mm[::-1], palm.x_mm, palm.pigment[::-1].astype(np.float64), kx=1, ky=1
    )
    return SimulatedSurface(
        camera=camera,
        height_mm=_where(seen, height + relief * rise, np.nan),
        shape_mm=_where(seen, height, np.nan),
        normals=_normals(skin_x, skin_y, seen),
        shape_normals=_normals(slope_x, slope_y, seen),
        relief_um=_where(seen, 1e3 * relief, 0.0),
        mask=seen,
        pigment=_where(seen, sample(pigment), 1.0),
        landmarks={
            "pattern": "palm",
            "period_mm": palm.period_mm,
            "ridge_depth_um": palm.ridge_depth_um,
        },
    )


def _centred(count: int, pitch: float) -> Array:
    return np.asarray((np.arange(count) - (count - 1) / 2) * pitch, dtype=np.float64)


def _direction(rng: np.random.Generator, x_mm: Array, y_mm: Array) -> Array:
    """(H, W) direction of the ridges, about a triradius on some patches."""
    pitch = float(x_mm[1] - x_mm[0])
    shape = (y_mm.size, x_mm.size)
    x, y = np.meshgrid(x_mm, y_mm)
    turn = np.clip(
        _TURN_RAD_PER_MM * rng.standard_normal(2), -2 * _TURN_RAD_PER_MM, 2 * _TURN_RAD_PER_MM
    )
    angle = rng.uniform(0.0, np.pi) + turn[0] * x + turn[1] * y
    angle += rng.uniform(0.1, 0.3) * smooth_noise(rng, shape, 9.0 / pitch)
    angle += rng.uniform(0.03, 0.09) * smooth_noise(rng, shape, 2.5 / pitch)
    at = rng.uniform(-0.3, 0.3, 2) * SIZE_MM
    if rng.random() < _DELTA_FRACTION:
        angle -= 0.5 * np.arctan2(y - at[1], x - at[0])
    return angle


def _ridges(rng: np.random.Generator, angle: Array, period_mm: float) -> FloatArray:
    """(H, W) wave of the ridges on the coarse grid."""
    pitch = 2.0 * PITCH_MM
    logs = _PERIOD_VARIATION * np.clip(smooth_noise(rng, angle.shape, 4.0 / pitch), -2.5, 2.5)
    noise = rng.standard_normal(angle.shape).astype(np.float32)
    return grow_ridges(noise, angle, period_mm * np.exp(logs) / pitch)


def _where(seen: NDArray[np.bool_], values: Array, beside: float) -> FloatArray:
    return np.where(seen, values, beside).astype(np.float32)


def _normals(slope_x: Array, slope_y: Array, seen: NDArray[np.bool_]) -> FloatArray:
    normals = np.stack([-slope_x, -slope_y, np.ones_like(slope_x)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return np.where(seen[..., None], normals, 0.0).astype(np.float32)
