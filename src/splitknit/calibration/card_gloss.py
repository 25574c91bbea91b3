"""Whether a card shines: a bright spot that stands where a mirror would show the LED, and moves with it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from splitknit.calibration.card_light import CardPlane, rays_to_led
from splitknit.calibration.card_model import Answer, CardModel, Order
from splitknit.model import Camera, Led

Array = NDArray[np.float64]

WIDTHS_DEG = (3.0, 6.0)
"""Of the spot, as the deviation of the angle between the card's normal and half way from LED to camera."""


def half_angles(camera: Camera, led: Led, pixels: Array, card: CardPlane) -> Array:
    """(N,) angle in deg between the card's normal and the direction half way between LED and camera."""
    points = card.points(camera, pixels)
    towards, _ = rays_to_led(led, points)
    sight = np.array([0.0, 0.0, camera.height_mm]) - points
    if camera.model == "orthographic":
        sight = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    half = towards + sight / np.linalg.norm(sight, axis=1, keepdims=True)
    cosine = half @ card.normal / np.linalg.norm(half, axis=1)
    return np.asarray(np.rad2deg(np.arccos(np.clip(cosine, -1.0, 1.0))))


def card_gloss(  # noqa: PLR0917
    camera: Camera,
    leds: Sequence[Led],
    pixels: Array,
    card: CardPlane,
    fit: tuple[CardModel, Answer, Order],
    rest: Array,
) -> tuple[float, float]:
    """Brightness of the spot at the mirror's angle relative to the card's own, and its standard error.

    Parameters
    ----------
    camera, leds, pixels, card : as fitted
    fit : model, its best parameters and their order
    rest : (L, N) residuals of the fit, NaN where dust was found

    Notes
    -----
    Least squares of the residuals on the spot and on all slopes of the model: what beams and aims could explain as
    well is not counted. The greatest of a narrow and a wide spot, in its errors, is returned.
    """
    model, answer, order = fit
    angles = np.stack([half_angles(camera, led, pixels, card) for led in leds])
    used = np.isfinite(rest)
    left = np.where(used, rest, 0.0)
    size = model.size(order)
    normal, slope = np.zeros((size, size)), np.zeros(size)
    across = np.zeros((len(WIDTHS_DEG), size))
    spots = [np.exp(-0.5 * (angles / width) ** 2) * used for width in WIDTHS_DEG]
    for k in range(model.count):
        places, rows = model.slopes(answer, order, k)
        rows = rows * used[k]
        normal[np.ix_(places, places)] += rows @ rows.T
        slope[places] += rows @ left[k]
        for number, spot in enumerate(spots):
            across[number, places] += rows @ spot[k]
    inverse = np.linalg.pinv(normal, rcond=1e-12)
    noise = float(np.sqrt(np.mean(left[used] ** 2)))
    found = (0.0, np.inf)
    for number, spot in enumerate(spots):
        own = float((spot * spot).sum() - across[number] @ inverse @ across[number])
        if own < 1e-6 * float((spot * spot).sum()) + 1e-9:
            continue
        value = float(((spot * left).sum() - across[number] @ inverse @ slope) / own)
        error = float(noise / np.sqrt(own))
        if value / error > found[0] / found[1]:
            found = (value, error)
    return found
