"""TIFF files with one flat image, grey or RGB: the tags are read and checked here, LZW alone is decoded by OpenCV.

Nothing is allocated before the strips or tiles that the tags name are known to lie in the file, side by side, and to be
long enough for the image. Tags that no reader here needs are passed over. Damage inside LZW data may go unnoticed, as
inside JPEG data: OpenCV decodes on.

Source: TIFF, revision 6.0, Adobe 1992: sections 2 (image file directory), 9 (PackBits), 14 (predictor), 15 (tiles).
"""

from __future__ import annotations

import io
import logging
import math
import os
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, refusing, require
from splitknit.io.atomic import write_file
from splitknit.io.png import DEFLATE_RATIO, check_size, copy_rgb
from splitknit.io.provenance import canonical_json
from splitknit.model import PixelArray

SIGNATURES = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
DESCRIPTION, X_RESOLUTION, Y_RESOLUTION, RESOLUTION_UNIT = 270, 282, 283, 296
_COLUMNS, _ROWS, _BITS, _COMPRESSION, _PHOTOMETRIC, _BIT_ORDER = 256, 257, 258, 259, 262, 266
_SAMPLES, _STRIP_ROWS, _PLANAR, _PREDICTOR, _FORMAT, _DEPTH = 277, 278, 284, 317, 339, 32997
_STRIP_OFFSETS, _STRIP_BYTES, _TILE_COLUMNS, _TILE_ROWS, _TILE_OFFSETS, _TILE_BYTES = 273, 279, 322, 323, 324, 325
_ORIENTATION, _SHORT = 274, 3
_OPTIONAL = {DESCRIPTION, X_RESOLUTION, Y_RESOLUTION, RESOLUTION_UNIT}
_READ = _OPTIONAL | {
    *(_COLUMNS, _ROWS, _BITS, _COMPRESSION, _PHOTOMETRIC, _BIT_ORDER),
    *(_SAMPLES, _STRIP_ROWS, _PLANAR, _PREDICTOR, _FORMAT, _DEPTH),
    *(_STRIP_OFFSETS, _STRIP_BYTES, _TILE_COLUMNS, _TILE_ROWS, _TILE_OFFSETS, _TILE_BYTES),
}
_TYPES = {1: ("u1", 1), 2: ("u1", 1), 3: ("u2", 1), 4: ("u4", 1), 5: ("u4", 2), 7: ("u1", 1), 16: ("u8", 1)}
"""Of a tag's values: kind, and how many make one value."""
_WHOLE = frozenset({1, 3, 4, 16})
"""Types of whole numbers, which all tags but the optional ones hold."""
_KINDS = {1: "uint", 2: "int", 3: "float"}
_NONE, _LZW, _DEFLATE, _OLD_DEFLATE, _PACKBITS = 1, 5, 8, 32946, 32773
_RATIO = {_NONE: 1, _LZW: 2560, _DEFLATE: DEFLATE_RATIO, _OLD_DEFLATE: DEFLATE_RATIO, _PACKBITS: 64}
"""The most bytes that a stored byte can become; of LZW a string of 3838 bytes for 12 bits."""
_WHITE_IS_ZERO, _BLACK_IS_ZERO, _RGB = 0, 1, 2
_SEPARATE = 2
_MAX_TAGS = 4096
_LONGEST_TEXT = 1_000_000
_MIN_TILE = 16
_INCH, _CENTIMETRE, _CM_PER_INCH = 2, 3, 2.54


@dataclass(frozen=True, slots=True, eq=False)
class TiffPage:
    """The facts of the first page."""

    rows: int
    columns: int
    samples: int
    """Channels as stored, with alpha."""
    dtype: np.dtype[Any]
    """As stored, with its order of bytes."""
    photometric: int
    compression: int
    predictor: bool
    """Whether differences along the rows are stored."""
    separate: bool
    """Whether each channel has strips or tiles of its own."""
    segment: tuple[int, int]
    """Rows and columns of a strip or tile."""
    places: tuple[tuple[int, int], ...]
    """Offset and length of each."""
    tags: Mapping[int, NDArray[Any]]
    """Values by the number of the tag; those of fractions alternate."""

    @property
    def channels(self) -> int:
        """Channels after decoding: 1 or 3."""
        return 1 if self.photometric in (_WHITE_IS_ZERO, _BLACK_IS_ZERO) else 3

    @property
    def description(self) -> str:
        """Text of the description tag, empty where there is none; a longer one is cut."""
        text = self.tags.get(DESCRIPTION, np.zeros(0, np.uint8))[:_LONGEST_TEXT].tobytes()
        return text.rstrip(b"\0").decode("utf-8", "replace")


