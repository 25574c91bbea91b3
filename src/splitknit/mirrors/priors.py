"""What is expected without any outline, what the skin's slopes say, and how far points of an outline are believed."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from splitknit.mirrors.settings import ANGLE_DEG, OFFSET_MM, MirrorShapeSettings
from splitknit.mirrors.state import SeenIn, Slopes, State

_SLOPE_ERROR = 0.1
"""Standard deviation of a measured slope of the skin; skin that scatters light looks flatter than it is."""

Array = NDArray[np.float64]

SHEAR_SD = 0.05
"""Standard deviation of the shear: a roll by 8 deg gives about 0.045."""
INDEPENDENT_SLOPES = 20.0
"""Slopes err together: at glare, and where light by way of a mirror ends."""
TIP_SD_MM = 0.05
"""Standard deviation of the tip's place as the front view's outline has it."""


def add_priors(  # noqa: PLR0917
    normal: Array,
    right: Array,
    state: State,
    names: list[tuple[str, float]],
    mirrors: Mapping[str, SeenIn],
    tip_mm: float,
    settings: MirrorShapeSettings,
    count: int,
) -> None:
    """What is expected without any outline: smooth lines, sections of like form, mirrors near their nominal poses."""
    body = state.body
    smooth = (0.4, 0.4, 0.6, 0.6)  # mm, standard deviation of third differences of t, z, A and B
    third = np.diff(np.eye(count), 3, axis=0)
    for k, rough in enumerate(smooth):
        of_line = slice(k * count, (k + 1) * count)
        normal[of_line, of_line] += third.T @ third / rough**2
        right[of_line] -= third.T @ (third @ body.coefficients[k]) / rough**2
    # B over A is even along the finger: it holds where one edge of a mirror's view is missing
    ratio = float(np.sum(body.coefficients[3]) / np.sum(body.coefficients[2]))
    apart = body.coefficients[3] - ratio * body.coefficients[2]
    part = np.arange(3 * count, 4 * count)
    normal[part, part] += 1.0
    right[part] -= apart
    expected = {
        "squareness": (settings.squareness - body.squareness, settings.squareness_spread),
        "shear": (-body.shear, SHEAR_SD),
        "shear_slope": (-body.shear_slope, 0.3 * SHEAR_SD),
        "tip_mm": (tip_mm - body.tip_mm, TIP_SD_MM),
    }
    for k, (name, _) in enumerate(names):
        kind, _, mirror = name.partition(" ")
        if mirror:
            pose = state.poses[mirror]
            spread = OFFSET_MM if kind == "shift_mm" else np.deg2rad(ANGLE_DEG)
            away = -getattr(pose, kind)
            told = mirrors[mirror].turn_sd_rad
            if kind == "turn_rad" and told is not None:
                away, spread = away + mirrors[mirror].turn_rad, told
        else:
            away, spread = expected[kind]
        normal[4 * count + k, 4 * count + k] += 1.0 / spread**2
        right[4 * count + k] += away / spread**2


def add_slopes(  # noqa: PLR0917
    normal: Array,
    right: Array,
    state: State,
    names: list[tuple[str, float]],
    slopes: Slopes,
    count: int,
) -> None:
    """The skin's slopes across the finger, as far as squareness and shear answer to them."""
    chosen = [k for k, (name, _) in enumerate(names) if name in ("squareness", "shear", "shear_slope")]
    if not chosen:
        return
    from splitknit.mirrors.dense import slopes_across  # noqa: PLC0415 - it needs bodies, too

    residual = slopes_across(state.body, slopes)
    good = np.isfinite(residual)
    columns = []
    for k in chosen:
        name, size = names[k]
        columns.append((slopes_across(state.moved(name, size).body, slopes) - residual) / size)
    jacobian = np.column_stack(columns)
    good &= np.isfinite(jacobian).all(axis=1)
    if int(good.sum()) < 20:
        return
    weight = tukey(residual[good], 4.0 * _SLOPE_ERROR) / _SLOPE_ERROR**2
    weight *= INDEPENDENT_SLOPES / max(int(good.sum()), 1)
    part = jacobian[good]
    where = 4 * count + np.asarray(chosen)
    normal[np.ix_(where, where)] += part.T @ (weight[:, None] * part)
    right[where] -= part.T @ (weight * residual[good])


def robust_weights(residual: Array, ends: Array, sigma: float, *, sure: bool) -> Array:
    """Weights of the outlines' points, each view with its own scale; milder ones before the fit is `sure`."""
    parts = []
    for part in np.split(residual, ends):
        size = np.abs(part)
        scale = max(sigma, 1.4826 * float(np.median(size)))
        if sure:
            parts.append(tukey(part, 4.685 * scale))
        else:  # Huber
            parts.append(np.where(size >= 5.0, 0.0, np.minimum(1.0, 1.345 * scale / np.maximum(size, 1e-9))))
    return np.concatenate(parts)


def tukey(residual: Array, limit: float) -> Array:
    """Tukey's biweight: one at zero, nothing from `limit` on."""
    return np.asarray(np.clip(1.0 - (residual / limit) ** 2, 0.0, None) ** 2)
