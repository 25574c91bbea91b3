"""The rough dome as the methods see it: photographs in which the object was found."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from rough_dome import scene
from splitknit.io.plain import capture_of_arrays
from splitknit.methods.photographs import FingerPhotographs, prepared
from splitknit.model import Camera
from splitknit.presets import PRESETS

PX_PER_MM = 10.0
COLOUR = (0.9, 0.6, 0.3)
"""Red, green and blue of a thing that has a colour."""


def dome(
    preset: str = "ea",
    *,
    side: int = 60,
    px_per_mm: float = PX_PER_MM,
    colour: Any = None,
    pixels: np.ndarray | None = None,
    **capture: Any,
) -> FingerPhotographs:
    """Photographs (8, side, side) of 16 bits, with a `colour` in red, green and blue, or given as
    `pixels`; `capture`: fields of the capture that differ."""
    stack, lights, mask = scene(0, side)
    if pixels is None:
        stack = np.clip(0.6 * stack, 0, 1)
        if colour is not None:
            stack = stack[..., None] * np.asarray(colour)
        pixels = np.rint(stack * 65535).astype(np.uint16)
    photographed, _ = capture_of_arrays(pixels, lights, mask, px_per_mm, np.ones(len(lights)))
    photographs = prepared(photographed, PRESETS[preset])
    return replace(photographs, capture=replace(photographs.capture, **capture))


def from_40_mm(camera: Camera) -> Camera:
    """The camera as a perspective one, 40 mm above the plane."""
    rows, columns = camera.image_size
    focal_px = 40.0 * camera.px_per_mm
    matrix = np.array(
        [[focal_px, 0, (columns - 1) / 2], [0, focal_px, (rows - 1) / 2], [0, 0, 1]], dtype=float
    )
    return replace(camera, model="perspective", height_mm=40.0, matrix=matrix)
