"""Cameras of other makers: simulated streams keep the contract, substitutes of OpenCV and harvesters are driven."""

from __future__ import annotations

import sys
from contextlib import contextmanager
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from test_contract_pi import PINS, pins, recording_line  # noqa: F401 - a fixture

from contract import CameraContract
from fake_picamera2 import World
from splitknit.devices import ExposureRange
from splitknit.errors import BadInput
from splitknit.imaging.band import decode_table
from splitknit.model import default_rig
from splitknit_rig.capture.pi import PiCameraSettings, PiLightBank, opened_pi
from splitknit_rig.capture.streams import StreamCamera, _Grab, open_genicam, open_uvc

FRAME_NS = 33_000_000


class SimulatedStream:
    """A camera that runs freely, with four buffers that hold stale frames, or one that waits for its trigger."""

    image_size = (64, 96)
    exposures = ExposureRange(1e-4, 0.2, 1.0, 8.0)

    def __init__(self, world: World, kind: str) -> None:
        self.world, self.kind, self.closed = world, kind, 0
        self.exposure_s, self.gain = 0.02, 1.0
        self.taken = [(world.now_ns - FRAME_NS, 0.02, 1.0)]  # began, exposure, gain
        self.asked: list[tuple[int, float, float]] = []
        self.given = 0

    def set(self, exposure_s: float, gain: float) -> None:
        if self.kind == "triggered":
            self.exposure_s, self.gain = exposure_s, gain
        self._run_on()
        self.asked.append((len(self.taken) + 3, exposure_s, gain))

    def _run_on(self) -> None:
        while self.taken[-1][0] < self.world.now_ns:
            began, exposure_s, gain = self.taken[-1]
            for since, wanted_s, wanted_gain in self.asked:
                if len(self.taken) >= since:
                    exposure_s, gain = wanted_s, wanted_gain
            self.taken.append((began + max(FRAME_NS, round(exposure_s * 1e9)), exposure_s, gain))

    def grab(self) -> _Grab:
        world = self.world
        if self.kind == "triggered":
            began, exposure_s, gain = world.now_ns, self.exposure_s, self.gain
        else:
            self._run_on()
            done = [k for k, shot in enumerate(self.taken) if shot[0] + shot[1] * 1e9 <= world.now_ns]
            self.given = max(self.given, len(done) - 4)
            while self.given >= len(self.taken):
                world.now_ns = self.taken[-1][0] + 1
                self._run_on()
            began, exposure_s, gain = self.taken[self.given]
            self.given += 1
        ended = began + round(exposure_s * 1e9)
        world.now_ns = max(world.now_ns, ended)
        pixels = self.pixels_of(began, ended, exposure_s, gain)
        if self.kind == "blind":
            return _Grab(pixels, self.now_s())
        return _Grab(pixels, self.now_s(), began * 1e-9, exposure_s, gain)

    def pixels_of(self, began: int, ended: int, exposure_s: float, gain: float) -> np.ndarray:
        lit = self.world.lit_throughout(began, ended)
        level = 255 if -1 in lit else 2 + sum(1 + line for line in lit) * 3
        return np.full((64, 96, 3), level, dtype=np.uint8)

    def now_s(self) -> float:
        return self.world.now_ns * 1e-9

    def close(self) -> None:
        self.closed += 1


class StreamContract(CameraContract):
    readout_s = 0.0  # in the time of exposure, here
    kind = ""

    @pytest.fixture(autouse=True)
    def hardware(self, pins):  # noqa: F811
        self.world = World()

    def devices(self):
        lights = PiLightBank(PINS, recording_line(self.world), sleep=self.world.sleep)
        return StreamCamera(SimulatedStream(self.world, self.kind)), lights

    def now_s(self):
        return self.world.now_ns * 1e-9


class TestTagged(StreamContract):
    kind = "tagged"


class TestTriggered(StreamContract):
    kind = "triggered"

    def test_no_frame_is_thrown_away(self):
        camera, lights = self.devices()
        with lights, camera:
            assert [camera.capture().discarded for _ in range(3)] == [0, 0, 0]


class TestBlind(StreamContract):
    kind = "blind"

    def test_as_many_are_thrown_away_as_can_wait(self):
        camera, lights = self.devices()
        with lights, camera:
            assert camera.capture().discarded == 9  # after a new exposure
            assert camera.capture().discarded == 5


