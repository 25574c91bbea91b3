"""Images in and out: 8- or 16-bit PNG, TIFF and JPEG, grey or RGB, as (H, W, C) integers."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, read_bytes, require
from splitknit.io import png, tiff
from splitknit.io.atomic import write_file
from splitknit.io.png import check_held, check_size
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
"""Pixels of one image, and bytes of its file, at most: nothing of a rig is larger, and a small file can claim any."""
_MAPPED_BYTES = 1_000_000_000
"""Beyond so many the images of a capture lie on disk while they are worked on; a full frame of 16 bits takes 0.7 GB."""
STACK_BYTES = 4_000_000_000  # bytes of all images of a capture once decoded: 80 of the rig's camera in 16-bit colour


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
    """Size, channels and type by the header; BadInput, with `name`, if it is damaged, of an unknown format, or claims
    more than `max_pixels`, 400 MB once decoded, or what the file can hold.
    """
    if data.startswith(png.SIGNATURE[:4]):
        header = png.png_header(data, name)
        info = _ImageInfo(header.rows, header.columns, header.channels, header.dtype)
    elif data.startswith(_JPEG_SIGNATURE):
        info = _jpeg_header(data, name)
    elif data.startswith(tiff.SIGNATURES):
        page = tiff.tiff_header(data, name)
        info = _ImageInfo(page.rows, page.columns, page.channels, page.dtype.newbyteorder("="))
    else:
        what = "is empty" if not data else "is not a PNG, TIFF or JPEG image"
        raise BadInput(f"{name} {what}; export it again as 8- or 16-bit PNG.")
    large = f"{name} claims {info.rows} x {info.columns} pixels, more than the {max_pixels} that are read."
    require(info.rows * info.columns <= max_pixels, large)
    return info


def decode_image(data: bytes, name: str, out: PixelArray | None = None, max_pixels: int = MAX_PIXELS) -> PixelArray:
    """Decode the bytes of an image file, into `out` (H, W, C) where given; see :func:`read_image`."""
    info = _image_info(data, name, max_pixels)
    if data.startswith(png.SIGNATURE):
        return png.decode_png(data, name, out)
    if data.startswith(_JPEG_SIGNATURE):
        return png.placed(png.decoded(data, name), out, info, name)
    return tiff.decode_tiff(data, name, out)


def cores() -> int:
    """Cores that this process may use, at most eight."""
    return min(8, len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else 2)


class StackReader:
    """Decodes many files at once, each into its place in a stack. A context manager; call :meth:`start` for each stack,
    then :meth:`finish`: all share the threads.
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
        """The stack (L, H, W, C) that :meth:`finish` fills; `expected_by`: who wants `size` (rows, columns)."""
        first = read_bytes(files[0], MAX_BYTES)
        info = _image_info(first, str(files[0]))
        _check_size(info, size, str(files[0]), expected_by)
        self._bytes += len(files) * size[0] * size[1] * info.channels * info.dtype.itemsize
        large = f"{files[0]} and the images with it take {self._bytes} bytes once decoded, more than the {STACK_BYTES}"
        require(self._bytes <= STACK_BYTES, f"{large} that are read at once; reduce them, or name fewer.")
        shape = (len(files), *size, info.channels)
        stack = large_array(shape, info.dtype) if self._bytes > _MAPPED_BYTES else np.empty(shape, dtype=info.dtype)
        for k, file in enumerate(files):
            data = first if k == 0 else None
            job = self._pool.submit(self._read, file, data, info, str(files[0]), stack[k], expected_by)
            self._jobs.append((str(file), job))
        return stack

    def finish(self) -> dict[str, str]:
        """Wait for all files; return the SHA-256 of each by its path. The first file at fault is the one reported."""
        return {name: job.result() for name, job in self._jobs}

    def _read(  # noqa: PLR0917 - the job of one thread
        self, file: Path, data: bytes | None, like: _ImageInfo, first: str, out: PixelArray, expected_by: str
    ) -> str:
        name = str(file)
        data = read_bytes(file, MAX_BYTES) if data is None else data
        info = _image_info(data, name)
        _check_size(info, (like.rows, like.columns), name, expected_by)
        require(info == like, f"{name} is {info.words}, but {first} is {like.words}; all images of a band must agree.")
        decode_image(data, name, out)
        let_go(out)
        return hashlib.sha256(data).hexdigest()


def write_image(path: str | os.PathLike[str], pixels: PixelArray) -> None:
    """Write (H, W), (H, W, 1) or (H, W, 3) uint8 or uint16, RGB, losslessly as PNG or TIFF (by the suffix). Raises
    BadInput if array or suffix is of another kind, or on writing.
    """
    write_file(path, encode_image(pixels, Path(path).suffix.lower()))


