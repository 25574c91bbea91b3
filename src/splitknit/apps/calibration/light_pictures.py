"""Pictures that show what was found in photographs for the calibration of lights."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.apps.pictures import ORANGE, PAPER, SKY, ColourArray
from splitknit.calibration.shadow import NailView
from splitknit.model import FloatArray

Points = NDArray[np.float64]


def nail_overview(
    tiles: Sequence[tuple[str, FloatArray, NailView, int]], image_size: tuple[int, int], width: int = 400
) -> ColourArray:
    """All photographs of the nail, small, seven a row: nail tip (cross), shadow tip (ring), ray towards the LED (line).

    Parameters
    ----------
    tiles : name, image (h, w) of any size, what was found in its stack, and the image's number in it
    image_size : rows, columns of the photographs
    width : of each tile in pixels
    """
    drawn = [
        nail_tile(name, image, (view.nail_px, view.tips_px[led]), image_size, width) for name, image, view, led in tiles
    ]
    blank = np.full_like(drawn[0], 255)
    drawn += [blank] * (-len(drawn) % 7)
    rows = [np.concatenate(drawn[k : k + 7], axis=1) for k in range(0, len(drawn), 7)]
    return np.ascontiguousarray(np.concatenate(rows, axis=0))


def nail_tile(
    name: str, image: FloatArray, found: tuple[Points, Points], image_size: tuple[int, int], width: int
) -> ColourArray:
    """One photograph with what was found drawn into it: `found` is the nail and the tip."""
    nail_px, tip_px = found
    scale = width / image_size[1]
    size = (width, max(1, round(image_size[0] * scale)))
    grey = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    top = max(float(np.percentile(grey, 99.5)), 1e-6)
    shade = np.rint(255.0 * np.clip(grey / top, 0, 1) ** (1 / 2.2)).astype(np.uint8)
    picture = np.ascontiguousarray(np.repeat(shade[..., None], 3, axis=2))
    nail = _at(nail_px, scale)
    if np.isfinite(tip_px).all():
        away = nail_px - tip_px
        away = away / max(float(np.linalg.norm(away)), 1e-9) * float(sum(image_size))
        cv2.line(picture, _at(tip_px, scale), _at(nail_px + away, scale), SKY, 1, cv2.LINE_AA, 4)
        cv2.circle(picture, _at(tip_px, scale), 6 * 16, ORANGE, 1, cv2.LINE_AA, 4)
    for x, y in ((6 * 16, 0), (0, 6 * 16)):
        cv2.line(picture, (nail[0] - x, nail[1] - y), (nail[0] + x, nail[1] + y), PAPER, 1, cv2.LINE_AA, 4)
    words = name if np.isfinite(tip_px).all() else f"{name}: out of the picture"
    cv2.putText(picture, words, (6, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255, 255, 255), 3, cv2.LINE_AA)
    cv2.putText(picture, words, (6, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (0, 0, 0), 1, cv2.LINE_AA)
    picture[-1], picture[:, -1] = 255, 255
    return picture


def _at(place: Points, scale: float) -> tuple[int, int]:
    """Of a pixel of the photograph, in sixteenths of a pixel of the tile."""
    x, y = (place + 0.5) * scale - 0.5
    return round(16 * float(x)), round(16 * float(y))
