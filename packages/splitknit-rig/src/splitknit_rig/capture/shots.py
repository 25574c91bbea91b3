"""The shots of a capture: light, photograph, check while the finger still lies there, repeat if a
check fails."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import cv2
import numpy as np

from splitknit import Ambient, Band
from splitknit.capture import spectral_band
from splitknit.devices import Frame, Opened, relative_exposure
from splitknit.finger.motion import MIN_RELIABILITY, MOTION_PX_PER_MM, shot_motion
from splitknit.finger.regions import blur, dilate, reduce_image
from splitknit.model import Array, BoolArray, FloatArray
from splitknit.nominal import side_lights
from splitknit.settings import Checked, Limits
from splitknit_rig.capture.exposure import MEDIAN, Exposure, coarse_light, grey_light
from splitknit_rig.capture.pins import led_names


@dataclass(frozen=True, slots=True)
class CheckSettings(Checked):
    """Limits of the checks."""

    _group = "checks"

    moved_mm: Annotated[float, Limits(0, above=True)] = 0.13
    """Largest motion between two shots. The change of light between shots mimics up to 0.07 mm of
    motion. In coarse pictures motion is measured less accurately: at least 1.5 pixels are
    allowed."""
    retries: Annotated[int, Limits(0, 20)] = 2
    """How often a bad shot is repeated."""


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """Reduced copies of a shot, for the checks."""

    grey: FloatArray  # (h, w) light at the working scale, 1 = full scale
    # (h, w) its ridges: band-passed relative brightness, zero beside the finger
    details: FloatArray
    level: float  # median of the finger (or another percentile), 1 = full scale
    saturated: float  # fraction of the finger at full scale
    light: FloatArray  # see :func:`splitknit_rig.capture.exposure.coarse_light`


MAX_MISFIT = 0.09
"""Largest relative difference between the light of a shot and that predicted by its preview. A
frame exposed one `EXPOSURE_STEP` less differs by 0.13, a finger that moved by 0.5 mm by 0.04.
Chosen on: simulated fingers."""
_DRIFTED_MM = 0.12
"""Motion against all shots of the band, after the apparent motion caused by the light is
subtracted. Chosen on: simulated fingers (four at half scale; a light that changes place looks like
up to 0.07 mm)."""
SHINE_PERCENTILE = 99.5
"""Percentile of the finger's pixels that represents its specular reflections."""


