"""Binary PLY: vertices in mm with normals, quality as intensity.

``quality`` is the per-vertex scalar that MeshLab, CloudCompare and trimesh know by that name; here it is the albedo's
intensity from 0 (black) to 1 (white).

Source: G. Turk, The PLY Polygon File Format, 1994.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from typing import Any

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

    `vertices_mm`: (N, 3), mm; `normals`: (N, 3), unit length; `intensity`: (N,) uint8, or float in [0, 1], stored as
    the property ``quality`` in [0, 1]; `faces`: (M, 3) indices of vertices, counter-clockwise seen from outside, or
    None for a cloud of points; `comments`: single lines for the header (units, provenance). Raises BadInput if the
    shapes do not fit, a face refers to a vertex that is not there, a comment has several lines, or the file cannot be
    written.
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
    scale = np.float32(1.0 / 255.0) if shade.dtype == np.uint8 else np.float32(1.0)
    parts = [slice(start, start + _CHUNK) for start in range(0, count, _CHUNK)]
    points = ((vertices_mm[part], normals[part], shade[part] * scale) for part in parts)
    faces_in_parts = (corners[start : start + _CHUNK] for start in range(0, len(corners), _CHUNK))
    write_ply_pieces(path, (count, points), (len(corners), faces_in_parts), comments)


def write_ply_pieces(
    path: str | os.PathLike[str],
    vertices: tuple[int, Iterable[tuple[FloatArray, FloatArray, FloatArray]]],
    faces: tuple[int, Iterable[NDArray[Any]]],
    comments: Sequence[str],
) -> None:
    """Write what :func:`write_ply` writes, piece by piece. `vertices`: how many there are, and pieces of them: places
    (n, 3) in mm, normals (n, 3) and intensity (n,) in [0, 1]; `faces`: how many there are, and pieces of them, (m, 3).
    Raises BadInput if the file cannot be written.
    """
    header = [
        "ply",
        "format binary_little_endian 1.0",
        *(f"comment {text}" for text in comments),
        f"element vertex {vertices[0]}",
        *_VERTEX_LINES,
        f"element face {faces[0]}",
        *_FACE_LINES,
        "end_header",
    ]
    with atomic_file(path) as stream:
        stream.write(("\n".join(header) + "\n").encode("ascii"))
        for place, normal, quality in vertices[1]:
            points = np.empty(len(place), dtype=_VERTEX)
            points["place"], points["normal"], points["quality"] = place, normal, quality
            stream.write(points.data)
        for corners in faces[1]:
            triangles = np.empty(len(corners), dtype=_FACE)
            triangles["count"], triangles["corners"] = 3, corners
            stream.write(triangles.data)
