"""Photographs of any camera: the formats of :mod:`splitknit.io.images`, and WEBP, BMP, float TIFF, HEIC, camera RAW.

The first bytes show the format, the suffix that of RAW files (most are TIFF files inside). Headers are checked
before memory is taken. HEIC and RAW are decoded by the packages of the extra ``photos``.
"""

from __future__ import annotations

import hashlib
import io
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, open_file, read_bytes, refusing, require
from splitknit.io import png, tiff
from splitknit.io.images import APP1, MAX_BYTES, MAX_PIXELS, decode_image, jpeg_segments
from splitknit.io.png import check_size, png_header
from splitknit.model import BoolArray

RAW_SUFFIXES = frozenset({".dng", ".nef", ".cr2", ".cr3", ".arw", ".raf", ".orf", ".rw2", ".pef", ".srw"})
SRGB_SUFFIXES = frozenset({".jpg", ".jpeg", ".webp", ".heic", ".heif"})
"""What cameras and telephones write with a tone curve."""
SUFFIXES = RAW_SUFFIXES | SRGB_SUFFIXES | {".png", ".tif", ".tiff", ".bmp"}
FORMATS = "JPEG, PNG, TIFF, WEBP, BMP, HEIC and camera RAW"
JPEG_SIGNATURE, BMP_SIGNATURE = b"\xff\xd8\xff", b"BM"
_EXTRA = "{} needs a package that is not installed: pip install 'splitknit[photos]', or export it as PNG or TIFF."
_UNREADABLE = "{} cannot be decoded; export it as PNG or TIFF."
_PIXELS_PER_BYTE = 16384
"""Pixels per byte of a WEBP file, at most (38 bytes can claim any number): photographs have up to 100, masks 4000."""
_RAW_TURNS = {0: 1, 3: 3, 5: 8, 6: 6}  # LibRaw's ``flip`` as EXIF's orientation


@dataclass(frozen=True, slots=True, eq=False)
class Photo:
    """One photograph, upright."""

    pixels: NDArray[Any]
    """(H, W, C) uint8, uint16, or float32 as it stands in the file; C = 1 or 3, red, green, blue."""
    orientation: int
    """EXIF's, 1 to 8, which has been obeyed: 1 = stored as it is seen."""
    sha256: str
    """Hash of the file."""
    opaque: BoolArray | None = None
    """(H, W) what is not transparent, by half or more; None where all is opaque."""


def read_photo(path: str | os.PathLike[str], *, room: int | None = None) -> Photo:
    """Read a photograph, turned upright as its EXIF data say.

    RAW is demosaiced to linear 16-bit light in the camera's own colours, black level taken off: no white balance, no
    tone curve, no automatic brightness. `path`: JPEG, PNG, TIFF (8- or 16-bit or float), WEBP, BMP, HEIC or RAW file;
    `room`: bytes that the pixels may take, at most 400 MB. Raises BadInput if the file is missing, damaged, too large,
    of another kind, or of a kind whose package is not installed.

    >>> read_photo("photos/IMG_1.HEIC").pixels.shape  # doctest: +SKIP
    (3024, 4032, 3)
    """
    return decode_photo(read_bytes(path, MAX_BYTES), os.fspath(path), room=room)