class Examiner:
    """Checks shots, given the finger's region and its light without LEDs."""

    def __init__(
        self, region: BoolArray, px_per_mm: float, settings: CheckSettings, typical: float = MEDIAN
    ) -> None:
        """Prepare for the finger's `region` (h, w), on a grid of any size that covers the whole
        picture; `px_per_mm` of full-size shots; `typical`: percentile of the finger's pixels that
        represents its brightness.
        """
        self.settings, self._typical = settings, typical
        self.region = region
        self._px_per_mm = px_per_mm
        measurable = 1.5 / px_per_mm
        self.moved_mm, self.drifted_mm = (
            max(settings.moved_mm, measurable),
            max(_DRIFTED_MM, measurable),
        )
        """Limits of motion between two shots, and of drift against all shots of a band."""
        self._masks: dict[tuple[int, int], tuple[BoolArray, FloatArray]] = {}

    def look(self, frame: Frame) -> Look:
        """Reduce a shot to what the checks need."""
        step = max(1, int(self._px_per_mm / (2.5 * MOTION_PX_PER_MM)))
        full = frame.pixels[::step, ::step]  # a sparse grid first: a Raspberry Pi has little time
        scale = min(1.0, MOTION_PX_PER_MM * step / self._px_per_mm)
        grey = reduce_image(grey_light(full, frame.black_level), scale)
        inside, window = self._mask((grey.shape[0], grey.shape[1]))
        level = float(np.percentile(grey[inside], self._typical))
        px = self._px_per_mm * grey.shape[1] / frame.pixels.shape[1]
        local = np.maximum(blur(grey, 1.2 * px), np.float32(max(0.1 * level, 1e-6)))
        relative = np.asarray(grey / local, dtype=np.float32)
        details = np.asarray(
            (blur(relative, 0.08 * px) - blur(relative, 0.3 * px)) * window, dtype=np.float32
        )
        region = cv2.resize(
            self.region.astype(np.uint8), full.shape[1::-1], interpolation=cv2.INTER_NEAREST
        )
        clipped = full[region > 0] >= 0.995 * float(np.iinfo(full.dtype).max)
        # at full scale in two channels, or the one
        saturated = (
            float(np.mean(clipped.sum(axis=1) >= min(2, full.shape[2]))) if clipped.size else 0.0
        )
        return Look(grey, details, level, saturated, coarse_light(frame))

    def misfit(self, light: FloatArray, promised: FloatArray, *, any_gain: bool = False) -> float:
        """Relative difference between the light of the finger and that predicted by a preview, in
        the worst of four strips of rows, because part of a frame may belong to another frame;
        `any_gain`: up to one factor."""
        size = light.shape[1::-1]
        whole = cv2.resize(self.region.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        inside = whole > min(0.99, float(whole.max()) - 0.01)
        grey = promised.mean(axis=2)
        inside &= grey > 0.1 * float(grey[inside].max())  # what stays dark shows noise
        expected = np.where(inside[..., None], promised, 0.0)
        found = np.where(inside[..., None], light, 0.0)
        if any_gain:
            expected = expected * (found.sum() / max(float(expected.sum()), 1e-9))
        strips = np.array_split(np.flatnonzero(inside.any(axis=1)), 4)
        off = np.array([np.abs(found[rows] - expected[rows]).sum() for rows in strips])
        level = np.array([np.abs(expected[rows]).sum() for rows in strips])
        return float((off / np.maximum(level, max(0.5 * level.mean(), 1e-9))).max())

    def shine(self, look: Look, dark: Look) -> float:
        """Level of the finger's specular reflections in a shot, minus that without LEDs, 1 = full
        scale."""
        inside, _ = self._mask((look.grey.shape[0], look.grey.shape[1]))
        return float(np.percentile((look.grey - dark.grey)[inside], SHINE_PERCENTILE))

    def shift_mm(self, before: Look, after: Look, full_columns: int) -> float | None:
        """Motion of the finger between two shots, or None if they cannot be registered."""
        shift, response = cv2.phaseCorrelate(before.details, after.details)
        px = self._px_per_mm * before.details.shape[1] / full_columns
        return float(np.hypot(*np.divide(shift, px))) if response >= 0.2 else None

    def drift(self, looks: Sequence[Look], dark: Look, full_columns: int) -> Array:
        """(L,) distance in mm of the finger in each shot of a band from its mean position."""
        stack = np.stack([look.grey - dark.grey for look in looks])
        inside, _ = self._mask((stack.shape[1], stack.shape[2]))
        px = self._px_per_mm * stack.shape[2] / full_columns
        motion = shot_motion(stack, inside, px)
        length = np.hypot(motion.shift_mm[:, 0], motion.shift_mm[:, 1])
        reliable = motion.reliability >= MIN_RELIABILITY
        return np.asarray(np.where(reliable, length, 0.0), dtype=np.float64)

    def _mask(self, shape: tuple[int, int]) -> tuple[BoolArray, FloatArray]:
        """The finger's mask on a copy of `shape`, and a window that fades out beside it."""
        if shape not in self._masks:
            fraction = cv2.resize(
                self.region.astype(np.float32), shape[::-1], interpolation=cv2.INTER_AREA
            )
            inside = np.asarray(fraction > 0.5)
            px = MOTION_PX_PER_MM
            window = blur(dilate(inside, 0.7 * px).astype(np.float32), 0.5 * px)
            self._masks[shape] = (
                (inside if inside.any() else np.ones(shape, dtype=np.bool_)),
                window,
            )
        return self._masks[shape]


@dataclass(frozen=True, slots=True)
class Shot:
    """Facts about one photograph that was kept."""

    name: str  # like ``white 3`` or ``white ambient``
    led: int | None
    level: float  # median of the finger, fraction of full scale
    saturated: float  # fraction of the finger at full scale
    # against the shot before; None for the first, for ambient frames, and where the two show
    # different things
    moved_mm: float | None
    at_s: float  # when its exposure ended, by the camera's clock
    exposure_s: float
    gain: float
    discarded: int  # frames that the camera threw away before it
    retries: int
    misfit: float | None
    """Relative difference between the light and that predicted by the LED's preview; None for
    ambient frames."""


MAX_CROSSED = 0.93
"""Largest ratio of the light of crossed images to that of parallel ones, where the finger has
specular reflections. Simulated fingers behind films have 0.47 (wet) to 0.91 (matt), a path-traced
one 0.76; a missing film, or one that did not turn, has 1. Chosen on: simulated fingers (behind
films, wet to matt; a path-traced one). Range: 0.91 to 1."""


class Shooting:
    """Takes the shots of all bands, one band after the other."""

    def __init__(
        self,
        devices: Opened,
        examiner: Examiner,
        *,
        watch_motion: bool,
        progress: Callable[[str, float], None],
    ) -> None:
        """Prepare; nothing is lit yet."""
        self._camera, self._lights, self._examiner = devices.camera, devices.lights, examiner
        self._names = led_names(devices.rig)
        self._intensities = [led.intensity for led in devices.rig.leds]
        self._side = side_lights(devices.rig.leds)
        self._series = ""
        self._settings, self._watch_motion, self._progress = (
            examiner.settings,
            watch_motion,
            progress,
        )
        self.bands: dict[str, Band] = {}
        self.shots: list[Shot] = []
        self.verdict: list[str] = []
        self.taken = 0
        places = [np.array(led.position_mm or led.direction) for led in devices.rig.leds]
        self._towards = [place / np.linalg.norm(place) for place in places]
        self._before: list[tuple[int, str, Look]] = []
        self._steady = True
        self._looks: dict[str, tuple[Sequence[int], list[Look], Look]] = {}

    def band(self, band: str, leds: Sequence[int], exposure: Exposure, total: int) -> None:
        """Take a band's ambient frame and its lit ones; `total` is the number of frames of all
        bands."""
        self._camera.lock(exposure.exposure_s, exposure.gain, spectral_band(band))
        self._lights.off()
        self._series = " crossed" if band == "white_crossed" else ""
        ambient, dark = self._ambient(exposure)
        self._note(f"{spectral_band(band)}{self._series} ambient", None, ambient, dark)
        pixels: Any = np.empty((len(leds), *ambient.pixels.shape), dtype=ambient.pixels.dtype)
        exposures = []
        black_levels = []
        looks = []
        for k, led in enumerate(leds):
            self._progress(self._name(led), len(self.shots) / total)
            frame, look = self._lit(led, dark, exposure)
            pixels[k] = frame.pixels
            exposures.append(relative_exposure(frame))
            black_levels.append(frame.black_level)
            looks.append(look)
        self._lights.off()
        self._looks[band] = leds, looks, dark
        self.bands[band] = Band(
            name=band,
            pixels=pixels,
            leds=tuple((led,) for led in leds),
            exposure=np.array(exposures),
            black_level=np.array(black_levels),
            ambient=Ambient(ambient.pixels, relative_exposure(ambient), ambient.black_level),
            polarisation="crossed" if self._series else "",
        )
        if self._series:
            self.bands["white"] = replace(self.bands["white"], polarisation="parallel")

    def _name(self, led: int) -> str:
        return self._names[led] + self._series

    def _ambient(self, exposure: Exposure) -> tuple[Frame, Look]:
        """Photograph without LEDs; repeat if there is light that was not there before."""
        for _ in range(self._settings.retries + 1):
            frame, look = self._take()
            lit = min(float(light.mean()) for light in exposure.light.values())
            if exposure.room is None or float((look.light - exposure.room).mean()) < 0.1 * lit:
                return frame, look
        self.verdict.append(
            "the ambient frame shows light although all LEDs are off: the camera gave another"
            " frame, or an LED stayed on; capture again"
        )
        return frame, look

    def _lit(self, led: int, dark: Look, exposure: Exposure) -> tuple[Frame, Look]:
        """Photograph the finger under one LED; repeat if a check fails."""
        for attempt in range(self._settings.retries + 1):
            if attempt:
                self._lights.off()
            self._lights.on(led)
            frame, look = self._take()
            moved, misfit, troubles = self._examine(led, look, dark, exposure)
            if not troubles or attempt == self._settings.retries:
                break
            if troubles[0][0] == "moved" and not self._steady:
                break  # it has moved before: no time is spent on this capture any more
        for kind, words in troubles:
            self.verdict.append(words)
            self._steady = self._steady and kind != "moved"
        self._note(
            self._name(led), led, frame, look, moved_mm=moved, misfit=misfit, retries=attempt
        )
        if not any(kind == "unlit" for kind, _ in troubles):
            self._before.append((led, self._name(led), look))
        return frame, look

    def _take(self) -> tuple[Frame, Look]:
        frame = self._camera.capture()
        self.taken += 1
        return frame, self._examiner.look(frame)

    def _examine(
        self, led: int, look: Look, dark: Look, exposure: Exposure
    ) -> tuple[float | None, float, list[tuple[str, str]]]:
        """Motion in mm, misfit of the light, and failed checks: their kinds, and messages."""
        name = self._name(led)
        light = look.light - dark.light
        crossed = bool(self._series)  # by how much darker is not known
        misfits = {
            other: self._examiner.misfit(light, promised, any_gain=crossed)
            for other, promised in exposure.light.items()
        }
        misfit, closest = misfits[led], min(misfits, key=lambda other: misfits[other])
        if light.sum() < 0.4 * exposure.light[led].sum():
            words = f"{name} did not light: check its wiring and capture again"
            return None, misfit, [("unlit", words)]
        if misfits[closest] < 0.5 * misfit:
            words = (
                f"{name} shows the light of {self._name(closest)}: the camera gave another frame,"
                " or plugs are exchanged; capture again"
            )
            return None, misfit, [("unlit", words)]
        troubles = []
        moved = None
        if look.saturated > 0.05:
            words = (
                f"{name} is overexposed on {100 * look.saturated:.0f} % of the finger: capture"
                " again"
            )
            troubles.append(("saturated", words))
        # the latest shot under a light from about there, or the same side light: others' shadows
        # differ too much
        near = 0.98 if led in self._side else 0.7
        beside = [
            shot for shot in self._before if self._towards[shot[0]] @ self._towards[led] > near
        ]
        if self._watch_motion and beside:
            _, earlier, before = beside[-1]
            between = f"between {earlier} and {name}"
            moved = self._examiner.shift_mm(before, look, self._camera.image_size[1])
            if moved is None:
                words = (
                    f"the picture changed {between}: keep the finger in its place and capture again"
                )
                troubles.append(("moved", words))
            elif moved > self._examiner.moved_mm:
                words = (
                    f"the finger moved by {moved:.1f} mm {between}: hold still and capture again"
                )
                troubles.append(("moved", words))
        wrong = closest != led or (misfit > MAX_MISFIT and not crossed)
        if wrong and not troubles:
            words = (
                f"{name} is {100 * misfit:.0f} % off the light that its preview showed: the finger"
                " moved since, the light changed, or the camera did not expose as it states;"
                " capture again"
            )
            troubles.append(("light", words))
        return moved, misfit, troubles

    def check_drift(self) -> None:
        """Check for slow motion after the last shot; not under side lights, whose shadows look like
        motion."""
        if not self._watch_motion or not self._steady:
            return
        for band, (leds, looks, dark) in self._looks.items():
            ring = [
                (led, look) for led, look in zip(leds, looks, strict=True) if led not in self._side
            ]
            away = self._examiner.drift(
                [look for _, look in ring], dark, self._camera.image_size[1]
            )
            worst = int(np.argmax(away))
            if away[worst] > self._examiner.drifted_mm:
                series = ", crossed" if band == "white_crossed" else ""
                where = (
                    f"under the {spectral_band(band)} LEDs{series} (most at"
                    f" {self._names[ring[worst][0]]})"
                )
                self.verdict.append(
                    f"the finger drifted by {away[worst]:.1f} mm {where}: hold still and capture"
                    " again"
                )

    def check_films(self) -> float:
        """Ratio of crossed to parallel light where the finger shines; too high a ratio adds a
        verdict."""

        def light(band: str) -> float:
            leds, looks, dark = self._looks[band]
            shines = [self._examiner.shine(look, dark) for look in looks]
            return sum(
                shine / self._intensities[led] for shine, led in zip(shines, leds, strict=True)
            )

        ratio = light("white_crossed") / max(light("white"), 1e-9)
        if ratio > MAX_CROSSED:
            self.verdict.append(
                f"where the finger shines, the crossed images have {100 * ratio:.0f} % of the"
                f" parallel ones' light, not {100 * MAX_CROSSED:.0f} % or less: the analyser did"
                " not turn, or a film is missing or swapped; check them and capture again"
            )
        return ratio

    def _note(
        self,
        name: str,
        led: int | None,
        frame: Frame,
        look: Look,
        *,
        moved_mm: float | None = None,
        misfit: float | None = None,
        retries: int = 0,
    ) -> None:
        self.shots.append(
            Shot(
                name,
                led,
                look.level,
                look.saturated,
                moved_mm,
                frame.at_s,
                frame.exposure_s,
                frame.gain,
                frame.discarded,
                retries,
                misfit,
            )
        )
