"""Where every pixel of a calibrated camera looks, and surfaces along its rays.

A camera stands at (0, 0, height) of the rig's frame and looks down. An orthographic camera's rays
are parallel; a perspective camera's pass through its centre, lens distortion taken off, and meet
the finger plane (z = 0) where this module says.

Surfaces *along the rays*: with D the camera's height and r the distance of a surface point from the
camera's centre, h = D log(D / r) plays the part that the height plays under parallel rays. In the
frame that is turned so that the pixel's ray is its z axis, the slopes of the surface are the
derivatives of h by the angle times D. So the equations of slopes and light under parallel rays hold
in each pixel's own frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from splitknit.errors import require
from splitknit.model import Array, Camera, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """Where on the finger plane (z = 0) every pixel looks, and how its ray runs."""

    x_mm: Array
    """(W,) or (H, W)."""
    y_mm: Array
    """(H,) or (H, W)."""
    apex_mm: float | None = None
    """Height of the camera's centre, through which all rays pass; None for parallel rays."""
    along_rays: bool = False
    """Whether heights run along the rays and vectors are in each pixel's frame; else both in the
    rig's frame."""

    def on_plane(self, chunk: slice = slice(None)) -> tuple[FloatArray, FloatArray]:
        """x and y on the finger plane of the pixels of some rows, to be broadcast to (h, W)."""
        x = (self.x_mm if self.x_mm.ndim == 1 else self.x_mm[chunk]).astype(np.float32)
        y = (self.y_mm[chunk, None] if self.y_mm.ndim == 1 else self.y_mm[chunk]).astype(np.float32)
        return x, y

    def points(
        self, height_mm: FloatArray, chunk: slice = slice(None)
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """x, y and z (h, W) of the surface points that the pixels of some rows see."""
        x, y = self.on_plane(chunk)
        if self.apex_mm is None:
            return (
                np.broadcast_to(x, height_mm.shape),
                np.broadcast_to(y, height_mm.shape),
                height_mm,
            )
        apex = np.float32(self.apex_mm)
        if not self.along_rays:
            nearer = 1.0 - height_mm / apex
            return x * nearer, y * nearer, height_mm
        # r over the distance at which the ray meets the plane
        nearer = np.exp(-height_mm / apex) / np.sqrt(1.0 + (x * x + y * y) / (apex * apex))
        return x * nearer, y * nearer, apex * (1.0 - nearer)

    def along(self, z_mm: FloatArray) -> FloatArray:
        """Heights along the rays (H, W) of surface points at `z_mm` (H, W): what :meth:`points`
        takes back to them."""
        if self.apex_mm is None:
            return z_mm
        x, y = self.on_plane()
        apex = np.float32(self.apex_mm)
        far = np.sqrt(x * x + y * y + apex * apex) * (1.0 - z_mm / apex)
        return np.asarray(apex * np.log(apex / far))

    def of_rows(self, chunk: slice) -> View:
        """The view of some rows."""
        x = self.x_mm if self.x_mm.ndim == 1 else self.x_mm[chunk]
        return View(x, self.y_mm[chunk], self.apex_mm, self.along_rays)

    def turned(
        self, vectors: FloatArray, chunk: slice = slice(None), where: Any = None
    ) -> FloatArray:
        """Vectors (L, 3, h, W), or (L, 3, n) at the pixels `where` (h, W) of some rows, in the
        pixels' own frames."""
        if not self._spread:
            return vectors
        a, b, c = self._towards(chunk, where)
        vx, vy, vz = np.moveaxis(vectors, 1, 0)
        sideways = a * vx + b * vy
        common = sideways / (1.0 + c) + vz
        return np.stack([vx - a * common, vy - b * common, sideways + c * vz], axis=1)

    def in_rig(self, vectors: FloatArray) -> FloatArray:
        """Vectors (H, W, 3) of the pixels' own frames in the rig's frame: the inverse of
        :meth:`turned`."""
        if not self._spread:
            return vectors
        a, b, c = self._towards()
        rx, ry, rz = np.moveaxis(vectors, -1, 0)
        sideways = a * rx + b * ry
        common = rz - sideways / (1.0 + c)
        return np.stack([rx + a * common, ry + b * common, c * rz - sideways], axis=-1)

    def stretch(
        self, pitch_mm: float, shape: tuple[int, int]
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Movements (x_x, x_y, y_x, y_y), (H, W) each, in the pixel's frame, over `pitch_mm`, on an
        image of `shape`.

        Along the frame's x by a step of a pixel to the right (``x_x``) and up (``x_y``), and along
        its y. Under parallel rays on a regular grid: 1, 0, 0, 1.
        """
        x, y = (np.broadcast_to(v, shape) for v in self.on_plane())
        x_right = np.gradient(x, axis=1) / pitch_mm
        x_up = -np.gradient(x, axis=0) / pitch_mm
        y_right = np.gradient(y, axis=1) / pitch_mm
        y_up = -np.gradient(y, axis=0) / pitch_mm
        if not self._spread:
            return x_right, x_up, y_right, y_up
        a, b, c = self._towards()
        k = 1.0 / (1.0 + c)
        xx = c * (1 - a * a * k)
        xy = -c * a * b * k
        yy = c * (1 - b * b * k)
        return (
            xx * x_right + xy * y_right,
            xx * x_up + xy * y_up,
            xy * x_right + yy * y_right,
            xy * x_up + yy * y_up,
        )

    @property
    def _spread(self) -> bool:
        return self.along_rays and self.apex_mm is not None

    def _towards(
        self, chunk: slice = slice(None), where: Any = None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Unit vectors from the plane towards the camera, at the pixels `where` (h, W) of some
        rows."""
        assert self.apex_mm is not None
        x, y = np.broadcast_arrays(*self.on_plane(chunk))
        if where is not None:
            x = x[where]
            y = y[where]
        apex = np.float32(self.apex_mm)
        far = np.sqrt(x * x + y * y + apex * apex)
        return -x / far, -y / far, apex / far


def view_of(
    camera: Camera,
    rows: slice | None = None,
    columns: slice | None = None,
    *,
    binning: float = 1,
    along_rays: bool = False,
) -> View:
    """View of a window of the camera's image, of blocks of `binning` pixels a side (what fills no
    block is dropped)."""
    places = []
    for part, size in zip((rows, columns), camera.image_size, strict=True):
        start, stop, _ = (part or slice(None)).indices(size)
        blocks = np.arange(int((stop - start) // binning), dtype=np.float64)
        places.append(start + blocks * binning + 0.5 * (binning - 1))
    row, column = places
    if camera.model == "orthographic":
        return View(*_pixel_axes_mm(camera, row, column))
    some_rows, some_columns = (_lattice(axis) for axis in places)
    grid = np.stack(np.meshgrid(some_columns, some_rows), axis=-1).reshape(-1, 2)
    points = plane_points(camera, grid).reshape(some_rows.size, some_columns.size, 2)
    # slow to import; lenses with distortion alone
    from scipy.interpolate import RectBivariateSpline

    x, y = (
        RectBivariateSpline(some_rows, some_columns, points[..., axis])(row, column)
        for axis in range(2)
    )
    return View(x, y, camera.height_mm, along_rays)


def _lattice(axis: Array) -> Array:
    first = float(axis[0])
    last = float(axis[-1])
    # 16 pixels are fine enough for a lens's distortion, and quick
    count = max(int(np.ceil((last - first) / 16)) + 1, 4)
    return np.linspace(first, max(last, first + 3.0), count)


def _pixel_axes_mm(camera: Camera, rows: Array, columns: Array) -> tuple[Array, Array]:
    """x of `columns` and y of `rows`, in mm on the finger plane, under parallel rays."""
    height, width = camera.image_size
    x = (columns - (width - 1) / 2) * camera.pitch_mm
    return x, ((height - 1) / 2 - rows) * camera.pitch_mm


def _distortion(camera: Camera) -> Array:
    return np.asarray(camera.distortion or (0.0,) * 5, dtype=np.float64)


def plane_points(camera: Camera, pixels: Any) -> Array:
    """(N, 2) x and y in mm on the plane z = 0 that `pixels` (N, 2; column, row, the first pixel's
    centre is (0, 0)) look at."""
    places = np.asarray(pixels, dtype=np.float64)
    if camera.model == "orthographic":
        return np.stack(_pixel_axes_mm(camera, places[:, 1], places[:, 0]), axis=1)
    matrix = camera.matrix
    assert matrix is not None
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-10)
    rays = cv2.undistortPointsIter(
        places[:, None], matrix, _distortion(camera), np.eye(3), matrix, criteria
    )[:, 0]
    rays = (rays - matrix[:2, 2]) / np.diag(matrix)[:2]
    rays[:, 0] -= matrix[0, 1] / matrix[0, 0] * rays[:, 1]
    return rays * (camera.height_mm, -camera.height_mm)


def pixels_of(camera: Camera, points_mm: Any) -> Array:
    """Pixels (N, 2), column and row, at which the camera sees points (N, 3) in mm, or places (N, 2)
    on the finger plane: the inverse of `plane_points`. Raises BadInput for points at or beyond a
    perspective camera's height.
    """
    points = np.asarray(points_mm, dtype=np.float64)
    points = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
    rows, columns = camera.image_size
    if camera.model == "orthographic":
        column = points[:, 0] * camera.px_per_mm + (columns - 1) / 2
        return np.stack([column, (rows - 1) / 2 - points[:, 1] * camera.px_per_mm], axis=1)
    require((points[:, 2] < camera.height_mm).all(), "points_mm must lie below the camera.")
    assert camera.matrix is not None
    seen = np.stack([points[:, 0], -points[:, 1], camera.height_mm - points[:, 2]], axis=1)
    matrix = np.asarray(camera.matrix, np.float64)
    pixels, _ = cv2.projectPoints(seen, np.zeros(3), np.zeros(3), matrix, _distortion(camera))
    return np.asarray(pixels[:, 0], dtype=np.float64)


# How the lens darkens towards the corners.


def lens_shading(  # noqa: PLR0917
    shading: Sequence[float],
    image_size: Sequence[int],
    first_row: int = 0,
    first_column: int = 0,
    binning: float = 1,
    shape: Sequence[int] | None = None,
) -> FloatArray:
    """(h, w) brightness of the lens relative to the image's centre: 1 + a r^2 + b r^4 + ...

    `shading`: a, b, ... of :class:`splitknit.model.Camera`; `image_size`: rows, columns of the
    whole image, half whose diagonal is r = 1; `first_row`, `first_column`: where the window starts;
    `binning`: pixels a side of its blocks; `shape`: of the window in blocks, by default that of the
    image, for blocks of one pixel.
    """
    rows, columns = image_size
    height, width = (shape or image_size)[:2]
    middle = 0.5 * (binning - 1)
    y = first_row + np.arange(height) * binning + middle - 0.5 * (rows - 1)
    x = first_column + np.arange(width) * binning + middle - 0.5 * (columns - 1)
    squared = (y[:, None] ** 2 + x[None, :] ** 2) / (0.25 * (rows**2 + columns**2))
    return shading_at(shading, squared).astype(np.float32)


def shading_at(shading: Sequence[float], squared: Array) -> Array:
    """1 + a r^2 + b r^4 + ... at `squared` distances r^2 (any shape), see
    :class:`splitknit.model.Camera`."""
    brightness = np.ones_like(squared)
    for k, coefficient in enumerate(shading):
        brightness += coefficient * squared ** (k + 1)
    return brightness
