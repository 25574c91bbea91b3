"""PNG files, checked byte by byte before the decoder sees them.

The decoder's C library prints on stderr and may hand out half an image when a file is damaged. So the chunks are
walked here (lengths, CRC-32), the image data is inflated here (which checks it to the last byte), and what the C
library gets are strips of rows in a fresh, sound wrapping: all that is left for it is to undo the row filters. Strips
also keep the memory small: beside the pixels themselves only the file and one strip exist.

Source: Portable Network Graphics (PNG) Specification, second edition, W3C 2003; chunk layout section 5.3, colour types
section 11.2.2, filters section 9, interlace section 8.2.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, require
from splitknit.io.deflate import DAMAGED, engine
from splitknit.model import PixelArray

SIGNATURE = b"\x89PNG\r\n\x1a\n"
_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
_DEPTHS = {0: (1, 2, 4, 8, 16), 2: (8, 16), 3: (1, 2, 4, 8), 4: (8, 16), 6: (8, 16)}
_ADAM7 = ((0, 0, 8, 8), (0, 4, 8, 8), (4, 0, 8, 4), (0, 2, 4, 4), (2, 0, 4, 2), (0, 1, 2, 2), (1, 0, 2, 1))
"""First row, first column, row step, column step of the seven passes."""
_STRIP_BYTES = 1 << 20
_PIECE_BYTES = 1 << 18
DECODED_BYTES = 400_000_000
"""Of one decoded image: 130 million pixels of 8-bit RGB. Decoders of C hold a second copy beside it."""
DEFLATE_RATIO = 1032
"""Deflate makes no more of a byte (zlib, technical details): a longer image cannot be in the file."""
_WHOLE_BYTES = 100_000_000
"""Of an image that is decoded in one piece, which takes four copies: interlaced, palette, or below 8 bits."""


@dataclass(frozen=True, slots=True)
class _PngHeader:
    """The facts of the IHDR chunk."""

    rows: int
    columns: int
    depth: int
    """Bits per sample."""
    colour: int
    """0 grey, 2 RGB, 3 palette, 4 grey and alpha, 6 RGB and alpha."""
    interlaced: bool

    @property
    def channels(self) -> int:
        """Channels after decoding, alpha dropped: 1 or 3."""
        return 1 if self.colour in (0, 4) else 3

    @property
    def dtype(self) -> np.dtype[Any]:
        """Stored integer type after decoding."""
        return np.dtype(np.uint16 if self.depth == 16 else np.uint8)

    def line_bytes(self, columns: int | None = None) -> int:
        """Bytes of one filtered row: the filter's number and the packed samples."""
        width = self.columns if columns is None else columns
        return 1 + (width * _CHANNELS[self.colour] * self.depth + 7) // 8

    def passes(self) -> list[tuple[int, int]]:
        """(rows, bytes of a row) of every interlace pass; one pass for an image that is not interlaced."""
        if not self.interlaced:
            return [(self.rows, self.line_bytes())]
        sizes = [(-(-(self.rows - r) // dr), -(-(self.columns - c) // dc)) for r, c, dr, dc in _ADAM7]
        return [(rows, self.line_bytes(columns)) for rows, columns in sizes if rows > 0 and columns > 0]


def png_header(data: bytes, name: str) -> _PngHeader:
    """Read the IHDR chunk of `data`; `name` is for messages. Raises BadInput if it is not sound, or claims an image too
    large to be decoded, or to be in the file.
    """
    damaged = f"{name} is not a sound PNG file (its header is damaged); capture or export it again."
    require(len(data) >= 33 and data[:8] == SIGNATURE and data[8:16] == b"\0\0\0\rIHDR", damaged)
    require(zlib.crc32(data[12:29]) == int.from_bytes(data[29:33], "big"), damaged)
    columns, rows, depth, colour, compression, filters, interlace = struct.unpack(">IIBBBBB", data[16:29])
    require(0 < rows < 1 << 31 and 0 < columns < 1 << 31, damaged)
    require(depth in _DEPTHS.get(colour, ()) and (compression, filters) == (0, 0) and interlace in (0, 1), damaged)
    header = _PngHeader(rows, columns, depth, colour, bool(interlace))
    check_size(rows * columns * header.channels * header.dtype.itemsize, name, f"{rows} x {columns}")
    stored = sum(count * line for count, line in header.passes())
    require(
        stored <= DEFLATE_RATIO * len(data),
        f"{name} is damaged: it claims {rows} x {columns} pixels, which cannot be in {len(data)} bytes; copy it again.",
    )
    require(
        stored <= _WHOLE_BYTES or not (interlace or depth < 8 or colour == 3),
        f"{name} claims {rows} x {columns} pixels, too many for an interlaced PNG or one with a palette; save it as "
        "plain grey or RGB.",
    )
    return header


def check_size(decoded_bytes: int, name: str, words: str) -> None:
    """Refuse an image of more bytes than one may have once decoded; `words` is its size in pixels."""
    require(
        decoded_bytes <= DECODED_BYTES,
        f"{name} claims {words} pixels, {decoded_bytes} bytes once decoded, more than the {DECODED_BYTES} that are "
        "read; reduce the image.",
    )


def decode_png(data: bytes, name: str, out: PixelArray | None = None) -> PixelArray:
    """Decode a PNG file to (H, W, C) uint8 or uint16 in RGB order, C = 1 or 3; alpha is dropped, palettes expanded.
    `out`: array of the header's size, channels and type to decode into. Raises BadInput if the file is damaged.
    """
    header = png_header(data, name)
    palette, compressed = _walk(data, name)
    if out is None:
        out = np.empty((header.rows, header.columns, header.channels), dtype=header.dtype)
    if header.colour == 3:
        require(palette is not None, f"{name} is damaged: a PNG image with a palette that is missing.")
        assert palette is not None
        _decode_palette(header, palette, compressed, name, out)
    elif header.interlaced or header.depth < 8:
        lines = b"".join(_inflate(compressed, header, name))
        _store(_unfilter(header, lines, header.rows, name), header.colour, out)
    else:
        _decode_strips(header, compressed, name, out)
    return out


def _walk(data: bytes, name: str) -> tuple[bytes | None, bytes]:
    """Walk all chunks; return the palette, if any, and the compressed image data."""
    view = memoryview(data)
    palette: bytes | None = None
    pieces = []
    position, end = 8, False
    while not end:
        require(position + 12 <= len(data), f"{name} is truncated: the file ends within the image; copy it again.")
        length = int.from_bytes(view[position : position + 4], "big")
        kind = bytes(view[position + 4 : position + 8])
        require(
            position + 12 + length <= len(data),
            f"{name} is truncated: the file ends within the image; copy it again.",
        )
        stored = int.from_bytes(view[position + 8 + length : position + 12 + length], "big")
        require(
            engine.crc32(view[position + 4 : position + 8 + length]) == stored,
            f"{name} is damaged: a checksum does not match; copy it again.",
        )
        body = view[position + 8 : position + 8 + length]
        if kind == b"IDAT":
            pieces.append(body)
        elif kind == b"PLTE":
            palette = bytes(body)
        elif kind not in (b"IHDR", b"IEND"):
            require(bool(kind[0] & 0x20), f"{name} is damaged: the PNG chunk {kind!r} is not known.")
        end = kind == b"IEND"
        position += 12 + length
    return palette, b"".join(pieces)


def chunks_of(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Kind and content of every chunk of a sound PNG file."""
    place = len(SIGNATURE)
    while place + 8 <= len(data):
        length = int.from_bytes(data[place : place + 4], "big")
        yield data[place + 4 : place + 8], data[place + 8 : place + 8 + length]
        place += 12 + length


def _inflate(compressed: bytes, header: _PngHeader, name: str) -> Iterator[bytes]:
    """Inflate the image data piece by piece; exactly the header's number of bytes must come out."""
    left = sum(rows * line for rows, line in header.passes())
    job = engine.decompressobj()
    view = memoryview(compressed)
    try:
        for start in range(0, len(view), _PIECE_BYTES):
            piece = job.decompress(view[start : start + _PIECE_BYTES], left + 1)
            left -= len(piece)
            require(left >= 0, f"{name} is damaged: it holds more image data than its header states.")
            yield piece
    except DAMAGED as error:
        raise BadInput(f"{name} is damaged: its image data cannot be decompressed; copy it again.") from error
    require(left == 0 and job.eof, f"{name} is damaged: its image data is incomplete; copy it again.")


def _decode_strips(header: _PngHeader, compressed: bytes, name: str, out: PixelArray) -> None:
    line = header.line_bytes()
    strip_bytes = max(1, _STRIP_BYTES // line) * line
    pending = bytearray()  # begins with the last decoded row, as the file would store it: row filters refer to it
    row = held = 0
    for piece in _inflate(compressed, header, name):
        pending += piece
        while (new := len(pending) - held) >= strip_bytes or (new and new == (header.rows - row) * line):
            count = min(new, strip_bytes) // line
            with memoryview(pending) as view:
                strip = _unfilter(header, view[: held + count * line], count + held // line, name)[held // line :]
            _store(strip, header.colour, out[row : row + count])
            pending[: held + count * line] = b"\0" + _stored_row(strip[-1], header)
            row, held = row + count, line


def _decode_palette(header: _PngHeader, palette: bytes, compressed: bytes, name: str, out: PixelArray) -> None:
    require(
        len(palette) % 3 == 0 and 0 < len(palette) <= 768, f"{name} is damaged: its palette has an impossible length."
    )
    grey = _PngHeader(header.rows, header.columns, header.depth, 0, header.interlaced)
    index = _unfilter(grey, b"".join(_inflate(compressed, header, name)), header.rows, name)
    index = index // (255 // (2**header.depth - 1))  # the decoder stretches 1, 2 and 4 bits to the full scale
    table = np.frombuffer(palette, dtype=np.uint8).reshape(-1, 3)
    require(int(index.max()) < len(table), f"{name} is damaged: it refers to a colour beyond its palette.")
    for row in range(header.rows):
        out[row] = table[index[row]]


def _unfilter(header: _PngHeader, lines: bytes | memoryview, rows: int, name: str) -> NDArray[Any]:
    """Undo the row filters of `rows` complete filtered rows with the C library; gives grey, RGB or BGRA."""
    import cv2  # slow to import

    _check_filters(header, lines, rows, name)
    shape = struct.pack(">IIBBBBB", header.columns, rows, header.depth, header.colour, 0, 0, header.interlaced)
    wrapped = b"".join(
        [
            SIGNATURE,
            *_chunk(b"IHDR", shape),
            *_chunk(b"IDAT", *_stored(lines)),
            *_chunk(b"IEND"),
        ]
    )
    try:
        # RGB at once where OpenCV can; alpha, which it would drop, is needed for the next strip's filters
        rgb = header.colour == 2 and hasattr(cv2, "IMREAD_COLOR_RGB")
        how = cv2.IMREAD_COLOR_RGB | cv2.IMREAD_ANYDEPTH if rgb else cv2.IMREAD_UNCHANGED
        image = cv2.imdecode(np.frombuffer(wrapped, dtype=np.uint8), how)
        if image is not None and header.colour == 2 and not rgb:
            image = image[..., ::-1]
    except cv2.error as error:
        raise BadInput(f"{name} cannot be decoded: {error.err}.") from error
    if image is None or image.shape[:2] != (rows, header.columns):
        raise BadInput(f"{name} cannot be decoded; capture or export it again.")
    return np.asarray(image)


def _stored(data: bytes | memoryview) -> list[bytes | memoryview]:
    """The pieces of a zlib stream of `data` that packs nothing; zlib takes ten times as long to make one."""
    view = memoryview(data)
    pieces: list[bytes | memoryview] = [b"\x78\x01"]
    for start in range(0, len(view), 65535):
        part = view[start : start + 65535]
        pieces += [struct.pack("<BHH", start + len(part) == len(view), len(part), 65535 - len(part)), part]
    return [*pieces, engine.adler32(view).to_bytes(4, "big")]


def _check_filters(header: _PngHeader, lines: bytes | memoryview, rows: int, name: str) -> None:
    data = np.frombuffer(lines, dtype=np.uint8)
    sizes = header.passes() if header.interlaced else [(rows, header.line_bytes())]
    position = 0
    for count, line in sizes:
        kinds = data[position : position + count * line : line]
        require(int(kinds.max()) <= 4, f"{name} is damaged: it uses a row filter that does not exist.")
        position += count * line


def _store(image: NDArray[Any], colour: int, out: PixelArray) -> None:
    """Copy a decoded image (grey, RGB or BGRA) into `out` (H, W, C) in RGB order without alpha."""
    if colour == 2:
        out[...] = image
    elif colour == 6:
        copy_rgb(image, out)
    else:
        out[..., 0] = image if image.ndim == 2 else image[..., 0]


def copy_rgb(image: NDArray[Any], out: PixelArray) -> None:
    """Copy blue-green-red(-alpha) pixels into `out` (H, W, 3) as red-green-blue."""
    import cv2  # slow to import

    code = cv2.COLOR_BGR2RGB if image.shape[2] == 3 else cv2.COLOR_BGRA2RGB
    if out.flags.c_contiguous:
        cv2.cvtColor(image, code, dst=out)
    else:
        out[...] = image[..., 2::-1]


def _stored_row(row: NDArray[Any], header: _PngHeader) -> bytes:
    """Return one decoded row (W,) or (W, C) in the byte order of the file."""
    if header.colour == 6:
        row = row[:, [2, 1, 0, 3]]
    elif header.colour == 4:
        row = row[:, [0, 3]]
    return np.ascontiguousarray(row, dtype=header.dtype.newbyteorder(">")).tobytes()


def _chunk(kind: bytes, *body: bytes | memoryview) -> list[bytes | memoryview]:
    checksum = reduce(lambda so_far, piece: engine.crc32(piece, so_far), body, engine.crc32(kind))
    return [sum(map(len, body)).to_bytes(4, "big"), kind, *body, checksum.to_bytes(4, "big")]
