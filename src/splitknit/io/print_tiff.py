"""Prints as 8-bit grey TIFF with their resolution in the tags and their texts in the description.

References
----------
TIFF, revision 6.0, Adobe 1992: XResolution, YResolution, ResolutionUnit.
"""

from __future__ import annotations

import io
import os
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, read_bytes, require
from splitknit.io.atomic import atomic_file
from splitknit.io.fields import parse_json
from splitknit.io.images import ImageSettings, decode_image
from splitknit.io.prints import PrintFile
from splitknit.io.provenance import canonical_json
from splitknit.io.tiff import (
    RESOLUTION_UNIT,
    SIGNATURES,
    X_RESOLUTION,
    Y_RESOLUTION,
    TiffPage,
    quiet_tifffile,
    tiff_page,
)

_INCH, _CENTIMETRE = 2, 3
_CM_PER_INCH = 2.54
_PRINT = ImageSettings(max_pixels=64_000_000, max_bytes=500_000_000)


def write_print_tiff(
    path: str | os.PathLike[str], image: NDArray[np.uint8], ppi: float = 500.0, text: Mapping[str, str] | None = None
) -> None:
    """Write a print as an uncompressed TIFF that every reader of prints takes; equal input gives equal bytes.

    Parameters
    ----------
    image : (H, W) uint8, ridges dark
    ppi : pixels per inch, such as 500 or 1000
    text : keyword to text, such as the provenance; kept in the description as JSON

    Raises
    ------
    BadInput
        If the image or the resolution is of another kind, or the file cannot be written.
    """
    array = np.ascontiguousarray(image)
    require(
        array.ndim == 2 and array.size > 0 and array.dtype == np.uint8,
        f"a print must be (H, W) uint8, not {array.shape} {array.dtype}.",
    )
    require(10 <= ppi <= 100_000, f"ppi must lie between 10 and 100000, but it is {ppi}.")
    stream = io.BytesIO()
    quiet_tifffile().imwrite(
        stream,
        array,
        photometric="minisblack",
        description=canonical_json(dict(text)) if text else None,
        metadata=None,
        software="splitknit",
        resolution=(float(ppi), float(ppi)),
        resolutionunit="INCH",
    )
    with atomic_file(path) as file:
        file.write(stream.getbuffer())


def read_print_tiff(path: str | os.PathLike[str]) -> PrintFile:
    """Read a grey TIFF with its resolution (None where the tags do not say) and, if it is one of ours, its texts.

    Raises
    ------
    BadInput
        If the file is missing, damaged, not 8-bit grey, or its pixels are not square.
    """
    data, name = read_bytes(path, _PRINT.max_bytes), os.fspath(path)
    require(data.startswith(SIGNATURES), f"{name} is not a TIFF file; name another one.")
    pixels = decode_image(data, name, settings=_PRINT)
    require(pixels.shape[2] == 1 and pixels.dtype == np.uint8, f"{name} is not an 8-bit grey image.")
    page = tiff_page(data, name)
    x, y = (_ratio(page, tag) for tag in (X_RESOLUTION, Y_RESOLUTION))
    unit = int(page.tags[RESOLUTION_UNIT][0]) if RESOLUTION_UNIT in page.tags else _INCH
    resolution = None
    if x and y and unit in (_INCH, _CENTIMETRE):
        require(abs(x - y) <= 0.01 * x, f"{name} has {x:g} pixels along and {y:g} across; square pixels are expected.")
        resolution = x if unit == _INCH else x * _CM_PER_INCH
    return PrintFile(np.asarray(pixels[..., 0], dtype=np.uint8), resolution, _texts(page))


def _ratio(page: TiffPage, tag: int) -> float | None:
    fraction = page.tags.get(tag, np.zeros(0)).tolist()
    return fraction[0] / fraction[1] if len(fraction) == 2 and all(fraction) else None


def _texts(page: TiffPage) -> dict[str, str]:
    try:
        document = parse_json(page.description.encode(), "the description")
    except BadInput:
        return {}
    return (
        {key: value for key, value in document.items() if isinstance(value, str)} if isinstance(document, dict) else {}
    )
