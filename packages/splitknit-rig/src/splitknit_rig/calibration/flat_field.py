"""Flat field: the lens's fall-off and every LED's brightness, beam and aim, from a white card under
each LED.

Dividing a finger's images by those of a card corrects them only in the plane of the card, but a
finger's pad lies up to a centimetre above it. A model of the light holds at every height and does
not copy the card's dust into every finger. The lens's fall-off is the same in all images and
centred on the image; the inverse square law and the card's cosine follow from the known positions
of the LEDs; what remains is the beam of each LED.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from splitknit import Camera, Led
from splitknit.errors import require
from splitknit.imaging.robust import cauchy, deviation
from splitknit.model import Array, BoolArray
from splitknit_rig.calibration.card_model import CardModel, CardPlane, rays_to_led

# Robust least squares for the model of a white card, by scipy with weights of the card's places.
#
# Dust lies on the card: it darkens a place under every LED. What departs under one LED alone is not
# dust but that LED, and must be fitted, or show in its residuals. So a place is trusted by the
# median of its residuals over all LEDs.


_PRIOR = (0.0, 5.0, 0.0, 0.0), (0.0, 1 / 20.0, 1 / 4.0, 1 / 4.0)
"""Middle and inverse width of what is expected of an LED: ln c, n, n u and n v. It determines what
the images do not, the aim of a wide beam; each prior weighs as much as one cell among thousands."""


def _fit(
    model: CardModel, start: Array, logarithm: Array, scale: float
) -> tuple[Array, Array, Array]:
    """Parameters that fit ln (L, N) of the images, their covariance, and the slopes (L, N, P) of
    the model; `scale`: residual beyond which a place is down-weighted (Cauchy)."""
    vector, weight = start, np.zeros(logarithm.shape[1])

    def residuals(vector: Array, root: Array) -> Array:
        apart = (model.logarithm(vector) - logarithm) * root
        expected = vector[2:].reshape(-1, 4).copy()
        expected[:, 2:] *= expected[:, 1:2]
        prior = (expected - _PRIOR[0]) * _PRIOR[1]
        return np.concatenate([apart.ravel(), prior.ravel()])

    low, high = (model.vector(*limits) for limits in model.bounds)
    for _ in range(10):  # each with new weights of the card's places
        common = np.median(logarithm - model.logarithm(vector), axis=0)
        width = max(scale, 3.0 * deviation(common))
        last, weight = weight, cauchy(common, width)
        if float(np.abs(weight - last).max()) < 0.01:
            break
        root = np.sqrt(weight) / scale
        fit = least_squares(residuals, vector, bounds=(low, high), args=(root,), ftol=1e-7)
        vector = fit.x
    jacobian: Array = np.asarray(fit.jac)
    covariance = np.linalg.pinv(jacobian.T @ jacobian, hermitian=True)
    slopes = jacobian[: logarithm.size].reshape(*logarithm.shape, -1) / root[:, None]
    return vector, np.asarray(covariance), np.asarray(slopes)


# Whether a card shines: a bright spot that stands where a mirror would show the LED, and moves with
# it.


def _half_angles(camera: Camera, led: Led, pixels: Array, card: CardPlane) -> Array:
    """(N,) angle in deg between the card's normal and the bisector of the directions to LED and
    camera."""
    points = card.points(camera, pixels)
    towards, _ = rays_to_led(led, points)
    sight = np.array([0.0, 0.0, camera.height_mm]) - points
    if camera.model == "orthographic":
        sight = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    half = towards + sight / np.linalg.norm(sight, axis=1, keepdims=True)
    cosine = half @ card.normal / np.linalg.norm(half, axis=1)
    return np.asarray(np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0))))


def _card_gloss(slopes: Array, half_angles_deg: Array, rest: Array) -> tuple[float, float]:
    """Brightness of the specular spot relative to the card, and its standard error. Least squares
    of the residuals (L, N), NaN where dust is, on a narrow and a wide spot and on all `slopes` of
    the model; the spot with the larger ratio to its standard error is returned.
    """
    used = np.isfinite(rest)
    left, rows = rest[used], slopes[used]
    inverse, slope = np.linalg.pinv(rows.T @ rows, rcond=1e-12), rows.T @ left
    noise = float(np.sqrt(np.mean(left**2)))
    gloss = (0.0, np.inf)
    # the spot's widths in deg between the card's normal and the half vector (standard deviations)
    for width in (3.0, 6.0):
        spot = np.exp(-0.5 * (half_angles_deg[used] / width) ** 2)
        shared, whole = rows.T @ spot, float(spot @ spot)
        own = whole - float(shared @ inverse @ shared)
        if own >= 1e-6 * whole + 1e-9:
            value = float((spot @ left - shared @ inverse @ slope) / own)
            gloss = max(
                gloss, (value, float(noise / np.sqrt(own))), key=lambda spot: spot[0] / spot[1]
            )
    return gloss


@dataclass(frozen=True, slots=True, eq=False)
class FlatField:
    """Lens and LEDs of a rig, measured with a white card."""

    camera: Camera  # with its fall-off
    leds: tuple[Led, ...]  # with intensity (the mean is one), lobe_exponent and aim
    # brightness of the card: the images are this times
    # :func:`splitknit_rig.calibration.card_model.card_light`
    card_level: float
    residual: Array  # (L, N) image over model, less one
    dust: BoolArray  # (N,) cells that were left out
    # (L,) standard errors of the beams' exponents
    exponent_error: Array
    # rms over the cells of the residuals' mean over all LEDs: what the card (or the lens) does, not
    # the LEDs
    common_percent: float
    # brightness of a spot where a mirror would show the LEDs, relative to the card's own; 0 for a
    # matt card
    gloss_percent: float
    gloss_error: float
    card: CardPlane  # where it lay
    rms_percent: Array  # (L,) rms of each LED's residuals without dust
    largest_percent: Array  # (L,) largest residual of each LED without dust


DUST_PERCENT = 2.0
"""A cell that departs further under all LEDs is dust and left out of the residuals."""


def fit_flat_field(
    camera: Camera, leds: Sequence[Led], pixels: Any, light: Any, card: CardPlane | None = None
) -> FlatField:
    """Fit lens, brightnesses, beams and aims to images of a white card, all images of all bands
    together.

    `light` (L, N) is linear, at `pixels` (N, 2; column, row), under LED k alone, and includes the
    lens's fall-off; `card` lies on the finger plane by default. The camera's `shading` and the
    LEDs' intensities, exponents and aims are replaced. Raises BadInput if an LED did not light, the
    card does not fill the field or is not uniform. A tilt of the card is indistinguishable from
    aims and brightnesses: it must be known (as the camera's tilt against the base is) or small. An
    unknown tilt of 1 deg changes the brightness of LEDs by up to 0.7 % and tilts surfaces by 1 deg.
    """
    places, images = np.asarray(pixels, dtype=np.float64), np.asarray(light, dtype=np.float64)
    require(
        float(np.median(images)) > 0,
        "the images of the card are black; check the LEDs and the black level.",
    )
    plane = card or CardPlane()
    model = CardModel(camera, leds, places, plane)
    floor = 1e-4 * float(np.median(images))
    logarithm = np.log(np.maximum(images, max(floor, 1e-12)))
    level = np.exp(np.median(logarithm - model.known, axis=1))
    start = model.vector([0.0, 0.0], [0.0, 1.0, 0.0, 0.0])
    start[2::4] = np.log(level)
    for k, led in enumerate(leds):
        usual = float(np.median([level[j] for j in range(len(leds)) if leds[j].band == led.band]))
        require(
            level[k] > 0.1 * usual,
            f"LED {k} ({led.band}) shows the card at {100 * level[k] / usual:.0f} % of the"
            " brightness of its band: it did not light; check its wire and take the card again.",
        )
    scale = 0.005  # places with larger residuals count less and less: dust
    vector, covariance, slopes = _fit(model, start, logarithm, scale)
    residual = images / np.exp(model.logarithm(vector)) - 1.0
    _check_field(1.0 + residual)
    dust = np.abs(np.median(residual, axis=0)) > 0.01 * DUST_PERCENT
    require(
        not dust.all(), "the card is not uniform: no part of the picture looks like an even card."
    )
    clean = residual[:, ~dust]
    angles = np.stack([_half_angles(camera, led, places, plane) for led in leds])
    rest = np.where(dust, np.nan, residual)
    gloss, gloss_error = _card_gloss(slopes, angles, rest)
    brightness = np.exp(vector[2::4])
    # the residuals taken as independent between cells
    errors = np.sqrt(np.diag(covariance)) * float(np.sqrt(np.mean(clean**2))) / scale
    return FlatField(
        camera=replace(camera, shading=tuple(round(float(value), 6) for value in vector[:2])),
        leds=tuple(
            replace(
                led,
                intensity=round(float(brightness[k] / brightness.mean()), 6),
                lobe_exponent=round(float(vector[3 + 4 * k]), 5),
                aim=model.aim(vector, k),
            )
            for k, led in enumerate(leds)
        ),
        card_level=float(brightness.mean()),
        residual=residual,
        dust=dust,
        exponent_error=errors[3::4],
        common_percent=100 * float(np.sqrt(np.mean(clean.mean(axis=0) ** 2))),
        gloss_percent=100 * gloss,
        gloss_error=100 * gloss_error,
        card=plane,
        rms_percent=100 * np.sqrt(np.mean(clean**2, axis=1)),
        largest_percent=100 * np.abs(clean).max(axis=1),
    )


MAX_DUST = 0.05  # fraction of the cells; beyond it the card is not uniform


def _check_field(ratio: Array) -> None:
    """Refuse a card that ends inside the picture: cells that are far darker than the rest under
    most LEDs."""
    usual = np.median(ratio, axis=0)
    fraction = float((usual < 0.3).mean())  # so dark a cell does not show the card
    require(
        fraction <= 0.005,
        f"the card does not fill the field: {100 * fraction:.0f} % of the picture is far darker"
        " than the rest; take a larger card, or move it until it reaches over all borders.",
    )
    strange = float((np.abs(usual - 1) > 0.05).mean())
    require(
        strange <= 2 * MAX_DUST,
        f"the card is not uniform: {100 * strange:.0f} % of the picture departs by more than 5 %"
        " from an even card under all LEDs; use a clean matt white card that reaches over all"
        " borders.",
    )
