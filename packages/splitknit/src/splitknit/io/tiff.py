"""TIFF files with one flat image, grey or RGB: tags are read and checked here, OpenCV decodes LZW and PackBits.

Nothing is allocated before the strips or tiles that the tags name are known to lie in the file, side by side, and to be
long enough for the image. Tags that no reader here needs are passed over.

Source: TIFF, revision 6.0, Adobe 1992: sections 2 (image file directory), 15 (tiles).
"""

from __future__ import annotations

import math
import os
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, refusing, require
from splitknit.io.atomic import write_file
from splitknit.io.png import DEFLATE_RATIO, check_held, check_size, decoded, placed
from splitknit.io.provenance import canonical_json
from splitknit.model import PixelArray

SIGNATURES = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
DESCRIPTION, X_RESOLUTION, Y_RESOLUTION, RESOLUTION_UNIT = 270, 282, 283, 296
_COLUMNS, _ROWS, _BITS, _COMPRESSION, _PHOTOMETRIC, _BIT_ORDER = 256, 257, 258, 259, 262, 266
_SAMPLES, _STRIP_ROWS, _PLANAR, _PREDICTOR, _FORMAT, _DEPTH = 277, 278, 284, 317, 339, 32997
_STRIP_OFFSETS, _STRIP_BYTES, _TILE_COLUMNS, _TILE_ROWS, _TILE_OFFSETS, _TILE_BYTES = 273, 279, 322, 323, 324, 325
_ORIENTATION, _SOFTWARE, _SHORT = 274, 305, 3
_EXTRA_SAMPLES, _ALPHA = 338, (1, 2)
_OPTIONAL = {DESCRIPTION, X_RESOLUTION, Y_RESOLUTION, RESOLUTION_UNIT, _EXTRA_SAMPLES}
_READ = _OPTIONAL | {
    *(_COLUMNS, _ROWS, _BITS, _COMPRESSION, _PHOTOMETRIC, _BIT_ORDER),
    *(_SAMPLES, _STRIP_ROWS, _PLANAR, _PREDICTOR, _FORMAT, _DEPTH),
    *(_STRIP_OFFSETS, _STRIP_BYTES, _TILE_COLUMNS, _TILE_ROWS, _TILE_OFFSETS, _TILE_BYTES),
}
_TYPES = {1: ("u1", 1), 2: ("u1", 1), 3: ("u2", 1), 4: ("u4", 1), 5: ("u4", 2), 7: ("u1", 1), 16: ("u8", 1)}
"""Types of a tag's values: kind, and how many make one value."""
_WHOLE = frozenset({1, 3, 4, 16})  # types of whole numbers, which all tags but the optional ones hold
_UNSIGNED, _FLOAT = 1, 3
_KINDS = {_UNSIGNED: "uint", 2: "int", _FLOAT: "float"}
_OF_FLOATS = 3  # a predictor
_NONE, _LZW, _DEFLATE, _OLD_DEFLATE, _PACKBITS = 1, 5, 8, 32946, 32773
_RATIO = {_NONE: 1, _LZW: 2560, _DEFLATE: DEFLATE_RATIO, _OLD_DEFLATE: DEFLATE_RATIO, _PACKBITS: 64}
"""The most bytes that a stored byte can become; of LZW a string of 3838 bytes for 12 bits."""
_WHITE_IS_ZERO, _BLACK_IS_ZERO, _RGB = 0, 1, 2
_MAX_TAGS = 4096
_LONGEST_TEXT = 1_000_000
_MIN_TILE = 16
INCH, CENTIMETRE = 2, 3
"""Units of a resolution."""
_CM_PER_INCH = 2.54
_FINEST_RATIO = 1_000_000  # denominator of a resolution: below 4000 pixels a unit it fits into 32 bits


@dataclass(frozen=True, slots=True, eq=False)
class TiffPage:
    """The facts of the first page."""

    rows: int
    columns: int
    samples: int  # channels as stored, with alpha
    dtype: np.dtype[Any]
    order: Literal["<", ">"]  # of the bytes of a value
    photometric: int
    compression: int
    predictor: int
    segment: tuple[int, int]  # rows and columns of a strip or tile
    tiled: bool
    places: tuple[tuple[int, int], ...]  # offset and length of each strip or tile
    tags: Mapping[int, NDArray[Any]]  # values by the number of the tag; those of fractions alternate

    @property
    def channels(self) -> int:
        """Channels after decoding: 1 or 3."""
        return 1 if self.photometric in (_WHITE_IS_ZERO, _BLACK_IS_ZERO) else 3

    @property
    def description(self) -> str:
        """Text of the description tag, empty where there is none; a longer one is cut."""
        text = self.tags.get(DESCRIPTION, np.zeros(0, np.uint8))[:_LONGEST_TEXT].tobytes()
        return text.rstrip(b"\0").decode("utf-8", "replace")


