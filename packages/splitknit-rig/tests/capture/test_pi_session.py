"""The whole verb on a Raspberry Pi whose camera and pins are of our making, around a finger of the
twin."""

import io
import sys
from types import SimpleNamespace

import gpiozero
import numpy as np
import pytest
from test_contract_pi import PINS, mock_pins

from enrolled import facts_of, refusal_of
from fake_picamera2 import FakePicamera2, FakeRequest, World
from splitknit.cli.main import main
from splitknit.io.capture import read_capture
from splitknit.io.rig import write_rig
from splitknit.nominal import default_rig
from splitknit_rig.capture import pi

CAMERA = ("--set", "pi.image_size=[220, 320]")


class SceneCamera(FakePicamera2):
    """Sees the finger under whatever the pins light."""

    scene = None

    def capture_request(self):
        request = super().capture_request()
        request.__class__ = SceneRequest
        return request


class SceneRequest(FakeRequest):
    def make_array(self, name):
        pins = [gpiozero.Device.pin_factory.pin(pin) for pin in PINS]
        lit = [k for k, pin in enumerate(pins) if pin.function == "output" and pin.state]
        fraction = self.shot.exposure_us * 1e-6 * self.shot.gain * 500
        rng = np.random.default_rng(self.shot.at_ns)
        light = 255 * fraction * self.camera.scene.light(lit)
        return np.clip(np.rint(light + rng.normal(0, 0.7, light.shape)), 0, 255).astype(np.uint8)


@pytest.fixture
def rig_of_pi(monkeypatch, finger, tmp_path):
    """A Raspberry Pi with a finger; returns the command's first words, and the world."""
    world = World()
    monkeypatch.setattr(SceneCamera, "world", world)
    monkeypatch.setattr(SceneCamera, "scene", finger)
    monkeypatch.setitem(sys.modules, "picamera2", SimpleNamespace(Picamera2=SceneCamera))
    monkeypatch.setattr(pi.time, "clock_gettime_ns", lambda clock: world.now_ns)
    monkeypatch.setattr(pi.PiLightBank, "_wait", lambda self, seconds: world.sleep(seconds))
    mock_pins()
    write_rig(default_rig(0.1, 0), tmp_path / "rig.json")
    yield [*f"capture --device pi --rig {tmp_path}/rig.json".split(), *CAMERA], world
    pins = [gpiozero.Device.pin_factory.pin(pin) for pin in PINS]
    assert not any(pin.state for pin in pins if pin.function == "output")
    gpiozero.Device.pin_factory.reset()
    gpiozero.Device.pin_factory = None


def test_a_session_on_a_pi_writes_a_capture(rig_of_pi, tmp_path, capsys):
    words, world = rig_of_pi
    before = world.now_ns
    person = "--subject", "S03", "--finger", "right_index"
    facts = facts_of(capsys, *words, "--out", tmp_path / "c", *person)
    capture = read_capture(tmp_path / "c")
    assert capture.subject == {"id": "S03", "session": 1, "finger": "right_index"}
    assert capture.captured_at is not None
    assert capture.truth is None
    assert len(capture.bands["white"].pixels) == len(capture.bands["nir"].pixels) == 7
    assert facts["device"] == "pi"
    assert (world.now_ns - before) * 1e-9 < 20
    assert facts["seconds"] < 7  # stale frames, late settings and settling LEDs included
    (finding,) = facts["findings"]
    assert finding["code"] == "untested-camera"
    assert finding["message"] == f"the imx219 camera was {pi.UNTESTED}"
    assert all(shot["discarded"] >= 1 for shot in facts["shots"])


def test_a_camera_of_another_size_than_the_rig_is_refused(rig_of_pi, tmp_path, capsys):
    words, _ = rig_of_pi
    words = *words[:-2], "--set", "pi.image_size=[64, 96]", "--out", tmp_path / "c"
    assert "another camera: its images have 220 x 320" in refusal_of(capsys, *words)
    assert not (tmp_path / "c").exists()


def test_an_enrolment_requests_every_finger_on_the_terminal(
    rig_of_pi, tmp_path, capsys, monkeypatch
):
    words, _ = rig_of_pi
    answers = io.StringIO("\ns\nq\n")
    answers.isatty = lambda: True
    monkeypatch.setattr(sys, "stdin", answers)
    folder = tmp_path / "e"
    plan = "--subjects", "1", "--sessions", "1", "--fingers", "right_index,right_middle,left_thumb"
    assert main([*words, "--enrolment", str(folder), *plan]) == 0
    out, err = capsys.readouterr()
    assert "S01, session 1, right index: lay it down" in err
    assert "Skipped: S01/session_1/right_middle" in out
    assert "1 of 3 are finished" in out
    assert [file.parent.name for file in folder.rglob("capture.json")] == ["right_index"]