def encode_tiff(image: NDArray[Any], **tags: Any) -> bytes:
    """An uncompressed TIFF file of one page (H, W) or (H, W, 3); equal input gives equal bytes. `tags` are arguments of
    tifffile's ``imwrite``, such as the resolution.
    """
    import tifffile  # slow to import

    logger = logging.getLogger("tifffile")
    if not logger.handlers:  # its warnings would go to stderr
        logger.addHandler(logging.NullHandler())
    stream = io.BytesIO()
    photometric = "minisblack" if image.ndim == 2 else "rgb"
    tifffile.imwrite(stream, image, photometric=photometric, metadata=None, software="splitknit", **tags)
    return stream.getvalue()


def write_float_tiff(
    path: str | os.PathLike[str],
    field: NDArray[np.floating],
    unit: str,
    metadata: Mapping[str, Any] | None = None,
    pitch_mm: float | None = None,
) -> None:
    """Write a field of floats (H, W) or (H, W, 3), NaN where nothing is known, as an uncompressed float32 TIFF.

    The description tag is a JSON object with ``unit`` (such as ``mm``, ``pixel`` or ``linear light, 1 = full scale``),
    ``pitch_mm`` (exact; None where unknown: no resolution is stated then), and everything in `metadata`, what JSON can
    hold; pixels per centimetre are in the resolution tags. Equal input gives equal bytes. Raises BadInput if the array
    or the pitch is of another kind, or the file cannot be written.
    """
    image = np.ascontiguousarray(field, dtype=np.float32)
    good = image.size > 0 and (image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3))
    require(good, f"a field to write must have the shape (H, W) or (H, W, 3), but it has {image.shape}.")
    description = {**(metadata or {}), "unit": unit}
    tags: dict[str, Any] = {}
    if pitch_mm is not None:
        require(bool(np.isfinite(pitch_mm)) and pitch_mm > 0, f"pitch_mm must be a positive number, not {pitch_mm}.")
        description["pitch_mm"] = float(pitch_mm)
        tags = {"resolution": (10.0 / float(pitch_mm),) * 2, "resolutionunit": "CENTIMETER"}
    write_file(path, encode_tiff(image, description=canonical_json(description), **tags))


def tiff_page(data: bytes, name: str) -> TiffPage:
    """Read and check the first page's tags. Raises BadInput if they are damaged, name strips that are not in the file,
    or the image is not flat grey or RGB of 8 to 64 bits.
    """
    damaged = f"{name} is not a sound TIFF file: its tags are damaged; export it again."
    with refusing(damaged):
        order, tags = _tags(data, damaged)

        def number(tag: int, default: int = 0) -> int:
            return int(tags[tag][0]) if tag in tags else default

        rows, columns, samples = number(_ROWS), number(_COLUMNS), number(_SAMPLES, 1)
        bits, kind = (set(tags[tag].tolist()) if tag in tags else {1} for tag in (_BITS, _FORMAT))
        photometric, compression = number(_PHOTOMETRIC, -1), number(_COMPRESSION, _NONE)
    flat = 0 < rows < 1 << 31 and 0 < columns < 1 << 31 and number(_DEPTH, 1) == 1
    require(flat, f"{name} is not a single flat image; save it as PNG.")
    shown = f"{_KINDS.get(max(kind), 'unknown')}{max(bits)}"
    known = len(bits) == len(kind) == 1 and shown in ("uint8", "uint16", "int8", "int16", "float32", "float64")
    require(
        known, f"{name} has {max(bits)}-bit samples of the type {shown}; save it as 8- or 16-bit unsigned integers."
    )
    grey = photometric in (_WHITE_IS_ZERO, _BLACK_IS_ZERO) and samples in (1, 2)
    colour = photometric == _RGB and samples in (3, 4)
    require(grey or colour, f"{name} is neither grey nor RGB (CMYK or palette?); save it as grey or RGB.")
    readable = compression in _RATIO and number(_PREDICTOR, 1) in (1, 2)
    require(
        readable and number(_BIT_ORDER, 1) == 1 and number(_PLANAR, 1) in (1, 2),
        f"{name} has an unsupported storage format (compression {compression}, predictor {number(_PREDICTOR, 1)}, "
        f"order of bits {number(_BIT_ORDER, 1)}); save it as PNG or as uncompressed TIFF.",
    )
    dtype = np.dtype(shown).newbyteorder(order)
    check_size(rows * columns * samples * dtype.itemsize, name, f"{rows} x {columns}")
    tiled = _TILE_OFFSETS in tags
    if tiled:
        segment = number(_TILE_ROWS), number(_TILE_COLUMNS)
        require(min(segment) >= _MIN_TILE and segment[0] < rows + 4096 and segment[1] < columns + 4096, damaged)
    else:
        segment = max(1, min(number(_STRIP_ROWS, rows), rows)), columns
    separate = samples > 1 and number(_PLANAR, 1) == _SEPARATE
    count = math.ceil(rows / segment[0]) * math.ceil(columns / segment[1]) * (samples if separate else 1)
    where = (_TILE_OFFSETS, _TILE_BYTES) if tiled else (_STRIP_OFFSETS, _STRIP_BYTES)
    offsets, lengths = (tags.get(tag) for tag in where)
    if lengths is None and offsets is not None and count == 1 and compression == _NONE:  # written by old programs
        lengths = np.array([rows * columns * samples * dtype.itemsize])
    whole = offsets is not None and lengths is not None and len(offsets) == len(lengths) == count
    require(whole, damaged)
    places = tuple(zip(offsets.tolist(), lengths.tolist(), strict=True))  # type: ignore[union-attr]
    require(
        all(offset > 0 and length > 0 and offset + length <= len(data) for offset, length in places),
        f"{name} is truncated: the TIFF file ends within the image; copy it again.",
    )
    stored = sum(length for _, length in places)
    require(stored <= len(data), damaged)
    page = TiffPage(
        rows, columns, samples, dtype, photometric, compression, number(_PREDICTOR, 1) == 2, separate, segment, places,
        tags,
    )  # fmt: skip
    require(
        rows * columns * samples * dtype.itemsize <= _RATIO[compression] * stored,
        f"{name} is damaged: it claims {rows} x {columns} pixels, which cannot be in {stored} bytes; copy it again.",
    )
    return page