def encode_image(pixels: PixelArray, suffix: str) -> bytes:
    """Return the bytes of a ``.png`` or ``.tif``/``.tiff`` file; see :func:`write_image`."""
    array: NDArray[Any] = np.asarray(pixels)
    good = array.dtype in (np.uint8, np.uint16) and (array.ndim == 2 or (array.ndim == 3 and array.shape[2] in (1, 3)))
    wanted = "an image to write must be (H, W), (H, W, 1) or (H, W, 3) of uint8 or uint16"
    require(good and array.size > 0, f"{wanted}, but it is {array.shape} of {array.dtype}.")
    if array.ndim == 3 and array.shape[2] == 1:
        array = array[..., 0]
    if suffix == ".png":
        # Runs alone, as small as the default on noisy photographs, and one row filter: to choose among all five saves
        # 1 % of 16 bits and 10 % of 8 bits, and takes as long again. Both are read faster so.
        return png_bytes(array, cv2.IMWRITE_PNG_STRATEGY_RLE, cv2.IMWRITE_PNG_FILTER_UP)
    require(suffix in (".tif", ".tiff"), f"images are written as .png, .tif or .tiff, not as '{suffix}'.")
    return tiff.encode_tiff(array)


def png_bytes(image: NDArray[Any], strategy: int, row_filter: int) -> bytes:
    """A PNG file of (H, W) or (H, W, 3) integers, packed quickly by a strategy and a row filter of OpenCV."""
    how = [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, strategy, cv2.IMWRITE_PNG_FILTER, row_filter]
    return cv2.imencode(".png", image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2BGR), how)[1].tobytes()


def _check_size(info: _ImageInfo, size: tuple[int, int], name: str, expected_by: str) -> None:
    expected = f"{size[0]} x {size[1]} are expected by {expected_by}."
    other = f"{name} has {info.rows} x {info.columns} pixels (rows x columns), but {expected}"
    require((info.rows, info.columns) == size, other)


# JPEG files: the structure is checked before the decoder sees them.
#
# JPEG has no checksums, so that a changed byte inside the image data cannot be distinguished from a picture; what can
# be found is a file that ends early, has a damaged header, or is of a kind that is not supported.
#
# Source: ITU-T T.81 (1992), annex B: markers and segments.

_JPEG_SIGNATURE = b"\xff\xd8\xff"
_MARKER_IN_SCAN = re.compile(rb"\xff+[^\x00\xff\xd0-\xd7]", re.DOTALL)
APP1 = 0xE1  # second byte of the marker of a segment that may hold EXIF data
_FRAMES = frozenset({0xC0, 0xC1, 0xC2})
_MAX_SCANS = 100  # each scan costs a pass through the whole image; a progressive image has about ten
_BLOCK_PIXELS = 64
_OTHER_FRAMES = frozenset({0xC3, 0xC5, 0xC6, 0xC7, 0xC9, 0xCA, 0xCB, 0xCD, 0xCE, 0xCF})


def _jpeg_header(data: bytes, name: str) -> _ImageInfo:
    """Size of a JPEG file's frame, all segments walked; BadInput if it is damaged, cut short or of a kind not read."""
    truncated = f"{name} is truncated: the JPEG file ends within the image; copy it again."
    frame: _ImageInfo | None = None
    finest, position, scans = 0.0, 2, 0
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
            frame, finest = _frame(data[position + 4 : position + 2 + length], name)
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
    check_size(frame.rows, frame.columns, frame.channels, name)
    check_held(frame.rows, frame.columns, finest / _BLOCK_PIXELS / 8, len(data), name)
    return frame


def jpeg_segments(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Second byte of the marker, start and end of each segment of a sound JPEG file, before its first scan."""
    place = 2
    while (marker := data[place + 1]) != 0xDA:
        end = place + (1 if marker == 0xFF else 2 + int.from_bytes(data[place + 2 : place + 4], "big"))
        yield marker, place, end
        place = end


def _frame(body: bytes, name: str) -> tuple[_ImageInfo, float]:
    """The frame header, and the finest channel's part of the pixels; each of its 8 x 8 blocks takes a bit or more."""
    require(len(body) >= 6, f"{name} is damaged: its JPEG frame header is incomplete; copy it again.")
    rows, columns = int.from_bytes(body[1:3], "big"), int.from_bytes(body[3:5], "big")
    require(body[0] == 8, f"{name} has {body[0]} bits a sample; a JPEG file must have 8.")
    require(body[5] in (1, 3), f"{name} has {body[5]} channels (CMYK?); save it as grey or RGB.")
    require(rows > 0 and columns > 0, f"{name} is damaged: its JPEG frame header gives no size; copy it again.")
    require(len(body) == 6 + 3 * body[5], f"{name} is damaged: its JPEG frame header is incomplete; copy it again.")
    sampling = [(body[place] >> 4, body[place] & 15) for place in range(7, len(body), 3)]
    across, down = (max(factors) for factors in zip(*sampling, strict=True))
    possible = all(1 <= factor <= 4 for pair in sampling for factor in pair)
    require(possible, f"{name} is damaged: its JPEG channels have an impossible sampling; copy it again.")
    info = _ImageInfo(rows, columns, body[5], np.dtype(np.uint8))
    return info, max(x * y for x, y in sampling) / (across * down)
