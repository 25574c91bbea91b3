"""Comparison of minutiae in space after Kumar and Kwong: a reference pair aligns them, tolerances count them.

Level by level: pairs of neighbouring minutiae that look similar wherever they lie (their distance, and both directions
against the line between them) propose motions; those whose minutiae are proposed most often are tried on all minutiae;
the best are refined from all that agree. The score is that of the paper, the square of the number of agreeing minutiae
over the product of both sides' numbers.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from functools import cached_property
from itertools import combinations, permutations
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from numpy.typing import NDArray

from splitknit import Checked, Limits
from splitknit_match.matching.minutiae_record import SpaceMinutiae, pack_space_minutiae
from splitknit_match.matching.score import prepared_sides

if TYPE_CHECKING:
    import scipy.spatial

Array = NDArray[np.float64]
Index = NDArray[np.intp]

# Minutiae in space laid on each other by a rigid motion, and those counted that then agree. Each matcher proposes
# correspondences of a few minutiae; the motions that follow from them are tried, the best are refined, and agreeing
# minutiae are paired one to one.

_HEIGHT_MM = 1.2
"""Largest distance across it (z)."""
_THETA_DEG = 20.0
"""Largest difference of the azimuths."""
_PHI_DEG = 20.0
"""Largest difference of the elevations."""
_MOTIONS = 4
"""Motions with the most votes that are tried on all minutiae."""
_TURN_DEG = 10.0
"""Votes fall into cells of this size, and count in their neighbours too."""
_SHIFT_MM = 1.2
"""Size of the cells along the plane."""
_ROUNDS = 3
"""Refinements: a new motion from all that agree."""
_ARM_MM = 1.5
"""Directions count in a motion as a second point at this distance."""


@dataclass(frozen=True, slots=True)
class AgreementSettings(Checked):
    """When two minutiae of laid-on fingers agree, and how motions are found."""

    plane_mm: Annotated[float, Limits(0, 20, above=True)] = 1.2
    """Largest distance along the finger's plane (x and y)."""


@dataclass(frozen=True, eq=False)
class _Framed(ABC):
    """Minutiae in a frame of their own, so that nothing depends on how the finger lay.

    The origin is their mean; x, y and z are the axes of their spread, the largest first, z out of the side that bulges.
    """

    minutiae: SpaceMinutiae
    settings: Any = field(default=None)

    @abstractmethod
    def correspondences(self, other: Any) -> tuple[Index, Index]:
        """(K, n) of a few minutiae of both sides that look similar, wherever they lie."""

    @cached_property
    def places(self) -> tuple[Array, Array]:
        """Places and directions, (N, 3) each."""
        places = self.minutiae.position_mm - self.minutiae.position_mm.mean(axis=0)
        _, axes = np.linalg.eigh(places.T @ places)
        axes = axes[:, ::-1]
        own = places @ axes
        radius2 = (own[:, :2] ** 2).sum(axis=1)
        bulge = float(np.sum((radius2 - radius2.mean()) * own[:, 2]))
        size = float(np.linalg.norm(radius2 - radius2.mean()) * np.linalg.norm(own[:, 2]))
        # a flat one shows the side from which it was seen
        inward = bulge > 0 if abs(bulge) > 0.1 * size else axes[2, 2] < 0
        axes = axes * np.array([1.0, 1.0, -1.0 if inward else 1.0])
        axes[:, 1] *= np.linalg.det(axes)
        return places @ axes, self.minutiae.direction @ axes

    @cached_property
    def key(self) -> tuple[float, float, bytes]:
        """By which sides are ordered, so that the result depends neither on the order of arguments nor on the frame."""
        places = self.places[0]
        return float(self.minutiae.count), round(float((places**2).sum()), 3), pack_space_minutiae(self.minutiae)


