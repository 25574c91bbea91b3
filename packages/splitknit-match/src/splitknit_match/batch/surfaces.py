"""A surface as bytes: exactly what matching needs of a reconstruction, and nothing that follows
from it.

The payload, little-endian: a head (see :data:`_HEAD`), the mask's bounding box in bits, and for
each pixel of the mask, in row order, the heights of surface and shape as differences of
neighbouring values' bit patterns, the relief as its difference from surface minus shape, and the
normals only where they do not follow from the surface. All of it is stored by byte planes, which
compress to about 5 bytes a pixel. Nothing is rounded: local binary patterns compare neighbours, and
a step of 0.05 um changed the features of the relief by 7 %.
"""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import refusing, require
from splitknit.imaging.geometry import bounding_box, height_gradients, normals_from_gradients
from splitknit.model import BoolArray, FloatArray, Surface
from splitknit_match.batch.parameters import MAX_MM, MAX_PIXELS

_HEAD = struct.Struct("<4sII4IId9dII")
"""Magic; rows, columns; top, left, rows and columns of the box; 1 if normals are stored, and 2 more
if the surface is not split; pitch in mm; matrix that takes the upright frame to the input; rows and
columns of the upright frame."""
_MAGIC = b"SKS1"
_DAMAGED = "a stored surface is damaged; remove its chunk and run the same again."


def pack_surface(surface: Surface, height_mm: FloatArray) -> bytes:
    """Payload of a surface whose knitted height (H, W) is `height_mm`."""
    mask = surface.mask
    require(mask.any(), "the mask of a surface is empty.")
    fault = f"a surface of {mask.size} pixels is too large to be kept; reduce the images."
    require(mask.size <= MAX_PIXELS, fault)
    box = bounding_box(mask)
    height, shape = height_mm[mask], surface.shape_mm[mask]
    normals = _normals(height_mm, mask, surface.pitch_mm)
    stored = not np.array_equal(normals, surface.normals)
    corner = [side.start for side in box] + [side.stop - side.start for side in box]
    matrix = np.asarray(surface.input_from_upright, dtype=float).ravel()
    kinds = int(stored) + 2 * int(surface.whole)
    head = _HEAD.pack(
        _MAGIC, *mask.shape, *corner, kinds, surface.pitch_mm, *matrix, *surface.upright_size
    )
    words = [_differences(height), _differences(shape)]
    words.append(_bits(surface.ridge_mm[mask]) - _bits(height - shape))
    if stored:
        words += [_differences(surface.normals[mask][:, k]) for k in range(3)]
    planes = np.stack(words).astype("<i4").view(np.uint8).reshape(len(words), -1, 4)
    return head + np.packbits(mask[box]).tobytes() + planes.transpose(0, 2, 1).tobytes()


def unpack_surface(payload: bytes) -> Surface:
    """Read what :func:`pack_surface` wrote, to the last bit. Raises BadInput if it is damaged."""
    with refusing(_DAMAGED):
        magic, rows, columns, top, left, high, wide, kinds, pitch, *rest = _HEAD.unpack_from(
            payload
        )
        matrix, upright_size = np.array(rest[:9]).reshape(3, 3), (rest[9], rest[10])
        largest = int(max(rows * columns, upright_size[0] * upright_size[1] // 2))
        sound = magic == _MAGIC and kinds < 4 and bool(1e-6 < pitch < 1e3) and largest <= MAX_PIXELS
        sound = sound and top + high <= rows and left + wide <= columns
        require(sound and np.isfinite(matrix).all(), _DAMAGED)
        bits = np.frombuffer(payload, np.uint8, (high * wide + 7) // 8, _HEAD.size)
        inside = np.unpackbits(bits, count=high * wide).astype(bool)
        count = int(np.count_nonzero(inside))
        layers = 6 if kinds % 2 else 3
        at = _HEAD.size + len(bits)
        require(count > 0 and len(payload) == at + 4 * count * layers, _DAMAGED)
        planes = np.frombuffer(payload, np.uint8, offset=at).reshape(layers, 4, count)
        words = np.ascontiguousarray(planes.transpose(0, 2, 1)).view("<i4")[..., 0]
    height, shape, *normal = (
        _floats(np.cumsum(words[k], dtype=np.int32)) for k in (0, 1, *range(3, layers))
    )
    with np.errstate(invalid="ignore", over="ignore"):
        ridge = _floats(_bits(height - shape) + words[2])
    sound = all(bool((np.abs(part) <= MAX_MM).all()) for part in (height, shape, ridge, *normal))
    require(sound, _DAMAGED)
    mask = np.zeros((rows, columns), dtype=bool)
    mask[top : top + high, left : left + wide] = inside.reshape(high, wide)
    normals = np.zeros((rows, columns, 3), dtype=np.float32)
    if normal:
        normals[mask] = np.stack(normal, axis=1)
    else:  # where the mask is, and beside it: they follow from neighbours
        box = slice(max(top - 1, 0), top + high + 1), slice(max(left - 1, 0), left + wide + 1)
        normals[box] = _normals(_placed(height, mask[box]), mask[box], pitch)
    return Surface(
        ridge_mm=_placed(ridge, mask),
        shape_mm=_placed(shape, mask),
        normals=normals,
        mask=mask,
        pitch_mm=pitch,
        input_from_upright=matrix,
        upright_size=upright_size,
        whole=kinds >= 2,
    )


def _normals(height_mm: FloatArray, mask: BoolArray, pitch_mm: float) -> FloatArray:
    """Normals (H, W, 3) of a surface under parallel rays, zero outside the mask."""
    seen = np.where(mask, height_mm, np.nan).astype(np.float32)
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


def _differences(values: FloatArray) -> NDArray[np.int32]:
    return np.diff(_bits(values), prepend=np.zeros(1, dtype=np.int32))
