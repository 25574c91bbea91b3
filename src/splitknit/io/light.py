"""Images of linear light as float32 TIFF: grey or RGB, NaN where nothing is known, where they came from in the tags."""

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
    stream = io.BytesIO()
    quiet_tifffile().imwrite(
        stream,
        image,
        photometric="minisblack" if image.ndim == 2 else "rgb",
        description=canonical_json({**(metadata or {}), "unit": unit}),
        metadata=None,
        software="splitknit",
    )
    with atomic_file(path) as file:
        file.write(stream.getbuffer())


def read_light_tiff(path: str | os.PathLike[str]) -> tuple[FloatArray, dict[str, Any]]:
    """Read what :func:`write_light_tiff` wrote: (H, W) or (H, W, 3) float32, and all of the description.

    Raises
    ------
    BadInput
        If the file is missing, damaged or not one of ours.
    """
    data, name = read_bytes(path), os.fspath(path)
    try:
        page = quiet_tifffile().TiffFile(io.BytesIO(data)).pages[0]
        light = np.asarray(page.asarray(maxworkers=1))
        metadata = json.loads(page.description)
        good = light.dtype == np.float32 and isinstance(metadata["unit"], str)
    except Exception as error:  # tifffile raises whatever its parsing meets
        raise BadInput(f"{name} is not a light image of splitknit, or it is damaged: {error}.") from error
    require(good, f"{name} is not a light image of splitknit.")
    return light, metadata
