"""Figures that compare the fast twin with the reference on one crop of ridged skin, with standard errors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
LOW_MM, HIGH_MM = 0.03, 0.32
"""Gaussians between which the twin's relief term takes the relief (RenderSettings)."""


@dataclass(frozen=True, slots=True, eq=False)
class Relief:
    """What of the skin's relief the light may follow, on the pixels of the crop."""

    height_um: Array
    """(h, w) band-passed as in the twin's relief term, mean removed."""
    slopes: Array
    """(L, h, w) slope of the relief's band that faces each light: positive where it leans towards the light."""

    @staticmethod
    def of(relief_um: NDArray[np.float32], window: tuple[slice, slice], lights: Array, pitch_mm: float) -> Relief:
        """Band-pass the whole map, then cut and bin the crop by two; `lights` are (L, 2) unit vectors in the plane."""

        def smooth(sigma_mm: float) -> Array:
            blurred = cv2.GaussianBlur(relief_um, (0, 0), sigma_mm / pitch_mm, borderType=cv2.BORDER_REPLICATE)
            return np.asarray(blurred, dtype=np.float64)

        band = smooth(LOW_MM) - smooth(HIGH_MM)
        down, across = np.gradient(band * 1e-3, pitch_mm)
        height, p, q = (binned(a[window]) for a in (band, across, -down))
        slopes = -(lights[:, 0, None, None] * p + lights[:, 1, None, None] * q)
        return Relief(height - height.mean(), slopes - slopes.mean(axis=(1, 2), keepdims=True))


def binned(image: Array | NDArray[np.float32], factor: int = 2) -> Array:
    """Mean over squares of `factor` pixels of the last two axes."""
    *front, rows, columns = image.shape
    split = np.asarray(image, dtype=np.float64).reshape(*front, rows // factor, factor, columns // factor, factor)
    return np.asarray(split.mean(axis=(-3, -1)))


def spread(measure: Callable[[Array], Array], batches: Array) -> tuple[Array, Array]:
    """Value of `measure` on the mean of the batches, and its standard error by leaving one batch out (jackknife)."""
    count, total = batches.shape[0], batches.sum(axis=0)
    left_out = np.array([measure((total - one) / (count - 1)) for one in batches])
    error = np.sqrt((count - 1) / count * ((left_out - left_out.mean(axis=0)) ** 2).sum(axis=0))
    return np.asarray(measure(total / count)), error


def gain_of_relief(light: Array, plain: Array, relief: Relief) -> Array:
    """k in % per um that makes `plain` (1 + k h) follow `light` best, both summed over the lights; a plane is free."""
    ratio = light.sum(axis=0) / plain.sum(axis=0)
    columns = [np.ones(ratio.size), *_plane(ratio.shape), relief.height_um.ravel()]
    solution = np.linalg.lstsq(np.stack(columns, axis=1), ratio.ravel() / ratio.mean(), rcond=None)[0]
    return np.asarray(100.0 * solution[-1])


def modulation(light: Array, relief: Relief) -> Array:
    """Relative light per standard deviation of the relief's height, and of its slope towards the light.

    One pair for all lights: every light's image is divided by its mean; each may have a plane of its own.
    """
    height = relief.height_um / relief.height_um.std()
    slope = relief.slopes / relief.slopes.std()
    shared_h, shared_s, target = [], [], []
    basis = np.stack([np.ones(height.size), *_plane(height.shape)], axis=1)
    project = basis @ np.linalg.pinv(basis)
    for image, toward in zip(light, slope, strict=True):
        for field, store in ((image / image.mean(), target), (height, shared_h), (toward, shared_s)):
            flat = field.ravel()
            store.append(flat - project @ flat)
    design = np.stack([np.concatenate(shared_h), np.concatenate(shared_s)], axis=1)
    return np.asarray(np.linalg.lstsq(design, np.concatenate(target), rcond=None)[0])


def contrast(batches: Array) -> Array:
    """Standard deviation over mean of the lights' images, planes removed, without the noise of the batches.

    The product of different batches has no noise in the mean: their mean covariance is the variance of what they share.
    """
    count, lights = batches.shape[:2]
    basis = np.stack([np.ones(batches[0, 0].size), *_plane(batches.shape[2:])], axis=1)
    flat = batches.reshape(count, lights, -1)
    level = flat.mean(axis=(0, 2))
    flat = flat - (flat @ np.linalg.pinv(basis).T) @ basis.T
    total = flat.sum(axis=0)
    shared = ((total**2).mean(axis=1) - (flat**2).mean(axis=2).sum(axis=0)) / max(count * (count - 1), 1)
    if count == 1:
        shared = (flat[0] ** 2).mean(axis=1)
    return np.asarray(np.mean(np.sign(shared) * np.sqrt(np.abs(shared)) / level))


def contrast_error(batches: Array) -> float:
    """Standard error of :func:`contrast` by leaving one batch out."""
    count = batches.shape[0]
    values = np.array([contrast(np.delete(batches, k, axis=0)) for k in range(count)])
    return float(np.sqrt((count - 1) / count * ((values - values.mean()) ** 2).sum()))


def _plane(shape: tuple[int, ...]) -> tuple[Array, Array]:
    rows, columns = np.meshgrid(np.linspace(-1, 1, shape[0]), np.linspace(-1, 1, shape[1]), indexing="ij")
    return rows.ravel(), columns.ravel()
