"""Prints as pictures: PNG, TIFF, JPEG and BMP read with the resolution that they state; TIFF
written."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, require
from splitknit.files import AnyPath, read_bytes
from splitknit.findings import Finding
from splitknit.io.fields import parse_json
from splitknit.io.images import BMP, JPEG, MAX_BYTES, PNG, TIFFS, encode_tiff, read_header
from splitknit.io.photos import decode_photo
from splitknit.io.prints import checked_print
from splitknit.io.provenance import canonical_json

SIGNATURES = (PNG, JPEG, *TIFFS, BMP)
"""First bytes of the files that :func:`decode_print_image` reads."""
KINDS = "PNG, TIFF, JPEG and BMP"
_MAX_PIXELS = 64_000_000
"""Maximum pixels of a print or a page of prints: nearly A4 at 1000 ppi."""


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
    """One of :data:`splitknit_match.records.minutiae_record.IMPRESSIONS`."""
    findings: tuple[Finding, ...] = ()
    """What was changed on reading (pixels made square, white ridges turned dark), or is in doubt.
    A doubt is why its resolution cannot be right."""


def read_print_png(path: AnyPath) -> PrintFile:
    """Read a print of `write_print_png`; BadInput as :func:`decode_print_image`."""
    return decode_print_image(read_bytes(path, MAX_BYTES), os.fspath(path))


def decode_print_image(data: bytes, name: str) -> PrintFile:
    """A PNG, TIFF, JPEG or BMP file, 8 or 16 bits, grey or grey as RGB, as a print, upright by
    EXIF, with the resolution that it states, or None; pixels not square are resampled to the finer
    side. Raises BadInput, with `name`, if the file is damaged, too large, of colour or of another
    kind.
    """
    require(data.startswith(SIGNATURES), f"{name} is none of {KINDS}; export the print as PNG.")

    def check(rows: int, columns: int) -> None:
        require(
            rows * columns <= _MAX_PIXELS,
            f"{name} has {rows} x {columns} pixels, more than the {_MAX_PIXELS} that are read of"
            " prints; reduce it.",
        )

    photo = decode_photo(data, name, check)
    header = read_header(data, name)
    stated = header.ppi
    text = _texts(header.text[""]) if "" in header.text else dict(header.text)
    grey = _grey(photo.pixels, name)
    if stated is None or abs(stated[0] - stated[1]) <= 0.01 * stated[0]:
        return PrintFile(grey, None if stated is None else stated[0], text)
    # from 5 on the picture lies on its side
    x, y = stated if photo.orientation < 5 else (stated[1], stated[0])
    ppi = max(x, y)
    size = (round(grey.shape[1] * ppi / x), round(grey.shape[0] * ppi / y))
    require(
        max(size) <= 4 * max(grey.shape),
        f"{name} states {x:g} by {y:g} ppi, which no scanner has; correct it.",
    )
    check(size[1], size[0])
    square = np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_CUBIC), dtype=np.uint8)
    note = f"its pixels of {x:.0f} by {y:.0f} ppi were made square, of {ppi:.0f} ppi."
    return PrintFile(square, ppi, text, findings=(Finding("square-pixels", note),))


def _grey(pixels: NDArray[Any], name: str) -> NDArray[np.uint8]:
    """(H, W) of (H, W, 1 or 3)."""
    require(
        pixels.dtype in (np.uint8, np.uint16),
        f"{name} holds {pixels.dtype}; save the print with 8 bits.",
    )
    require(
        not is_coloured(pixels),
        f"{name} is a colour image, not an 8-bit grey image; save the print as one.",
    )
    grey = pixels[..., pixels.shape[2] // 2]
    return np.ascontiguousarray(
        grey if grey.dtype == np.uint8 else grey // 257 + (grey % 257 > 128), np.uint8
    )


def is_coloured(pixels: NDArray[Any]) -> bool:
    """Whether a picture (H, W, 1 or 3) is more than grey stored in colour."""
    if pixels.shape[2] != 3 or pixels.dtype not in (np.uint8, np.uint16):
        return False
    limit = 12 if pixels.dtype == np.uint8 else 12 * 257  # JPEG rounds
    step = 1 + int((pixels[..., 0].size / 2e5) ** 0.5)  # of large pictures a part is enough
    # 15 times as quick as along the last axis
    red, green, blue = (pixels[::step, ::step, k] for k in range(3))
    spread = np.maximum(np.maximum(red, green), blue) - np.minimum(np.minimum(red, green), blue)
    return float((spread > limit).mean()) > 0.01


def encode_print_tiff(
    image: NDArray[np.uint8], ppi: float, text: Mapping[str, str] | None = None
) -> bytes:
    """A print (H, W) uint8 as uncompressed TIFF, `text` as JSON in its description; BadInput if of
    another kind."""
    return encode_tiff(
        checked_print(image, ppi), canonical_json(dict(text)) if text else None, float(ppi)
    )


def _texts(description: str) -> dict[str, str]:
    """Texts of a TIFF file's description; none where it is no JSON object."""
    with contextlib.suppress(BadInput):
        document = parse_json(description.encode(), "the description")
        if isinstance(document, dict):
            return {key: value for key, value in document.items() if isinstance(value, str)}
    return {}