def tiff_header(data: bytes, name: str) -> TiffPage:
    """Read the first page's tags. Raises BadInput as :func:`tiff_page`, and if the image is not 8- or 16-bit grey or
    RGB.
    """
    page = tiff_page(data, name)
    require(
        page.dtype in (np.uint8, np.dtype("<u2"), np.dtype(">u2")),
        f"{name} has {8 * page.dtype.itemsize}-bit samples of the type {page.dtype.newbyteorder('=')}; save it as 8- "
        "or 16-bit unsigned integers.",
    )
    return page


def decode_tiff(data: bytes, name: str, out: PixelArray | None = None) -> PixelArray:
    """Decode the first page of a TIFF file to (H, W, C) uint8 or uint16, C = 1 or 3; alpha is dropped. Raises BadInput
    if the file is truncated or damaged, or not 8- or 16-bit grey or RGB.
    """
    page = tiff_header(data, name)
    if out is None:
        out = np.empty((page.rows, page.columns, page.channels), dtype=page.dtype.newbyteorder("="))
    if page.compression == _LZW:
        return _decode_lzw(data, page, name, out)
    decode_page(data, page, name, out)
    if page.photometric == _WHITE_IS_ZERO:
        np.subtract(np.iinfo(out.dtype).max, out, out=out)
    return out


