"""Images of linear light as float32 TIFF: grey or RGB, NaN where nothing is known, where they came from in the tags."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from splitknit.errors import require
from splitknit.io.float_tiff import read_float_tiff, write_float_tiff
from splitknit.model import FloatArray


def write_light_tiff(
    path: str | os.PathLike[str], light: FloatArray, unit: str, metadata: Mapping[str, Any] | None = None
) -> None:
    """Write an image of floats as an uncompressed float32 TIFF. Equal input gives equal bytes.

    Parameters
    ----------
    light : (H, W) or (H, W, 3)
    unit : such as ``linear light, 1 = full scale`` or ``rad``; in the description tag, with `metadata`, as JSON
    metadata : what JSON can hold

    Raises
    ------
    BadInput
        If the array is of another kind, or the file cannot be written.
    """
    image = np.ascontiguousarray(light, dtype=np.float32)
    good = image.size > 0 and (image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3))
    require(good, f"light must have the shape (H, W) or (H, W, 3), but it has {image.shape}.")
    write_float_tiff(path, image, {**(metadata or {}), "unit": unit})


def read_light_tiff(path: str | os.PathLike[str]) -> tuple[FloatArray, dict[str, Any]]:
    """Read what :func:`write_light_tiff` wrote: (H, W) or (H, W, 3) float32, and all of the description.

    Raises
    ------
    BadInput
        If the file is missing, damaged or not one of ours.
    """
    return read_float_tiff(path, "a light image")
