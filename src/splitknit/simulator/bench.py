"""Everything that a person puts under the rig to calibrate it, photographed by the twin.

A scene has a `camera`, its `leds`, and `light(lit)`: what reaches the sensor with those LEDs on. See docs/twin.md,
"The bench".
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from splitknit.errors import require
from splitknit.model import Camera, FloatArray, Led, PixelArray
from splitknit.simulator.bench_flat import Board, BoardScene, CardScene, DiscScene
from splitknit.simulator.bench_nail import NailScene
from splitknit.simulator.bench_poses import BoardPose, HandRanges, board_poses
from splitknit.simulator.bench_scene import BenchSettings, switched_on
from splitknit.simulator.bench_sphere import SphereScene
from splitknit.simulator.device import Scene
from splitknit.simulator.sensor import RESPONSE, SensorSettings, binning_scale, record

__all__ = [
    "BenchSettings",
    "Board",
    "BoardPose",
    "BoardScene",
    "CardScene",
    "DarkScene",
    "DiscScene",
    "HandRanges",
    "NailScene",
    "Scene",
    "SphereScene",
    "board_poses",
    "photograph_bench",
    "well_exposed",
]


@dataclass(frozen=True, eq=False, kw_only=True)
class DarkScene:
    """The lens cap is on: no light, whatever is switched on."""

    camera: Camera
    leds: tuple[Led, ...]

    def light(self, lit: Sequence[int]) -> FloatArray:
        """(H, W, 3) of zeros."""
        tuple(switched_on(self.leds, lit))
        return np.zeros((*self.camera.image_size, 3), dtype=np.float32)


def well_exposed(scene: Scene, lit: Sequence[Sequence[int]], level: float = 0.7) -> float:
    """Exposure at which the 99.9th percentile of the brightest of some images is at `level` of full scale.

    Parameters
    ----------
    scene : photographed
    lit : the LEDs of each image
    level : share of full scale
    """
    require(len(lit) > 0, "exposing needs at least one image.")
    brightest = max(float(np.percentile(scene.light(leds)[::4, ::4], 99.9)) for leds in lit)
    require(brightest > 0.0, "exposing needs some light, but all images are black.")
    return level / brightest


def photograph_bench(
    scene: Scene,
    lit: Sequence[int],
    seed: int | np.random.SeedSequence,
    *,
    exposure: float,
    sensor: SensorSettings | None = None,
    band: str = "white",
) -> PixelArray:
    """Photograph a scene.

    Parameters
    ----------
    scene : of the bench, or any other with `camera` and `light`
    lit : indices of the LEDs that are on
    seed : of the noise
    exposure : full scales per unit of light; :func:`well_exposed` finds one
    sensor : the camera's; its own `exposure` is not used here
    band : ``white`` or ``nir``: how the sensor responds

    Returns
    -------
    (H, W, 3) uint8 or uint16

    Raises
    ------
    BadInput
        If `exposure`, `band` or `lit` cannot be.
    """
    require(bool(np.isfinite(exposure)) and exposure > 0.0, f"exposure must be a positive number, but is {exposure}.")
    require(band in RESPONSE, f"band must be one of {', '.join(RESPONSE)}, but it is '{band}'.")
    seeds = seed if isinstance(seed, np.random.SeedSequence) else np.random.SeedSequence([seed, 0xB2])
    light = scene.light(lit) * np.float32(exposure)
    return record(light, band, seeds, sensor, binning_scale(scene.camera))
