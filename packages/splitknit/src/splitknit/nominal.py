"""The thesis's rig as it is drawn, and lights as data sheets have them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from splitknit.errors import require
from splitknit.model import Camera, Led, Rig

_LEDS_PER_BAND = 7
"""LEDs of white light, and of near infrared. Source: thesis."""
HALF_ANGLE_DEG = {"white": 30.0, "nir": 20.0}
"""Where a data sheet's LED of 60 (40) deg viewing angle has half its light."""
CROSSTALK: tuple[tuple[float, float, float], ...] = (
    (1.000, 0.136, 0.045),
    (0.218, 1.000, 0.229),
    (0.071, 0.295, 1.000),
)
"""Signal of the red, green and blue pixels (rows) under a red, a green and a blue LED (columns),
each row relative to its own: the IMX219's quantum efficiency under Gaussian lines at 625, 525 and
465 nm, 20, 33 and 24 nm wide. Source: the sensor's quantum efficiency."""


def default_rig(scale: float = 1.0, seed: int | None = None, intensity_spread: float = 0.1) -> Rig:
    """Return the thesis's rig: seven white and seven NIR LEDs on a circle of 52.5 mm at the
    camera's height.

    Raises BadInput if `scale` is out of range. Returns a rig whose LEDs 0 to 6 are white, at
    azimuths 2 pi k / 7, and 7 to 13 NIR, half a step further. `scale`: size of the image relative
    to the full frame of 2200 x 3200 pixels at 75.7 px/mm, in (0, 1]; `seed`: seed of the LEDs'
    individual intensities; None makes all of them one; `intensity_spread`: standard deviation of
    the intensities about one; they stay within 2.5 deviations.
    """
    require(0.0 < scale <= 1.0, f"scale must lie in (0, 1], but it is {scale}.")
    camera = Camera(
        px_per_mm=75.7 * scale,
        image_size=(round(2200 * scale), round(3200 * scale)),
        height_mm=140.0,
    )
    intensities = np.ones(2 * _LEDS_PER_BAND)
    if seed is not None:
        deviations = np.random.default_rng(seed).standard_normal(2 * _LEDS_PER_BAND)
        intensities = 1.0 + intensity_spread * np.clip(deviations, -2.5, 2.5)
    leds = []
    for index in range(2 * _LEDS_PER_BAND):
        nir, k = divmod(index, _LEDS_PER_BAND)
        azimuth = 2.0 * np.pi * (k + 0.5 * nir) / _LEDS_PER_BAND
        position = (float(52.5 * np.cos(azimuth)), float(52.5 * np.sin(azimuth)), 140.0)
        intensity = round(float(intensities[index]), 6)
        leds.append(Led(band="nir" if nir else "white", position_mm=position, intensity=intensity))
    return Rig(
        camera=camera,
        leds=tuple(leds),
        provenance={"source": "digital twin", "intensities": "exact"},
    )


def nominal_rig(scale: float = 1.0) -> Rig:
    """The rig as drawings and data sheets have it: a perspective camera, 7 white and 7 NIR LEDs of
    intensity one with their sheets' lobes, aimed at the origin. `scale`: of the full frame of 2200
    x 3200 pixels, in (0, 1], or BadInput.
    """
    drawn = default_rig(scale)
    rows, columns = drawn.camera.image_size
    focal_px = drawn.camera.px_per_mm * drawn.camera.height_mm
    matrix = np.array(
        [[focal_px, 0.0, (columns - 1) / 2], [0.0, focal_px, (rows - 1) / 2], [0.0, 0.0, 1.0]]
    )
    camera = replace(drawn.camera, model="perspective", matrix=matrix)
    leds = tuple(
        replace(led, lobe_exponent=lobe_exponent(HALF_ANGLE_DEG[led.band])) for led in drawn.leds
    )
    return Rig(camera=camera, leds=leds, provenance={"source": "digital twin", "rig": "as drawn"})


def side_lights(leds: Sequence[Led]) -> tuple[int, ...]:
    """Numbers of the near LEDs that stand more than 60 deg off the camera's axis."""
    places = [(k, led.position_mm) for k, led in enumerate(leds) if led.position_mm is not None]
    return tuple(k for k, (x, y, z) in places if np.hypot(x, y) > z * np.tan(np.deg2rad(60.0)))


def lobe_exponent(half_angle_deg: float) -> float:
    """Exponent m of cos^m that is one half at `half_angle_deg`."""
    require(
        1.0 <= half_angle_deg <= 80.0,
        f"half_angle_deg must lie between 1 and 80, but it is {half_angle_deg}.",
    )
    return float(np.log(0.5) / np.log(np.cos(np.deg2rad(half_angle_deg))))


def shared_exposures(exposures: int) -> tuple[tuple[int, int, int], ...]:
    """Places on the circle, of 3 x `exposures` even ones, of the red, green and blue LED of each
    exposure: those of one lie around the finger, and so do those of a colour. BadInput if it is not
    one to three exposures.
    """
    require(
        1 <= exposures <= 3, f"coloured LEDs take one to three exposures here, not {exposures}."
    )
    count = 3 * exposures
    step = 4 if exposures == 3 else exposures
    return tuple(
        (3 * k, (3 * k + step) % count, (3 * k + 2 * step) % count) for k in range(exposures)
    )
