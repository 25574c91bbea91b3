"""Comparison of minutiae in space after Kumar and Kwong: a reference pair aligns them, tolerances count them.

Level by level: pairs of neighbouring minutiae that look alike wherever they lie (their distance, and both directions
against the line between them) propose motions; those whose minutiae are proposed most often are tried on all minutiae;
the best are refined from all that agree. The score is that of the paper, the square of the number of agreeing minutiae
over the product of both sides' numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from splitknit.matching.minutiae3d_record import SpaceMinutiae
from splitknit.matching.space_alignment import (
    AgreementSettings,
    Framed,
    Index,
    best_agreement,
    close_points,
    nearest,
    share_of_both,
    two_sides,
)
from splitknit.settings import Checked, Limits

Array = NDArray[np.float64]


_LENGTH_MM = 0.25
"""Largest difference of the lengths of two pairs that are alike."""
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
    """How alike two sets of minutiae in space are."""

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
    def tree(self) -> cKDTree:
        """The looks in units of the tolerances; azimuths go round."""
        angle = np.deg2rad(_ANGLE_DEG)
        scaled = self.looks / np.array([_LENGTH_MM, angle, angle])
        round_ = 2 * np.pi / angle
        scaled[:, 1:] %= round_
        scaled[:, 1:][scaled[:, 1:] >= round_] = 0.0
        return cKDTree(scaled, boxsize=np.array([1e6, round_, round_]))


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
    found = best_agreement(left, right, alike_pairs(left, right), left.settings.agreement)
    count = len(found.a)
    return Minutiae3DMatch(share_of_both(count, left.minutiae.count, right.minutiae.count), count, compared=True)


def alike_pairs(a: PreparedMinutiae3D, b: PreparedMinutiae3D) -> tuple[Index, Index]:
    """Correspondences (K, 2) of pairs that look alike."""
    i, j = close_points(a.tree, b.tree)
    return a.pairs[i], b.pairs[j]
