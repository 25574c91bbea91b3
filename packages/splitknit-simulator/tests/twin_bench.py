"""The twin's devices around a scene."""

from __future__ import annotations

from splitknit_simulator.camera.device import Clock, LitScene, TwinCamera, TwinLightBank

Devices = tuple[TwinCamera, TwinLightBank, Clock]


def twin_devices(scene: LitScene) -> Devices:
    """Camera, LEDs and clock around a scene."""
    clock = Clock()
    lights = TwinLightBank(scene, clock)
    return TwinCamera(scene, lights, clock), lights, clock
