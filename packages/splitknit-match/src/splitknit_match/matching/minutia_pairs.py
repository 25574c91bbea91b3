"""Which minutiae of two prints may be the same: cylinder codes, relaxed by how the pairs lie to each other.

Source: R. Cappelli, M. Ferrara and D. Maltoni, "Minutia Cylinder-Code: a new representation and matching technique for
fingerprint recognition", IEEE TPAMI 32(12), 2010. Different from it: what the print does not show is known from its
ridges instead of the minutiae's hull, any turn is allowed, two pairs may not share a minutia, and distances may
differ by a fraction of themselves, as skin stretches.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.model import BoolArray, FloatArray
from splitknit_match.prints.minutiae_record import Minutiae

Places = NDArray[np.complex128]

_RADIUS_MM, _CELLS, _LEVELS = 3.556, 8, 6
"""Radius of a cylinder, its cells across, and its levels of direction."""
_SIGMA_MM, _SIGMA_RAD = 0.474, 2 * np.pi / 9
_MIDDLE, _STEEP = 0.234, 17.0
"""Middle and steepness of the sigmoid that lets many minutiae in a cell count little more than one."""
_MARGIN_MM = 0.5
"""So far beyond the ridges a print would still show its minutiae."""
_MIN_COMMON = 0.5
"""Fraction of a cylinder that both prints must show."""
_MOST = 100
"""Minutiae that are compared: the most reliable."""
_PAIRS = 120
"""Most similar pairs that are relaxed."""
_NEAR_MM, _STRETCH, _TURN_RAD = 0.3, 0.08, 0.3
"""Differences at which two pairs fit each other by 1/e: of a distance (and so much of itself), of an angle."""
_STEPS = 5
_MEMBER = 0.2
"""Pairs that fit the best one less are none of its company."""
_ARM_MM = 3.0
"""Direction of one minutia counts in an alignment as its place so far from the middle does."""
_FITS_MM, _FITS_RAD = 0.4, 0.35
"""Differences at which a minutia laid on another counts 1/e."""


@dataclass(frozen=True, slots=True, eq=False)
class Cylinders:
    """Minutiae of one print with what lies around each."""

    place: Places
    """(N,) mm to the right, and up times i, of the middle of the print's template, as a camera sees it."""
    turn: NDArray[np.float64]
    """(N,) radians, counter-clockwise."""
    value: FloatArray
    """(N, cells) 0 to 1."""
    known: FloatArray
    """(N, cells) 1 where the print shows the cell."""


_NONE = np.zeros(0, dtype=np.complex128)


@dataclass(frozen=True, slots=True, eq=False)
class Laid:
    """How A lies on B: turned about its middle, then moved; and the pairs of minutiae by which that was found."""

    angle_rad: float
    right_mm: float
    up_mm: float
    support: float = 0.0
    """About how many pairs of minutiae fit each other."""
    a: Places = field(default_factory=lambda: _NONE)
    b: Places = field(default_factory=lambda: _NONE)

    def moved(self, place: Places) -> Places:
        """Places (N,) of A on B."""
        return np.asarray(place * np.exp(1j * self.angle_rad) + complex(self.right_mm, self.up_mm))


_LINE_MM = (2 * _RADIUS_MM / _CELLS * (np.arange(_CELLS) - (_CELLS - 1) / 2)).astype(np.float32)
_LEVEL_RAD = ((2 * np.pi / _LEVELS * np.arange(_LEVELS) + np.pi) % (2 * np.pi) - np.pi).astype(np.float32)
_ROUND = np.hypot(_LINE_MM[:, None], _LINE_MM) <= _RADIUS_MM
"""Which cells of the square are a cylinder's."""
CYLINDER = int(_ROUND.sum()) * _LEVELS
"""Numbers of a cylinder."""


def minutia_cylinders(minutiae: Minutiae, valid: BoolArray, pitch_mm: float) -> Cylinders:
    """Cylinders of a print's minutiae; `valid` (H, W) are its ridges, mirrored as a template has them."""
    if minutiae.count > _MOST:
        minutiae = minutiae.taken(np.sort(np.argsort(-minutiae.quality.astype(np.int64), kind="stable")[:_MOST]))
    place = -minutiae.x_mm + 1j * minutiae.y_mm
    turn = np.pi - minutiae.direction_rad
    ahead = np.exp(1j * turn)[:, None]
    gap = ((place - place[:, None]) * ahead.conj()).astype(np.complex64)[:, None]
    # the Gaussian around a minutia is the product of one to the right and one up; each (N, cells, N)
    line = _LINE_MM[:, None]
    far = -35  # less makes numbers so small (subnormal) that sums of their products take ten times as long
    right, up = (np.exp(np.maximum((line - part) ** 2 / (-2 * _SIGMA_MM**2), far)) for part in (gap.real, gap.imag))
    own = np.arange(len(place))
    right[own, :, own] = 0.0
    turned = _wrapped(turn - turn[:, None]).astype(np.float32)[:, None]
    apart = np.pi - np.abs(np.pi - np.abs(_LEVEL_RAD[:, None] - turned))
    like = np.exp(-0.5 * (apart / _SIGMA_RAD) ** 2)  # (N, levels, N)
    both = (up[:, :, None] * like[:, None]).reshape(len(place), _CELLS * _LEVELS, len(place))
    near = (right @ both.swapaxes(1, 2)).reshape(len(place), _CELLS, _CELLS, _LEVELS)[:, _ROUND]
    value = 1 / (1 + np.exp(_STEEP * (_MIDDLE - near)))
    at = place[:, None] + (_LINE_MM[:, None] + 1j * _LINE_MM)[_ROUND] * ahead
    reach = round(_MARGIN_MM / pitch_mm)
    shown = cv2.dilate(np.pad(valid.view(np.uint8), reach), np.ones((2 * reach + 1,) * 2, np.uint8))
    middle = (np.array(shown.shape) - 1) / 2
    pixels = np.stack([middle[1] + at.real / pitch_mm, middle[0] - at.imag / pitch_mm], axis=-1)
    known = on_ridges(shown > 0, pixels).astype(np.float32)
    value *= known[..., None]
    return Cylinders(place, turn, value.reshape(len(place), -1), np.repeat(known, _LEVELS, axis=1))


