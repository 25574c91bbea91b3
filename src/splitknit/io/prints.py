"""Prints as 8-bit grey PNG with their resolution and provenance inside.

References
----------
Portable Network Graphics (PNG) Specification, second edition, W3C 2003: pHYs section 11.3.5.3, tEXt 11.3.4.3, iTXt
11.3.4.5.
"""

from __future__ import annotations

import io
import os
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, read_bytes, require
from splitknit.io.atomic import atomic_file
from splitknit.io.fields import parse_json
from splitknit.io.images import DEFAULTS, ImageSettings, decode_image, encode_image
from splitknit.io.png import decode_png
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

_METRES_PER_INCH = 0.0254
_AFTER_HEADER = 33


@dataclass(frozen=True, slots=True, eq=False)
class PrintFile:
    """What a print's file holds."""

    image: NDArray[np.uint8]
    """(H, W)."""
    resolution_ppi: float | None
    """Pixels per inch, as near as the file's whole pixels per metre can represent."""
    text: dict[str, str]


def write_print_png(
    path: str | os.PathLike[str], image: NDArray[np.uint8], ppi: float = 500.0, text: Mapping[str, str] | None = None
) -> None:
    """Write a print as an 8-bit grey PNG.

    Parameters
    ----------
    image : (H, W) uint8, ridges dark
    ppi : pixels per inch, stored in whole pixels per metre (500 ppi: 19685)
    text : keyword (1 to 79 printable ASCII characters) to text, such as the provenance

    Raises
    ------
    BadInput
        If the image, the resolution or a keyword is of another kind, or the file cannot be written.
    """
    data = encode_print_png(image, ppi, text)
    with atomic_file(path) as stream:
        stream.write(data)


def encode_print_png(image: NDArray[np.uint8], ppi: float = 500.0, text: Mapping[str, str] | None = None) -> bytes:
    """Return the bytes that :func:`write_print_png` writes."""
    array = np.asarray(image)
    require(
        array.ndim == 2 and array.dtype == np.uint8, f"a print must be (H, W) uint8, not {array.shape} {array.dtype}."
    )
    require(10 <= ppi <= 100_000, f"ppi must lie between 10 and 100000, but it is {ppi}.")
    per_metre = round(ppi / _METRES_PER_INCH)
    chunks = [_chunk(b"pHYs", struct.pack(">IIB", per_metre, per_metre, 1))]
    chunks += [_text_chunk(keyword, value) for keyword, value in sorted((text or {}).items())]
    data = encode_image(array, ".png")
    return b"".join([data[:_AFTER_HEADER], *chunks, data[_AFTER_HEADER:]])


def read_print_png(path: str | os.PathLike[str]) -> PrintFile:
    """Read a grey PNG with its resolution and texts.

    Raises
    ------
    BadInput
        If the file is missing, damaged, or not 8-bit grey.
    """
    data, name = read_bytes(path, DEFAULTS.max_bytes), os.fspath(path)
    pixels = decode_png(data, name)
    require(pixels.shape[2] == 1 and pixels.dtype == np.uint8, f"{name} is not an 8-bit grey image.")
    resolution, text = None, {}
    position = 8
    while position < len(data):
        length = int.from_bytes(data[position : position + 4], "big")
        kind, body = data[position + 4 : position + 8], data[position + 8 : position + 8 + length]
        if kind == b"pHYs" and length == 9 and body[8] == 1:
            resolution = struct.unpack(">I", body[:4])[0] * _METRES_PER_INCH
        elif kind == b"tEXt":
            keyword, _, value = body.partition(b"\0")
            text[keyword.decode("latin-1")] = value.decode("latin-1")
        elif kind == b"iTXt":
            keyword, _, rest = body.partition(b"\0")
            text[keyword.decode("latin-1")] = rest[2:].split(b"\0", 2)[-1].decode("utf-8", "replace")
        position += 12 + length
    return PrintFile(np.asarray(pixels[..., 0], dtype=np.uint8), resolution, text)


def _text_chunk(keyword: str, value: str) -> bytes:
    key = keyword.strip()
    if key != keyword or not 1 <= len(key) <= 79 or not key.isascii() or not key.isprintable():
        raise BadInput(f"a text in a PNG file cannot be called {keyword!r}: 1 to 79 printable ASCII characters.")
    require("\0" not in value, f"the text '{keyword}' holds a NUL character, which PNG cannot store.")
    try:
        return _chunk(b"tEXt", key.encode("ascii") + b"\0" + value.encode("latin-1"))
    except UnicodeEncodeError:
        return _chunk(b"iTXt", key.encode("ascii") + b"\0\0\0\0\0" + value.encode("utf-8"))


def _chunk(kind: bytes, body: bytes) -> bytes:
    return len(body).to_bytes(4, "big") + kind + body + zlib.crc32(body, zlib.crc32(kind)).to_bytes(4, "big")


def provenance_texts(origin: Mapping[str, Any]) -> dict[str, str]:
    """Texts of a PNG that state where it comes from; `origin` is that of :func:`splitknit.io.provenance`."""
    return {"Software": f"splitknit {origin['version']}", "Comment": canonical_json(origin)}


# Prints as 8-bit grey TIFF with their resolution in the tags and their texts in the description.
#
# Source: TIFF, revision 6.0, Adobe 1992: XResolution, YResolution, ResolutionUnit.


_INCH, _CENTIMETRE = 2, 3
_CM_PER_INCH = 2.54
_PRINT = ImageSettings(max_pixels=64_000_000, max_bytes=500_000_000)


def write_print_tiff(
    path: str | os.PathLike[str], image: NDArray[np.uint8], ppi: float = 500.0, text: Mapping[str, str] | None = None
) -> None:
    """Write a print as an uncompressed TIFF that every reader of prints takes; equal input gives equal bytes.

    `image`: (H, W) uint8, ridges dark; `ppi`: pixels per inch, such as 500 or 1000; `text`: keyword to text, such as
    the provenance; kept in the description as JSON. Raises BadInput if the image or the resolution is of another kind,
    or the file cannot be written.
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
    """Read a grey TIFF with its resolution (None where the tags do not say) and, if it is written by this package,
    its texts. Raises BadInput if the file is missing, damaged, not 8-bit grey, or its pixels are not square.
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
