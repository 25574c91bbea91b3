"""Prints and pictures as PNG files, with their resolution and with texts."""

from __future__ import annotations

import io
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from splitknit.errors import require
from splitknit.files import AnyPath
from splitknit.io.atomic import write_file
from splitknit.io.provenance import canonical_json


def write_print_png(
    path: AnyPath,
    image: NDArray[np.uint8],
    ppi: float = 500.0,
    text: Mapping[str, str] | None = None,
) -> None:
    """Write a print (H, W) uint8 as PNG. `ppi` is stored in whole pixels per metre (500 ppi:
    19685); `text`: keyword (1 to 79 printable ASCII characters) to text. Raises BadInput if one of
    them is of another kind, or on writing.
    """
    write_file(path, encode_print_png(image, ppi, text))


def encode_print_png(
    image: NDArray[np.uint8], ppi: float = 500.0, text: Mapping[str, str] | None = None
) -> bytes:
    """Return the bytes that :func:`write_print_png` writes."""
    return encode_png(checked_print(image, ppi), text or {}, ppi)


def encode_png(image: NDArray[Any], text: Mapping[str, str], ppi: float | None = None) -> bytes:
    """A PNG file of (H, W) or (H, W, 3) uint8, or of (H, W) uint16, with its resolution and with
    texts by their keywords.

    Raises BadInput for a keyword other than 1 to 79 printable ASCII characters, and a text with a
    NUL character.
    """
    chunks = PngInfo()
    for keyword, value in sorted(text.items()):
        plain = (
            keyword.strip() == keyword
            and 1 <= len(keyword) <= 79
            and keyword.isascii()
            and keyword.isprintable()
        )
        require(
            plain,
            f"a text in a PNG file cannot be called {keyword!r}: 1 to 79 printable ASCII"
            " characters.",
        )
        require(
            "\0" not in value,
            f"the text '{keyword}' holds a NUL character, which PNG cannot store.",
        )
        chunks.add_text(keyword, value)
    stream = io.BytesIO()
    resolution = {} if ppi is None else {"dpi": (ppi, ppi)}
    packing = {"compress_level": 1, "compress_type": zlib.Z_RLE}  # smaller and faster than usual
    Image.fromarray(image).save(stream, "PNG", pnginfo=chunks, **packing, **resolution)
    return stream.getvalue()


def provenance_texts(origin: Mapping[str, Any]) -> dict[str, str]:
    """Texts of a PNG that state where it comes from; `origin` is that of
    :func:`splitknit.io.provenance`."""
    return {"Software": f"splitknit {origin['version']}", "Comment": canonical_json(origin)}


def checked_print(image: NDArray[np.uint8], ppi: float) -> NDArray[np.uint8]:
    """A print that can be written, in one piece."""
    array = np.ascontiguousarray(image)
    require(
        array.ndim == 2 and array.size > 0 and array.dtype == np.uint8,
        f"a print must be (H, W) uint8, not {array.shape} {array.dtype}.",
    )
    require(10 <= ppi <= 100_000, f"ppi must lie between 10 and 100000, but it is {ppi}.")
    return array