def on_ridges(valid: BoolArray, place: NDArray[np.float64]) -> BoolArray:
    """(...) whether columns and rows (..., 2) lie on a template's ridges."""
    rows, columns = (np.clip(np.rint(place[..., 1 - k]), -1, valid.shape[k]).astype(np.int64) + 1 for k in (0, 1))
    return np.pad(valid, 1)[rows, columns]


def pair_minutiae(a: Cylinders, b: Cylinders) -> list[Laid]:
    """At most two alignments of `a` on `b` by pairs of minutiae that support each other, the best first."""
    if min(len(a.turn), len(b.turn)) < 2:
        return []
    gamma = _similarity(a, b)
    count = min(_PAIRS, gamma.size)
    best = np.argpartition(-gamma, count - 1, axis=None)[:count]
    i, j = np.unravel_index(np.sort(best), gamma.shape)
    first = gamma[i, j].astype(float)
    fits = _compatible((a.place[i], a.turn[i]), (b.place[j], b.turn[j]))
    fits[(i[:, None] == i) | (j[:, None] == j)] = 0.0
    value = first
    for _ in range(_STEPS):
        value = 0.5 * value + 0.5 * (fits @ value) / (count - 1)
    laid, free = [], value.copy()
    for _ in range(2):
        top = int(np.argmax(free))
        near = fits[top] * value
        near[top] = value[top]
        company: list[int] = []
        for k in np.argsort(-near, kind="stable").tolist():
            if k != top and fits[top, k] < _MEMBER:
                continue
            if all(i[k] != i[other] and j[k] != j[other] for other in company):
                company.append(k)
        if len(company) < 3 or not value[top] > 0:  # cylinders that share too little are not alike at all
            break
        c = np.array(company)
        weight = first[c]
        support = float(np.sqrt(weight @ fits[np.ix_(c, c)] @ weight))
        laid.append(_laid((a.place[i[c]], a.turn[i[c]]), (b.place[j[c]], b.turn[j[c]]), near[c], support))
        free[(fits[top] > _MEMBER) | (np.arange(count) == top)] = 0.0
    return sorted(laid, key=lambda one: -one.support)


def agreeing(placed: tuple[Places, NDArray[np.float64]], others: tuple[Places, NDArray[np.float64]]) -> float:
    """About how many of some minutiae, laid on others, lie on one of these: places in mm and directions of both."""
    if not (len(placed[0]) and len(others[0])):
        return 0.0
    gap = np.abs(placed[0][:, None] - others[0])
    turn = _wrapped(placed[1][:, None] - others[1])
    like = np.exp(-((gap / _FITS_MM) ** 2) - (turn / _FITS_RAD) ** 2)
    best = (like == like.max(axis=1, keepdims=True)) & (like == like.max(axis=0, keepdims=True))
    return float(like[best].sum())


def _similarity(a: Cylinders, b: Cylinders) -> FloatArray:
    """(N, M) of cylinders, 0 where too little is shown by both."""
    cross = a.value @ b.value.T
    own, other = (a.value * a.value) @ b.known.T, a.known @ (b.value * b.value).T
    gap = np.sqrt(np.maximum(own + other - 2 * cross, 0))
    total = np.sqrt(own) + np.sqrt(other)
    enough = (a.known @ b.known.T >= _MIN_COMMON * a.known.shape[1]) & (total > 0)
    return np.where(enough, 1 - gap / np.maximum(total, 1e-6), 0.0)


def _compatible(a: tuple[Places, NDArray[np.float64]], b: tuple[Places, NDArray[np.float64]]) -> NDArray[np.float64]:
    """(K, K) how well each pair fits the others, 0 to 1: distances, directions, and where one sees the other."""
    (to_a, turn_a), (to_b, turn_b) = (
        ((place[None] - place[:, None]) * np.exp(-1j * turn)[:, None], turn[None] - turn[:, None])
        for place, turn in (a, b)
    )
    away = np.abs(to_a), np.abs(to_b)
    longer = (away[0] - away[1]) / (_NEAR_MM + _STRETCH * np.minimum(*away))
    seen = np.angle(to_a * np.conj(to_b))
    miss = longer**2 + (seen**2 + _wrapped(turn_a - turn_b) ** 2) / _TURN_RAD**2
    return np.asarray(np.exp(-0.5 * (miss + miss.T)))


def _laid(
    a: tuple[Places, NDArray[np.float64]],
    b: tuple[Places, NDArray[np.float64]],
    weight: NDArray[np.float64],
    support: float,
) -> Laid:
    """Least squares of places and directions."""
    weight = weight / weight.sum()
    middle_a, middle_b = weight @ a[0], weight @ b[0]
    turned = weight @ ((b[0] - middle_b) * np.conj(a[0] - middle_a) + _ARM_MM**2 * np.exp(1j * (b[1] - a[1])))
    angle = float(np.angle(turned))
    moved = middle_b - middle_a * np.exp(1j * angle)
    return Laid(angle, float(moved.real), float(moved.imag), support, a[0], b[0])


def _wrapped(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    return (angle + np.pi) % (2 * np.pi) - np.pi
