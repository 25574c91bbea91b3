"""Comparison of minutiae in space after Kumar and Kwong: a reference pair aligns them, tolerances count them.

Level by level: pairs of neighbouring minutiae that look similar wherever they lie (their distance, and both directions
against the line between them) propose motions; those whose minutiae are proposed most often are tried on all minutiae;
the best are refined from all that agree. The score is that of the paper, the square of the number of agreeing minutiae
over the product of both sides' numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations, permutations
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import NDArray

from splitknit.matching.minutiae_record import SpaceMinutiae
from splitknit.matching.space_alignment import (
    AgreementSettings,
    Framed,
    Index,
    best_agreement,
    close_points,
    fraction_of_both,
    nearest,
    two_sides,
)
from splitknit.settings import Checked, Limits

if TYPE_CHECKING:
    import scipy.spatial

Array = NDArray[np.float64]


_LENGTH_MM = 0.25
"""Largest difference of the lengths of two pairs that are similar."""
_ANGLE_DEG = 15.0
"""Largest difference of their angles."""


@dataclass(frozen=True, slots=True)
class Minutiae3DSettings(Checked):
    """How minutiae in space are compared."""

    _group = "minutiae3d"
    neighbours: Annotated[int, Limits(1, 50)] = 6
    """Nearest minutiae with which each forms pairs."""
    agreement: AgreementSettings = field(default_factory=AgreementSettings)


@dataclass(frozen=True, slots=True)
class Minutiae3DMatch:
    """How similar two sets of minutiae in space are."""

    similarity: float
    """0 to 1: the square of `agreeing` over the product of both numbers of minutiae."""
    agreeing: int
    """Minutiae that agree one to one."""
    compared: bool
    """False where one side has fewer than ten minutiae."""


@dataclass(frozen=True, eq=False)
class PreparedMinutiae3D(Framed):
    """Minutiae in their own frame, and the pairs of neighbours among them."""

    settings: Minutiae3DSettings = field(default_factory=Minutiae3DSettings)

    @cached_property
    def pairs(self) -> Index:
        """(P, 2) each minutia and one of its nearest."""
        places = self.places[0]
        near, _ = nearest(places, min(self.settings.neighbours, len(places) - 1))
        return np.stack([np.repeat(np.arange(len(places)), near.shape[1]), near.ravel()], axis=1)

    @cached_property
    def looks(self) -> Array:
        """(P, 3) of each pair: length, and both azimuths against the line between them, radians."""
        places, directions = self.places
        first, second = self.pairs.T
        line = places[second] - places[first]
        ahead = np.arctan2(line[:, 1], line[:, 0])
        azimuth = np.arctan2(directions[:, 1], directions[:, 0])
        return np.stack([np.linalg.norm(line, axis=1), azimuth[first] - ahead, azimuth[second] - ahead], axis=1)

    @cached_property
    def tree(self) -> scipy.spatial.cKDTree:
        """The looks in units of the tolerances; azimuths go round."""
        import scipy.spatial  # a comparison of templates needs none of it

        angle = np.deg2rad(_ANGLE_DEG)
        scaled = self.looks / np.array([_LENGTH_MM, angle, angle])
        round_ = 2 * np.pi / angle
        scaled[:, 1:] %= round_
        scaled[:, 1:][scaled[:, 1:] >= round_] = 0.0
        return scipy.spatial.cKDTree(scaled, boxsize=np.array([1e6, round_, round_]))


def minutiae3d_match(
    a: SpaceMinutiae | PreparedMinutiae3D,
    b: SpaceMinutiae | PreparedMinutiae3D,
    settings: Minutiae3DSettings | None = None,
) -> Minutiae3DMatch:
    """Compare the minutiae in space of two fingers.

    Comparing A with B gives what B with A gives, and neither depends on how the fingers lie in space.

    Parameters
    ----------
    a, b : SpaceMinutiae or PreparedMinutiae3D
        Prepare a side that is compared more than once; then its settings must be those given here.
    settings : Minutiae3DSettings, optional

    References
    ----------
    A. Kumar and C. Kwong, "Towards contactless, low-cost and accurate 3D fingerprint identification", IEEE Trans. PAMI
    37(3), 2015: a reference minutia pair aligns two sets; minutiae match within tolerances of place, theta and phi; the
    score is m^2 / (M_P M_Q).
    """
    sides = two_sides(a, b, PreparedMinutiae3D, settings, Minutiae3DSettings())
    if sides is None:
        return Minutiae3DMatch(0.0, 0, compared=False)
    left, right = sides
    found = best_agreement(left, right, _similar_pairs(left, right), left.settings.agreement)
    count = len(found.a)
    return Minutiae3DMatch(fraction_of_both(count, left.minutiae.count, right.minutiae.count), count, compared=True)


def _similar_pairs(a: PreparedMinutiae3D, b: PreparedMinutiae3D) -> tuple[Index, Index]:
    """Correspondences (K, 2) of pairs that look similar."""
    i, j = close_points(a.tree, b.tree)
    return a.pairs[i], b.pairs[j]


# Comparison of minutiae in space after Lin and Kumar: tetrahedra of neighbouring minutiae, matched level by level.
#
# A tetrahedron is a minutia and three of its nearest. Level 1 compares six sorted edges of all tetrahedra, which is
# cheap and hardly misses: sorted lists of edges that are similar one by one stay similar. Level 2 finds which corner is
# which, and compares edges and the angles between each corner's direction and the edges from it. Level 3 lets what is
# left vote for corresponding minutiae; the tetrahedra whose corners have the most votes align the fingers. Level 4
# counts minutiae that agree. Nothing of the first two levels depends on how the finger lies.


_EDGES = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))
_ORDERS = np.array([(0, *rest) for rest in permutations((1, 2, 3))])
"""Permutations that lay the corners of one tetrahedron on another's, the apex on the apex."""


