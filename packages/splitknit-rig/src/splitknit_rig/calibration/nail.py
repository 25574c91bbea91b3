"""Positions of LEDs from nail and shadow tips, by least squares over all rows; the nail's height is
unknown.

Seen from above, an LED at (p, z), a nail that stands at n with its tip at the height h, and the tip
t of its shadow on the finger plane obey

    t = n + (n - p) h / (z - h).

Unknown are every LED's p and z (L, 3), where the nail stood (P, 2), its height (one for all
positions), and by how much the circle's centre (2), radius and height are other than measured, all
in mm. Known are the tips and the nail in pixels, which the calibrated camera turns into places,
and, softly, that the LEDs sit on the circle. The height of the nail and that of the LEDs cannot
both be found from shadows (a nail and a rig of twice the height cast the same ones): the measured
height of the circle sets the scale, or that of the nail where it is known.

Tips far from the position that all others predict lose their weight (Geman and McClure) and are
named.

Source: the thesis, 4.3.2, for the set-up. D. Geman and S. Geman's redescending weights in the form
of S. Geman and D. E. McClure, "Statistical methods for tomographic image reconstruction", Bulletin
of the ISI 52(4), 1987.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import OptimizeResult, least_squares
from scipy.stats import chi2

from splitknit import Camera
from splitknit.errors import require
from splitknit.imaging.robust import cauchy
from splitknit.imaging.view import pixels_of, plane_points
from splitknit.model import Array
from splitknit_rig.calibration.lights import (
    CalibratedLed,
    Circle,
    Tip,
    by_circle,
    combine,
    nail_points,
    pixels,
    point_of,
)


@dataclass(frozen=True, slots=True)
class Nail:
    """Prior knowledge of the nail."""

    height_mm: float | None = None
    """If known: the LED positions then follow from it, and the circle is only a check."""
    sd_mm: float = 0.1
    """Standard deviation of its position on the finger plane, along each axis, shared by one
    position's rows."""


_FREE_SD_MM = 30.0
"""Standard deviation of LEDs and circle where the nail's height is known."""
_TIP_SD_PX = 1.0  # of a shadow tip, along each axis


class _NailModel:
    """The rows of a table as equations."""

    def __init__(self, tips: Sequence[Tip], camera: Camera, circle: Circle, nail: Nail) -> None:
        self.tips, self.camera, self.circle, self.nail = tuple(tips), camera, circle, nail
        nail_px, self.tip_px = pixels(tips)
        self.names = list(dict.fromkeys(tip.lit for tip in tips))
        """Band and number of the L LEDs."""
        self.led_of = np.array([self.names.index(tip.lit) for tip in tips])
        """(N,) index of the LED of each row."""
        places = [(tip.band, tip.nail) for tip in tips]
        stood = list(dict.fromkeys(places))
        self.place_of = np.array([stood.index(place) for place in places])
        """(N,) index of the nail's position, per band, of each row."""
        self.places_px = np.array(
            [nail_px[self.place_of == k].mean(axis=0) for k in range(len(stood))]
        )
        """(P, 2) mean pixels of the nail's positions."""
        self.known = nail.height_mm is not None
        self.at_height = 3 * len(self.names) + 2 * len(self.places_px)
        """Index of the nail's height in the vector of parameters."""
        # standard deviation in mm of each LED off the circle, and of the circle off the drawing
        self.circle_sd = _FREE_SD_MM if self.known else 1.0
        self.nail_sd_px = nail.sd_mm * camera.px_per_mm
        # a nail is taken to be lower than 0.6 of the LEDs' height
        self.top = 0.6 * min(circle.height_mm, camera.height_mm)

    def parts(self, x: Array) -> tuple[Array, Array, float, Array]:
        """LEDs (L, 3), nail positions (P, 2), nail height, and the circle's four offsets."""
        count = 3 * len(self.names)
        leds = x[:count].reshape(-1, 3)
        # above the nail, it the plane
        leds = np.column_stack([leds[:, :2], np.maximum(leds[:, 2], 1.1 * self.top)])
        height = float(np.clip(x[self.at_height], 0.5, self.top))
        return leds, x[count : self.at_height].reshape(-1, 2), height, x[-4:]

    def tip_residuals(self, x: Array) -> Array:
        """(N, 2) pixels, found minus expected."""
        leds, places, height, _ = self.parts(x)
        nail, led = places[self.place_of], leds[self.led_of]
        ends = nail + (nail - led[:, :2]) * (height / (led[:, 2] - height))[:, None]
        return self.tip_px - self._pixels(ends, 0.0)

    def residuals(self, x: Array, weights: Array) -> Array:
        """All residuals in standard deviations; `weights` (N,) are the tips'."""
        circle = self.circle
        leds, places, height, offsets = self.parts(x)
        tip = -self.tip_residuals(x) * np.sqrt(weights)[:, None] / _TIP_SD_PX
        nail = (self._pixels(places, height) - self.places_px) / self.nail_sd_px
        out = self.outside(leds, offsets) / self.circle_sd
        up = (leds[:, 2] - circle.height_mm - offsets[3]) / self.circle_sd
        # a known height has a standard deviation of 1 mm
        known = [height - (self.nail.height_mm or 0.0)] if self.known else []
        return np.concatenate([tip.ravel(), nail.ravel(), out, up, offsets / self.circle_sd, known])

    def outside(self, leds: Array, offsets: Array) -> Array:
        """(L,) distance in mm by which LEDs stand outside the circle, negative inside."""
        arms = leds[:, :2] - np.asarray(self.circle.centre_mm) - offsets[:2]
        return np.asarray(np.linalg.norm(arms, axis=1) - self.circle.radius_mm - offsets[2])

    def _pixels(self, places: Array, height: float) -> Array:
        return pixels_of(self.camera, np.column_stack([places, np.full(len(places), height)]))


