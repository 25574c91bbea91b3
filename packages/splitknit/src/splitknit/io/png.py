"""PNG files: their chunks are checked here, libpng (by imagecodecs) decodes what makes the image and nothing else.

A decoder of C takes memory by what the header claims, passes over chunks that it does not know, and stops reading
with the last row. So sizes are checked first, all chunks are walked to the end (lengths, CRC-32), and texts, colour
profiles and transparency never reach it. What libpng only warns of, such as more image data than rows, is damage.

Source: Portable Network Graphics (PNG) Specification, second edition, W3C 2003; chunk layout section 5.3, colour types
section 11.2.2, interlace section 8.2.
"""

from __future__ import annotations

import logging
import struct
import sys
import threading
import zlib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import refusing, require
from splitknit.model import BoolArray, PixelArray

SIGNATURE = b"\x89PNG\r\n\x1a\n"
_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
_DEPTHS = {0: (1, 2, 4, 8, 16), 2: (8, 16), 3: (1, 2, 4, 8), 4: (8, 16), 6: (8, 16)}
DECODED_BYTES = 400_000_000
"""Bytes of one decoded image, at most: 130 million pixels of 8-bit RGB. Decoders of C hold a second copy beside it."""
DEFLATE_RATIO = 1032  # deflate makes no more of a byte (zlib, technical details): a longer image cannot be in the file
_PLAIN = frozenset((0, 2))  # row filters none and up, section 9.2


@dataclass(frozen=True, slots=True)
class _PngHeader:
    rows: int
    columns: int
    depth: int  # bits per sample
    colour: int  # 0 grey, 2 RGB, 3 palette, 4 grey and alpha, 6 RGB and alpha
    interlaced: bool

    @property
    def channels(self) -> int:
        """Channels after decoding, alpha dropped: 1 or 3."""
        return 1 if self.colour in (0, 4) else 3

    @property
    def dtype(self) -> np.dtype[Any]:
        """Stored integer type after decoding."""
        return np.dtype(np.uint16 if self.depth == 16 else np.uint8)

    def packed(self) -> bytes:
        """The content of the IHDR chunk."""
        return struct.pack(">IIBBBBB", self.columns, self.rows, self.depth, self.colour, 0, 0, self.interlaced)


def png_header(data: bytes, name: str) -> _PngHeader:
    """The IHDR chunk of `data`; BadInput, with `name`, if unsound, too large to decode or to be in the file."""
    damaged = f"{name} is not a sound PNG file (its header is damaged); capture or export it again."
    require(len(data) >= 33 and data[:8] == SIGNATURE and data[8:16] == b"\0\0\0\rIHDR", damaged)
    require(zlib.crc32(data[12:29]) == int.from_bytes(data[29:33], "big"), damaged)
    columns, rows, depth, colour, compression, filters, interlace = struct.unpack(">IIBBBBB", data[16:29])
    require(0 < rows < 1 << 31 and 0 < columns < 1 << 31, damaged)
    require(depth in _DEPTHS.get(colour, ()) and (compression, filters) == (0, 0) and interlace in (0, 1), damaged)
    header = _PngHeader(rows, columns, depth, colour, bool(interlace))
    check_size(rows, columns, header.channels * header.dtype.itemsize, name)
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


def decode_png(data: bytes, name: str, out: PixelArray | None = None) -> PixelArray:
    """PNG as (H, W, C) uint8 or uint16, C = 1 or 3, no alpha or palette, in `out` if given; BadInput if damaged."""
    header = png_header(data, name)
    palette, image_data = _walk(data, name)
    if out is None:
        out = np.empty((header.rows, header.columns, header.channels), dtype=header.dtype)
    if header.colour == 3:
        _decode_palette(header, palette, image_data, name, out)
    elif header.colour in (4, 6):
        whole = np.empty((*out.shape[:2], _CHANNELS[header.colour]), dtype=header.dtype)
        _decode(header, image_data, name, whole)
        out[...] = whole[..., :-1]
    else:
        _decode(header, image_data, name, out)
    return out


