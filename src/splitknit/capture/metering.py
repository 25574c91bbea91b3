"""Before the shots: where the finger is, whether every LED lights, and which exposure each band gets. Previews only."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from splitknit.capture.exposure import (
    BRIGHT,
    MEDIAN,
    Exposure,
    ExposureSettings,
    Survey,
    find_exposure,
    survey,
    typical_level,
)
from splitknit.devices import Camera, Frame, LightBank
from splitknit.errors import BadInput, require
from splitknit.finger import finger_mask
from splitknit.model import BoolArray, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Metering:
    """What the previews tell."""

    region: BoolArray
    """(h, w) the finger on the previews' grid; everything, where a target is photographed."""
    exposures: Mapping[str, Exposure]
    """By band."""


@dataclass(frozen=True, slots=True)
class MeteringLimits:
    """What the previews must show."""

    least_relative: float
    """An LED lights if the finger gets more than this share of what the median LED gives."""
    most_ambient: float
    """Light with all LEDs off over the median LED's, at most."""


def meter(
    camera: Camera,
    lights: LightBank,
    bands: Mapping[str, Sequence[int]],
    names: Sequence[str],
    *,
    settings: ExposureSettings,
    limits: MeteringLimits,
    px_per_mm: float,
    find_finger: bool = True,
    progress: Callable[[float], None] = lambda share: None,
) -> Metering:
    """Preview the finger under every LED and find the exposure of every band.

    Parameters
    ----------
    camera, lights : the devices
    bands : band to its LEDs, white first
    names : of all LEDs, for messages
    settings, limits : what is wanted
    px_per_mm : of full-size photographs
    find_finger : False where a target is photographed: the whole picture counts
    progress : told the share that is done

    Raises
    ------
    BadInput
        If there is no finger, an LED does not light, the lid is open, or no exposure fits.
    """

    def look(led: int, exposure_s: float, gain: float, band: str) -> Frame:
        camera.lock(exposure_s, gain, band)
        lights.on(led)
        return camera.preview()

    typical = MEDIAN if find_finger else BRIGHT
    region: BoolArray | None = None
    exposures: dict[str, Exposure] = {}
    for done, (band, leds) in enumerate(bands.items()):

        def look_here(led: int, exposure_s: float, gain: float, band: str = band) -> Frame:
            return look(led, exposure_s, gain, band)

        seen = survey(look_here, leds, camera.exposures, settings)
        lights.off()
        camera.lock(seen.exposure_s, seen.gain, band)
        room = camera.preview()
        _check_light(band, seen, room)
        if region is None:
            region = _region(seen, room, px_per_mm, camera.image_size[1], find_finger=find_finger)
        dark = typical_level(room, region, typical)
        _check_lit(
            {led: typical_level(frame, region, typical) - dark for led, frame in seen.frames.items()},
            dark,
            names,
            limits,
        )
        exposures[band] = find_exposure(
            look_here, seen, region, dark, camera=camera.exposures, settings=settings, typical=typical
        )
        lights.off()
        progress((done + 1) / len(bands))
    assert region is not None
    return Metering(region, exposures)


def _region(seen: Survey, room: Frame, px_per_mm: float, full_columns: int, *, find_finger: bool) -> BoolArray:
    frames = list(seen.frames.values())
    if not find_finger:
        return np.ones(frames[0].pixels.shape[:2], dtype=np.bool_)
    mean: FloatArray = np.mean([frame.pixels for frame in frames], axis=0, dtype=np.float32)
    mean -= room.pixels
    mean *= np.float32(1.0 / np.iinfo(frames[0].pixels.dtype).max)
    try:
        image = mean if mean.shape[2] == 3 else mean[..., 0]
        return finger_mask(image, px_per_mm * mean.shape[1] / full_columns)
    except BadInput as error:
        raise BadInput(f"no finger is seen under the white LEDs ({str(error).rstrip('.')}); lay one down.") from error


def _check_light(band: str, seen: Survey, room: Frame) -> None:
    """Refuse a band whose LEDs, all of them, add nothing to the room's light."""
    full = float(np.iinfo(room.pixels.dtype).max)
    brighter = max(
        float(np.percentile(frame.pixels.astype(np.float32) - room.pixels, 99.9)) for frame in seen.frames.values()
    )
    require(
        brighter > 0.02 * full,
        f"nothing is seen under any {band} LED that is not seen without it; check the LEDs' supply and the lens.",
    )


def _check_lit(levels: Mapping[int, float], dark: float, names: Sequence[str], limits: MeteringLimits) -> None:
    typical = float(np.median(list(levels.values())))
    unlit = [names[led] for led, level in levels.items() if level < max(limits.least_relative * typical, 0.002)]
    require(
        not unlit,
        f"{_listed(unlit)} did not light; check {'its' if len(unlit) == 1 else 'their'} wiring and capture again.",
    )
    require(
        dark <= limits.most_ambient * typical,
        f"there is light although all LEDs are off ({100 * dark / max(typical, 1e-9):.0f} % of an LED's): close the "
        "lid, or look for an LED that stays on.",
    )


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1] if names else "no LED"
