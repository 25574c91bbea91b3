"""Whether the LEDs still are as bright as they were calibrated: from any photographs of a matt surface.

Under L lights a matt pixel obeys I_k = g_k l_k . b with its albedo times normal b (3 numbers) and gains g_k that are
one if the calibration holds. L - 3 numbers a pixel are left over, and the gains are the same for all pixels, so that
they show. Not all of them: a common factor is the albedo, and on a flat surface under a ring of LEDs a pattern that
runs as the cosine or sine of the LEDs' azimuth looks exactly like a tilt of the surface. Curvature tells it from a
tilt, but only by the square of the slopes, where cast shadows, gloss and light that wanders in skin say more than the
gains do. How much of its information a pattern of gains keeps when every pixel may choose its own b is an eigenvalue
between 0 and 1 (on a finger 0, 0.01, 0.02, and four above 0.7); patterns that keep too little are left out, and the
answer is only about the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.calibration.drift_surface import (
    DriftSettings,
    Samples,
    drift_samples,
    gain_patterns,
    gain_solver,
    project_surface,
    robust_deviation,
    robust_weights,
)

Array = NDArray[np.float64]
_MODEL_ERROR = 0.003
"""Errors of the gains below which nothing is told, whatever the number of pixels: no surface is that matt."""


@dataclass(frozen=True, slots=True, eq=False)
class LedDrift:
    """Gains of the LEDs against their calibration, as far as they show."""

    gain: Array
    """(L,) estimated gains, one in the mean of their logarithms: the observable part of the departure, the rest taken
    as zero. A single LED that drifted shows here with part of its departure, and the others with some of the opposite
    sign."""
    error: Array
    """(L,) standard errors of that."""
    observable: Array
    """(R, L) orthonormal patterns that can be told, R of them; patterns across them are unknown."""
    information: Array
    """(L,) share of its information that each eigenpattern keeps, ascending; the first is the common factor's zero."""
    suspect: int | None
    """The LED whose departure alone explains the pattern best, if that departure is beyond the limit and more than
    three errors; else None."""
    suspect_gain: float
    """Gain of the best single LED, the others as calibrated."""
    suspect_error: float
    explained: float
    """Share of the pattern's departure (squared, in errors) that the single LED explains."""
    residual_percent: float
    """Robust deviation of the images from a matt surface after the fit."""


def led_drift(
    stack: Any, light_vectors: Any, mask: Any = None, normals: Any = None, settings: DriftSettings | None = None
) -> LedDrift:
    """Relative brightness of every LED against its calibration, from one capture of any matt surface.

    Parameters
    ----------
    stack : (L, H, W) linear light, five images at least
    light_vectors : (L, 3) or (L, 3, H, W)
        Towards the lights, of the length of their calibrated irradiance.
    mask : (H, W) bool, optional
    normals : (H, W, 3), optional
        Where the surface is known. All patterns but the common factor can then be told.
    settings : DriftSettings, optional

    Returns
    -------
    LedDrift

    Raises
    ------
    BadInput
        If shapes disagree, the lights are fewer than five (four without a degree of freedom to spare), or hardly any
        pixel is lit by all of them.

    Notes
    -----
    Minimises sum w_kp (I_kp - g_k l_kp . b_p)^2, pixels by their mean brightness, over all b_p and g: b_p in closed
    form, g by Gauss and Newton's steps on what is left (variable projection). With A_p = (g_k l_kp), W_p = diag(w_kp)
    and m_p = A_p b_p the matrix of information of the relative gains is
    M = sum_p diag(m_p) (W_p - W_p A_p (A_p^T W_p A_p)^-1 A_p^T W_p) diag(m_p), against M_0 = sum_p diag(m_p^2 w_p) for
    a known surface; the eigenvalues of M_0^-1/2 M M_0^-1/2 are the shares of information.

    References
    ----------
    G. Golub and V. Pereyra, "Separable nonlinear least squares: the variable projection method", Inverse Problems 19
    (2003). P. N. Belhumeur, D. J. Kriegman and A. L. Yuille, "The bas-relief ambiguity", IJCV 35 (1999), for what
    lights of unknown strength leave open.
    """
    chosen = settings or DriftSettings()
    samples = drift_samples(stack, light_vectors, mask, normals, chosen)
    gain = np.ones(len(samples.light))
    weight = samples.lit.astype(np.float64)
    for _ in range(chosen.rounds):
        state = project_surface(samples, gain, weight)
        weight = robust_weights(samples, state, chosen)
        state = project_surface(samples, gain, weight)
        patterns, shares = gain_patterns(state)
        step = gain_solver(patterns, shares, chosen) @ state.score.sum(axis=0)
        gain = gain * (1 + np.clip(step, -0.3, 0.3))
        gain /= gain.mean()
        if float(np.abs(step).max()) < 1e-4:
            break
    return _judge(samples, gain, weight, chosen)


