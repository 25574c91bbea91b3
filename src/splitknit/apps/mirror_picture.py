"""The report's picture of a finger between mirrors: views, medial lines, and the outlines of the fitted finger."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import cv2
import numpy as np

from splitknit.apps.captioned import Picture
from splitknit.apps.photo_figures import LONGEST_PX, mean_image, titled
from splitknit.apps.pictures import BLUE, ORANGE, SKY, ColourArray
from splitknit.model import Capture, Reconstruction


def mirror_pictures(result: Reconstruction, capture: Capture) -> list[Picture]:
    """One picture where the shape came from mirrors, none elsewhere."""
    drawing = result.facts.get("mirror_drawing")
    if drawing is None:
        return []
    rows, columns = capture.shape
    scale = min(1.0, LONGEST_PX / max(rows, columns))
    picture = mean_image(capture, (max(1, round(columns * scale)), max(1, round(rows * scale))))
    for corners in drawing["mirrors"].values():
        _line(picture, corners, scale, (120, 120, 120), closed=True)
    for outline in drawing["masks"].values():
        _line(picture, outline, scale, ORANGE, closed=True)
    for line in drawing["medial_lines"].values():
        _line(picture, line, scale, SKY)
    for outline in drawing["fitted"].values():
        for point in outline:
            place = (round(float(point[0]) * scale), round(float(point[1]) * scale))
            cv2.circle(picture, place, 2, BLUE, -1, cv2.LINE_AA)
    caption = (
        "The finger itself and its mirror images. Orange: the outline found in each view. Pale blue: medial lines. "
        "Dark blue dots: the outline of the fitted finger, seen in the mirrors where they were found. Grey: where the "
        "rig file has the mirrors. Good: the dots lie on the orange lines."
    )
    return [titled("Views in the mirrors", picture, caption, pitch_mm=result.pitch_mm / scale)]


def _line(
    picture: ColourArray, points: Iterable[Any], scale: float, shade: tuple[int, int, int], *, closed: bool = False
) -> None:
    places = np.round(np.asarray(list(points), dtype=np.float64) * scale).astype(np.int32)
    cv2.polylines(picture, [places], closed, shade, 1, cv2.LINE_AA)
