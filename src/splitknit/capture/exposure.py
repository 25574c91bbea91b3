"""Auto-exposure: found once on the brightest LED of a band by previews, then locked for the whole band."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit.devices import ExposureRange, Frame
from splitknit.errors import BadInput, require
from splitknit.model import BoolArray

Look = Callable[[int, float, float], Frame]
"""Preview under an LED, with an exposure time and a gain."""

MEDIAN = 50.0
BRIGHT = 99.5
"""Percentile that stands for a target's light: most of its picture may be black."""


@dataclass(frozen=True, slots=True)
class ExposureSettings:
    """How bright the brightest image shall be."""

    target: float = 0.7
    """Share of full scale that the finger reaches under its brightest LED..."""
    percentile: float = 99.9
    """... in this percentile of its pixels, of the brightest channel."""
    start_s: float = 0.01
    """Exposure time of the first preview, at gain 1; above 0."""
    longest_s: float = 0.066
    """Longer times would spoil the seven seconds (see ``docs/capture.md``); above this the gain is raised."""
    clipped: float = 0.97
    """From this share of full scale on a preview says nothing but "less"."""
    tolerance: float = 0.06
    """The search ends when the level is as near to the target as this, relative."""
    steps: int = 12
    """Previews of the brightest LED at most."""
    least: float = 0.3
    """The finger is too dark if it does not even reach this share of the target with all that the camera can."""

    def __post_init__(self) -> None:
        require(0.05 <= self.target <= 0.95, f"exposure.target must be 0.05 to 0.95, but it is {self.target:g}.")
        require(50 <= self.percentile <= 100, "exposure.percentile must be 50 to 100.")
        require(min(self.start_s, self.longest_s) > 0, "exposure.start_s and exposure.longest_s must be positive.")
        require(self.target < self.clipped <= 1, "exposure.clipped must lie between exposure.target and 1.")
        require(0.005 <= self.tolerance <= 0.5, "exposure.tolerance must be 0.005 to 0.5.")
        require(self.steps >= 2, "exposure.steps must be at least 2.")
        require(0 <= self.least <= 1, "exposure.least must be 0 to 1.")


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """Previews under every LED of a band, all with one exposure, none overexposed."""

    frames: Mapping[int, Frame]
    exposure_s: float
    gain: float


@dataclass(frozen=True, slots=True)
class Exposure:
    """What was found for a band."""

    exposure_s: float
    gain: float
    brightest: int
    """LED under which the finger is brightest."""
    level: float
    """Share of full scale that the finger reaches under it."""
    expected: Mapping[int, float]
    """LED to the finger's median level (share of full scale) that the previews promise."""


def split(product_s: float, camera: ExposureRange, settings: ExposureSettings) -> tuple[float, float]:
    """Exposure time and gain whose product is `product_s`, or as near as the camera can: time first, then gain."""
    longest = min(max(settings.longest_s, camera.shortest_s), camera.longest_s)
    time_s = float(np.clip(product_s / camera.lowest_gain, camera.shortest_s, longest))
    return time_s, float(np.clip(product_s / time_s, camera.lowest_gain, camera.highest_gain))


def level_of(frame: Frame, region: BoolArray | None, percentile: float) -> float:
    """Percentile of the finger's pixels in the brightest channel, as a share of full scale above the black level."""
    full = float(np.iinfo(frame.pixels.dtype).max)
    pixels = frame.pixels.reshape(-1, frame.pixels.shape[2]) if region is None else frame.pixels[region]
    stored = float(np.max(np.percentile(pixels, percentile, axis=0)))
    return max(stored - frame.black_level, 0.0) / (full - frame.black_level)


