"""Triangles from a grid of pixels, and files of them: STL and PLY, in pieces."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import refusing, require
from splitknit.io.atomic import atomic_file
from splitknit.model import BoolArray, FloatArray


def surface_mesh(
    x_mm: FloatArray, y_mm: FloatArray, z_mm: FloatArray, mask: BoolArray | None = None
) -> tuple[FloatArray, NDArray[np.int32], NDArray[np.int32]]:
    """Triangulate a surface given on a pixel grid; y runs up against the rows, x right along the columns.

    Four valid neighbours give two triangles, three give one. Triangles run counter-clockwise seen from +z. Returns
    vertices (N, 3) float32, mm, in the order of the rows; faces (M, 3) int32; index (H, W) int32 of each pixel's
    vertex, -1 without: ``values[index >= 0]`` are in the order of the vertices. Raises BadInput if the shapes do not
    fit. `x_mm, y_mm`: (H, W), or broadcastable to it such as (W,) and (H, 1); `z_mm`: (H, W), NaN where there is no
    surface; `mask`: (H, W) bool, or None for everywhere; pixels whose z is not finite are left out in any case.
    """
    z_mm = np.asarray(z_mm, dtype=np.float32)
    require(z_mm.ndim == 2, f"z_mm must be (H, W), but it is {z_mm.shape}.")
    valid = np.isfinite(z_mm)
    if mask is not None:
        require(np.shape(mask) == z_mm.shape, f"mask must be {z_mm.shape}, but it is {np.shape(mask)}.")
        valid &= np.asarray(mask, dtype=np.bool_)
    index, _, pieces = triangulate(valid)
    vertices = np.empty((np.count_nonzero(valid), 3), dtype=np.float32)
    for axis, values in enumerate((x_mm, y_mm, z_mm)):
        with refusing(f"{'xyz'[axis]}_mm {np.shape(values)} does not fit z_mm {z_mm.shape}."):
            vertices[:, axis] = np.broadcast_to(np.asarray(values), z_mm.shape)[valid]
    return vertices, np.concatenate(list(pieces)), index


def triangulate(valid: BoolArray) -> tuple[NDArray[np.int32], int, Iterator[NDArray[np.int32]]]:
    """Triangulate pixels (H, W) as :func:`surface_mesh`: index (H, W) int32, -1 without; the number of triangles;
    pieces of them, (m, 3) int32: of whole squares, then of three pixels.
    """
    index: NDArray[np.int32] = np.full(valid.shape, -1, dtype=np.int32)
    index[valid] = np.arange(np.count_nonzero(valid), dtype=np.int32)
    ones = valid.view(np.uint8)
    known = ones[:-1, :-1] + ones[:-1, 1:] + ones[1:, :-1] + ones[1:, 1:]
    whole, three = known == 4, known == 3
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


# Binary STL of an indexed mesh, in pieces, so that millions of triangles need little memory.
#
# STL knows no unit; the header states that it is the millimetre, which printing programs assume.

_RECORD = np.dtype(
    [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")]
)  # one triangle of a binary file
_HEADER_BYTES = 80
_CHUNK = 1 << 16


def check_mesh(
    vertices_mm: FloatArray, faces: NDArray[Any], normals: Any = None, intensity: NDArray[Any] | None = None
) -> None:
    """Raise BadInput if the arrays of a mesh do not fit, or a face refers to a vertex that is not there."""
    count = len(vertices_mm)
    shapes = {"vertices_mm": (count, 3), "faces": (len(faces), 3), "normals": (count, 3), "intensity": (count,)}
    for array, (name, shape) in zip((vertices_mm, faces, normals, intensity), shapes.items(), strict=True):
        fits = array is None or np.shape(array) == shape
        require(fits, f"{name} must have the shape {shape}, but it has {np.shape(array)}.")
    fits = faces.size == 0 or (int(faces.min()) >= 0 and int(faces.max()) < count)
    require(fits, f"faces refer to vertices that are not there (0 to {count - 1}).")


def stl_chunks(vertices_mm: FloatArray, faces: NDArray[np.int32], title: str = "") -> Iterator[bytes]:
    """The bytes of a file, in order, of `vertices_mm` (N, 3) and `faces` (M, 3), counter-clockwise seen from outside;
    `title`: in the header behind ``splitknit, unit mm``. Raises BadInput if shapes or faces do not fit.
    """
    check_mesh(vertices_mm, faces)
    vertices = np.asarray(vertices_mm, dtype=np.float32)
    header = f"splitknit, unit mm {title}".encode("ascii", "replace")
    yield header[:_HEADER_BYTES].ljust(_HEADER_BYTES, b" ") + np.uint32(len(faces)).astype("<u4").tobytes()
    for start in range(0, len(faces), _CHUNK):
        corners = vertices[faces[start : start + _CHUNK]]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(across, axis=1, keepdims=True)
        records = np.zeros(len(corners), dtype=_RECORD)
        records["normal"] = np.divide(across, length, out=np.zeros_like(across), where=length > 0)
        records["corners"] = corners
        yield records.tobytes()


# Binary PLY: vertices in mm with normals, quality as intensity.
#
# ``quality`` is the per-vertex scalar that MeshLab, CloudCompare and trimesh know by that name; here it is the albedo's
# intensity from 0 (black) to 1 (white).
#
# Source: G. Turk, The PLY Polygon File Format, 1994.

_VERTEX = np.dtype([("place", "<f4", (3,)), ("normal", "<f4", (3,)), ("quality", "<f4")])
_FACE = np.dtype([("count", "u1"), ("corners", "<i4", (3,))])


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
    check_mesh(vertices_mm, corners, normals, shade)
    plain = all(text.isascii() and text.isprintable() for text in comments)
    require(plain, "a comment in a PLY file must be one line of printable ASCII.")
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
    """Write what :func:`write_ply` writes. `vertices`: how many, and pieces of them: places (n, 3) in mm, normals (n,
    3), intensity (n,) in [0, 1]; `faces`: how many, and pieces (m, 3). Raises BadInput on writing.
    """
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
