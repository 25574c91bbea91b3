"""Compares the measured ridges of the printed phantom with the drawn ones."""

from __future__ import annotations

import cv2
import numpy as np

from splitknit import BadInput, Reconstruction
from splitknit.errors import require
from splitknit.imaging.geometry import (
    BAND_SIGMA_MM,
    Floats,
    eroded,
    high_passed,
    pixels_above,
    sampled_at,
)
from splitknit.model import BoolArray, FloatArray
from splitknit_rig.calibration.phantom import FIELDS_END_MM, PITCH_MM, PLATE_MM, phantom

_UNSEEN = "the phantom's ridges are not seen; lay it tip up on dark ground, in focus."


_FINE_MM = 0.15
"""Standard deviation of a Gaussian that keeps 3, 11 and 29 % of ridges 0.35, 0.45 and 0.6 mm apart;
coarse ridges are those that it keeps and one twice as wide does not."""


def ridge_heights(result: Reconstruction) -> tuple[float, float, float]:
    """Ratio of the phantom's measured ridge height to the drawn one (least squares), their
    correlation, and the ratio of fine ridges over that of coarse ones, after the measured phantom
    is aligned with the drawing. A blur lowers the last, an error of the print's height does not.

    Raises BadInput if no ridges are visible.
    """
    drawn, _ = phantom()
    seen = _on_grid(result)
    template = _relief(drawn.height_mm, drawn.mask)
    # the phantom may lie up to 4 mm off the picture's middle, each way
    size = np.array(template.shape[::-1]) + 2 * round(4.0 / PITCH_MM)
    middle = (np.array(seen.shape[::-1]) - 1.0) / 2
    centring = (size - 1.0) / 2 - middle
    best = -1.0
    for turn in np.arange(-10.0, 10.5, 1.0):  # deg
        ahead = np.asarray(cv2.getRotationMatrix2D(middle.tolist(), turn, 1.0), dtype=np.float64)
        ahead[:, 2] += centring
        turned = cv2.warpAffine(seen, ahead, size.tolist())
        alike = cv2.matchTemplate(turned, template, cv2.TM_CCORR_NORMED)
        _, value, _, corner = cv2.minMaxLoc(alike)
        if value > best:
            ahead[:, 2] -= corner
            best, start = value, cv2.invertAffineTransform(ahead)
    inside = (seen != 0.0).astype(np.uint8)
    steps = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-6)
    try:
        _, place = cv2.findTransformECC(
            template, seen, start.astype(np.float32), cv2.MOTION_AFFINE, steps, inside, 1
        )
    except cv2.error as error:
        raise BadInput(_UNSEEN) from error
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    measured = cv2.warpAffine(seen, place, template.shape[::-1], flags=flags)
    both = (measured != 0.0) & (template != 0.0)
    both[: round((PLATE_MM[1] / 2 - FIELDS_END_MM) / PITCH_MM)] = False  # the marks
    require(both.any(), _UNSEEN)
    likeness = float(np.corrcoef(measured[both], template[both])[0, 1])
    require(likeness > 0.5, _UNSEEN)
    smooth, wide = (cv2.GaussianBlur(template, (0, 0), k * _FINE_MM / PITCH_MM) for k in (1, 2))
    whole, low, high = (
        float(measured[both] @ part[both] / (template[both] @ part[both]))
        for part in (template, smooth - wide, template - smooth)
    )
    return whole, likeness, high / low


def _relief(height_mm: FloatArray, mask: BoolArray) -> FloatArray:
    """The ridge band, zero beside the phantom and at its edge."""
    relief = high_passed(np.nan_to_num(height_mm), mask, BAND_SIGMA_MM / PITCH_MM)
    # the outermost 0.8 mm do not count: they are the steepest
    return np.where(eroded(mask, 0.8 / PITCH_MM), relief, 0.0).astype(np.float32)


def _on_grid(result: Reconstruction) -> FloatArray:
    """Relief resampled on the drawing's grid, centred on the middle of the picture."""
    rows, columns = result.mask.shape
    known = result.mask & np.isfinite(result.height_mm)
    size = [round(length * result.pitch_mm / PITCH_MM) + 1 for length in (rows, columns)]
    y, x = ((np.arange(n) - (n - 1) / 2) * PITCH_MM for n in size)
    x, y = np.broadcast_arrays(x[None, :], -y[:, None])

    def pixel(x_mm: Floats, y_mm: Floats) -> tuple[Floats, Floats]:
        return x_mm / result.pitch_mm + (columns - 1) / 2, (rows - 1) / 2 - y_mm / result.pitch_mm

    place = pixel(x, y)
    if result.x_mm is not None and result.y_mm is not None:
        place = pixels_above(pixel(result.x_mm, result.y_mm), known, *place)
    mask = sampled_at(known.astype(np.float32), *place, outside=0.0) > 0.999
    height = np.where(known, result.height_mm, 0.0).astype(np.float32)
    return _relief(sampled_at(height, *place, cv2.INTER_CUBIC, 0.0), mask)
