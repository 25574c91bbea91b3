"""The rig that the twin copies: 14 LEDs on a circle and a camera that looks down."""

from __future__ import annotations

import numpy as np

from splitknit.errors import require
from splitknit.model import Camera, Led, Rig

LEDS_PER_BAND = 7


def default_rig(scale: float = 1.0, seed: int | None = None, intensity_spread: float = 0.1) -> Rig:
    """Return the thesis's rig: seven white and seven NIR LEDs on a circle of 52.5 mm at the camera's height.

    Parameters
    ----------
    scale : size of the image relative to the full frame of 2200 x 3200 pixels at 75.7 px/mm, in (0, 1]
    seed : seed of the LEDs' individual intensities; None makes all of them one
    intensity_spread : standard deviation of the intensities about one; they stay within 2.5 deviations

    Returns
    -------
    Rig whose LEDs 0 to 6 are white, at azimuths 2 pi k / 7, and 7 to 13 NIR, half a step further.

    Raises
    ------
    BadInput
        If `scale` or `intensity_spread` is out of range.
    """
    require(0.0 < scale <= 1.0, f"scale must lie in (0, 1], but it is {scale}.")
    require(
        0.0 <= intensity_spread <= 0.3, f"intensity_spread must lie between 0 and 0.3, but it is {intensity_spread}."
    )
    camera = Camera(px_per_mm=75.7 * scale, image_size=(round(2200 * scale), round(3200 * scale)), height_mm=140.0)
    intensities = np.ones(2 * LEDS_PER_BAND)
    if seed is not None:
        deviations = np.random.default_rng(seed).standard_normal(2 * LEDS_PER_BAND)
        intensities = 1.0 + intensity_spread * np.clip(deviations, -2.5, 2.5)
    leds = []
    for index in range(2 * LEDS_PER_BAND):
        nir, k = divmod(index, LEDS_PER_BAND)
        azimuth = 2.0 * np.pi * (k + 0.5 * nir) / LEDS_PER_BAND
        position = (float(52.5 * np.cos(azimuth)), float(52.5 * np.sin(azimuth)), 140.0)
        leds.append(
            Led(band="nir" if nir else "white", position_mm=position, intensity=round(float(intensities[index]), 6))
        )
    return Rig(camera=camera, leds=tuple(leds), provenance={"source": "digital twin", "intensities": "exact"})
