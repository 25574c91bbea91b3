"""Prints as pictures: PNG, TIFF, JPEG and BMP read with the resolution that they state; PNG and TIFF written.

Source: Portable Network Graphics (PNG) Specification, second edition, W3C 2003: pHYs section 11.3.5.3, tEXt 11.3.4.3,
iTXt 11.3.4.5.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, read_bytes, require
from splitknit.io.atomic import write_file
from splitknit.io.fields import parse_json
from splitknit.io.images import MAX_BYTES, encode_image, jpeg_segments
from splitknit.io.photos import BMP_SIGNATURE, JPEG_SIGNATURE, decode_photo, exif_data
from splitknit.io.png import SIGNATURE as PNG
from splitknit.io.png import chunks_of, decode_png
from splitknit.io.provenance import canonical_json
from splitknit.io.tiff import SIGNATURES as TIFFS
from splitknit.io.tiff import TiffPage, encode_tiff, stated_ppi, tiff_page

SIGNATURES = (PNG[:4], JPEG_SIGNATURE, *TIFFS, BMP_SIGNATURE)
"""First bytes of the files that :func:`decode_print_image` reads."""
KINDS = "PNG, TIFF, JPEG and BMP"
_METRES_PER_INCH, _CM_PER_INCH = 0.0254, 2.54
_APP0 = 0xE0
_COLOUR_LEVELS, _COLOURED = 12, 0.01
"""By how many grey levels the channels of grey stored as RGB may differ (JPEG rounds them), and the fraction of pixels
that may differ more."""
_AFTER_HEADER = 33
"""Of a PNG file: signature and IHDR."""


@dataclass(frozen=True, slots=True, eq=False)
class PrintFile:
    """What a print's file holds."""

    image: NDArray[np.uint8]
    """(H, W)."""
    resolution_ppi: float | None
    """Pixels per inch, as near as the file's whole pixels per metre can represent."""
    text: dict[str, str]
    finger: str = "unknown"
    """``right_thumb`` to ``left_little``, or ``unknown``."""
    impression: str = "unknown"
    """One of :data:`splitknit.io.minutiae_record.IMPRESSIONS`."""


def write_print_png(
    path: str | os.PathLike[str], image: NDArray[np.uint8], ppi: float = 500.0, text: Mapping[str, str] | None = None
) -> None:
    """Write a print (H, W) uint8 as PNG. `ppi` is stored in whole pixels per metre (500 ppi: 19685); `text`: keyword (1
    to 79 printable ASCII characters) to text. Raises BadInput if one of them is of another kind, or on writing.
    """
    write_file(path, encode_print_png(image, ppi, text))


def encode_print_png(image: NDArray[np.uint8], ppi: float = 500.0, text: Mapping[str, str] | None = None) -> bytes:
    """Return the bytes that :func:`write_print_png` writes."""
    array = np.asarray(image)
    require(
        array.ndim == 2 and array.dtype == np.uint8, f"a print must be (H, W) uint8, not {array.shape} {array.dtype}."
    )
    require(10 <= ppi <= 100_000, f"ppi must lie between 10 and 100000, but it is {ppi}.")
    per_metre = round(ppi / _METRES_PER_INCH)
    resolution = _chunk(b"pHYs", struct.pack(">IIB", per_metre, per_metre, 1))
    return png_with_texts(encode_image(array, ".png"), text or {}, resolution)


def png_with_texts(data: bytes, text: Mapping[str, str], *chunks: bytes) -> bytes:
    """Return a PNG file with further chunks, and with texts by their keywords, behind its header."""
    texts = [_text_chunk(keyword, value) for keyword, value in sorted(text.items())]
    return b"".join([data[:_AFTER_HEADER], *chunks, *texts, data[_AFTER_HEADER:]])


def read_print_png(path: str | os.PathLike[str]) -> PrintFile:
    """Read a grey PNG with its resolution and texts; BadInput if the file is missing, damaged, or not 8-bit grey."""
    data, name = read_bytes(path, MAX_BYTES), os.fspath(path)
    pixels = decode_png(data, name)
    require(pixels.shape[2] == 1 and pixels.dtype == np.uint8, f"{name} is not an 8-bit grey image.")
    return PrintFile(np.asarray(pixels[..., 0], dtype=np.uint8), *_png_facts(data))


