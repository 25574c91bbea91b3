"""The ridge band: what two impressions of one finger have in common, on a grid of fixed pitch,
lying flat.

The relief is brought upright, unrolled across the finger (a step along a row is a step along the
skin), low-passed, freed from everything wider than a ridge, and made even in contrast. Roll then
shifts ridges more than it bends them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.checks import check_mask
from splitknit.errors import require
from splitknit.imaging.geometry import gaussian_mean, height_gradients, sampled_at
from splitknit.model import Array, BoolArray, FloatArray
from splitknit_match.records.minutiae_record import LARGEST_MM2

AnyArray = np.ndarray[Any, Any]
MM_PER_INCH = 25.4
"""Source: definition of the inch."""


@dataclass(frozen=True, slots=True, eq=False)
class RidgeBand:
    """Ridges of even contrast, as the camera sees them (not mirrored), tip up."""

    value: FloatArray
    """(H, W) about unit variance, ridges positive, zero where not `valid`."""
    valid: BoolArray
    """(H, W) where ridges were found."""
    pitch_mm: float

    @property
    def area_mm2(self) -> float:
        """Skin with ridges."""
        return float(self.valid.sum()) * self.pitch_mm**2


_FINEST_MM = 1e-3  # finer pixels are not a finger's, and need windows that fill the memory
_COARSEST_MM = 10.0  # coarser pixels are not a finger's
_LONGEST_MM = 500.0  # longer surfaces are not a finger's, and need grids that fill the memory
PITCH_MM = 0.1  # side of a pixel of the band
_RIDGE_MM = 0.32
"""Sigma of the Gaussian mean that is subtracted, to remove what is wider than a ridge."""
_WINDOW_MM = 0.6
"""Sigma of the window over which contrast is made even and ridges are tested for one direction."""
_FLOOR = 0.3
"""Contrast below this fraction of the finger's median is not raised further; half of it is not a
ridge at all."""
_SLANT_DEG = 60.0  # skin seen at a steeper slant is left out


def ridge_band(  # noqa: PLR0917 - as the guide calls it
    ridge_mm: FloatArray,
    mask: BoolArray,
    pitch_mm: float,
    shape_mm: FloatArray | None = None,
    input_from_upright: Array | None = None,
    upright_size: tuple[int, int] | None = None,
    *,
    band_mm: float = PITCH_MM,
) -> RidgeBand:
    """Return the ridge band of a relief.

    `ridge_mm`: (H, W) ridges up, of any unit, ignored outside `mask`; `pitch_mm`: of the input on
    the finger plane; `shape_mm`: (H, W) finger without its ridges: without it nothing is unrolled
    and no slant is known; `input_from_upright`: (3, 3), takes (column, row, 1) of the upright
    frame, of `upright_size` rows and columns, to the input; without it the input is upright;
    `band_mm`: pitch of the band. `valid` of the result may be empty (failure to acquire). Raises
    BadInput if shapes disagree, the mask is empty, or the pitch is not positive.

    Source: Hong, Wan and Jain 1998, Fingerprint image enhancement (normalisation, orientation by
    the structure tensor); Chen, Parziale, Diaz-Santana and Jain 2006, 3D touchless fingerprints:
    compatibility with legacy rolled images (unrolling by arc length).
    """
    require(
        _FINEST_MM <= pitch_mm <= _COARSEST_MM,
        f"pitch_mm must be a number from {_FINEST_MM:g} to {_COARSEST_MM:g}, but it is {pitch_mm}.",
    )
    require(
        ridge_mm.ndim == 2, f"ridge_mm must have the shape (H, W), but it has {ridge_mm.shape}."
    )
    mask = check_mask(mask, (ridge_mm.shape[0], ridge_mm.shape[1]))
    for name, field in (("ridge_mm", ridge_mm), ("shape_mm", shape_mm)):
        if field is not None:
            require(
                field.shape == mask.shape,
                f"{name} must have the shape {mask.shape}, but it has {field.shape}.",
            )
            mask = mask & np.isfinite(field)
            require(mask.any(), f"{name} is NaN all over the mask.")
            deep = bool((np.abs(field[mask]) > _LONGEST_MM).any())
            require(
                not deep,
                f"{name} holds heights beyond {_LONGEST_MM:g} mm, which are not a finger's.",
            )
    transform = np.eye(3) if input_from_upright is None else input_from_upright
    size = upright_size or (mask.shape[0], mask.shape[1])
    area_mm2 = float(mask.sum()) * pitch_mm**2
    # largest ridge band with its margins, 200 x 200 mm; it takes 100 bytes a pixel
    require(
        max(size) * pitch_mm <= _LONGEST_MM
        and size[0] * size[1] * (pitch_mm / band_mm) ** 2 <= 4_000_000
        and area_mm2 <= LARGEST_MM2,
        f"the surface is {max(size) * pitch_mm:.0f} mm long and shows {area_mm2:.0f} mm², more"
        f" than a finger's {LARGEST_MM2:.0f}; check its pitch ({pitch_mm:g} mm).",
    )
    columns, rows, slant_cos = band_places(
        mask, shape_mm, transform, size, pitch_mm=pitch_mm, band_mm=band_mm
    )
    # low-pass, then sample
    sigma = 0.05 / pitch_mm  # sigma of the low-pass before sampling
    weight = gaussian_mean(mask.astype(np.float32), sigma)
    smooth = gaussian_mean(np.where(mask, ridge_mm, 0.0).astype(np.float32), sigma) / np.maximum(
        weight, 1e-3
    )
    value = sampled_at(smooth, columns, rows, outside=0.0)
    inside = sampled_at(weight, columns, rows, outside=0.0) > 0.5
    inside &= slant_cos >= np.cos(np.deg2rad(_SLANT_DEG))
    # ridges of even contrast; what is wider is taken out
    weight = inside.astype(np.float32)
    narrow, window = _RIDGE_MM / band_mm, _WINDOW_MM / band_mm
    total = np.maximum(gaussian_mean(weight, narrow), 1e-3)
    ridges: AnyArray = np.where(inside, value, 0.0)
    for _ in range(2):  # twice: the first pass leaves something of a slope beside the edge
        ridges = (ridges - gaussian_mean(ridges, narrow) / total) * weight
    fraction = np.maximum(gaussian_mean(weight, window), 1e-3)
    spread = np.sqrt(np.maximum(gaussian_mean(ridges * ridges, window) / fraction, 0.0))
    typical = float(np.median(spread[inside])) if inside.any() else 0.0
    if typical <= 0.0:
        return RidgeBand(np.zeros_like(ridges), np.zeros_like(inside), band_mm)
    flat = ridges / np.maximum(spread, _FLOOR * typical)
    # coherence of the structure tensor. Source: Bigun and Granlund 1987, Optimal orientation
    # detection
    across, down = cv2.Sobel(flat, cv2.CV_32F, 1, 0), cv2.Sobel(flat, cv2.CV_32F, 0, 1)
    xx, yy, xy = (
        gaussian_mean(part, window) for part in (across * across, down * down, across * down)
    )
    total = xx + yy
    coherence = np.hypot(xx - yy, 2 * xy) / np.maximum(total, 1e-6 * max(float(total.max()), 1e-30))
    # skin whose ridges have less coherence (0 no direction, 1 parallel) is left out
    valid = inside & (spread > 0.5 * _FLOOR * typical) & (coherence >= 0.2)
    # specks and threads of valid skin at the edge are not used
    element = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))
    valid = cv2.morphologyEx(valid.view(np.uint8), cv2.MORPH_OPEN, element) > 0
    return RidgeBand(np.where(valid, flat, 0.0), valid, band_mm)


def print_band(
    image: NDArray[np.uint8], ppi: float = 500.0, inside: BoolArray | None = None
) -> RidgeBand:
    """Return the ridge band of a print: mirrored back to what a camera sees, ridges (dark)
    positive.

    `image`: (H, W) uint8, ridges dark, upright, as ink on paper; `inside`: (H, W) bool, where there
    are ridges, by default wherever there is contrast; without any, nothing is valid.
    """
    pitch = MM_PER_INCH / ppi
    ink = np.ascontiguousarray(255.0 - image[:, ::-1].astype(np.float32))
    detail = ink - gaussian_mean(ink, _RIDGE_MM / pitch)
    spread = np.sqrt(gaussian_mean(detail * detail, 0.5 * _WINDOW_MM / pitch))
    finger = spread > 0.3 * float(np.quantile(spread, 0.9))
    if inside is not None:
        finger &= inside[:, ::-1]
    if not finger.any():
        # a band without any valid skin
        finger, ink = np.ones(image.shape, dtype=bool), np.zeros_like(ink)
    return ridge_band(ink, finger, pitch)


def band_places(
    mask: BoolArray,
    shape_mm: FloatArray | None,
    transform: Array,
    size: tuple[int, int],
    *,
    pitch_mm: float,
    band_mm: float = PITCH_MM,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Where each pixel of the band lies in the input (columns, rows), and the cosine of the slant
    there."""
    step = band_mm / pitch_mm
    grid = max(1, int(np.ceil(size[0] / step))), max(1, int(np.ceil(size[1] / step)))
    row, column = (np.arange(length, dtype=float) * step for length in grid)
    flat = np.broadcast_to(column, grid)
    if shape_mm is None:
        return (*_to_input(flat, row, transform), np.ones(grid, dtype=np.float32))
    # slopes of the shape, on a grid of 0.25 mm and smooth: ridges must not stretch the skin
    reduced = max(1, int(0.25 / pitch_mm))
    small = max(1, mask.shape[1] // reduced), max(1, mask.shape[0] // reduced)
    weight = cv2.resize(mask.astype(np.float32), small, interpolation=cv2.INTER_AREA)
    height: AnyArray = cv2.resize(
        np.where(mask, shape_mm, 0.0), small, interpolation=cv2.INTER_AREA
    )
    factor = mask.shape[1] / small[0]
    inside = weight > 0.5
    height = np.where(inside, height / np.maximum(weight, 0.5), np.nan)
    sigma = 0.6 / (pitch_mm * factor)
    fraction = inside.astype(np.float32)
    total = np.maximum(gaussian_mean(fraction, sigma), 1e-3)
    limit = np.float32(np.tan(np.deg2rad(_SLANT_DEG)))
    x, y = _to_input(flat, row, transform)
    place = (x + 0.5) / factor - 0.5, (y + 0.5) / factor - 0.5
    known = sampled_at(fraction, *place, outside=0.0) > 0.5
    right, up = (
        sampled_at(
            gaussian_mean(np.clip(slope, -2 * limit, 2 * limit), sigma) / total, *place, outside=0.0
        )
        for slope in height_gradients(height, pitch_mm * factor)
    )
    across = np.where(known, transform[0, 0] * right - transform[1, 0] * up, 0.0)
    along = np.where(known, transform[0, 1] * right - transform[1, 1] * up, 0.0)
    slant_cos = (1.0 / np.sqrt(1.0 + across**2 + along**2)).astype(np.float32)
    # arc length across the finger, from its middle
    length = np.sqrt(1.0 + np.clip(across, -limit, limit) ** 2)
    arc = np.cumsum(length, axis=1) - 0.5 * length
    anywhere = np.flatnonzero(known.any(axis=0))
    middle = int(anywhere.mean()) if anywhere.size else grid[1] // 2
    arc -= arc[:, middle : middle + 1]
    wanted = np.arange(np.floor(arc[:, 0].min()), np.ceil(arc[:, -1].max()) + 1.0)
    source = np.stack([np.interp(wanted, line, column, left=-1e6, right=-1e6) for line in arc])
    own = np.broadcast_to(np.arange(grid[0], dtype=np.float32)[:, None], source.shape)
    slant_cos = sampled_at(slant_cos, (source / step).astype(np.float32), own, outside=0.0)
    return (*_to_input(source, row, transform), slant_cos)


def _to_input(columns: Array, rows: Array, transform: Array) -> tuple[FloatArray, FloatArray]:
    """Columns and rows in the input of columns (h, w) and rows (h,) of the upright frame."""
    x, y = (line[0] * columns + line[1] * rows[:, None] + line[2] for line in transform[:2])
    return x.astype(np.float32), y.astype(np.float32)
