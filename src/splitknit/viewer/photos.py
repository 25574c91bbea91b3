"""The photographs that a result was made from, for people: 8 bits, sRGB, straight from the capture's folder."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, require
from splitknit.io.capture_file import read_plan
from splitknit.io.images import decode_image
from splitknit.viewer.catalogue import Entry, read_below

_WIDEST = 4096


@dataclass(frozen=True, slots=True)
class Photo:
    """One photograph."""

    name: str
    """Relative to the capture's folder."""
    band: str
    number: int
    """Within the band, from 0."""
    encoding: str


@lru_cache(maxsize=16)
def photos_of(folder: Path) -> tuple[Photo, ...]:
    """Return the photographs of a capture, band by band.

    Raises
    ------
    BadInput
        If ``capture.json`` or its rig cannot be read.
    """
    plan = read_plan(folder / "capture.json")
    return tuple(
        Photo(name, band, number, plan.encoding)
        for band, shots in plan.bands.items()
        for number, name in enumerate(shots.names)
    )


def photo_jpeg(entry: Entry, number: int, width: int) -> bytes:
    """Return a photograph as JPEG, at most `width` pixels wide.

    Raises
    ------
    BadInput
        If there is no such photograph, it cannot be read, or it is not the one that the result was made from.
    """
    if entry.capture is None:
        raise BadInput("the photographs are not at hand; name their folder with --capture.")
    photos = photos_of(entry.capture)
    require(0 <= number < len(photos), f"there is no photograph number {number}.")
    require(16 <= width <= _WIDEST, f"a width must lie between 16 and {_WIDEST} pixels.")
    photo = photos[number]
    hashes: Any = entry.report.get("inputs_sha256", {})
    return _jpeg(entry.capture, photo, str(hashes.get(photo.name)), width)


@lru_cache(maxsize=32)
def _jpeg(folder: Path, photo: Photo, sha256: str, width: int) -> bytes:
    data = read_below(folder, photo.name)
    same = hashlib.sha256(data).hexdigest() == sha256
    require(same, f"{photo.name} is not the file that this result was made from: its hash is another.")
    pixels: NDArray[Any] = decode_image(data, photo.name)
    if pixels.shape[1] > width:
        size = (width, max(1, round(pixels.shape[0] * width / pixels.shape[1])))
        pixels = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA))
    level = pixels.astype(np.float32) / np.float32(np.iinfo(pixels.dtype).max)
    if photo.encoding == "linear":
        level = np.where(level <= 0.0031308, 12.92 * level, 1.055 * np.maximum(level, 1e-6) ** (1 / 2.4) - 0.055)
    image = np.round(255.0 * np.clip(level, 0.0, 1.0)).astype(np.uint8)
    if image.ndim == 3:
        image = image[..., 0] if image.shape[2] == 1 else image[..., ::-1]
    done, encoded = cv2.imencode(".jpg", np.ascontiguousarray(image), [cv2.IMWRITE_JPEG_QUALITY, 88])
    if not done:
        raise RuntimeError("a photograph could not be encoded")
    return encoded.tobytes()