def _rigid_motion(a: Array, b: Array) -> tuple[Array, Array]:
    """Rotation (3, 3) and shift (3,) that take points `a` (n, 3) best to points `b` (n, 3). Source: W. Kabsch, "A
    solution for the best rotation to relate two sets of vectors", Acta Cryst. A32, 1976.
    """
    middle_a, middle_b = a.mean(axis=0), b.mean(axis=0)
    u, _, vt = np.linalg.svd((a - middle_a).T @ (b - middle_b))
    u[:, 2] *= np.sign(np.linalg.det(u) * np.linalg.det(vt))
    rotation = (u @ vt).T
    return rotation, middle_b - rotation @ middle_a


def _most_agreeing(a: _Framed, b: _Framed, pairs: tuple[Index, Index], settings: AgreementSettings) -> int:
    """Let correspondences (K, n) of a few minutiae vote for motions, refine the best of them, and count what agrees."""
    most = 0
    for chosen in _voted(a, b, pairs):
        found = _moved(a, b, pairs[0][chosen].ravel(), pairs[1][chosen].ravel(), settings)
        for _ in range(_ROUNDS):
            if len(found[0]) < 3:
                break
            again = _moved(a, b, *found, settings)
            if len(again[0]) <= len(found[0]):
                break
            found = again
        most = max(most, len(found[0]))
    return most