def png_opaque(data: bytes, name: str) -> BoolArray | None:
    """Where a sound PNG file is opaque by half or more (H, W); None where it has no transparency."""
    header = png_header(data, name)
    palette, image_data = _walk(data, name)
    if header.colour in (4, 6):
        whole = np.empty((header.rows, header.columns, _CHANNELS[header.colour]), dtype=header.dtype)
        _decode(header, image_data, name, whole)
        return np.asarray(whole[..., -1] > np.iinfo(header.dtype).max // 2)
    alpha = next((content for kind, content in chunks_of(data) if kind == b"tRNS"), b"")
    if header.colour != 3 or not alpha:  # one transparent colour of grey or RGB is left as it is
        return None
    opaque = np.frombuffer(alpha[:256].ljust(256, b"\xff"), dtype=np.uint8) > 127
    return np.asarray(opaque[_palette_index(header, palette, image_data, name)])


def _walk(data: bytes, name: str) -> tuple[bytes, list[memoryview]]:
    """Walk all chunks to the last; return the content of the palette and the whole chunks of image data."""
    view = memoryview(data)
    palette, image_data = b"", []
    position, kind = 8, b""
    while kind != b"IEND":
        length = int.from_bytes(view[position : position + 4], "big")
        end = position + 12 + length
        require(end <= len(data), f"{name} is truncated: the file ends within the image; copy it again.")
        kind = bytes(view[position + 4 : position + 8])
        if kind == b"IDAT":  # libpng compares its checksum
            image_data.append(view[position:end])
            position = end
            continue
        sound = zlib.crc32(view[position + 4 : end - 4]) == int.from_bytes(view[end - 4 : end], "big")
        require(sound, f"{name} is damaged: a checksum does not match; copy it again.")
        if kind == b"PLTE":
            palette = bytes(view[position + 8 : end - 4])
        elif kind not in (b"IHDR", b"IEND"):
            require(bool(kind[0] & 0x20), f"{name} is damaged: the PNG chunk {kind!r} is not known.")
        position = end
    return palette, image_data


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


class _Warnings(logging.Handler):
    """The last warning of a decoder about PNG image data, in each thread; it also keeps all warnings from stderr."""

    last = threading.local()

    def emit(self, record: logging.LogRecord) -> None:
        if "IDAT" in record.getMessage():  # others are of how libpng is called
            self.last.words = record.getMessage()


def codecs() -> Any:
    """The package imagecodecs, which is slow to import and prints nothing then."""
    import imagecodecs

    log = logging.getLogger("imagecodecs")
    if not any(isinstance(one, _Warnings) for one in log.handlers):
        log.addHandler(_Warnings())
    return imagecodecs


def _decode(header: _PngHeader, image_data: list[memoryview], name: str, out: NDArray[Any]) -> None:
    """Decode grey or RGB, with or without alpha, into `out` (H, W, C)."""
    if _decode_plain(header, image_data, out):
        return
    sound = b"".join([SIGNATURE, png_chunk(b"IHDR", header.packed()), *image_data, png_chunk(b"IEND", b"")])
    _Warnings.last.words = ""
    damaged = f"{name} is damaged: its image data cannot be decoded; copy it again."
    with refusing(damaged):  # also where imagecodecs has lost libpng's message, which is not UTF-8 then
        codecs().png_decode(sound, out=out if out.shape[2] > 1 else out[..., 0])
    require(not _Warnings.last.words, damaged)


def _decode_plain(header: _PngHeader, image_data: list[memoryview], out: NDArray[Any]) -> bool:
    """Decode rows that are at most differences to the row above, as :func:`write_image` writes them, in 0.6 of libpng's
    time; return whether that was done: libpng decides where anything is unusual or unsound."""
    packed, row = b"".join(chunk[8:-4] for chunk in image_data), out[0].nbytes + 1
    with suppress(zlib.error, codecs().DeflateError):
        first = zlib.decompressobj().decompress(packed, 8 * row)  # a few rows show whether to inflate all
        if header.interlaced or header.depth < 8 or not _PLAIN.issuperset(first[::row]):
            return False
        lines = np.empty((header.rows, row), dtype=np.uint8)
        whole = len(codecs().deflate_decode(packed, out=lines.reshape(-1))) == lines.size
        ends = codecs().deflate_adler32(lines) == int.from_bytes(packed[-4:], "big")  # nothing follows
        sound = all(codecs().deflate_crc32(one[4:-4]) == int.from_bytes(one[-4:], "big") for one in image_data)
        if not (whole and ends and sound and _PLAIN.issuperset(filters := lines[:, 0].tolist())):
            return False
        above = np.zeros(row - 1, dtype=np.uint8)
        for up, line, values in zip(filters, lines[:, 1:], out.reshape(len(out), -1).view(np.uint8), strict=True):
            above = np.add(above, line, out=values) if up else np.positive(line, out=values)
        if header.depth == 16 and sys.byteorder == "little":
            out.byteswap(inplace=True)
        return True
    return False


def _decode_palette(
    header: _PngHeader, palette: bytes, image_data: list[memoryview], name: str, out: PixelArray
) -> None:
    index = _palette_index(header, palette, image_data, name)
    np.frombuffer(palette, dtype=np.uint8).reshape(-1, 3).take(index, axis=0, out=out)


def _palette_index(header: _PngHeader, palette: bytes, image_data: list[memoryview], name: str) -> NDArray[np.uint8]:
    """Numbers (H, W) of colours, decoded as grey values: libpng takes any colour for one beyond the palette."""
    require(len(palette) > 0, f"{name} is damaged: a PNG image with a palette that is missing.")
    require(len(palette) % 3 == 0 and len(palette) <= 768, f"{name} is damaged: its palette has an impossible length.")
    index = np.empty((header.rows, header.columns, 1), dtype=np.uint8)
    _decode(replace(header, colour=0), image_data, name, index)
    index //= np.uint8(255 // (2**header.depth - 1))  # libpng stretches 1, 2 and 4 bits to the full scale
    require(int(index.max()) < len(palette) // 3, f"{name} is damaged: it refers to a colour beyond its palette.")
    return index[..., 0]
