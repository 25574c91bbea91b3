"""The twin's devices keep the contract."""

import pytest

from contract import CameraContract, LightContract
from splitknit.nominal import default_rig
from splitknit_simulator.camera.device import Clock, TwinCamera, TwinLightBank


class DarkRoom:
    """LEDs and nothing to see."""

    def __init__(self):
        rig = default_rig(0.05)
        self.camera, self.leds = rig.camera, rig.leds


class Watched(TwinLightBank):
    """Remembers what burns."""

    def __init__(self, scene, clock):
        self.burns, self.most = set(range(14)), 0
        super().__init__(scene, clock)
        self.most = 0

    def _switch(self, led, lit):
        super()._switch(led, lit)
        (self.burns.add if lit else self.burns.discard)(led)
        self.most = max(self.most, len(self.burns))


class TestTwinLights(LightContract):
    making = """
from test_contract_twin import DarkRoom, Watched
from splitknit_simulator.camera.device import Clock
bank = Watched(DarkRoom(), Clock())
burning = lambda: bank.burns
"""

    def bank(self):
        self.clock = Clock()
        self.watched = Watched(DarkRoom(), self.clock)
        return self.watched

    def burning(self):
        return self.watched.burns

    def most_at_once(self):
        return self.watched.most

    def now_s(self):
        return self.clock.now_s


class TestTwinCamera(CameraContract):
    @pytest.fixture(autouse=True)
    def look_at(self, finger):
        self.scene = finger

    def devices(self):
        self.clock = Clock()
        lights = TwinLightBank(self.scene, self.clock)
        return TwinCamera(self.scene, lights, self.clock), lights

    def now_s(self):
        return self.clock.now_s
