"""The LEDs from nail and shadow tips by least squares: all rows at once, the nail's height unknown.

Seen from above, an LED at (p, z), a nail that stands at n with its tip at the height h, and the tip t of its shadow on
the finger plane obey

    t = n + (n - p) h / (z - h).

Unknown are every LED's p and z, where the nail stood, its height (one for all positions, as it is one nail), and by how
much the circle's centre, radius and height are other than measured. Known are the tips and the nail in pixels, which
the calibrated camera turns into places, and, softly, that the LEDs sit on the circle. The height of the nail and that
of the LEDs cannot both be told from shadows (a nail and a rig of twice the height cast the same ones), so that the
measured height of the circle sets the scale; where the nail's height is known, it does, and the circle is not needed.

Tips that lie far from where all others put them lose their weight (Geman and McClure's) and are named.

References
----------
The thesis, 4.3.2, for the set-up. D. Geman and S. Geman's redescending weights in the form of S. Geman and
D. E. McClure, "Statistical methods for tomographic image reconstruction", Bulletin of the ISI 52(4), 1987.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from splitknit.calibration.light_table import Tip
from splitknit.calibration.lights import Circle, LedEstimate, by_circle, combine, nail_points
from splitknit.calibration.nail_model import NailModel, NailSettings
from splitknit.errors import require
from splitknit.imaging.view import plane_points
from splitknit.model import Camera

Points = NDArray[np.float64]
HIGHEST = 0.6
"""A nail is taken to be lower than this part of the LEDs' height."""


@dataclass(frozen=True, slots=True, eq=False)
class JointFit:
    """All LEDs, and how well they are known."""

    leds: tuple[LedEstimate, ...]
    interval_deg: Points
    """(L,) the true direction lies within this angle with 95 % probability."""
    interval_mm: Points
    """(L,) the same of the position."""
    nail_height_mm: float
    nail_height_interval_mm: float
    """Half width of its 95 % interval."""
    residual_px: Points
    """(N, 2) tips found minus expected, columns and rows, in the order of the rows."""
    outliers: tuple[int, ...]
    """Rows whose tip lies astray."""
    strays: frozenset[tuple[str, int]]
    """LEDs, band and number, off the circle."""
    circle: Circle
    """As fitted."""
    rms_px: float
    """Of the tips that are no outliers, each way."""


def by_joint_fit(tips: Sequence[Tip], camera: Camera, circle: Circle, settings: NailSettings | None = None) -> JointFit:
    """Find every LED from all rows together.

    Parameters
    ----------
    tips : rows of the table, two positions of the nail at least
    camera : orthographic or perspective
    circle : on which the LEDs sit, as measured
    settings : NailSettings

    Returns
    -------
    JointFit, LEDs in the order of the rows

    Raises
    ------
    BadInput
        If there is one nail position only, a row shows no shadow, or a nail stands outside the circle.
    """
    model = NailModel(tips, camera, circle, settings or NailSettings())
    require(len(model.places_px) >= 2, "the joint fit needs two nail positions at least, but there is one.")
    solution, weights = _solve(model)
    return _result(model, solution, weights)


def _solve(model: NailModel) -> tuple[Points, Points]:
    """Return the unknowns and the weight (N,) of every tip."""
    settings = model.settings
    first, height = by_circle(
        model.tips, model.camera, model.circle, known_height_mm=settings.nail_height_mm, seen=settings.nail_seen
    )
    height = float(np.clip(height, 0.6, _highest(model)))
    places = nail_points(model.camera, model.places_px, height, settings.nail_seen)
    x = np.concatenate([np.ravel([one.position_mm for one in first]), places.ravel(), [height], np.zeros(4)])
    weights = np.ones(len(model.tips))
    # the weights sharpen step by step, so that a tip astray does not pull its neighbours' away first
    for sharpness in (64.0, 32.0, 16.0, 8.0, 4.0, 2.0, *(1.0,) * 10):
        before, x = x, _least_squares(model, x, weights)
        distance = np.linalg.norm(model.tip_residuals(x), axis=1) / settings.tip_sd_px
        weights = 1.0 / (1.0 + (distance / (settings.outlier * sharpness)) ** 2) ** 2
        if sharpness == 1.0 and float(np.abs(x - before).max()) < 1e-5:
            break
    return x, weights


def _least_squares(model: NailModel, x: Points, weights: Points) -> Points:
    """Gauss-Newton from `x`, every step shortened until it helps."""
    residuals = model.residuals(x, weights)
    for _ in range(30):
        step = np.linalg.lstsq(model.jacobian(x, weights), -residuals, rcond=1e-12)[0]
        for halving in range(12):
            ahead = _within(model, x + step * 0.5**halving)
            tried = model.residuals(ahead, weights)
            if tried @ tried < residuals @ residuals:
                break
        else:
            return x
        done = float(np.abs(ahead - x).max()) < 1e-6
        x, residuals = ahead, tried
        if done:
            break
    return x


