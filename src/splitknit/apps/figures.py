"""The pictures of the report, each with a caption that says what is seen and what good looks like."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from splitknit.apps import charts
from splitknit.apps.compare import Comparison
from splitknit.apps.pictures import (
    BLUE,
    ORANGE,
    SKY,
    ColourArray,
    Frame,
    colour,
    data_uri,
    normal_colours,
    on_paper,
    to_frame,
    upright_frame,
    upright_turn,
)
from splitknit.apps.shading import oblique_view, top_view, upright_surface
from splitknit.types import Capture, FloatArray, Reconstruction

LONGEST_PX = 700
_NO_LEGEND = Markup("")
RELIEF_EXAGGERATION = 2.0
TILT_DEG = 56.0


@dataclass(frozen=True, slots=True)
class Picture:
    """One figure of the report."""

    title: str
    uri: str
    caption: str
    width: int
    height: int
    legend: Markup = _NO_LEGEND
    scale_percent: float = 0.0
    """Length of the scale bar in percent of the picture's width; 0 = none."""
    scale_label: str = ""


def _picture(  # noqa: PLR0917
    title: str,
    image: NDArray[np.uint8],
    caption: str,
    legend: Markup = _NO_LEGEND,
    pitch_mm: float = 0.0,
    photo: bool = False,
) -> Picture:
    height, width = image.shape[:2]
    bar_mm = next((b for b in (10.0, 5.0, 2.0, 1.0, 0.5) if b < 0.45 * width * pitch_mm), 0.0) if pitch_mm else 0.0
    return Picture(
        title=title,
        uri=data_uri(image, photo=photo),
        caption=caption,
        width=width,
        height=height,
        legend=legend,
        scale_percent=round(100 * bar_mm / (width * pitch_mm), 2) if bar_mm else 0.0,
        scale_label=f"{bar_mm:g} mm",
    )


def titled(title: str, image: ColourArray, caption: str, pitch_mm: float) -> Picture:
    """A photograph with a caption and a scale bar."""
    return _picture(title, image, caption, pitch_mm=pitch_mm, photo=True)