def _voted(a: _Framed, b: _Framed, pairs: tuple[Index, Index]) -> list[Index]:
    """Correspondences that propose like motions, the largest such groups first.

    Each proposes a turn in the finger's plane, and a shift; they are counted in overlapping cells.
    """
    left, right = pairs
    if not len(left):
        return []
    turn, shift = _plane_motions(a, b, left, right)
    steps = round(2 * np.pi / np.deg2rad(_TURN_DEG))
    cell = np.floor(shift / _SHIFT_MM).astype(np.intp)
    cell -= cell.min(axis=0) - 1
    wide, high = (cell.max(axis=0) + 2).tolist()
    angle = np.floor(turn / (2 * np.pi) * steps).astype(np.intp) % steps
    votes = np.zeros((steps, wide, high))
    np.add.at(votes, (angle, cell[:, 0], cell[:, 1]), 1.0)
    votes = votes + np.roll(votes, 1, axis=0) + np.roll(votes, -1, axis=0)
    for axis in (1, 2):  # the border cells are empty, so that nothing is rolled round
        votes = votes + np.roll(votes, 1, axis=axis) + np.roll(votes, -1, axis=axis)
    groups = []
    for _ in range(_MOTIONS):
        top = np.unravel_index(int(np.argmax(votes)), votes.shape)
        if votes[top] <= 0:
            break
        around = np.abs((angle - top[0] + steps // 2) % steps - steps // 2) <= 1
        around &= (np.abs(cell - np.array(top[1:])) <= 1).all(axis=1)
        groups.append(np.flatnonzero(around))
        turns = [(top[0] + d) % steps for d in (-1, 0, 1)]
        votes[turns, max(top[1] - 1, 0) : top[1] + 2, max(top[2] - 1, 0) : top[2] + 2] = 0.0
    return groups


def _moved(a: _Framed, b: _Framed, left: Index, right: Index, settings: AgreementSettings) -> tuple[Index, Index]:
    """What agrees after the motion that takes minutiae `left` best to `right`."""
    return _agreeing(a, b, *_rigid_motion(_armed(a, left), _armed(b, right)), settings)


def _agreeing(
    a: _Framed, b: _Framed, rotation: Array, shift_mm: Array, settings: AgreementSettings
) -> tuple[Index, Index]:
    """Minutiae (M,) of both sides that agree after a motion, paired one to one, the nearest first."""
    there, ahead = a.places[0] @ rotation.T + shift_mm, a.places[1] @ rotation.T
    apart = there[:, None] - b.places[0][None]
    plane2 = apart[..., 0] ** 2 + apart[..., 1] ** 2
    near = (plane2 <= settings.plane_mm**2) & (np.abs(apart[..., 2]) <= _HEIGHT_MM)
    i, j = np.nonzero(near)
    turned = np.arctan2(ahead[i, 1], ahead[i, 0]) - np.arctan2(b.places[1][j, 1], b.places[1][j, 0])
    turned = np.abs((turned + np.pi) % (2 * np.pi) - np.pi)
    risen = np.abs(np.arcsin(np.clip(ahead[i, 2], -1, 1)) - np.arcsin(np.clip(b.places[1][j, 2], -1, 1)))
    similar = (turned <= np.deg2rad(_THETA_DEG)) & (risen <= np.deg2rad(_PHI_DEG))
    i, j, turned, risen = i[similar], j[similar], turned[similar], risen[similar]
    cost = plane2[i, j] / settings.plane_mm**2 + (apart[i, j, 2] / _HEIGHT_MM) ** 2
    cost += (turned / np.deg2rad(_THETA_DEG)) ** 2 + (risen / np.deg2rad(_PHI_DEG)) ** 2
    chosen = one_to_one(i, j, cost)
    return i[chosen], j[chosen]


def one_to_one(i: Index, j: Index, cost: Array) -> Index:
    """Which of the pairs (i, j) are kept if each side is used once, the cheapest first."""
    kept, seen_i, seen_j = [], set(), set()
    for k in np.argsort(cost, kind="stable").tolist():
        one, other = int(i[k]), int(j[k])
        if one not in seen_i and other not in seen_j:
            kept.append(k)
            seen_i.add(one)
            seen_j.add(other)
    return np.array(kept, dtype=np.intp)


def _nearest(places: Array, count: int) -> tuple[Index, Array]:
    """Each of N points' `count` nearest others (N, count), nearest first, and all squared distances (N, N)."""
    apart2 = ((places[:, None] - places[None]) ** 2).sum(axis=2)
    np.fill_diagonal(apart2, np.inf)
    return np.argsort(apart2, axis=1, kind="stable")[:, :count], apart2


def _close_points(a: scipy.spatial.cKDTree, b: scipy.spatial.cKDTree) -> tuple[Index, Index]:
    """Points of `a` and `b` that differ by one at most in every coordinate, ordered by both."""
    found = a.sparse_distance_matrix(b, 1.0, p=np.inf, output_type="ndarray")
    order = np.lexsort((found["j"], found["i"]))
    return found["i"][order], found["j"][order]


def _plane_motions(a: _Framed, b: _Framed, left: Index, right: Index) -> tuple[Array, Array]:
    """Turns (K,) in the plane and the shifts (K, 2) that follow, of correspondences (K, n)."""
    places, others = a.places[0][left][..., :2], b.places[0][right][..., :2]
    middle, there = places.mean(axis=1), others.mean(axis=1)
    arms = np.concatenate([places - middle[:, None], a.places[1][left][..., :2]], axis=1)
    others = np.concatenate([others - there[:, None], b.places[1][right][..., :2]], axis=1)
    across = (arms[..., 0] * others[..., 1] - arms[..., 1] * others[..., 0]).sum(axis=1)
    turn = np.arctan2(across, (arms * others).sum(axis=(1, 2)))
    cosine, sine = np.cos(turn), np.sin(turn)
    moved = np.stack([cosine * middle[:, 0] - sine * middle[:, 1], sine * middle[:, 0] + cosine * middle[:, 1]], axis=1)
    return turn, there - moved


def _armed(side: _Framed, index: Index) -> Array:
    """Places and the ends of their directions, (2 n, 3)."""
    places = side.places[0][index]
    return np.concatenate([places, places + _ARM_MM * side.places[1][index]])


# Pairs of neighbouring minutiae.

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
class SpaceMatch:
    """How similar two sets of minutiae in space are."""

    similarity: float
    """0 to 1: the square of `agreeing` over the product of both numbers of minutiae."""
    agreeing: int
    """Minutiae that agree one to one."""
    proposals: int
    """Pairs of minutiae, or tetrahedra, of both sides that look similar."""
    compared: bool
    """False where one side has fewer than ten minutiae."""


@dataclass(frozen=True, eq=False)
class PreparedMinutiae3D(_Framed):
    """Minutiae in their own frame, and the pairs of neighbours among them."""

    settings: Minutiae3DSettings = field(default_factory=Minutiae3DSettings)

    def correspondences(self, other: PreparedMinutiae3D) -> tuple[Index, Index]:
        """(K, 2) pairs that look similar."""
        i, j = _close_points(self.tree, other.tree)
        return self.pairs[i], other.pairs[j]

    @cached_property
    def pairs(self) -> Index:
        """(P, 2) each minutia and one of its nearest."""
        places = self.places[0]
        near, _ = _nearest(places, min(self.settings.neighbours, len(places) - 1))
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
) -> SpaceMatch:
    """Compare the minutiae in space of two fingers.

    Comparing A with B gives what B with A gives, and neither depends on how the fingers lie in space. Prepare a side
    that is compared more than once; then its settings must be those given here.

    Source: A. Kumar and C. Kwong, "Towards contactless, low-cost and accurate 3D fingerprint identification", IEEE
    Trans. PAMI 37(3), 2015: a reference minutia pair aligns two sets; minutiae match within tolerances of place, theta
    and phi; the score is m^2 / (M_P M_Q).
    """
    return _compared(*prepared_sides(a, b, PreparedMinutiae3D, settings))


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
    """Largest difference of two edges that still match."""
    angle_deg: Annotated[float, Limits(0, 90, above=True)] = 25.0
    """Largest difference of the angles between directions and edges."""
    agreement: AgreementSettings = field(default_factory=AgreementSettings)


@dataclass(frozen=True, eq=False)
class PreparedTetrahedra(_Framed):
    """Minutiae in their own frame, and the tetrahedra among them."""

    settings: TetrahedraSettings = field(default_factory=TetrahedraSettings)

    def correspondences(self, other: PreparedTetrahedra) -> tuple[Index, Index]:
        """Corners (K, 4) of similar tetrahedra, each corner beside the one that it corresponds to.

        Where several orders of the corners are similar, the one with the smallest difference of angles is taken.
        """
        i, j = _close_points(self.tree, other.tree)
        order, good = _best_order(self, other, i, j)
        i, j, order = i[good], j[good], order[good]
        return self.corners[i], np.take_along_axis(other.corners[j], _ORDERS[order], axis=1)

    @cached_property
    def corners(self) -> Index:
        """(T, 4) minutiae of each tetrahedron, its apex first; none with an edge below what is separated."""
        places = self.places[0]
        near, apart2 = _nearest(places, self.settings.neighbours)
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
) -> SpaceMatch:
    """Compare the minutiae in space of two fingers by their tetrahedra; as :func:`minutiae3d_match`.

    Source: C. Lin and A. Kumar, "Tetrahedron based fast 3D fingerprint identification using colored LEDs illumination",
    IEEE Trans. PAMI 40(12), 2018. The accessible text of the paper lacks its tolerances: those here are chosen by us.
    """
    return _compared(*prepared_sides(a, b, PreparedTetrahedra, settings))


def _compared(a: _Framed, b: _Framed) -> SpaceMatch:
    """Align two sides by what looks similar in both, and count the minutiae that agree."""
    if not (a.minutiae.acquired and b.minutiae.acquired):
        return SpaceMatch(0.0, 0, 0, compared=False)
    left, right = (b, a) if a.key > b.key else (a, b)
    pairs = left.correspondences(right)
    count = _most_agreeing(left, right, pairs, left.settings.agreement)
    similarity = count * count / (a.minutiae.count * b.minutiae.count)
    return SpaceMatch(similarity, count, len(pairs[0]), compared=True)


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
