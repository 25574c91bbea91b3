"""Images in and out: 8- or 16-bit PNG, TIFF and JPEG, grey or RGB, as (H, W, C) integers."""

from __future__ import annotations

import hashlib
import io
import os
import re
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, read_bytes, refusing, require
from splitknit.io import png, tiff
from splitknit.io.atomic import write_file
from splitknit.io.png import check_size
from splitknit.model import PixelArray
from splitknit.steps import large_array, let_go


@dataclass(frozen=True, slots=True)
class _ImageInfo:
    """A file's header on its image once decoded."""

    rows: int
    columns: int
    channels: int
    dtype: np.dtype[Any]

    @property
    def words(self) -> str:
        """Such as ``3200 x 2200 RGB, 8 bits``; rows by columns, as in the rig file."""
        colour = "RGB" if self.channels == 3 else "grey"
        return f"{self.rows} x {self.columns} {colour}, {self.dtype.itemsize * 8} bits"


MAX_PIXELS, MAX_BYTES = 200_000_000, 600_000_000
"""Of one image, and of its file: nothing of the rig's kind is larger, and a small file can claim any number."""
_MAPPED_BYTES = 1_000_000_000
"""Beyond so many the images of a capture lie on disk while they are worked on; a full frame of 16 bits takes 0.7 GB."""
STACK_BYTES = 4_000_000_000
"""Of all images of a capture once decoded: 80 of the rig's camera in 16-bit colour."""


def read_image(path: str | os.PathLike[str]) -> PixelArray:
    """Read a PNG, TIFF or JPEG file as (H, W, C) uint8 or uint16 in RGB order, C = 1 (grey) or 3.

    Pixels come as stored: no colour profile is applied, EXIF orientation is ignored, alpha is dropped, a PNG palette is
    expanded. Raises BadInput if the file is missing, truncated, damaged, too large, or not 8- or 16-bit grey or RGB.

    >>> import numpy as np, tempfile, pathlib
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "grey.png"
    >>> write_image(path, np.full((2, 3), 7, dtype=np.uint8))
    >>> read_image(path).shape
    (2, 3, 1)
    """
    return decode_image(read_bytes(path, MAX_BYTES), str(path))


def image_size(path: str | os.PathLike[str]) -> tuple[int, int]:
    """Rows and columns of an image file, without decoding it."""
    info = _image_info(read_bytes(path, MAX_BYTES), str(path))
    return info.rows, info.columns


def _image_info(data: bytes, name: str, max_pixels: int = MAX_PIXELS) -> _ImageInfo:
    """Size, channels and type by the header in `data`; BadInput, with `name`, if it is damaged, of an unknown format,
    or claims more than `max_pixels`, 400 MB once decoded, or what the file can hold.
    """
    if data.startswith(png.SIGNATURE[:4]):
        header = png.png_header(data, name)
        info = _ImageInfo(header.rows, header.columns, header.channels, header.dtype)
    elif data.startswith(_JPEG_SIGNATURE):
        frame = _jpeg_header(data, name)
        info = _ImageInfo(frame.rows, frame.columns, frame.channels, np.dtype(np.uint8))
    elif data.startswith(tiff.SIGNATURES):
        page = tiff.tiff_header(data, name)
        info = _ImageInfo(page.rows, page.columns, page.channels, page.dtype.newbyteorder("="))
    else:
        what = "is empty" if not data else "is not a PNG, TIFF or JPEG image"
        raise BadInput(f"{name} {what}; export it again as 8- or 16-bit PNG.")
    require(
        info.rows * info.columns <= max_pixels,
        f"{name} claims {info.rows} x {info.columns} pixels, more than the {max_pixels} that are read.",
    )
    return info


def decode_image(data: bytes, name: str, out: PixelArray | None = None, max_pixels: int = MAX_PIXELS) -> PixelArray:
    """Decode the bytes of an image file, into `out` (H, W, C) where given; see :func:`read_image`."""
    _image_info(data, name, max_pixels)
    if data.startswith(png.SIGNATURE):
        return png.decode_png(data, name, out)
    if data.startswith(_JPEG_SIGNATURE):
        return _decode_jpeg(data, name, out)
    return tiff.decode_tiff(data, name, out)


