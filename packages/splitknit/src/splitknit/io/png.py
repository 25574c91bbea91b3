"""PNG files, whose chunks are checked here; and OpenCV, which decodes all formats behind such checks.

A decoder of C takes memory by what the header claims, passes over chunks that it does not know, and stops reading
with the last row. So sizes are checked first, all chunks are walked to the end (lengths, CRC-32), and texts, colour
profiles and transparency of grey or RGB never reach it.

Source: Portable Network Graphics (PNG) Specification, second edition, W3C 2003; chunk layout section 5.3, colour types
section 11.2.2.
"""

from __future__ import annotations

import contextlib
import os
import struct
import threading
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import refusing, require
from splitknit.model import PixelArray

SIGNATURE = b"\x89PNG\r\n\x1a\n"
_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
_DEPTHS = {0: (1, 2, 4, 8, 16), 2: (8, 16), 3: (1, 2, 4, 8), 4: (8, 16), 6: (8, 16)}
DECODED_BYTES = 400_000_000
"""Bytes of one decoded image, at most: 130 million pixels of 8-bit RGB. Decoders of C hold a second copy beside it."""
DEFLATE_RATIO = 1032  # deflate makes no more of a byte (zlib, technical details): a longer image cannot be in the file


@dataclass(frozen=True, slots=True)
class PngHeader:
    """What the header says of the image once decoded, alpha dropped."""

    rows: int
    columns: int
    channels: int  # 1 or 3
    dtype: np.dtype[Any]
    palette: bool


def png_header(data: bytes, name: str) -> PngHeader:
    """The IHDR chunk of `data`; BadInput, with `name`, if unsound, too large to decode or to be in the file."""
    damaged = f"{name} is not a sound PNG file (its header is damaged); capture or export it again."
    require(len(data) >= 33 and data[:8] == SIGNATURE and data[8:16] == b"\0\0\0\rIHDR", damaged)
    require(zlib.crc32(data[12:29]) == int.from_bytes(data[29:33], "big"), damaged)
    columns, rows, depth, colour, compression, filters, interlace = struct.unpack(">IIBBBBB", data[16:29])
    require(0 < rows < 1 << 31 and 0 < columns < 1 << 31, damaged)
    require(depth in _DEPTHS.get(colour, ()) and (compression, filters) == (0, 0) and interlace in (0, 1), damaged)
    dtype: np.dtype[Any] = np.dtype(np.uint16 if depth == 16 else np.uint8)
    header = PngHeader(rows, columns, 1 if colour in (0, 4) else 3, dtype, colour == 3)
    check_size(rows, columns, header.channels * dtype.itemsize, name)
    check_held(rows, columns, _CHANNELS[colour] * depth / 8 / DEFLATE_RATIO, len(data), name)
    return header


def check_size(rows: int, columns: int, bytes_each: int, name: str) -> None:
    """Refuse an image of more bytes than one may have once decoded; `bytes_each`: of a pixel."""
    decoded = rows * columns * bytes_each
    large = f"{name} claims {rows} x {columns} pixels, {decoded} bytes once decoded, more than the {DECODED_BYTES} that"
    require(decoded <= DECODED_BYTES, f"{large} are read; reduce the image.")


def check_held(rows: int, columns: int, least_each: float, stored: int, name: str) -> None:
    """Refuse an image of more pixels than can be in the `stored` bytes of its file; `least_each`: bytes of a pixel."""
    impossible = f"it claims {rows} x {columns} pixels, which cannot be in {stored} bytes; copy it again."
    require(rows * columns * least_each <= stored, f"{name} is damaged: {impossible}")


class _Silence:
    """While any thread is inside, nothing reaches the process's stderr: libpng and libjpeg print what they refuse."""

    def __init__(self) -> None:
        self._lock, self._inside, self._stderr = threading.Lock(), 0, -1

    def __enter__(self) -> None:
        with self._lock:
            self._inside += 1
            if self._inside == 1:
                with contextlib.suppress(OSError):  # closed
                    self._stderr = os.dup(2)
                    null = os.open(os.devnull, os.O_WRONLY)
                    os.dup2(null, 2)
                    os.close(null)

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._inside -= 1
            if self._inside == 0 and self._stderr >= 0:
                os.dup2(self._stderr, 2)
                os.close(self._stderr)
                self._stderr = -1