@dataclass(frozen=True, slots=True, eq=False)
class JointFit:
    """All LEDs, and their uncertainty."""

    leds: tuple[CalibratedLed, ...]
    nail_height_mm: float
    # (N, 2) tips found minus expected, columns and rows, in the order of the rows
    residual_px: Array
    outliers: tuple[int, ...]  # rows whose tip lies astray
    strays: frozenset[tuple[str, int]]  # LEDs, band and number, off the circle


def by_joint_fit(
    tips: Sequence[Tip], camera: Camera, circle: Circle, nail: Nail | None = None
) -> JointFit:
    """Estimate every LED from all rows together. Raises BadInput for a single position, a row
    without shadow, or a nail outside the circle."""
    model = _NailModel(tips, camera, circle, nail or Nail())
    require(
        len({tip.nail for tip in tips}) >= 2,
        "the joint fit needs two nail positions at least, but there is one.",
    )
    return _result(model, _solve(model))


_STRAY_TIP = 4.0
"""Standard deviations from its expected position beyond which a tip is named; it has then lost most
of its weight."""


def _solve(model: _NailModel) -> OptimizeResult:
    first, height = by_circle(
        model.tips, model.camera, model.circle, known_height_mm=model.nail.height_mm
    )
    height = float(np.clip(height, 0.6, model.top))
    places = nail_points(model.camera, model.places_px, height)
    x = np.concatenate(
        [
            np.array([led.position_mm for led in first]).ravel(),
            places.ravel(),
            [height],
            np.zeros(4),
        ]
    )
    weights = np.ones(len(model.tips))
    # the weights sharpen step by step, so that a tip astray does not pull its neighbours' away
    # first
    for sharpness in (64.0, 32.0, 16.0, 8.0, 4.0, 2.0, *(1.0,) * 10):
        fit = least_squares(model.residuals, x, method="lm", xtol=1e-7, args=(weights,))
        before, x = x, fit.x
        distance = np.linalg.norm(model.tip_residuals(x), axis=1) / _TIP_SD_PX
        weights = cauchy(distance, _STRAY_TIP * sharpness) ** 2
        if sharpness == 1.0 and float(np.abs(x - before).max()) < 1e-5:
            break
    return fit


STRAY_LED_MM = 10.0  # off the fitted circle


def _result(model: _NailModel, fit: OptimizeResult) -> JointFit:
    circle = model.circle
    leds, places, height, offsets = model.parts(fit.x)
    residual_px = model.tip_residuals(fit.x)
    astray = np.linalg.norm(residual_px, axis=1) > _STRAY_TIP * _TIP_SD_PX
    freedom = max(fit.fun.size - fit.x.size, 1)
    # where the residuals exceed their stated deviation
    wider = max(1.0, 2.0 * float(fit.cost) / freedom)
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac, hermitian=True) * wider
    estimates = []
    ends = plane_points(model.camera, model.tip_px)
    for k, (band, led) in enumerate(model.names):
        rows = np.flatnonzero(model.led_of == k)
        nail = places[model.place_of[rows]]
        reach = (leds[k, 2] - height) / height
        singles = np.column_stack(
            [nail + (nail - ends[rows]) * reach, np.full(len(rows), leds[k, 2])]
        )
        alone = combine(band, led, singles, circle)
        arm = leds[k] - circle.foot_mm
        unit = arm / np.linalg.norm(arm)
        block = covariance[3 * k : 3 * k + 3, 3 * k : 3 * k + 3]
        turn = (np.eye(3) - np.outer(unit, unit)) / np.linalg.norm(arm)
        estimates.append(
            replace(
                alone,
                direction=point_of(unit),
                position_mm=point_of(leds[k]),
                interval_deg=float(np.degrees(_radius_95(turn @ block @ turn.T))),
                interval_mm=_radius_95(block),
            )
        )
    off = np.abs(model.outside(leds, offsets)) > STRAY_LED_MM
    return JointFit(
        leds=tuple(estimates),
        nail_height_mm=height,
        residual_px=residual_px,
        outliers=tuple(int(row) for row in np.flatnonzero(astray)),
        strays=frozenset(name for name, far in zip(model.names, off, strict=True) if far),
    )


# How far from the truth an estimate may be: from a covariance to one number.


def _radius_95(covariance: Array) -> float:
    """95 % radius of a normal error of covariance (D, D), from its first two moments (Satterthwaite
    1946); accurate to 4 %."""
    values = np.clip(np.linalg.eigvalsh(covariance), 0.0, None)
    total = float(values.sum())
    if total <= 0:
        return 0.0
    squares = float((values**2).sum())
    return float(np.sqrt(squares / total * chi2.ppf(0.95, total * total / squares)))
