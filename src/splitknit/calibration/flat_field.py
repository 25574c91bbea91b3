"""Flat field: the lens's fall-off and every LED's brightness, beam and aim, from a white card under each LED.

An image of a card, divided into the images of a finger, is a flat field for the plane of the card alone: a finger's pad
lies up to a centimetre above it, nearer to the LEDs and elsewhere in their beams. A model of the light holds at every
height, needs a handful of numbers where a picture has millions, and does not carry the card's dust into every finger.

What tells the parts apart: the lens's fall-off is the same in all images and lies about the image's centre; the inverse
square and the card's cosine follow from the LEDs' places, which are known; what is left is the beam, which moves with
the LED.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.calibration.card_fit import CardFit, fit_order
from splitknit.calibration.card_gloss import card_gloss
from splitknit.calibration.card_light import CardPlane
from splitknit.calibration.card_model import LADDER, Answer, CardModel, Order
from splitknit.errors import require
from splitknit.model import Camera, Led

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class FlatFieldSettings:
    """How the model is fitted and judged."""

    robust_percent: float = 0.5
    """Places whose residuals under all LEDs (in the median) lie beyond this many per cent count less and less: dust."""
    dust_percent: float = 2.0
    """A cell that departs further under all LEDs is counted as dust and left out of the residuals."""
    enough_percent: float = 0.05
    """The simplest model is taken whose rms exceeds the best one's by no more than this (added in squares) ..."""
    enough_share: float = 0.05
    """... or by no more than this share of it."""
    least_field_share: float = 0.3
    """A cell that is darker than this share of the model's brightness does not show the card."""
    empty_cells: float = 0.005
    """Share of the cells that may be so."""
    worst_dust_share: float = 0.05
    """Largest share of dust; beyond it the card is not uniform."""

    def __post_init__(self) -> None:
        for name in ("robust_percent", "dust_percent", "enough_percent", "enough_share"):
            require(getattr(self, name) > 0, f"flat_field.{name} must be positive.")
        for name in ("least_field_share", "empty_cells", "worst_dust_share"):
            require(0 < getattr(self, name) < 1, f"flat_field.{name} must lie between 0 and 1.")


@dataclass(frozen=True, slots=True, eq=False)
class FlatField:
    """A rig's light as a white card shows it."""

    camera: Camera
    """With its fall-off."""
    leds: tuple[Led, ...]
    """With intensity (the mean is one), lobe_exponent and aim."""
    card_level: float
    """Brightness of the card: the images are this times :func:`splitknit.calibration.card_light.card_light`."""
    order: Order
    orders: tuple[tuple[str, int, float], ...]
    """Every model tried: name, number of parameters, rms of its residuals in per cent."""
    residual: Array
    """(L, N) image over model, less one."""
    dust: NDArray[np.bool_]
    """(N,) cells that were left out."""
    exponent_error: Array
    """(L,) standard errors of the beams' exponents; NaN where they were not fitted."""
    common_percent: float
    """rms over the cells of the residuals' mean over all LEDs: what the card (or the lens) does, not the LEDs."""
    gloss_percent: float
    """Brightness of a spot where a mirror would show the LEDs, relative to the card's own; 0 for a matt card."""
    gloss_error: float
    card: CardPlane = field(default_factory=CardPlane)
    """Where it lay."""
    settings: FlatFieldSettings = field(default_factory=FlatFieldSettings)

    @property
    def rms_percent(self) -> Array:
        """(L,) rms of each LED's residuals without dust."""
        return np.asarray(100 * np.sqrt(np.mean(self.residual[:, ~self.dust] ** 2, axis=1)))

    @property
    def largest_percent(self) -> Array:
        """(L,) largest residual of each LED without dust."""
        return np.asarray(100 * np.abs(self.residual[:, ~self.dust]).max(axis=1))


