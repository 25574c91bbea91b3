"""Whether the LEDs still are as bright as they were calibrated: from any photographs of a matt surface.

Under L lights a matt pixel obeys I_k = g_k l_k . b with its albedo times normal b (3 numbers) and gains g_k that are
one if the calibration holds. L - 3 numbers a pixel are left over, and the gains are the same for all pixels, so that
they show. Not all of them: a common factor is the albedo, and on a flat surface under a ring of LEDs a pattern that
runs as the cosine or sine of the LEDs' azimuth looks exactly like a tilt of the surface. Curvature separates it from a
tilt, but only by the square of the slopes, where cast shadows, gloss and light that is scattered in skin matter more
than the gains do. How much of its information a pattern of gains keeps when every pixel may choose its own b is an
eigenvalue between 0 and 1 (on a finger 0, 0.01, 0.02, and four above 0.7); patterns that keep too little are left out,
and the answer is only about the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import check_mask, check_stack, require

# Gains of LEDs and the surface they light, separated: the best surface for given gains, patterns that show.

_LIMIT_PERCENT = 3.0
"""An LED has drifted if it departs by more."""
_MAX_PIXELS = 5_000
"""Pixels that are used, on a regular grid."""
_DARK = 0.15
"""An image shadows a pixel if it is darker than this fraction of the pixel's median image."""
_ROBUST_SIGMAS = 2.0
"""Residuals beyond this many deviations count less and less (Cauchy's weights): gloss, soft shadows."""
_MIN_INFORMATION = 0.2
"""Patterns of gains that keep less of their information are left out."""
_BLOCK_PX = 24
"""Squares of this side count as independent in standard errors: what is not matt is similar from pixel to pixel."""
_MIN_EXPLAINED = 0.6
"""A single LED is named if it explains this fraction of the departure."""
_ROUNDS = 15
"""Iterations of weights and gains."""


@dataclass(frozen=True, slots=True, eq=False)
class _Samples:
    light: Array
    """(L, P) brightness; the mean over the LEDs is one at every pixel."""
    vectors: Array
    """(P, L, 3)."""
    lit: NDArray[np.bool_]
    """(L, P) whether the LED lights the pixel, not its shadow."""
    block: NDArray[np.intp]
    """(P,) number of the square that a pixel lies in."""


@dataclass(frozen=True, slots=True, eq=False)
class _SurfaceState:
    """Surface and information at some gains."""

    residual: Array
    """(P, L)."""
    score: Array
    """(P, L) weighted residual times g l . b: derivative by relative gains."""
    information: Array
    """(L, L)."""
    known: Array
    """(L,) diagonal of the information if the surface were known."""


def _drift_samples(stack: Any, light_vectors: Any, mask: Any) -> _Samples:
    images = check_stack(stack, least=5)
    count, height, width = images.shape
    inside = check_mask(mask, (height, width))
    vectors = np.asarray(light_vectors, dtype=np.float64)
    shapes = (count, 3), (count, 3, height, width)
    other = f"light_vectors must have the shape {shapes[0]} or {shapes[1]}, but it has {vectors.shape}."
    require(vectors.shape in shapes, other)
    step = max(1, int(np.sqrt(inside.sum() / _MAX_PIXELS)))
    rows, columns = np.nonzero(inside[::step, ::step])
    rows, columns = rows * step, columns * step
    light = images[:, rows, columns].astype(np.float64)
    lit = light > np.maximum(_DARK * np.median(light, axis=0), 1e-12)
    good = lit.sum(axis=0) >= 5
    dark = f"only {int(good.sum())} pixels are lit by five LEDs or more; the LEDs' brightness is undetermined."
    require(int(good.sum()) >= 100, dark)
    rows, columns = rows[good], columns[good]
    light, lit = light[:, good], lit[:, good]
    light = light / np.where(lit, light, 0.0).sum(axis=0) * lit.sum(axis=0)
    if vectors.ndim == 2:
        own = np.broadcast_to(vectors, (len(rows), count, 3))
    else:
        own = vectors[:, :, rows, columns].transpose(2, 0, 1)
    own = own / float(np.linalg.norm(own, axis=2).mean())
    side = _BLOCK_PX
    block = rows // side * (width // side + 1) + columns // side
    return _Samples(light, np.ascontiguousarray(own), lit, np.unique(block, return_inverse=True)[1])


