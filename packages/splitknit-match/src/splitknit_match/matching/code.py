"""Codes of fixed length: what a search through very many fingers compares first.

A gallery finger has one code. A probe is coded in many variants, turned and shifted, because neither the upright
direction nor the place of the tip is known well; its similarity to a gallery finger is the best variant's inner
product.
The numbers behind the code (a factor model of ridge fields) were learned on simulated fingers: ``code_model.npz``, and
its card ``code_model.json`` beside it.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from splitknit import Checked, FloatArray, Limits, check_fields, gaussian_mean, require
from splitknit_match.matching.template import Template

# What a code is made of: how ridges run and how wide they are, on a coarse grid in the finger's own frame.
#
# The frame's origin lies in the middle of the finger at the height of its uppermost valid skin, x to the right, y down.
# Both are known to some millimetres only (roll shifts ridges across, pitch along), which is why a probe is sampled in
# many places and turned by several angles, and a gallery finger once.

COLUMNS, ROWS, STEP_MM = 17, 17, 1.0
"""The grid of a code: its first row lies one step below the finger's uppermost skin."""
CELLS = COLUMNS * ROWS
CHANNELS = 3
"""Cosine and sine of twice the direction across the ridges, times coherence; log of their frequency (rad a 0.1 mm)."""
_WINDOW_MM = 0.7
_TURN_MM = 10.0
"""A probe is turned about a point so far below the origin."""
_DERIVATIVE = np.array([-1, 9, -45, 0, 45, -9, 1], dtype=np.float32) / 60
"""Central difference of the sixth order: ridges have but four pixels of the template, too few for shorter ones."""
_HERE = np.ones(1, dtype=np.float32)
_STRANGE = 0.2
"""Where the logarithm of the frequency is so far from the finger's median, a cell counts less, and at twice not."""
_REDUCED = 2
"""Pixels of the template, each way, that share a pixel of the maps."""


@dataclass(frozen=True, slots=True, eq=False)
class _CodeField:
    """Maps of one finger."""

    maps: FloatArray
    """(4, H, W): the channels, and how much of the window about each pixel is valid, 0 to 1."""
    origin_px: tuple[float, float]
    """Column and row of the frame's origin."""
    pitch_mm: float
    """Spacing of the maps' pixels."""


