"""Normal maps of any program as unit vectors: PNG and TIFF, ``.npy`` and ``.npz``, EXR.

x points right, y up and z to the camera, as most programs write them. Integers go from -1 at zero
to 1 at the highest; floats are the vectors themselves, or colours from 0 to 1, whichever have the
length 1.
"""

from __future__ import annotations

import hashlib
import io
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import refusing, require
from splitknit.files import AnyPath, read_bytes
from splitknit.io.content import mask_of_photo
from splitknit.io.images import MAX_BYTES, check_size, size_check
from splitknit.io.npz import read_npy, read_npz
from splitknit.io.photos import decode_photo, of_extra, read_photo
from splitknit.model import BoolArray, FloatArray

_NO_VECTORS = (
    "{} holds no normal map: vectors x, y, z of length 1 are expected, as -1 to 1, or as colours"
    " whose lowest value is -1 and whose highest is 1; but half of them are shorter than {:.2f} or"
    " longer than {:.2f}."
)
_TOLERANCE = 0.2
"""By how much a unit vector may be too long or short: a mean over an edge is 0.9."""


def read_normal_map(path: AnyPath) -> tuple[FloatArray, dict[str, str]]:
    """Normals (H, W, 3) of a file, of length 1 or, where the file has none, zero; and its SHA-256
    by its name. Raises BadInput if it is missing, damaged, too large, or no normal map.
    """
    file = Path(path)
    data = read_bytes(file, MAX_BYTES)
    if file.suffix.lower() == ".npz":
        stored, opaque = _only_map(read_npz(file, ("normals",)) or read_npz(file), file), None
    elif file.suffix.lower() == ".npy":
        stored, opaque = _only_map({"": read_npy(data, str(file))}, file), None
    elif file.suffix.lower() == ".exr":
        stored, opaque = _exr(data, str(file)), None
    else:
        photo = decode_photo(data, str(file))
        stored, opaque = photo.pixels, photo.opaque
    three = stored.shape[2] == 3
    require(three, f"{file} is grey; a normal map has three channels, x, y and z.")
    hashes = {file.name: hashlib.sha256(data).hexdigest()}
    return unit_vectors(stored, str(file), opaque), hashes


def unit_vectors(stored: NDArray[Any], name: str, opaque: BoolArray | None = None) -> FloatArray:
    """The vectors (H, W, 3) that numbers or colours stand for; zero where they have no length, or
    not that of a unit vector. Raises BadInput if that is most of what is not empty."""
    scale = float(np.iinfo(stored.dtype).max) if stored.dtype.kind == "u" else 1.0
    values = np.nan_to_num(stored.astype(np.float32), posinf=0.0, neginf=0.0) / np.float32(scale)
    values = np.clip(values, -1e6, 1e6)  # so that squares stay finite
    used = values.any(axis=2) if opaque is None else values.any(axis=2) & opaque
    drawn = used & (values != values[0, 0]).any(axis=2)  # a corner has the background's colour
    used = drawn if drawn.any() else used
    require(used.any(), f"{name} is empty: all its vectors are zero.")
    forms = [2.0 * values - 1.0] if stored.dtype.kind == "u" else [values, 2.0 * values - 1.0]
    lengths = [np.sqrt(np.einsum("hwc,hwc->hw", form, form)) for form in forms]
    off = [float(np.median(np.abs(length[used] - 1.0))) for length in lengths]
    best = int(np.argmin(off))
    low, high = np.percentile(lengths[best][used], (25, 75))
    unit = used & (np.abs(lengths[best] - 1.0) < _TOLERANCE)
    require(off[best] < _TOLERANCE, _NO_VECTORS.format(name, low, high))
    normals = np.where(unit[..., None], forms[best] / np.maximum(lengths[best], 0.1)[..., None], 0)
    require(
        float(np.median(normals[unit][:, 2])) > 0.0,
        f"{name}: z of most normals points away from the camera; x right, y up and z to the camera"
        " are expected.",
    )
    return normals.astype(np.float32)


def read_mask(path: AnyPath, shape: tuple[int, int]) -> tuple[BoolArray, dict[str, str]]:
    """Mask (H, W) of an image, and its SHA-256 by its name. Raises BadInput if it has another
    `shape`."""
    name = str(path)
    photo = read_photo(path, size_check(shape, "the picture that it masks", name))
    return mask_of_photo(photo, name), {Path(path).name: photo.sha256}


def _only_map(arrays: dict[str, NDArray[Any]], file: Path) -> NDArray[Any]:
    """The one array (H, W, 3) of a file."""
    maps = [
        array
        for array in arrays.values()
        if array.ndim == 3 and array.shape[2] == 3 and array.dtype.kind in "uf"
    ]
    require(
        len(maps) == 1,
        f"{file} must hold one array (H, W, 3) of floats, uint8 or uint16, or one named 'normals',"
        f" but it holds {len(maps)}.",
    )
    rows, columns, _ = maps[0].shape
    check_size(rows, columns, 3 * maps[0].dtype.itemsize, str(file))
    return maps[0]


def _exr(data: bytes, name: str) -> NDArray[Any]:
    """The channels R, G, B, or x, y, z, of an OpenEXR file."""
    with of_extra(name, "EXR"):
        import OpenEXR
    with refusing(f"{name} is damaged, or no OpenEXR image of R, G, B or X, Y, Z; save it again."):
        with OpenEXR.File(io.BytesIO(data), separate_channels=True, header_only=True) as file:
            (left, top), (right, bottom) = file.header()["dataWindow"]
            rows, columns = int(bottom - top) + 1, int(right - left) + 1
            check_size(rows, columns, 4 * len(file.header()["channels"]), name)
        with OpenEXR.File(io.BytesIO(data), separate_channels=True) as file:
            channels = {key.split(".")[-1].lower(): each for key, each in file.channels().items()}
        names = "rgb" if "r" in channels else "xyz"
        return np.stack([channels[key].pixels.astype(np.float32) for key in names], axis=2)