def decode_page(data: bytes, page: TiffPage, name: str, out: NDArray[Any]) -> None:
    """Decode the strips or tiles of a page into `out` (H, W, C), its values as stored; alpha is dropped."""
    require(page.compression != _LZW, f"{name} is compressed in a way that is not read (LZW); save it uncompressed.")
    samples = 1 if page.separate else page.samples
    down, across = (math.ceil(side / part) for side, part in zip((page.rows, page.columns), page.segment, strict=True))
    for k, (offset, length) in enumerate(page.places):
        plane, rest = divmod(k, down * across)
        if plane >= out.shape[2]:
            break  # alpha
        top, left = (rest // across) * page.segment[0], (rest % across) * page.segment[1]
        rows, columns = page.segment
        if _TILE_OFFSETS not in page.tags:
            rows = min(rows, page.rows - top)  # the last strip is shorter, tiles are padded
        raw = _inflated(
            memoryview(data)[offset : offset + length], rows * columns * samples * page.dtype.itemsize, page, name
        )
        values = np.frombuffer(raw, page.dtype).reshape(rows, columns, samples)
        if page.predictor:
            values = np.cumsum(values, axis=1, dtype=page.dtype.newbyteorder("="))
        target = out[top : top + rows, left : left + columns]
        if page.separate:
            target[..., plane] = values[: target.shape[0], : target.shape[1], 0]
        else:
            target[...] = values[: target.shape[0], : target.shape[1], : out.shape[2]]


def _directory(data: bytes) -> tuple[Literal["<", ">"], str, int, Iterator[tuple[int, int, int, int]]]:
    """Byte order, format of an offset, number of tags; of each: tag, type, count, and place of values or offset."""
    order: Literal["<", ">"] = "<" if data[:2] == b"II" else ">"
    big = 43 in data[2:4]
    entry, long = struct.Struct(f"{order}HHQ8x" if big else f"{order}HHI4x"), f"{order}Q" if big else f"{order}I"
    (place,) = struct.unpack_from(long, data, 8 if big else 4)
    (count,) = struct.unpack_from(long if big else f"{order}H", data, place)
    place, value = (place + 8, 12) if big else (place + 2, 8)
    starts = range(place, place + min(count, _MAX_TAGS) * entry.size, entry.size)
    return order, long, count, ((*entry.unpack_from(data, start), start + value) for start in starts)


def _tags(data: bytes, damaged: str) -> tuple[Literal["<", ">"], dict[int, NDArray[Any]]]:
    """Order of bytes, and values of the tags that are read."""
    order, long, count, entries = _directory(data)
    require(0 < count <= _MAX_TAGS, damaged)
    tags: dict[int, NDArray[Any]] = {}
    for tag, kind, number, where in entries:
        if tag not in _READ or (tag in _OPTIONAL and kind not in _TYPES):
            continue
        require(tag not in tags and number > 0 and (kind in _WHOLE or tag in _OPTIONAL), damaged)
        dtype, parts = np.dtype(_TYPES[kind][0]).newbyteorder(order), _TYPES[kind][1]
        inline = number * parts * dtype.itemsize <= struct.calcsize(long)
        offset = where if inline else struct.unpack_from(long, data, where)[0]
        tags[tag] = np.frombuffer(data, dtype, number * parts, offset)
    return order, tags


def stated_ppi(data: bytes, name: str) -> float | None:
    """Resolution by the first directory of a TIFF file or of EXIF data; None where there is none, or it is damaged.
    Raises BadInput if it is not the same both ways.
    """
    damaged = f"{name} has damaged tags; export it again."
    try:
        with refusing(damaged):
            _, tags = _tags(data, damaged)
    except BadInput:
        return None

    def ratio(tag: int) -> float | None:
        fraction = tags.get(tag, np.zeros(0)).tolist()
        return fraction[0] / fraction[1] if len(fraction) == 2 and all(fraction) else None

    x, y = ratio(X_RESOLUTION), ratio(Y_RESOLUTION)
    unit = int(tags[RESOLUTION_UNIT][0]) if RESOLUTION_UNIT in tags else _INCH
    if not x or not y or unit not in (_INCH, _CENTIMETRE):
        return None
    require(abs(x - y) <= 0.01 * x, f"{name} has {x:g} pixels along and {y:g} across; square pixels are expected.")
    return x if unit == _INCH else x * _CM_PER_INCH


def exif_orientation(data: bytes, name: str) -> int:
    """How the picture is turned, 1 to 8, by the first directory of a TIFF file or of EXIF data; 1 (as stored) without
    a tag that means something. Raises BadInput if the directory is damaged.
    """
    if not data:
        return 1
    with refusing(f"{name} has damaged EXIF data, so that nobody knows how it is turned; export it again."):
        order, _, _, entries = _directory(data)
        for tag, kind, _, place in entries:
            if tag == _ORIENTATION:
                value = int(struct.unpack_from(f"{order}{'H' if kind == _SHORT else 'I'}", data, place)[0])
                return value if 1 <= value <= 8 else 1
    return 1


def _inflated(stored: memoryview, size: int, page: TiffPage, name: str) -> bytes | memoryview:
    """The first `size` bytes of a strip or tile, and never more."""
    damaged = f"{name} is damaged: a part of its image cannot be decompressed; copy it again."
    raw: bytes | memoryview = stored[:size]
    if page.compression == _PACKBITS:
        raw = _unpacked(bytes(stored), size)
    elif page.compression != _NONE:
        engine = zlib.decompressobj()
        with refusing(damaged):
            raw = engine.decompress(stored, size)
            engine.decompress(engine.unconsumed_tail, 1)  # to the end, where the checksum is compared
    require(len(raw) == size, damaged)
    return raw


def _unpacked(stored: bytes, size: int) -> bytes:
    """PackBits: a count, then bytes as they are or one byte to repeat."""
    result = bytearray()
    place = 0
    while place < len(stored) and len(result) < size:
        count = stored[place]
        if count < 128:
            result += stored[place + 1 : place + 2 + count]
            place += 2 + count
        else:
            result += stored[place + 1 : place + 2] * (257 - count if count > 128 else 0)
            place += 2 if count > 128 else 1
    return bytes(result[:size])


def _decode_lzw(data: bytes, page: TiffPage, name: str, out: PixelArray) -> PixelArray:
    import cv2  # slow to import

    # libtiff's errors go to OpenCV's log, which is printed; what cannot be decoded comes as None all the same
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise BadInput(f"{name} cannot be decoded: {error.err}.") from error
    ok = image is not None and image.shape[:2] == (page.rows, page.columns) and image.dtype == out.dtype
    if not ok or image is None:
        raise BadInput(f"{name} cannot be decoded; save it as PNG or as uncompressed TIFF.")
    if page.channels == 3 and image.ndim == 3:
        copy_rgb(image, out)
    else:
        out[..., 0] = image if image.ndim == 2 else image[..., 0]
    return out