def survey(look: Look, leds: Sequence[int], camera: ExposureRange, settings: ExposureSettings) -> Survey:
    """Look at a band under each of its LEDs, with one exposure at which none clips and the brightest is not dark.

    Raises
    ------
    BadInput
        If it is too bright or too dark at every exposure.
    """
    product = settings.start_s
    while True:
        time_s, gain = split(product, camera, settings)
        frames = {}
        for led in leds:
            frames[led] = look(led, time_s, gain)
            if level_of(frames[led], None, settings.percentile) >= settings.clipped:
                break
        levels = [level_of(frame, None, settings.percentile) for frame in frames.values()]
        if max(levels) >= settings.clipped:
            shorter = product / 4
            require(
                split(shorter, camera, settings) != (time_s, gain),
                "the picture is overexposed even with the shortest exposure: another light is on; close the lid, or "
                "lower the LEDs' current.",
            )
            product = shorter
            continue
        at_limit = split(2 * product, camera, settings) == (time_s, gain)
        require(
            not at_limit or max(levels) >= 0.01,
            "nothing is seen under any LED, even with the longest exposure; check the LEDs' supply and the lens.",
        )
        if max(levels) >= 0.08 or at_limit:
            return Survey(frames, time_s, gain)
        product *= 4 if max(levels) < 0.02 else 2


def find_exposure(
    look: Look,
    seen: Survey,
    region: BoolArray,
    dark: float,
    *,
    camera: ExposureRange,
    settings: ExposureSettings,
    typical: float = MEDIAN,
) -> Exposure:
    """Find the exposure of a band.

    Parameters
    ----------
    look : takes a preview
    seen : of this band
    region : (h, w) the finger in previews
    dark : median level of the finger with all LEDs off, at the survey's exposure
    camera : what can be set
    settings : what is wanted
    typical : percentile of the pixels whose level is promised to the shots

    Returns
    -------
    Exposure

    Raises
    ------
    BadInput
        If the finger stays too dark or too bright.
    """
    levels = {led: level_of(frame, region, settings.percentile) for led, frame in seen.frames.items()}
    brightest = max(levels, key=lambda led: levels[led])
    time_s, gain, level = seen.exposure_s, seen.gain, levels[brightest]
    for _ in range(settings.steps):
        if abs(level / settings.target - 1.0) <= settings.tolerance:
            break
        factor = 0.3 if level >= settings.clipped else float(np.clip(settings.target / max(level, 1e-3), 0.1, 8.0))
        wanted = split(time_s * gain * factor, camera, settings)
        if np.allclose(wanted, (time_s, gain), rtol=1e-6):
            break  # the camera's limit
        time_s, gain = wanted
        frame = look(brightest, time_s, gain)
        time_s, gain = frame.exposure_s, frame.gain  # what the sensor made of it
        level = level_of(frame, region, settings.percentile)
    if level < settings.least * settings.target:
        raise BadInput(
            f"the finger is too dark: with {1e3 * time_s:.0f} ms at gain {gain:.1f} its brightest LED brings it to "
            f"{100 * level:.0f} % of full scale; check the LEDs' supply."
        )
    if level >= settings.clipped:
        raise BadInput(
            f"the finger is overexposed even with {1e3 * time_s:.2f} ms at gain {gain:.1f}; close the lid, or lower "
            "the LEDs' current."
        )
    ratio = time_s * gain / (seen.exposure_s * seen.gain)
    expected = {
        led: ratio * max(typical_level(frame, region, typical) - dark, 0.0) for led, frame in seen.frames.items()
    }
    return Exposure(time_s, gain, brightest, level, expected)


def typical_level(frame: Frame, region: BoolArray, percentile: float = MEDIAN) -> float:
    """Mean over the channels of the finger's median (or percentile), as a share of full scale above the black level."""
    full = float(np.iinfo(frame.pixels.dtype).max)
    stored = float(np.mean(np.percentile(frame.pixels[region], percentile, axis=0)))
    return (stored - frame.black_level) / (full - frame.black_level)


def clipped_share(pixels: NDArray[np.unsignedinteger], region: BoolArray) -> float:
    """Share of the region's pixels in which two channels (or the one) are at full scale."""
    full = float(np.iinfo(pixels.dtype).max)
    inside = pixels[region] >= 0.995 * full
    return float(np.mean(inside.sum(axis=1) >= min(2, pixels.shape[2]))) if inside.size else 0.0
