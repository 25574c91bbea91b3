"""Minutiae in space after Kumar and Kwong: a reference pair aligns them, tolerances count them.

    python validation/published/minutiae3d.py A B [--preset kumar]
    python validation/published/minutiae3d.py PEOPLE --out scores.csv

A. Kumar and C. Kwong, "Towards contactless, low-cost and accurate 3D fingerprint identification",
IEEE Trans. PAMI 37(3), 2015. Minutiae of the relief's print (mindtct) with their height z and
elevation phi. Pairs of neighbours that look similar propose motions; those proposed most often are
tried on all minutiae and refined from all that agree. The score is the square of the number of
agreeing minutiae over the product of both sides' numbers. Tolerances were chosen on two simulated
people.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scored import run, surface_at

from splitknit.finger.ridges import surface_print
from splitknit.imaging.geometry import height_gradients, sampled_at, smoothed
from splitknit.reconstruction import Surface
from splitknit_match.prints.minutiae import extract
from splitknit_match.prints.print_map import plane_map
from splitknit_match.records.minutiae_record import MIN_MINUTIAE

Array = NDArray[np.float64]
Index = NDArray[np.intp]

SLOPE_SIGMA_MM = 0.2
"""Of the Gaussian over the surface before its slope along a ridge is measured: half a ridge's
period."""
NEIGHBOURS = 6
"""Nearest minutiae with which each forms pairs."""
LENGTH_MM = 0.25
"""Largest difference of the lengths of two similar pairs."""
ANGLE_DEG = 15.0
"""Largest difference of the directions of two similar pairs."""
PLANE_MM = 1.2
"""Tolerance of agreeing minutiae along the finger's plane."""
HEIGHT_MM = 1.2
"""Tolerance of agreeing minutiae across the finger's plane."""
AZIMUTH_DEG = 20.0
"""Tolerance of the azimuths of agreeing minutiae."""
ELEVATION_DEG = 20.0
"""Tolerance of the elevations of agreeing minutiae."""
MOTIONS = 4
"""Motions with the most votes that are tried on all minutiae."""
REFINEMENTS = 3
"""Refinements of each motion."""
CELL_TURN_DEG = 10.0
"""Turn that a cell of votes spans; votes count in neighbouring cells too."""
CELL_SHIFT_MM = 1.2
"""Shift that a cell of votes spans."""
ARM_MM = 1.5
"""Directions count in a motion as a second point at this distance."""


@dataclass(frozen=True, eq=False)
class SpaceMinutiae:
    """N minutiae of one finger, in any right-handed frame."""

    position_mm: Array  # (N, 3)
    direction: Array  # (N, 3) unit vectors

    @property
    def count(self) -> int:
        """How many there are."""
        return len(self.position_mm)


def space_minutiae(surface: Surface) -> SpaceMinutiae:
    """Minutiae of a reconstruction, in the upright finger's frame: x to the right, y to the tip, z
    to the camera.

    Places of the print go back to the surface; the direction rises as the smoothed surface does
    along it.
    """
    flat = extract(surface_print(surface, 500.0))
    print_map = plane_map(surface.pitch_mm, surface.input_from_upright, surface.upright_size)
    height = smoothed(
        surface.shape_mm + surface.ridge_mm, surface.mask, SLOPE_SIGMA_MM / surface.pitch_mm
    )
    height = np.where(surface.mask, height, np.float32(np.nan)).astype(np.float32)
    places = np.stack([flat.x_px, flat.y_px], axis=1).astype(np.float64)
    # rows run downwards
    step = 0.5 * np.stack([np.cos(flat.direction_rad), -np.sin(flat.direction_rad)], axis=1)
    there = print_map.input_from_print(places)
    ahead = print_map.input_from_print(places + step) - print_map.input_from_print(places - step)
    ahead = ahead * [1, -1] / np.linalg.norm(ahead, axis=1, keepdims=True)
    slopes = np.stack(
        [_bilinear(part, there) for part in height_gradients(height, surface.pitch_mm)], axis=1
    )
    turn = np.linalg.inv(surface.input_from_upright[:2, :2])
    flip = np.diag([1.0, -1.0])
    turn = flip @ (turn / np.sqrt(abs(np.linalg.det(turn)))) @ flip
    middle = (np.array(height.shape[::-1]) - 1) / 2
    plane = (there - middle) * [surface.pitch_mm, -surface.pitch_mm]
    space = np.column_stack(
        [plane @ turn.T, _bilinear(height, there), ahead @ turn.T, (slopes * ahead).sum(axis=1)]
    )
    space = space[np.isfinite(space).all(axis=1)]
    return SpaceMinutiae(
        space[:, :3], space[:, 3:] / np.linalg.norm(space[:, 3:], axis=1, keepdims=True)
    )


