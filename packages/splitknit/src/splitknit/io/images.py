"""Pictures in and out: 8- or 16-bit PNG, TIFF and JPEG, grey or RGB, as (H, W, C) integers.

Pillow and tifffile read what a file states, so that sizes are known before memory is taken; OpenCV
decodes the pixels, but for those of TIFF files that are uncompressed, or compressed by Zstandard.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import logging
import math
import os
import struct
import threading
import warnings
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image
from PIL.BmpImagePlugin import BmpImageFile
from PIL.JpegImagePlugin import JpegImageFile
from PIL.PngImagePlugin import PngImageFile
from PIL.TiffImagePlugin import TiffImageFile
from PIL.WebPImagePlugin import WebPImageFile

from splitknit.errors import refusing, require
from splitknit.files import read_bytes
from splitknit.io.atomic import write_file
from splitknit.io.paging import new_stack
from splitknit.io.provenance import canonical_json
from splitknit.model import PixelArray

PNG, JPEG, WEBP, BMP = b"\x89PNG", b"\xff\xd8\xff", b"RIFF", b"BM"
"""First bytes of files."""
PNG_END = b"IEND\xaeB`\x82"  # last chunk, with its checksum
TIFFS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_OPENERS: dict[bytes, Any] = {
    PNG: PngImageFile,
    JPEG: JpegImageFile,
    WEBP: WebPImageFile,
    BMP: BmpImageFile,
}
_GREY, _COLOUR = {"1", "L", "LA", "I;16"}, {"P", "PA", "RGB", "RGBA", "RGBX"}  # Pillow's modes
_ORIENTATION = 274
"""Tag of TIFF and EXIF. Source: TIFF 6.0."""
_X_RESOLUTION = 282
"""Tag of TIFF. Source: TIFF 6.0."""
_Y_RESOLUTION = 283
"""Tag of TIFF. Source: TIFF 6.0."""
_RESOLUTION_UNIT = 296
"""Tag of TIFF. Source: TIFF 6.0."""
_ALPHA = (1, 2)
"""Alpha, associated or not. Source: TIFF 6.0, tag ExtraSamples."""
_STRIPS = (273, 279, 324, 325)
"""Tags of the places and lengths of strips and of tiles. Source: TIFF 6.0."""
_PREDICTOR = 317
"""Tag of TIFF; 2: differences along rows. Source: TIFF 6.0."""
_ZSTD = 50000
"""Tag Compression of TIFF: Zstandard. Source: libtiff 4.0.10."""
_CM_PER_INCH = 2.54
"""Centimetres in an inch. Source: definition of the inch."""

SizeCheck = Callable[[int, int], None]
"""Gets rows and columns of a picture, upright, before memory is taken for it; raises BadInput."""

logging.getLogger("tifffile").addHandler(logging.NullHandler())  # else it writes to stderr


@dataclass(frozen=True, slots=True)
class Header:
    """What an image file states; headers are equal where the decoded images have one shape and
    type."""

    rows: int
    columns: int
    channels: int
    """1 or 3, without alpha."""
    dtype: np.dtype[Any]
    orientation: int = field(default=1, compare=False)
    """EXIF's, 1 to 8; 1 = stored as it is seen."""
    ppi: tuple[float, float] | None = field(default=None, compare=False)
    """Pixels per inch along columns and rows."""
    encoding: str = field(default="", compare=False)
    """``srgb`` or ``linear`` where a PNG file states it."""
    text: Mapping[str, str] = field(default_factory=dict, compare=False)
    page: Any = field(default=None, compare=False)
    """Of tifffile, the first of a TIFF file."""

    @property
    def words(self) -> str:
        """Such as ``3200 x 2200 RGB, 8 bits``; rows by columns, as in the rig file."""
        colour = "RGB" if self.channels == 3 else "grey"
        return f"{self.rows} x {self.columns} {colour}, {self.dtype.itemsize * 8} bits"


class _Quiet:
    """While any thread is inside, nothing reaches the process's stderr: libpng and libjpeg print
    what they refuse, and Pillow warns of it.
    """

    def __init__(self) -> None:
        self._lock, self._inside, self._undo = threading.Lock(), 0, contextlib.ExitStack()

    def __enter__(self) -> None:
        with self._lock:
            self._inside += 1
            if self._inside == 1:
                self._undo.enter_context(warnings.catch_warnings(action="ignore"))
                with contextlib.suppress(OSError):  # closed
                    stderr = os.dup(2)
                    self._undo.callback(os.close, stderr)
                    self._undo.callback(os.dup2, stderr, 2)
                    with open(os.devnull, "wb") as null:  # noqa: PTH123 - a device
                        os.dup2(null.fileno(), 2)

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._inside -= 1
            if self._inside == 0:
                self._undo.close()


