"""A patch of a palm: the skin of fingers with flatter relief, coarser ridges and lines, gently curved.

The thesis trains its separation on palms, whose skin is that of fingers and which fill the picture. A palm here is a
patch under an orthographic camera, its ridges displaced along the shape's normal; where the camera sees more than the
patch, there is nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline

from splitknit.errors import require
from splitknit.model import Camera
from splitknit.simulator.master_print import MasterPrintSettings, ridge_profile, twice_as_fine
from splitknit.simulator.orientation_field import smooth_noise
from splitknit.simulator.palm_lines import PalmLine, draw_lines, groove_map
from splitknit.simulator.pores import scatter_pores
from splitknit.simulator.ridge_growth import grow_ridges
from splitknit.simulator.surface import Surface

# The palm without its skin relief: a gently curved sheet with the pads of thumb and little finger.


@dataclass(frozen=True, slots=True)
class PalmShape:
    """Height of the sheet: a tilted quadric and round pads."""

    tilt: tuple[float, float]
    """Slopes along x and y in the middle."""
    curvature_per_mm: tuple[float, float]
    """Along the two principal axes; positive is domed."""
    axis_rad: float
    """Of the first principal axis, counter-clockwise from x."""
    pads: tuple[tuple[float, float, float, float], ...]
    """x, y, height (negative is a hollow) and standard deviation of each, all in mm."""
    top_mm: float = 0.0
    """Subtracted from the height."""

    def on_grid(self, x_mm: Array, y_mm: Array) -> tuple[Array, Array, Array]:
        """Height and its slopes along x and y, (H, W) on the axes `x_mm` (W,) and `y_mm` (H,)."""
        x, y = x_mm[None, :], y_mm[:, None]
        cosine, sine = np.cos(self.axis_rad), np.sin(self.axis_rad)
        u, v = cosine * x + sine * y, cosine * y - sine * x
        first, second = self.curvature_per_mm
        height = self.tilt[0] * x + self.tilt[1] * y - 0.5 * (first * u**2 + second * v**2) - self.top_mm
        slope_x = self.tilt[0] - first * u * cosine + second * v * sine
        slope_y = self.tilt[1] - first * u * sine - second * v * cosine
        for px, py, rise, sigma in self.pads:
            bump = rise * np.exp(-0.5 * ((x - px) / sigma) ** 2) * np.exp(-0.5 * ((y - py) / sigma) ** 2)
            height = height + bump
            slope_x = slope_x - bump * (x - px) / sigma**2
            slope_y = slope_y - bump * (y - py) / sigma**2
        return height, slope_x, slope_y


def draw_shape(
    rng: np.random.Generator, half_size_mm: tuple[float, float], radius_mm: tuple[float, float]
) -> PalmShape:
    """Draw one sheet; its highest point within the patch lies on the finger plane, z = 0."""
    low, high = radius_mm
    radii = low * (high / low) ** rng.random(2)
    tilt = np.clip(0.06 * rng.standard_normal(2), -0.12, 0.12)
    pads = []
    for _ in range(int(rng.integers(2, 6))):
        sigma = float(rng.uniform(4.0, 11.0))
        # slopes of a pad stay below about 8 degrees
        rise = float(np.clip(0.1 * sigma * rng.standard_normal(), -0.2 * sigma, 0.22 * sigma))
        px, py = rng.uniform(-1.1, 1.1, 2) * half_size_mm
        pads.append((float(px), float(py), rise, sigma))
    shape = PalmShape(
        (float(tilt[0]), float(tilt[1])),
        (float(1.0 / radii[0]), float(1.0 / radii[1])),
        float(rng.uniform(0.0, np.pi)),
        tuple(pads),
    )
    grid = [np.linspace(-half, half, 201) for half in half_size_mm]
    top = float(shape.on_grid(grid[0], grid[1])[0].max())
    return PalmShape(shape.tilt, shape.curvature_per_mm, shape.axis_rad, shape.pads, top)


Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

FLATTENED_MM = 0.12
"""Ridges flatten inside grooves of about this depth."""


@dataclass(frozen=True, slots=True, eq=False)
class Palm:
    """One patch, all of it drawn. Axes as in the camera's frame: x right, y up, origin in the middle."""

    seed: int
    period_mm: float
    """Mean ridge period."""
    ridge_depth_um: float
    """Mean height of ridges over valleys."""
    shape: PalmShape
    lines: tuple[PalmLine, ...]
    x_mm: Array
    """(W,) of the columns."""
    y_mm: Array
    """(H,) of the rows; falls with the row."""
    angle_rad: Array32
    """(H, W) direction of the ridges, counter-clockwise from x, defined up to pi."""
    relief_mm: Array32
    """(H, W) displacement along the shape's normal: 0 at ridge tops, negative in valleys and lines."""
    pigment: Array32
    """(H, W) multiplier of the diffuse reflectance."""
    triradius_mm: tuple[float, float] | None = field(default=None)
    """x and y of the triradius, where the patch has one."""


