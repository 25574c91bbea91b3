"""One capture: focus, exposure, an ambient frame and the lit frames of every band, each checked at
once, so that it can be repeated.

A rig with polarising films has a parallel and a crossed series of white frames, with one exposure.
It is set with the parallel series, where specular reflections saturate first.

Pictures are kept in memory and written after the last shot: while the finger lies there, only
light, camera and checks take time. All LEDs are off when a session ends, for whatever reason.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import cv2
import numpy as np

from splitknit import BadInput, Band, Capture, Rig
from splitknit.capture import spectral_band
from splitknit.devices import Frame, Opened, Turn
from splitknit.errors import require
from splitknit.finger.mask import finger_mask
from splitknit.imaging.geometry import bounding_box
from splitknit.model import BoolArray, FloatArray, Progress, no_progress
from splitknit_rig.calibration.lights import listed
from splitknit_rig.capture.exposure import (
    MEDIAN,
    Exposure,
    ExposureSettings,
    Focus,
    Survey,
    coarse_light,
    find_exposure,
    grey_light,
    measure_focus,
    survey,
)
from splitknit_rig.capture.pins import led_names, rig_films
from splitknit_rig.capture.shots import (
    CheckSettings,
    Examiner,
    Shooting,
    Shot,
)

BANDS = ("white", "nir")


@dataclass(frozen=True, slots=True)
class SessionSettings:
    """Settings of a capture."""

    exposure: ExposureSettings = field(default_factory=ExposureSettings)
    checks: CheckSettings = field(default_factory=CheckSettings)
    find_finger: bool = True
    """False for calibration targets: the whole picture is used, and motion and focus are not
    checked."""
    images: Literal["png", "tiff"] = "png"
    """File format of the images, see :func:`splitknit.write_capture`; the verb uses ``tiff``."""


@dataclass(frozen=True, slots=True, eq=False)
class Session:
    """Result of a session."""

    bands: Mapping[str, Band]
    shots: tuple[Shot, ...]  # in their order, ambient frames included
    exposures: Mapping[str, Exposure]
    focus: Focus
    verdict: tuple[str, ...]  # why the finger must be captured again; empty if it need not
    frames_taken: int  # full-size frames of the shots, retries included
    # light of the crossed images over that of the parallel ones where the finger shines; None
    # without films
    crossed_over_parallel: float | None = None

    @property
    def seconds(self) -> float:
        """Time from the first ambient frame to the end of the last lit one, by the camera's
        clock."""
        return self.shots[-1].at_s - self.shots[0].at_s

    def capture(self, rig: Rig, *, material: str = "skin") -> Capture:
        """Return the capture that :func:`splitknit.write_capture` writes."""
        return Capture(rig=rig, bands=self.bands, encoding="linear", material=material)


def _check_fit(devices: Opened) -> dict[str, tuple[int, ...]]:
    """LEDs by band, white first, then ``white_crossed`` of a rig with films; refuse a rig file that
    does not match the devices."""
    rig, connected = devices.rig, devices.lights.count
    rows, columns = devices.camera.image_size
    require(
        rig.camera.image_size == (rows, columns),
        f"the rig file is for another camera: its images have {rig.camera.image_size[0]} x"
        f" {rig.camera.image_size[1]} pixels (rows x columns), this camera's have {rows} x"
        f" {columns}.",
    )
    require(
        connected == len(rig.leds),
        f"the rig file has {len(rig.leds)} LEDs, but {connected} are connected; correct one of"
        " them.",
    )
    bands = {band: tuple(k for k, led in enumerate(rig.leds) if led.band == band) for band in BANDS}
    for k, led in enumerate(rig.leds):
        require(
            led.band in BANDS,
            f"LED {k} of the rig is of the band '{led.band}'; bands are white and nir.",
        )
    for band, leds in bands.items():
        require(
            len(leds) >= 3 or (band == "nir" and not leds),
            f"the rig file has {len(leds)} {band} LEDs, but photometric stereo needs three at"
            " least; add the missing ones.",
        )
    films = rig_films(rig)
    if films is not None:
        parallel = [
            k for k in bands["white"] if k not in films.crossed or films.kind != "neighbours"
        ]
        bands = {"white": tuple(parallel), "white_crossed": films.crossed, "nir": bands["nir"]}
        require(
            len(parallel) >= 3,
            f"the rig file has {len(parallel)} white LEDs a series, but needs three at least.",
        )
    return {band: leds for band, leds in bands.items() if leds}


_BRIGHT_PERCENTILE = 99.5
"""Percentile for a calibration target, most of whose picture may be black."""


def run_session(
    devices: Opened,
    settings: SessionSettings | None = None,
    *,
    turn: Turn | None = None,
    progress: Progress = no_progress,
) -> Session:
    """Photograph one finger under all LEDs; read the result's verdict first. `turn` turns the
    analyser. Raises BadInput if nothing can be captured: wrong rig, no finger, a dead LED, no
    suitable exposure, or nothing that turns the analyser.
    """
    settings = settings or SessionSettings()
    bands = _check_fit(devices)
    lights, px_per_mm = devices.lights, devices.rig.camera.px_per_mm
    turn = turn if bands.get("white_crossed") == bands["white"] else None
    require(
        turn is not None or bands.get("white_crossed") != bands["white"],
        "the rig file has an analyser that turns between the two series, but nothing turns it here:"
        " run this on the Raspberry Pi, and on a terminal if it is turned by hand.",
    )
    try:
        lights.off()
        if turn is not None:
            turn("parallel")
        progress("finding the exposure", 0.0)
        region, exposures = _meter(
            devices, bands, settings, lambda part: progress("finding the exposure", 0.3 * part)
        )
        progress("focus", 0.3)
        focus = _focus(devices, region, exposures["white"])
        shooting = Shooting(
            devices,
            Examiner(
                region,
                px_per_mm,
                settings.checks,
                MEDIAN if settings.find_finger else _BRIGHT_PERCENTILE,
            ),
            watch_motion=settings.find_finger,
            progress=lambda name, fraction: progress(name, 0.4 + 0.6 * fraction),
        )
        for band, leds in bands.items():
            if band == "white_crossed" and turn is not None:
                turn("crossed")
            shooting.band(
                band, leds, exposures[band], total=sum(map(len, bands.values())) + len(bands)
            )
    finally:
        lights.off()
    shooting.check_drift()
    crossed_over_parallel = (
        shooting.check_films() if settings.find_finger and "white_crossed" in bands else None
    )
    verdict = list(shooting.verdict)
    # coarser pictures are not refused: ridges are so small in them that they pass for noise
    judged = settings.find_finger and px_per_mm >= 18.0
    # no detail above the noise: the picture is refused as out of focus
    if judged and focus.snr < 0.1:
        verdict.append(
            "the finger is out of focus (nothing on it is sharper than the noise): focus and"
            " capture again"
        )
    return Session(
        bands=shooting.bands,
        shots=tuple(shooting.shots),
        exposures=exposures,
        focus=focus,
        verdict=tuple(verdict),
        frames_taken=shooting.taken,
        crossed_over_parallel=crossed_over_parallel,
    )


FOCUS_FIELD_MM = 10.0  # side of the field in the finger's middle


def _focus(devices: Opened, region: BoolArray, exposure: Exposure) -> Focus:
    """Measure the focus under the brightest white LED."""
    camera, lights, px_per_mm = devices.camera, devices.lights, devices.rig.camera.px_per_mm
    camera.lock(exposure.exposure_s, exposure.gain, "white")
    rows, columns = camera.image_size
    # the region without a rim, or as it is where nothing would be left
    depth = cv2.distanceTransform(np.pad(region.astype(np.uint8), 1), cv2.DIST_L2, 3)[1:-1, 1:-1]
    inner = np.asarray(depth > px_per_mm * region.shape[1] / columns)
    inner = inner if inner.any() else region
    whole = cv2.resize(inner.astype(np.uint8), (columns, rows), interpolation=cv2.INTER_NEAREST) > 0
    part = []
    for extent in bounding_box(whole):
        outside = max(0.5 * (extent.stop - extent.start - FOCUS_FIELD_MM * px_per_mm), 0.0)
        part.append(slice(int(extent.start + outside), int(np.ceil(extent.stop - outside))))
    lights.on(exposure.brightest)
    frame = camera.capture()
    lights.off()
    light = grey_light(frame.pixels[tuple(part)], frame.black_level)
    return measure_focus(light, whole[tuple(part)], px_per_mm)


# Before the shots: where the finger is, whether every LED lights, and which exposure each band
# gets. Previews only.


def _meter(
    devices: Opened,
    bands: Mapping[str, Sequence[int]],
    settings: SessionSettings,
    progress: Callable[[float], None],
) -> tuple[BoolArray, dict[str, Exposure]]:
    """Preview the finger under every LED; find its region on the previews' grid, and every band's
    exposure."""
    camera, lights = devices.camera, devices.lights
    region: BoolArray | None = None
    exposures: dict[str, Exposure] = {}
    for done, (band, leds) in enumerate(bands.items()):
        if band == "white_crossed" and leds == bands["white"]:
            exposures[band] = exposures["white"]
            continue

        def look(
            led: int, exposure_s: float, gain: float, band: str = spectral_band(band)
        ) -> Frame:
            camera.lock(exposure_s, gain, band)
            lights.on(led)
            return camera.preview()

        # against the order of the shots: a camera that lags shows other LEDs in both
        seen = survey(look, leds[::-1], camera.exposures, settings.exposure)
        lights.off()
        camera.lock(seen.exposure_s, seen.gain, spectral_band(band))
        room = camera.preview()
        added = max(
            float(np.percentile(frame.pixels - np.float32(room.pixels), 99.9))
            for frame in seen.frames.values()
        )
        require(
            added > 0.02 * float(np.iinfo(room.pixels.dtype).max),
            f"nothing is seen under any {band.replace('_', ' ')} LED that is not seen without it;"
            " check the LEDs' supply and the lens.",
        )
        if region is None:
            everything = np.ones(room.pixels.shape[:2], dtype=np.bool_)
            region = _region(seen, room, devices) if settings.find_finger else everything
        _check_lit(seen, room, led_names(devices.rig))
        # both series have the parallel one's
        exposure = exposures.get(band.removesuffix("_crossed"))
        exposure = exposure or find_exposure(
            look, seen, region, camera.exposures, settings.exposure
        )
        exposures[band] = exposure.promising(seen, room)
        lights.off()
        progress((done + 1) / len(bands))
    assert region is not None
    return region, exposures


def _region(seen: Survey, room: Frame, devices: Opened) -> BoolArray:
    mean: FloatArray = np.mean(
        [frame.pixels for frame in seen.frames.values()], axis=0, dtype=np.float32
    )
    mean -= room.pixels
    mean *= np.float32(1.0 / np.iinfo(room.pixels.dtype).max)
    try:
        image = mean if mean.shape[2] == 3 else mean[..., 0]
        return finger_mask(
            image, devices.rig.camera.px_per_mm * mean.shape[1] / devices.camera.image_size[1]
        )
    except BadInput as error:
        raise BadInput(
            f"no finger is seen under the white LEDs ({str(error).rstrip('.')}); lay one down."
        ) from error


def _check_lit(seen: Survey, room: Frame, names: Sequence[str]) -> None:
    dark = float(coarse_light(room).mean())
    levels = {led: float(coarse_light(frame).mean()) - dark for led, frame in seen.frames.items()}
    typical = float(np.median(list(levels.values())))
    unlit = [names[led] for led in sorted(levels) if levels[led] < 0.12 * typical]
    require(
        not unlit,
        f"{listed(unlit)} did not light; check {'its' if len(unlit) == 1 else 'their'} wiring and"
        " capture again.",
    )
    require(
        dark <= 0.3 * typical,
        f"there is light although all LEDs are off ({100 * dark / max(typical, 1e-9):.0f} % of an"
        " LED's): close the lid, or look for an LED that stays on.",
    )
