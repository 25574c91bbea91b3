"""Fields of floats as uncompressed TIFF whose description tag is a JSON object: heights and light are such files."""

from __future__ import annotations

import io
import json
import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from splitknit.errors import read_bytes, refusing, require
from splitknit.io.atomic import atomic_file
from splitknit.io.images import DEFAULTS
from splitknit.io.provenance import canonical_json
from splitknit.io.tiff import SIGNATURES, decode_page, quiet_tifffile, tiff_page
from splitknit.model import FloatArray


def _write_float_tiff(
    path: str | os.PathLike[str], field: FloatArray, description: Mapping[str, Any], **tags: Any
) -> None:
    """Write one page of float32. Equal input gives equal bytes.

    `path`: the file; `field`: (H, W) or (H, W, 3) float32; `description`: what JSON can hold; with the ``unit`` of the
    values; `tags`: further arguments of tifffile's ``imwrite``, such as the resolution. Raises BadInput if the file
    cannot be written.
    """
    stream = io.BytesIO()
    quiet_tifffile().imwrite(
        stream,
        field,
        photometric="minisblack" if field.ndim == 2 else "rgb",
        description=canonical_json(description),
        metadata=None,
        software="splitknit",
        **tags,
    )
    with atomic_file(path) as file:
        file.write(stream.getbuffer())


def _read_float_tiff(path: str | os.PathLike[str], what: str) -> tuple[FloatArray, dict[str, Any]]:
    """Read what :func:`_write_float_tiff` wrote: (H, W) or (H, W, 3) float32, and the description.

    `path`: the file; `what`: it should be, for messages: "a height map". Raises BadInput if the file is missing,
    damaged or not written by this package.
    """
    data, name = read_bytes(path, DEFAULTS.max_bytes), os.fspath(path)
    wrong = f"{name} is not {what} of splitknit"
    require(data.startswith(SIGNATURES), f"{wrong}, or it is damaged; write it again.")
    page = tiff_page(data, name)
    require(page.dtype.kind == "f" and page.dtype.itemsize == 4, f"{wrong}.")
    with refusing(f"{wrong}, or it is damaged; write it again."):
        description = json.loads(page.description)
    require(isinstance(description, dict) and isinstance(description.get("unit"), str), f"{wrong}.")
    field = np.empty((page.rows, page.columns, page.channels), dtype=np.float32)
    decode_page(data, page, name, field)
    return field[..., 0] if page.channels == 1 else field, description


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


def read_height_tiff(path: str | os.PathLike[str]) -> tuple[FloatArray, float, dict[str, Any]]:
    """Read a height map that :func:`write_height_tiff` wrote.

    Returns `height_mm`: (H, W) float32, NaN outside the mask; `pitch_mm`: size of one pixel; `metadata`: all of the
    description. Raises BadInput if the file is missing, damaged or not written by this package.
    """
    height, metadata = _read_float_tiff(path, "a height map")
    pitch_mm: Any = metadata.get("pitch_mm")
    sound = type(pitch_mm) in (int, float) and 0 < pitch_mm < np.inf
    good = height.ndim == 2 and metadata["unit"] == "mm" and sound
    require(good, f"{os.fspath(path)} is not a height map of splitknit.")
    return height, float(pitch_mm), metadata


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


def read_light_tiff(path: str | os.PathLike[str]) -> tuple[FloatArray, dict[str, Any]]:
    """Read what :func:`write_light_tiff` wrote: (H, W) or (H, W, 3) float32, and all of the description. Raises
    BadInput if the file is missing, damaged or not written by this package.
    """
    return _read_float_tiff(path, "a light image")
