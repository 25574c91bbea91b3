"""Fingers of the twin, sound and with faults."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from faulty_scene import Faults, FaultyScene
from splitknit_simulator.finger.finger import FingerPose
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import FingerScene
from twin_bench import Devices, twin_devices


@pytest.fixture(scope="session")
def finger() -> FingerScene:
    """A finger of 220 x 320 pixels."""
    return FingerScene(
        3, "whorl", TwinSettings(scale=0.1, pose=FingerPose(insertion_mm=26.0, yaw_rad=0.05))
    )


@pytest.fixture(scope="session")
def sharp_finger() -> FingerScene:
    """A finger of 550 x 800 pixels, fine enough for focus."""
    return FingerScene(1, None, TwinSettings(scale=0.25))


@pytest.fixture
def faulty(finger: FingerScene) -> Callable[..., Devices]:
    """Return devices around the small finger with faults."""
    return lambda **faults: twin_devices(FaultyScene(finger, Faults(**faults)))
