"""Pictures with captions, and what the camera saw: the mean white image with what was found in it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from splitknit.io.pictures import BLUE, ORANGE, SKY, ColourArray, data_uri, upright_limits
from splitknit.model import Band, Capture, PixelArray, Reconstruction
from splitknit.steps import let_go

_NO_LEGEND = Markup("")


@dataclass(frozen=True, slots=True)
class Picture:
    """One figure of the report."""

    title: str
    uri: Markup
    caption: str
    width: int
    height: int
    legend: Markup = _NO_LEGEND
    scale_percent: float = 0.0
    """Length of the scale bar in percent of the picture's width; 0 = none."""
    scale_label: str = ""


def captioned(  # noqa: PLR0917
    title: str,
    image: NDArray[np.uint8],
    caption: str,
    legend: Markup = _NO_LEGEND,
    pitch_mm: float = 0.0,
    photo: bool = False,
) -> Picture:
    """A picture as a data URI, with a bar of a round length where the size of a pixel is known."""
    height, width = image.shape[:2]
    bar_mm = next((b for b in (10.0, 5.0, 2.0, 1.0, 0.5) if b < 0.45 * width * pitch_mm), 0.0) if pitch_mm else 0.0
    return Picture(
        title=title,
        uri=Markup(data_uri(image, photo=photo)),  # holds nothing that HTML would have to escape
        caption=caption,
        width=width,
        height=height,
        legend=legend,
        scale_percent=round(100 * bar_mm / (width * pitch_mm), 2) if bar_mm else 0.0,
        scale_label=f"{bar_mm:g} mm",
    )


LONGEST_PX = 700
"""Longer side of a picture."""


def small_images(band: Band) -> PixelArray:
    """The images (L, h, w, C) of a band as small as a picture of the report shows them."""
    rows, columns = band.pixels.shape[1:3]
    scale = min(1.0, LONGEST_PX / max(rows, columns))
    size = (max(1, round(columns * scale)), max(1, round(rows * scale)))
    small = []
    for image in band.pixels:
        small.append(cv2.resize(image, size, interpolation=cv2.INTER_AREA))
        let_go(band.pixels)
    return np.stack(small).reshape(len(small), size[1], size[0], -1)


def _mean_image(capture: Capture, size: tuple[int, int]) -> ColourArray:
    """Mean of the white images for people, `size` (columns, rows)."""
    pixels = capture.bands["white"].pixels
    total = np.zeros((size[1], size[0], 3), dtype=np.float32)
    for image in pixels:
        small = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.float32)
        total += small.reshape(size[1], size[0], -1)
    total /= len(pixels) * float(np.iinfo(pixels.dtype).max)
    brightest = max(float(np.percentile(total, 99.7)), 1e-6)
    gamma = 1.0 / 2.2 if capture.encoding == "linear" else 1.0
    picture: ColourArray = np.round(255 * np.clip(total / brightest, 0.0, 1.0) ** gamma).astype(np.uint8)
    return np.ascontiguousarray(picture)


def mask_on_image(result: Reconstruction, capture: Capture) -> Picture:
    """Show the mean white image as the camera saw it, with the mask's outline, the cut and the finger's axis."""
    rows, columns = result.mask.shape
    scale = min(1.0, LONGEST_PX / max(rows, columns))
    size = (max(1, round(columns * scale)), max(1, round(rows * scale)))
    picture = _mean_image(capture, size)

    inside = cv2.resize(result.mask.astype(np.uint8) * 255, size, interpolation=cv2.INTER_AREA) > 127
    outlines, _ = cv2.findContours(inside.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(picture, outlines, -1, ORANGE, 2, cv2.LINE_AA)
    finger = result.facts.get("material", "skin") == "skin"
    if finger:
        _draw(picture, [_axis(result)], scale, SKY)
    crease = result.facts.get("crease_line")
    if crease is not None:
        _draw(picture, [np.asarray(crease, dtype=np.float64)], scale, BLUE)
    caption = (
        "Mean of the white-light images, as the camera saw it. Orange: the outline of the skin that was used. "
        "Pale blue: the finger's axis, with a dot at the tip. "
    )
    caption += (
        "Dark blue: the flexion crease at which the phalange was cut. " if crease is not None else "No crease was cut. "
    )
    caption += "Good: the outline follows the finger closely and holds neither background nor shadow."
    if not finger:
        caption = (
            "Mean of the images, as the camera saw it. Orange: the outline of what was measured. Good: the outline "
            "follows the thing closely and holds neither background nor shadow."
        )
    return captioned(
        "Finger found" if finger else "Outline", picture, caption, pitch_mm=result.pitch_mm / scale, photo=True
    )


def _axis(result: Reconstruction) -> NDArray[np.float64]:
    """Two points (column, row) of the input: tip end and base end of the upright frame's middle line in the mask."""
    ends = upright_limits(result)
    ends[:, 0] = ends[:, 0].mean()
    return np.asarray(ends @ result.input_from_upright[:2, :2].T + result.input_from_upright[:2, 2])


def _draw(
    picture: ColourArray, lines: Sequence[NDArray[np.float64]], scale: float, shade: tuple[int, int, int]
) -> None:
    for line in lines:
        points = [(round(float(c) * scale), round(float(r) * scale)) for c, r in line]
        cv2.polylines(picture, [np.array(points, dtype=np.int32)], False, shade, 2, cv2.LINE_AA)
        if shade == SKY:
            cv2.circle(picture, points[0], 5, shade, -1, cv2.LINE_AA)


def mirror_pictures(result: Reconstruction, capture: Capture) -> list[Picture]:
    """One picture where the shape came from mirrors, none elsewhere."""
    drawing = result.facts.get("mirror_drawing")
    if drawing is None:
        return []
    rows, columns = capture.shape
    scale = min(1.0, LONGEST_PX / max(rows, columns))
    picture = _mean_image(capture, (max(1, round(columns * scale)), max(1, round(rows * scale))))
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
    return [captioned("Views in the mirrors", picture, caption, pitch_mm=result.pitch_mm / scale, photo=True)]


def _line(
    picture: ColourArray, points: Iterable[Any], scale: float, shade: tuple[int, int, int], *, closed: bool = False
) -> None:
    places = np.round(np.asarray(list(points), dtype=np.float64) * scale).astype(np.int32)
    cv2.polylines(picture, [places], closed, shade, 1, cv2.LINE_AA)