def _project_surface(samples: _Samples, gain: Array, weight: Array) -> _SurfaceState:
    """Best surface of every pixel, and what it leaves."""
    scaled = samples.vectors * gain[None, :, None]  # (P, L, 3)
    trust = weight.T
    weighted = scaled * trust[..., None]
    normal = np.einsum("pld,ple->pde", weighted, scaled)
    normal += 1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    inverse = np.linalg.inv(normal)
    surface = np.einsum("pde,ple,pl->pd", inverse, weighted, samples.light.T)
    predicted = np.einsum("pld,pd->pl", scaled, surface)
    residual = samples.light.T - predicted
    lean = weighted * predicted[..., None]  # (P, L, 3)
    information = np.diag((predicted**2 * trust).sum(axis=0)) - np.einsum("pld,pde,pme->lm", lean, inverse, lean)
    return _SurfaceState(residual, predicted * trust * residual, information, (predicted**2 * trust).sum(axis=0))


def _robust_deviation(residual: Array) -> float:
    """Standard deviation by the median, never zero."""
    return max(1.4826 * float(np.median(np.abs(residual))), 1e-6)


def _gain_patterns(state: _SurfaceState) -> tuple[Array, Array]:
    """Eigenpatterns p of relative gains, M p = fraction M_0 p, p^T M_0 p = 1, rows of (L, L); fractions, ascending."""
    root = 1.0 / np.sqrt(np.maximum(state.known, 1e-12 * float(state.known.max())))
    fractions, vectors = np.linalg.eigh(root[:, None] * state.information * root[None, :])
    return (vectors * root[:, None]).T, np.clip(fractions, 0.0, 1.0)


def _gain_solver(patterns: Array, fractions: Array) -> Array:
    """(L, L) from the score to relative gains, what is undetermined left as it is."""
    kept = fractions >= _MIN_INFORMATION
    return np.asarray(patterns[kept].T @ (patterns[kept] / fractions[kept, None]))


Array = NDArray[np.float64]
_MODEL_ERROR = 0.003
"""Errors of the gains below which nothing is reported, whatever the number of pixels: no surface is that matt."""


@dataclass(frozen=True, slots=True, eq=False)
class _LedDrift:
    """Gains of the LEDs against their calibration, as far as they show."""

    gain: Array
    """(L,) estimated gains, one in the mean of their logarithms: the observable part of the departure, the rest taken
    as zero. A single LED that drifted shows here with part of its departure, and the others with some of the opposite
    sign."""
    error: Array
    """(L,) standard errors of that."""
    observable: Array
    """(R, L) orthonormal patterns that are determined, R of them; patterns across them are unknown."""
    information: Array
    """(L,) fraction of its information each eigenpattern keeps, ascending; the first is the common factor's zero."""
    suspect: int | None
    """The LED that alone explains the pattern best, beyond the limit and three errors; else None."""
    suspect_gain: float
    """Gain of the best single LED, the others as calibrated."""
    explained: float
    """Fraction of the pattern's departure (squared, in errors) that the single LED explains."""
    residual_percent: float
    """Robust deviation of the images from a matt surface after the fit."""


def led_drift(stack: Any, light_vectors: Any, mask: Any = None) -> _LedDrift:
    """Relative brightness of every LED against its calibration, from one capture of any matt surface.

    Minimises sum w_kp (I_kp - g_k l_kp . b_p)^2, pixels by their mean brightness, over all b_p and g: b_p in closed
    form, g by Gauss and Newton's steps on what is left (variable projection). With A_p = (g_k l_kp), W_p = diag(w_kp)
    and m_p = A_p b_p the matrix of information of the relative gains is M = sum_p diag(m_p) (W_p - W_p A_p (A_p^T W_p
    A_p)^-1 A_p^T W_p) diag(m_p), against M_0 = sum_p diag(m_p^2 w_p) for a known surface; the eigenvalues of M_0^-1/2 M
    M_0^-1/2 are the fractions of information. Raises BadInput if shapes disagree, the lights are fewer than five (four
    without a degree of freedom to spare), or hardly any pixel is lit by all of them. Source: G. Golub and V. Pereyra,
    "Separable nonlinear least squares: the variable projection method", Inverse Problems 19 (2003). P. N. Belhumeur, D.
    J. Kriegman and A. L. Yuille, "The bas-relief ambiguity", IJCV 35 (1999), for what lights of unknown strength leave
    open. `stack`: (L, H, W) linear light, five images at least; `light_vectors`: (L, 3) or (L, 3, H, W), towards the
    lights, of the length of their calibrated irradiance; `mask`: (H, W) bool.
    """
    samples = _drift_samples(stack, light_vectors, mask)
    gain = np.ones(len(samples.light))
    weight = samples.lit.astype(np.float64)
    for _ in range(_ROUNDS):
        state = _project_surface(samples, gain, weight)
        scale = _ROBUST_SIGMAS * _robust_deviation(state.residual[samples.lit.T])
        weight = np.asarray((samples.lit.T / (1 + (state.residual / scale) ** 2)).T)  # Cauchy's
        state = _project_surface(samples, gain, weight)
        patterns, fractions = _gain_patterns(state)
        step = _gain_solver(patterns, fractions) @ state.score.sum(axis=0)
        gain = gain * (1 + np.clip(step, -0.3, 0.3))
        gain /= gain.mean()
        if float(np.abs(step).max()) < 1e-4:
            break
    return _judge(samples, gain, weight)


