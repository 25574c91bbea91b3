"""Prints as WSQ, the FBI's lossy compression for prints of 500 ppi, through the package `wsq`
(NIST's own code).

That code ends the whole process on some damaged files, and keeps state in global variables. So it
runs in a process of its own, which may end: 50 ms more, and whatever the bytes, an image or one
sentence. The process may take the memory and the processor's time that an image of the size in the
checked header needs, several times over, and no more (where the system has such limits). The
package serves Pillow; its codec is called without it here.

Source: FBI IAFIS-IC-0110 (V3.1), 2010; C. I. Watson et al., "User's Guide to NIST Biometric Image
Software", 2007: cwsq, dwsq.
"""

from __future__ import annotations

import importlib.util
import os
import re
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np

from splitknit import BadInput
from splitknit.errors import require
from splitknit.model import GreyArray
from splitknit_match.records.pictures import PrintFile

BIT_RATE = 0.75
"""Bits a pixel that the encoder aims at; files come out smaller, about 1/15 of the pixels' bytes.
Source: wsq 0.9, which passes no other on."""
_CHILD = f"""
import sys
try:
    import resource
    for limit, most in zip((resource.RLIMIT_AS, resource.RLIMIT_CPU), map(int, sys.argv[3:])):
        resource.setrlimit(limit, (most, most))
except (ImportError, OSError, ValueError):
    pass  # not on every system
sys.path.insert(0, sys.argv[1])
import _wsq
data = sys.stdin.buffer.read()
if sys.argv[2] == "encode":
    width, height = int.from_bytes(data[:4]), int.from_bytes(data[4:8])
    sys.stdout.buffer.write(_wsq.compress(data[8:], width, height, {BIT_RATE}))
else:
    pixels, columns, rows, _ = _wsq.decompress(data)
    sys.stdout.buffer.write(rows.to_bytes(4) + columns.to_bytes(4) + pixels)
"""
_WSQ_SIDE_PX = 96
"""Smallest side of a picture that is coded, for five levels of wavelets: images below 81 pixels
come back in another brightness, below 65 as garbage. Chosen on: judgement. Range: 81 or more."""
_LARGEST_SIDE_PX = 5000  # largest side of a picture that is coded


def encode_wsq(image: GreyArray, ppi: float = 500.0) -> bytes:
    """Compress a print (H, W) uint8, at least 96 pixels each way, of 500 ppi within 1 %: WSQ is
    defined for no other. Raises BadInput if the image or the resolution is of another kind, or the
    package `wsq` is not installed.
    """
    array = np.asarray(image)
    require(
        array.ndim == 2 and array.dtype == np.uint8,
        f"a print must be (H, W) uint8, not {array.shape} {array.dtype}.",
    )
    require(
        min(array.shape) >= _WSQ_SIDE_PX and max(array.shape) <= _LARGEST_SIDE_PX,
        f"WSQ takes images of {_WSQ_SIDE_PX} to {_LARGEST_SIDE_PX} pixels each way, not"
        f" {array.shape[0]} x {array.shape[1]}; pad or crop the print, or write PNG.",
    )
    require(
        495 <= ppi <= 505,
        f"WSQ is for 500 ppi, but the print has {ppi:g}; resample it, or write PNG.",
    )
    rows, columns = array.shape
    data = _run(
        "encode", array.size, rows.to_bytes(4, "big") + columns.to_bytes(4, "big") + array.tobytes()
    )
    if data is None or _wsq_header(data, "the compressed print")[0] != rows:
        raise BadInput("the print cannot be compressed as WSQ; write it as PNG.")
    return data


