"""Auto-exposure, set with the brightest LED of a band and then locked; and focus, a number that is
largest when sharp."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.checks import check_image, check_mask
from splitknit.devices import ExposureRange, Frame, relative_exposure
from splitknit.errors import require
from splitknit.imaging.robust import deviation
from splitknit.model import BoolArray, FloatArray
from splitknit.settings import Checked, Limits

Look = Callable[[int, float, float], Frame]
"""Preview under an LED, with an exposure time and a gain."""
MEDIAN = 50.0
"""Percentile. Source: definition of the median."""


@dataclass(frozen=True, slots=True)
class ExposureSettings(Checked):
    """Target brightness of the brightest image."""

    target: Annotated[float, Limits(0.05, 0.95)] = 0.7
    """Fraction of full scale that the finger's 99.9th percentile reaches, brightest channel and
    LED."""
    longest_s: Annotated[float, Limits(0, above=True)] = 0.066
    """Beyond this the gain is raised instead: a capture should take no more than seven seconds."""


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """Previews under every LED of a band, all with one exposure, none overexposed."""

    frames: Mapping[int, Frame]
    exposure_s: float
    gain: float


@dataclass(frozen=True, slots=True)
class Exposure:
    """Exposure chosen for a band."""

    exposure_s: float
    gain: float
    brightest: int  # LED under which the finger is brightest
    level: float  # fraction of full scale that the finger reaches under it
    # LED to the light (h, w, C) that its preview shows, see :func:`coarse_light`
    light: Mapping[int, FloatArray] = field(default_factory=dict)
    room: FloatArray | None = None
    """(h, w, C) coarse light with all LEDs off."""

    def promising(self, seen: Survey, room: Frame) -> Exposure:
        """The exposure with the light that the previews predict for the shots, and `room`, the
        preview without LEDs."""
        dark = coarse_light(room)
        light = {led: coarse_light(frame) - dark for led, frame in seen.frames.items()}
        return replace(self, light=light, room=dark)


def coarse_light(frame: Frame) -> FloatArray:
    """(h, w, C) mean light of a frame or its preview in 48 cells across, divided by the exposure.
    It reveals the LED, exposure and white balance of the frame."""
    rows, columns, channels = frame.pixels.shape
    size = (48, max(1, round(48 * rows / columns)))
    stored = frame.pixels.astype(np.float32)
    cells = cv2.resize(stored, size, interpolation=cv2.INTER_AREA).reshape(size[1], 48, channels)
    full = float(np.iinfo(frame.pixels.dtype).max)
    return np.asarray((cells - frame.black_level) / (full * relative_exposure(frame)), np.float32)


EXPOSURE_STEP = 1.15
"""Ratio of neighbouring exposures on a ladder: a frame taken with another exposure than the camera
states is detected by its light."""


def exposure_of(
    product_s: float, camera: ExposureRange, settings: ExposureSettings
) -> tuple[float, float]:
    """Exposure time and gain whose product is `product_s`, or as near as the camera allows: time is
    raised first, then gain; the product lies on the ladder of `EXPOSURE_STEP`."""
    rung = round(np.log(product_s / START_S) / np.log(EXPOSURE_STEP))
    product_s = START_S * EXPOSURE_STEP**rung
    longest = min(max(settings.longest_s, camera.shortest_s), camera.longest_s)
    time_s = float(np.clip(product_s / camera.lowest_gain, camera.shortest_s, longest))
    return time_s, float(np.clip(product_s / time_s, camera.lowest_gain, camera.highest_gain))


FINGER_PERCENTILE = 99.9
"""Percentile of the finger's pixels, in the brightest channel."""


def _level_of(frame: Frame, region: BoolArray | None = None) -> float:
    """Brightness of the finger in the brightest channel, as a fraction of full scale above the
    black level."""
    pixels = (
        frame.pixels.reshape(-1, frame.pixels.shape[2]) if region is None else frame.pixels[region]
    )
    stored = float(np.max(np.percentile(pixels, FINGER_PERCENTILE, axis=0)))
    full = float(np.iinfo(pixels.dtype).max)
    return max((stored - frame.black_level) / (full - frame.black_level), 0.0)


START_S = 0.01
"""Exposure of the first preview, at gain 1. Chosen on: speed."""
_CLIPPED_PREVIEW = 0.97
"""Fraction of full scale: a brighter preview only shows that less exposure is needed."""


def survey(
    look: Look, leds: Sequence[int], camera: ExposureRange, settings: ExposureSettings
) -> Survey:
    """Preview a band under each LED with one exposure, at which no preview clips and the brightest
    is not dark. Raises BadInput if it is too bright or too dark at every exposure.
    """
    product = START_S
    while True:
        time_s, gain = exposure_of(product, camera, settings)
        frames, levels = {}, []
        for led in leds:
            frames[led] = look(led, time_s, gain)
            levels.append(_level_of(frames[led]))
            if levels[-1] >= _CLIPPED_PREVIEW:
                break
        if levels[-1] >= _CLIPPED_PREVIEW:
            product /= 4
            require(
                exposure_of(product, camera, settings) != (time_s, gain),
                "the picture is overexposed even with the shortest exposure: another light is on;"
                " close the lid, or lower the LEDs' current.",
            )
            continue
        at_limit = exposure_of(2 * product, camera, settings) == (time_s, gain)
        require(
            not at_limit or max(levels) >= 0.01,
            "nothing is seen under any LED, even with the longest exposure; check the LEDs' supply"
            " and the lens.",
        )
        if max(levels) >= 0.08 or at_limit:
            return Survey(frames, time_s, gain)
        product *= 4 if max(levels) < 0.02 else 2


