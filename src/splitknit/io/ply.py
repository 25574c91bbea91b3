"""Binary PLY: vertices in mm with normals, quality as intensity.

``quality`` is the per-vertex scalar that MeshLab, CloudCompare and trimesh know by that name; here it is the albedo's
intensity from 0 (black) to 1 (white).

References
----------
G. Turk, The PLY Polygon File Format, 1994.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.io.atomic import atomic_file
from splitknit.model import FloatArray

_VERTEX = np.dtype([("place", "<f4", (3,)), ("normal", "<f4", (3,)), ("quality", "<f4")])
_FACE = np.dtype([("count", "u1"), ("corners", "<i4", (3,))])
_CHUNK = 1 << 16
_VERTEX_LINES = tuple(f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz", "quality"))
_FACE_LINES = ("property list uchar int vertex_indices",)
_MAX_BYTES = 700_000_000
"""A mesh of ten million vertices."""
_LONGEST_HEADER = 1_000_000


def write_ply(  # noqa: PLR0917 - a mesh is these arrays
    path: str | os.PathLike[str],
    vertices_mm: FloatArray,
    normals: FloatArray,
    intensity: NDArray[np.uint8] | FloatArray,
    faces: NDArray[np.int32] | None = None,
    comments: Sequence[str] = (),
) -> None:
    """Write a surface as binary little-endian PLY.

    Parameters
    ----------
    vertices_mm : (N, 3), mm
    normals : (N, 3), unit length
    intensity : (N,) uint8 in [0, 255], or float in [0, 1]; stored as the property ``quality`` in [0, 1]
    faces : (M, 3) indices of vertices, counter-clockwise seen from outside, or None for a cloud of points
    comments : single lines for the header (units, provenance)

    Raises
    ------
    BadInput
        If the shapes do not fit, a face refers to a vertex that is not there, a comment has more than one line, or the
        file cannot be written.
    """
    corners = np.zeros((0, 3), dtype=np.int32) if faces is None else np.asarray(faces)
    count = len(vertices_mm)
    shade: NDArray[Any] = np.asarray(intensity)
    require(np.shape(vertices_mm) == (count, 3), f"vertices_mm must be (N, 3), but it is {np.shape(vertices_mm)}.")
    require(np.shape(normals) == (count, 3), f"normals must be ({count}, 3), but it is {np.shape(normals)}.")
    require(shade.shape == (count,), f"intensity must be ({count},), but it is {shade.shape}.")
    require(corners.ndim == 2 and corners.shape[1] == 3, f"faces must be (M, 3), but it is {corners.shape}.")
    require(
        corners.size == 0 or (int(corners.min()) >= 0 and int(corners.max()) < count),
        f"faces refer to vertices that are not there (0 to {count - 1}).",
    )
    require(
        all(text.isascii() and text.isprintable() for text in comments),
        "a comment in a PLY file must be one line of printable ASCII.",
    )
    header = [
        "ply",
        "format binary_little_endian 1.0",
        *(f"comment {text}" for text in comments),
        f"element vertex {count}",
        *_VERTEX_LINES,
        f"element face {len(corners)}",
        *_FACE_LINES,
        "end_header",
    ]
    scale = np.float32(1.0 / 255.0) if shade.dtype == np.uint8 else np.float32(1.0)
    with atomic_file(path) as stream:
        stream.write(("\n".join(header) + "\n").encode("ascii"))
        buffer = np.empty(min(_CHUNK, count), dtype=_VERTEX)
        for start in range(0, count, _CHUNK):
            part = slice(start, min(start + _CHUNK, count))
            chunk = buffer[: part.stop - start]
            chunk["place"] = vertices_mm[part]
            chunk["normal"] = normals[part]
            chunk["quality"] = shade[part] * scale
            stream.write(chunk.data)
        _write_faces(stream, corners)


def _write_faces(stream: BinaryIO, corners: NDArray[Any]) -> None:
    buffer = np.empty(min(_CHUNK, len(corners)), dtype=_FACE)
    buffer["count"] = 3
    for start in range(0, len(corners), _CHUNK):
        part = corners[start : start + _CHUNK]
        buffer["corners"][: len(part)] = part
        stream.write(buffer[: len(part)].data)