def code_field(template: Template) -> _CodeField:
    """Directions and frequency of the ridges of a template that is not empty. Raises BadInput if the template is empty.

    Source: Bigun and Granlund 1987, Optimal orientation detection of linear symmetry; Cappelli 2011, Fast and accurate
    fingerprint indexing based on ridge orientation and frequency.
    """
    require(not template.empty, "a failure to acquire has no ridges; test template.empty first.")
    pitch = template.pitch_mm
    valid = template.valid.astype(np.uint8)
    value = gaussian_mean(template.value(), 0.6)
    # gradients beside the border of the valid skin are those of the border
    inside = cv2.erode(valid, np.ones((5, 5), np.uint8), borderValue=0).astype(np.float32)
    right = cv2.sepFilter2D(value, cv2.CV_32F, _DERIVATIVE, _HERE) * inside
    up = cv2.sepFilter2D(value, cv2.CV_32F, _HERE, _DERIVATIVE) * -inside
    parts = (right * right, up * up, right * up, value * value * inside, inside)
    small = max(1, valid.shape[1] // _REDUCED), max(1, valid.shape[0] // _REDUCED)
    sigma = _WINDOW_MM / (pitch * _REDUCED)
    xx, yy, xy, power, weight = (
        gaussian_mean(np.asarray(cv2.resize(part, small, interpolation=cv2.INTER_AREA)), sigma) for part in parts
    )
    total = np.maximum(xx + yy, np.float32(1e-6))
    frequency = 0.5 * np.log(total / np.maximum(power, np.float32(1e-6)))
    frequency -= np.float32(np.log(pitch / 0.1))
    # creases and folds look like ridges, but for their width
    usual = float(np.median(frequency[weight > 0.5])) if bool((weight > 0.5).any()) else 0.0
    strange = np.abs(frequency - usual) / _STRANGE
    weight = weight * np.clip(2.0 - strange, 0.0, 1.0)
    maps = np.stack([(xx - yy) / total, 2 * xy / total, frequency, weight])
    column, row = origin_of(template)
    scale = small[0] / valid.shape[1], small[1] / valid.shape[0]
    origin = (column + 0.5) * scale[0] - 0.5, (row + 0.5) * scale[1] - 0.5
    return _CodeField(maps.astype(np.float32), origin, pitch * _REDUCED)


def origin_of(template: Template) -> tuple[float, float]:
    """Column of the finger's middle and row of its uppermost skin: the origin of its frame, pixels of the template."""
    valid, pitch = template.valid, template.pitch_mm
    broad = np.flatnonzero(valid.sum(axis=1) >= min(2.0 / pitch, 0.5 * valid.sum(axis=1).max()))
    top = int(broad[0])
    rows = valid[top + round(3.0 / pitch) : top + round(14.0 / pitch)]
    rows = rows[rows.any(axis=1)]
    if not len(rows):
        rows = valid[valid.any(axis=1)]
    first = rows.argmax(axis=1)
    last = rows.shape[1] - 1 - rows[:, ::-1].argmax(axis=1)
    return float(np.mean(first + last)) / 2, float(top)


def laid_on(probe: Template, other: Template, turn_rad: float, right_mm: float, down_mm: float) -> NDArray[np.float64]:
    """(2, 3) matrix from (column, row, 1) in the probe to the other template, for a variant of :func:`sampled`."""
    pitch = probe.pitch_mm
    cos, sin = np.cos(turn_rad), np.sin(turn_rad)
    turn = np.array([[cos, sin], [-sin, cos]])
    below = np.array([0.0, _TURN_MM / pitch])
    shift = np.array([right_mm, down_mm]) / pitch
    target = np.array(origin_of(other)) + below + shift
    return np.hstack([turn, (target - turn @ (np.array(origin_of(probe)) + below))[:, None]])


def sampled(
    field: _CodeField, turn_rad: NDArray[np.float64], right_mm: NDArray[np.float64], down_mm: NDArray[np.float64]
) -> tuple[FloatArray, FloatArray]:
    """Channels (V, CHANNELS, CELLS) and weights (V, CELLS), 0 to 1, on the grid of a code, of a finger that is turned
    by `turn_rad` (V,), counter-clockwise as seen, and then shifted by `right_mm` and `down_mm` (V,).
    """
    x = (np.arange(COLUMNS) - (COLUMNS - 1) / 2) * STEP_MM
    y = (1.0 + np.arange(ROWS)) * STEP_MM
    gx = np.tile(x, ROWS)[None, :] - right_mm[:, None]
    gy = np.repeat(y, COLUMNS)[None, :] - down_mm[:, None] - _TURN_MM
    cos, sin = np.cos(turn_rad)[:, None], np.sin(turn_rad)[:, None]
    columns = field.origin_px[0] + (cos * gx - sin * gy) / field.pitch_mm
    rows = field.origin_px[1] + (sin * gx + cos * gy + _TURN_MM) / field.pitch_mm
    there = columns.astype(np.float32), rows.astype(np.float32)
    cosine, sine, frequency, weight = (
        cv2.remap(plane, *there, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0.0)
        for plane in field.maps
    )
    two_cos, two_sin = np.cos(2 * turn_rad)[:, None], np.sin(2 * turn_rad)[:, None]
    channels = np.stack([two_cos * cosine - two_sin * sine, two_sin * cosine + two_cos * sine, frequency], axis=1)
    return channels.astype(np.float32), np.clip(np.asarray(weight, dtype=np.float32), 0.0, 1.0)


CODE_VERSION = 1
"""Version of the code: codes of different versions cannot be compared. It rises with every change of field or model."""
SCALE = 360.0
"""A code is the direction of the latent numbers times this, rounded; longer numbers than 127 are cut (hardly any)."""
_FILE = Path(__file__).with_name("code_model.npz")

_TURN_STEP_DEG = 5.0
"""Between two turns."""
_STEP_MM = 1.0
"""Between two shifts."""


@dataclass(frozen=True, slots=True)
class ProbeSettings(Checked):
    """The variants of a probe."""

    turn_deg: Annotated[float, Limits(0)] = 10.0
    """Largest turn."""
    right_mm: Annotated[float, Limits(0)] = 1.0
    """Largest shift across."""
    down_mm: Annotated[float, Limits(0)] = 1.0
    """Largest shift along."""

    def __post_init__(self) -> None:
        check_fields(self)
        require(self.count <= 10_000, f"a probe would have {self.count} variants; at most 10000 go.")

    @property
    def count(self) -> int:
        """Variants."""
        return int(np.prod([len(_steps(*pair)) for pair in self._pairs()]))

    def variants(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """(V,) turns in radians, shifts to the right and shifts down in millimetres."""
        turns, right, down = np.meshgrid(*(_steps(*pair) for pair in self._pairs()), indexing="ij")
        return np.deg2rad(turns.ravel()), right.ravel(), down.ravel()

    def coarse(self) -> NDArray[np.int64]:
        """Numbers of the few variants of which a search through millions compares bits.

        Every second one of each kind, and of those that are not turned all that are shifted one way only: bits, unlike
        the finer numbers, bear half a step of any of them. On true surfaces of 50 fingers these seven of 45 did as well
        as all; turns alone (five) did not, as a finger rolls.
        """
        steps = (np.deg2rad(_TURN_STEP_DEG), _STEP_MM, _STEP_MM)
        turn, right, down = (np.rint(moved / step) for moved, step in zip(self.variants(), steps, strict=True))
        second = (turn % 2 == 0) & (right % 2 == 0) & (down % 2 == 0)
        return np.flatnonzero(second | ((turn == 0) & ((right == 0) | (down == 0))))

    def _pairs(self) -> tuple[tuple[float, float], ...]:
        return ((self.turn_deg, _TURN_STEP_DEG), (self.right_mm, _STEP_MM), (self.down_mm, _STEP_MM))


def _steps(limit: float, step: float) -> NDArray[np.float64]:
    count = int(np.floor(limit / step + 1e-9))
    return step * np.arange(-count, count + 1, dtype=np.float64)


@lru_cache(maxsize=1)
def code_model() -> FactorModel:
    """Read the model that is shipped (once)."""
    with np.load(_FILE, allow_pickle=False) as arrays:
        require(int(arrays["version"]) == CODE_VERSION, f"{_FILE.name} is of another version; install splitknit again.")
        return FactorModel(*(arrays[name].astype(np.float32) for name in ("mean", "loading", "noise")))


def code_size() -> int:
    """Bytes of a code."""
    return code_model().size


def code_of(template: Template) -> NDArray[np.int8]:
    """Code (K,) int8 of a gallery finger, K = :func:`code_size`; zeros for a failure to acquire, which is never found.

    It reveals roughly how a finger's ridges run, and should be protected like the template. Source: Cappelli 2011, Fast
    and accurate fingerprint indexing based on ridge orientation and frequency (what is described); Prince and Elder
    2007, Probabilistic linear discriminant analysis (how it is reduced).
    """
    if template.empty:
        return np.zeros(code_size(), dtype=np.int8)
    still = np.zeros(1)
    directions = _directions(*sampled(code_field(template), still, still, still))[0]
    return np.asarray(np.clip(np.rint(SCALE * directions), -127, 127), dtype=np.int8)


def probe_codes(template: Template, settings: ProbeSettings | None = None) -> FloatArray:
    """(V, K) float32 variants of a probe, so scaled that the product with a finger's own code is about 1.

    They are in steps (:func:`in_steps`), so that a product with a code is the same in whatever order it is summed.
    Raises BadInput if the template is a failure to acquire.
    """
    settings = settings or ProbeSettings()
    require(not template.empty, "the probe is a failure to acquire; lay the finger down again.")
    return in_steps(_directions(*sampled(code_field(template), *settings.variants())) / SCALE)


def in_steps(variants: NDArray[Any]) -> FloatArray:
    """Round variants to multiples of 2 ** -23, a thousandth of their size.

    A product with a code, whose length is `SCALE`, is then at most 2 ** 23 such steps and something, and every part of
    its sum is a whole number of them: single precision holds it without rounding. Rounded sums would differ with the
    number of codes and threads, and with them which of two fingers that are almost equally similar comes first.
    """
    return np.asarray(np.ldexp(np.rint(np.ldexp(variants, 23)), -23), dtype=np.float32)


def _directions(channels: FloatArray, weights: FloatArray) -> NDArray[np.float64]:
    """(V, K) unit vectors."""
    found = code_model().latent(channels, weights)
    return np.asarray(found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), 1e-9))