def find_exposure(
    look: Look, seen: Survey, region: BoolArray, camera: ExposureRange, settings: ExposureSettings
) -> Exposure:
    """The exposure of a band, before :meth:`Exposure.promising`, from previews `look` of the finger
    in `region` (h, w). Raises BadInput if it stays too dark or too bright.
    """
    levels = {led: _level_of(frame, region) for led, frame in seen.frames.items()}
    brightest = max(levels, key=lambda led: levels[led])
    time_s, gain, level = seen.exposure_s, seen.gain, levels[brightest]
    wanted = time_s, gain
    for _ in range(12):
        if abs(level / settings.target - 1.0) <= 0.075:  # half a step
            break
        factor = (
            0.3
            if level >= _CLIPPED_PREVIEW
            else float(np.clip(settings.target / max(level, 1e-3), 0.1, 8.0))
        )
        before, wanted = wanted, exposure_of(time_s * gain * factor, camera, settings)
        if np.allclose(wanted, before, rtol=1e-6):
            break  # the camera's limit, or the nearest step
        frame = look(brightest, *wanted)
        time_s, gain = frame.exposure_s, frame.gain  # what the sensor made of it
        level = _level_of(frame, region)
    if np.isclose(time_s * gain, seen.exposure_s * seen.gain, rtol=0.05):
        # what a camera may keep of an earlier setting must not look alike in preview and shot
        frame = look(brightest, *exposure_of(time_s * gain / EXPOSURE_STEP, camera, settings))
        time_s, gain, level = frame.exposure_s, frame.gain, _level_of(frame, region)
    require(
        level >= 0.3 * settings.target,
        f"the finger is too dark: with {1e3 * time_s:.0f} ms at gain {gain:.1f} its brightest LED"
        f" brings it to {100 * level:.0f} % of full scale; check the LEDs' supply.",
    )
    tried = f"{1e3 * time_s:.2f} ms at gain {gain:.1f}"
    words = (
        f"the finger is overexposed even with {tried}; close the lid, or lower the LEDs' current."
    )
    require(level < _CLIPPED_PREVIEW, words)
    return Exposure(time_s, gain, brightest, level)


@dataclass(frozen=True, slots=True)
class Focus:
    """One measurement of the focus."""

    # standard deviation of the detail, relative to brightness, in per cent; the noise's part is
    # taken off
    sharpness: float
    snr: float  # variance of the detail over that of the noise


def measure_focus(image: FloatArray, region: BoolArray, px_per_mm: float) -> Focus:
    """Focus of one picture (H, W) of linear light in the finger's `region` (H, W), without its
    outline: the variance of the Laplacian of Gaussian of the relative brightness, minus that of the
    noise, measured at the finest scale, where blurred skin has almost no contrast. Source:
    Pech-Pacheco, J. L. et al., "Diatom autofocusing in brightfield microscopy", ICPR 2000.
    Immerkaer, J., "Fast noise variance estimation", Computer Vision and Image Understanding 64,
    1996 (the mask of the noise).
    """
    light = check_image(image)
    inside = check_mask(region, (light.shape[0], light.shape[1]))
    sigma = max(0.02 * px_per_mm, 0.7)  # 1.5 px of the full frame; finer shows focus, and noise
    local = cv2.GaussianBlur(light, (0, 0), 6.0 * sigma)
    floor = np.float32(max(0.05 * float(np.mean(light[inside], dtype=np.float64)), 1e-9))
    relative = np.asarray(light / np.maximum(local, floor), dtype=np.float32)
    inside = inside & (local > 2 * floor)  # the finger's unlit flank is noise alone
    if not inside.any():
        return Focus(0.0, 0.0)

    def fine(picture: FloatArray) -> FloatArray:
        """Laplacian of Gaussian."""
        smooth = cv2.GaussianBlur(picture, (0, 0), sigma)
        return cv2.Laplacian(smooth, cv2.CV_32F) * np.float32(sigma**2)

    detail = fine(relative)[inside]
    finest = cv2.filter2D(relative, cv2.CV_32F, _NOISE_MASK)
    # robust, because specular reflections and hairs are sharp at every scale
    noise = deviation(finest[inside]) ** 2 / float((_NOISE_MASK**2).sum())
    # Variance that white noise of variance one has after the filter
    size = int(np.ceil(6 * sigma)) * 2 + 9
    impulse = np.zeros((size, size), dtype=np.float32)
    impulse[size // 2, size // 2] = 1.0
    of_noise = noise * float((fine(impulse).astype(np.float64) ** 2).sum())
    signal = max(deviation(detail - np.median(detail)) ** 2 - of_noise, 0.0)
    return Focus(sharpness=float(100.0 * np.sqrt(signal)), snr=float(signal / max(of_noise, 1e-12)))


_NOISE_MASK = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], dtype=np.float32)
"""Difference of two Laplacians: blind to planes, quadratics along the axes and edges along them.

Source: Immerkaer 1996, see :func:`measure_focus`.
"""


def grey_light(pixels: NDArray[np.unsignedinteger], black_level: float = 0.0) -> FloatArray:
    """(H, W) mean of the channels of stored (H, W, C) integers, 1 = full scale."""
    mean: FloatArray = pixels.mean(axis=2, dtype=np.float32)
    return (mean - np.float32(black_level)) / np.float32(np.iinfo(pixels.dtype).max)