def draw_palm(seed: int, settings: PalmSettings | None = None) -> Palm:
    """Draw one patch of a palm; the same seed and settings give the same bytes.

    References
    ----------
    Ashbaugh 1999, Quantitative-qualitative friction ridge analysis (palmar ridges, flexion creases, white lines).
    """
    settings = settings or PalmSettings()
    require(seed >= 0, f"the seed of a palm must not be negative, but it is {seed}.")
    draws = [np.random.default_rng(child) for child in np.random.SeedSequence([seed, 0xBA1]).spawn(7)]
    pick = draws[0]
    period = float(pick.uniform(*settings.period_mm))
    depth_um = float(pick.uniform(*settings.ridge_depth_um))
    darkening, mottling = float(pick.uniform(*settings.darkening)), float(pick.uniform(*settings.mottling))
    x_mm, y_mm = _axes(settings)
    angle, triradius = _direction(draws[1], settings, x_mm, y_mm)
    wave = twice_as_fine(_ridges(draws[2], settings, angle, period))
    fine_x = x_mm[0] + settings.pitch_mm * np.arange(wave.shape[1])
    fine_y = y_mm[0] - settings.pitch_mm * np.arange(wave.shape[0])
    skin = MasterPrintSettings(period_mm=period, pitch_mm=settings.pitch_mm)
    ridge = ridge_profile(draws[3], wave, skin)
    pores = scatter_pores(
        draws[3], wave, pitch_mm=settings.pitch_mm, period_mm=period, spacing_mm=0.8, diameter_mm=0.13
    )
    half = (0.5 * settings.size_mm[0], 0.5 * settings.size_mm[1])
    lines = draw_lines(
        draws[4],
        half,
        principal=int(draws[4].integers(*settings.principal, endpoint=True)),
        wrinkles=int(draws[4].integers(*settings.wrinkles, endpoint=True)),
        principal_depth_mm=1e-3 * float(draws[4].uniform(*settings.principal_depth_um)),
        wrinkle_depth_mm=1e-3 * float(draws[4].uniform(*settings.wrinkle_depth_um)),
    )
    groove = groove_map(lines, fine_x, fine_y)
    uneven = np.clip(1.0 + 0.15 * smooth_noise(draws[5], wave.shape, 4.0 / settings.pitch_mm), 0.5, 1.5)
    flatten = np.exp(-((groove / FLATTENED_MM) ** 2))
    relief = -groove - 1e-3 * depth_um * uneven * (1.0 - ridge) * (0.2 + 0.8 * flatten)
    relief -= 1e-3 * 0.35 * depth_um * pores * flatten
    blotches = 1.0 + mottling * np.clip(smooth_noise(draws[5], wave.shape, 2.0 / settings.pitch_mm), -2.5, 2.5)
    broad = cv2.GaussianBlur(groove, (0, 0), 0.1 / settings.pitch_mm)
    pigment = blotches * (1.0 - darkening * np.minimum(broad / 0.2, 1.5)) * (1.0 - 0.04 * pores * flatten)
    return Palm(
        seed,
        period,
        depth_um,
        draw_shape(draws[6], half, settings.radius_mm),
        lines,
        fine_x,
        fine_y,
        _twice(angle).astype(np.float32),
        relief.astype(np.float32),
        pigment.astype(np.float32),
        triradius,
    )