_SILENCE = _Silence()


def decoded(data: bytes, name: str) -> NDArray[Any]:
    """Pixels (H, W, C) of an image file whose header was checked, as stored, in the order red, green, blue, alpha.
    Raises BadInput where OpenCV cannot decode them.
    """
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # what it would print is refused here
    damaged = f"{name} is damaged: its image data cannot be decoded; copy it again, or save it as PNG."
    image: Any = None
    with refusing(damaged), _SILENCE:
        image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    require(image is not None, damaged)
    if image.ndim == 2:
        return np.asarray(image[..., None])
    if image.dtype == np.float64:
        return np.asarray(image[..., [2, 1, 0, 3][: image.shape[2]]])
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB if image.shape[2] == 3 else cv2.COLOR_BGRA2RGBA))


def placed(image: NDArray[Any], out: PixelArray | None, like: Any, name: str) -> PixelArray:
    """A decoded image, without alpha and in `out` if given. BadInput if it is of another kind than its header says
    (`like`: its rows, columns, channels and dtype).
    """
    image = image[..., : like.channels]
    same = image.shape == (like.rows, like.columns, like.channels) and image.dtype == like.dtype
    require(same, f"{name} is stored in a way that is not read; save it as 8- or 16-bit PNG, grey or RGB.")
    if out is None:
        return np.ascontiguousarray(image)
    out[...] = image
    return out


def decode_png(data: bytes, name: str, out: PixelArray | None = None) -> PixelArray:
    """PNG as (H, W, C) uint8 or uint16, C = 1 or 3, no alpha or palette, in `out` if given; BadInput if damaged."""
    return placed(png_pixels(data, name), out, png_header(data, name), name)


def png_pixels(data: bytes, name: str) -> NDArray[Any]:
    """As :func:`decode_png`, with alpha behind the colours where there is some: C = 1 to 4."""
    header = png_header(data, name)
    pixels = decoded(_image_chunks(data, name, header), name)
    return pixels[..., ::3] if header.channels == 1 and pixels.shape[2] == 4 else pixels


def _image_chunks(data: bytes, name: str, header: PngHeader) -> bytes:
    """The file with the chunks alone that make the image, all of them walked to the last."""
    wanted = (b"IHDR", b"IDAT", b"IEND", *((b"PLTE", b"tRNS") if header.palette else ()))
    view, kept, position, kind = memoryview(data), [memoryview(SIGNATURE)], 8, b""
    while kind != b"IEND":
        end = position + 12 + int.from_bytes(view[position : position + 4], "big")
        require(end <= len(data), f"{name} is truncated: the file ends within the image; copy it again.")
        kind = bytes(view[position + 4 : position + 8])
        sound = zlib.crc32(view[position + 4 : end - 4]) == int.from_bytes(view[end - 4 : end], "big")
        require(sound, f"{name} is damaged: a checksum does not match; copy it again.")
        known = kind in (b"IHDR", b"IDAT", b"IEND", b"PLTE") or bool(kind[0] & 0x20)
        require(known, f"{name} is damaged: the PNG chunk {kind!r} is not known.")
        require((kind == b"IHDR") == (position == 8), f"{name} is damaged: its PNG chunks are out of order.")
        kept += [view[position:end]] if kind in wanted else []
        position = end
    return b"".join(kept)


def chunks_of(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Kind and content of every chunk of a sound PNG file."""
    place = len(SIGNATURE)
    while place + 8 <= len(data):
        length = int.from_bytes(data[place : place + 4], "big")
        yield data[place + 4 : place + 8], data[place + 8 : place + 8 + length]
        place += 12 + length


def png_chunk(kind: bytes, content: bytes) -> bytes:
    """One chunk of a PNG file, whole."""
    return len(content).to_bytes(4, "big") + kind + content + zlib.crc32(content, zlib.crc32(kind)).to_bytes(4, "big")
