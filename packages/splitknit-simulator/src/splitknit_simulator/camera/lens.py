"""The simulated lens: which way every pixel looks, where a point appears, and depth of field.

Written apart from the code that undoes it (:mod:`splitknit.imaging.view`). The distortion is the
usual one of five coefficients k1, k2, p1, p2, k3 on normalised coordinates (Brown 1966; OpenCV's
order), rows running down.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit import Camera
from splitknit.errors import require
from splitknit.model import Array, FloatArray

Numbers = Array | NDArray[np.intp]


class SightLines(NamedTuple):
    """Lines of sight: at the height z a pixel looks at (x - z slope_x, y - z slope_y)."""

    x: Array  # mm, where the line meets z = 0
    y: Array
    slope_x: Array  # mm sideways per mm downwards; zero for parallel rays
    slope_y: Array

    def some(self, which: Any) -> SightLines:
        """The lines with these indices."""
        return SightLines(*(part[which] for part in self))

    def at(self, z: Array | FloatArray | float) -> tuple[Array, Array, Array]:
        """x, y and z of the points at heights `z`."""
        x, y = self.x - self.slope_x * z, self.y - self.slope_y * z
        return x, y, np.broadcast_to(z, x.shape)

    def along(self, x: Array, y: Array, z: Array) -> Array:
        """Change per mm of height along the lines of a function with the gradient (x, y, z)."""
        return z - self.slope_x * x - self.slope_y * y

    @property
    def length(self) -> Array:
        """mm of the lines per mm of height."""
        return np.sqrt(1.0 + self.slope_x**2 + self.slope_y**2)

    @property
    def towards_camera(self) -> Array:
        """(..., 3) unit vectors to the camera."""
        up = np.stack([-self.slope_x, -self.slope_y, np.ones_like(self.x)], axis=-1)
        return up / self.length[..., None]


def sight_lines(camera: Camera, columns: Numbers, rows: Numbers) -> SightLines:
    """The lines of sight of pixels; `columns` and `rows` broadcast."""
    if camera.model == "perspective":
        right, up = slopes_of_pixels(camera, columns, rows)
        return SightLines(right * camera.height_mm, up * camera.height_mm, right, up)
    x = (columns - (camera.image_size[1] - 1) / 2) / camera.px_per_mm
    y = ((camera.image_size[0] - 1) / 2 - rows) / camera.px_per_mm
    return SightLines(*np.broadcast_arrays(x, y, 0.0 * x, 0.0 * y))


def slopes_of_pixels(camera: Camera, columns: Numbers, rows: Numbers) -> tuple[Array, Array]:
    """Direction of a perspective camera's rays: (x, y) in mm that they move sideways per mm
    downwards.

    x right, y up; `columns` and `rows` broadcast. The ray of a pixel starts at (0, 0, height_mm).
    """
    fx, fy, cx, cy, skew = _matrix(camera)
    v = (np.asarray(rows, dtype=np.float64) - cy) / fy
    u = (np.asarray(columns, dtype=np.float64) - cx - skew * v) / fx
    u, v = np.broadcast_arrays(u, v)
    x, y = u.copy(), v.copy()
    miss = 0.0
    with np.errstate(over="ignore", invalid="ignore"):
        # a contraction wherever a lens is invertible
        for _ in range(60 if any(camera.distortion or ()) else 0):
            moved_x, moved_y = _distorted(camera, x, y)
            step_x, step_y = u - moved_x, v - moved_y
            x, y = x + step_x, y + step_y
            miss = max(
                float(np.abs(step_x).max(initial=0.0)), float(np.abs(step_y).max(initial=0.0))
            )
            if not 1e-12 <= miss < 1e3:
                break
    require(
        miss < 1e-8,
        f"the lens distortion {list(camera.distortion or ())} folds the picture over itself; give"
        " coefficients that can be undone all over the picture.",
    )
    return x, -y


def picture_on_plane(camera: Camera) -> tuple[float, float, float]:
    """Where the picture lies on the finger plane: x of its middle, y of its lower and of its upper
    border, in mm."""
    rows, columns = camera.image_size
    middle = np.full(3, 0.5 * (columns - 1))
    places = np.array([0.5 * (rows - 1), rows - 0.5, -0.5])
    lines = sight_lines(camera, middle, places)
    return float(lines.x[0]), float(lines.y[1]), float(lines.y[2])


def px_per_mm_at(camera: Camera, z_mm: float) -> float:
    """Pixels per millimetre of what lies at the height `z_mm`, in the middle of the picture."""
    if camera.model == "orthographic":
        return camera.px_per_mm
    fx, fy, *_ = _matrix(camera)
    return float(np.sqrt(fx * fy)) / (camera.height_mm - z_mm)


def fall_off(camera: Camera) -> FloatArray:
    """(H, W) fraction of the light that the lens lets through: 1 + a r^2 + b r^4 + ... of
    `camera.shading`.

    r is the distance from the picture's centre over half its diagonal.
    """
    rows, columns = camera.image_size
    down = (np.arange(rows) - 0.5 * (rows - 1))[:, None]
    right = (np.arange(columns) - 0.5 * (columns - 1))[None, :]
    squared = (down * down + right * right) / (0.25 * (rows * rows + columns * columns))
    fraction = np.zeros_like(squared)
    for coefficient in reversed(camera.shading):
        fraction = (fraction + coefficient) * squared
    return np.asarray(1.0 + fraction, dtype=np.float32)


def pixels_of_points(camera: Camera, x: Array, y: Array, z: Array) -> tuple[Array, Array]:
    """Column and row at which points (mm, the rig's frame) appear to any camera; arrays
    broadcast."""
    height, width = camera.image_size
    if camera.model == "orthographic":
        column = x * camera.px_per_mm + (width - 1) / 2 + 0.0 * z
        return np.asarray(column), (height - 1) / 2 - y * camera.px_per_mm + 0.0 * z
    fx, fy, cx, cy, skew = _matrix(camera)
    depth = camera.height_mm - z
    u, v = _distorted(camera, x / depth, -y / depth)
    return fx * u + skew * v + cx, fy * v + cy


def _matrix(camera: Camera) -> tuple[float, float, float, float, float]:
    require(camera.model == "perspective", "only a perspective camera's rays spread.")
    assert camera.matrix is not None
    m = np.asarray(camera.matrix, dtype=np.float64)
    return float(m[0, 0]), float(m[1, 1]), float(m[0, 2]), float(m[1, 2]), float(m[0, 1])


def _distorted(camera: Camera, x: Array, y: Array) -> tuple[Array, Array]:
    coefficients = tuple(camera.distortion or ())
    require(
        len(coefficients) <= 5, "the twin's lens knows the five coefficients k1, k2, p1, p2, k3."
    )
    k1, k2, p1, p2, k3 = (*coefficients, *(0.0,) * (5 - len(coefficients)))
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return (
        x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
        y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
    )


# Depth of field of a thin lens, as blur that grows with the distance from the plane in focus.


def blur_sigma_px(
    depth_mm: FloatArray,
    focus_mm: float,
    camera_height_mm: float,
    aperture_mm: float,
    px_per_mm: float,
) -> FloatArray:
    """Standard deviation, per axis, of the disc that a point at height `depth_mm` becomes on the
    plane in focus.

    A point d below the plane in focus, which is D from the pupil, becomes a disc of the diameter
    aperture d / (D + d) there (similar triangles); a disc of diameter c has the standard deviation
    c / 4 per axis.
    """
    distance = camera_height_mm - focus_mm
    below = focus_mm - depth_mm
    disc_mm = aperture_mm * np.abs(below) / (distance + below)
    return np.asarray(0.25 * px_per_mm * disc_mm, dtype=np.float32)


_BLUR_LEVELS_PER_DOUBLING = 2
"""Evenly blurred images for each doubling of the blur's width; pixels interpolate between them.
Chosen on: speed."""


def defocus(image: FloatArray, sigma_px: FloatArray) -> FloatArray:
    """Blur (H, W, C) `image` by a Gaussian whose width `sigma_px` (H, W) changes from pixel to
    pixel.

    Each pixel interpolates, linearly in the variance, between the two nearest of a ladder of evenly
    blurred images.
    """
    largest = float(sigma_px.max())
    if largest < 0.1:
        return image
    steps = max(int(np.ceil(_BLUR_LEVELS_PER_DOUBLING * np.log2(max(largest / 0.5, 1.0)))), 1)
    ladder = np.concatenate(
        [[0.0], largest * 2.0 ** (np.arange(-steps, 1) / _BLUR_LEVELS_PER_DOUBLING)]
    )
    variance = sigma_px * sigma_px
    result = np.zeros_like(image)
    lower, low = image, 0.0
    for sigma in ladder[1:]:
        blurred = cv2.GaussianBlur(image, (0, 0), float(sigma), borderType=cv2.BORDER_REPLICATE)
        upper = np.asarray(blurred, dtype=np.float32).reshape(image.shape)
        high = float(sigma) ** 2
        inside = (variance >= low) & ((variance < high) | (sigma == ladder[-1]))
        fraction = np.clip((variance - low) / (high - low), 0.0, 1.0).astype(np.float32)[..., None]
        result = np.where(inside[..., None], lower + fraction * (upper - lower), result)
        lower, low = upper, high
    return np.asarray(result, dtype=np.float32)
