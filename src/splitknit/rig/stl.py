"""STL files: binary ones are written, binary and text ones read."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import read_bytes, require
from splitknit.io.atomic import atomic_file
from splitknit.io.mesh import HEADER_BYTES, RECORD

Triangles = NDArray[np.float32]
"""(N, 3, 3): corners of each triangle, counter-clockwise seen from outside; x, y, z in mm."""
_MAX_BYTES = 700_000_000
"""A mesh of fourteen million triangles."""
_MAX_TEXT_BYTES = 50_000_000
"""Read line by line, at ten times the memory."""


def write_stl(path: str | os.PathLike[str], triangles: Triangles, title: str = "") -> None:
    """Write a binary STL file; equal triangles give equal bytes."""
    corners = np.asarray(triangles, dtype=np.float32)
    require(corners.ndim == 3 and corners.shape[1:] == (3, 3), f"triangles must be (N, 3, 3), not {corners.shape}.")
    records = np.zeros(len(corners), dtype=RECORD)
    records["corners"] = corners
    records["normal"] = unit_normals(corners)
    header = f"splitknit {title}".encode("ascii", "replace")[:HEADER_BYTES].ljust(HEADER_BYTES, b" ")
    with atomic_file(path) as stream:
        stream.write(header)
        stream.write(np.uint32(len(corners)).astype("<u4").tobytes())
        stream.write(records.tobytes())


def read_stl(path: str | os.PathLike[str]) -> Triangles:
    """Read an STL file, binary or text.

    Raises
    ------
    BadInput
        If the file cannot be read or is not STL.
    """
    data = read_bytes(path, _MAX_BYTES)
    if len(data) >= HEADER_BYTES + 4:
        count = int(np.frombuffer(data, dtype="<u4", count=1, offset=HEADER_BYTES)[0])
        if len(data) == HEADER_BYTES + 4 + count * RECORD.itemsize:
            records = np.frombuffer(data, dtype=RECORD, offset=HEADER_BYTES + 4)
            corners = np.array(records["corners"], dtype=np.float32)
            require(bool(np.isfinite(corners).all()), f"'{path}' holds corners that are not numbers.")
            return corners
    require(data.lstrip().startswith(b"solid"), f"'{path}' is not an STL file, or it is cut short.")
    require(len(data) <= _MAX_TEXT_BYTES, f"'{path}' is a long text file; save it as binary STL.")
    return _text(data, str(path))


def _text(data: bytes, name: str) -> Triangles:
    rows: list[Any] = [line.split()[1:] for line in data.splitlines() if line.strip().startswith(b"vertex")]
    try:
        corners = np.array(rows, dtype=np.float32)
    except ValueError:
        corners = np.empty((0, 0), dtype=np.float32)
    sound = (
        len(rows) > 0 and corners.shape == (len(rows), 3) and len(rows) % 3 == 0 and bool(np.isfinite(corners).all())
    )
    require(sound, f"'{name}' is not a sound STL file: its vertices do not make triangles.")
    return corners.reshape(-1, 3, 3)


def unit_normals(triangles: Triangles) -> NDArray[np.float64]:
    """Return (N, 3) unit normals of triangles; zero where a triangle has no area."""
    corners = np.asarray(triangles, dtype=np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0))