def fit_flat_field(  # noqa: PLR0917
    camera: Camera,
    leds: Sequence[Led],
    pixels: Any,
    light: Any,
    card: CardPlane | None = None,
    settings: FlatFieldSettings | None = None,
) -> FlatField:
    """Fit lens, brightnesses, beams and aims to images of a white card, all images of all bands together.

    Parameters
    ----------
    camera : Camera
        Calibrated; its `shading` is replaced.
    leds : (L,) LEDs at known places
        Intensities, exponents and aims are replaced.
    pixels : (N, 2) column and row
    light : (L, N) linear light at `pixels` with LED k alone, the lens's fall-off in it
    card : where the card lies; on the finger plane by default
    settings : FlatFieldSettings, optional

    Returns
    -------
    FlatField

    Raises
    ------
    BadInput
        If an LED did not light, the card does not fill the field or is not uniform.

    Notes
    -----
    Models of :data:`splitknit.calibration.card_model.LADDER` are fitted one after the other, each from the one before,
    and the simplest is taken that explains the images about as well as the richest. Two weak priors (exponents 5 +- 20,
    slopes by the aims 0 +- 4, each worth one cell of thousands) settle what the images leave open: the aim of a
    beam that is wide.

    A tilt of the card cannot be told from aims and brightnesses: it must be known (as the camera's tilt against the
    base is) or small. One degree that nobody knows of makes LEDs up to 0.7 % brighter or darker, and surfaces lean by
    one degree.
    """
    chosen = settings or FlatFieldSettings()
    places, images = _checked(pixels, light, len(leds))
    plane = card or CardPlane()
    model = CardModel(camera, leds, places, plane)
    floor = 1e-4 * float(np.median(images))
    logarithm = np.log(np.maximum(images, max(floor, 1e-12)))
    start = _start(model, logarithm)
    _check_lit(leds, start)
    scale = 0.01 * chosen.robust_percent
    fits: list[CardFit] = []
    for order in LADDER:
        fits.append(fit_order(model, start, order, logarithm, scale))
        start = fits[-1].answer
        if order.lens and not order.aims:
            _check_field(np.exp(logarithm - model.logarithm(start)), chosen)
    residuals = [images / np.exp(model.logarithm(fit.answer)) - 1.0 for fit in fits]
    dust = np.abs(np.median(residuals[-1], axis=0)) > 0.01 * chosen.dust_percent
    require(not dust.all(), "the card is not uniform: no part of the picture looks like an even card.")
    rms = [100 * float(np.sqrt(np.mean(one[:, ~dust] ** 2))) for one in residuals]
    enough = max(float(np.hypot(min(rms), chosen.enough_percent)), (1 + chosen.enough_share) * min(rms))
    best = next(k for k, value in enumerate(rms) if value <= enough)
    fit = fits[best]
    rest = np.where(dust, np.nan, residuals[-1])
    gloss, gloss_error = card_gloss(camera, leds, places, plane, (model, fits[-1].answer, fits[-1].order), rest)
    lens, lit = _result(camera, leds, model, fit.answer, fit.order)
    return FlatField(
        camera=lens,
        leds=lit,
        card_level=float(fit.answer.brightness.mean()),
        order=fit.order,
        orders=tuple((one.order.name, model.size(one.order), value) for one, value in zip(fits, rms, strict=True)),
        residual=residuals[best],
        dust=dust,
        exponent_error=_exponent_errors(model, fit, scale, rms[best]),
        common_percent=_common(residuals[best], dust),
        gloss_percent=100 * gloss,
        gloss_error=100 * gloss_error,
        card=plane,
        settings=chosen,
    )


def _checked(pixels: Any, light: Any, count: int) -> tuple[Array, Array]:
    places, images = np.asarray(pixels, dtype=np.float64), np.asarray(light, dtype=np.float64)
    require(
        places.ndim == 2 and places.shape[1] == 2 and len(places) >= 50,
        f"pixels must have the shape (N, 2) with N of 50 at least, but the shape is {places.shape}.",
    )
    require(
        images.shape == (count, len(places)),
        f"light must have the shape ({count}, {len(places)}), one image for each LED, but it has {images.shape}.",
    )
    require(bool(np.isfinite(images).all()), "light contains NaN or infinite values.")
    require(float(np.median(images)) > 0, "the images of the card are black; check the LEDs and the black level.")
    return places, images


def _start(model: CardModel, logarithm: Array) -> Answer:
    level = np.exp(np.median(logarithm - model.known, axis=1))
    return Answer(level, np.ones(model.count), np.zeros((model.count, 2)), np.zeros(2))


def _check_lit(leds: Sequence[Led], start: Answer) -> None:
    for k, led in enumerate(leds):
        usual = float(np.median([start.brightness[j] for j, other in enumerate(leds) if other.band == led.band]))
        require(
            start.brightness[k] > 0.1 * usual,
            f"LED {k} ({led.band}) shows the card at {100 * start.brightness[k] / usual:.0f} % of the brightness of "
            f"its band: it did not light; check its wire and take the card again.",
        )


def _check_field(ratio: Array, settings: FlatFieldSettings) -> None:
    """Refuse a card that ends inside the picture: cells that are far darker than the rest under most LEDs."""
    empty = np.median(ratio, axis=0) < settings.least_field_share
    share = float(empty.mean())
    require(
        share <= settings.empty_cells,
        f"the card does not fill the field: {100 * share:.0f} % of the picture is far darker than the rest; take a "
        f"larger card, or move it until it reaches over all borders.",
    )
    strange = float((np.abs(np.median(ratio, axis=0) - 1) > 0.05).mean())
    require(
        strange <= 2 * settings.worst_dust_share,
        f"the card is not uniform: {100 * strange:.0f} % of the picture departs by more than 5 % from an even card "
        f"under all LEDs; use a clean matt white card that reaches over all borders.",
    )


def _result(
    camera: Camera, leds: Sequence[Led], model: CardModel, answer: Answer, order: Order
) -> tuple[Camera, tuple[Led, ...]]:
    mean = float(answer.brightness.mean())
    shading = tuple(round(float(value), 6) for value in answer.lens) if order.lens else ()
    lit = []
    for k, led in enumerate(leds):
        x, y, z = (round(float(value), 6) for value in model.aim(answer, k))
        lit.append(
            replace(
                led,
                intensity=round(float(answer.brightness[k]) / mean, 6),
                lobe_exponent=round(float(answer.exponent[k]), 5),
                aim=(x, y, z) if order.aims and answer.exponent[k] > 0 else None,
            )
        )
    return replace(camera, shading=shading), tuple(lit)


def _exponent_errors(model: CardModel, fit: CardFit, scale: float, rms_percent: float) -> Array:
    """Standard errors (L,) of the exponents, the residuals taken as independent between cells."""
    errors = np.sqrt(np.maximum(np.diag(np.linalg.pinv(fit.normal)), 0.0)) * (0.01 * rms_percent / scale)
    return model.exponents(errors, fit.order)


def _common(residual: Array, dust: NDArray[np.bool_]) -> float:
    return 100 * float(np.sqrt(np.mean(residual[:, ~dust].mean(axis=0) ** 2)))
