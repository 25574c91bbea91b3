"""Triangles from a grid of pixels, and binary PLY files of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from splitknit.files import AnyPath
from splitknit.imaging.pixels import CHANNELS
from splitknit.io.atomic import atomic_file
from splitknit.model import BoolArray, FloatArray

_VERTEX = [("place", "<f4", (3,)), ("normal", "<f4", (3,)), ("quality", "<f4")]
_CHUNK = 1 << 16
"""Vertices or triangles that fit into a core's cache."""
_FACE = np.dtype([("count", "u1"), ("corners", "<i4", (3,))])


def triangulate(valid: BoolArray) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Triangles between the valid pixels of a grid (H, W) whose rows run down: counter-clockwise
    seen from +z.

    Four valid neighbours give two triangles, three give one. Returns faces (M, 3), and the index
    (H, W) of each pixel's vertex, -1 without: ``values[valid]`` are in the order of the vertices.
    """
    index: NDArray[np.int32] = np.full(valid.shape, -1, dtype=np.int32)
    index[valid] = np.arange(np.count_nonzero(valid), dtype=np.int32)
    bits = valid.view(np.uint8)
    known = bits[:-1, :-1] + bits[:-1, 1:] + bits[1:, :-1] + bits[1:, 1:]
    a = index[:-1, :-1][known == 4]  # a b of each square of four pixels
    c = index[1:, :-1][known == 4]  # c d
    halves = np.stack([a, c, a + 1, a + 1, c, c + 1], axis=1).reshape(-1, 3)
    around = (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:])
    three = np.stack([corner[known == 3] for corner in around], axis=1)
    return np.concatenate([halves, three[three >= 0].reshape(-1, 3)]), index


def write_ply(
    path: AnyPath,
    vertices: tuple[FloatArray, FloatArray, FloatArray],
    faces: NDArray[np.int32],
    comments: Sequence[str] = (),
    colours: NDArray[np.uint8] | None = None,
) -> None:
    """Write a surface as binary little-endian PLY (G. Turk, The PLY Polygon File Format, 1994).

    `vertices`: places (N, 3) in mm, unit normals (N, 3) and intensity (N,) from 0 (black) to 1
    (white), which MeshLab, CloudCompare and trimesh know as ``quality``; `faces`: (M, 3) indices of
    vertices, counter-clockwise seen from outside; `comments`: single lines of ASCII for the header
    (units, provenance); `colours`: (N, 3) red, green, blue in sRGB. Raises BadInput if the file
    cannot be written.
    """
    coloured = [] if colours is None else [("colour", "u1", (3,))]
    vertex = np.dtype([*_VERTEX, *coloured])
    header = [
        "ply",
        "format binary_little_endian 1.0",
        *(f"comment {text}" for text in comments),
        f"element vertex {len(vertices[0])}",
        *(f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz", "quality")),
        *(f"property uchar {name}" for name in CHANNELS if coloured),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header\n",
    ]
    with atomic_file(path) as stream:
        stream.write("\n".join(header).encode("ascii"))
        for start in range(0, len(vertices[0]), _CHUNK):
            place, normal, quality = (values[start : start + _CHUNK] for values in vertices)
            points = np.empty(len(place), dtype=vertex)
            points["place"], points["normal"], points["quality"] = place, normal, quality
            if colours is not None:
                points["colour"] = colours[start : start + _CHUNK]
            stream.write(points.data)
        for start in range(0, len(faces), _CHUNK):
            corners = faces[start : start + _CHUNK]
            triangles = np.empty(len(corners), dtype=_FACE)
            triangles["count"] = 3
            triangles["corners"] = corners
            stream.write(triangles.data)
