"""A small picamera2 for tests: frames on a clock, settings that arrive late, buffers that hold
stale frames."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

READOUT_NS = 46_600_000
CARRIED_NS = 60_000_000
LATE = 3


@dataclass
class World:
    """Time, and what was lit when."""

    now_ns: int = 5_000_000_000
    lit: set[int] = field(default_factory=set)
    history: list[tuple[int, frozenset[int]]] = field(default_factory=list)

    def sleep(self, seconds: float) -> None:
        self.now_ns += round(seconds * 1e9)

    def switch(self, line: int, value: bool) -> None:
        (self.lit.add if value else self.lit.discard)(line)
        self.history.append((self.now_ns, frozenset(self.lit)))

    def lit_throughout(self, begin_ns: int, end_ns: int) -> frozenset[int]:
        """Lines that were on for the whole time, or {-1} if anything was switched in it."""
        state: frozenset[int] = frozenset()
        for at, lit in self.history:
            if at <= begin_ns:
                state = lit
            elif at < end_ns:
                return frozenset({-1})
        return state


@dataclass
class Shot:
    at_ns: int
    exposure_us: int
    gain: float
    colours: tuple[float, float]


class FakeRequest:
    def __init__(self, camera: FakePicamera2, shot: Shot) -> None:
        self.camera, self.shot, self.released = camera, shot, False

    def get_metadata(self) -> dict[str, Any]:
        shot = self.shot
        return {
            "SensorTimestamp": shot.at_ns,
            # the sensor counts lines, and its gain has steps
            "ExposureTime": int(shot.exposure_us / 18.904) * 18.904 // 1,
            "AnalogueGain": 256 / (256 - round(256 - 256 / shot.gain)),
            "DigitalGain": 1.0,
            "ColourGains": shot.colours,
            "FrameDuration": 47_700,
        }

    def make_array(self, name: str) -> np.ndarray:
        world, shot = self.camera.world, self.shot
        lit = world.lit_throughout(shot.at_ns - 1000 * shot.exposure_us, shot.at_ns + READOUT_NS)
        if name == "raw":
            columns, rows = self.camera.configuration["raw"]["size"]
            dark = {"imx477": 256, "imx296": 60}.get(self.camera.model, 64)
            values = np.full((rows, columns), dark + 16 * len(lit), dtype=np.uint16)
            values[0::2, 0::2] += 5  # blue
            values[1::2, 1::2] += 9  # red
            if self.camera.pi5:  # 16 bits whatever was asked for
                values <<= 4 if self.camera.model == "imx477" else 6
            return values.view(np.uint8)
        columns, rows = self.camera.configuration["main"]["size"]
        image = np.zeros((rows, columns, 3), dtype=np.uint8)
        image[..., 0] = 255 if -1 in lit else sum(1 + line for line in lit)
        image[..., 1] = 2
        return image

    def release(self) -> None:
        assert not self.released
        self.released = True


class FakePicamera2:
    """What :mod:`splitknit_rig.capture.pi` uses of ``picamera2.Picamera2``."""

    cameras = 1
    world = World()
    stuck = False
    broken = False
    opened: list[FakePicamera2] = []  # noqa: RUF012 - tests look into it
    model = "imx219"
    pi5 = False

    @classmethod
    def global_camera_info(cls) -> list[dict[str, Any]]:
        return [{"Model": cls.model, "Num": n} for n in range(cls.cameras)]

    @classmethod
    def load_tuning_file(cls, name: str) -> dict[str, Any]:
        assert name.startswith(cls.model) and name.endswith(".json")
        return tuning()

    def camera_configuration(self) -> dict[str, Any]:
        raw = dict(self.configuration["raw"])
        if self.pi5:
            raw["format"] = raw["format"].rstrip("0123456789") + "16"
        return self.configuration | {"raw": raw}

    def __init__(self, tuning: dict[str, Any] | None = None) -> None:
        if self.broken:
            raise RuntimeError("Failed to acquire camera:\n Device or resource busy")
        self.tuning, self.configuration, self.calls = tuning, {}, []
        self.asked: list[tuple[int, dict[str, Any]]] = []
        self.shots: list[Shot] = []
        self.delivered = 0
        self.requests: list[FakeRequest] = []
        type(self).opened.append(self)

    def create_still_configuration(self, **parts: Any) -> dict[str, Any]:
        return parts

    def configure(self, configuration: dict[str, Any]) -> None:
        self.configuration = configuration

    def start(self) -> None:
        self.calls.append("start")
        self.shots = [Shot(self.world.now_ns, 20_000, 2.0, (1.5, 1.5))]

    def stop(self) -> None:
        self.calls.append("stop")

    def close(self) -> None:
        self.calls.append("close")

    def set_controls(self, controls: dict[str, Any]) -> None:
        self._run_on()
        self.asked.append((len(self.shots) + LATE, controls))

    def capture_request(self) -> FakeRequest:
        """Return the oldest frame that still waits in a buffer, or the next when it is there."""
        self._run_on()
        complete = [
            k
            for k, shot in enumerate(self.shots)
            if shot.at_ns + READOUT_NS + CARRIED_NS <= self.world.now_ns
        ]
        self.delivered = max(self.delivered, len(complete) - 2)
        while self.delivered >= len(self.shots):
            self._next()
        shot = self.shots[self.delivered]
        self.delivered += 1
        self.world.now_ns = max(self.world.now_ns, shot.at_ns + READOUT_NS + CARRIED_NS)
        self.requests.append(FakeRequest(self, shot))
        return self.requests[-1]

    def _run_on(self) -> None:
        while self.shots[-1].at_ns < self.world.now_ns:
            self._next()

    def _next(self) -> None:
        before, number = self.shots[-1], len(self.shots)
        controls: dict[str, Any] = {}
        for since, asked in self.asked:
            if number >= since and not self.stuck:
                controls |= asked
        exposure = controls.get("ExposureTime", before.exposure_us)
        duration = max(47_700, exposure + 1000)
        gain, colours = (
            controls.get("AnalogueGain", before.gain),
            controls.get("ColourGains", before.colours),
        )
        self.shots.append(Shot(before.at_ns + 1000 * duration, exposure, gain, colours))


def tuning() -> dict[str, Any]:
    """The parts of a tuning file that matter."""
    return {
        "version": 2.0,
        "target": "bcm2835",
        "algorithms": [
            {"rpi.black_level": {"black_level": 4096}},
            {"rpi.agc": {}},
            {"rpi.alsc": {"luminance_strength": 0.8}},
            {"rpi.contrast": {"ce_enable": 1, "gamma_curve": [0, 0, 1024, 5040, 65535, 65535]}},
            {"rpi.ccm": {"ccms": [{"ct": 2860, "ccm": [2, -1, 0, 0, 2, -1, 0, -1, 2]}]}},
        ],
    }
