"""How high the calibration nail may be: its shadows must stay in the picture."""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import Rig

_STEP_MM = 0.5


def shadow_tips(rig: Rig, nail_mm: float, place_mm: tuple[float, float] = (0.0, 0.0)) -> NDArray[np.float64]:
    """Return (L, 2): where each LED throws the shadow of a nail's tip onto the finger plane, in mm.

    Parameters
    ----------
    rig : Rig
        With the places of its LEDs.
    nail_mm : height of the tip over the plane, below the lowest LED
    place_mm : x and y of the nail

    Examples
    --------
    >>> from splitknit.model import default_rig
    >>> shadow_tips(default_rig(), 14.0)[0].round(2).tolist()  # the LED on the right throws it to the left
    [-5.83, 0.0]
    """
    leds = _places(rig)
    stretch = nail_mm / (leds[:, 2] - nail_mm)
    place = np.asarray(place_mm, dtype=np.float64)
    return np.asarray(place + (place - leds[:, :2]) * stretch[:, None])


def nail_height(rig: Rig, offset_mm: float, margin_mm: float, radius_mm: float) -> float:
    """Return the greatest height (mm, in half millimetres) of a nail whose shadows all stay in the picture.

    Parameters
    ----------
    rig : Rig
    offset_mm : how far from the middle the nail may stand, along x and along y
    margin_mm : between a shadow's tip and the border of the picture
    radius_mm : of the nail's foot; a shadow's tip must come out from under it

    Raises
    ------
    BadInput
        If the picture is too small for a nail of 4 mm, or the shadows stay hidden under the foot.
    """
    camera = rig.camera
    half = np.array([camera.image_size[1], camera.image_size[0]]) / camera.px_per_mm / 2 - margin_mm
    leds = _places(rig)
    best = float(leds[:, 2].min()) / 3
    for place in itertools.product((-offset_mm, 0.0, offset_mm), repeat=2):
        away = np.asarray(place) - leds[:, :2]  # (L, 2) the way of the shadow
        room = np.where(away >= 0, half - place, half + place)
        stretch = (room / np.maximum(np.abs(away), 1e-9)).min(axis=1)
        if not (stretch > 0).all():
            best = 0.0
            break
        best = min(best, float((leds[:, 2] * stretch / (1 + stretch)).min()))
    height = math.floor(best / _STEP_MM + 1e-9) * _STEP_MM
    require(
        height >= 4.0,
        f"the picture of {2 * (half[0] + margin_mm):.0f} x {2 * (half[1] + margin_mm):.0f} mm is too small for the "
        f"shadows of a nail up to {offset_mm:g} mm from its middle; set calibration.nail_offset_mm smaller.",
    )
    nearest = float(np.hypot(*shadow_tips(rig, height).T).min())
    require(
        nearest >= radius_mm + 0.5,
        f"a nail of {height:g} mm hides the shadow of an LED under its foot of {radius_mm:g} mm radius "
        f"(calibration.nail_radius_mm), as that LED stands nearly above it.",
    )
    return height


def _places(rig: Rig) -> NDArray[np.float64]:
    places = [led.position_mm for led in rig.leds]
    require(None not in places, "the nail's height needs the place of every LED (position_mm).")
    return np.asarray(places, dtype=np.float64)