def decode_wsq(data: bytes, name: str = "the image") -> PrintFile:
    """Decompress a print, the whole file `data`, with the comment's resolution, None if there is
    none; `name`: for messages. Raises BadInput if it is not a WSQ file, truncated or damaged, or
    the package `wsq` is not installed.
    """
    rows, columns, ppi = _wsq_header(data, name)
    decoded = _run("decode", rows * columns, data)
    size = rows.to_bytes(4, "big") + columns.to_bytes(4, "big")
    if decoded is None or decoded[:8] != size or len(decoded) != 8 + rows * columns:
        raise BadInput(f"{name} is damaged: its WSQ image cannot be decoded; copy it again.")
    pixels = np.frombuffer(decoded, dtype=np.uint8, offset=8).reshape(rows, columns)
    return PrintFile(pixels.copy(), None if ppi is None else float(ppi), {})


TIMEOUT_S = 60.0  # how long the codec may take
_CODEC_BYTES = 200_000_000
"""Memory of the codec's process, beside that of the pixels: Python and the file take 13 MB."""
CODEC_S = 2  # time of a processor that the codec may take, beside that of the pixels
_CODEC_PIXELS_PER_S = 1_000_000
"""Pixels in a second that the codec is expected to decode at least; a desktop's core decodes 18
million."""


def _run(task: str, pixels: int, data: bytes) -> bytes | None:
    """Return what the package makes of the bytes in a process of its own; None if it failed or
    ended."""
    package = importlib.util.find_spec("_wsq")
    if package is None or package.origin is None:
        raise BadInput(
            "WSQ needs the package wsq: pip install 'splitknit-match[records]'; or write PNG."
        )
    # the codec takes 10 bytes for each pixel
    limits = (
        _CODEC_BYTES + 30 * pixels + 4 * len(data),
        CODEC_S + pixels // _CODEC_PIXELS_PER_S,
    )
    try:
        done = subprocess.run(
            [
                sys.executable,
                "-I",
                "-S",
                "-c",
                _CHILD,
                str(Path(package.origin).parent),
                task,
                *map(str, limits),
            ],
            input=data,
            capture_output=True,
            timeout=TIMEOUT_S,
            check=False,
            # no keys
            env={
                name: value
                for name, value in os.environ.items()
                if not name.startswith("SPLITKNIT_")
            },
        )
    except subprocess.TimeoutExpired:
        return None
    except OSError as error:
        raise BadInput(
            f"WSQ needs a Python process of its own, which could not be started: {error}."
        ) from error
    return done.stdout if done.returncode == 0 else None


# What is checked before the decoder sees a file. WSQ has no checksums: a changed byte inside the
# image data cannot be distinguished from a picture. Inside them 0xFF is followed by 0, so that
# markers are found by searching.
#
# Source: FBI IAFIS-IC-0110 (V3.1), WSQ Gray-Scale Fingerprint Image Compression Specification,
# 2010: markers and segments.

SIGNATURE = b"\xff\xa0"
_FRAME, _BLOCK, _END = b"\xff\xa2\x00\x11", b"\xff\xa3", b"\xff\xa1"
"""Markers: of the frame, with its length, of the image data, and of the end."""
_SIZE = struct.Struct(">6xHH")
_PPI_LINE = re.compile(rb"\nPPI ([0-9]{1,5})(?=\n)")
_MAX_WSQ_PIXELS = 25_000_000


def _wsq_header(data: bytes, name: str) -> tuple[int, int, int | None]:
    """Rows and columns of a WSQ file, and the resolution in ppi if its comment states it. Raises
    BadInput if it is not a WSQ file, ends early, or claims no or more than 25 million pixels.
    """
    require(
        data[:2] == SIGNATURE,
        f"{name} is not a WSQ file (they begin with FF A0); name another file.",
    )
    frame, block = data.find(_FRAME), data.find(_BLOCK)
    require(
        0 < frame < block < data.rfind(_END),
        f"{name} is truncated or damaged: its WSQ image is not whole; copy it again.",
    )
    rows, columns = _SIZE.unpack_from(data, frame)
    require(
        0 < rows * columns <= _MAX_WSQ_PIXELS,
        f"{name} claims {rows} x {columns} pixels; prints have up to {_MAX_WSQ_PIXELS}.",
    )
    stated = _PPI_LINE.findall(data[:block])
    return rows, columns, int(stated[-1]) if stated else None