def mean_image(capture: Capture, size: tuple[int, int]) -> ColourArray:
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
    picture = mean_image(capture, size)

    inside = cv2.resize(result.mask.astype(np.uint8) * 255, size, interpolation=cv2.INTER_AREA) > 127
    outlines, _ = cv2.findContours(inside.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(picture, outlines, -1, ORANGE, 2, cv2.LINE_AA)
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
    return _picture("Finger found", picture, caption, pitch_mm=result.pitch_mm / scale, photo=True)


def _axis(result: Reconstruction) -> NDArray[np.float64]:
    """Two points (column, row) of the input: tip end and base end of the upright frame's middle line in the mask."""
    rows, columns = np.nonzero(result.mask[::4, ::4])
    points = np.stack([columns * 4.0, rows * 4.0, np.ones(rows.size)])
    upright = np.linalg.inv(result.input_from_upright) @ points
    middle = (float(upright[0].min()) + float(upright[0].max())) / 2
    ends = np.array([[middle, middle], [float(upright[1].min()), float(upright[1].max())], [1.0, 1.0]])
    return np.asarray((result.input_from_upright @ ends)[:2].T)


def _draw(
    picture: ColourArray, lines: Sequence[NDArray[np.float64]], scale: float, shade: tuple[int, int, int]
) -> None:
    for line in lines:
        points = [(round(float(c) * scale), round(float(r) * scale)) for c, r in line]
        cv2.polylines(picture, [np.array(points, dtype=np.int32)], False, shade, 2, cv2.LINE_AA)
        if shade == SKY:
            cv2.circle(picture, points[0], 5, shade, -1, cv2.LINE_AA)


def normals_picture(result: Reconstruction, frame: Frame) -> Picture:
    """Show the normals, turned with the finger."""
    values, weight = to_frame(result.normals, result.mask, frame)
    turned = values.copy()
    turned[..., :2] = np.einsum("ij,hwj->hwi", upright_turn(result).astype(np.float32), values[..., :2])
    picture = on_paper(normal_colours(turned), weight)
    return _picture(
        "Surface normals",
        picture,
        "Direction of the surface: red grows to the right, green to the tip, blue towards the camera. "
        "Good: colours change smoothly over the finger, with the ridges as fine lines on top, and no blotches.",
        pitch_mm=frame.pitch_mm,
        photo=True,
    )


def relief_picture(result: Reconstruction, frame: Frame) -> Picture:
    """Show the ridges and valleys in micrometres."""
    values, weight = to_frame(result.ridge_mm, result.mask, frame)
    relief = 1000.0 * values
    low, high = relief_limits_um(result)
    picture = on_paper(colour(relief, low, high), weight)
    return _picture(
        "Relief",
        picture,
        "Height of the ridges above their surroundings, without the shape of the finger. Yellow is high. "
        "Good: even, unbroken ridges from edge to edge, some 40 to 100 µm from valley to top.",
        charts.colour_bar(low, high, "µm"),
        frame.pitch_mm,
    )


def relief_limits_um(result: Reconstruction) -> tuple[float, float]:
    """Limits of a colour scale for the relief: what ridges span where the skin faces the camera, in whole fives."""
    facing = result.mask & (result.normals[..., 2] > np.cos(np.pi / 4)) & np.isfinite(result.ridge_mm)
    where = facing if bool(facing.any()) else result.mask
    relief = 1000.0 * result.ridge_mm[where][::3]
    low, high = (float(v) for v in np.nanpercentile(relief, (3.0, 98.0)))
    margin = 0.1 * (high - low)
    return 5.0 * float(np.floor((low - margin) / 5.0)), 5.0 * float(np.ceil((high + margin) / 5.0 + 1e-9))


def shape_picture(result: Reconstruction, frame: Frame) -> Picture:
    """Show the finger without ridges, with contour lines."""
    values, weight = to_frame(result.shape_mm, result.mask, frame)
    top = float(np.percentile(values[weight > 0.5], 99.9))
    depth = values - np.float32(top)
    low = float(np.percentile(depth[weight > 0.5], 0.5))
    step = 0.5 if low > -6 else 1.0
    picture = colour(depth, low, 0.0)
    level = np.floor(depth / step)
    edge = np.zeros(level.shape, dtype=bool)
    edge[:, 1:] |= level[:, 1:] != level[:, :-1]
    edge[1:] |= level[1:] != level[:-1]
    edge[:, :-1] |= edge[:, 1:]
    edge[:-1] |= edge[1:]
    picture[edge & (weight > 0.9)] = (20, 20, 20)
    return _picture(
        "Shape",
        on_paper(picture, weight),
        f"Height of the finger without its ridges, below its highest point; a line every {step:g} mm. "
        "Good: smooth, rounded contours that close towards the tip, with no dents and no waves at the edge.",
        charts.colour_bar(round(low, 1), 0.0, "mm"),
        frame.pitch_mm,
    )


def uncertainty_picture(result: Reconstruction, frame: Frame) -> Picture | None:
    """Show the standard deviation of the relief, if the pipeline gives one."""
    if result.uncertainty_um is None:
        return None
    known = result.mask & np.isfinite(result.uncertainty_um)
    if not bool(known.any()):
        return None
    values, weight = to_frame(result.uncertainty_um, known, frame)
    high = float(np.percentile(values[weight > 0.5], 98))
    return _picture(
        "Uncertainty of the relief",
        on_paper(colour(values, 0.0, high), weight),
        "Skin blurs what light shows of the ridges, and glare covers it; both are undone as far as simulated skin "
        "teaches it. This is the standard deviation (one sigma) of what is left. Good: small against the relief.",
        charts.colour_bar(0.0, float(f"{high:.2g}"), "µm"),
        frame.pitch_mm,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """The shaded surface from three sides."""

    above: ColourArray
    left: ColourArray
    right: ColourArray
    pitch_mm: float
    """Size of one pixel of `above`."""


def render_views(result: Reconstruction, frame: Frame) -> Views:
    """Render the surface from above and from two sides."""
    surface = upright_surface(result, frame, RELIEF_EXAGGERATION)
    left, right = (oblique_view(surface, turn_deg=turn, tilt_deg=TILT_DEG) for turn in (38.0, -38.0))
    return Views(top_view(surface), left, right, frame.pitch_mm)


def view_pictures(views: Views) -> list[Picture]:
    """Show the surface from above and from two sides."""
    stated = f"Ridges are drawn {RELIEF_EXAGGERATION:g} times as high as they are; the shape of the finger is true."
    oblique = f"The same surface at {TILT_DEG:g} deg from the camera's axis. {stated}"
    return [
        _picture(
            "From above",
            views.above,
            f"Measured surface, lit from the upper left. {stated} "
            "Good: rounded like a finger, ridges even from edge to edge, no bumps or waves.",
            pitch_mm=views.pitch_mm,
            photo=True,
        ),
        _picture("From the left", views.left, oblique, photo=True),
        _picture("From the right", views.right, oblique, photo=True),
    ]


def print_picture(prints: NDArray[np.uint8]) -> Picture:
    """Show the print, cut to the finger."""
    dark = prints < 250
    rows, columns = np.flatnonzero(dark.any(axis=1)), np.flatnonzero(dark.any(axis=0))
    if rows.size:
        prints = prints[max(0, rows[0] - 8) : rows[-1] + 9, max(0, columns[0] - 8) : columns[-1] + 9]
    return _picture(
        "Print",
        prints,
        "The relief as ink on paper: ridges dark, mirrored against the camera image, 500 pixels an inch. "
        "Good: dark, separate ridges with clear endings and forks up to the edge.",
        pitch_mm=25.4 / 500,
    )


def error_pictures(result: Reconstruction, comparison: Comparison, frame: Frame) -> list[Picture]:
    """Show where a reconstruction departs from the truth."""
    surface, surface_weight = to_frame(comparison.height_error_mm, np.isfinite(comparison.height_error_mm), frame)
    ridge, ridge_weight = to_frame(comparison.ridge_error_um, comparison.band, frame)
    return [
        _picture(
            f"Surface error, {result.preset}",
            on_paper(colour(surface, -0.5, 0.5, diverging=True), surface_weight),
            "Measured minus true height, mean removed. Blue is too low, orange too high; white is right.",
            charts.colour_bar(-0.5, 0.5, "mm", diverging=True),
            frame.pitch_mm,
        ),
        _picture(
            f"Ridge error, {result.preset}",
            on_paper(colour(ridge, -50.0, 50.0, diverging=True), ridge_weight),
            "Measured minus true relief where the finger's slant is below 60 deg. Ridges that are seen here are ridges "
            "of the wrong height; white is right.",
            charts.colour_bar(-50.0, 50.0, "µm", diverging=True),
            frame.pitch_mm,
        ),
    ]


def close_up(relief_mm: FloatArray, result: Reconstruction, title: str, side_mm: float = 5.0) -> Picture:
    """Show a square of the relief in the middle of the finger, on one fixed scale so that squares can be compared."""
    frame = close_up_frame(result, side_mm)
    values, weight = to_frame(relief_mm, result.mask & np.isfinite(relief_mm), frame)
    mean = float(np.mean(values[weight > 0.5])) if bool((weight > 0.5).any()) else 0.0
    relief = 1000.0 * (values - np.float32(mean))
    return _picture(
        title,
        on_paper(colour(relief.astype(np.float32), -60.0, 40.0), weight),
        f"{side_mm:g} mm square in the middle of the finger.",
        charts.colour_bar(-60.0, 40.0, "µm"),
        frame.pitch_mm,
    )


def close_up_frame(result: Reconstruction, side_mm: float) -> Frame:
    """Upright square in the middle of the mask, one picture pixel for each input pixel."""
    whole = upright_frame(result, 10**6)
    side = max(8, round(side_mm / result.pitch_mm))
    shift = np.eye(3)
    shift[:2, 2] = (whole.size[1] - side) / 2, (whole.size[0] - side) / 2
    return Frame(whole.input_from_picture @ shift, (side, side), whole.pitch_mm)