def palm_surface(palm: Palm, camera: Camera) -> Surface:
    """Show a palm to an orthographic camera, the middle of the patch in the middle of the picture.

    Normals are the derivatives of the splines that the heights are drawn from.

    Raises
    ------
    BadInput
        If the camera is not orthographic.
    """
    require(camera.model == "orthographic", "the simulated palm needs an orthographic camera.")
    rows, columns = camera.image_size
    x, y = _centred(columns, camera.pitch_mm), -_centred(rows, camera.pitch_mm)
    height, slope_x, slope_y = palm.shape.on_grid(x, y)
    # splines want rising axes: the patch is turned upside down, and so is what comes out
    spline = RectBivariateSpline(palm.y_mm[::-1], palm.x_mm, palm.relief_mm[::-1].astype(np.float64))
    inside = (x >= palm.x_mm[0]) & (x <= palm.x_mm[-1])
    seen = ((y >= palm.y_mm[-1]) & (y <= palm.y_mm[0]))[:, None] & inside[None, :]

    def sample(of: RectBivariateSpline, dy: int = 0, dx: int = 0) -> Array:
        return np.asarray(of(y[::-1], x, dx=dy, dy=dx)[::-1])

    relief = sample(spline)
    # displacement along the shape's normal raises the height by 1 / nz, and the patch is gently curved
    rise = np.sqrt(1.0 + slope_x**2 + slope_y**2)
    skin_x, skin_y = slope_x + sample(spline, 0, 1) * rise, slope_y + sample(spline, 1, 0) * rise
    pigment = RectBivariateSpline(palm.y_mm[::-1], palm.x_mm, palm.pigment[::-1].astype(np.float64), kx=1, ky=1)
    return Surface(
        camera=camera,
        height_mm=_where(seen, height + relief * rise, np.nan),
        shape_mm=_where(seen, height, np.nan),
        normals=_normals(skin_x, skin_y, seen),
        shape_normals=_normals(slope_x, slope_y, seen),
        relief_um=_where(seen, 1e3 * relief, 0.0),
        mask=seen,
        pigment=_where(seen, sample(pigment), 1.0),
        landmarks={"pattern": "palm", "period_mm": palm.period_mm, "ridge_depth_um": palm.ridge_depth_um},
    )


def _axes(settings: PalmSettings) -> tuple[Array, Array]:
    """Coarse axes (twice the pitch) whose lengths suit the Fourier transform and cover the patch."""
    pitch = 2.0 * settings.pitch_mm
    width, height = (scipy.fft.next_fast_len(int(np.ceil(s / pitch)) + 1, real=True) for s in settings.size_mm)
    return _centred(width, pitch), -_centred(height, pitch)


def _centred(count: int, pitch: float) -> Array:
    return np.asarray((np.arange(count) - (count - 1) / 2) * pitch, dtype=np.float64)


def _direction(
    rng: np.random.Generator, settings: PalmSettings, x_mm: Array, y_mm: Array
) -> tuple[Array, tuple[float, float] | None]:
    """(H, W) direction of the ridges, and the triradius if there is one."""
    pitch = float(x_mm[1] - x_mm[0])
    shape = (y_mm.size, x_mm.size)
    x, y = np.meshgrid(x_mm, y_mm)
    turn = np.clip(settings.turn_per_mm * rng.standard_normal(2), -2 * settings.turn_per_mm, 2 * settings.turn_per_mm)
    angle = rng.uniform(0.0, np.pi) + turn[0] * x + turn[1] * y
    angle += rng.uniform(0.1, 0.3) * smooth_noise(rng, shape, 9.0 / pitch)
    angle += rng.uniform(0.03, 0.09) * smooth_noise(rng, shape, 2.5 / pitch)
    at = rng.uniform(-0.3, 0.3, 2) * settings.size_mm
    if rng.random() >= settings.delta_share:
        return angle, None
    angle -= 0.5 * np.arctan2(y - at[1], x - at[0])
    return angle, (float(at[0]), float(at[1]))


def _ridges(rng: np.random.Generator, settings: PalmSettings, angle: Array, period_mm: float) -> Array32:
    """(H, W) wave of the ridges on the coarse grid."""
    pitch = 2.0 * settings.pitch_mm
    logs = settings.period_variation * np.clip(smooth_noise(rng, angle.shape, 4.0 / pitch), -2.5, 2.5)
    noise = rng.standard_normal(angle.shape).astype(np.float32)
    return grow_ridges(noise, angle, period_mm * np.exp(logs) / pitch)


