"""The tilted holes for the LEDs."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import Led
from splitknit.rig.part_settings import LedSettings


@dataclass(frozen=True, slots=True, eq=False)
class LedHole:
    """A tilted hole for one LED; distances along its axis count from the light, away from the finger."""

    index: int
    band: str
    light_mm: NDArray[np.float64]
    """(3,) the LED's place in the rig file: the middle of its dome."""
    back: NDArray[np.float64]
    """(3,) unit vector along the hole, away from the finger."""
    radius_mm: float
    pocket_radius_mm: float
    """Behind the shoulder, where the flange rests."""
    shoulder_mm: float
    back_mm: float
    """Where the pocket ends."""

    @property
    def tilt_deg(self) -> float:
        """Angle between the hole and the camera's axis."""
        return math.degrees(math.acos(min(1.0, float(self.back[2]))))

    def at(self, distance_mm: float) -> NDArray[np.float64]:
        """(3,) point on the axis."""
        return np.asarray(self.light_mm + distance_mm * self.back)

    @property
    def lean_mm(self) -> float:
        """How much farther along the axis a level face meets the hole's one side than its axis."""
        return self.radius_mm * math.tan(math.radians(self.tilt_deg))

    def level_mm(self, z: float) -> float:
        """Where the axis meets a level face at the height `z`."""
        return (z - float(self.light_mm[2])) / float(self.back[2])

    @property
    def radius_taken_mm(self) -> float:
        """How far from the camera's axis the LED reaches while it is pushed in from behind."""
        tilted = self.pocket_radius_mm * float(self.back[2])
        waiting = self.at(self.back_mm + self.shoulder_mm + self.radius_mm)  # its dome is at the pocket's end
        outside = float(np.hypot(*waiting[:2])) + tilted
        return max(outside, float(np.hypot(*self.light_mm[:2])) + self.radius_mm)


def led_hole(index: int, led: Led, settings: LedSettings) -> LedHole:
    """Return the hole of one LED.

    Raises
    ------
    BadInput
        If the LED has no place.
    """
    require(
        led.position_mm is not None and not led.also,
        f"LED {index} of the rig has no position_mm (it is distant light or a group), but parts need its place.",
    )
    white = led.band == "white"
    diameter = settings.white_diameter_mm if white else settings.nir_diameter_mm
    flange = settings.white_flange_mm if white else settings.nir_flange_mm
    shoulder = settings.white_flange_to_light_mm if white else settings.nir_flange_to_light_mm
    return LedHole(
        index=index,
        band=led.band,
        light_mm=np.asarray(led.position_mm, dtype=np.float64),
        back=-led.axis,
        radius_mm=diameter / 2 + settings.clearance_mm,
        pocket_radius_mm=flange / 2 + settings.clearance_mm,
        shoulder_mm=shoulder,
        back_mm=shoulder + settings.pocket_mm,
    )
