"""Photographs of any camera: the formats of :mod:`splitknit.io.images`, and WEBP, BMP, float TIFF,
HEIC, camera RAW.

The first bytes show the format, the suffix that of RAW files (most are TIFF files inside). Headers
are checked before memory is taken. HEIC and RAW are decoded by the packages of the extra
``photos``.
"""

from __future__ import annotations

import hashlib
import io
import os
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import importing, refusing, require
from splitknit.files import AnyPath, read_bytes
from splitknit.io.images import MAX_BYTES, Header, SizeCheck, check_size, decode_pixels, read_header
from splitknit.model import BoolArray

RAW_SUFFIXES = frozenset(
    {".dng", ".nef", ".cr2", ".cr3", ".arw", ".raf", ".orf", ".rw2", ".pef", ".srw"}
)
SRGB_SUFFIXES = frozenset({".jpg", ".jpeg", ".webp", ".heic", ".heif"})
"""Suffixes of files that have a tone curve."""
SUFFIXES = RAW_SUFFIXES | SRGB_SUFFIXES | {".png", ".tif", ".tiff", ".bmp"}
FORMATS = "JPEG, PNG, TIFF, WEBP, BMP, HEIC and camera RAW"
_UNREADABLE = "{} cannot be decoded; export it as PNG or TIFF."
_RAW_TURNS = {0: 1, 3: 3, 5: 8, 6: 6}  # LibRaw's ``flip`` as EXIF's orientation


@dataclass(frozen=True, slots=True, eq=False)
class Photo:
    """One photograph, upright."""

    pixels: NDArray[Any]
    """(H, W, C) uint8, uint16, or float32 as it stands in the file; C = 1 or 3, red, green,
    blue."""
    orientation: int
    """EXIF's, 1 to 8, which has been obeyed: 1 = stored as it is seen."""
    sha256: str
    """Hash of the file."""
    opaque: BoolArray | None = None
    """(H, W) what is not transparent, by half or more; None where all is opaque."""


def read_photo(path: AnyPath, check: SizeCheck | None = None) -> Photo:
    """Read a photograph, turned upright as its EXIF data say.

    RAW is demosaiced to linear 16-bit light in the camera's own colours, black level taken off: no
    white balance, no tone curve, no automatic brightness. `path`: JPEG, PNG, TIFF (8- or 16-bit or
    float), WEBP, BMP, HEIC or RAW file; `check` is called with rows and columns before memory is
    taken, and may raise. Raises BadInput if the file is missing, damaged, larger
    than 400 MB once decoded, of another kind, or of a kind whose package is not installed.

    >>> read_photo("photos/IMG_1.HEIC").pixels.shape  # doctest: +SKIP
    (3024, 4032, 3)
    """
    return decode_photo(read_bytes(path, MAX_BYTES), os.fspath(path), check)


def decode_photo(data: bytes, name: str, check: SizeCheck | None = None) -> Photo:
    """Decode the bytes of a photograph, as :func:`read_photo`; `name`: for messages; its suffix
    shows camera RAW."""
    if Path(name).suffix.lower() in RAW_SUFFIXES:
        pixels, orientation = _raw(data, name, check)
    elif data[4:8] == b"ftyp":
        pixels = _heic(data, name, check)
        orientation = 1  # its turns are part of the picture, and undone with it
    else:
        header = read_header(data, name)
        orientation = header.orientation
        _check_upright(check, header.rows, header.columns, orientation)
        pixels = decode_pixels(data, header, name)
    if pixels.dtype.kind == "f":
        require(
            np.isfinite(pixels).all() and np.abs(pixels).max() < 1e30,
            f"{name} holds values that are not finite; export it again without them.",
        )
        pixels = pixels.astype(np.float32)
    pixels = _upright(pixels, orientation)
    opaque = None
    if pixels.shape[2] in (2, 4):  # with alpha
        clear = pixels[..., -1] > (
            0.5 if pixels.dtype.kind == "f" else np.iinfo(pixels.dtype).max // 2
        )
        opaque = None if clear.all() else np.asarray(clear)
    colours = np.ascontiguousarray(pixels[..., : 1 if pixels.shape[2] < 3 else 3])
    return Photo(colours, orientation, hashlib.sha256(data).hexdigest(), opaque)


