"""Prints as JPEG 2000, without loss."""

from __future__ import annotations

import struct

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.io.images import decoded

_SMALLEST = 32
"""Pixels of a print's shorter side at least. Source: JPEG 2000, five halvings."""


def encode_jpeg2000(image: NDArray[np.uint8]) -> bytes:
    """Compress a print (H, W) uint8 as JPEG 2000 (a JP2 file) without loss; BadInput below 32
    pixels a side."""
    require(
        min(image.shape) >= _SMALLEST,
        f"a print of {image.shape[0]} x {image.shape[1]} pixels is too small for JPEG 2000; choose"
        " PNG.",
    )
    return cv2.imencode(".jp2", image, [cv2.IMWRITE_JPEG2000_COMPRESSION_X1000, 1000])[1].tobytes()


def decode_jpeg2000(data: bytes, name: str, max_pixels: int) -> NDArray[np.uint8]:
    """Decode a print (H, W) of JP2 or its code stream. BadInput if damaged, not 8-bit grey, or
    above `max_pixels`."""
    start = data.find(b"\xff\x4f\xff\x51")  # the code stream begins with its sizes
    head = data[start + 8 : start + 43]
    require(
        start >= 0 and len(head) == 35,
        f"{name} is not a JPEG 2000 image, or truncated; copy it again.",
    )
    right, down, left, up, *_, components = struct.unpack_from(">IIIIIIIIH", head)
    rows = down - up
    columns = right - left
    require(
        rows > 0 and columns > 0 and rows * columns <= max_pixels,
        f"{name} claims {rows} x {columns} pixels.",
    )
    require(components == 1 and head[34] == 7, f"{name} is not 8-bit grey; convert it.")
    image = decoded(data, name)
    require(
        image.shape == (rows, columns, 1) and image.dtype == np.uint8,
        f"{name} is damaged; copy it again.",
    )
    return image[..., 0]
