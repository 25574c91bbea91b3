"""Which minutiae of two prints may be the same: cylinder codes, relaxed by how the pairs lie to
each other.

Source: R. Cappelli, M. Ferrara and D. Maltoni, "Minutia Cylinder-Code: a new representation and
matching technique for fingerprint recognition", IEEE TPAMI 32(12), 2010. Different from it: what
the print does not show is known from its ridges instead of the minutiae's hull, any turn is
allowed, two pairs may not share a minutia, and distances may differ by a fraction of themselves, as
skin stretches.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.model import Array, BoolArray, FloatArray
from splitknit_match.matching.elastic import Affine, rigid
from splitknit_match.matching.ridge_band import RidgeBand
from splitknit_match.records.minutiae_record import Minutiae

Places = NDArray[np.complex128]
Directed = tuple[Places, Array]
"""Places (N,) in mm and directions (N,) in radians of minutiae."""

_RADIUS_MM = 3.556
"""Radius of a cylinder. Source: Cappelli et al. 2010 (70 pixels at 500 ppi)."""
_CELLS = 8
"""Its cells across. Source: Cappelli et al. 2010."""
_LEVELS = 6
"""Its levels of direction. Source: Cappelli et al. 2010."""
_SIGMA_MM = 0.474
"""Gaussian of a minutia's place. Source: Cappelli et al. 2010."""
_SIGMA_RAD = 2 * np.pi / 9
"""Gaussian of its direction. Source: Cappelli et al. 2010."""


@dataclass(frozen=True, slots=True, eq=False)
class Cylinders:
    """Minutiae of one print with what lies around each."""

    place: Places
    """(N,) mm to the right, and up times i, of the centre of the print's template, as a camera sees
    it."""
    turn: Array
    """(N,) radians, counter-clockwise."""
    value: FloatArray
    """(N, cells) 0 to 1."""
    known: FloatArray
    """(N, cells) 1 where the print shows the cell."""


@dataclass(frozen=True, slots=True, eq=False)
class Pairing:
    """How A lies on B: turned about its centre, then moved."""

    angle_rad: float
    shift_mm: complex
    """To the right, and up times i."""
    support: float
    """About how many pairs of minutiae fit each other."""

    def affine(self, a: RidgeBand, b: RidgeBand) -> Affine:
        """Position in B to position in A."""
        return rigid(a, b, self.angle_rad, self.shift_mm.real, -self.shift_mm.imag)

    def moved(self, place: Places) -> Places:
        """Places (N,) of A on B."""
        return np.asarray(place * np.exp(1j * self.angle_rad) + self.shift_mm)


_LINE_MM = (2 * _RADIUS_MM / _CELLS * (np.arange(_CELLS) - (_CELLS - 1) / 2)).astype(np.float32)
"""Place of a cylinder's cells along one axis. Source: derived."""
_LEVEL_RAD = ((2 * np.pi / _LEVELS * np.arange(_LEVELS) + np.pi) % (2 * np.pi) - np.pi).astype(
    np.float32
)
"""Directions of its levels. Source: derived."""
_ROUND = np.hypot(_LINE_MM[:, None], _LINE_MM) <= _RADIUS_MM
"""Which cells of the square are a cylinder's."""
CYLINDER = int(_ROUND.sum()) * _LEVELS
"""Numbers of a cylinder."""
MAX_COMPARED = 100
"""Minutiae that are compared: the most reliable. Chosen on: speed."""


def minutia_cylinders(minutiae: Minutiae, valid: BoolArray, pitch_mm: float) -> Cylinders:
    """Cylinders of a print's minutiae; `valid` (H, W) are its ridges, mirrored as a template has
    them."""
    minutiae = minutiae.best(MAX_COMPARED)
    count = minutiae.count
    place = -minutiae.x_mm + 1j * minutiae.y_mm
    turn = np.pi - minutiae.direction_rad
    ahead = np.exp(1j * turn)[:, None]
    offset = ((place - place[:, None]) * ahead.conj()).astype(np.complex64)[:, None]
    # the Gaussian around a minutia is the product of one to the right and one up; each (N, cells,
    # N)
    line = _LINE_MM[:, None]
    # less makes numbers so small (subnormal) that sums of their products take ten times as long
    far = -35
    right, up = (
        np.exp(np.maximum((line - part) ** 2 / (-2 * _SIGMA_MM**2), far))
        for part in (offset.real, offset.imag)
    )
    right[range(count), :, range(count)] = 0.0
    turned = _wrapped(turn - turn[:, None]).astype(np.float32)[:, None]
    angle = np.pi - np.abs(np.pi - np.abs(_LEVEL_RAD[:, None] - turned))
    by_direction = np.exp(-0.5 * (angle / _SIGMA_RAD) ** 2)  # (N, levels, N)
    up_by_direction = (up[:, :, None] * by_direction[:, None]).reshape(
        count, _CELLS * _LEVELS, count
    )
    near = (right @ up_by_direction.swapaxes(1, 2)).reshape(count, _CELLS, _CELLS, _LEVELS)[
        :, _ROUND
    ]
    # a sigmoid: many minutiae in a cell count little more than one
    value = 1 / (1 + np.exp(17.0 * (0.234 - near)))
    cells = place[:, None] + (_LINE_MM[:, None] + 1j * _LINE_MM)[_ROUND] * ahead
    reach = round(0.5 / pitch_mm)  # so far beyond the ridges a print would still show its minutiae
    print_area = cv2.dilate(
        np.pad(valid.view(np.uint8), reach), np.ones((2 * reach + 1,) * 2, np.uint8)
    )
    centre = (np.array(print_area.shape) - 1) / 2
    pixels = np.stack(
        [centre[1] + cells.real / pitch_mm, centre[0] - cells.imag / pitch_mm], axis=-1
    )
    known = on_ridges(print_area > 0, pixels).astype(np.float32)
    value *= known[..., None]
    return Cylinders(place, turn, value.reshape(count, -1), np.repeat(known, _LEVELS, axis=1))


