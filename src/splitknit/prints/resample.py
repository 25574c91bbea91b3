"""A field of the input, read at a print's pixels."""

from __future__ import annotations

import cv2
import numpy as np

from splitknit.errors import check_mask
from splitknit.model import BoolArray, FloatArray
from splitknit.prints.print_map import PrintMap
from splitknit.prints.ridges import MM_PER_INCH


def resample(
    field: FloatArray, mask: BoolArray, pitch_mm: float, print_map: PrintMap, sigma_px: float = 0.5
) -> tuple[FloatArray, FloatArray]:
    """Read `field` on a print.

    Parameters
    ----------
    field : (H, W) float32
        Ignored outside `mask`.
    mask : (H, W) bool
    pitch_mm : float
        Of the input.
    print_map : PrintMap
    sigma_px : float
        Of the Gaussian, in pixels of the print, that takes out what the print is too coarse for; used only where it is
        coarser than the input.

    Returns
    -------
    values : (h, w) float32
    weight : (h, w) float32
        Share of the pixel that lies on the finger, 0 to 1.
    """
    mask = check_mask(mask, (field.shape[0], field.shape[1]))
    step = MM_PER_INCH / print_map.ppi / pitch_mm
    rows, columns = mask_box(mask, int(4 * step) + 2)
    inside = mask[rows, columns]
    weight = inside.astype(np.float32)
    values = np.where(inside, field[rows, columns], np.float32(0.0)).astype(np.float32)
    factor = max(1, int(step / 1.9))
    if factor > 1:  # averaging whole blocks first costs a fraction and takes out next to nothing
        height, width = (n // factor for n in inside.shape)
        cut = slice(0, height * factor), slice(0, width * factor)
        weight, values = (_shrunk(image[cut], (width, height)) for image in (weight, values))
    if step > 1.0:
        sigma = float(np.sqrt(max((sigma_px * step) ** 2 - (factor**2 - 1) / 12, 0.01))) / factor
        share = _blur(weight, sigma)
        values = np.asarray(_blur(values, sigma) / np.maximum(share, np.float32(1e-3)), dtype=np.float32)
        values[share <= 1e-3] = 0.0
        weight = share
    x, y = (
        (places - np.float32(box.start) + np.float32(0.5)) / np.float32(factor) - np.float32(0.5)
        for places, box in ((print_map.columns, columns), (print_map.rows, rows))
    )
    return _read(values, x, y), np.clip(_read(weight, x, y), 0.0, 1.0).astype(np.float32)


def _shrunk(image: FloatArray, size: tuple[int, int]) -> FloatArray:
    return np.asarray(cv2.resize(np.ascontiguousarray(image), size, interpolation=cv2.INTER_AREA), dtype=np.float32)


def _read(image: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    read = cv2.remap(image, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT, borderValue=0.0)
    return np.asarray(read, dtype=np.float32)


def mask_box(mask: BoolArray, margin: int) -> tuple[slice, slice]:
    """Rows and columns of the mask and `margin` pixels around it, inside the image."""
    rows = np.flatnonzero(mask.any(axis=1))
    columns = np.flatnonzero(mask.any(axis=0))
    return (
        slice(max(0, int(rows[0]) - margin), min(mask.shape[0], int(rows[-1]) + margin + 1)),
        slice(max(0, int(columns[0]) - margin), min(mask.shape[1], int(columns[-1]) + margin + 1)),
    )


def _blur(image: FloatArray, sigma: float) -> FloatArray:
    blurred = cv2.GaussianBlur(image, (0, 0), sigma, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(blurred, dtype=np.float32)
