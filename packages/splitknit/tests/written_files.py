"""Readers, for tests alone, of what splitknit writes and never reads: meshes as PLY and STL, floats
as TIFF."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import tifffile
from numpy.testing import assert_array_equal
from PIL import Image

VERTEX = [("place", "<f4", 3), ("normal", "<f4", 3), ("quality", "<f4")]
FACE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])


class Ply(NamedTuple):
    vertices_mm: np.ndarray
    normals: np.ndarray
    quality: np.ndarray
    faces: np.ndarray
    comments: tuple[str, ...]
    colours: np.ndarray | None


def read_ply(path: Path) -> Ply:
    """Vertices with normals, a quality and perhaps colours, and triangles, binary and
    little-endian."""
    header, body = path.read_bytes().split(b"end_header\n", 1)
    lines = header.decode("ascii").splitlines()
    comments = tuple(line.removeprefix("comment ") for line in lines if line.startswith("comment "))
    layout = [line for line in lines if not line.startswith("comment ")]
    vertices, faces = (int(line.split()[-1]) for line in layout if line.startswith("element "))
    names = ("x", "y", "z", "nx", "ny", "nz", "quality")
    coloured = "property uchar red" in layout
    vertex = np.dtype([*VERTEX, *([("colour", "u1", 3)] if coloured else [])])
    assert layout == [
        "ply",
        "format binary_little_endian 1.0",
        f"element vertex {vertices}",
        *(f"property float {name}" for name in names),
        *(f"property uchar {name}" for name in ("red", "green", "blue") if coloured),
        f"element face {faces}",
        "property list uchar int vertex_indices",
    ]
    assert len(body) == vertices * vertex.itemsize + faces * FACE.itemsize
    points = np.frombuffer(body, vertex, vertices)
    corners = np.frombuffer(body, FACE, faces, vertices * vertex.itemsize)
    assert (corners["count"] == 3).all()
    colours = points["colour"] if coloured else None
    return Ply(
        points["place"], points["normal"], points["quality"], corners["corners"], comments, colours
    )


def read_stl(path: Path) -> np.ndarray:
    """(N, 3, 3) corners of the triangles of a binary file."""
    data = path.read_bytes()
    triangle = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")])
    (count,) = struct.unpack_from("<I", data, 80)
    assert len(data) == 84 + count * triangle.itemsize
    return np.frombuffer(data, triangle, count, 84)["corners"].copy()


def read_light_tiff(path: Path) -> tuple[np.ndarray, dict[str, Any]]:
    """The floats of one page, as every reader has them, and what its description tells."""
    with tifffile.TiffFile(path) as file:
        description = json.loads(file.pages[0].description)
    values = read_by_all(path)
    assert values.dtype == np.float32
    return values, description


def read_by_all(path: Path) -> np.ndarray:
    """The picture of a TIFF file, by the readers that people use, which must agree."""
    import imageio.v3  # of scikit-image, which other packages' tests lack
    import skimage.io

    values = tifffile.imread(path)
    assert_array_equal(imageio.v3.imread(path), values)
    assert_array_equal(skimage.io.imread(path), values)
    if values.ndim == 2 or values.dtype == np.uint8:  # Pillow has no other colours
        with Image.open(path) as picture:
            assert_array_equal(np.asarray(picture), values)
    colours = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert_array_equal(colours if values.ndim == 2 else colours[..., ::-1], values)
    return values


def read_height_tiff(path: Path) -> tuple[np.ndarray, float, dict[str, Any]]:
    """A height map, its pitch, and all of its description."""
    height, metadata = read_light_tiff(path)
    assert height.ndim == 2 and metadata["unit"] == "mm"
    return height, metadata["pitch_mm"], metadata
