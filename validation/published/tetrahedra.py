"""Minutiae in space after Lin and Kumar: tetrahedra of neighbouring minutiae, matched level by
level.

    python validation/published/tetrahedra.py A B [--preset lin]
    python validation/published/tetrahedra.py PEOPLE --out scores.csv

C. Lin and A. Kumar, "Tetrahedron based fast 3D fingerprint identification using colored LEDs
illumination", IEEE Trans. PAMI 40(12), 2018; the accessible text lacks its tolerances: those here
are ours. A tetrahedron is a minutia and three of its nearest. Level 1 compares six sorted edges;
level 2 finds which corner is which, and compares edges and the angles between each corner's
direction and the edges from it. The rest is as in ``minutiae3d.py``.
"""

from __future__ import annotations

from functools import cached_property
from itertools import combinations, permutations

import numpy as np
from minutiae3d import Array, Framed, Index, close_points, framed, nearest, similarity
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scored import run

NEIGHBOURS = 5
"""Nearest minutiae; any three of them make a tetrahedron with the minutia."""
EDGE_MM = 0.35
"""Largest difference of edges."""
ANGLE_RAD = np.deg2rad(25.0)
"""Largest difference of angles between directions and edges."""
EDGES = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))
ORDERS = np.array([(0, *rest) for rest in permutations((1, 2, 3))])
"""Permutations that lay the corners of one tetrahedron on another's, the apex on the apex."""


class Tetrahedra(Framed):
    """Minutiae in their own frame, and the tetrahedra among them."""

    def correspondences(self, opposite: Tetrahedra) -> tuple[Index, Index]:
        """Corners (K, 4) of similar tetrahedra, each beside its own; of several orders that with
        the least angles."""
        i, j = close_points(self.tree, opposite.tree)
        own_edges, own_angles = (part[:, 0] for part in self.ordered)
        edges, angles = opposite.ordered
        k, order = np.nonzero((np.abs(own_edges[i][:, None] - edges[j]) <= EDGE_MM).all(axis=2))
        worst = np.full((len(i), len(ORDERS)), np.inf)
        worst[k, order] = np.abs(own_angles[i[k]] - angles[j[k], order]).max(axis=1)
        best = worst.argmin(axis=1)
        good = worst[np.arange(len(i)), best] <= ANGLE_RAD
        return self.corners[i[good]], np.take_along_axis(
            opposite.corners[j[good]], ORDERS[best[good]], axis=1
        )

    @cached_property
    def corners(self) -> Index:
        """(T, 4) minutiae of each tetrahedron, its apex first; none with an edge below what is
        separated."""
        places = self.places[0]
        near, apart2 = nearest(places, NEIGHBOURS)
        triples = np.array(list(combinations(range(near.shape[1]), 3)), dtype=np.intp)
        corners = np.column_stack(
            [np.repeat(np.arange(len(places)), len(triples)), near[:, triples].reshape(-1, 3)]
        )
        least = np.stack([apart2[corners[:, i], corners[:, j]] for i, j in EDGES]).min(axis=0)
        return corners[least >= EDGE_MM**2]

    @cached_property
    def edges(self) -> Array:
        """(T, 4, 4) distances between corners."""
        corner = self.places[0][self.corners]
        return np.asarray(np.linalg.norm(corner[:, :, None] - corner[:, None], axis=3))

    @cached_property
    def angles(self) -> Array:
        """(T, 4, 4) angle between the direction of each corner and the line to each other one; 0 to
        itself."""
        corner, ahead = self.places[0][self.corners], self.places[1][self.corners]
        line = corner[:, None] - corner[:, :, None]  # (T, from, to, 3)
        angle = np.arccos(
            np.clip(
                (line * ahead[:, :, None]).sum(axis=3) / np.maximum(self.edges, 1e-9), -1.0, 1.0
            )
        )
        angle[:, np.arange(4), np.arange(4)] = 0.0
        return np.asarray(angle)

    @cached_property
    def ordered(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(T, 6, 6) edges and (T, 6, 12) angles with the corners in each of the six orders."""
        first, second = np.array(EDGES).T
        start, end = np.array([(i, j) for i in range(4) for j in range(4) if i != j]).T
        edges = np.stack([self.edges[:, order[first], order[second]] for order in ORDERS], axis=1)
        angles = np.stack([self.angles[:, order[start], order[end]] for order in ORDERS], axis=1)
        return edges.astype(np.float32), angles.astype(np.float32)

    @cached_property
    def tree(self) -> cKDTree:
        """Sorted edges from the apex, other edges and the apex's angles, in units of the
        tolerances."""
        flat = np.stack([self.edges[:, i, j] for i, j in EDGES], axis=1)
        parts = (flat[:, :3], flat[:, 3:], self.angles[:, 0, 1:])
        looks = np.concatenate([np.sort(part, axis=1) for part in parts], axis=1)
        return cKDTree(looks / np.repeat([EDGE_MM, EDGE_MM, ANGLE_RAD], 3), leafsize=32)


if __name__ == "__main__":
    raise SystemExit(
        run(lambda finger, preset: framed(Tetrahedra, finger, preset), similarity, "lin")
    )
