"""What goes wrong in front of a real camera, on purpose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from splitknit.model import Camera, FloatArray, Led
from splitknit_simulator.camera.device import LitScene


@dataclass(frozen=True, slots=True)
class Faults:
    """Faults by the number of the full-size photograph (from 0, previews not counted) from which on
    they hold."""

    moves_mm: Mapping[int, tuple[float, float]] = field(default_factory=dict)
    """Step of the finger (x right, y up) before a photograph; steps add up."""
    blur_mm: Mapping[int, float] = field(default_factory=dict)
    """Defocus (standard deviation, on the finger plane) from a photograph on."""
    dead: frozenset[int] = frozenset()
    """LEDs that do not light."""
    dies_at: Mapping[int, int] = field(default_factory=dict)
    """LED to the photograph from which on it does not light."""
    flickers_at: frozenset[int] = frozenset()
    """Photographs in which no LED lights."""
    room: float = 0.0
    """Radiance of stray light, the same everywhere."""


class FaultyScene:
    """A scene with faults."""

    def __init__(self, scene: LitScene, faults: Faults) -> None:
        """Spoil `scene`."""
        self.scene, self.faults = scene, faults
        self._number = -1

    @property
    def camera(self) -> Camera:
        """The scene's camera."""
        return self.scene.camera

    @property
    def leds(self) -> tuple[Led, ...]:
        """The scene's LEDs."""
        return self.scene.leds

    def frame_begins(self, number: int) -> None:
        """Note that full-size photograph `number` begins."""
        self._number = number

    def light(self, lit: Sequence[int]) -> FloatArray:
        """(H, W, 3) light of the scene with the faults of the present photograph."""
        faults, now = self.faults, self._number
        burning = [
            led
            for led in lit
            if led not in faults.dead
            and faults.dies_at.get(led, now + 1) > now
            and now not in faults.flickers_at
        ]
        frame = self.scene.light(burning) + np.float32(faults.room)
        steps = [step for number, step in faults.moves_mm.items() if number <= now]
        if steps:
            x, y = np.sum(steps, axis=0) * self.camera.px_per_mm
            matrix = np.array([[1.0, 0.0, x], [0.0, 1.0, -y]])
            size = (frame.shape[1], frame.shape[0])
            warped = cv2.warpAffine(
                frame, matrix, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
            )
            frame = np.asarray(warped, dtype=np.float32)
        begun = [number for number in faults.blur_mm if number <= now]
        sigma = faults.blur_mm[max(begun)] * self.camera.px_per_mm if begun else 0.0
        if sigma > 0:
            frame = np.asarray(cv2.GaussianBlur(frame, (0, 0), sigma), dtype=np.float32)
        return frame