def drift_words(drift: _LedDrift, names: Sequence[str]) -> list[str]:
    """What departs, in sentences; none where nothing does. `names`: of the LEDs, such as ``white 3``."""
    remedy = "photograph the white card again (splitknit calibrate radiometry)."
    if drift.suspect is not None:
        change = f"{100 * abs(drift.suspect_gain - 1):.0f} % {'darker' if drift.suspect_gain < 1 else 'brighter'}"
        return [f"LED {names[drift.suspect]} is {change} than at the calibration, by this capture; {remedy}"]
    worst = int(np.argmax(np.abs(drift.gain - 1)))
    departure = 100 * abs(float(drift.gain[worst]) - 1)
    if departure <= _LIMIT_PERCENT or departure <= 300 * float(drift.error[worst]):
        return []
    least = f"LED {names[worst]} by {departure:.0f} % at least"
    return [f"several LEDs depart from the calibration, {least}, by this capture; {remedy}"]


def _judge(samples: _Samples, gain: Array, weight: Array) -> _LedDrift:
    state = _project_surface(samples, gain, weight)
    patterns, fractions = _gain_patterns(state)
    solver = _gain_solver(patterns, fractions)
    hidden = np.linalg.qr(patterns[fractions < _MIN_INFORMATION].T)[0]  # (L, L - R)
    shown = np.linalg.svd(np.eye(len(gain)) - hidden @ hidden.T)[0][:, : len(gain) - hidden.shape[1]].T
    scores = np.zeros((int(samples.block.max()) + 1, len(gain)))
    np.add.at(scores, samples.block, state.score)
    spread = solver @ (scores.T @ scores) @ solver.T
    observed = shown @ np.log(gain)
    covariance = shown @ spread @ shown.T + _MODEL_ERROR**2 * np.eye(len(shown))
    suspect, value, error, explained = _single(shown, observed, covariance)
    drifted = abs(np.expm1(value)) > 0.01 * _LIMIT_PERCENT and abs(value) > 3 * error
    return _LedDrift(
        gain=np.exp(shown.T @ observed),
        error=np.sqrt(np.maximum(np.diag(shown.T @ covariance @ shown), 0.0)),
        observable=shown,
        information=fractions,
        suspect=suspect if drifted and explained >= _MIN_EXPLAINED else None,
        suspect_gain=float(np.exp(value)),
        explained=explained,
        residual_percent=100 * _robust_deviation(state.residual[samples.lit.T]),
    )


def _single(shown: Array, departure: Array, covariance: Array) -> tuple[int, float, float, float]:
    """LED that alone explains `departure` (R,) best: its number, its relative departure, the error, the fraction."""
    if len(shown) == 0:
        return 0, 0.0, float("inf"), 0.0
    inverse = np.linalg.inv(covariance)
    total = float(departure @ inverse @ departure)
    best = (0, 0.0, float("inf"), -1.0)
    for k in range(shown.shape[1]):
        own = shown[:, k]
        weight = float(own @ inverse @ own)
        value = float(own @ inverse @ departure) / weight
        fraction = value * value * weight / max(total, 1e-30)
        if fraction > best[3]:
            best = (k, value, float(1 / np.sqrt(weight)), fraction)
    return best
