"""JPEG files: the structure is checked before the decoder sees them.

JPEG has no checksums, so that a changed byte inside the image data cannot be told from a picture; what can be found is
a
file that ends early, has a damaged header, or is of a kind that is not supported. Pillow decodes: to the same pixels as
OpenCV, whose decoder prints on stderr where a file is damaged.

References
----------
ITU-T T.81 (1992), annex B: markers and segments.
"""

from __future__ import annotations

import io
import re
from dataclasses import dataclass

import numpy as np

from splitknit.errors import BadInput, refusing, require
from splitknit.io.png import check_size
from splitknit.model import PixelArray

SIGNATURE = b"\xff\xd8\xff"
_MARKER_IN_SCAN = re.compile(rb"\xff+[^\x00\xff\xd0-\xd7]", re.DOTALL)
_FRAMES = frozenset({0xC0, 0xC1, 0xC2})
_MOST_SCANS = 100
"""Each scan costs a pass through the whole image, whatever its length; a progressive image has about ten."""
_BLOCK_PIXELS = 64
_OTHER_FRAMES = frozenset({0xC3, 0xC5, 0xC6, 0xC7, 0xC9, 0xCA, 0xCB, 0xCD, 0xCE, 0xCF})


@dataclass(frozen=True, slots=True)
class JpegHeader:
    """The facts of the frame header."""

    rows: int
    columns: int
    channels: int
    finest: float
    """Part of the pixels that the finest channel has; each of its blocks of 8 x 8 takes at least one bit."""


def jpeg_header(data: bytes, name: str) -> JpegHeader:
    """Walk all segments of a JPEG file to its end marker and return the frame's size.

    Raises
    ------
    BadInput
        If the file ends early, has no frame, is CMYK, 12-bit, lossless or arithmetic-coded, or claims an image that is
        too large to be decoded, or to be in the file.
    """
    truncated = f"{name} is truncated: the JPEG file ends within the image; copy it again."
    frame: JpegHeader | None = None
    position, scans = 2, 0
    while True:
        require(position + 2 <= len(data), truncated)
        require(data[position] == 0xFF, f"{name} is damaged: a JPEG marker is missing; copy it again.")
        marker = data[position + 1]
        if marker == 0xFF:  # a fill byte
            position += 1
            continue
        if marker == 0xD9:
            break
        require(position + 4 <= len(data), truncated)
        length = int.from_bytes(data[position + 2 : position + 4], "big")
        require(length >= 2, f"{name} is damaged: a JPEG segment has an impossible length; copy it again.")
        require(position + 2 + length <= len(data), truncated)
        require(marker not in _OTHER_FRAMES, f"{name} is a kind of JPEG that is not supported; save it as PNG.")
        if marker in _FRAMES:
            require(frame is None, f"{name} is damaged: it has two JPEG frames.")
            frame = _frame(data[position + 4 : position + 2 + length], name)
        position += 2 + length
        if marker == 0xDA:
            scans += 1
            require(
                scans <= _MOST_SCANS, f"{name} is damaged: it has more than {_MOST_SCANS} JPEG scans; copy it again."
            )
            found = _MARKER_IN_SCAN.search(data, position)
            if found is None:
                raise BadInput(truncated)
            position = found.end() - 2
    if frame is None or scans == 0:
        raise BadInput(f"{name} is damaged: the JPEG file holds no image; copy it again.")
    rows, columns = frame.rows, frame.columns
    check_size(rows * columns * frame.channels, name, f"{rows} x {columns}")
    require(
        rows * columns * frame.finest / _BLOCK_PIXELS <= 8 * len(data),
        f"{name} is damaged: it claims {rows} x {columns} pixels, which cannot be in {len(data)} bytes; copy it again.",
    )
    return frame


def decode_jpeg(data: bytes, name: str, out: PixelArray | None = None) -> PixelArray:
    """Decode a JPEG file to (H, W, C) uint8 in RGB order, C = 1 or 3, as stored: EXIF orientation is ignored.

    Raises
    ------
    BadInput
        If the file is truncated, damaged or of a kind that is not supported.
    """
    from PIL import JpegImagePlugin  # noqa: PLC0415 - slow to import

    header = jpeg_header(data, name)
    with refusing(f"{name} cannot be decoded; capture or export it again."):
        image = np.asarray(JpegImagePlugin.JpegImageFile(io.BytesIO(data)))
    shape = (header.rows, header.columns) if header.channels == 1 else (header.rows, header.columns, header.channels)
    require(image.shape == shape, f"{name} cannot be decoded; export it again.")
    if out is None:
        out = np.empty((header.rows, header.columns, header.channels), dtype=np.uint8)
    out[...] = image.reshape(out.shape)
    return out


def _frame(body: bytes, name: str) -> JpegHeader:
    require(len(body) >= 6, f"{name} is damaged: its JPEG frame header is incomplete; copy it again.")
    rows, columns = int.from_bytes(body[1:3], "big"), int.from_bytes(body[3:5], "big")
    require(body[0] == 8, f"{name} has {body[0]} bits a sample; a JPEG file must have 8.")
    require(
        body[5] in (1, 3),
        f"{name} has {body[5]} channels (CMYK?); save it as grey or RGB.",
    )
    require(rows > 0 and columns > 0, f"{name} is damaged: its JPEG frame header gives no size; copy it again.")
    require(len(body) == 6 + 3 * body[5], f"{name} is damaged: its JPEG frame header is incomplete; copy it again.")
    sampling = [(body[place] >> 4, body[place] & 15) for place in range(7, len(body), 3)]
    across, down = (max(factors) for factors in zip(*sampling, strict=True))
    require(
        all(1 <= factor <= 4 for pair in sampling for factor in pair),
        f"{name} is damaged: its JPEG channels have an impossible sampling; copy it again.",
    )
    return JpegHeader(rows, columns, body[5], max(x * y for x, y in sampling) / (across * down))