def _check_upright(check: SizeCheck | None, rows: int, columns: int, orientation: int) -> None:
    if check is not None:
        check(*((rows, columns) if orientation < 5 else (columns, rows)))


def encoding_of(files: Sequence[Path], of_8_bits: str = "srgb") -> tuple[str, str]:
    """Encoding of photographs that came without one, and a note on it; the same rule for every
    verb.

    Camera RAW is linear; JPEG, WEBP and HEIC are sRGB; PNG is what its chunks sRGB, gAMA and iCCP
    state. Other files of 16 bits or floats are linear; those of 8 bits may be either, and are taken
    as `of_8_bits`. Raises BadInput if some have a tone curve and some have none.
    """
    encodings = {stated_encoding(file) for file in files}
    require(
        len(encodings) == 1,
        "the photographs are of several kinds, some with a tone curve (JPEG, WEBP, HEIC, PNG that"
        " states sRGB) and some without; give `encoding`.",
    )
    suffix = files[0].suffix.lower()
    stated = encodings.pop()
    if stated:
        why = "stated in" if suffix == ".png" else "assumed of"
        return stated, f"encoding {stated} is {why} the {suffix} files (`encoding` changes it)."
    if of_8_bits == "linear" or _header_of(files[0]).dtype != np.uint8:
        return "linear", (
            f"encoding linear is assumed of the {suffix} files, which state none; give `encoding`"
            " srgb if a program for pictures or a telephone saved them."
        )
    return "srgb", (
        f"encoding srgb is assumed of the {suffix} files of 8 bits, which state none; give"
        " `encoding` linear if an industrial camera or a renderer saved them."
    )


def stated_encoding(file: Path) -> str:
    """``srgb``, ``linear``, or nothing where the file's kind leaves it open."""
    suffix = file.suffix.lower()
    if suffix in SRGB_SUFFIXES or suffix in RAW_SUFFIXES:
        return "srgb" if suffix in SRGB_SUFFIXES else "linear"
    return _header_of(file).encoding if suffix == ".png" else ""


def _header_of(file: Path) -> Header:
    return read_header(read_bytes(file, MAX_BYTES), str(file))


def _upright(pixels: NDArray[Any], orientation: int) -> NDArray[Any]:
    """`pixels` (H, W, C) as they are to be seen (EXIF 2.32, tag 274)."""
    if orientation in (5, 6, 7, 8):
        pixels = pixels.swapaxes(0, 1)
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    return np.ascontiguousarray(pixels)


def of_extra(name: str, kind: str) -> AbstractContextManager[None]:
    """A block that imports what reads a `kind` of files: a package of the extra ``photos``."""
    return importing(
        f"{name} ({kind}) needs a package that is not installed: pip install 'splitknit[photos]',"
        " or export it as PNG or TIFF."
    )


def _heic(data: bytes, name: str, check: SizeCheck | None) -> NDArray[Any]:
    with of_extra(name, "HEIC"):
        import pillow_heif
    with refusing(_UNREADABLE.format(name)):
        image = pillow_heif.open_heif(io.BytesIO(data), convert_hdr_to_8bit=False)
        columns, rows = image.size
        check_size(rows, columns, 8, name)
        _check_upright(check, rows, columns, 1)
        values = np.asarray(image)
        require(values.shape[:2] == (rows, columns), _UNREADABLE.format(name))
        return values.reshape(rows, columns, -1)


def _raw(data: bytes, name: str, check: SizeCheck | None) -> tuple[NDArray[Any], int]:
    with of_extra(name, "camera RAW"):
        import rawpy
    with (
        refusing(f"{name} is not a RAW file that LibRaw reads; export it as linear TIFF."),
        rawpy.imread(io.BytesIO(data)) as raw,
    ):
        sizes = raw.sizes
        check_size(max(sizes.raw_height, sizes.height), max(sizes.raw_width, sizes.width), 6, name)
        orientation = _RAW_TURNS.get(int(sizes.flip), 1)
        _check_upright(check, sizes.height, sizes.width, orientation)
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
        return pixels, orientation
