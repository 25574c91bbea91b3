"""The shots of a capture: light, photograph, check, again if it went wrong."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from splitknit.capture.checks import Examiner, Look
from splitknit.capture.exposure import Exposure
from splitknit.devices import Camera, Frame, LightBank, relative_exposure
from splitknit.model import Band, PixelArray


@dataclass(frozen=True, slots=True)
class Shot:
    """Facts about one photograph that was kept."""

    name: str
    """Like ``white 3`` or ``white ambient``."""
    led: int | None
    level: float
    """Median of the finger, share of full scale."""
    saturated: float
    """Share of the finger at full scale."""
    moved_mm: float | None
    """Against the shot before; None for the first, for ambient frames, and where the two show different things."""
    at_s: float
    """When its exposure ended, by the camera's clock."""
    exposure_s: float
    gain: float
    discarded: int
    """Frames that the camera threw away before it."""
    retries: int


@dataclass(frozen=True, slots=True)
class _Trouble:
    """What is wrong with a shot."""

    kind: str
    words: str


class Shooting:
    """Takes the shots of all bands, one band after the other."""

    def __init__(
        self,
        camera: Camera,
        lights: LightBank,
        names: Sequence[str],
        examiner: Examiner,
        *,
        watch_motion: bool,
        progress: Callable[[str, float], None],
    ) -> None:
        """Prepare; nothing is lit yet."""
        self._camera, self._lights, self._names, self._examiner = camera, lights, names, examiner
        self._settings, self._watch_motion, self._progress = examiner.settings, watch_motion, progress
        self.bands: dict[str, Band] = {}
        self.shots: list[Shot] = []
        self.verdict: list[str] = []
        self.taken = 0
        self._before: tuple[str, Look] | None = None
        self._steady = True
        self._looks: list[tuple[str, Sequence[int], list[Look], Look]] = []

    def band(self, band: str, leds: Sequence[int], exposure: Exposure, total: int) -> None:
        """Take a band's ambient frame and its lit ones; `total` is the number of frames of all bands."""
        self._camera.lock(exposure.exposure_s, exposure.gain, band)
        self._lights.off()
        room, dark = self._take()
        self._note(f"{band} ambient", None, room, dark, moved=None, retries=0)
        pixels: Any = np.empty((len(leds), *room.pixels.shape), dtype=room.pixels.dtype)
        frames, looks = [], []
        for k, led in enumerate(leds):
            self._progress(self._names[led], len(self.shots) / total)
            frame, look = self._lit(led, dark, exposure.expected[led])
            pixels[k] = frame.pixels
            frames.append(Frame(frame.pixels[:0], frame.exposure_s, frame.gain, frame.black_level))
            looks.append(look)
        self._lights.off()
        self._looks.append((band, leds, looks, dark))
        self.bands[band] = _as_band(band, pixels, leds, frames, room)

    def _lit(self, led: int, dark: Look, expected: float) -> tuple[Frame, Look]:
        """Photograph the finger under one LED, again where it went wrong."""
        for attempt in range(self._settings.retries + 1):
            if attempt:
                self._lights.off()
            self._lights.on(led)
            frame, look = self._take()
            moved, troubles = self._examine(led, look, dark, expected)
            if not troubles or attempt == self._settings.retries:
                break
            if troubles[0].kind == "moved" and not self._steady:
                break  # it has moved before: no time is spent on this capture any more
        for trouble in troubles:
            self.verdict.append(trouble.words)
            self._steady = self._steady and trouble.kind != "moved"
        self._note(self._names[led], led, frame, look, moved=moved, retries=attempt)
        if not any(trouble.kind == "unlit" for trouble in troubles):
            self._before = (self._names[led], look)
        return frame, look

    def _take(self) -> tuple[Frame, Look]:
        frame = self._camera.capture()
        self.taken += 1
        return frame, self._examiner.look(frame)

    def _examine(self, led: int, look: Look, dark: Look, expected: float) -> tuple[float | None, list[_Trouble]]:
        """Motion in mm, and what is wrong."""
        name, limits = self._names[led], self._settings
        if look.level - dark.level < limits.least_light * expected:
            words = f"{name} did not light: check its wiring and capture again"
            return None, [_Trouble("unlit", words)]
        troubles = []
        if look.saturated > limits.saturated_share:
            words = f"{name} is overexposed on {100 * look.saturated:.0f} % of the finger: capture again"
            troubles.append(_Trouble("saturated", words))
        moved = None
        if self._watch_motion and self._before is not None:
            earlier, before = self._before
            shift = self._examiner.shift_mm(before, look, self._camera.image_size[1])
            if shift is None:
                words = (
                    f"the picture changed between {earlier} and {name}: keep the finger in its place and capture again"
                )
                troubles.append(_Trouble("moved", words))
            else:
                moved = float(np.hypot(*shift))
                if moved > self._examiner.moved_mm:
                    words = (
                        f"the finger moved by {moved:.1f} mm between {earlier} and {name}: hold still and capture again"
                    )
                    troubles.append(_Trouble("moved", words))
        return moved, troubles

    def check_drift(self) -> None:
        """Look for slow motion, which no two neighbours show; after the last shot, because it takes time."""
        if not self._watch_motion or not self._steady:
            return
        for band, leds, looks, dark in self._looks:
            away = self._examiner.drift(looks, dark, self._camera.image_size[1])
            worst = int(np.argmax(away))
            if away[worst] > self._examiner.drifted_mm:
                where = f"under the {band} LEDs (most at {self._names[leds[worst]]})"
                self.verdict.append(f"the finger drifted by {away[worst]:.1f} mm {where}: hold still and capture again")

    def _note(self, name: str, led: int | None, frame: Frame, look: Look, *, moved: float | None, retries: int) -> None:
        self.shots.append(
            Shot(
                name=name,
                led=led,
                level=look.level,
                saturated=look.saturated,
                moved_mm=moved,
                at_s=frame.at_s,
                exposure_s=frame.exposure_s,
                gain=frame.gain,
                discarded=frame.discarded,
                retries=retries,
            )
        )


def _as_band(name: str, pixels: PixelArray, leds: Sequence[int], frames: Sequence[Frame], room: Frame) -> Band:
    return Band(
        name=name,
        pixels=pixels,
        leds=tuple((led,) for led in leds),
        exposure=np.array([relative_exposure(frame) for frame in frames]),
        black_level=np.array([frame.black_level for frame in frames]),
        ambient=room.pixels,
        ambient_exposure=relative_exposure(room),
        ambient_black_level=room.black_level,
    )