def encode_tiff(image: NDArray[Any], description: str = "", resolution: float = 0.0, unit: int = INCH) -> bytes:
    """Uncompressed TIFF (H, W) or (H, W, 3); `resolution`: pixels in a `unit`, 0 where it is unknown."""
    pixels = np.ascontiguousarray(image, dtype=image.dtype.newbyteorder("<"))
    rows, columns = pixels.shape[:2]
    samples = 1 if pixels.ndim == 2 else 3
    ratio = struct.pack("<II", *Fraction(resolution).limit_denominator(_FINEST_RATIO).as_integer_ratio())
    values = {
        **{_COLUMNS: [columns], _ROWS: [rows], _BITS: [8 * pixels.itemsize] * samples, _COMPRESSION: [_NONE]},
        **{_PHOTOMETRIC: [_BLACK_IS_ZERO if samples == 1 else _RGB], _SAMPLES: [samples], _STRIP_ROWS: [rows]},
        **{_STRIP_OFFSETS: [8], _STRIP_BYTES: [pixels.nbytes]},
        **{_FORMAT: [_FLOAT if pixels.dtype.kind == "f" else _UNSIGNED] * samples},
    }
    tags = {tag: (4, len(one), struct.pack(f"<{len(one)}I", *one)) for tag, one in values.items()}
    texts = {_SOFTWARE: "splitknit", **({DESCRIPTION: description} if description else {})}
    tags |= {tag: (2, len(text) + 1, text.encode("ascii") + b"\0") for tag, text in texts.items()}
    if resolution:
        tags |= {
            X_RESOLUTION: (5, 1, ratio),
            Y_RESOLUTION: (5, 1, ratio),
            RESOLUTION_UNIT: (4, 1, struct.pack("<I", unit)),
        }
    place = 8 + pixels.nbytes + pixels.nbytes % 2
    behind = place + 2 + 12 * len(tags) + 4
    entries, more = [], b""
    for tag, (kind, count, content) in sorted(tags.items()):
        inline = content.ljust(4, b"\0") if len(content) <= 4 else struct.pack("<I", behind + len(more))
        entries.append(struct.pack("<HHI", tag, kind, count) + inline)
        more += b"" if len(content) <= 4 else content + b"\0" * (len(content) % 2)
    directory = struct.pack("<H", len(entries)) + b"".join(entries) + bytes(4)
    head = struct.pack("<2sHI", b"II", 42, place)
    return b"".join([head, pixels.tobytes(), bytes(pixels.nbytes % 2), directory, more])


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
    if pitch_mm is not None:
        require(bool(np.isfinite(pitch_mm)) and pitch_mm > 0, f"pitch_mm must be a positive number, not {pitch_mm}.")
        description["pitch_mm"] = float(pitch_mm)
    per_cm = 0.0 if pitch_mm is None else 10.0 / float(pitch_mm)
    write_file(path, encode_tiff(image, canonical_json(description), per_cm, CENTIMETRE))


def tiff_page(data: bytes, name: str) -> TiffPage:
    """The first page's tags; BadInput if damaged, without its strips, or not flat grey or RGB of 8 to 64 bits."""
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
    kinds = f"{name} has {max(bits)}-bit samples of the type {shown}; save it as 8- or 16-bit unsigned integers."
    require(known, kinds)
    grey = photometric in (_WHITE_IS_ZERO, _BLACK_IS_ZERO) and samples == 1
    colour = photometric == _RGB and samples in (3, 4)
    require(
        grey or colour, f"{name} is neither grey nor RGB (CMYK, palette, grey with alpha?); save it as grey or RGB."
    )
    readable = compression in _RATIO and number(_PREDICTOR, 1) in (1, 2, 3)
    readable = readable and number(_BIT_ORDER, 1) == 1 and (samples == 1 or number(_PLANAR, 1) == 1)
    stored = f"compression {compression}, predictor {number(_PREDICTOR, 1)}, order of bits {number(_BIT_ORDER, 1)}"
    remedy = "save it as PNG or as uncompressed TIFF."
    require(readable, f"{name} has an unsupported storage format ({stored}); {remedy}")
    dtype = np.dtype(shown)
    check_size(rows, columns, samples * dtype.itemsize, name)
    tiled = _TILE_OFFSETS in tags
    if tiled:
        segment = number(_TILE_ROWS), number(_TILE_COLUMNS)
        require(min(segment) >= _MIN_TILE and segment[0] < rows + 4096 and segment[1] < columns + 4096, damaged)
    else:
        segment = max(1, min(number(_STRIP_ROWS, rows), rows)), columns
    count = math.ceil(rows / segment[0]) * math.ceil(columns / segment[1])
    where = (_TILE_OFFSETS, _TILE_BYTES) if tiled else (_STRIP_OFFSETS, _STRIP_BYTES)
    offsets, lengths = (tags.get(tag) for tag in where)
    if lengths is None and offsets is not None and count == 1 and compression == _NONE:  # written by old programs
        lengths = np.array([rows * columns * samples * dtype.itemsize])
    whole = offsets is not None and lengths is not None and len(offsets) == len(lengths) == count
    require(whole, damaged)
    places = tuple(zip(offsets.tolist(), lengths.tolist(), strict=True))  # type: ignore[union-attr]
    whole = all(offset > 0 and length > 0 and offset + length <= len(data) for offset, length in places)
    require(whole, f"{name} is truncated: the TIFF file ends within the image; copy it again.")
    size = sum(length for _, length in places)
    require(size <= len(data), damaged)
    check_held(rows, columns, samples * dtype.itemsize / _RATIO[compression], size, name)
    predictor = number(_PREDICTOR, 1)
    return TiffPage(
        rows, columns, samples, dtype, order, photometric, compression, predictor, segment, tiled, places, tags
    )


