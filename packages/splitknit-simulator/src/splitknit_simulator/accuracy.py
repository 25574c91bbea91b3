"""A reconstruction beside the truth of a simulator: figures and error maps.

Definitions (the same for every preset and for the validation):

- *surface*: the pixels of both masks that lie further than 0.33 mm from the edge of their common
  mask (the image's border is an edge). The rms is taken after the mean difference is removed: a
  camera without stereo does not know the distance.
- *ridge band*: value minus its mask-normalised Gaussian mean with sigma 0.32 mm, on the surface
  where the slant of the true shape is below 60 deg. The relief (`ridge_mm`; of a surface that is
  not split, as in `ea` and `pr`, its height less its slow part) is compared with the true relief
  (`height_mm - shape_mm`); the whole height (`height_mm`) with the true height is given beside it,
  where curvature and mask edge count as well.
- *gain*: least-squares factor that takes the true ridge band to the estimated one; 1 is right,
  below 1 too flat.
- *local correlation*: correlation in square windows of 0.86 mm side, without removing the window's
  mean; the area is the fraction of the ridge band's pixels where it exceeds 0.8.
- *normals*: mean angle between estimated and true normals on the surface.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.capture import Capture
from splitknit.errors import BadInput, require
from splitknit.imaging.geometry import (
    BAND_SIGMA_MM,
    EROSION_MM,
    bounding_box,
    eroded,
    height_gradients,
    high_passed,
)
from splitknit.io.npz import read_npz
from splitknit.model import BoolArray, FloatArray
from splitknit.reconstruction import Comparison, Reconstruction

TRUTH_ARRAYS = ("height_mm", "shape_mm", "mask", "normals")
"""What is compared."""
MAX_SLANT_DEG = 60.0
"""Largest slant of the true shape at which the ridge band counts. Source: definition of the figures
(docs/experiments/accuracy.md)."""
WINDOW_MM = 0.86
"""Side of the windows of the local correlation. Source: definition of the figures
(docs/experiments/accuracy.md)."""
GOOD_CORRELATION = 0.8
"""Local correlation from which on ridges count as recovered. Source: definition of the figures
(docs/experiments/accuracy.md)."""


def compare(result: Reconstruction, truth: Mapping[str, NDArray[Any]]) -> Comparison:
    """Measure a reconstruction against the truth of a simulator.

    Parameters
    ----------
    result : Reconstruction
    truth : arrays (H, W) by name
        ``height_mm``, ``shape_mm`` and ``mask``, and ``normals`` (H, W, 3) where they are known, on
        the input's grid.

    Returns
    -------
    Comparison
        ``figures`` by name, and error maps.

    Raises
    ------
    BadInput
        If the truth lacks an array or has another size, or nothing is left to compare.

    Examples
    --------
    >>> import splitknit
    >>> import splitknit_simulator
    >>> capture, truth = splitknit_simulator.simulate_capture(1, settings={"scale": 0.08})
    >>> result = splitknit.reconstruct(capture, "ea")
    >>> splitknit_simulator.compare(result, truth).figures["surface_rms_mm"] < 2
    True
    """
    for name in ("height_mm", "shape_mm", "mask"):
        require(name in truth, f"the truth has no '{name}'; write it with splitknit simulate.")
        require(
            truth[name].shape == result.mask.shape,
            f"the truth's {name} has the shape {truth[name].shape}, but the images have"
            f" {result.mask.shape}.",
        )
    true_mask = truth["mask"]
    common = (
        result.mask & true_mask & np.isfinite(result.height_mm) & np.isfinite(truth["height_mm"])
    )
    require(common.any(), "the reconstruction and the truth have no pixel in common.")
    box = bounding_box(common)
    inside = common[box]
    pitch = result.pitch_mm
    surface = eroded(inside, EROSION_MM / pitch)
    require(
        surface.any(),
        "the surface common to the truth and the reconstruction is too narrow to measure.",
    )

    def cut(field: NDArray[Any]) -> FloatArray:
        return np.nan_to_num(np.where(inside, field[box], 0.0)).astype(np.float32)

    height = cut(result.height_mm)
    true_height = cut(truth["height_mm"])
    true_shape = cut(truth["shape_mm"])
    height_error = _centred(height - true_height, surface)
    shape_error = _centred(cut(result.shape_mm) - true_shape, surface)

    slopes = height_gradients(np.where(inside, true_shape, np.nan), pitch)
    band = surface & (np.rad2deg(np.arctan(np.hypot(*slopes))) < MAX_SLANT_DEG)
    sigma_px = BAND_SIGMA_MM / pitch
    true_band = high_passed(true_height - true_shape, inside, sigma_px)
    ridge_band = high_passed(cut(result.ridge_mm), inside, sigma_px)
    height_band = high_passed(height, inside, sigma_px)
    true_height_band = high_passed(true_height, inside, sigma_px)
    overlap = float(np.sum(result.mask & true_mask))
    figures = {
        "surface_rms_mm": _rms(height_error[surface]),
        "shape_rms_mm": _rms(shape_error[surface]),
        "mask_on_finger": overlap / float(np.sum(result.mask)),
        "mask_overlap": overlap / float(np.sum(result.mask | true_mask)),
        "ridge_area_mm2": float(np.sum(band)) * pitch**2,
    }
    if "normals" in truth:
        normals = result.normals[box][surface].astype(np.float64)
        true_normals = truth["normals"][box][surface].astype(np.float64)
        cosine = np.clip(np.sum(normals * true_normals, axis=1), -1.0, 1.0)
        figures["normals_mean_deg"] = float(np.mean(np.rad2deg(np.arccos(cosine))))
    window = max(3, 2 * round(WINDOW_MM / pitch / 2) + 1)
    figures |= _band_figures("ridge", ridge_band, true_band, band, window)
    figures |= _band_figures("height_band", height_band, true_height_band, band, window)
    ridge_error = np.where(inside, 1000.0 * (ridge_band - true_band), np.nan).astype(np.float32)

    def uncut(values: NDArray[Any], outside: Any) -> NDArray[Any]:
        whole = np.full(common.shape, outside, dtype=values.dtype)
        whole[box] = values
        return whole

    return Comparison(
        result.preset,
        figures,
        height_error_mm=uncut(np.where(inside, height_error, np.nan), np.nan),
        ridge_error_um=uncut(ridge_error, np.nan),
        surface=uncut(surface, False),
        band=uncut(band, False),
    )


def _local_correlation(
    first: FloatArray, second: FloatArray, where: BoolArray, window_px: int
) -> FloatArray:
    """Correlation of two zero-mean fields over square windows of `window_px` a side, counting the
    pixels of `where`."""

    def total(image: NDArray[Any]) -> FloatArray:
        size = (window_px, window_px)
        return np.asarray(cv2.blur(image.astype(np.float32), size, borderType=cv2.BORDER_CONSTANT))

    fraction = np.maximum(total(where), 1e-6)
    a = np.where(where, first, 0.0)
    b = np.where(where, second, 0.0)
    power = (total(a * a) / fraction) * (total(b * b) / fraction)
    return total(a * b) / fraction / np.sqrt(np.maximum(power, 1e-30))


def _band_figures(
    name: str, estimate: FloatArray, truth: FloatArray, where: BoolArray, window: int
) -> dict[str, float]:
    if not where.any():
        return {}
    local = _local_correlation(1000.0 * estimate, 1000.0 * truth, where, window)
    e = estimate[where].astype(np.float64)
    t = truth[where].astype(np.float64)
    e_centred = e - e.mean()
    t_centred = t - t.mean()
    power = float(np.sum(np.square(e_centred))) * float(np.sum(np.square(t_centred)))
    return {
        f"{name}_correlation": float(np.sum(e_centred * t_centred)) / max(power**0.5, 1e-30),
        f"{name}_gain": float(np.sum(e * t)) / max(float(np.sum(t * t)), 1e-30),
        f"{name}_rms_um": 1000.0 * _rms(e - t),
        f"{name}_truth_std_um": 1000.0 * float(t.std()),
        f"{name}_good_area": float(np.mean(local[where] > GOOD_CORRELATION)),
    }


def _centred(error: FloatArray, where: BoolArray) -> FloatArray:
    return (error - np.float32(np.mean(error[where], dtype=np.float64))).astype(np.float32)


def _rms(values: NDArray[Any]) -> float:
    return float(np.sqrt(np.mean(np.square(values.astype(np.float64)))))


def compare_with_own(result: Reconstruction, capture: Capture) -> Comparison:
    """Measure a reconstruction against the truth that its capture names; what `reconstruct` asks
    for."""
    return compare(result, read_truth(capture))


def read_truth(capture: Capture) -> dict[str, Any]:
    """The simulator's truth of a capture, as far as compared. BadInput if none, damaged or of
    another size."""
    if capture.truth is None:
        raise BadInput("the capture has no truth to compare with; only simulated ones have.")
    truth = read_npz(capture.truth, TRUTH_ARRAYS)  # only what is compared: the rest is large
    for name, array in truth.items():
        expected = (*capture.shape, 3) if name == "normals" else capture.shape
        require(
            array.shape == expected and array.dtype.kind in "fiub",
            f"{capture.truth}: the truth's {name} has the shape {array.shape}, but the images have "
            f"{capture.shape}; simulate the capture again.",
        )
    return truth