def cores() -> int:
    """Cores that this process may use, at most eight."""
    return min(8, len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 2)


class StackReader:
    """Decodes many files at once, each straight into its place in a stack. Use as a context manager; call :meth:`start`
    for each stack and then :meth:`finish`, so that the files of all stacks share the threads.
    """

    def __init__(self, threads: int = 0) -> None:
        """Start so many threads; 0: one for each core, at most eight."""
        self._pool = ThreadPoolExecutor(threads or cores(), thread_name_prefix="splitknit-read")
        self._jobs: list[tuple[str, Future[str]]] = []
        self._bytes = 0

    def __enter__(self) -> StackReader:
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown(wait=True, cancel_futures=True)

    def start(self, files: Sequence[Path], size: tuple[int, int], expected_by: str) -> PixelArray:
        """Return the stack (L, H, W, C) that :meth:`finish` will have filled; `expected_by`: who expects the `size`
        (rows, columns), for the message.
        """
        first = read_bytes(files[0], MAX_BYTES)
        info = _image_info(first, str(files[0]))
        _check_size(info, size, str(files[0]), expected_by)
        self._bytes += len(files) * size[0] * size[1] * info.channels * info.dtype.itemsize
        require(
            self._bytes <= STACK_BYTES,
            f"{files[0]} and the images with it take {self._bytes} bytes once decoded, more than the {STACK_BYTES} "
            "that are read at once; reduce them, or name fewer.",
        )
        shape = (len(files), *size, info.channels)
        stack = large_array(shape, info.dtype) if self._bytes > _MAPPED_BYTES else np.empty(shape, dtype=info.dtype)
        for k, file in enumerate(files):
            data = first if k == 0 else None
            job = self._pool.submit(self._read, file, data, info, str(files[0]), stack[k], expected_by)
            self._jobs.append((str(file), job))
        return stack

    def finish(self) -> dict[str, str]:
        """Wait for all files; return the SHA-256 of each by its path. The first file at fault is the one reported."""
        hashes = {name: job.result() for name, job in self._jobs}
        self._jobs.clear()
        return hashes

    def _read(  # noqa: PLR0917 - the job of one thread
        self, file: Path, data: bytes | None, like: _ImageInfo, first: str, out: PixelArray, expected_by: str
    ) -> str:
        name = str(file)
        data = read_bytes(file, MAX_BYTES) if data is None else data
        info = _image_info(data, name)
        _check_size(info, (like.rows, like.columns), name, expected_by)
        require(
            info == like,
            f"{name} is {info.words}, but {first} is {like.words}; all images of a band must agree.",
        )
        decode_image(data, name, out)
        let_go(out)
        return hashlib.sha256(data).hexdigest()


def write_image(path: str | os.PathLike[str], pixels: PixelArray) -> None:
    """Write (H, W), (H, W, 1) or (H, W, 3) uint8 or uint16, RGB order, as PNG or TIFF (by the suffix), losslessly.
    Raises BadInput if the array or the suffix is of another kind, or the file cannot be written.
    """
    write_file(path, encode_image(pixels, Path(path).suffix.lower()))


def encode_image(pixels: PixelArray, suffix: str) -> bytes:
    """Return the bytes of a ``.png`` or ``.tif``/``.tiff`` file; see :func:`write_image`."""
    array: NDArray[Any] = np.asarray(pixels)
    good = array.dtype in (np.uint8, np.uint16) and (array.ndim == 2 or (array.ndim == 3 and array.shape[2] in (1, 3)))
    require(
        good and array.size > 0,
        f"an image to write must be (H, W), (H, W, 1) or (H, W, 3) of uint8 or uint16, "
        f"but it is {array.shape} of {array.dtype}.",
    )
    if array.ndim == 3 and array.shape[2] == 1:
        array = array[..., 0]
    if suffix == ".png":
        return _encode_png(array)
    require(suffix in (".tif", ".tiff"), f"images are written as .png, .tif or .tiff, not as '{suffix}'.")
    return tiff.encode_tiff(array)


def _encode_png(array: NDArray[Any]) -> bytes:
    import cv2  # slow to import

    # Run-length strategy: on noisy photographs as small as the default, in a third of the time.
    options = [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE]
    image: NDArray[Any] = np.ascontiguousarray(array[..., ::-1] if array.ndim == 3 else array)
    done, data = cv2.imencode(".png", image, options)
    require(bool(done), "an image could not be encoded as PNG.")
    return data.tobytes()