_QUIET = _Quiet()
MAX_PIXELS = 200_000_000
"""Maximum pixels of one image: a small damaged file can claim any number."""


def read_header(data: bytes, name: str, max_pixels: int = MAX_PIXELS) -> Header:
    """What a PNG, TIFF, JPEG, WEBP or BMP file states, before memory is taken.

    Raises BadInput, with `name`, if the header is damaged, the file of another kind, or the image
    larger than `max_pixels` or 400 MB once decoded.
    """
    _check_parts(data, name)
    header = _tiff_header(data, name) if data.startswith(TIFFS) else _pillow_header(data, name)
    decoded = check_size(
        header.rows, header.columns, header.channels * header.dtype.itemsize, name, max_pixels
    )
    # bytes that one byte of a file can become: of a WEBP or a palette of one bit, the densest
    require(
        decoded <= 50_000 * len(data),
        f"{name} is damaged: it claims {header.rows} x {header.columns} pixels"
        f", which cannot be in {len(data)} bytes; copy it again.",
    )
    return header


_METADATA_PARTS = 1000
"""Chunks of a PNG file and segments of a JPEG file at most, beside those of the image."""
_IMAGE_PARTS = 100_000
"""Chunks of a PNG's image, and strips or tiles of a TIFF's, at most: 400 MB in libpng's 8 kB are
50,000."""


