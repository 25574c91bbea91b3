"""Minutiae in space laid on each other by a rigid motion, and those counted that then agree.

Shared by the matchers of minutiae in space: each proposes correspondences of a few minutiae; here the motions that
follow from them are tried, the best are refined, and agreeing minutiae are paired one to one.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.matching.minutiae_record import SpaceMinutiae, pack_space_minutiae
from splitknit.settings import Checked, Limits

if TYPE_CHECKING:
    import scipy.spatial

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Side = TypeVar("Side", bound="Framed")


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


@dataclass(frozen=True, slots=True, eq=False)
class _Agreement:
    """Minutiae that agree, and the motion."""

    a: Index
    """(M,) of the first side."""
    b: Index
    """(M,) of the second side."""
    rotation: Array
    """(3, 3), from the first side's own frame to the second's."""
    shift_mm: Array
    """(3,)"""


@dataclass(frozen=True, eq=False)
class Framed:
    """Minutiae in a frame of their own, so that nothing depends on how the finger lay.

    The origin is their mean; x, y and z are the axes of their spread, the largest first, z out of the side that bulges.
    """

    minutiae: SpaceMinutiae
    settings: Any = field(default=None)

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


def best_agreement(a: Framed, b: Framed, pairs: tuple[Index, Index], settings: AgreementSettings) -> _Agreement:
    """Let correspondences (K, n) of a few minutiae vote for motions, refine the best of them, and keep the best.

    Of equally good ones the first is kept; with none, nothing agrees.
    """
    none = np.zeros(0, dtype=np.intp)
    best = _Agreement(none, none, np.eye(3), np.zeros(3))
    for chosen in _voted(a, b, pairs):
        found = _moved(a, b, pairs[0][chosen].ravel(), pairs[1][chosen].ravel(), settings)
        for _ in range(_ROUNDS):
            if len(found.a) < 3:
                break
            again = _moved(a, b, found.a, found.b, settings)
            if len(again.a) <= len(found.a):
                break
            found = again
        if len(found.a) > len(best.a):
            best = found
    return best


def _voted(a: Framed, b: Framed, pairs: tuple[Index, Index]) -> list[Index]:
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
        votes[
            np.ix_(
                [(top[0] + d) % steps for d in (-1, 0, 1)],
                *(_beside(k, votes.shape[1 + d]) for d, k in enumerate(top[1:])),
            )
        ] = 0.0
    return groups


def _agreeing(a: Framed, b: Framed, rotation: Array, shift_mm: Array, settings: AgreementSettings) -> _Agreement:
    """Minutiae that agree after a motion, paired one to one, the nearest first."""
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
    chosen = _one_to_one(i, j, cost)
    return _Agreement(i[chosen], j[chosen], rotation, shift_mm)


def _one_to_one(i: Index, j: Index, cost: Array) -> Index:
    """Which of the pairs (i, j) are kept if each side is used once, the cheapest first."""
    kept, seen_i, seen_j = [], set(), set()
    for k in np.argsort(cost, kind="stable").tolist():
        one, other = int(i[k]), int(j[k])
        if one not in seen_i and other not in seen_j:
            kept.append(k)
            seen_i.add(one)
            seen_j.add(other)
    return np.array(kept, dtype=np.intp)


def fraction_of_both(count: int, a: int, b: int) -> float:
    """Score of `count` agreeing minutiae of `a` and `b`: count squared over their product, 0 to 1."""
    return count * count / (a * b) if a and b else 0.0


def two_sides(
    a: SpaceMinutiae | Side, b: SpaceMinutiae | Side, kind: type[Side], settings: Any, usual: Any
) -> tuple[Side, Side] | None:
    """Both sides prepared as `kind`, in an order of their own; None where one has too few minutiae.

    Raises
    ------
    BadInput
        If a side was prepared with other settings than the other, or than `settings`.
    """
    sides = []
    for side in (a, b):
        if isinstance(side, kind):
            require(
                settings is None or side.settings == settings,
                "a side was prepared with other settings; prepare it again.",
            )
            sides.append(side)
        else:
            assert isinstance(side, SpaceMinutiae)
            sides.append(kind(side, settings or usual))
    left, right = sides
    require(
        left.settings == right.settings,
        "the two sides were prepared with different settings; prepare both with the same.",
    )
    if not (left.minutiae.acquired and right.minutiae.acquired):
        return None
    return (right, left) if left.key > right.key else (left, right)


def nearest(places: Array, count: int) -> tuple[Index, Array]:
    """Each of N points' `count` nearest others (N, count), nearest first, and all squared distances (N, N)."""
    apart2 = ((places[:, None] - places[None]) ** 2).sum(axis=2)
    np.fill_diagonal(apart2, np.inf)
    return np.argsort(apart2, axis=1, kind="stable")[:, :count], apart2


def close_points(a: scipy.spatial.cKDTree, b: scipy.spatial.cKDTree) -> tuple[Index, Index]:
    """Points of `a` and `b` that differ by one at most in every coordinate, ordered by both."""
    found = a.sparse_distance_matrix(b, 1.0, p=np.inf, output_type="ndarray")
    order = np.lexsort((found["j"], found["i"]))
    return found["i"][order], found["j"][order]


def _moved(a: Framed, b: Framed, left: Index, right: Index, settings: AgreementSettings) -> _Agreement:
    """What agrees after the motion that takes minutiae `left` best to `right`."""
    rotation, shift = _rigid_motion(_armed(a, left), _armed(b, right))
    return _agreeing(a, b, rotation, shift, settings)


def _plane_motions(a: Framed, b: Framed, left: Index, right: Index) -> tuple[Array, Array]:
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


def _beside(k: np.intp, size: int) -> list[int]:
    return list(range(max(int(k) - 1, 0), min(int(k) + 2, size)))


def _armed(side: Framed, index: Index) -> Array:
    """Places and the ends of their directions, (2 n, 3)."""
    places = side.places[0][index]
    return np.concatenate([places, places + _ARM_MM * side.places[1][index]])