def test_a_stream_that_does_not_obey_is_refused_and_closed_once():
    stream = SimulatedStream(World(), "tagged")
    with StreamCamera(stream) as camera:
        stream.set = lambda exposure_s, gain: None  # type: ignore[method-assign]
        camera.lock(0.1, 4.0)
        with pytest.raises(BadInput, match=r"did not take its settings: 0.1 s at gain 4 .* 0.01 s at gain 1"):
            camera.capture()
        camera.close()
    assert stream.closed == 1


class FakeVideo:
    """What is used of ``cv2.VideoCapture``."""

    def __init__(self, number: int) -> None:
        self.number, self.open = number, number == 0
        self.values = {cv2.CAP_PROP_FRAME_HEIGHT: 48.0, cv2.CAP_PROP_FRAME_WIDTH: 64.0}
        self.locked: set[int] = set()
        self.frames = 0

    def isOpened(self) -> bool:  # noqa: N802 - OpenCV's
        return self.open

    def set(self, what: int, value: float) -> bool:
        if what not in self.locked:
            self.values[what] = value
        return what not in self.locked

    def get(self, what: int) -> float:
        return self.values.get(what, 0.0)

    def read(self):
        self.frames += 1
        image = np.zeros((48, 64, 3), dtype=np.uint8)
        image[..., 2] = 128  # red, in OpenCV's order
        return True, image

    def release(self) -> None:
        self.open = False


def test_a_webcam_is_set_by_hand_and_straightened():
    made: list[FakeVideo] = []

    def make(number):
        made.append(FakeVideo(number))
        return made[-1]

    stream = open_uvc(0, make)
    with StreamCamera(stream) as camera:
        values = made[0].values
        assert values[cv2.CAP_PROP_AUTO_EXPOSURE] == 1
        assert values[cv2.CAP_PROP_AUTO_WB] == 0
        camera.lock(0.0203, 1.0)
        assert values[cv2.CAP_PROP_EXPOSURE] == 203
        frame = camera.capture()
        assert frame.pixels.shape == (48, 64, 3)
        assert frame.pixels.dtype == np.uint16
        assert frame.pixels[0, 0].tolist() == [round(128 / 255 * 65535), 0, 0]  # its gamma was set to 1
        assert frame.exposure_s == 0.0203
        with pytest.raises(BadInput, match="gain is 1 to 1"):
            camera.lock(0.02, 2.0)
    assert not made[0].open
    with pytest.raises(BadInput, match="no UVC camera 3 was found"):
        open_uvc(3, make)


def test_a_webcam_without_gamma_is_taken_as_srgb_and_one_without_exposure_refused():
    made = FakeVideo(0)
    made.locked = {cv2.CAP_PROP_GAMMA}
    with StreamCamera(open_uvc(0, lambda _: made)) as camera:
        red = int(camera.capture().pixels[0, 0, 0])
        assert red == round(float(decode_table(np.dtype(np.uint8), "srgb")[128]) * 65535)
    made = FakeVideo(0)
    made.locked = {cv2.CAP_PROP_EXPOSURE}
    with pytest.raises(BadInput, match="does not let its exposure be set"):
        StreamCamera(open_uvc(0, lambda _: made))
    made = FakeVideo(0)
    made.read = lambda: (False, None)  # type: ignore[method-assign]
    with StreamCamera(open_uvc(0, lambda _: made)) as camera, pytest.raises(BadInput, match="gave no picture"):
        camera.capture()


class FakeNode(SimpleNamespace):
    def execute(self):
        self.executed = getattr(self, "executed", 0) + 1