def _check_parts(data: bytes, name: str) -> None:
    """Refuse files with implausibly many chunks (PNG), markers (JPEG), or tags and strips (TIFF):
    each costs the decoders 20 us or 100 bytes."""
    metadata, image = 0, 0
    with contextlib.suppress(struct.error):  # it ends here, which its reader reports
        if data.startswith(PNG):
            place = 8
            while max(metadata * _IMAGE_PARTS // _METADATA_PARTS, image) <= _IMAGE_PARTS:
                length, kind = struct.unpack_from(">I4s", data, place)
                place += length + 12
                metadata, image = metadata + (kind != b"IDAT"), image + (kind == b"IDAT")
        elif data.startswith(JPEG):
            place = 2
            while metadata <= _METADATA_PARTS:
                fill, marker, length = struct.unpack_from(">BBH", data, place)
                if (fill, marker) == (0xFF, 0xDA):  # the image
                    break
                segment = fill == 0xFF and 0xC0 <= marker < 0xFF and not 0xD0 <= marker <= 0xD9
                place += 2 + length if segment else 1
                metadata += 1
        elif data.startswith(TIFFS):
            order, big = "<" if data.startswith(b"II") else ">", b"+" in data[2:4]
            (place,) = struct.unpack_from(order + "IQ"[big], data, 4 + 4 * big)
            (metadata,) = struct.unpack_from(order + "HQ"[big], data, place)
            for k in range(min(metadata, _METADATA_PARTS)):
                entry = place + (8 + 20 * k if big else 2 + 12 * k)
                tag, _, count = struct.unpack_from(order + ("HHQ" if big else "HHI"), data, entry)
                image = max(image, count if tag in _STRIPS else 0)
    require(
        metadata <= _METADATA_PARTS and image <= _IMAGE_PARTS,
        f"{name} has more chunks, segments, tags ({_METADATA_PARTS}) or strips ({_IMAGE_PARTS})"
        " than any picture; save it again.",
    )


_DECODED_BYTES = 400_000_000
"""Bytes of one decoded image, at most: 130 million pixels of 8-bit RGB. Decoders of C hold a second
copy beside it."""


def check_size(
    rows: int, columns: int, bytes_each: int, name: str, max_pixels: int = MAX_PIXELS
) -> int:
    """Size in bytes of an image once decoded; BadInput if it is too large or empty. `bytes_each`:
    of a pixel."""
    size = f"{name} claims {rows} x {columns} pixels"
    require(0 < rows * columns <= max_pixels, f"{size}, more than the {max_pixels} that are read.")
    decoded = rows * columns * bytes_each
    require(
        decoded <= _DECODED_BYTES,
        f"{size}, {decoded} bytes once decoded, more than the {_DECODED_BYTES} that are read;"
        " reduce the image.",
    )
    return decoded


def _pillow_header(data: bytes, name: str) -> Header:
    opener: Any = next(
        (opener for start, opener in _OPENERS.items() if data.startswith(start)), None
    )
    what = "is not a PNG, TIFF or JPEG image" if data else "is empty"
    require(opener is not None, f"{name} {what}; export it again as 8- or 16-bit PNG.")
    with (
        refusing(
            f"{name} is damaged, or of a kind that is not read: its header makes no sense; copy it"
            " again."
        ),
        _QUIET,
    ):
        picture = opener(io.BytesIO(data))
        columns, rows = picture.size
        info = picture.info
        exif = Image.Exif()
        exif.load(info.get("exif"))
        orientation = exif.get(_ORIENTATION, 1)
    grey = picture.mode in _GREY
    dtype = np.dtype("u1")
    encoding = ""
    require(
        grey or picture.mode in _COLOUR,
        f"{name} is neither grey nor RGB ({picture.mode}); save it as one of both.",
    )
    if data.startswith(PNG):  # Pillow has no modes of 16 bits but grey
        grey = data[25] in (0, 4)
        dtype = np.dtype("u2" if data[24] == 16 else "u1")
        encoding = _encoding(info)
    ppi = info.get("dpi")
    return Header(
        rows,
        columns,
        1 if grey else 3,
        dtype,
        orientation if orientation in range(1, 9) else 1,
        (float(ppi[0]), float(ppi[1])) if ppi and min(ppi) > 0 else None,
        encoding,
        {str(key): value for key, value in info.items() if isinstance(value, str)},
    )


def _encoding(info: Mapping[Any, Any]) -> str:
    """Encoding by a PNG file's chunks sRGB, gAMA and iCCP."""
    gamma = float(info.get("gamma", 0.0))
    if "srgb" in info or (gamma != 1.0 and ("icc_profile" in info or 0.4 < gamma < 0.5)):
        return "srgb"
    return "linear" if gamma == 1.0 else ""


def _tiff_header(data: bytes, name: str) -> Header:
    """Of a flat grey or RGB image of 8 or 16 bits or floats, whose strips or tiles lie in the file,
    side by side."""
    import tifffile  # slow

    damaged = f"{name} is not a sound TIFF file: its tags are damaged; export it again."
    with refusing(damaged), _QUIET:
        page: Any = tifffile.TiffFile(io.BytesIO(data)).pages.first
        orientation = page.tags.valueof(_ORIENTATION, 1)
        rows = int(page.imagelength)
        columns = int(page.imagewidth)
        samples = int(page.samplesperpixel)
        stored = list(zip(page.dataoffsets, page.databytecounts, strict=True))
        counted = len(stored) == np.prod(page.chunked)
        dtype = page.dtype
        ends = max((offset + length for offset, length in stored), default=0)
        ppi = _tiff_ppi(page)
        photometric = int(page.photometric)
        planes = int(page.planarconfig or 1)
        text = page.description[:1_000_000]
    require(
        page.imagedepth == 1 and min(rows, columns) > 0,
        f"{name} is not a single flat image; save it as PNG.",
    )
    known = dtype is not None and dtype.name in ("uint8", "uint16", "float32", "float64")
    require(
        known,
        f"{name} has samples of the type {dtype} ({page.bitspersample} bits)"
        "; save it as 8- or 16-bit unsigned integers.",
    )
    grey = photometric in (0, 1) and samples == 1
    colour = photometric == 2 and samples in (3, 4)
    require(
        (grey or colour) and (samples == 1 or planes == 1),
        f"{name} is neither grey nor RGB (CMYK, palette, grey with alpha?); save it as grey or"
        " RGB.",
    )
    require(counted and sum(length for _, length in stored) <= len(data), damaged)
    require(
        ends <= len(data),
        f"{name} is truncated: the TIFF file ends within the image; copy it again.",
    )
    orientation = orientation if orientation in range(1, 9) else 1
    channels = 1 if grey else 3
    return Header(
        rows, columns, channels, dtype.newbyteorder("="), orientation, ppi, "", {"": text}, page
    )


def _tiff_ppi(page: Any) -> tuple[float, float] | None:
    """Resolution along columns and rows by the tags; None where it is not stated, or not
    soundly."""
    with contextlib.suppress(ValueError, TypeError, ZeroDivisionError, OSError, struct.error):
        (x, x_of), (y, y_of) = page.tags.valueof(_X_RESOLUTION), page.tags.valueof(_Y_RESOLUTION)
        scale = {2: 1.0, 3: _CM_PER_INCH}.get(int(page.tags.valueof(_RESOLUTION_UNIT, 2)), 0.0)
        ppi = scale * x / x_of, scale * y / y_of
        return ppi if min(ppi) > 0 else None
    return None


def decode_pixels(data: bytes, header: Header, name: str) -> NDArray[Any]:
    """Pixels (H, W, C) as stored, in the order red, green, blue, with alpha behind them where there
    is some; BadInput where a part is missing or damaged.
    """
    page = header.page
    if page is None:
        _check_whole(data, name)
        pixels = decoded(data, name)
        return pixels[..., ::3] if header.channels == 1 and pixels.shape[2] == 4 else pixels
    if page.compression == _ZSTD:
        pixels = _by_pillow(data, header, name)
    elif page.compression == 1:
        with refusing(f"{name} is damaged: a part of its image is missing; copy it again."), _QUIET:
            pixels = page.asarray(maxworkers=1).reshape(header.rows, header.columns, -1)
    else:
        pixels = decoded(data, name)
    colours = page.samplesperpixel == header.channels or (page.extrasamples or (0,))[0] in _ALPHA
    pixels = pixels if colours else pixels[..., : header.channels]
    turned = page.compression != 1 and header.dtype == np.uint8  # by OpenCV
    inverted = page.photometric == 0 and not turned and header.dtype.kind == "u"
    return np.asarray(np.iinfo(header.dtype).max - pixels) if inverted else pixels


def _by_pillow(data: bytes, header: Header, name: str) -> NDArray[Any]:
    """Pixels (H, W, C) of a TIFF file that OpenCV cannot decompress."""
    damaged = f"{name} is damaged, or stored turned; copy it again, or save it as PNG."
    with refusing(damaged), _QUIET:
        picture = TiffImageFile(io.BytesIO(data))
        same = picture.size == (header.columns, header.rows) and header.orientation == 1
        require(same, damaged)  # before memory is taken
        return np.asarray(picture).reshape(header.rows, header.columns, -1)


_MAX_SCANS = 100
"""Scans of a JPEG file at most: each costs a pass through the whole image; a progressive image has
about ten."""


def _check_whole(data: bytes, name: str) -> None:
    """Refuse PNG and JPEG files of which a part is missing; the decoder compares checksums."""
    if data.startswith(PNG):
        require(
            data.rfind(PNG_END) >= 0,  # from the end, where it is
            f"{name} is truncated: the PNG file ends within the image; copy it again.",
        )
    elif data.startswith(JPEG):
        scan = data.rfind(b"\xff\xda")
        require(
            0 <= scan < data.rfind(b"\xff\xd9"),
            f"{name} is truncated: the JPEG file ends within the image; copy it again.",
        )
        require(
            data.count(b"\xff\xda") <= _MAX_SCANS,
            f"{name} is damaged: it has more than {_MAX_SCANS} JPEG scans; copy it again.",
        )


def decoded(data: bytes, name: str) -> NDArray[Any]:
    """Pixels (H, W, C) that OpenCV decodes of a file whose header was checked, in the order red,
    green, blue, alpha. Raises BadInput where it cannot.
    """
    # what it would print is refused here
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    damaged = (
        f"{name} is damaged: its image data cannot be decoded; copy it again, or save it as PNG."
    )
    image: Any = None
    with refusing(damaged), _QUIET:
        image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    require(image is not None, damaged)
    if image.ndim == 2:
        return np.asarray(image[..., None])
    if image.dtype == np.float64:
        return np.asarray(image[..., [2, 1, 0, 3][: image.shape[2]]])
    return np.asarray(
        cv2.cvtColor(image, cv2.COLOR_BGR2RGB if image.shape[2] == 3 else cv2.COLOR_BGRA2RGBA)
    )


MAX_BYTES = 600_000_000
"""Maximum size of an image file."""


def read_image(path: str | os.PathLike[str], check: SizeCheck | None = None) -> PixelArray:
    """Read a PNG, TIFF or JPEG file as (H, W, C) uint8 or uint16 in RGB order, C = 1 (grey) or 3.

    Pixels come as stored: no colour profile is applied, EXIF orientation is ignored, alpha is
    dropped, a PNG palette is expanded. `check` is called with rows and columns before memory is
    taken, and may raise. Raises BadInput if the file is missing, truncated, damaged,
    too large, or not 8- or 16-bit grey or RGB.

    >>> import numpy as np, tempfile, pathlib
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "grey.png"
    >>> write_image(path, np.full((2, 3), 7, dtype=np.uint8))
    >>> read_image(path).shape
    (2, 3, 1)
    """
    return decode_image(read_bytes(path, MAX_BYTES), str(path), check=check)


def decode_image(
    data: bytes, name: str, max_pixels: int = MAX_PIXELS, check: SizeCheck | None = None
) -> PixelArray:
    """Decode the bytes of an image file; see :func:`read_image`."""
    header = read_header(data, name, max_pixels)
    if check is not None:
        check(header.rows, header.columns)
    return _plain_pixels(data, header, name)


def _plain_pixels(data: bytes, header: Header, name: str) -> PixelArray:
    """(H, W, C) without alpha, as the header states."""
    require(
        header.dtype.kind == "u",
        f"{name} holds {header.dtype}; save it as 8- or 16-bit unsigned integers.",
    )
    image = decode_pixels(data, header, name)[..., : header.channels]
    same = (
        image.shape == (header.rows, header.columns, header.channels)
        and image.dtype == header.dtype
    )
    require(
        same,
        f"{name} is stored in a way that is not read; save it as 8- or 16-bit PNG, grey or RGB.",
    )
    return np.ascontiguousarray(image)


def cores() -> int:
    """Cores that this process may use, at most eight."""
    return min(8, len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 2)


STACK_BYTES = 4_000_000_000
"""Maximum size of all decoded images of a capture: 80 images of the rig's camera in 16-bit
colour."""


def read_stacks(
    groups: Mapping[str, Sequence[Path]],
    size: tuple[int, int],
    expected_by: str,
    threads: int = 0,
) -> tuple[dict[str, PixelArray], dict[str, str]]:
    """Decode groups of files at once, each group into a stack (L, H, W, C); and the SHA-256 of each
    file by its path. `expected_by`: what requires `size` (rows, columns), for messages; `threads`:
    0 is one for each core, at most eight. The first file at fault is the one reported.
    """
    pool = ThreadPoolExecutor(threads or cores(), thread_name_prefix="splitknit-read")
    stacks: dict[str, PixelArray] = {}
    jobs: list[tuple[str, Future[str]]] = []
    total = 0

    def read(stack: PixelArray, k: int, file: Path, first: Path, like: Header) -> str:
        name = str(file)
        data = read_bytes(file, MAX_BYTES)
        header = read_header(data, name)
        size_check(size, expected_by, name)(header.rows, header.columns)
        require(
            header == like,
            f"{name} is {header.words}, but {first} is {like.words}; all images of a band must"
            " agree.",
        )
        stack[k] = _plain_pixels(data, header, name)
        return hashlib.sha256(data).hexdigest()

    try:
        for key, files in groups.items():
            like = read_header(read_bytes(files[0], MAX_BYTES), str(files[0]))
            size_check(size, expected_by, str(files[0]))(like.rows, like.columns)
            shape = (len(files), *size, like.channels)
            total += math.prod(shape) * like.dtype.itemsize
            require(
                total <= STACK_BYTES,
                f"{files[0]} and the images with it take {total} bytes once decoded, more than the"
                f" {STACK_BYTES} that are read at once; reduce them, or name fewer.",
            )
            stack = stacks[key] = new_stack(shape, like.dtype)
            for k, file in enumerate(files):
                jobs.append((str(file), pool.submit(read, stack, k, file, files[0], like)))
        return stacks, {name: job.result() for name, job in jobs}
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def size_check(size: tuple[int, int], expected_by: str, name: str) -> SizeCheck:
    """What refuses a picture, `name`, of another size (rows, columns); `expected_by`: what requires
    it, for messages."""

    def check(rows: int, columns: int) -> None:
        require(
            (rows, columns) == size,
            f"{name} has {rows} x {columns} pixels (rows x columns), but {size[0]} x {size[1]} are"
            f" expected by {expected_by}.",
        )

    return check


def write_image(path: str | os.PathLike[str], pixels: PixelArray) -> None:
    """Write (H, W), (H, W, 1) or (H, W, 3) uint8 or uint16, RGB, losslessly as PNG or TIFF (by the
    suffix). Raises BadInput if array or suffix is of another kind, or on writing.
    """
    write_file(path, encode_image(pixels, Path(path).suffix.lower()))


def encode_image(pixels: PixelArray, suffix: str, *, compress: bool = False) -> bytes:
    """Return the bytes of a ``.png`` or ``.tif``/``.tiff`` file; see :func:`write_image`.

    `compress`: a TIFF file by Zstandard, smaller than a PNG file and read in a third of its time;
    colours of 16 bits, which Pillow does not know, stay uncompressed.
    """
    array: NDArray[Any] = np.asarray(pixels)
    good = array.dtype in (np.uint8, np.uint16) and (
        array.ndim == 2 or (array.ndim == 3 and array.shape[2] in (1, 3))
    )
    require(
        good and array.size > 0,
        "an image to write must be (H, W), (H, W, 1) or (H, W, 3) of uint8 or uint16"
        f", but it is {array.shape} of {array.dtype}.",
    )
    if array.ndim == 3 and array.shape[2] == 1:
        array = array[..., 0]
    if suffix == ".png":
        # Runs alone, as small as the default on noisy photographs, and one row filter: to choose
        # among all five saves 1 % of 16 bits and 10 % of 8 bits, and takes as long again. Both are
        # read faster so.
        return png_bytes(array, cv2.IMWRITE_PNG_STRATEGY_RLE, cv2.IMWRITE_PNG_FILTER_UP)
    require(
        suffix in (".tif", ".tiff"),
        f"images are written as .png, .tif or .tiff, not as '{suffix}'.",
    )
    if not compress or (array.ndim == 3 and array.dtype == np.uint16):
        return encode_tiff(array)
    stream = io.BytesIO()
    differences = {_PREDICTOR: 2}
    Image.fromarray(array).save(stream, "TIFF", compression="zstd", tiffinfo=differences)
    return stream.getvalue()


def png_bytes(image: NDArray[Any], strategy: int, row_filter: int) -> bytes:
    """A PNG file of (H, W) or (H, W, 3) integers, packed quickly by a strategy and a row filter of
    OpenCV."""
    how = [
        cv2.IMWRITE_PNG_COMPRESSION,
        1,
        cv2.IMWRITE_PNG_STRATEGY,
        strategy,
        cv2.IMWRITE_PNG_FILTER,
        row_filter,
    ]
    return cv2.imencode(
        ".png", image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2BGR), how
    )[1].tobytes()