def drift_words(drift: LedDrift, names: Sequence[str], settings: DriftSettings | None = None) -> list[str]:
    """Say in sentences what departs; none where nothing does.

    Parameters
    ----------
    drift : LedDrift
    names : of the LEDs, such as ``white 3``
    settings : DriftSettings, optional
    """
    limit = (settings or DriftSettings()).limit_percent
    if drift.suspect is not None:
        change = 100 * abs(drift.suspect_gain - 1)
        word = "darker" if drift.suspect_gain < 1 else "brighter"
        return [
            f"LED {names[drift.suspect]} is {change:.0f} % {word} than at the calibration, by this capture; photograph "
            f"the white card again (splitknit calibrate radiometry --check)."
        ]
    worst = int(np.argmax(np.abs(drift.gain - 1)))
    departure = 100 * abs(float(drift.gain[worst]) - 1)
    if departure <= limit or departure <= 300 * float(drift.error[worst]):
        return []
    return [
        f"several LEDs depart from the calibration, LED {names[worst]} by {departure:.0f} % at least, by this capture; "
        f"photograph the white card again (splitknit calibrate radiometry --check)."
    ]


def _judge(samples: Samples, gain: Array, weight: Array, settings: DriftSettings) -> LedDrift:
    state = project_surface(samples, gain, weight)
    patterns, shares = gain_patterns(state)
    solver = gain_solver(patterns, shares, settings)
    hidden = np.linalg.qr(patterns[shares < settings.least_information].T)[0]  # (L, L - R)
    shown = np.linalg.svd(np.eye(len(gain)) - hidden @ hidden.T)[0][:, : len(gain) - hidden.shape[1]].T
    scores = np.zeros((int(samples.block.max()) + 1, len(gain)))
    np.add.at(scores, samples.block, state.score)
    spread = solver @ (scores.T @ scores) @ solver.T
    seen = shown @ np.log(gain)
    covariance = shown @ spread @ shown.T + _MODEL_ERROR**2 * np.eye(len(shown))
    suspect, value, error, explained = _single(shown, seen, covariance)
    drifted = abs(np.expm1(value)) > 0.01 * settings.limit_percent and abs(value) > 3 * error
    return LedDrift(
        gain=np.exp(shown.T @ seen),
        error=np.sqrt(np.maximum(np.diag(shown.T @ covariance @ shown), 0.0)),
        observable=shown,
        information=shares,
        suspect=suspect if drifted and explained >= settings.least_explained else None,
        suspect_gain=float(np.exp(value)),
        suspect_error=error,
        explained=explained,
        residual_percent=100 * robust_deviation(state.residual[samples.lit.T]),
    )


def _single(shown: Array, departure: Array, covariance: Array) -> tuple[int, float, float, float]:
    """LED that alone explains `departure` (R,) best: its number, its relative departure, the error, the share."""
    if len(shown) == 0:
        return 0, 0.0, float("inf"), 0.0
    inverse = np.linalg.inv(covariance)
    total = float(departure @ inverse @ departure)
    best = (0, 0.0, float("inf"), -1.0)
    for k in range(shown.shape[1]):
        own = shown[:, k]
        weight = float(own @ inverse @ own)
        value = float(own @ inverse @ departure) / weight
        share = value * value * weight / max(total, 1e-30)
        if share > best[3]:
            best = (k, value, float(1 / np.sqrt(weight)), share)
    return best
