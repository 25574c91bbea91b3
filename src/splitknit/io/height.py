"""Height maps as float32 TIFF: mm, NaN outside the mask, the pitch in the tags and the metadata."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from splitknit.check import BadInput, require
from splitknit.io.atomic import atomic_file
from splitknit.io.images import read_bytes
from splitknit.io.provenance import canonical_json
from splitknit.io.tiff import quiet_tifffile
from splitknit.types import FloatArray


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
    description = canonical_json({**(metadata or {}), "pitch_mm": float(pitch_mm), "unit": "mm"})
    per_cm = 10.0 / float(pitch_mm)
    stream = io.BytesIO()
    quiet_tifffile().imwrite(
        stream,
        height,
        photometric="minisblack",
        description=description,
        metadata=None,
        software="splitknit",
        resolution=(per_cm, per_cm),
        resolutionunit="CENTIMETER",
    )
    with atomic_file(path) as file:
        file.write(stream.getbuffer())


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
    data, name = read_bytes(path), os.fspath(path)
    try:
        page = quiet_tifffile().TiffFile(io.BytesIO(data)).pages[0]
        height = np.asarray(page.asarray(maxworkers=1))
        metadata = json.loads(page.description)
        pitch_mm = float(metadata["pitch_mm"])
        good = height.ndim == 2 and height.dtype == np.float32 and metadata["unit"] == "mm" and 0 < pitch_mm < np.inf
    except Exception as error:  # tifffile raises whatever its parsing meets
        raise BadInput(f"{name} is not a height map of splitknit, or it is damaged: {error}.") from error
    require(good, f"{name} is not a height map of splitknit.")
    return height, pitch_mm, metadata