def on_ridges(valid: BoolArray, place: FloatArray) -> BoolArray:
    """(...) whether columns and rows (..., 2) lie on a template's ridges."""
    columns, rows = np.moveaxis(np.rint(place).astype(np.int64), -1, 0)
    inside = (rows >= 0) & (columns >= 0) & (rows < valid.shape[0]) & (columns < valid.shape[1])
    return np.asarray(valid[rows * inside, columns * inside] & inside)


_MIN_FIT = 0.2  # pairs that fit the best one less do not go with it


def pair_minutiae(a: Cylinders, b: Cylinders) -> list[Pairing]:
    """At most two alignments of `a` on `b` by pairs of minutiae that support each other, the best
    first."""
    if min(len(a.turn), len(b.turn)) < 2:
        return []
    similarity = _similarity(a, b)
    count = min(120, similarity.size)  # most similar pairs, which are relaxed
    best = np.argpartition(-similarity, count - 1, axis=None)[:count]
    i, j = np.unravel_index(np.sort(best), similarity.shape)
    first = similarity[i, j].astype(float)
    fits = _compatible((a.place[i], a.turn[i]), (b.place[j], b.turn[j]))
    fits[(i[:, None] == i) | (j[:, None] == j)] = 0.0
    value = first
    for _ in range(5):  # steps of the relaxation
        value = 0.5 * value + 0.5 * (fits @ value) / (count - 1)
    pairings = []
    free = value.copy()
    for _ in range(2):
        top = int(np.argmax(free))
        member = (fits[top] >= _MIN_FIT) | (np.arange(count) == top)
        near = np.where(np.arange(count) == top, value, fits[top] * value)
        company = []
        taken: set[int] = set()  # of A as they are, of B as ~j
        for k in np.argsort(-near, kind="stable").tolist():
            both = {int(i[k]), ~int(j[k])}
            if member[k] and taken.isdisjoint(both):
                company.append(k)
                taken |= both
        # cylinders that share too little are not similar at all
        if len(company) < 3 or not value[top] > 0:
            break
        support = float(np.sqrt(first[company] @ fits[np.ix_(company, company)] @ first[company]))
        own, matched = i[company], j[company]
        pairings.append(
            _aligned(
                (a.place[own], a.turn[own]),
                (b.place[matched], b.turn[matched]),
                near[company],
                support,
            )
        )
        free[(fits[top] > _MIN_FIT) | (np.arange(count) == top)] = 0.0
    return sorted(pairings, key=lambda pairing: -pairing.support)


_FITS_RAD = 0.35  # difference of directions at which a minutia laid on another counts 1/e


def agreeing(laid: Directed, minutiae: Directed) -> float:
    """About how many of some minutiae, laid on others, lie on one of these."""
    if not (len(laid[0]) and len(minutiae[0])):
        return 0.0
    distance = np.abs(laid[0][:, None] - minutiae[0])
    turn = _wrapped(laid[1][:, None] - minutiae[1])
    # a minutia laid on another counts 1/e at 0.4 mm
    fit = np.exp(-((distance / 0.4) ** 2) - (turn / _FITS_RAD) ** 2)
    mutual = (fit == fit.max(axis=1, keepdims=True)) & (fit == fit.max(axis=0))
    return float(fit[mutual].sum())


_DRIFT_MM = (0.7, 0.25)
"""Standard deviation of a minutia's place about its partner's, in the first and the last step of
the drift. Chosen on: simulated presses with pulls. Range: 0.5 to 1.0, 0.25 to 0.3."""
_DRIFT_STEPS = 8
"""Steps of the drift. Chosen on: simulated presses with pulls. Range: 8 to 15."""
_UNPAIRED = 0.1
"""Weight of a minutia having no partner, relative to one that lies on it. Chosen on: simulated
presses with pulls. Range: 0.05 to 0.3."""


