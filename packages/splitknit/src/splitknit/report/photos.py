"""What the camera saw: the mean of the white images with the outline, and all photographs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from splitknit.capture import Band, Capture
from splitknit.io.pictures import BLUE, ORANGE, SKY, ColourArray, colour, data_uri, upright_limits
from splitknit.model import FloatArray, PixelArray
from splitknit.reconstruction import Reconstruction

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


def is_finger(result: Reconstruction) -> bool:
    """Whether the result shows a finger, captured as skin, and not an opaque object."""
    return str(result.facts.get("material", "skin")) == "skin"


def captioned(
    title: str,
    image: NDArray[np.uint8],
    caption: str = "",
    pitch_mm: float = 0.0,
    legend: Markup = _NO_LEGEND,
) -> Picture:
    """A picture as a data URI, with a scale bar where the pixel size is known. Prints and pictures
    with a legend are stored without loss, all others as JPEG.
    """
    height, width = image.shape[:2]
    bar_mm = round_step(0.45 * width * pitch_mm) if pitch_mm else 0.0
    return Picture(
        title=title,
        # HTML has to escape nothing in it
        uri=Markup(data_uri(image, photo=image.ndim == 3 and not legend)),
        caption=caption,
        width=width,
        height=height,
        legend=legend,
        scale_percent=round(100 * bar_mm / (width * pitch_mm), 2) if bar_mm else 0.0,
        scale_label=f"{bar_mm:g} mm",
    )


def round_step(limit: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten that does not exceed `limit`.

    >>> round_step(0.45), round_step(73.0)
    (0.2, 50.0)
    """
    ten = float(10.0 ** np.floor(np.log10(limit)))
    return max(float(f"{digit * ten:.1g}") for digit in (1, 2, 5) if digit * ten <= limit)


def colour_bar(low: float, high: float, unit: str, *, diverging: bool = False) -> Markup:
    """A bar that explains :func:`splitknit.io.pictures.colour`."""
    fractions = np.linspace(0.0, 1.0, 17, dtype=np.float32)
    shades = colour(fractions, 0.0, 1.0, diverging=diverging)
    stops = ",".join(f"rgb({r},{g},{b})" for r, g, b in shades)
    return Markup(
        '<div style="max-width:220px"><div'
        f' style="height:10px;background:linear-gradient(90deg,{stops})"></div><div'
        f' style="display:flex;justify-content:space-between;font-size:11px"><span>{low:.4g}</span>'
        f"<span>{(low + high) / 2:.4g} {unit}</span><span>{high:.4g}</span></div></div>"
    )


LONGEST_PX = 700  # longer side of a picture


def _fitting(shape: tuple[int, ...]) -> tuple[tuple[int, int], float]:
    """Size (columns, rows) of a picture of an image of this shape, and the scale between them."""
    rows, columns = shape
    scale = min(1.0, LONGEST_PX / max(rows, columns))
    return (max(1, round(columns * scale)), max(1, round(rows * scale))), scale


def small_images(band: Band) -> PixelArray:
    """The images (L, h, w, C) of a band as small as a picture of the report shows them."""
    size, _ = _fitting(band.pixels.shape[1:3])
    small = []
    for photograph in band.pixels:
        image = photograph
        while min(image.shape[0] / size[1], image.shape[1] / size[0]) >= 2:
            half = image.shape[1] // 2, image.shape[0] // 2  # OpenCV is fast at whole factors
            image = cv2.resize(image, half, interpolation=cv2.INTER_AREA)
        small.append(cv2.resize(image, size, interpolation=cv2.INTER_AREA))
    return np.stack(small).reshape(len(small), size[1], size[0], -1)


def _mean_image(capture: Capture) -> ColourArray:
    """Mean of the white images for people."""
    band = capture.bands["white"]
    level = small_images(band).mean(axis=0, dtype=np.float32)
    return _shown(level / max(float(np.percentile(level, 99.7)), 1e-6), capture)


def _shown(level: FloatArray, capture: Capture) -> ColourArray:
    """Levels (h, w) or (h, w, C), 1 = white, for people."""
    gamma = 1.0 / 2.2 if capture.encoding == "linear" else 1.0
    code = np.round(255 * np.clip(level, 0.0, 1.0) ** gamma).astype(np.uint8)
    return np.atleast_3d(code) * np.ones(3, dtype=np.uint8)


