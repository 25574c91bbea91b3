"""The ridge band: what two impressions of one finger have in common, on a grid of fixed pitch, lying flat.

The relief is brought upright, unrolled across the finger (a step along a row is a step along the skin), low-passed,
freed from everything wider than a ridge, and made even in contrast. Roll then shifts ridges more than it bends them.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import check_mask, require
from splitknit.matching.unroll import AnyArray, GridSettings, band_places, blur, sample
from splitknit.model import BoolArray, FloatArray

MM_PER_INCH = 25.4
_FINEST_MM, _COARSEST_MM, _LONGEST_MM = 1e-3, 10.0, 500.0
"""Pixels and surfaces beyond these are no finger's, and ask for grids and windows that fill the memory."""


@dataclass(frozen=True, slots=True)
class RidgeBandSettings:
    """How the ridge band is made."""

    pitch_mm: float = 0.1
    """Side of a pixel of the band."""
    ridge_mm: float = 0.32
    """Sigma of the Gaussian mean that is taken away: what is wider than a ridge."""
    noise_mm: float = 0.05
    """Sigma of the low-pass before sampling."""
    window_mm: float = 0.6
    """Sigma of the window over which contrast is made even and ridges are tested for one direction."""
    floor: float = 0.3
    """Contrast below this share of the finger's median is not raised further; half of it is no ridge at all."""
    coherence: float = 0.2
    """Skin whose ridges agree less on a direction (0 none, 1 parallel) is left out."""
    slant_deg: float = 60.0
    """Skin seen at a steeper slant is left out."""
    unroll: bool = True
    """Whether distances across the finger are measured along the skin, where the shape is known."""

    def __post_init__(self) -> None:
        for name in ("pitch_mm", "ridge_mm", "noise_mm", "window_mm"):
            value = getattr(self, name)
            require(np.isfinite(value) and value > 0, f"ridge_band.{name} must be positive, but it is {value}.")
        require(0 <= self.floor <= 1, "ridge_band.floor must lie in [0, 1].")
        require(0 <= self.coherence < 1, "ridge_band.coherence must lie in [0, 1).")
        require(0 < self.slant_deg < 85, "ridge_band.slant_deg must lie in (0, 85).")


@dataclass(frozen=True, slots=True, eq=False)
class RidgeBand:
    """Ridges of even contrast, as the camera sees them (not mirrored), tip up."""

    value: FloatArray
    """(H, W) about unit variance, ridges positive, zero where not `valid`."""
    valid: BoolArray
    """(H, W) where ridges were found."""
    orientation_rad: FloatArray
    """(H, W) direction across which the ridges run (of their normal), counter-clockwise from x, in (-pi/2, pi/2]."""
    coherence: FloatArray
    """(H, W) 0 to 1: how well that direction is held in the window."""
    pitch_mm: float

    @property
    def area_mm2(self) -> float:
        """Skin with ridges."""
        return float(self.valid.sum()) * self.pitch_mm**2


def ridge_band(  # noqa: PLR0917
    ridge_mm: FloatArray,
    mask: BoolArray,
    pitch_mm: float,
    shape_mm: FloatArray | None = None,
    input_from_upright: NDArray[np.float64] | None = None,
    upright_size: tuple[int, int] | None = None,
    settings: RidgeBandSettings | None = None,
) -> RidgeBand:
    """Return the ridge band of a relief.

    Parameters
    ----------
    ridge_mm : (H, W) float32
        Relief, ridges up, of any unit; ignored outside `mask`.
    mask : (H, W) bool
    pitch_mm : float
        Side of a pixel of the input on the finger plane.
    shape_mm : (H, W) float32, optional
        Finger without its ridges, mm; without it nothing is unrolled and no slant is known.
    input_from_upright : (3, 3), optional
        Takes (column, row, 1) of the upright frame to the input; the input is upright where it is missing.
    upright_size : (rows, columns) of the upright frame, optional
    settings : RidgeBandSettings, optional

    Returns
    -------
    RidgeBand
        Whose pixels are `settings.pitch_mm` wide; `valid` may be empty (failure to acquire).

    Raises
    ------
    BadInput
        If shapes disagree, the mask is empty, or the pitch is not positive.

    References
    ----------
    Hong, Wan and Jain 1998, Fingerprint image enhancement (normalisation, orientation by the structure tensor); Chen,
    Parziale, Diaz-Santana and Jain 2006, 3D touchless fingerprints: compatibility with legacy rolled images
    (unrolling by arc length).
    """
    settings = settings or RidgeBandSettings()
    require(
        _FINEST_MM <= pitch_mm <= _COARSEST_MM,
        f"pitch_mm must be a number from {_FINEST_MM:g} to {_COARSEST_MM:g}, but it is {pitch_mm}.",
    )
    require(ridge_mm.ndim == 2, f"ridge_mm must have the shape (H, W), but it has {ridge_mm.shape}.")
    mask = check_mask(mask, (ridge_mm.shape[0], ridge_mm.shape[1])) & np.isfinite(ridge_mm)
    require(bool(mask.any()), "ridge_mm is NaN all over the mask.")
    if shape_mm is not None:
        require(
            shape_mm.shape == mask.shape, f"shape_mm must have the shape {mask.shape}, but it has {shape_mm.shape}."
        )
        mask = mask & np.isfinite(shape_mm)
        require(bool(mask.any()), "shape_mm is NaN all over the mask.")
    for name, field in (("ridge_mm", ridge_mm), ("shape_mm", shape_mm)):
        deep = field is not None and bool((np.abs(field[mask]) > _LONGEST_MM).any())
        require(not deep, f"{name} holds heights beyond {_LONGEST_MM:g} mm, which are no finger's.")
    transform = np.eye(3) if input_from_upright is None else np.asarray(input_from_upright, dtype=np.float64)
    size = mask.shape if upright_size is None else upright_size
    require(
        max(size) * pitch_mm <= _LONGEST_MM,
        f"the surface is {max(size) * pitch_mm:.0f} mm long, more than any finger; check its pitch ({pitch_mm:g} mm).",
    )
    grid = GridSettings(settings.pitch_mm, settings.slant_deg, settings.unroll)
    columns, rows, slant_cos = band_places(mask, shape_mm, transform, (size[0], size[1]), pitch_mm, grid)

    sigma = settings.noise_mm / pitch_mm
    weight = blur(mask.astype(np.float32), sigma)
    known = np.where(mask, ridge_mm, np.float32(0.0)).astype(np.float32)
    smooth = blur(known, sigma) / np.maximum(weight, np.float32(1e-3))
    value = sample(smooth, columns, rows)
    inside = (sample(weight, columns, rows) > 0.5) & (slant_cos >= np.cos(np.deg2rad(settings.slant_deg)))
    return even(value, inside, settings)


