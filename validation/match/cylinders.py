"""Minutia cylinder code as published, a peer of the library's own comparison of minutiae.

R. Cappelli, M. Ferrara and D. Maltoni, "Minutia Cylinder-Code: a new representation and matching technique for
fingerprint recognition", IEEE TPAMI 32(12), 2010: MCC16 (table 1) with local similarity sort and relaxation (LSSR).
Numbers in brackets are the paper's equations.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from splitknit_match.matching.minutiae_record import Minutiae

Array = NDArray[np.float64]
_R, _NS, _ND = 70.0, 16, 6
_SIGMA_S, _SIGMA_D = 28 / 3, 2 * np.pi / 9
_MU_PSI, _TAU_PSI = 0.01, 400.0
_HULL = 50.0
_MIN_VALID, _MIN_MINUTIAE, _MIN_COMMON = 0.75, 2, 0.60
_TURN = np.pi / 2
_MU_P, _TAU_P, _MIN_P, _MAX_P = 20.0, 2 / 5, 4, 12
_W_R, _STEPS = 0.5, 5
_RHO = ((5.0, -8 / 5), (np.pi / 12, -30.0), (np.pi / 12, -30.0))


@dataclass(frozen=True, slots=True, eq=False)
class Cylinders:
    """The valid cylinders of one print."""

    place: Array
    """(N, 2) pixels at 500 ppi, right and up."""
    turn: Array
    """(N,) radians."""
    value: Array
    """(N, cells)."""
    valid: NDArray[np.bool_]
    """(N, cells)."""


def cylinders(minutiae: Minutiae) -> Cylinders:
    """The cylinders of all minutiae that have enough neighbours."""
    place = np.stack([minutiae.x_px, -minutiae.y_px], axis=1).astype(np.float64)
    turn = minutiae.direction_rad
    step = 2 * _R / _NS
    line = step * (np.arange(_NS) - (_NS - 1) / 2)
    offset = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1).reshape(-1, 2)
    offset = offset[np.hypot(*offset.T) <= _R]
    level = -np.pi + (np.arange(_ND) + 0.5) * 2 * np.pi / _ND
    if len(place) < 3:
        none = np.zeros((0, len(offset) * _ND))
        return Cylinders(np.zeros((0, 2)), np.zeros(0), none, none.astype(np.bool_))
    hull = cv2.convexHull(place.astype(np.float32))
    value, valid, kept = [], [], []
    for k in range(len(place)):
        cos, sin = np.cos(turn[k]), np.sin(turn[k])
        cell = place[k] + offset @ np.array([[cos, sin], [-sin, cos]])  # (4)
        inside = [cv2.pointPolygonTest(hull, (float(x), float(y)), True) >= -_HULL for x, y in cell]
        others = np.arange(len(place)) != k
        away = np.linalg.norm(cell[:, None] - place[others][None], axis=2)
        near = np.where(away <= 3 * _SIGMA_S, np.exp(-0.5 * (away / _SIGMA_S) ** 2), 0.0) / (
            _SIGMA_S * np.sqrt(2 * np.pi)
        )  # (7)
        apart = _wrapped(level[:, None] - _wrapped(turn[k] - turn[others])[None])
        half = np.pi / _ND
        root = np.sqrt(2) * _SIGMA_D
        like = 0.5 * (erf((apart + half) / root) - erf((apart - half) / root))  # (11)
        value.append(1 / (1 + np.exp(-_TAU_PSI * (near @ like.T - _MU_PSI))))  # (5)
        valid.append(np.repeat(inside, _ND))
        distance = np.linalg.norm(place[others] - place[k], axis=1)
        enough = int((distance <= _R + 3 * _SIGMA_S).sum()) >= _MIN_MINUTIAE
        kept.append(enough and np.mean(inside) >= _MIN_VALID)
    chosen = np.flatnonzero(kept)
    table, known = np.stack([one.ravel() for one in value])[chosen], np.stack(valid)[chosen]
    return Cylinders(place[chosen], turn[chosen], np.where(known, table, 0.0), known)


def local_similarity(a: Cylinders, b: Cylinders, largest_turn: float = _TURN) -> Array:
    """(N, M) similarity of cylinders (17), 0 where two cannot be compared."""
    known_a, known_b = a.valid.astype(np.float64), b.valid.astype(np.float64)
    cross = a.value @ b.value.T
    own, other = (a.value**2) @ known_b.T, known_a @ (b.value**2).T
    gap = np.sqrt(np.maximum(own + other - 2 * cross, 0.0))
    total = np.sqrt(own) + np.sqrt(other)
    common = known_a @ known_b.T / a.valid.shape[1]
    apart = np.abs(_wrapped(a.turn[:, None] - b.turn[None]))
    fits = (common >= _MIN_COMMON) & (apart <= largest_turn) & (total > 0)
    return np.where(fits, 1 - gap / np.maximum(total, 1e-9), 0.0)


def mcc_similarity(a: Cylinders, b: Cylinders) -> float:
    """Global score by local similarity sort with relaxation, 0 to 1."""
    fewer = min(len(a.turn), len(b.turn))
    if not fewer:
        return 0.0
    gamma = local_similarity(a, b)
    best = np.argsort(-gamma, axis=None, kind="stable")[:fewer]
    i, j = np.unravel_index(best, gamma.shape)
    first = gamma[i, j]
    side_a, side_b = (_relations(one.place[k], one.turn[k]) for one, k in ((a, i), (b, j)))
    rho = np.ones((len(best), len(best)))
    for left, right, (mu, tau), angular in zip(side_a, side_b, _RHO, (False, True, True), strict=True):
        gap = np.abs(_wrapped(left - right)) if angular else np.abs(left - right)
        rho *= 1 / (1 + np.exp(np.clip(-tau * (gap - mu), -500, 500)))  # (26)
    np.fill_diagonal(rho, 0.0)
    value = first.copy()
    for _ in range(_STEPS):
        value = _W_R * value + (1 - _W_R) * (rho @ value) / max(len(best) - 1, 1)  # (25)
    count = _MIN_P + round((_MAX_P - _MIN_P) / (1 + np.exp(-_TAU_P * (fewer - _MU_P))))  # (21)
    gain = np.where(first > 0, value / np.maximum(first, 1e-9), 0.0)
    chosen = np.argsort(-gain, kind="stable")[:count]
    return float(value[chosen].mean())


def _relations(place: Array, turn: Array) -> tuple[Array, Array, Array]:
    """Distances, differences of direction and radial angles between minutiae (27)."""
    gap = place[:, None] - place[None]
    radial = _wrapped(turn[:, None] - np.arctan2(-gap[..., 1], -gap[..., 0]))
    return np.hypot(gap[..., 0], gap[..., 1]), _wrapped(turn[:, None] - turn[None]), radial


def _wrapped(angle: Array) -> Array:
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)
