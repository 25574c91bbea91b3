"""Devices of the twin around one small finger."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from splitknit.simulate.device import Clock, Scene, TwinCamera, TwinDeviceSettings, TwinLightBank
from splitknit.simulate.faults import Faults, FaultyScene
from splitknit.simulate.finger import Pose
from splitknit.simulate.finger_scene import FingerScene
from splitknit.simulate.twin import TwinSettings

Devices = tuple[TwinCamera, TwinLightBank, Clock]


@pytest.fixture(scope="session")
def finger() -> FingerScene:
    """A finger of 220 x 320 pixels."""
    return FingerScene(3, "whorl", TwinSettings(scale=0.1, pose=Pose(insertion_mm=26.0, yaw_rad=0.05)))


@pytest.fixture(scope="session")
def sharp_finger() -> FingerScene:
    """A finger of 550 x 800 pixels, fine enough for focus."""
    return FingerScene(1, None, TwinSettings(scale=0.25))


def twin_devices(scene: Scene, settings: TwinDeviceSettings | None = None) -> Devices:
    """Camera, LEDs and clock around a scene."""
    clock = Clock()
    lights = TwinLightBank(scene, clock, settings)
    return TwinCamera(scene, lights, clock, settings), lights, clock


@pytest.fixture
def faulty(finger: FingerScene) -> Callable[..., Devices]:
    """Return devices around the small finger with faults."""
    return lambda **faults: twin_devices(FaultyScene(finger, Faults(**faults)))