def _highest(model: NailModel) -> float:
    return HIGHEST * min(model.circle.height_mm, model.camera.height_mm)


def _within(model: NailModel, x: Points) -> Points:
    """Keep the nail above the plane and below the LEDs, and the LEDs above it."""
    top = _highest(model)
    x = x.copy()
    x[model.at_height] = np.clip(x[model.at_height], 0.5, top)
    x[2 : 3 * len(model.names) : 3] = np.maximum(x[2 : 3 * len(model.names) : 3], 1.1 * top)
    return x


def _result(model: NailModel, x: Points, weights: Points) -> JointFit:
    """Name what was found."""
    settings, circle = model.settings, model.circle
    leds, places, height, offsets = model.parts(x)
    found = model.tip_residuals(x)
    astray = np.linalg.norm(found, axis=1) > settings.outlier * settings.tip_sd_px
    covariance = _covariance(model, x, weights)
    estimates, degrees, sizes = [], [], []
    ends = plane_points(model.camera, model.tip_px)
    for k, (band, led) in enumerate(model.names):
        rows = np.flatnonzero(model.led_of == k)
        nail = places[model.place_of[rows]]
        reach = (leds[k, 2] - height) / height
        singles = np.column_stack([nail + (nail - ends[rows]) * reach, np.full(len(rows), leds[k, 2])])
        alone = combine(band, led, singles, tuple(model.tips[row].nail for row in rows), circle)
        arm = leds[k] - circle.foot_mm
        unit = arm / np.linalg.norm(arm)
        estimates.append(LedEstimate(band, led, leds[k], unit, alone.disagreement_deg, alone.nails, singles))
        block = covariance[3 * k : 3 * k + 3, 3 * k : 3 * k + 3]
        turn = (np.eye(3) - np.outer(unit, unit)) / np.linalg.norm(arm)
        degrees.append(np.degrees(radius_95(turn @ block @ turn.T)))
        sizes.append(radius_95(block))
    x0, y0 = circle.centre_mm
    centre = (x0 + float(offsets[0]), y0 + float(offsets[1]))
    fitted = Circle(circle.radius_mm + float(offsets[2]), circle.height_mm + float(offsets[3]), centre)
    off = np.abs(np.linalg.norm(leds[:, :2] - np.asarray(centre), axis=1) - fitted.radius_mm) > settings.stray_mm
    return JointFit(
        leds=tuple(estimates),
        interval_deg=np.array(degrees),
        interval_mm=np.array(sizes),
        nail_height_mm=height,
        nail_height_interval_mm=1.96 * float(np.sqrt(covariance[model.at_height, model.at_height])),
        residual_px=found,
        outliers=tuple(int(row) for row in np.flatnonzero(astray)),
        strays=frozenset(name for name, far in zip(model.names, off, strict=True) if far),
        circle=fitted,
        rms_px=float(np.sqrt(np.mean(found[~astray] ** 2))) if not astray.all() else float("nan"),
    )


def _covariance(model: NailModel, x: Points, weights: Points) -> Points:
    """Of all unknowns; wider where the residuals are larger than they were said to be."""
    jacobian, residuals = model.jacobian(x, weights), model.residuals(x, weights)
    freedom = max(residuals.size - x.size, 1)
    scale = max(1.0, float(residuals @ residuals) / freedom)
    return np.asarray(np.linalg.pinv(jacobian.T @ jacobian, hermitian=True) * scale)


# How far from the truth an estimate may be: from a covariance to one number.


def radius_95(covariance: NDArray[np.float64]) -> float:
    """Radius about the estimate within which the truth lies with 95 % probability.

    Parameters
    ----------
    covariance : (D, D) of a normal error, singular ones too

    Notes
    -----
    The squared length of the error is a sum of squared normal numbers of unequal variance. Its quantile is that of a
    scaled chi-squared number of the same mean and variance (Satterthwaite 1946, Patnaik 1949), right
    within 4 % of the radius.

    Examples
    --------
    >>> round(radius_95(np.eye(2)), 3)
    2.448
    """
    values = np.clip(np.linalg.eigvalsh(covariance), 0.0, None)
    total = float(values.sum())
    if total <= 0:
        return 0.0
    squares = float((values**2).sum())
    return float(np.sqrt(squares / total * chi2.ppf(0.95, total * total / squares)))
