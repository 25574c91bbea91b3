"""The Raspberry Pi's devices keep the contract: gpiozero on mock pins, and a small picamera2 of our
own."""

import gpiozero
import pytest
from gpiozero.pins.mock import MockFactory

from contract import CameraContract, LightContract
from fake_picamera2 import FakePicamera2, World
from splitknit_rig.capture.pi import PiCamera, PiCameraSettings, PiLightBank
from splitknit_rig.capture.pins import NIR_PINS, WHITE_PINS

PINS = WHITE_PINS + NIR_PINS


def mock_pins():
    """Pins of a Raspberry Pi that is not there."""
    gpiozero.Device.pin_factory = MockFactory()
    return gpiozero.Device.pin_factory


@pytest.fixture
def pins():
    factory = mock_pins()
    yield factory
    factory.reset()
    gpiozero.Device.pin_factory = None


def recording_line(world):
    """Lines of gpiozero that tell the world when they are switched."""

    def make(pin, **options):
        line = gpiozero.DigitalOutputDevice(pin, **options)
        number, on, off = PINS.index(pin), line.on, line.off

        class Line:
            def on(self):
                on()
                world.switch(number, True)

            def off(self):
                off()
                world.switch(number, False)

            def close(self):
                line.close()

        return Line()

    return make


class TestPiLights(LightContract):
    making = """
from test_contract_pi import PINS, mock_pins
from splitknit_rig.capture.pi import PiLightBank
import gpiozero
factory = mock_pins()
bank = PiLightBank(PINS, gpiozero.DigitalOutputDevice)
def burning():
    pins = [factory.pin(pin) for pin in PINS]
    return [k for k, pin in enumerate(pins) if pin.function == "output" and pin.state]
"""

    @pytest.fixture(autouse=True)
    def hardware(self, pins):
        self.pins = pins

    def bank(self):
        self.world = World()
        for pin in PINS:  # lit by whoever ran before
            self.pins.pin(pin).function = "output"
            self.pins.pin(pin).state = True
        return PiLightBank(PINS, recording_line(self.world), sleep=self.world.sleep)

    def burning(self):
        # a closed line is an input: its transistor's base resistor pulls it down
        return {
            k
            for k, pin in enumerate(PINS)
            if self.pins.pin(pin).function == "output" and self.pins.pin(pin).state
        }

    def most_at_once(self):
        return max(len(lit) for _, lit in self.world.history)

    def now_s(self):
        return self.world.now_ns * 1e-9


class TestPiCamera(CameraContract):
    raw = False

    @pytest.fixture(autouse=True)
    def hardware(self, pins, monkeypatch):
        self.world = World()
        monkeypatch.setattr(FakePicamera2, "world", self.world)

    def devices(self):
        lights = PiLightBank(PINS, recording_line(self.world), sleep=self.world.sleep)
        settings = PiCameraSettings(image_size=(64, 96), raw=self.raw)
        return PiCamera(FakePicamera2, settings, now_ns=lambda: self.world.now_ns), lights

    def now_s(self):
        return self.world.now_ns * 1e-9


class TestPiCameraRaw(TestPiCamera):
    raw = True
