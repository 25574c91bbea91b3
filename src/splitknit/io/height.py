"""Height maps as float32 TIFF: mm, NaN outside the mask, the pitch in the tags and the metadata."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from splitknit.errors import require
from splitknit.io.float_tiff import read_float_tiff, write_float_tiff
from splitknit.model import FloatArray


def write_height_tiff(
    path: str | os.PathLike[str],
    height_mm: FloatArray,
    pitch_mm: float,
    metadata: Mapping[str, Any] | None = None,
) -> None:
    """Write a height map as an uncompressed float32 TIFF.

    Pixels per centimetre are in the resolution tags; the description tag is a JSON object with ``pitch_mm`` (exact),
    ``unit`` and everything in `metadata` (see :func:`splitknit.io.provenance`). Equal input gives equal bytes.

    Parameters
    ----------
    height_mm : (H, W), mm, NaN outside the mask
    pitch_mm : size of one pixel
    metadata : what JSON can hold

    Raises
    ------
    BadInput
        If the array or the pitch is of another kind, or the file cannot be written.
    """
    height = np.ascontiguousarray(height_mm, dtype=np.float32)
    require(height.ndim == 2 and height.size > 0, f"height_mm must have the shape (H, W), but it has {height.shape}.")
    require(bool(np.isfinite(pitch_mm)) and pitch_mm > 0, f"pitch_mm must be a positive number, but it is {pitch_mm}.")
    description = {**(metadata or {}), "pitch_mm": float(pitch_mm), "unit": "mm"}
    per_cm = 10.0 / float(pitch_mm)
    write_float_tiff(path, height, description, resolution=(per_cm, per_cm), resolutionunit="CENTIMETER")


def read_height_tiff(path: str | os.PathLike[str]) -> tuple[FloatArray, float, dict[str, Any]]:
    """Read a height map that :func:`write_height_tiff` wrote.

    Returns
    -------
    height_mm : (H, W) float32, NaN outside the mask
    pitch_mm : size of one pixel
    metadata : all of the description

    Raises
    ------
    BadInput
        If the file is missing, damaged or not one of ours.
    """
    height, metadata = read_float_tiff(path, "a height map")
    pitch_mm: Any = metadata.get("pitch_mm")
    sound = type(pitch_mm) in (int, float) and 0 < pitch_mm < np.inf
    good = height.ndim == 2 and metadata["unit"] == "mm" and sound
    require(good, f"{os.fspath(path)} is not a height map of splitknit.")
    return height, float(pitch_mm), metadata
