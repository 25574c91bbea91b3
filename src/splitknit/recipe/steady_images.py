"""The part of the images in which motion is looked for and undone: its place, its light, and its pixels elsewhere."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.finger.registration_flow import Flow
from splitknit.imaging import Window
from splitknit.imaging.view import plane_points
from splitknit.model import Band, Capture
from splitknit.photometric import light_vectors_at
from splitknit.recipe.finger import Finger

MARGIN_MM = 2.0
"""Beyond the finger, images are left as they are."""


def around(capture: Capture, finger: Finger) -> Window:
    """Rows and columns that hold the finger and what is beside it."""
    margin = round(MARGIN_MM * capture.rig.camera.px_per_mm)
    rows, columns = finger.window
    height, width = capture.shape
    return (
        slice(max(0, rows.start - margin), min(height, rows.stop + margin)),
        slice(max(0, columns.start - margin), min(width, columns.stop + margin)),
    )


def lights_over(capture: Capture, band: Band, window: Window, pitch_mm: float) -> NDArray[np.float64]:
    """(L, 3, h, w) light vectors on the finger plane, on nodes about `pitch_mm` apart evenly over a window."""
    camera = capture.rig.camera
    rows, columns = (
        np.linspace(part.start, part.stop - 1, max(2, round((part.stop - part.start) * camera.pitch_mm / pitch_mm) + 1))
        for part in window
    )
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1)
    places = plane_points(camera, pixels.reshape(-1, 2)).reshape(pixels.shape).astype(np.float32)
    level = np.zeros(pixels.shape[:2], dtype=np.float32)
    field = light_vectors_at(capture.rig.select(band.lights), places[..., 0], places[..., 1], level)
    return np.asarray(field, dtype=np.float64)


def take(  # noqa: PLR0917
    image: NDArray[Any], flow: Flow, shot: int, px_per_mm: float, window: Window, out: NDArray[Any]
) -> None:
    """Write a shot's image where a window of the reference has its skin, by cubic interpolation, into `out`."""
    place = out[window]
    affine = flow.affine(shot, px_per_mm)
    if affine is None:
        columns, rows = flow.maps(shot, px_per_mm, window)
        moved = cv2.remap(image, columns, rows, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    else:
        first = np.array([window[1].start, window[0].start], dtype=np.float64)
        affine[:, 2] += affine[:, :2] @ first
        size = (place.shape[1], place.shape[0])
        flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
        moved = cv2.warpAffine(image, affine, size, dst=place, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    if not np.shares_memory(moved, out):
        place[...] = moved.reshape(place.shape)