def _bilinear(values: Any, places: Array) -> Array:
    """(N,) values of a field (H, W) at places (N, 2; column, row); NaN outside and beside NaN."""
    column, row = np.nan_to_num(places, nan=-10.0).T
    return sampled_at(values, column, row, outside=float("nan")).astype(np.float64)


@dataclass(frozen=True, eq=False)
class Framed(ABC):
    """Minutiae in a frame of their own, so that nothing depends on how the finger lay.

    The origin is their mean; x, y and z are the axes of their spread, the largest first, z out of
    the side that bulges.
    """

    minutiae: SpaceMinutiae

    @abstractmethod
    def correspondences(self, opposite: Any) -> tuple[Index, Index]:
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
        """By which sides are ordered, so that the result depends neither on the order of arguments
        nor on the frame."""
        places = self.places[0]
        return (
            float(len(places)),
            round(float((places**2).sum()), 3),
            self.minutiae.position_mm.tobytes(),
        )


class Pairs(Framed):
    """Minutiae in their own frame, and the pairs of neighbours among them."""

    def correspondences(self, opposite: Pairs) -> tuple[Index, Index]:
        """(K, 2) pairs that look similar."""
        i, j = close_points(self.tree, opposite.tree)
        return self.pairs[i], opposite.pairs[j]

    @cached_property
    def pairs(self) -> Index:
        """(P, 2) each minutia and one of its nearest."""
        places = self.places[0]
        near, _ = nearest(places, min(NEIGHBOURS, len(places) - 1))
        return np.stack([np.repeat(np.arange(len(places)), near.shape[1]), near.ravel()], axis=1)

    @cached_property
    def tree(self) -> cKDTree:
        """Of each pair its length, and both azimuths against the line between them, in units of the
        tolerances."""
        places, directions = self.places
        first, second = self.pairs.T
        line = places[second] - places[first]
        ahead = np.arctan2(line[:, 1], line[:, 0])
        azimuth = np.arctan2(directions[:, 1], directions[:, 0])
        looks = np.stack(
            [np.linalg.norm(line, axis=1), azimuth[first] - ahead, azimuth[second] - ahead], axis=1
        )
        angle = np.deg2rad(ANGLE_DEG)
        scaled = looks / np.array([LENGTH_MM, angle, angle])
        round_ = 2 * np.pi / angle  # azimuths go round
        scaled[:, 1:] %= round_
        scaled[:, 1:][scaled[:, 1:] >= round_] = 0.0
        return cKDTree(scaled, boxsize=np.array([1e6, round_, round_]))


def similarity(a: Framed, b: Framed) -> float:
    """Align two sides by what looks similar in both: the square of agreeing minutiae over the
    product of both numbers.

    Comparing A with B gives what B with A gives.
    """
    left, right = (b, a) if a.key > b.key else (a, b)
    pairs = left.correspondences(right)
    most = 0
    for chosen in voted(left, right, pairs):
        agreed = _moved(left, right, pairs[0][chosen].ravel(), pairs[1][chosen].ravel())
        for _ in range(REFINEMENTS):
            if len(agreed[0]) < 3:
                break
            refined = _moved(left, right, *agreed)
            if len(refined[0]) <= len(agreed[0]):
                break
            agreed = refined
        most = max(most, len(agreed[0]))
    return most * most / (a.minutiae.count * b.minutiae.count)