@dataclass(frozen=True, slots=True)
class TetrahedraSettings(Checked):
    """How minutiae in space are compared by tetrahedra."""

    neighbours: Annotated[int, Limits(3, 12)] = 5
    """Nearest minutiae; any three of them make a tetrahedron with the minutia."""
    edge_mm: Annotated[float, Limits(0, 5, above=True)] = 0.35
    """Largest difference of two edges that are similar."""
    angle_deg: Annotated[float, Limits(0, 90, above=True)] = 25.0
    """Largest difference of the angles between directions and edges."""
    agreement: AgreementSettings = field(default_factory=AgreementSettings)


@dataclass(frozen=True, slots=True)
class TetrahedraMatch:
    """How similar two sets of minutiae in space are."""

    similarity: float
    """0 to 1: the square of `agreeing` over the product of both numbers of minutiae."""
    agreeing: int
    """Minutiae that agree one to one."""
    tetrahedra: int
    """Pairs of tetrahedra that are similar in edges and angles."""
    compared: bool
    """False where one side has fewer than ten minutiae."""


@dataclass(frozen=True, eq=False)
class PreparedTetrahedra(Framed):
    """Minutiae in their own frame, and the tetrahedra among them."""

    settings: TetrahedraSettings = field(default_factory=TetrahedraSettings)

    @cached_property
    def corners(self) -> Index:
        """(T, 4) minutiae of each tetrahedron, its apex first; none with an edge below what is separated."""
        places = self.places[0]
        near, apart2 = nearest(places, self.settings.neighbours)
        triples = np.array(list(combinations(range(near.shape[1]), 3)), dtype=np.intp)
        others = near[:, triples].reshape(-1, 3)
        corners = np.column_stack([np.repeat(np.arange(len(places)), len(triples)), others])
        least = np.stack([apart2[corners[:, i], corners[:, j]] for i, j in _EDGES]).min(axis=0)
        kept: Index = corners[least >= self.settings.edge_mm**2]
        return kept

    @cached_property
    def edges(self) -> Array:
        """(T, 4, 4) distances between corners."""
        corner = self.places[0][self.corners]
        return np.asarray(np.linalg.norm(corner[:, :, None] - corner[:, None], axis=3))

    @cached_property
    def angles(self) -> Array:
        """(T, 4, 4) angle between the direction of each corner and the line to each other one; 0 to itself."""
        corner, ahead = self.places[0][self.corners], self.places[1][self.corners]
        line = corner[:, None] - corner[:, :, None]  # (T, from, to, 3)
        cosine = (line * ahead[:, :, None]).sum(axis=3) / np.maximum(self.edges, 1e-9)
        angle = np.arccos(np.clip(cosine, -1.0, 1.0))
        angle[:, np.arange(4), np.arange(4)] = 0.0
        return np.asarray(angle)

    @cached_property
    def ordered(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """(T, 6, 6) edges and (T, 6, 12) angles with the corners in each of the six orders."""
        first, second = np.array(_EDGES).T
        edges = np.stack([self.edges[:, order[first], order[second]] for order in _ORDERS], axis=1)
        start, end = np.array([(i, j) for i in range(4) for j in range(4) if i != j]).T
        angles = np.stack([self.angles[:, order[start], order[end]] for order in _ORDERS], axis=1)
        return edges.astype(np.float32), angles.astype(np.float32)

    @cached_property
    def looks(self) -> Array:
        """(T, 9) sorted: the edges from the apex, the other edges, and the apex's angles."""
        flat = np.stack([self.edges[:, i, j] for i, j in _EDGES], axis=1)
        parts = (flat[:, :3], flat[:, 3:], self.angles[:, 0, 1:])
        return np.concatenate([np.sort(part, axis=1) for part in parts], axis=1)

    @cached_property
    def tree(self) -> scipy.spatial.cKDTree:
        """The looks in units of the tolerances."""
        import scipy.spatial  # a comparison of templates needs none of it

        units = np.repeat([self.settings.edge_mm, self.settings.edge_mm, np.deg2rad(self.settings.angle_deg)], 3)
        return scipy.spatial.cKDTree(self.looks / units, leafsize=32)


def tetrahedra_match(
    a: SpaceMinutiae | PreparedTetrahedra,
    b: SpaceMinutiae | PreparedTetrahedra,
    settings: TetrahedraSettings | None = None,
) -> TetrahedraMatch:
    """Compare the minutiae in space of two fingers by their tetrahedra; as :func:`minutiae3d_match`.

    References
    ----------
    C. Lin and A. Kumar, "Tetrahedron based fast 3D fingerprint identification using colored LEDs illumination", IEEE
    Trans. PAMI 40(12), 2018. The accessible text of the paper lacks its tolerances: those here are chosen by us.
    """
    sides = two_sides(a, b, PreparedTetrahedra, settings, TetrahedraSettings())
    if sides is None:
        return TetrahedraMatch(0.0, 0, 0, compared=False)
    left, right = sides
    corners = _similar_tetrahedra(left, right)
    total = len(corners[0])
    found = best_agreement(left, right, corners, left.settings.agreement)
    count = len(found.a)
    score = fraction_of_both(count, left.minutiae.count, right.minutiae.count)
    return TetrahedraMatch(score, count, total, compared=True)


def _similar_tetrahedra(a: PreparedTetrahedra, b: PreparedTetrahedra) -> tuple[Index, Index]:
    """Corners (K, 4) of both sides' tetrahedra that are similar, each corner beside the one that it corresponds to.

    Where several orders of the corners are similar, the one with the smallest difference of angles is taken.
    """
    i, j = close_points(a.tree, b.tree)
    order, good = _best_order(a, b, i, j)
    i, j, order = i[good], j[good], order[good]
    return a.corners[i], np.take_along_axis(b.corners[j], _ORDERS[order], axis=1)


def _best_order(a: PreparedTetrahedra, b: PreparedTetrahedra, i: Index, j: Index) -> tuple[Index, NDArray[np.bool_]]:
    """Level 2: which order of the corners is similar in edges and angles, and whether any is."""
    edge, angle = a.settings.edge_mm, np.deg2rad(a.settings.angle_deg)
    own_edges, own_angles = (one[:, 0] for one in a.ordered)
    edges, angles = b.ordered
    k, order = np.nonzero((np.abs(own_edges[i][:, None] - edges[j]) <= edge).all(axis=2))
    difference = np.abs(own_angles[i[k]] - angles[j[k], order]).max(axis=1)
    all_of = np.full((len(i), len(_ORDERS)), np.inf)
    all_of[k, order] = difference
    best = all_of.argmin(axis=1)
    return best, all_of[np.arange(len(i)), best] <= angle