def capture_pictures(result: Reconstruction, capture: Capture | None) -> list[Picture]:
    """The outline on the photographs, the mirrors' views where the shape came from them, and the
    photographs; none without a capture."""
    if capture is None:
        return []
    pictures = [_mask_on_image(result, capture), _contact_sheet(capture)]
    drawing = result.facts.get("mirror_drawing")
    if drawing is not None:
        pictures.insert(1, _mirror_picture(result, capture, drawing))
    return pictures


def _contact_sheet(capture: Capture) -> Picture:
    """All photographs, small, in the order of their bands and lights, each as bright as its sensor
    saw it."""
    images = [image for band in capture.bands.values() for image in band.pixels]
    across = min(4, len(images))
    width = LONGEST_PX // across
    size = (width, max(1, width * images[0].shape[0] // images[0].shape[1]))
    shots = []
    for image in images:
        small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        shots.append(_shown(small / np.float32(np.iinfo(image.dtype).max), capture))
    shots += [np.full_like(shots[0], 255)] * (-len(shots) % across)
    sheet = np.vstack([np.hstack(shots[n : n + across]) for n in range(0, len(shots), across)])
    named = "; ".join(f"{len(band.pixels)} {name}" for name, band in capture.bands.items())
    return captioned("Photographs", sheet, f"{named}." if len(capture.bands) > 1 else "")


def _mask_on_image(result: Reconstruction, capture: Capture) -> Picture:
    """Show the mean white image as the camera saw it, with the mask's outline, the cut and the
    finger's axis."""
    size, scale = _fitting(result.mask.shape)
    picture = _mean_image(capture)

    inside = (
        cv2.resize(result.mask.astype(np.uint8) * 255, size, interpolation=cv2.INTER_AREA) > 127
    )
    outlines, _ = cv2.findContours(
        inside.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    cv2.drawContours(picture, outlines, -1, ORANGE, 2, cv2.LINE_AA)
    finger = is_finger(result)
    if finger:
        ends = upright_limits(result)
        # tip and base of the upright frame's middle line in the mask
        ends[:, 0] = ends[:, 0].mean()
        ends = scale * (
            ends @ result.input_from_upright[:2, :2].T + result.input_from_upright[:2, 2]
        )
        _line(picture, ends, SKY, 2)
        cv2.circle(picture, np.round(ends[0]).astype(int).tolist(), 5, SKY, -1, cv2.LINE_AA)
    crease = result.facts.get("crease_line")
    if crease is not None:
        _line(picture, scale * np.asarray(crease, dtype=np.float64), BLUE, 2)
    pitch_mm = result.pitch_mm / scale
    if not finger:
        return captioned("Outline", picture, pitch_mm=pitch_mm)
    cut = "No crease was cut."
    if crease is not None:
        cut = "Dark blue: the flexion crease at which the phalange was cut."
    return captioned("Finger found", picture, cut, pitch_mm)


def _mirror_picture(
    result: Reconstruction, capture: Capture, drawing: Mapping[str, Any]
) -> Picture:
    """The mean image with the outlines in every view, where the shape came from mirrors."""
    _, scale = _fitting(capture.shape)
    picture = _mean_image(capture)
    for name, shade in (("mirrors", (120, 120, 120)), ("masks", ORANGE), ("medial_lines", SKY)):
        for line in drawing[name].values():
            _line(
                picture,
                scale * np.array(line, dtype=np.float64),
                shade,
                1,
                closed=name != "medial_lines",
            )
    for outline in drawing["fitted"].values():
        for place in np.round(scale * np.array(outline, dtype=np.float64)).astype(int).tolist():
            cv2.circle(picture, place, 2, BLUE, -1, cv2.LINE_AA)
    return captioned("Views in the mirrors", picture, pitch_mm=result.pitch_mm / scale)


def _line(
    picture: ColourArray,
    points: NDArray[np.float64],
    shade: Sequence[int],
    width: int,
    *,
    closed: bool = False,
) -> None:
    cv2.polylines(picture, [np.round(points).astype(np.int32)], closed, shade, width, cv2.LINE_AA)
