"""The simulated camera and LEDs: they implement :mod:`splitknit.devices`, on a clock that costs no
time.

The camera is timed like the Raspberry Pi's: it runs freely at its frame rate, a new exposure takes
effect some frames after it was asked for, and a frame is there when it was read out and carried
over. So the times that a capture session reports from the simulator are those of the design,
without the computer's own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

import cv2
import numpy as np

from splitknit import Camera, Led
from splitknit.devices import CameraDevice, ExposureRange, Frame, LightBank
from splitknit.errors import require
from splitknit.model import FloatArray
from splitknit_simulator.camera.sensor import RESPONSE, SensorSettings, binning_scale, record


class LitScene(Protocol):
    """What the twin's camera can look at: a finger, or a target on the bench."""

    @property
    def camera(self) -> Camera:
        """The camera that looks at it."""

    @property
    def leds(self) -> tuple[Led, ...]:
        """LEDs around it."""

    def light(self, lit: Sequence[int]) -> FloatArray:
        """(H, W, 3) noise-free white-balanced radiance with those LEDs on, in the rig's units."""


class Clock:
    """Time that passes only when asked to."""

    def __init__(self) -> None:
        """Start at zero."""
        self.now_s = 0.0

    def advance(self, seconds: float) -> None:
        """Let time pass."""
        require(seconds >= 0, "time does not run backwards.")
        self.now_s += seconds


_LINE_S = 18.904e-6
"""Time to read a row; exposures are whole numbers of it. Source: IMX219 driver in Linux."""
_SHORTEST_EXPOSURE_S = 4 * _LINE_S
"""Shortest exposure time: four rows. Source: IMX219 driver in Linux."""
_LARGEST_GAIN = 10.6
"""Largest gain; the smallest is 1. Source: IMX219 driver in Linux."""
_READOUT_S = 0.0466
"""Time from the first row to the last. Source: derived, 2464 rows of the IMX219."""
_FRAME_S = 0.0477
"""Shortest time from frame to frame. Source: IMX219 driver in Linux."""
SETTLE_S = 0.02
"""Until an LED is at full brightness, as the Raspberry Pi's lights wait: far above what an LED and
its supply need."""


class TwinLightBank(LightBank):
    """LEDs of a scene."""

    def __init__(self, scene: LitScene, clock: Clock) -> None:
        """Take the LEDs, all off."""
        self._clock = clock
        self._since: dict[int, float] = {}
        super().__init__(len(scene.leds), SETTLE_S)

    def brightness(self, at_s: float) -> float:
        """Fraction of its full light that the last LED that was switched on gives at a time: it
        rises evenly."""
        if not self._since:
            return 1.0
        return float(np.clip((at_s - max(self._since.values())) / self.settle_s, 0.0, 1.0))

    def _switch(self, led: int, lit: bool) -> None:
        if lit:
            self._since[led] = self._clock.now_s
        else:
            self._since.pop(led, None)

    def _wait(self, seconds: float) -> None:
        self._clock.advance(seconds)

    def _release(self) -> None:
        pass


SENSITIVITY_PER_S = 500.0
"""Fraction of full scale, of light of radiance one (in the rig's units) at gain one."""


class TwinCamera(CameraDevice):
    """A :class:`splitknit.devices.CameraDevice` that looks at a scene."""

    def __init__(
        self,
        scene: LitScene,
        lights: TwinLightBank,
        clock: Clock,
        *,
        sensor: SensorSettings | None = None,
        sensor_scale: float | None = None,
        seed: int = 0,
    ) -> None:
        """Start the camera that looks at the scene of `lights`; what was locked replaces
        `sensor.exposure`."""
        self._scene, self._lights, self._clock = scene, lights, clock
        self._sensor = sensor or SensorSettings()
        require(
            self._sensor.encoding == "linear",
            "the twin's camera gives linear images; leave sensor.encoding so.",
        )
        require(
            lights.count == len(scene.leds),
            "scene and bank of LEDs differ in their number of LEDs.",
        )
        require(seed >= 0, "seed must not be negative.")
        self._scale = sensor_scale or binning_scale(scene.camera)
        self._seed, self._exposed, self._photographs = seed, 0, 0
        self._closed = False
        self.image_size = scene.camera.image_size
        self.exposures = ExposureRange(
            _SHORTEST_EXPOSURE_S,
            0.2,  # 14 photographs in 7 s
            1.0,
            _LARGEST_GAIN,
        )
        self.lock(0.01, 1.0)

    def lock(self, exposure_s: float, gain: float, band: str = "white") -> None:
        """See :class:`splitknit.devices.CameraDevice`."""
        self.exposures.check(exposure_s, gain)
        require(band in RESPONSE, f"the bands are white and nir, not '{band}'.")
        self._exposure_s = round(exposure_s / _LINE_S) * _LINE_S
        self._gain, self._band = float(gain), band
        self._fresh = 3  # frames until a new exposure takes effect

    def capture(self) -> Frame:
        """See :class:`splitknit.devices.CameraDevice`."""
        if begins := getattr(self._scene, "frame_begins", None):
            begins(self._photographs)
        self._photographs += 1
        return self._expose(1)

    def preview(self) -> Frame:
        """See :class:`splitknit.devices.CameraDevice`."""
        return self._expose(max(1, round(self.image_size[1] / 800)))  # about 800 px wide

    def close(self) -> None:
        """See :class:`splitknit.devices.CameraDevice`."""
        self._closed = True

    def _expose(self, reduction: int) -> Frame:
        require(not self._closed, "the camera is closed; open it again.")
        frame_s = max(self._exposure_s + 0.001, _FRAME_S)
        begins_s = np.ceil(self._clock.now_s / frame_s - 1e-9) * frame_s + self._fresh * frame_s
        # the one that was being exposed when we were called
        discarded, self._fresh = 1 + self._fresh, 0
        light = self._light(begins_s)
        if reduction > 1:
            size = (light.shape[1] // reduction, light.shape[0] // reduction)
            light = np.asarray(
                cv2.resize(light, size, interpolation=cv2.INTER_AREA), dtype=np.float32
            )
        fraction = np.float32(self._exposure_s * self._gain * SENSITIVITY_PER_S)
        sensor = replace(
            self._sensor, full_well_e=max(self._sensor.full_well_e / self._gain, 100.0)
        )
        seed = np.random.SeedSequence([self._seed, 0xCA, self._exposed])
        pixels = record(light * fraction, self._band, seed, sensor, self._scale / reduction)
        self._exposed += 1
        ended_s = begins_s + self._exposure_s + _READOUT_S
        transferred_s = float(ended_s) + 0.07
        self._clock.advance(transferred_s - self._clock.now_s)
        return Frame(pixels, self._exposure_s, self._gain, 0.0, float(ended_s), discarded)

    def _light(self, at_s: float) -> FloatArray:
        """(H, W, 3) light of the LEDs as bright as they are."""
        lit = sorted(self._lights.lit)
        light = self._scene.light(lit)
        fraction = self._lights.brightness(at_s)
        if fraction < 1.0:
            dark = self._scene.light(())
            light = dark + np.float32(fraction) * (light - dark)
        return light
