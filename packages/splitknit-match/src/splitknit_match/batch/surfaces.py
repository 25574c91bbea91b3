"""A surface as bytes: exactly what matching needs of a reconstruction, and nothing that follows from it.

The payload, little-endian: a head (see :data:`_HEAD`), the mask's bounding box in bits, and for each pixel of the mask,
in row order, the heights of surface and shape as differences of neighbouring values' bit patterns, the relief as its
difference from surface minus shape, and the normals only where they do not follow from the surface. All of it is stored
by byte planes, which compress to about 5 bytes a pixel. Nothing is rounded: local binary patterns compare neighbours,
and a step of 0.05 um changed the features of the relief by 7 %.
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import refusing, require
from splitknit.imaging.geometry import bounding_box, height_gradients, normals_from_gradients
from splitknit.model import BoolArray, FloatArray, Surface

_HEAD = struct.Struct("<4sII4IId9dII")
"""Magic; rows, columns; top, left, rows and columns of the box; 1 if normals are stored, and 2 more if the surface is
not split; pitch in mm; matrix that takes the upright frame to the input; rows and columns of the upright frame."""
_MAGIC = b"SKS1"
_MAX_PIXELS = 40_000_000
"""Pixels of a capture's images, at most: five times the rig's camera. A surface takes 21 bytes a pixel unpacked."""
_MAX_MM = 1000.0  # largest height
_DAMAGED = "a stored surface is damaged; remove its chunk and run the same again."


def pack_surface(surface: Surface, height_mm: FloatArray) -> bytes:
    """Payload of a surface whose knitted height (H, W) is `height_mm`."""
    mask = surface.mask
    require(bool(mask.any()), "the mask of a surface is empty.")
    require(mask.size <= _MAX_PIXELS, f"a surface of {mask.size} pixels is too large to be kept; reduce the images.")
    box = bounding_box(mask)
    height, shape = height_mm[mask], surface.shape_mm[mask]
    follow = np.array_equal(_normals(height_mm, mask, surface.pitch_mm), surface.normals)
    head = _HEAD.pack(
        _MAGIC, *mask.shape, *(side.start for side in box), *(side.stop - side.start for side in box),
        int(not follow) + 2 * int(surface.whole), surface.pitch_mm,
        *np.asarray(surface.input_from_upright, dtype=np.float64).ravel().tolist(), *surface.upright_size,
    )  # fmt: skip
    parts = [head, np.packbits(mask[box]).tobytes(), _along(height), _along(shape)]
    parts.append(_planes(_bits(surface.ridge_mm[mask]) - _bits(height - shape)))
    if not follow:
        parts += [_along(surface.normals[mask][:, k]) for k in range(3)]
    return b"".join(parts)


def unpack_surface(payload: bytes) -> Surface:
    """Read what :func:`pack_surface` wrote, to the last bit. Raises BadInput if it is damaged."""
    with refusing(_DAMAGED):
        magic, rows, columns, top, left, high, wide, kinds, pitch, *rest = _HEAD.unpack_from(payload)
        require(magic == _MAGIC and 0 < top + high <= rows and 0 < left + wide <= columns, _DAMAGED)
        require(rows * columns <= _MAX_PIXELS and rest[9] * rest[10] <= 2 * _MAX_PIXELS, _DAMAGED)
        require(kinds in range(4) and 1e-6 < pitch < 1e3 and bool(np.isfinite(rest[:9]).all()), _DAMAGED)
        at = _HEAD.size
        size = (high * wide + 7) // 8
        require(len(payload) > at + size, _DAMAGED)
        bits = np.unpackbits(np.frombuffer(payload, np.uint8, size, at), count=high * wide)
        at, count = at + size, int(np.count_nonzero(bits))
        stored = kinds % 2
        planes = 3 + 3 * stored
        require(len(payload) == at + 4 * count * planes and count > 0, _DAMAGED)
        words = [_words(payload, at + 4 * count * k, count) for k in range(planes)]
    mask = np.zeros((rows, columns), dtype=np.bool_)
    mask[top : top + high, left : left + wide] = bits.reshape(high, wide).astype(np.bool_)
    height, shape, *parts = (_floats(np.cumsum(word, dtype=np.int32)) for word in (*words[:2], *words[3:]))
    with np.errstate(invalid="ignore", over="ignore"):
        ridge = _floats(_bits(height - shape) + words[2])
    sound = all(bool((np.abs(values) <= _MAX_MM).all()) for values in (height, shape, ridge, *parts))
    require(sound, _DAMAGED)
    normals = np.zeros((rows, columns, 3), dtype=np.float32)
    if stored:
        normals[mask] = np.stack(parts, axis=1)
    else:  # where the mask is, and beside it: they follow from neighbours
        box = slice(max(top - 1, 0), top + high + 1), slice(max(left - 1, 0), left + wide + 1)
        normals[box] = _normals(_placed(height, mask[box]), mask[box], pitch)
    return Surface(
        ridge_mm=_placed(ridge, mask),
        shape_mm=_placed(shape, mask),
        normals=normals,
        mask=mask,
        pitch_mm=pitch,
        input_from_upright=np.asarray(rest[:9], dtype=np.float64).reshape(3, 3),
        upright_size=(rest[9], rest[10]),
        whole=kinds >= 2,
    )


def _normals(height_mm: FloatArray, mask: BoolArray, pitch_mm: float) -> FloatArray:
    """Normals (H, W, 3) of a surface under parallel rays, zero outside the mask."""
    seen = np.where(mask, height_mm, np.float32(np.nan)).astype(np.float32)
    normals = normals_from_gradients(*height_gradients(seen, pitch_mm)) * mask[..., None]
    return np.nan_to_num(normals, nan=0.0)


def _placed(values: FloatArray, mask: BoolArray) -> FloatArray:
    whole = np.full(mask.shape, np.nan, dtype=np.float32)
    whole[mask] = values
    return whole


def _bits(values: NDArray[np.floating]) -> NDArray[np.int32]:
    return np.ascontiguousarray(values, dtype=np.float32).view(np.int32)


def _floats(words: NDArray[np.int32]) -> NDArray[np.float32]:
    return np.ascontiguousarray(words, dtype=np.int32).view(np.float32)


def _along(values: NDArray[np.floating]) -> bytes:
    bits = _bits(values)
    return _planes(np.diff(bits, prepend=np.zeros(1, dtype=np.int32)))


def _planes(words: NDArray[np.int32]) -> bytes:
    return np.ascontiguousarray(words.astype("<i4").view(np.uint8).reshape(-1, 4).T).tobytes()


def _words(payload: bytes, at: int, count: int) -> NDArray[np.int32]:
    planes: NDArray[Any] = np.frombuffer(payload, np.uint8, 4 * count, at).reshape(4, count)
    return np.ascontiguousarray(planes.T).view("<i4").ravel().astype(np.int32)
