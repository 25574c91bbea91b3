"""Does a capture keep frames that another LED, or another exposure, made than it states?

    python validation/rig_check/synchrony.py                # 10,000 frames of each camera

A drawn ball under a rig's LEDs, and a camera between it and the capture session that misbehaves:
it lags, repeats frames, exposes as it was told before, or reads half of a frame late, now and then
or always, and states each time what it was asked for. Counted are the frames of captures that the
session takes for good, and the wrong ones among them. An ambient frame is wrong if an LED was lit;
its exposure does not show in the dark.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from splitknit import BadInput, Rig
from splitknit.devices import CameraDevice, ExposureRange, Frame, LightBank, Opened
from splitknit.io.csv_table import csv_text
from splitknit.nominal import default_rig
from splitknit_rig.capture.session import SessionSettings, run_session

HERE = Path(__file__).resolve().parent
CAMERAS: Mapping[str, tuple[str, float]] = {
    "as it should be": ("", 0.0),
    "lags by one to three frames, one in 50": ("late", 0.02),
    "lags by one frame, always": ("late", 1.0),
    "repeats a frame, one in 50": ("again", 0.02),
    "exposes as before, one in 50": ("settings", 0.02),
    "exposes as before, for three frames": ("settled", 0.0),
    "reads half a frame late, one in 50": ("half", 0.02),
    "all of them, one in 20": ("any", 0.05),
}
"""What a camera does, and how often."""


@dataclass(frozen=True)
class Made:
    """What made a frame."""

    leds: frozenset[int]
    exposure: float
    band: str


class Bank(LightBank):
    """LEDs without hardware."""

    def _switch(self, led: int, lit: bool) -> None:
        pass

    def _wait(self, seconds: float) -> None:
        pass

    def _release(self) -> None:
        pass


class Camera(CameraDevice):
    """A camera that looks at a drawn ball and misbehaves."""

    def __init__(self, rig: Rig, lights: Bank, kind: str, rate: float, seed: int) -> None:
        self.image_size = rig.camera.image_size
        self.exposures = ExposureRange(1e-4, 0.2, 1.0, 8.0)
        self._lights, self._kind, self._rate = lights, kind, rate
        self._rng = np.random.default_rng(seed)
        rows, columns = self.image_size
        y, x = np.mgrid[:rows, :columns]
        x, y = (2 * x - columns + 1) / rows, (rows - 1 - 2 * y) / rows
        normals = np.dstack([x, y, np.sqrt(np.maximum(1.0 - x * x - y * y, 0.0))])
        places = np.array([led.position_mm for led in rig.leds])
        towards = places / np.linalg.norm(places, axis=1, keepdims=True)
        albedo = 0.8 + 0.1 * self._rng.standard_normal((rows, columns))
        self._light = 40.0 * albedo * np.maximum(np.einsum("ki,hwi->khw", towards, normals), 0.0)
        self._light *= (x * x + y * y < 1.0) * self._rng.uniform(0.8, 1.2, (len(places), 1, 1))
        self._history: list[Made] = []
        self._locks: list[tuple[float, float, str]] = []
        self._since_lock = 0
        self.made: dict[bytes, tuple[Made, ...]] = {}
        self.lock(0.01, 1.0)

    def lock(self, exposure_s: float, gain: float, band: str = "white") -> None:
        self.exposures.check(exposure_s, gain)
        if not self._locks or self._locks[-1] != (exposure_s, gain, band):
            self._locks.append((exposure_s, gain, band))
            self._since_lock = 0

    def close(self) -> None:
        pass

    def preview(self) -> Frame:
        return self.capture()

    def capture(self) -> Frame:
        exposure_s, gain, band = self._locks[-1]
        now = Made(self._lights.lit, exposure_s * gain, band)
        self._history.append(now)
        parts: tuple[Made, ...] = (now, now)
        kind = self._kind
        if kind == "any":
            kind = str(self._rng.choice(["late", "again", "settings", "half"]))
        misbehaves = self._rng.random() < self._rate
        before = self._locks[-2] if len(self._locks) > 1 else self._locks[-1]
        stale = Made(now.leds, before[0] * before[1], before[2])
        if kind == "late" and misbehaves:
            lag = 1 if self._rate == 1.0 else int(self._rng.integers(1, 4))
            old = self._history[max(len(self._history) - 1 - lag, 0)]
            parts = old, old
        elif kind == "again" and misbehaves and len(self._history) > 1:
            parts = self._shown
        elif (kind == "settings" and misbehaves) or (kind == "settled" and self._since_lock < 3):
            parts = stale, stale
        elif kind == "half" and misbehaves and len(self._history) > 1:
            parts = self._history[-2], now
        self._shown = parts
        self._since_lock += 1
        half = self.image_size[0] // 2
        images = [self._image(part) for part in parts]
        pixels = np.concatenate([images[0][:half], images[1][half:]])
        self.made[pixels.tobytes()] = parts
        return Frame(pixels, exposure_s, gain, 0.0, 0.1 * len(self._history))

    def _image(self, made: Made) -> np.ndarray:
        light = self._light[sorted(made.leds)].sum(axis=0) + 0.02
        colours = np.array([1.0, 0.9, 0.7]) if made.band == "white" else np.array([0.9, 0.7, 0.35])
        value = 255.0 * made.exposure * light[..., None] * colours
        noise = self._rng.standard_normal(value.shape) * np.sqrt(0.05 * value + 0.1)
        return np.clip(np.rint(value + noise), 0, 255).astype(np.uint8)


def is_wrong(camera: Camera, pixels: Any, led: int | None, exposure: float, band: str) -> bool:
    """Whether a frame was not made as its capture states."""
    for made in camera.made[pixels.tobytes()]:
        wanted = frozenset() if led is None else frozenset({led})
        if made.leds != wanted:
            return True
        if led is not None and (abs(made.exposure / exposure - 1) > 0.01 or made.band != band):
            return True
    return False


def counted(kind: str, rate: float, frames: int, seed: int) -> dict[str, int]:
    """Captures and frames that one camera took, those of captures taken for good, and the wrong
    ones."""
    rig = default_rig(0.03)
    counts = {
        "captures": 0,
        "frames": 0,
        "wrong": 0,
        "good_captures": 0,
        "kept": 0,
        "kept_wrong": 0,
    }
    while counts["frames"] < frames:
        seed += 1
        with Bank(len(rig.leds), 0.0) as lights, Camera(rig, lights, kind, rate, seed) as camera:
            counts["captures"] += 1
            try:
                session = run_session(
                    Opened("twin", camera, lights, rig, {}), SessionSettings(find_finger=False)
                )
            except BadInput:
                counts["frames"] += 16
                continue
        wrong = taken = 0
        for name, band in session.bands.items():
            taken += 1 + len(band.pixels)
            assert band.ambient is not None
            wrong += is_wrong(camera, band.ambient.pixels, None, band.ambient.exposure, name)
            for image, (led,), exposure in zip(band.pixels, band.leds, band.exposure, strict=True):
                wrong += is_wrong(camera, image, led, float(exposure), name)
        counts["frames"] += taken
        counts["wrong"] += wrong
        if not session.verdict:
            counts["good_captures"] += 1
            counts["kept"] += taken
            counts["kept_wrong"] += wrong
    return counts


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--frames", type=int, default=10_000)
    parser.add_argument("--out", type=Path, default=HERE / "tables" / "synchrony.csv")
    chosen = parser.parse_args(arguments)
    rows = []
    for name, (kind, rate) in CAMERAS.items():
        rows.append({"camera": name, **counted(kind, rate, chosen.frames, 1000)})
        print(*rows[-1].values(), flush=True)
        table = csv_text([rows[0], *(row.values() for row in rows)])
        chosen.out.write_text(table, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
