"""Water on the skin: it fills the valleys, creeps up the ridges, and at last lies over them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.simulator.orientation_field import smooth_noise

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Water:
    """How much water there is; everything follows from the severity."""

    meniscus_mm: float
    """Radius of curvature of the water's surface: the larger, the fuller the valleys."""
    over_ridges_um: float
    """Thickness of the film over the ridges' tops."""
    levelled_mm: float
    """Standard deviation over which the film has levelled out; 0 where none closes over the ridges."""
    share: float
    """Share of the skin that is wet."""


def water_of(severity: float) -> Water:
    """From sweat in the valleys' corners to a hand that comes out of water.

    The radius grows from 0.05 mm (a tenth of a ridge period: only sharp corners are rounded) to 2 mm (valleys are full
    but for a micrometre or two; water's capillary length is 2.7 mm); above one half a film closes over the ridges, up
    to 15 um; from one half on no dry patch is left. A film of 20 um levels out over a ridge period in 0.1 ms and over
    5 mm in seconds, so a closed one shows no ridges.
    """
    closed = max(0.0, 2.0 * severity - 1.0)
    return Water(0.05 * 40.0**severity, 15.0 * closed, 0.6 * closed, min(1.0, 2.0 * severity))


def water_level(displacement: Array, pitch_mm: float, water: Water, rng: np.random.Generator) -> Array:
    """(H, W) displacement of the water's surface, mm; equal to `displacement` where there is no water.

    Water that wets the skin (contact angle zero) meets it in menisci of one curvature: the closing of the relief by a
    ball of that radius, here by the paraboloid that osculates it, which acts along rows and columns one after
    the other. The body's own curvature (a radius of 8 mm) is left out.

    References
    ----------
    Orchard 1962, On surface levelling in viscous liquids and gels (time 3 eta l^4 / (16 pi^4 gamma h^3)).
    de Gennes, Brochard-Wyart and Quere 2004, Capillarity and Wetting Phenomena, section 1.1.3 (Laplace pressure) and
    2.2 (capillary length).
    van den Boomgaard et al. 1996, Quadratic structuring functions in mathematical morphology.
    """
    filled = _closed(displacement, pitch_mm, water.meniscus_mm)
    if water.levelled_mm > 0.0:
        level = cv2.GaussianBlur(filled, (0, 0), water.levelled_mm / pitch_mm)
        filled = _closed(np.maximum(level + 1e-3 * water.over_ridges_um, displacement), pitch_mm, water.meniscus_mm)
    if water.share >= 1.0:
        return filled
    # patches of 2 mm with soft edges; a normal variable lies below the threshold over the wanted share
    noise = smooth_noise(rng, displacement.shape, 1.0 / pitch_mm)
    threshold = float(np.quantile(noise, water.share))
    patch = np.clip(0.5 + (threshold - noise) / 0.3, 0.0, 1.0)
    patch = patch * patch * (3.0 - 2.0 * patch)
    return np.asarray(displacement + patch * (filled - displacement))


def _closed(values: Array, pitch_mm: float, radius_mm: float) -> Array:
    """Closing of `values` by the paraboloid x^2 / (2 radius)."""
    reach = int(np.ceil(np.sqrt(2.0 * radius_mm * float(np.ptp(values))) / pitch_mm)) + 1
    over = _parabolic(values, pitch_mm, radius_mm, reach, 1.0)
    return np.maximum(_parabolic(over, pitch_mm, radius_mm, reach, -1.0), values)


def _parabolic(values: Array, pitch_mm: float, radius_mm: float, reach: int, sign: float) -> Array:
    """Dilation (sign 1) or erosion (-1) of `values` by the paraboloid x^2 / (2 radius) turned down."""
    result = values
    for axis in (0, 1):
        size = result.shape[axis]
        padding = [(0, 0), (0, 0)]
        padding[axis] = (reach, reach)
        padded = np.pad(sign * result, padding, mode="edge")
        best = np.full(result.shape, -np.inf)
        for step in range(-reach, reach + 1):
            fall = (step * pitch_mm) ** 2 / (2.0 * radius_mm)
            part = [slice(None), slice(None)]
            part[axis] = slice(reach + step, reach + step + size)
            np.maximum(best, padded[tuple(part)] - fall, out=best)
        result = sign * best
    return np.asarray(result)
