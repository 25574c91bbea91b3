"""Whether the finger moved between the shots. Measured and warned of; nothing is shifted.

On a copy of about 10 px/mm. Shots differ in illumination, so comparing two of them mistakes moving light for a moving
finger: a ridge lit from the left looks shifted against the same ridge lit from the right by up to a tenth of a
millimetre. Every shot is therefore compared with what the *others* predict for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.check import check_mask, check_stack, require
from splitknit.preprocess.regions import blur, bounding_box, dilate, reduce_image, reduce_mask, reduction
from splitknit.types import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class MotionSettings:
    """How motion between shots is measured."""

    working_px_per_mm: float = 10.0
    """Scale of the copies that are compared."""
    bands_mm: tuple[float, ...] = (1.0, 0.5, 0.25)
    """Standard deviations of the band-pass filters, coarse to fine; a finger may move by about the first."""
    iterations: int = 3
    """Refinements in each band."""
    surround_mm: float = 1.0
    """Width of the backdrop around the finger that is used, for the sake of its silhouette."""
    warn_mm: float = 0.05
    """Motion from here on is warned of: a ninth of a ridge period blurs the combined relief visibly."""
    least_reliability: float = 0.5
    """Motion of a shot with less reliability than this is not believed."""

    def __post_init__(self) -> None:
        require(self.working_px_per_mm > 0, "motion.working_px_per_mm must be positive.")
        require(len(self.bands_mm) > 0 and min(self.bands_mm) > 0, "motion.bands_mm must be positive numbers.")
        require(self.iterations >= 1, "motion.iterations must be at least 1.")
        require(self.surround_mm >= 0, "motion.surround_mm must not be negative.")
        require(self.warn_mm > 0, "motion.warn_mm must be positive.")
        require(0 <= self.least_reliability <= 1, "motion.least_reliability must lie in [0, 1].")


@dataclass(frozen=True, slots=True, eq=False)
class ShotMotion:
    """Shift of every shot against the common position of all."""

    shift_mm: NDArray[np.float64]
    """(L, 2): x right, y up."""
    reliability: NDArray[np.float64]
    """(L,) in [0, 1]: correlation of the shot with what the others predict for it, after alignment."""


def shot_motion(
    stack: FloatArray, mask: BoolArray, px_per_mm: float, settings: MotionSettings | None = None
) -> ShotMotion:
    """Measure by how much the finger shifted in each shot against the others.

    Under distant lights the images of a matt surface span three dimensions, whatever their number. So each image is
    predicted from the three principal images of the others, and the residual is explained by a shift of the
    prediction (Lucas-Kanade, robustly weighted), coarse to fine on band-passed images. At least four shots are needed.

    Parameters
    ----------
    stack : (L, H, W) float32 linear
    mask : (H, W) bool
    px_per_mm : float
    settings : MotionSettings, optional

    Returns
    -------
    ShotMotion
        Relative to the median position. With fewer than four shots all zero, reliability zero.

    References
    ----------
    Shashua, A., "On photometric issues in 3D visual recognition from a single 2D image", IJCV 21, 1997 (three-image
    basis). Lucas, B. and Kanade, T., "An iterative image registration technique", IJCAI 1981.
    """
    settings = settings or MotionSettings()
    stack = check_stack(stack)
    mask = check_mask(mask, (stack.shape[1], stack.shape[2]))
    count = len(stack)
    if count < 4:
        return ShotMotion(np.zeros((count, 2)), np.zeros(count))
    images, region, px = _working_copy(stack, mask, px_per_mm, settings)
    shifts = np.zeros((count, 2))  # columns, rows; pixels of the working copy
    agreement = np.zeros(count)
    for band in settings.bands_mm:
        sigma = band * px
        bands = [blur(image, 0.5 * sigma) - blur(image, sigma) for image in images]
        for _ in range(settings.iterations):
            aligned = np.stack([_shifted(bands[k], shifts[k]) for k in range(count)])
            steps = np.zeros_like(shifts)
            for k in range(count):
                steps[k], agreement[k] = _step(aligned, k, region)
            limit = sigma
            shifts += np.clip(steps, -limit, limit)
            shifts -= np.median(shifts, axis=0)
            if float(np.abs(steps).max()) < 0.002 * px:
                break
    shift_mm = shifts / px * np.array([1.0, -1.0])
    return ShotMotion(shift_mm, np.clip(agreement, 0.0, 1.0))


def motion_warnings(motion: ShotMotion, settings: MotionSettings | None = None) -> tuple[str, ...]:
    """Warnings in words for shots in which the finger moved by more than `settings.warn_mm`."""
    settings = settings or MotionSettings()
    length = np.hypot(motion.shift_mm[:, 0], motion.shift_mm[:, 1])
    moved = np.flatnonzero((length > settings.warn_mm) & (motion.reliability >= settings.least_reliability))
    if len(moved) == 0:
        return ()
    which = ", ".join(f"{k} by {length[k]:.2f} mm" for k in moved)
    return (
        f"the finger moved between the shots (image {which}): the relief is blurred there; rest the finger on its "
        "support and capture again.",
    )


def _working_copy(
    stack: FloatArray, mask: BoolArray, px_per_mm: float, settings: MotionSettings
) -> tuple[list[FloatArray], BoolArray, float]:
    """Reduced images cut to the finger, each with mean one on it; the pixels used; their scale."""
    scale = reduction(mask.shape, px_per_mm, settings.working_px_per_mm, 600)
    px = px_per_mm * scale
    inside = reduce_mask(mask, scale) > 0.5
    if not inside.any():
        inside = reduce_mask(mask, scale) > 0.0
    region = dilate(inside, settings.surround_mm * px)
    rim = max(2, round(0.5 * settings.surround_mm * px))
    region[:rim], region[-rim:], region[:, :rim], region[:, -rim:] = False, False, False, False
    if not region.any():
        region = inside
    box = bounding_box(dilate(region, 2.0 * settings.surround_mm * px))
    images = []
    for image in stack:
        small = reduce_image(image, scale)
        mean = float(np.abs(small[inside]).mean())
        images.append(np.asarray(small[box] / np.float32(max(mean, 1e-12)), dtype=np.float32))
    return images, region[box], px


def _shifted(image: FloatArray, shift: NDArray[np.float64]) -> FloatArray:
    """The image with a shift of (columns, rows) undone."""
    matrix = np.array([[1.0, 0.0, shift[0]], [0.0, 1.0, shift[1]]])
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    size = (image.shape[1], image.shape[0])
    warped = cv2.warpAffine(image, matrix, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(warped, dtype=np.float32)


def _step(aligned: FloatArray, k: int, region: BoolArray) -> tuple[NDArray[np.float64], float]:
    """Remaining shift (columns, rows) of image k against its prediction, and their correlation."""
    others = np.delete(aligned, k, axis=0)
    values = others[:, region].astype(np.float64)
    gram = np.einsum("in,jn->ij", values, values)
    rank = min(3, len(others) - 1)
    vectors = np.linalg.eigh(gram)[1][:, -rank:]
    basis = np.einsum("ir,ihw->rhw", vectors, others.astype(np.float64))
    target = aligned[k][region].astype(np.float64)
    inside = basis[:, region]
    weights = np.ones_like(target)
    shift = np.zeros(2)
    correlation = 0.0
    for _ in range(3):
        coefficients = _least_squares(inside, target, weights)
        prediction = np.einsum("r,rhw->hw", coefficients, basis)
        down, right = np.gradient(prediction)
        design = np.concatenate([inside, -right[region][None], -down[region][None]])
        solution = _least_squares(design, target, weights)
        shift = solution[-2:]
        residual = target - np.einsum("r,rn->n", solution, design)
        spread = max(1.4826 * float(np.median(np.abs(residual))), 1e-12)
        weights = 1.0 / np.maximum(1.0, np.abs(residual) / (1.5 * spread))
        fitted = np.einsum("r,rn->n", solution[:rank], inside)
        power = np.sqrt(np.sum(weights * fitted**2) * np.sum(weights * target**2))
        correlation = float(np.sum(weights * fitted * target) / max(float(power), 1e-30))
    return shift, correlation


def _least_squares(
    design: NDArray[np.float64], target: NDArray[np.float64], weights: NDArray[np.float64]
) -> NDArray[np.float64]:
    weighted = design * weights
    normal = np.einsum("in,jn->ij", weighted, design)
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-30))
    normal = normal / np.outer(scale, scale) + 1e-9 * np.eye(len(normal))
    return np.asarray(np.linalg.solve(normal, np.einsum("in,n->i", weighted, target) / scale) / scale)