def _twice(angle: Array) -> Array:
    """The directions at half the pitch, by the doubled angle so that they may wrap."""
    size = (2 * angle.shape[1], 2 * angle.shape[0])
    cosine, sine = (cv2.resize(f(2.0 * angle), size, interpolation=cv2.INTER_LINEAR) for f in (np.cos, np.sin))
    return np.asarray(0.5 * np.arctan2(sine, cosine) % np.pi)


def _where(seen: NDArray[np.bool_], values: Array, beside: float) -> Array32:
    return np.where(seen, values, beside).astype(np.float32)


def _normals(slope_x: Array, slope_y: Array, seen: NDArray[np.bool_]) -> Array32:
    normals = np.stack([-slope_x, -slope_y, np.ones_like(slope_x)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return np.where(seen[..., None], normals, 0.0).astype(np.float32)


# Ranges that palms are drawn from.


@dataclass(frozen=True, slots=True)
class PalmSettings:
    """Ranges that a palm is drawn from."""

    size_mm: tuple[float, float] = (44.0, 34.0)
    """Width and height of the patch."""
    pitch_mm: float = 0.05
    """Grid pitch of the patch's relief."""
    period_mm: tuple[float, float] = (0.48, 0.62)
    """Mean ridge period."""
    period_variation: float = 0.06
    """Relative standard deviation within a palm, over distances of about 5 mm."""
    ridge_depth_um: tuple[float, float] = (20.0, 60.0)
    """Mean height of ridges over valleys: flatter than on fingers."""
    turn_per_mm: float = 0.02
    """Standard deviation of the steady turn of the ridges' direction, rad/mm, along each axis."""
    delta_share: float = 0.15
    """Share of the patches that hold a triradius."""
    principal: tuple[int, int] = (0, 3)
    """Principal lines in the patch, inclusive."""
    principal_depth_um: tuple[float, float] = (90.0, 280.0)
    """Of the principal lines, 0 to 300."""
    wrinkles: tuple[int, int] = (10, 60)
    """Finer lines, inclusive."""
    wrinkle_depth_um: tuple[float, float] = (18.0, 50.0)
    """Of the finer lines, 0 to 100."""
    darkening: tuple[float, float] = (0.05, 0.25)
    """Loss of diffuse reflectance at the bottom of a line of 0.2 mm."""
    mottling: tuple[float, float] = (0.01, 0.06)
    """Standard deviation of the blotches' diffuse reflectance, over distances of about 2 mm."""
    radius_mm: tuple[float, float] = (35.0, 150.0)
    """Radii of curvature of the patch along its two axes."""

    def __post_init__(self) -> None:
        require(min(self.size_mm) >= 4.0, f"palm.size_mm must be at least 4 mm each way, but it is {self.size_mm}.")
        for name, low, high in (
            ("period_mm", 0.3, 1.0),
            ("ridge_depth_um", 0.0, 200.0),
            ("principal", 0, 10),
            ("principal_depth_um", 0.0, 300.0),
            ("wrinkles", 0, 400),
            ("wrinkle_depth_um", 0.0, 100.0),
            ("darkening", 0.0, 0.8),
            ("mottling", 0.0, 0.2),
            ("radius_mm", 20.0, 1e6),
        ):
            least, most = getattr(self, name)
            require(
                low <= least <= most <= high,
                f"palm.{name} must be (low, high) within {low} to {high}, but it is ({least}, {most}).",
            )
        require(
            0 < self.pitch_mm <= self.period_mm[0] / 8,
            f"palm.pitch_mm must be an eighth of the least ridge period or less, but it is {self.pitch_mm}.",
        )
        require(0 <= self.period_variation <= 0.15, "palm.period_variation must lie in [0, 0.15].")
        require(0 <= self.turn_per_mm <= 0.2, "palm.turn_per_mm must lie in [0, 0.2].")
        require(0 <= self.delta_share <= 1, "palm.delta_share must lie in [0, 1].")