def tiff_header(data: bytes, name: str) -> TiffPage:
    """The first page's tags. Raises BadInput as :func:`tiff_page`, and for others than 8- or 16-bit grey or RGB."""
    page = tiff_page(data, name)
    kind = f"{8 * page.dtype.itemsize}-bit samples of the type {page.dtype}"
    known = page.dtype in (np.uint8, np.uint16)
    require(known, f"{name} has {kind}; save it as 8- or 16-bit unsigned integers.")
    return page


def decode_tiff(data: bytes, name: str, out: PixelArray | None = None) -> PixelArray:
    """Decode the first page to (H, W, C) uint8 or uint16, C = 1 or 3, without alpha, raises as :func:`tiff_header`."""
    page = tiff_header(data, name)
    return placed(page_pixels(data, page, name), out, page, name)


def page_pixels(data: bytes, page: TiffPage, name: str) -> NDArray[Any]:
    """Pixels (H, W, C) of a page, dark where they are small, with alpha behind the colours where it is stated. BadInput
    where a part of it is missing.
    """
    if page.compression in (_LZW, _PACKBITS) or page.predictor == _OF_FLOATS:
        pixels = decoded(data, name)
        turned = page.dtype == np.uint8  # by OpenCV, where white is zero
    else:
        pixels, turned = _segments(data, page, name), False
    known = page.samples == page.channels or int(page.tags.get(_EXTRA_SAMPLES, [0])[0]) in _ALPHA
    pixels = pixels if known else pixels[..., : page.channels]
    white_is_zero = page.photometric == _WHITE_IS_ZERO and not turned and page.dtype.kind == "u"
    return np.asarray(np.iinfo(page.dtype).max - pixels) if white_is_zero else pixels


def _segments(data: bytes, page: TiffPage, name: str) -> NDArray[Any]:
    """The strips or tiles of a page, not packed or deflated."""
    (high, wide), samples = page.segment, page.samples
    across, down = -(-page.columns // wide), -(-page.rows // high)
    whole = np.empty((down * high, across * wide, samples), page.dtype)
    damaged = f"{name} is damaged: a part of its image cannot be decompressed; copy it again."
    for k, (offset, length) in enumerate(page.places):
        top, left = k // across * high, k % across * wide
        rows = high if page.tiled else min(high, page.rows - top)
        size, part = rows * wide * samples * page.dtype.itemsize, data[offset : offset + length]
        with refusing(damaged):
            part = part if page.compression == _NONE else zlib.decompressobj().decompress(part, size)
        require(len(part) >= size, damaged)
        values = np.frombuffer(part[:size], page.dtype.newbyteorder(page.order)).reshape(rows, wide, samples)
        values = values if page.predictor == 1 else np.cumsum(values, axis=1, dtype=page.dtype)
        whole[top : top + rows, left : left + wide] = values
    return whole[: page.rows, : page.columns]


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


def stated_ppi(data: bytes) -> tuple[float, float] | None:
    """Resolution along columns and rows in the first directory of TIFF or EXIF; None without, or where damaged."""
    try:
        with refusing("damaged"):
            _, tags = _tags(data, "damaged")
    except BadInput:
        return None

    def ratio(tag: int) -> float | None:
        fraction = tags.get(tag, np.zeros(0)).tolist()
        return fraction[0] / fraction[1] if len(fraction) == 2 and all(fraction) else None

    x, y = ratio(X_RESOLUTION), ratio(Y_RESOLUTION)
    unit = int(tags[RESOLUTION_UNIT][0]) if RESOLUTION_UNIT in tags else INCH
    if not x or not y or unit not in (INCH, CENTIMETRE):
        return None
    scale = 1.0 if unit == INCH else _CM_PER_INCH
    return x * scale, y * scale


def exif_orientation(data: bytes, name: str) -> int:
    """How the picture is turned, 1 to 8, by TIFF's or EXIF's first directory, 1 without; BadInput if it is damaged."""
    if not data:
        return 1
    with refusing(f"{name} has damaged EXIF data, so that nobody knows how it is turned; export it again."):
        order, _, _, entries = _directory(data)
        for tag, kind, _, place in entries:
            if tag == _ORIENTATION:
                value = int(struct.unpack_from(f"{order}{'H' if kind == _SHORT else 'I'}", data, place)[0])
                return value if 1 <= value <= 8 else 1
    return 1
