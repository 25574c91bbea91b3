"""TIFF files with 8- or 16-bit grey or RGB images: checked, then decoded by tifffile (LZW by OpenCV)."""

from __future__ import annotations

import io
import logging
from dataclasses import dataclass
from typing import Any

import numpy as np

from splitknit.check import BadInput, require
from splitknit.io.png import copy_rgb
from splitknit.types import PixelArray

SIGNATURES = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_LZW = 5
_UNSIGNED = 1
_WHITE_IS_ZERO, _BLACK_IS_ZERO, _RGB, _YCBCR = 0, 1, 2, 6


@dataclass(frozen=True, slots=True)
class TiffHeader:
    """The facts of the first page."""

    rows: int
    columns: int
    channels: int
    """Channels after decoding: 1 or 3."""
    dtype: np.dtype[Any]


def quiet_tifffile() -> Any:
    """Import tifffile with a handler on its logger, so that its warnings do not go to stderr by default."""
    import tifffile  # noqa: PLC0415 - slow to import

    logger = logging.getLogger("tifffile")
    if not logger.handlers:
        logger.addHandler(logging.NullHandler())
    return tifffile


def tiff_header(data: bytes, name: str) -> TiffHeader:
    """Read the first page's tags.

    Raises
    ------
    BadInput
        If they are damaged, or the image is not 8- or 16-bit grey or RGB.
    """
    return _open(data, name)[1]


def decode_tiff(data: bytes, name: str, out: PixelArray | None = None) -> PixelArray:
    """Decode the first page of a TIFF file to (H, W, C) uint8 or uint16, C = 1 or 3; alpha is dropped.

    Raises
    ------
    BadInput
        If the file is truncated or damaged, or not 8- or 16-bit grey or RGB.
    """
    page, header = _open(data, name)
    offsets, counts = tuple(page.dataoffsets), tuple(page.databytecounts)
    whole = len(offsets) > 0 and len(offsets) == len(counts)
    whole = whole and all(o > 0 and c > 0 and o + c <= len(data) for o, c in zip(offsets, counts, strict=True))
    require(whole, f"{name} is truncated: the TIFF file ends within the image; copy it again.")
    if out is None:
        out = np.empty((header.rows, header.columns, header.channels), dtype=header.dtype)
    if int(page.compression) == _LZW:
        return _decode_lzw(data, header, name, out)
    try:
        image = np.asarray(page.asarray(maxworkers=1))
    except Exception as error:
        raise BadInput(f"{name} cannot be decoded ({error}); save it as PNG or as uncompressed TIFF.") from error
    if page.planarconfig == 2 and image.ndim == 3:  # channels in separate planes
        image = np.moveaxis(image, 0, -1)
    if image.ndim == 2:
        image = image[..., None]
    require(
        image.ndim == 3 and image.shape[:2] == out.shape[:2] and image.shape[2] >= header.channels,
        f"{name} cannot be decoded: its shape is {image.shape}; save it as PNG.",
    )
    image = image[..., : header.channels]
    out[...] = np.iinfo(header.dtype).max - image if int(page.photometric) == _WHITE_IS_ZERO else image
    return out


def _open(data: bytes, name: str) -> tuple[Any, TiffHeader]:
    tifffile = quiet_tifffile()
    try:
        page = tifffile.TiffFile(io.BytesIO(data)).pages[0]
        rows, columns, samples = int(page.imagelength), int(page.imagewidth), int(page.samplesperpixel)
        photometric, depth, dtype = int(page.photometric), int(page.imagedepth), page.dtype
        bits = page.bitspersample if isinstance(page.bitspersample, int) else max(page.bitspersample)
    except Exception as error:  # tifffile raises whatever its parsing meets
        raise BadInput(f"{name} is not a sound TIFF file: its tags are damaged; export it again.") from error
    integer = page.sampleformat == _UNSIGNED and bits in (8, 16) and dtype is not None
    require(
        integer and dtype in (np.uint8, np.uint16),
        f"{name} has {bits}-bit samples of the type {dtype}; save it as 8- or 16-bit unsigned integers.",
    )
    grey = photometric in (_WHITE_IS_ZERO, _BLACK_IS_ZERO) and samples in (1, 2)
    colour = photometric in (_RGB, _YCBCR) and samples in (3, 4)
    require(grey or colour, f"{name} is neither grey nor RGB (CMYK or palette?); save it as grey or RGB.")
    require(rows > 0 and columns > 0 and depth == 1, f"{name} is not a single flat image; save it as PNG.")
    return page, TiffHeader(rows, columns, 1 if grey else 3, np.dtype(dtype))


def _decode_lzw(data: bytes, header: TiffHeader, name: str, out: PixelArray) -> PixelArray:
    """LZW needs a codec that tifffile does not bring."""
    import cv2  # noqa: PLC0415 - slow to import

    try:
        image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise BadInput(f"{name} cannot be decoded: {error.err}.") from error
    ok = image is not None and image.shape[:2] == (header.rows, header.columns) and image.dtype == header.dtype
    if not ok or image is None:
        raise BadInput(f"{name} cannot be decoded; save it as PNG or as uncompressed TIFF.")
    if header.channels == 3 and image.ndim == 3:
        copy_rgb(image, out)
    else:
        out[..., 0] = image if image.ndim == 2 else image[..., 0]
    return out
