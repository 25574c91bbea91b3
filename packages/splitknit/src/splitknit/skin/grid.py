"""The pixel grids on which skin is reconstructed, and the Fourier filters on them."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.finger.regions import largest_component
from splitknit.imaging.geometry import local_mean, nearest_known
from splitknit.imaging.view import View
from splitknit.model import Array, BoolArray, FloatArray, Rig

Slopes = tuple[FloatArray, FloatArray]
"""dz/dx and dz/dy (h, w), y up."""


@dataclass(frozen=True, eq=False)
class Grid:
    """A window of the image at some pitch, and which of its sides cut the finger."""

    mask: BoolArray  # (h, w)
    x_mm: Array  # (w,) or (h, w) on the finger plane
    y_mm: Array  # (h,) or (h, w)
    pitch_mm: float
    # whether the finger goes on beyond the top, bottom, left and right side
    cut: tuple[bool, bool, bool, bool]
    apex_mm: float | None = None
    """Height of a perspective camera: heights are then those along its rays, see
    :mod:`splitknit.imaging.view`."""

    @property
    def view(self) -> View:
        """How the pixels look at the surface."""
        return View(self.x_mm, self.y_mm, self.apex_mm, self.apex_mm is not None)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows, columns."""
        return self.mask.shape[0], self.mask.shape[1]

    @cached_property
    def _margin(self) -> int:
        return int(np.ceil(3.0 / self.pitch_mm))

    @cached_property
    def _size(self) -> tuple[int, int]:
        rows, columns = (cv2.getOptimalDFTSize(n + 2 * self._margin) for n in self.shape)
        return rows, columns

    @cached_property
    def omega(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Angular frequencies along x, along y (up), and their length, rad/mm, of
        :meth:`forward`."""
        wx = (2 * np.pi / self.pitch_mm * np.fft.rfftfreq(self._size[1])[None, :]).astype(
            np.float32
        )
        wy = (-2 * np.pi / self.pitch_mm * np.fft.fftfreq(self._size[0])[:, None]).astype(
            np.float32
        )
        return wx, wy, np.hypot(wx, wy)

    def forward(self, field: FloatArray, extend: bool = False) -> NDArray[np.complex64]:
        """Fourier transform of a field (..., h, w) with a margin of 3 mm: zero, or the border's
        values beyond a cut."""
        margins = self._margin * (np.reshape(self.cut, (2, 2)) & extend)
        whole = [(0, 0)] * (field.ndim - 2)
        field = np.pad(field, [*whole, *margins], mode="edge")
        top, left = self._margin - margins[:, 0]
        padded = np.zeros((*field.shape[:-2], *self._size), dtype=np.float32)
        padded[..., top : top + field.shape[-2], left : left + field.shape[-1]] = field
        return np.asarray(np.fft.rfft2(padded), dtype=np.complex64)

    def inverse(self, spectrum: NDArray[np.complex64]) -> FloatArray:
        """Back from :meth:`forward`, the margin cut off."""
        rows, columns = (slice(self._margin, self._margin + n) for n in self.shape)
        field = np.fft.irfft2(spectrum, self._size)[..., rows, columns]
        return np.ascontiguousarray(field, dtype=np.float32)

    def radial(self, omega: Array, gain: Array) -> FloatArray:
        """Sample a radial gain, given at increasing `omega`, on the frequencies of
        :meth:`forward`."""
        return np.interp(self.omega[2], omega, gain).astype(np.float32)

    def sampled(self, gain: Callable[[Array], Array]) -> FloatArray:
        """A smooth radial gain, a function of rad/mm, on the frequencies of :meth:`forward`."""
        omega = np.linspace(0, float(self.omega[2].max()), 1024)
        return self.radial(omega, gain(omega))

    def smooth(
        self, field: FloatArray, region: BoolArray | FloatArray, sigma_mm: float
    ) -> FloatArray:
        """Gaussian mean of (..., h, w) over `region` (h, w) only; wide Gaussians on a reduced
        copy."""
        sigma = sigma_mm / self.pitch_mm

        def mean(values: FloatArray) -> FloatArray:
            return local_mean(np.where(region > 0, values, 0), region, sigma)[0]

        with ThreadPoolExecutor(2) as pool:
            means = list(pool.map(mean, field.reshape(-1, *self.shape)))
        return np.reshape(means, field.shape)

    @cached_property
    def depth_mm(self) -> FloatArray:
        """Distance of each pixel of the mask from its outline; a cut is an outline too."""
        return cv2.distanceTransform(self.mask.astype(np.uint8), cv2.DIST_L2, 5) * self.pitch_mm


def coarsen(grid: Grid, factor: int) -> Grid:
    """Grid of blocks of `factor` pixels a side, all of which belong to the mask; the largest part
    of it."""
    rows, columns = (n // factor for n in grid.shape)
    blocks = grid.mask[: rows * factor, : columns * factor].reshape(rows, factor, columns, factor)
    # nothing belongs to the mask beyond the border
    whole = np.pad(blocks.all(axis=(1, 3)).astype(np.uint8), 1)
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    mask = largest_component(cv2.morphologyEx(whole, cv2.MORPH_OPEN, cross)[1:-1, 1:-1] > 0)
    if grid.x_mm.ndim == 1:
        x = grid.x_mm[: columns * factor].reshape(columns, factor).mean(axis=1)
        y = grid.y_mm[: rows * factor].reshape(rows, factor).mean(axis=1)
    else:
        x, y = (
            axis[: rows * factor, : columns * factor]
            .reshape(rows, factor, columns, factor)
            .mean(axis=(1, 3))
            for axis in (grid.x_mm, grid.y_mm)
        )
    return Grid(mask, x, y, grid.pitch_mm * factor, grid.cut, grid.apex_mm)


def refine(field: FloatArray, mask: BoolArray, factor: int, shape: tuple[int, int]) -> FloatArray:
    """Smooth copy of a coarse field on the fine grid, continued beyond its mask by the nearest
    values."""
    filled = nearest_known(field, mask)
    rows, columns = filled.shape
    large = cv2.resize(filled, (columns * factor, rows * factor), interpolation=cv2.INTER_CUBIC)
    large = cv2.GaussianBlur(large, (0, 0), factor / 2)
    missing = ((0, max(0, shape[0] - large.shape[0])), (0, max(0, shape[1] - large.shape[1])))
    return np.asarray(np.pad(large, missing, mode="edge")[: shape[0], : shape[1]])


def smooth_step(values: FloatArray) -> FloatArray:
    """Zero below 0, one above 1, smooth between."""
    t = np.clip(values, 0.0, 1.0)
    return t * t * (3 - 2 * t)


# What the preset sees: linear images of a band.


@dataclass(frozen=True, slots=True, eq=False)
class BandImages:
    """Linear images of one band on one grid."""

    channels: tuple[str, ...]  # names of the channels: red, green, blue, nir
    stack: FloatArray  # (C, L, h, w)
    rig: Rig  # `rig.leds[k]` lights image k
    unpolarised: BandImages | None = None
    """Beside a crossed series: the images without films."""