def voted(a: Framed, b: Framed, pairs: tuple[Index, Index]) -> list[Index]:
    """Correspondences that propose like motions, the largest such groups first.

    Each proposes a turn in the finger's plane, and a shift; they are counted in overlapping cells.
    """
    left, right = pairs
    if not len(left):
        return []
    turn, shift = _plane_motions(a, b, left, right)
    steps = round(2 * np.pi / np.deg2rad(CELL_TURN_DEG))
    cell = np.floor(shift / CELL_SHIFT_MM).astype(np.intp)
    cell -= cell.min(axis=0) - 1
    wide, high = (cell.max(axis=0) + 2).tolist()
    angle = np.floor(turn / (2 * np.pi) * steps).astype(np.intp) % steps
    votes = np.zeros((steps, wide, high))
    np.add.at(votes, (angle, cell[:, 0], cell[:, 1]), 1.0)
    for axis in range(3):  # the border cells of shifts are empty, so that none is rolled round
        votes = votes + np.roll(votes, 1, axis=axis) + np.roll(votes, -1, axis=axis)
    groups = []
    for _ in range(MOTIONS):
        top = np.unravel_index(int(np.argmax(votes)), votes.shape)
        if votes[top] <= 0:
            break
        around = np.abs((angle - top[0] + steps // 2) % steps - steps // 2) <= 1
        around &= (np.abs(cell - np.array(top[1:])) <= 1).all(axis=1)
        groups.append(np.flatnonzero(around))
        turns = [(top[0] + d) % steps for d in (-1, 0, 1)]
        votes[turns, max(top[1] - 1, 0) : top[1] + 2, max(top[2] - 1, 0) : top[2] + 2] = 0.0
    return groups


def _plane_motions(a: Framed, b: Framed, left: Index, right: Index) -> tuple[Array, Array]:
    """Turns (K,) in the plane and the shifts (K, 2) that follow, of correspondences (K, n)."""
    places, others = a.places[0][left][..., :2], b.places[0][right][..., :2]
    middle = places.mean(axis=1)
    there = others.mean(axis=1)
    arms = np.concatenate([places - middle[:, None], a.places[1][left][..., :2]], axis=1)
    others = np.concatenate([others - there[:, None], b.places[1][right][..., :2]], axis=1)
    across = (arms[..., 0] * others[..., 1] - arms[..., 1] * others[..., 0]).sum(axis=1)
    turn = np.arctan2(across, (arms * others).sum(axis=(1, 2)))
    cosine = np.cos(turn)
    sine = np.sin(turn)
    moved = np.stack(
        [cosine * middle[:, 0] - sine * middle[:, 1], sine * middle[:, 0] + cosine * middle[:, 1]],
        axis=1,
    )
    return turn, there - moved


def _moved(a: Framed, b: Framed, left: Index, right: Index) -> tuple[Index, Index]:
    """What agrees after the motion that takes minutiae `left` best to `right` (Kabsch, Acta Cryst.
    A32, 1976)."""
    points_a, points_b = (
        np.concatenate([side.places[0][k], side.places[0][k] + ARM_MM * side.places[1][k]])
        for side, k in ((a, left), (b, right))
    )
    middle = points_a.mean(axis=0)
    there = points_b.mean(axis=0)
    u, _, vt = np.linalg.svd((points_a - middle).T @ (points_b - there))
    u[:, 2] *= np.sign(np.linalg.det(u) * np.linalg.det(vt))
    rotation = (u @ vt).T
    return agreeing(a, b, rotation, there - rotation @ middle)


def agreeing(a: Framed, b: Framed, rotation: Array, shift_mm: Array) -> tuple[Index, Index]:
    """Minutiae (M,) of both sides that agree after a motion, paired one to one, the nearest
    first."""
    there, ahead = a.places[0] @ rotation.T + shift_mm, a.places[1] @ rotation.T
    apart = there[:, None] - b.places[0][None]
    plane2 = apart[..., 0] ** 2 + apart[..., 1] ** 2
    i, j = np.nonzero((plane2 <= PLANE_MM**2) & (np.abs(apart[..., 2]) <= HEIGHT_MM))
    turned = np.arctan2(ahead[i, 1], ahead[i, 0]) - np.arctan2(b.places[1][j, 1], b.places[1][j, 0])
    turned = np.abs((turned + np.pi) % (2 * np.pi) - np.pi) / np.deg2rad(AZIMUTH_DEG)
    risen = np.abs(
        np.arcsin(np.clip(ahead[i, 2], -1, 1)) - np.arcsin(np.clip(b.places[1][j, 2], -1, 1))
    )
    risen /= np.deg2rad(ELEVATION_DEG)
    cost = plane2[i, j] / PLANE_MM**2 + (apart[i, j, 2] / HEIGHT_MM) ** 2 + turned**2 + risen**2
    cost[(turned > 1) | (risen > 1)] = np.inf
    kept: dict[int, int] = {}
    for k in np.argsort(cost, kind="stable").tolist():
        if np.isfinite(cost[k]) and i[k] not in kept and j[k] not in kept.values():
            kept[int(i[k])] = int(j[k])
    return np.array(list(kept), dtype=np.intp), np.array(list(kept.values()), dtype=np.intp)


def nearest(places: Array, count: int) -> tuple[Index, Array]:
    """Each of N points' `count` nearest others (N, count), nearest first, and all squared distances
    (N, N)."""
    apart2 = ((places[:, None] - places[None]) ** 2).sum(axis=2)
    np.fill_diagonal(apart2, np.inf)
    return np.argsort(apart2, axis=1, kind="stable")[:, :count], apart2


def close_points(a: cKDTree, b: cKDTree) -> tuple[Index, Index]:
    """Points of `a` and `b` that differ by one at most in every coordinate, ordered by both."""
    pairs = a.sparse_distance_matrix(b, 1.0, p=np.inf, output_type="ndarray")
    order = np.lexsort((pairs["j"], pairs["i"]))
    return pairs["i"][order], pairs["j"][order]


def framed(kind: type[Framed], finger: Path, preset: str) -> Framed | None:
    """Features of a finger; None where it has fewer than ten minutiae."""
    minutiae = space_minutiae(surface_at(finger, preset))
    return kind(minutiae) if minutiae.count >= MIN_MINUTIAE else None


if __name__ == "__main__":
    raise SystemExit(run(lambda finger, preset: framed(Pairs, finger, preset), similarity, "kumar"))
