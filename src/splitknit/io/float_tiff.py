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


def write_float_tiff(
    path: str | os.PathLike[str], field: FloatArray, description: Mapping[str, Any], **tags: Any
) -> None:
    """Write one page of float32. Equal input gives equal bytes.

    Parameters
    ----------
    path : the file
    field : (H, W) or (H, W, 3) float32
    description : what JSON can hold; with the ``unit`` of the values
    tags : further arguments of tifffile's ``imwrite``, such as the resolution

    Raises
    ------
    BadInput
        If the file cannot be written.
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


def read_float_tiff(path: str | os.PathLike[str], what: str) -> tuple[FloatArray, dict[str, Any]]:
    """Read what :func:`write_float_tiff` wrote: (H, W) or (H, W, 3) float32, and the description.

    Parameters
    ----------
    path : the file
    what : it should be, for messages: "a height map"

    Raises
    ------
    BadInput
        If the file is missing, damaged or not one of ours.
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
