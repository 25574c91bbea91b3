"""Captures of other kinds, made from one, and the accuracy of every preset on that one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from splitknit.capture import Ambient, Band, Capture
from splitknit.model import Led, Rig

FIGURES = {
    "metric": ((0.3258, 0.0003), (0.7014, 0.0004), (0.6467, 0.0003)),
    "metric with networks": ((0.1197, 0.0005), (0.9402, 0.0001), (0.9383, 0.0006)),
    "snk": ((0.7126, 0.0001), (0.5973, 0.0002), (0.2083, 0.0002)),
    "pr": ((0.8849, 0.0015), (0.6181, 0.0002), (0.4642, 0.0004)),
    "ea": ((0.8362, 0.0001), (0.6518, 0.0001), (0.1764, 0.0001)),
    "pr-split": ((0.8849, 0.0015), (0.5973, 0.0002), (0.2083, 0.0002)),
    "ea-split": ((0.8362, 0.0001), (0.6067, 0.0001), (0.0807, 0.0001)),
    "kumar": ((0.8364, 0.0001), (0.6380, 0.0001), (0.1341, 0.0001)),
    "zheng": ((0.8362, 0.0001), (0.6518, 0.0001), (0.1764, 0.0001)),
    "lin": ((0.8377, 0.0002), (0.6710, 0.0001), (0.2118, 0.0001)),
}
"""Rms of the surface (mm), correlation and gain of the relief of the finger of `twin_folder` (with
networks: at scale 0.17): mean and standard deviation over six photographs with other dust and
noise."""


def each_band(capture: Capture, change: Callable[[Band], Band]) -> Capture:
    return replace(capture, bands={name: change(band) for name, band in capture.bands.items()})


def each_led(capture: Capture, change: Callable[[Led], Led]) -> Capture:
    return replace(
        capture, rig=replace(capture.rig, leds=tuple(change(led) for led in capture.rig.leds))
    )


def of_pixels(ambient: Ambient | None, change: Callable[[Any], Any]) -> Ambient | None:
    """The ambient image with other pixels."""
    return None if ambient is None else replace(ambient, pixels=change(ambient.pixels))


def turned(capture: Capture, quarter_turns: int, tip_direction_deg: float | None) -> Capture:
    """Images and lights turned counter-clockwise together."""

    def turn_array(array: Any, axes: tuple[int, int]) -> Any:
        return None if array is None else np.ascontiguousarray(np.rot90(array, quarter_turns, axes))

    def turn_led(led: Led) -> Led:
        assert led.position_mm is not None
        x, y, z = led.position_mm
        for _ in range(quarter_turns):
            x, y = -y, x
        return replace(led, position_mm=(x, y, z))

    size = capture.shape if quarter_turns % 2 == 0 else capture.shape[::-1]
    rig = Rig(
        replace(capture.rig.camera, image_size=size),
        tuple(turn_led(led) for led in capture.rig.leds),
    )
    result = replace(capture, rig=rig, tip_direction_deg=tip_direction_deg)
    return each_band(
        result,
        lambda band: replace(
            band,
            pixels=turn_array(band.pixels, (1, 2)),
            ambient=of_pixels(band.ambient, lambda image: turn_array(image, (0, 1))),
        ),
    )


def cropped(capture: Capture, rows: slice, columns: slice) -> Capture:
    """A part of every image; the lights move against the new middle."""
    height, width = capture.shape
    first_row, last_row, _ = rows.indices(height)
    first_column, last_column, _ = columns.indices(width)
    pitch = capture.rig.camera.pitch_mm
    right = ((first_column + last_column - 1) - (width - 1)) / 2 * pitch
    up = -((first_row + last_row - 1) - (height - 1)) / 2 * pitch

    def moved(led: Led) -> Led:
        assert led.position_mm is not None
        x, y, z = led.position_mm
        return replace(led, position_mm=(x - right, y - up, z))

    def part(band: Band) -> Band:
        ambient = of_pixels(band.ambient, lambda image: np.ascontiguousarray(image[rows, columns]))
        return replace(
            band, pixels=np.ascontiguousarray(band.pixels[:, rows, columns]), ambient=ambient
        )

    camera = replace(
        capture.rig.camera, image_size=(last_row - first_row, last_column - first_column)
    )
    result = each_band(each_led(capture, moved), part)
    return replace(result, rig=replace(result.rig, camera=camera))


def grey(capture: Capture, material: str) -> Capture:
    """White light only, as a grey camera sees it."""
    white = capture.bands["white"]
    weights = np.array([0.299, 0.587, 0.114])

    def merged(pixels: Any) -> Any:
        return (
            None if pixels is None else np.round(pixels @ weights).astype(pixels.dtype)[..., None]
        )

    band = replace(white, pixels=merged(white.pixels), ambient=of_pixels(white.ambient, merged))
    return replace(capture, material=material, bands={"white": band})


def chosen_lights(capture: Capture, images: list[int]) -> Capture:
    return each_band(
        capture,
        lambda band: replace(
            band,
            pixels=band.pixels[images],
            leds=tuple(band.leds[k] for k in images),
            exposure=band.exposure[images],
            black_level=band.black_level[images],
            files=(),
        ),
    )


def paired_lights(capture: Capture) -> Capture:
    """Each exposure lit by two neighbours, half as long."""

    def pair(band: Band) -> Band:
        count = len(band.pixels)
        both = band.pixels.astype(float) + np.roll(band.pixels, -1, axis=0)
        both -= 0 if band.ambient is None else band.ambient.pixels  # it was there once in each
        return replace(
            band,
            pixels=np.clip(np.round(both / 2), 0, 255).astype(np.uint8),
            leds=tuple(band.leds[k] + band.leds[(k + 1) % count] for k in range(count)),
            exposure=band.exposure / 2,
        )

    return each_band(capture, pair)


def distant(capture: Capture) -> Capture:
    def far(led: Led) -> Led:
        x, y, z = np.asarray(led.position_mm) / np.linalg.norm(np.asarray(led.position_mm))
        return replace(led, position_mm=None, direction=(float(x), float(y), float(z)))

    return each_led(capture, far)


def perspective(capture: Capture) -> Capture:
    """The same pictures, said to come from a camera with a lens."""
    camera = capture.rig.camera
    focal = camera.px_per_mm * camera.height_mm
    rows, columns = camera.image_size
    matrix = np.array([[focal, 0, (columns - 1) / 2], [0, focal, (rows - 1) / 2], [0, 0, 1.0]])
    lens = replace(camera, model="perspective", matrix=matrix, distortion=(0.0, 0.0, 0.0, 0.0, 0.0))
    return replace(capture, rig=replace(capture.rig, camera=lens))
