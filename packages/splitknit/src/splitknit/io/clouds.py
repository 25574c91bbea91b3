"""Point clouds and vertices of meshes of other scanners, read by trimesh: PLY, XYZ, OBJ, STL."""

from __future__ import annotations

import io
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import importing, read_bytes, refusing, require
from splitknit.model import FloatArray

CLOUDS = (".ply", ".xyz", ".obj", ".stl")
"""Suffixes of :func:`read_cloud`."""
NEEDS_TRIMESH = "Meshes and point clouds need the package trimesh: pip install 'splitknit[mesh]' ({error})."
UNITS_MM = {"um": 1e-3, "mm": 1.0, "cm": 10.0, "in": 25.4, "m": 1000.0}
_MAX_POINTS, _MAX_BYTES = 40_000_000, 1_000_000_000
_FAR_MM = 500.0  # a cloud that begins further from the origin is moved there: single precision would not do
_COARSEST_MM = 0.01  # steps of coordinates that are fine enough for ridges: 100 m from the origin in single precision
_BRIGHT = ("quality", "intensity", "scalar_intensity", "green")
_NORMAL = ("nx", "ny", "nz")


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """Points of a surface, in mm."""

    points_mm: FloatArray
    """(N, 3)."""
    kind: str
    """Such as ``PLY``."""
    normals: FloatArray | None = None
    """(N, 3), towards the outside."""
    quality: FloatArray | None = None
    """(N,) brightness of the surface, in any unit."""
    notes: tuple[str, ...] = ()


def read_cloud(path: str | os.PathLike[str], unit: str | None = None) -> Cloud:
    """Read a point cloud, or the vertices of a mesh; its suffix, of :data:`CLOUDS`, shows which.

    `unit`: of the coordinates, a key of :data:`UNITS_MM`, mm by default. Normals and brightness are read of PLY. Raises
    BadInput if the file is damaged, of another kind or too large, or trimesh is not installed.

    >>> read_cloud("finger.ply").points_mm.shape  # doctest: +SKIP
    (412345, 3)
    """
    name, suffix = os.fspath(path), Path(path).suffix.lower()
    require(suffix in CLOUDS, f"{name} is not a point cloud; its suffix must be one of {', '.join(CLOUDS)}.")
    with importing(NEEDS_TRIMESH):
        import trimesh
    kind = suffix[1:].upper()
    damaged = f"{name} cannot be read as {kind}: it is damaged or of another format; write it again."
    data = read_bytes(path, _MAX_BYTES)
    with refusing(damaged):  # bytes without a name: no other file is opened, whatever it refers to
        read: Any = trimesh.load(io.BytesIO(data), file_type=suffix[1:], process=False, maintain_order=True)
        vertices = np.asarray(getattr(read, "vertices", np.zeros((0, 3))), dtype=np.float64)
        columns: Any = read.metadata.get("_ply_raw", {}).get("vertex", {}).get("data", {})
        named = columns.keys() if isinstance(columns, dict) else columns.dtype.names
        values = {key: np.asarray(columns[key], np.float32).reshape(-1) for key in named if key in (*_NORMAL, *_BRIGHT)}
    require(len(vertices) <= _MAX_POINTS, f"{name} has more than {_MAX_POINTS} points; reduce them.")
    if suffix == ".stl":  # each corner once, in the order in which they come first
        vertices = vertices[np.sort(np.unique(vertices, axis=0, return_index=True)[1])]
    points = vertices * UNITS_MM[unit or "mm"]
    known = np.isfinite(points).all(axis=1) & (np.abs(points).max(axis=1, initial=0.0) < 1e9)
    require(bool(known.any()), f"{name} holds no point.")
    points[~known] = np.nan
    first = points[int(np.argmax(known))]
    apart = float(np.spacing(np.float32(np.abs(first).max())))
    single = bool((vertices[known] == vertices[known].astype(np.float32)).all())
    far = f"{name}: its points lie {np.abs(first).max() / 1000:.3g} m from the origin, where coordinates in single "
    fine = f"precision are {apart:.2g} mm apart; move the cloud to the origin and export it again."
    require(not single or apart <= _COARSEST_MM, far + fine)
    origin: NDArray[np.float64] = first.round() * (np.abs(first).max() > _FAR_MM)
    notes = ("its coordinates were moved to the origin.",) if origin.any() else ()
    normals = np.stack([values[key] for key in _NORMAL], axis=1) if set(_NORMAL) <= values.keys() else None
    quality = next((values[key] for key in _BRIGHT if key in values), None)
    return Cloud((points - origin).astype(np.float32), kind, normals, quality, notes)