# Latent numbers of a finger from a partly seen ridge field: a factor model.
#
# A field x (channels on a grid, D numbers) of a finger is taken as x = mean + loading z + noise, with K latent numbers
# z of the finger (standard normal over fingers) and noise of each number that differs between impressions
# (deformation, what is left of the alignment). Where nothing was seen, the noise is infinite. The posterior mean of z
# is what a code keeps: it does not depend on which part was seen, but for being less certain.
#
# Source: Rubin and Thayer 1982, EM algorithms for ML factor analysis (the model); Prince and Elder 2007, Probabilistic
# linear discriminant analysis for inferences about identity.


@dataclass(frozen=True, eq=False)
class FactorModel:
    """Mean, loading and noise; of C channels in M cells."""

    mean: FloatArray
    """(C, M)."""
    loading: FloatArray
    """(C, M, K)."""
    noise: FloatArray
    """(C, M) variance."""

    def __post_init__(self) -> None:
        same = self.mean.shape == self.noise.shape == self.loading.shape[:2]
        require(same and self.loading.ndim == 3, "mean, loading and noise of a factor model must have equal shapes.")
        require(bool((self.noise > 0).all()), "the noise of a factor model must be positive.")

    @property
    def size(self) -> int:
        """Latent numbers."""
        return int(self.loading.shape[2])

    @cached_property
    def _weighted(self) -> NDArray[np.float64]:
        """(C M, K) loading over noise."""
        return (self.loading / self.noise[:, :, None].astype(np.float64)).reshape(-1, self.size)

    @cached_property
    def _upper(self) -> list[tuple[int, int, FloatArray]]:
        """What each cell adds to the precision of z, a band of rows of the upper triangle at a time: first and last
        row, and an array (M, rows columns).
        """
        right = np.ascontiguousarray(self.loading.transpose(1, 0, 2))
        left: FloatArray = (right / self.noise.T[:, :, None]).transpose(0, 2, 1)
        limits = np.unique(np.linspace(0, self.size, 17).astype(int)).tolist()
        return [
            (first, last, np.asarray(left[:, first:last] @ right[:, :, first:], np.float32).reshape(len(right), -1))
            for first, last in itertools.pairwise(limits)
        ]

    def latent(self, channels: FloatArray, weights: FloatArray) -> NDArray[np.float64]:
        """Posterior means (N, K) of z, for N fields (N, C, M) with weights (N, M).

        Precisions are summed and factorised in single precision, whose rounding depends on the number of threads; the
        means are then refined until nothing of that is left (Wilkinson 1963, Rounding errors in algebraic processes).
        """
        size, factors = self.size, np.empty((len(channels), self.size, self.size), dtype=np.float32)
        for first, last, band in self._upper:
            factors[:, first:last, first:] = (weights @ band).reshape(-1, last - first, size - first)
        factors[:, np.arange(size), np.arange(size)] += 1
        for factor in factors:  # symmetric and positive definite: Cholesky's
            _, failed = scipy.linalg.lapack.spotrf(factor.T, lower=True, clean=False, overwrite_a=True)
            require(failed == 0, "the ridge field of a probe is not finite.")
        shares = np.repeat(weights[:, None, :], len(self.mean), axis=1).reshape(len(weights), -1).astype(np.float64)
        loading = self.loading.reshape(-1, size).astype(np.float64)
        seen = shares * (channels - self.mean).reshape(len(channels), -1)
        means = np.zeros((len(channels), size))
        for _ in range(3):
            left = (seen - shares * (means @ loading.T)) @ self._weighted - means
            for number, factor in enumerate(factors):
                half = scipy.linalg.blas.strsv(factor.T, left[number], lower=True)
                means[number] += scipy.linalg.blas.strsv(factor.T, half, lower=True, trans=1)
        return means