def _check_size(info: _ImageInfo, size: tuple[int, int], name: str, expected_by: str) -> None:
    require(
        (info.rows, info.columns) == size,
        f"{name} has {info.rows} x {info.columns} pixels (rows x columns), but {size[0]} x {size[1]} are expected "
        f"by {expected_by}.",
    )


# JPEG files: the structure is checked before the decoder sees them.
#
# JPEG has no checksums, so that a changed byte inside the image data cannot be distinguished from a picture; what can
# be found is a file that ends early, has a damaged header, or is of a kind that is not supported. Pillow decodes: to
# the same pixels as OpenCV, whose decoder prints on stderr where a file is damaged.
#
# Source: ITU-T T.81 (1992), annex B: markers and segments.

_JPEG_SIGNATURE = b"\xff\xd8\xff"
_MARKER_IN_SCAN = re.compile(rb"\xff+[^\x00\xff\xd0-\xd7]", re.DOTALL)
APP1 = 0xE1
"""Second byte of the marker of a segment that may hold EXIF data."""
_FRAMES = frozenset({0xC0, 0xC1, 0xC2})
_MAX_SCANS = 100
"""Each scan costs a pass through the whole image, whatever its length; a progressive image has about ten."""
_BLOCK_PIXELS = 64
_OTHER_FRAMES = frozenset({0xC3, 0xC5, 0xC6, 0xC7, 0xC9, 0xCA, 0xCB, 0xCD, 0xCE, 0xCF})


@dataclass(frozen=True, slots=True)
class _JpegHeader:
    """The facts of the frame header."""

    rows: int
    columns: int
    channels: int
    finest: float
    """Part of the pixels that the finest channel has; each of its blocks of 8 x 8 takes at least one bit."""


def _jpeg_header(data: bytes, name: str) -> _JpegHeader:
    """Walk all segments of a JPEG file to its end marker and return the frame's size. Raises BadInput if the file ends
    early, has no frame, is of a kind that is not supported, or claims more pixels than can be decoded or be in it.
    """
    truncated = f"{name} is truncated: the JPEG file ends within the image; copy it again."
    frame: _JpegHeader | None = None
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
            require(scans <= _MAX_SCANS, f"{name} is damaged: it has more than {_MAX_SCANS} JPEG scans; copy it again.")
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


def _decode_jpeg(data: bytes, name: str, out: PixelArray | None = None) -> PixelArray:
    """Decode a JPEG file to (H, W, C) uint8, RGB, C = 1 or 3, as stored, without EXIF orientation. Raises BadInput if
    the file is truncated, damaged or of a kind that is not supported.
    """
    from PIL import JpegImagePlugin  # slow to import

    header = _jpeg_header(data, name)
    with refusing(f"{name} cannot be decoded; capture or export it again."):
        image = np.asarray(JpegImagePlugin.JpegImageFile(io.BytesIO(_without_exif(data))))
    shape = (header.rows, header.columns) if header.channels == 1 else (header.rows, header.columns, header.channels)
    require(image.shape == shape, f"{name} cannot be decoded; export it again.")
    if out is None:
        out = np.empty((header.rows, header.columns, header.channels), dtype=np.uint8)
    out[...] = image.reshape(out.shape)
    return out


def _without_exif(data: bytes) -> bytes:
    """A sound JPEG file without its APP1 segments: Pillow warns of damage in what is not looked at here."""
    kept, end = [data[:2]], 2
    for marker, start, end in jpeg_segments(data):
        if marker != APP1:
            kept.append(data[start:end])
    return b"".join([*kept, data[end:]])


def jpeg_segments(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Second byte of the marker, start and end of each segment of a sound JPEG file, before its first scan."""
    place = 2
    while (marker := data[place + 1]) != 0xDA:
        end = place + (1 if marker == 0xFF else 2 + int.from_bytes(data[place + 2 : place + 4], "big"))
        yield marker, place, end
        place = end


def _frame(body: bytes, name: str) -> _JpegHeader:
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
    return _JpegHeader(rows, columns, body[5], max(x * y for x, y in sampling) / (across * down))