def decode_print_image(data: bytes, name: str) -> PrintFile:
    """Read a PNG, TIFF, JPEG or BMP file, 8 or 16 bits, grey or grey as RGB, as a print, upright by its EXIF data. Its
    resolution is what the file states, None where it states none. Raises BadInput, with `name`, if the file is damaged,
    too large, of colour or of another kind, or its pixels are not square.
    """
    require(data.startswith(SIGNATURES), f"{name} is none of {KINDS}; export the print as PNG.")
    pixels = decode_photo(data, name).pixels
    text: dict[str, str] = {}
    if data.startswith(PNG):
        ppi, text = _png_facts(data)
    elif data.startswith(BMP_SIGNATURE):
        ppi = _equal(struct.unpack_from("<ii", data, 38), _METRES_PER_INCH, name)
    elif data.startswith(JPEG_SIGNATURE):
        ppi = _jfif_ppi(data, name) or stated_ppi(exif_data(data), name)
    else:
        ppi, text = stated_ppi(data, name), _texts(tiff_page(data, name))
    return PrintFile(_grey(pixels, name), ppi, text)


def _grey(pixels: NDArray[Any], name: str) -> NDArray[np.uint8]:
    """(H, W) of (H, W, 1 or 3)."""
    require(pixels.dtype in (np.uint8, np.uint16), f"{name} holds {pixels.dtype}; save the print with 8 bits.")
    require(not is_coloured(pixels), f"{name} is a colour image, not an 8-bit grey image; save the print as one.")
    grey = pixels[..., pixels.shape[2] // 2]
    return np.ascontiguousarray(grey if grey.dtype == np.uint8 else (grey.astype(np.uint32) + 128) // 257, np.uint8)


def is_coloured(pixels: NDArray[Any]) -> bool:
    """Whether a picture (H, W, 1 or 3) is more than grey stored in colour."""
    if pixels.shape[2] != 3 or pixels.dtype not in (np.uint8, np.uint16):
        return False
    limit = _COLOUR_LEVELS if pixels.dtype == np.uint8 else _COLOUR_LEVELS * 257
    return float((pixels.max(axis=2) - pixels.min(axis=2) > limit).mean()) > _COLOURED


def _png_facts(data: bytes) -> tuple[float | None, dict[str, str]]:
    """Resolution and texts of a sound PNG file."""
    resolution, text = None, {}
    for kind, body in chunks_of(data):
        if kind == b"pHYs" and len(body) == 9 and body[8] == 1:
            resolution = struct.unpack(">I", body[:4])[0] * _METRES_PER_INCH
        elif kind == b"tEXt":
            keyword, _, value = body.partition(b"\0")
            text[keyword.decode("latin-1")] = value.decode("latin-1")
        elif kind == b"iTXt":
            keyword, _, rest = body.partition(b"\0")
            text[keyword.decode("latin-1")] = rest[2:].split(b"\0", 2)[-1].decode("utf-8", "replace")
    return resolution, text


def _jfif_ppi(data: bytes, name: str) -> float | None:
    """Density of a sound JPEG file's first segment APP0 (JFIF 1.02: unit 1 is the inch, 2 the centimetre)."""
    for marker, start, _ in jpeg_segments(data):
        if marker == _APP0 and data[start + 4 : start + 9] == b"JFIF\0":
            unit, x, y = struct.unpack_from(">BHH", data[start + 11 : start + 16].ljust(5, b"\0"))
            return _equal((x, y), {1: 1.0, 2: _CM_PER_INCH}.get(unit, 0.0), name)
    return None


def _equal(density: tuple[int, int], scale: float, name: str) -> float | None:
    """`density` along columns and rows times `scale`; None where it states nothing."""
    x, y = density
    if min(x, y) <= 0 or scale <= 0:
        return None
    require(abs(x - y) <= 0.01 * x, f"{name} has {x:g} pixels along and {y:g} across; square pixels are expected.")
    return x * scale


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


def encode_print_tiff(image: NDArray[np.uint8], ppi: float = 500.0, text: Mapping[str, str] | None = None) -> bytes:
    """Bytes of a print (H, W) uint8 as uncompressed TIFF; equal input gives equal bytes. `text`, keyword to text, is
    kept in the description as JSON. Raises BadInput if the image or the resolution is of another kind.
    """
    array = np.ascontiguousarray(image)
    require(
        array.ndim == 2 and array.size > 0 and array.dtype == np.uint8,
        f"a print must be (H, W) uint8, not {array.shape} {array.dtype}.",
    )
    require(10 <= ppi <= 100_000, f"ppi must lie between 10 and 100000, but it is {ppi}.")
    description = canonical_json(dict(text)) if text else None
    return encode_tiff(array, description=description, resolution=(float(ppi), float(ppi)), resolutionunit="INCH")


def _texts(page: TiffPage) -> dict[str, str]:
    try:
        document = parse_json(page.description.encode(), "the description")
    except BadInput:
        return {}
    return (
        {key: value for key, value in document.items() if isinstance(value, str)} if isinstance(document, dict) else {}
    )
