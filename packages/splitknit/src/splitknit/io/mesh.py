"""Triangles from a grid of pixels, and binary PLY files of them, in pieces, so that millions need little memory."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.io.atomic import atomic_file
from splitknit.model import BoolArray, FloatArray


def surface_mesh(
    x_mm: FloatArray, y_mm: FloatArray, z_mm: FloatArray, mask: BoolArray | None = None
) -> tuple[FloatArray, NDArray[np.int32], NDArray[np.int32]]:
    """Triangulate a surface given on a pixel grid; y runs up against the rows, x right along the columns.

    Four valid neighbours give two triangles, three give one. Triangles run counter-clockwise seen from +z. Returns
    vertices (N, 3) float32, mm, in the order of the rows; faces (M, 3) int32; index (H, W) int32 of each pixel's
    vertex, -1 without: ``values[index >= 0]`` are in the order of the vertices. `x_mm, y_mm`: (H, W), or broadcastable
    to it such as (W,) and (H, 1); `z_mm`: (H, W), NaN where there is no surface; `mask`: (H, W) bool, or None for
    everywhere; pixels whose z is not finite are left out in any case.
    """
    valid = np.isfinite(z_mm) if mask is None else np.isfinite(z_mm) & mask
    index, _, pieces = triangulate(valid)
    places = [np.broadcast_to(values, valid.shape)[valid] for values in (x_mm, y_mm, z_mm)]
    return np.stack(places, axis=1).astype(np.float32), np.concatenate(list(pieces)), index


def triangulate(valid: BoolArray) -> tuple[NDArray[np.int32], int, Iterator[NDArray[np.int32]]]:
    """Triangulate pixels (H, W) as :func:`surface_mesh`: index (H, W) int32, -1 without; the number of triangles;
    pieces of them, (m, 3) int32: of whole squares, then of three pixels.
    """
    index: NDArray[np.int32] = np.full(valid.shape, -1, dtype=np.int32)
    index[valid] = np.arange(np.count_nonzero(valid), dtype=np.int32)
    ones = valid.view(np.uint8)
    known = ones[:-1, :-1] + ones[:-1, 1:] + ones[1:, :-1] + ones[1:, 1:]
    whole = known == 4
    three = known == 3
    return index, int(2 * np.count_nonzero(whole) + np.count_nonzero(three)), _pieces(index, whole, three)


def _pieces(index: NDArray[np.int32], whole: BoolArray, three: BoolArray) -> Iterator[NDArray[np.int32]]:
    for band in bands(whole.shape):
        a = index[band][:, :-1][whole[band]]  # a b   of each square of four pixels
        c = index[band.start + 1 : band.stop + 1, :-1][whole[band]]  #   c d
        faces = np.empty((len(a), 2, 3), dtype=np.int32)
        faces[:, 0, 0], faces[:, 0, 1] = a, c
        faces[:, 0, 2] = faces[:, 1, 0] = a + 1
        faces[:, 1, 1], faces[:, 1, 2] = c, c + 1
        yield faces.reshape(-1, 3)
    row, column = np.nonzero(three)
    around = (row, column), (row + 1, column), (row + 1, column + 1), (row, column + 1)  # counter-clockwise
    corners = np.stack([index[place] for place in around], axis=1)
    yield corners[corners >= 0].reshape(-1, 3)


def bands(shape: tuple[int, ...]) -> Iterator[slice]:
    """Rows of a grid (H, W), some ten thousand pixels at a time."""
    step = max(1, _CHUNK // max(1, shape[1]))
    return (slice(start, min(start + step, shape[0])) for start in range(0, shape[0], step))


_CHUNK = 1 << 16


# Binary PLY: vertices in mm with normals, quality as intensity.
#
# ``quality`` is the per-vertex scalar that MeshLab, CloudCompare and trimesh know by that name; here it is the albedo's
# intensity from 0 (black) to 1 (white).
#
# Source: G. Turk, The PLY Polygon File Format, 1994.

_VERTEX = np.dtype([("place", "<f4", (3,)), ("normal", "<f4", (3,)), ("quality", "<f4")])
_FACE = np.dtype([("count", "u1"), ("corners", "<i4", (3,))])


def write_ply(
    path: str | os.PathLike[str],
    vertices: tuple[FloatArray, FloatArray, FloatArray],
    faces: NDArray[np.int32],
    comments: Sequence[str] = (),
) -> None:
    """Write a surface as binary little-endian PLY.

    `vertices`: places (N, 3) in mm, unit normals (N, 3) and the property ``quality`` (N,) in [0, 1]; `faces`: (M, 3)
    indices of vertices, counter-clockwise seen from outside; `comments`: single lines of ASCII for the header (units,
    provenance). Raises BadInput if the file cannot be written.
    """
    write_ply_pieces(path, (len(vertices[0]), [vertices]), (len(faces), [faces]), comments)


def write_ply_pieces(
    path: str | os.PathLike[str],
    vertices: tuple[int, Iterable[tuple[FloatArray, FloatArray, FloatArray]]],
    faces: tuple[int, Iterable[NDArray[Any]]],
    comments: Sequence[str],
) -> None:
    """Write what :func:`write_ply` writes. `vertices`: how many, and pieces of them; `faces`: the same."""
    header = [
        "ply",
        "format binary_little_endian 1.0",
        *(f"comment {text}" for text in comments),
        f"element vertex {vertices[0]}",
        *(f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz", "quality")),
        f"element face {faces[0]}",
        "property list uchar int vertex_indices",
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