def drifted(laid: Directed, minutiae: Directed, places: Sequence[Places]) -> list[Array]:
    """Shifts (N, 2), mm along the real and the imaginary axis, at each of `places` that move some
    minutiae, laid on others, onto these as smoothly as skin slips.

    Source: A. Myronenko and X. Song, "Point set registration: coherent point drift", IEEE TPAMI
    32(12), 2010. Different from it: the noise falls by a schedule, directions count, the shift's
    prior is in millimetres, and each minutia may be claimed once.
    """
    offset = (minutiae[0][:, None] - laid[0]).astype(np.complex64)
    real, imag = np.ascontiguousarray(offset.real), np.ascontiguousarray(offset.imag)
    turned = _wrapped(minutiae[1][:, None] - laid[1]).astype(np.float32)
    turn = -0.5 * (turned / np.float32(_FITS_RAD)) ** 2
    prior = _slip(minutiae[0], minutiae[0])
    shift = weighted = np.zeros((len(prior), 2))
    for sigma_mm in np.geomspace(*_DRIFT_MM, _DRIFT_STEPS):
        x, y = shift.astype(np.float32).T[..., None]
        fit = np.exp(turn - np.float32(0.5 / sigma_mm**2) * ((real - x) ** 2 + (imag - y) ** 2))
        fit /= np.maximum(fit.sum(axis=1, keepdims=True), fit.sum(axis=0)) + np.float32(_UNPAIRED)
        weight = np.maximum(fit.sum(axis=1, dtype=float), 1e-6)
        target = np.stack([(fit * real).sum(axis=1), (fit * imag).sum(axis=1)]) / weight
        weighted = np.linalg.solve(prior + np.diag(sigma_mm**2 / weight), target.T)
        shift = prior @ weighted
    return [_slip(part, minutiae[0]) @ weighted for part in places]


_SLIP_MM = (0.8, 0.3)
"""Standard deviations of skin's shift along one axis: of its smooth part, and of the whole print.
Chosen on: simulated presses with pulls. Range: 0.4 to 1.0 (the smooth part)."""
_SLIP_REACH_MM = 4.0
"""Distance over which the correlation of the smooth part falls to exp(-1/2). Chosen on: simulated
presses with pulls. Range: 3 to 6."""


def _slip(a: Places, b: Places) -> Array:
    """(N, M) covariance, mm2, of the skin's shift along one axis between places."""
    near = np.exp(-0.5 * (np.abs(a[:, None] - b) / _SLIP_REACH_MM) ** 2)
    return _SLIP_MM[0] ** 2 * near + _SLIP_MM[1] ** 2


def _similarity(a: Cylinders, b: Cylinders) -> FloatArray:
    """(N, M) of cylinders, 0 where too little is shown by both."""
    cross = a.value @ b.value.T
    power_a = (a.value * a.value) @ b.known.T
    power_b = a.known @ (b.value * b.value).T
    distance = np.sqrt(np.maximum(power_a + power_b - 2 * cross, 0))
    total = np.sqrt(power_a) + np.sqrt(power_b)
    # fraction of a cylinder that both prints must show
    enough = (a.known @ b.known.T >= 0.5 * a.known.shape[1]) & (total > 0)
    return np.where(enough, 1 - distance / np.maximum(total, 1e-6), 0.0)


def _compatible(a: Directed, b: Directed) -> Array:
    """(K, K) how well each pair fits the others, 0 to 1: distances, directions, and where one sees
    the other."""
    (to_a, turn_a), (to_b, turn_b) = (
        ((place[None] - place[:, None]) * np.exp(-1j * turn)[:, None], turn[None] - turn[:, None])
        for place, turn in (a, b)
    )
    distance_a, distance_b = np.abs(to_a), np.abs(to_b)
    # mm, and a fraction of the distance more, as skin stretches
    longer = (distance_a - distance_b) / (0.3 + 0.08 * np.minimum(distance_a, distance_b))
    bearing = np.angle(to_a * np.conj(to_b))
    # 0.3 rad
    misfit = longer**2 + (bearing**2 + _wrapped(turn_a - turn_b) ** 2) / 0.3**2
    return np.asarray(np.exp(-0.5 * (misfit + misfit.T)))


def _aligned(a: Directed, b: Directed, weight: Array, support: float) -> Pairing:
    """Least squares of places and directions."""
    weight = weight / weight.sum()
    centre_a, centre_b = weight @ a[0], weight @ b[0]
    # the direction of a minutia counts as its place 3 mm from the centre does
    turned = weight @ (
        (b[0] - centre_b) * np.conj(a[0] - centre_a) + 3.0**2 * np.exp(1j * (b[1] - a[1]))
    )
    angle = float(np.angle(turned))
    shift = centre_b - centre_a * np.exp(1j * angle)
    return Pairing(angle, complex(shift), support)


def _wrapped(angle: Array) -> Array:
    return (angle + np.pi) % (2 * np.pi) - np.pi