def even(value: FloatArray, inside: BoolArray, settings: RidgeBandSettings) -> RidgeBand:
    """Take out what is wider than a ridge, make contrast even, and keep what has ridges.

    `value` (H, W) lies on the band's grid already.
    """
    pitch = settings.pitch_mm
    weight = inside.astype(np.float32)
    narrow, window = settings.ridge_mm / pitch, settings.window_mm / pitch
    total = np.maximum(blur(weight, narrow), np.float32(1e-3))
    ridges: AnyArray = np.where(inside, value, np.float32(0.0)).astype(np.float32)
    for _ in range(2):  # twice: the first pass leaves something of a slope beside the edge
        ridges = (ridges - blur(ridges, narrow) / total) * weight
    share = np.maximum(blur(weight, window), np.float32(1e-3))
    spread = np.sqrt(np.maximum(blur(ridges * ridges, window) / share, np.float32(0.0)))
    typical = float(np.median(spread[inside])) if bool(inside.any()) else 0.0
    empty = np.zeros(value.shape, dtype=np.float32)
    if typical <= 0.0:
        return RidgeBand(empty, np.zeros(value.shape, dtype=np.bool_), empty, empty, pitch)
    flat = ridges / np.maximum(spread, np.float32(settings.floor * typical))
    orientation, coherence = ridge_direction(flat, window)
    valid = inside & (spread > 0.5 * settings.floor * typical) & (coherence >= settings.coherence)
    # specks and threads of valid skin at the edge say nothing
    element = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))
    valid = cv2.morphologyEx(valid.view(np.uint8), cv2.MORPH_OPEN, element).astype(np.bool_)
    return RidgeBand(np.where(valid, flat, np.float32(0.0)), valid, orientation, coherence, pitch)


def print_band(image: NDArray[np.uint8], ppi: float = 500.0, settings: RidgeBandSettings | None = None) -> RidgeBand:
    """Return the ridge band of a print: mirrored back to what a camera sees, ridges (dark) positive.

    Parameters
    ----------
    image : (H, W) uint8
        Grey, ridges dark, upright, as ink on paper.
    ppi : float
        Pixels per inch.

    Raises
    ------
    BadInput
        If it is no grey image or the resolution is not positive.
    """
    settings = settings or RidgeBandSettings()
    require(
        image.ndim == 2 and image.dtype == np.uint8 and image.size > 0,
        f"a print must be (H, W) uint8, not {image.shape} {image.dtype}.",
    )
    require(bool(np.isfinite(ppi)) and ppi > 0, f"ppi must be a positive number, but it is {ppi}.")
    pitch = MM_PER_INCH / ppi
    ink = np.ascontiguousarray(255.0 - image[:, ::-1].astype(np.float32))
    detail = ink - blur(ink, settings.ridge_mm / pitch)
    spread = np.sqrt(blur(detail * detail, 0.5 * settings.window_mm / pitch))
    finger = spread > 0.3 * float(np.quantile(spread, 0.9))
    if not bool(finger.any()):
        finger = np.ones(image.shape, dtype=np.bool_)
    return ridge_band(ink, finger, pitch, settings=settings)


def ridge_direction(ridges: AnyArray, sigma: float) -> tuple[FloatArray, FloatArray]:
    """Direction across the ridges (counter-clockwise from x, y up) and its coherence, by the structure tensor.

    References
    ----------
    Bigun and Granlund 1987, Optimal orientation detection of linear symmetry.
    """
    across = cv2.Sobel(ridges, cv2.CV_32F, 1, 0)
    up = -cv2.Sobel(ridges, cv2.CV_32F, 0, 1)
    xx, yy, xy = (blur(part, sigma) for part in (across * across, up * up, across * up))
    difference, total = xx - yy, xx + yy
    strength = np.hypot(difference, 2 * xy)
    coherence = strength / np.maximum(total, np.float32(1e-6) * max(float(total.max()), 1e-30))
    return (0.5 * np.arctan2(2 * xy, difference)).astype(np.float32), coherence.astype(np.float32)
