"""Checks of a closed triangle mesh: watertight, volume, thinnest wall.

They look at the triangles as they were written to the STL file, not at the solid they came from.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.rig.rays import first_hits
from splitknit.rig.stl import Triangles, unit_normals

_REACH_MM = 8.0
"""Walls thicker than this are not looked at."""


@dataclass(frozen=True, slots=True)
class Soundness:
    """Whether a mesh bounds a body."""

    triangles: int
    edges: int
    open_edges: int
    """Edges that do not lie between exactly two triangles."""
    turned_edges: int
    """Edges along which two triangles run the same way: one of them is inside out."""
    flat_triangles: int
    """Triangles without area."""
    volume_mm3: float
    area_mm2: float

    @property
    def watertight(self) -> bool:
        """Closed, all triangles turned the same way, and outwards."""
        return self.triangles > 0 and self.open_edges == 0 and self.turned_edges == 0 and self.volume_mm3 > 0


def check_soundness(triangles: Triangles) -> Soundness:
    """Count edges and measure the volume.

    Parameters
    ----------
    triangles : (N, 3, 3) float32, mm
        Corners are the same point if their numbers are the same.
    """
    corners = np.asarray(triangles, dtype=np.float32)
    require(corners.ndim == 3 and corners.shape[1:] == (3, 3), f"triangles must be (N, 3, 3), not {corners.shape}.")
    _, index = np.unique(corners.reshape(-1, 3) + np.float32(0.0), axis=0, return_inverse=True)
    faces = index.reshape(-1, 3).astype(np.int64)
    starts = faces.ravel()
    ends = np.roll(faces, -1, axis=1).ravel()
    low, high = np.minimum(starts, ends), np.maximum(starts, ends)
    count = int(faces.max()) + 1 if faces.size else 0
    keys, uses = np.unique(low * count + high, return_counts=True)
    ways = np.unique(starts * count + ends, return_counts=True)[1]
    exact = corners.astype(np.float64)
    cross = np.cross(exact[:, 1] - exact[:, 0], exact[:, 2] - exact[:, 0])
    return Soundness(
        triangles=len(corners),
        edges=len(keys),
        open_edges=int((uses != 2).sum()),
        turned_edges=int((ways > 1).sum()),
        flat_triangles=int((np.linalg.norm(cross, axis=1) < 1e-9).sum()),
        volume_mm3=float(np.einsum("ij,ij->", exact[:, 0], cross) / 6.0),
        area_mm2=float(np.linalg.norm(cross, axis=1).sum() / 2.0),
    )


@dataclass(frozen=True, slots=True, eq=False)
class Wall:
    """The thinnest place that was found."""

    thickness_mm: float
    """8 where no wall is thinner than that."""
    place_mm: NDArray[np.float64]
    """(3,) on the surface."""
    samples: int


def thinnest_wall(triangles: Triangles, samples: int = 4000, seed: int = 0) -> Wall:
    """Measure the thickness from points on the surface straight inwards to the opposite face.

    Only faces that look away from each other within 25 deg count: towards a sharp edge every body becomes thin, and
    that is no wall.

    Parameters
    ----------
    triangles : (N, 3, 3), a closed mesh, mm
    samples : points on the surface, drawn in proportion to the area; every triangle has one at least
    seed : of the drawing
    """
    corners = np.asarray(triangles, dtype=np.float64)
    normals = unit_normals(triangles)
    points, faces = _surface_points(corners, samples, seed)
    inwards = -normals[faces]
    distance, hit = first_hits(corners, points + 1e-4 * inwards, inwards, _REACH_MM)
    met = (hit >= 0) & (np.einsum("ij,ij->i", normals[faces], normals[np.maximum(hit, 0)]) < -np.cos(np.deg2rad(25)))
    if not bool(met.any()):
        return Wall(_REACH_MM, points[0], len(points))
    thickness = np.where(met, distance, np.inf)
    thinnest = int(np.argmin(thickness))
    return Wall(float(thickness[thinnest]) + 1e-4, points[thinnest], len(points))


def _surface_points(
    corners: NDArray[np.float64], samples: int, seed: int
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    rng = np.random.default_rng(seed)
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    sound = np.flatnonzero(areas > 1e-6)
    drawn = rng.choice(len(corners), size=samples, p=areas / areas.sum())
    faces = np.concatenate([sound, drawn])
    weights = rng.dirichlet((1.0, 1.0, 1.0), size=len(faces))
    weights[: len(sound)] = 1.0 / 3.0
    return np.einsum("ij,ijk->ik", weights, corners[faces]), faces.astype(np.int64)