def fake_harvesters(monkeypatch, tmp_path, formats=("Mono8", "BayerRG12"), broken=False):
    """A module ``harvesters.core`` with one camera; return its node map."""
    nodes = SimpleNamespace(
        ExposureAuto=FakeNode(value="Continuous"), GainAuto=FakeNode(value="Continuous"),
        PixelFormat=FakeNode(value="Mono8", symbolics=formats), TriggerMode=FakeNode(value="Off"),
        TriggerSource=FakeNode(value="Line0"), TriggerSoftware=FakeNode(), Height=FakeNode(value=32),
        Width=FakeNode(value=48), ExposureTime=FakeNode(value=5000.0, min=20.0, max=1e7),
        Gain=FakeNode(value=0.0, min=0.0, max=24.0),
    )  # fmt: skip
    log: list[str] = []

    @contextmanager
    def fetch(timeout):
        if broken:
            raise RuntimeError("timeout  (-1011)")
        values = np.zeros((32, 48), dtype=np.uint16)
        values[0::2, 0::2] = 1000  # red
        component = SimpleNamespace(data=values.ravel(), height=32, width=48)
        yield SimpleNamespace(payload=SimpleNamespace(components=[component]))

    acquirer = SimpleNamespace(
        remote_device=SimpleNamespace(node_map=nodes), start=lambda: log.append("start"),
        stop=lambda: log.append("stop"), destroy=lambda: log.append("destroy"), fetch=fetch,
    )  # fmt: skip

    class Harvester:
        device_info_list = ("camera",)

        def add_file(self, path):
            log.append(path)

        def update(self):
            pass

        def create(self, number):
            return acquirer

        def reset(self):
            log.append("reset")

    (tmp_path / "maker.cti").touch()
    monkeypatch.setenv("GENICAM_GENTL64_PATH", str(tmp_path))
    monkeypatch.setitem(sys.modules, "harvesters", SimpleNamespace(core=SimpleNamespace(Harvester=Harvester)))
    monkeypatch.setitem(sys.modules, "harvesters.core", SimpleNamespace(Harvester=Harvester))
    return nodes, log


def test_an_industrial_camera_is_triggered_frame_by_frame(monkeypatch, tmp_path):
    nodes, log = fake_harvesters(monkeypatch, tmp_path)
    with StreamCamera(open_genicam(0)) as camera:
        assert (nodes.ExposureAuto.value, nodes.GainAuto.value) == ("Off", "Off")
        assert (nodes.TriggerMode.value, nodes.TriggerSource.value) == ("On", "Software")
        assert nodes.PixelFormat.value == "BayerRG12"  # the best of what it has
        assert camera.image_size == (32, 48)
        assert camera.exposures.highest_gain == pytest.approx(15.85, rel=1e-3)  # 24 dB
        camera.lock(0.03, 2.0)
        assert nodes.ExposureTime.value == pytest.approx(30_000)
        assert nodes.Gain.value == pytest.approx(6.02, abs=0.01)
        frame = camera.capture()
        assert nodes.TriggerSoftware.executed == 1
        assert frame.discarded == 0
        assert frame.gain == pytest.approx(2.0)
        assert frame.pixels[8, 8].tolist() == [16_000, 0, 0]
    assert log == [str(tmp_path / "maker.cti"), "start", "stop", "destroy", "reset"]


def test_what_an_industrial_camera_lacks_is_named(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "harvesters", None)
    with pytest.raises(BadInput, match="install the extra genicam"):
        open_genicam(0)
    fake_harvesters(monkeypatch, tmp_path, formats=("YUV422",))
    with pytest.raises(BadInput, match="offers no pixel format"):
        open_genicam(0)
    fake_harvesters(monkeypatch, tmp_path)
    with pytest.raises(BadInput, match="no GenICam camera 2; 1 were found"):
        open_genicam(2)
    (tmp_path / "maker.cti").unlink()
    with pytest.raises(BadInput, match="no GenTL producer"):
        open_genicam(0)
    fake_harvesters(monkeypatch, tmp_path, formats=("Mono8",), broken=True)
    with StreamCamera(open_genicam(0)) as camera, pytest.raises(BadInput, match=r"after its trigger \(timeout"):
        camera.capture()


def test_a_mono_industrial_camera_gives_one_channel(monkeypatch, tmp_path):
    fake_harvesters(monkeypatch, tmp_path, formats=("Mono12",))
    with StreamCamera(open_genicam(0)) as camera:
        assert camera.capture().pixels.shape == (32, 48, 1)
        assert camera.preview().pixels.shape == (32, 48, 1)


def test_the_pi_s_leds_work_with_any_camera(pins, monkeypatch, tmp_path):  # noqa: F811
    fake_harvesters(monkeypatch, tmp_path)
    with opened_pi(default_rig(), PiCameraSettings(camera="genicam")) as devices:
        devices.lights.on(4)
        assert devices.camera.capture().pixels.shape == (32, 48, 3)
    assert not any(pins.pin(pin).function == "output" and pins.pin(pin).state for pin in PINS)