def encode_tiff(
    image: NDArray[Any], description: str | None = None, ppi: float | None = None
) -> bytes:
    """Uncompressed TIFF of (H, W) or (H, W, 3); equal input gives equal bytes. `description`: ASCII
    JSON."""
    import tifffile  # slow

    if description is not None:
        # tifffile takes JSON that holds this key, at any depth, for its own description of an array
        description = description.replace('"shape":', r'"\u0073hape":')
    stream = io.BytesIO()
    tifffile.imwrite(
        stream,
        image,
        photometric="minisblack" if image.ndim == 2 else "rgb",
        description=description,
        resolution=None if ppi is None else (ppi, ppi),
        resolutionunit=None if ppi is None else "INCH",
        software="splitknit",
        metadata=None,
        byteorder="<",
    )
    return stream.getvalue()


def write_float_tiff(
    path: str | os.PathLike[str],
    values: NDArray[np.floating],
    unit: str,
    metadata: Mapping[str, Any] | None = None,
    pitch_mm: float | None = None,
) -> None:
    """Write floats (H, W) or (H, W, 3), NaN where nothing is known, as an uncompressed float32
    TIFF.

    The description tag is a JSON object with ``unit`` (such as ``mm``, ``pixel`` or ``linear light,
    1 = full scale``), ``pitch_mm`` (exact; None where unknown: no resolution is stated then), and
    everything in `metadata`, what JSON can hold; pixels per inch are in the resolution tags. Equal
    input gives equal bytes. Raises BadInput if the array or the pitch is of another kind, or the
    file cannot be written.
    """
    image = np.ascontiguousarray(values, dtype=np.float32)
    good = image.size > 0 and (image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3))
    require(
        good, f"a field to write must have the shape (H, W) or (H, W, 3), but it has {image.shape}."
    )
    description = {**(metadata or {}), "unit": unit}
    if pitch_mm is not None:
        require(
            bool(np.isfinite(pitch_mm)) and pitch_mm > 0,
            f"pitch_mm must be a positive number, not {pitch_mm}.",
        )
        description["pitch_mm"] = float(pitch_mm)
    ppi = None if pitch_mm is None else 10.0 * _CM_PER_INCH / float(pitch_mm)
    write_file(path, encode_tiff(image, canonical_json(description), ppi))
