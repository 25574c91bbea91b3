"""Preview for focusing: the sharpness of repeated photographs, and a picture."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from splitknit.devices import Opened
from splitknit.io.images import write_image
from splitknit_rig.capture.exposure import (
    FINGER_PERCENTILE,
    START_S,
    ExposureSettings,
    exposure_of,
    grey_light,
    measure_focus,
)
from splitknit_rig.capture.session import FOCUS_FIELD_MM


def look_again(
    devices: Opened,
    led: int,
    seconds: float,
    picture: Path | None,
    show: Callable[[float, float], None],
) -> tuple[int, float]:
    """Photograph under one LED for some seconds; return the number of photographs, and the largest
    sharpness (%) of their middle.

    `show` is called with the sharpness of each and the largest so far, `picture` with the latest
    photograph, at most 640 pixels wide. The exposure adapts to the light.
    """
    camera, rig = devices.camera, devices.rig
    settings = ExposureSettings()
    product, best, count = START_S, 0.0, 0
    half = 0.5 * FOCUS_FIELD_MM * rig.camera.px_per_mm
    part = tuple(
        slice(max(int(length / 2 - half), 0), int(length / 2 + half))
        for length in camera.image_size
    )
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        time_s, gain = exposure_of(product, camera.exposures, settings)
        camera.lock(time_s, gain, rig.leds[led].band)
        devices.lights.on(led)
        frame = camera.capture()
        light = grey_light(frame.pixels, frame.black_level)
        level = max(float(np.percentile(light[::4, ::4], FINGER_PERCENTILE)), 0.01)
        product = time_s * gain * float(np.clip(settings.target / level, 0.25, 4.0))
        everywhere = np.ones(light[part].shape, dtype=np.bool_)
        sharpness = measure_focus(light[part], everywhere, rig.camera.px_per_mm).sharpness
        best = max(best, sharpness)
        count += 1
        if picture is not None:
            every = max(1, frame.pixels.shape[1] // 640)
            write_image(picture, frame.pixels[::every, ::every])
        show(sharpness, best)
    return count, best