def decode_photo(data: bytes, name: str, *, room: int | None = None) -> Photo:
    """Decode the bytes of a photograph, as :func:`read_photo`; `name`: for messages; its suffix shows camera RAW."""
    if Path(name).suffix.lower() in RAW_SUFFIXES:
        pixels, orientation = _raw(data, name, room)
    elif data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        pixels, orientation = _webp(data, name, room)
    elif data[4:8] == b"ftyp":
        pixels, orientation = _heic(data, name, room), 1  # its turns are part of the picture, and undone with it
    elif data.startswith(BMP_SIGNATURE):
        pixels, orientation = _bmp(data, name, room), 1
    elif data.startswith(tiff.SIGNATURES):
        pixels, orientation = _tiff(data, name, room)
    elif data.startswith((png.SIGNATURE[:4], JPEG_SIGNATURE)):
        pixels = png.png_pixels(data, name) if data.startswith(png.SIGNATURE[:4]) else decode_image(data, name)
        _check_room(pixels.nbytes, name, room)
        orientation = tiff.exif_orientation(exif_data(data), name)
    else:
        what = "is empty" if not data else f"is none of {FORMATS}"
        raise BadInput(f"{name} {what}; export it as PNG or TIFF.")
    pixels, opaque = _upright(pixels, orientation), None
    if pixels.shape[2] in (2, 4):  # with alpha
        clear = pixels[..., -1] > (0.5 if pixels.dtype.kind == "f" else np.iinfo(pixels.dtype).max // 2)
        opaque = None if clear.all() else np.asarray(clear)
    return Photo(_plain(pixels), orientation, hashlib.sha256(data).hexdigest(), opaque)


def encoding_of(files: Sequence[Path], by_shading: Callable[[], bool | None]) -> tuple[str, str]:
    """Encoding of photographs whose encoding nobody has given, and a note on it; the same rule for every verb.

    Camera RAW is linear; JPEG, WEBP and HEIC are sRGB; PNG is what its chunks sRGB, gAMA and iCCP state. Of other files
    those of 16 bits and of floats are linear, and those of 8 bits what fits their shading better, sRGB where that
    decides nothing. `files`: photographs; `by_shading`: whether it is sRGB that fits, None where nothing decides, see
    :func:`splitknit.imaging.response.shading_is_srgb`; called where it decides. Raises BadInput if some have a tone
    curve and some have none.
    """
    found = {_stated_encoding(file) for file in files}
    curves = "some with a tone curve (JPEG, WEBP, HEIC, PNG that states sRGB) and some without"
    require(len(found) == 1, f"the photographs are of several kinds, {curves}; give `encoding`.")
    suffix, stated = files[0].suffix.lower(), found.pop()
    if stated:
        why = "stated in" if suffix == ".png" else "assumed of"
        return stated, f"encoding {stated} is {why} the {suffix} files (`encoding` changes it)."
    curved = by_shading()
    if curved is not False and _of_eight_bits(files[0]):
        if curved is None:
            remedy = "give `encoding` linear if an industrial camera or a renderer saved them."
            return "srgb", f"encoding srgb is assumed of the {suffix} files of 8 bits, which state none; {remedy}"
        note = f"encoding srgb fits the shading in the {suffix} files better than linear (`encoding` changes it)."
        return "srgb", note
    remedy = "give `encoding` srgb if a program for pictures or a telephone saved them."
    return "linear", f"encoding linear is assumed of the {suffix} files, which state none; {remedy}"


def _of_eight_bits(file: Path) -> bool:
    """Whether a file has 8 bits a value; what a PNG states is read without its pixels."""
    if file.suffix.lower() == ".png":
        return bool(png_header(file.read_bytes(), str(file)).dtype == np.uint8)
    return read_photo(file).pixels.dtype == np.uint8


def _stated_encoding(file: Path) -> str:
    """``srgb``, ``linear``, or nothing where the file's kind leaves it open."""
    suffix = file.suffix.lower()
    if suffix in SRGB_SUFFIXES or suffix in RAW_SUFFIXES:
        return "srgb" if suffix in SRGB_SUFFIXES else "linear"
    with open_file(file, MAX_BYTES) as (stream, _):
        head = stream.read(1 << 16).partition(b"IDAT")[0]
    if not head.startswith(png.SIGNATURE):
        return ""
    gamma = head.find(b"gAMA")
    value = int.from_bytes(head[gamma + 4 : gamma + 8], "big") / 1e5 if gamma > 0 else 0.0
    if b"sRGB" in head or b"iCCP" in head or 0.4 < value < 0.5:
        return "linear" if value == 1.0 and b"sRGB" not in head else "srgb"
    return "linear" if value == 1.0 else ""


def _check_room(needed: int, name: str, room: int | None) -> None:
    large = f"{name} and the photographs with it take more memory than is read at once; reduce them, or name fewer."
    require(room is None or needed <= room, large)


def _checked(rows: int, columns: int, bytes_each: int, name: str, room: int | None) -> None:
    """Refuse sizes that are impossible or too large, before anything is decoded."""
    require(rows > 0 and columns > 0, _UNREADABLE.format(name))
    large = f"{name} claims {rows} x {columns} pixels, more than the {MAX_PIXELS} that are read."
    require(rows * columns <= MAX_PIXELS, large)
    check_size(rows, columns, bytes_each, name)
    _check_room(rows * columns * bytes_each, name, room)


def _upright(pixels: NDArray[Any], orientation: int) -> NDArray[Any]:
    """`pixels` (H, W) or (H, W, C) as they are to be seen (EXIF 2.32, tag 274)."""
    if orientation in (5, 6, 7, 8):
        pixels = pixels.swapaxes(0, 1)
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    return np.ascontiguousarray(pixels)


def exif_data(data: bytes) -> bytes:
    """EXIF data of a sound JPEG file (segment APP1) or PNG file (chunk eXIf); empty where there are none."""
    if data.startswith(JPEG_SIGNATURE):
        found = (_exif(data[start + 4 : end]) for marker, start, end in jpeg_segments(data) if marker == APP1)
    else:
        found = (content for kind, content in png.chunks_of(data) if kind == b"eXIf")
    return next(filter(None, found), b"")


def _exif(data: bytes) -> bytes:
    """EXIF data without the word before them; nothing where it is missing."""
    return data.removeprefix(b"Exif\0\0") if data.startswith(b"Exif\0\0") else b""


def _tiff(data: bytes, name: str, room: int | None) -> tuple[NDArray[Any], int]:
    page = tiff.tiff_page(data, name)
    orientation = tiff.exif_orientation(data, name)
    _check_room(page.rows * page.columns * page.channels * page.dtype.itemsize, name, room)
    if page.dtype.kind != "f":
        tiff.tiff_header(data, name)
        return tiff.page_pixels(data, page, name), orientation
    values = tiff.page_pixels(data, page, name)
    finite = bool(np.isfinite(values).all() and np.abs(values).max() < 1e30)
    require(finite, f"{name} holds values that are not finite; export it again without them.")
    return values.astype(np.float32), orientation


def _bmp(data: bytes, name: str, room: int | None) -> NDArray[Any]:
    """Uncompressed BMP of 8, 24 or 32 bits."""
    words = np.frombuffer(data[14:54].ljust(40, b"\0"), "<i4")
    bits, compression = int(words[3]) >> 16, int(words[4])
    known = len(data) >= 54 and bits in (8, 24, 32) and compression in (0, 3)
    require(known, f"{name} is a kind of BMP that is not read (compressed, or of few colours); save it as PNG.")
    columns, rows = int(words[1]), abs(int(words[2]))
    _checked(rows, columns, 3, name, room)
    require(rows * columns * bits // 8 <= len(data), f"{name} is truncated: the BMP file ends within the image.")
    image = png.decoded(data, name)
    require(image.shape[:2] == (rows, columns), _UNREADABLE.format(name))
    return _plain(image)


def _webp(data: bytes, name: str, room: int | None) -> tuple[NDArray[Any], int]:
    rows, columns = _webp_size(data, name)
    _checked(rows, columns, 4, name, room)
    empty = f"{name} claims {rows} x {columns} pixels in {len(data)} bytes, which is not a photograph; save it as PNG."
    require(rows * columns <= _PIXELS_PER_BYTE * len(data), empty)
    pixels = png.decoded(data, name)
    require(pixels.shape[:2] == (rows, columns), _UNREADABLE.format(name))
    place, exif = 12, b""
    while place + 8 <= len(data) and not exif:
        length = int.from_bytes(data[place + 4 : place + 8], "little")
        exif = data[place + 8 : place + 8 + length] if data[place : place + 4] == b"EXIF" else b""
        place += 8 + length + length % 2
    return pixels, tiff.exif_orientation(_exif(exif) or exif, name)


def _webp_size(data: bytes, name: str) -> tuple[int, int]:
    """Rows and columns from the first chunk (RFC 9649, sections 2.5 to 2.7)."""
    kind, body = data[12:16], data[20:30].ljust(10, b"\0")
    if kind == b"VP8X":
        return 1 + int.from_bytes(body[7:10], "little"), 1 + int.from_bytes(body[4:7], "little")
    if kind == b"VP8L":
        bits = int.from_bytes(body[1:5], "little")
        return 1 + (bits >> 14 & 0x3FFF), 1 + (bits & 0x3FFF)
    require(kind == b"VP8 ", f"{name} is damaged: its WEBP header is incomplete; copy it again.")
    return int.from_bytes(body[8:10], "little") & 0x3FFF, int.from_bytes(body[6:8], "little") & 0x3FFF


def _heic(data: bytes, name: str, room: int | None) -> NDArray[Any]:
    try:
        import pillow_heif  # of the extra `photos`
    except ImportError as error:
        raise BadInput(_EXTRA.format(f"{name} (HEIC)")) from error
    with refusing(_UNREADABLE.format(name)):
        image = pillow_heif.open_heif(io.BytesIO(data), convert_hdr_to_8bit=False)
        columns, rows = image.size
        _checked(rows, columns, 8, name, room)
        values = np.asarray(image)
        require(values.shape[:2] == (rows, columns), _UNREADABLE.format(name))
        return _plain(values)


def _raw(data: bytes, name: str, room: int | None) -> tuple[NDArray[Any], int]:
    try:
        import rawpy  # of the extra `photos`
    except ImportError as error:
        raise BadInput(_EXTRA.format(f"{name} (camera RAW)")) from error
    with (
        refusing(f"{name} is not a RAW file that LibRaw reads; export it as linear TIFF."),
        rawpy.imread(io.BytesIO(data)) as raw,
    ):
        sizes = raw.sizes
        _checked(max(sizes.raw_height, sizes.height), max(sizes.raw_width, sizes.width), 6, name, room)
        pixels = raw.postprocess(
            gamma=(1, 1),
            no_auto_bright=True,
            adjust_maximum_thr=0.0,  # one scale for all photographs, whatever their brightest pixel
            output_bps=16,
            use_camera_wb=False,
            use_auto_wb=False,
            user_wb=[1.0, 1.0, 1.0, 1.0],
            output_color=rawpy.ColorSpace.raw,
            user_flip=0,
        )
        return _plain(pixels), _RAW_TURNS.get(int(sizes.flip), 1)


def _plain(values: NDArray[Any]) -> NDArray[Any]:
    """(H, W, 1 or 3) without alpha."""
    image = values[..., None] if values.ndim == 2 else values
    return np.ascontiguousarray(image[..., : 1 if image.shape[2] < 3 else 3])
