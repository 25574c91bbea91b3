"""Fields of floats as uncompressed TIFF whose description tag is a JSON object: heights and light are such files."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from splitknit.errors import require
from splitknit.io.atomic import atomic_file
from splitknit.io.provenance import canonical_json
from splitknit.io.tiff import encode_tiff
from splitknit.model import FloatArray


def _write_float_tiff(
    path: str | os.PathLike[str], field: FloatArray, description: Mapping[str, Any], **tags: Any
) -> None:
    """Write one page of float32. Equal input gives equal bytes.

    `path`: the file; `field`: (H, W) or (H, W, 3) float32; `description`: what JSON can hold; with the ``unit`` of the
    values; `tags`: further arguments of tifffile's ``imwrite``, such as the resolution. Raises BadInput if the file
    cannot be written.
    """
    data = encode_tiff(field, description=canonical_json(description), **tags)
    with atomic_file(path) as file:
        file.write(data)


# Height maps as float32 TIFF: mm, NaN outside the mask, the pitch in the tags and the metadata.


def write_height_tiff(
    path: str | os.PathLike[str],
    height_mm: FloatArray,
    pitch_mm: float,
    metadata: Mapping[str, Any] | None = None,
    *,
    unit: str = "mm",
) -> None:
    """Write a height map as an uncompressed float32 TIFF.

    Pixels per centimetre are in the resolution tags; the description tag is a JSON object with ``pitch_mm`` (exact),
    ``unit`` and everything in `metadata` (see :func:`splitknit.io.provenance`). Equal input gives equal bytes.

    Parameters
    ----------
    height_mm : (H, W), mm, NaN outside the mask
    pitch_mm : size of one pixel
    metadata : what JSON can hold
    unit : ``pixel`` where the scale is unknown: the pitch is then one, and the file states no resolution

    Raises
    ------
    BadInput
        If the array or the pitch is of another kind, or the file cannot be written.
    """
    height = np.ascontiguousarray(height_mm, dtype=np.float32)
    require(height.ndim == 2 and height.size > 0, f"height_mm must have the shape (H, W), but it has {height.shape}.")
    require(bool(np.isfinite(pitch_mm)) and pitch_mm > 0, f"pitch_mm must be a positive number, but it is {pitch_mm}.")
    if unit != "mm":
        _write_float_tiff(path, height, {**(metadata or {}), "unit": unit})
        return
    description = {**(metadata or {}), "pitch_mm": float(pitch_mm), "unit": unit}
    per_cm = 10.0 / float(pitch_mm)
    _write_float_tiff(path, height, description, resolution=(per_cm, per_cm), resolutionunit="CENTIMETER")


# Images of linear light as float32 TIFF: grey or RGB, NaN where nothing is known, where they came from in the tags.


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
    _write_float_tiff(path, image, {**(metadata or {}), "unit": unit})
