"""Binary STL of an indexed mesh, in pieces, so that millions of triangles need little memory.

STL knows no unit; the header says that it is the millimetre, which printing programs assume.
"""

from __future__ import annotations

import os
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.io.atomic import atomic_file
from splitknit.model import FloatArray

RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")])
"""One triangle of a binary file."""
HEADER_BYTES = 80
_CHUNK = 1 << 16


def stl_size(faces: int) -> int:
    """Bytes of a file of so many triangles."""
    return HEADER_BYTES + 4 + faces * RECORD.itemsize


def stl_chunks(vertices_mm: FloatArray, faces: NDArray[np.int32], title: str = "") -> Iterator[bytes]:
    """Yield the bytes of a file, in order.

    Parameters
    ----------
    vertices_mm : (N, 3), mm
    faces : (M, 3) indices of vertices, counter-clockwise seen from outside
    title : what the header says behind ``splitknit, unit mm``

    Raises
    ------
    BadInput
        If the shapes do not fit or a face refers to a vertex that is not there.
    """
    require(vertices_mm.ndim == 2 and vertices_mm.shape[1] == 3, f"vertices must be (N, 3), not {vertices_mm.shape}.")
    require(faces.ndim == 2 and faces.shape[1] == 3, f"faces must be (M, 3), not {faces.shape}.")
    fits = faces.size == 0 or (int(faces.min()) >= 0 and int(faces.max()) < len(vertices_mm))
    require(fits, f"faces refer to vertices that are not there (0 to {len(vertices_mm) - 1}).")
    return _chunks(np.asarray(vertices_mm, dtype=np.float32), faces, title)


def _chunks(vertices: FloatArray, faces: NDArray[np.int32], title: str) -> Iterator[bytes]:
    header = f"splitknit, unit mm {title}".encode("ascii", "replace")
    yield header[:HEADER_BYTES].ljust(HEADER_BYTES, b" ") + np.uint32(len(faces)).astype("<u4").tobytes()
    for start in range(0, len(faces), _CHUNK):
        corners = vertices[faces[start : start + _CHUNK]]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(across, axis=1, keepdims=True)
        records = np.zeros(len(corners), dtype=RECORD)
        records["normal"] = np.divide(across, length, out=np.zeros_like(across), where=length > 0)
        records["corners"] = corners
        yield records.tobytes()


def write_mesh_stl(
    path: str | os.PathLike[str], vertices_mm: FloatArray, faces: NDArray[np.int32], title: str = ""
) -> None:
    """Write what :func:`stl_chunks` yields; equal meshes give equal bytes."""
    chunks = stl_chunks(vertices_mm, faces, title)
    with atomic_file(path) as stream:
        for chunk in chunks:
            stream.write(chunk)
