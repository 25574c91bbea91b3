"""The pictures of the report, each with a caption that says what is seen and what good looks like."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit.apps import charts
from splitknit.apps.captioned import Picture, captioned
from splitknit.apps.compare import Comparison
from splitknit.apps.photo_figures import LONGEST_PX, mask_on_image, mean_image, titled
from splitknit.apps.pictures import (
    ColourArray,
    Frame,
    colour,
    normal_colours,
    on_paper,
    to_frame,
    upright_frame,
    upright_turn,
)
from splitknit.apps.shading import oblique_view, top_view, upright_surface
from splitknit.model import FloatArray, Reconstruction

__all__ = [
    "LONGEST_PX",
    "Picture",
    "Views",
    "close_up",
    "close_up_frame",
    "error_pictures",
    "mask_on_image",
    "mean_image",
    "normals_picture",
    "print_picture",
    "relief_limits_um",
    "relief_picture",
    "render_views",
    "shape_picture",
    "titled",
    "uncertainty_picture",
    "view_pictures",
]

RELIEF_EXAGGERATION = 2.0
TILT_DEG = 56.0


def normals_picture(result: Reconstruction, frame: Frame) -> Picture:
    """Show the normals, turned with the finger."""
    values, weight = to_frame(result.normals, result.mask, frame)
    turned = values.copy()
    turned[..., :2] = np.einsum("ij,hwj->hwi", upright_turn(result).astype(np.float32), values[..., :2])
    picture = on_paper(normal_colours(turned), weight)
    return captioned(
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
    return captioned(
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
    return captioned(
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
    return captioned(
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
        captioned(
            "From above",
            views.above,
            f"Measured surface, lit from the upper left. {stated} "
            "Good: rounded like a finger, ridges even from edge to edge, no bumps or waves.",
            pitch_mm=views.pitch_mm,
            photo=True,
        ),
        captioned("From the left", views.left, oblique, photo=True),
        captioned("From the right", views.right, oblique, photo=True),
    ]


def print_picture(prints: NDArray[np.uint8]) -> Picture:
    """Show the print, cut to the finger."""
    dark = prints < 250
    rows, columns = np.flatnonzero(dark.any(axis=1)), np.flatnonzero(dark.any(axis=0))
    if rows.size:
        prints = prints[max(0, rows[0] - 8) : rows[-1] + 9, max(0, columns[0] - 8) : columns[-1] + 9]
    return captioned(
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
        captioned(
            f"Surface error, {result.preset}",
            on_paper(colour(surface, -0.5, 0.5, diverging=True), surface_weight),
            "Measured minus true height, mean removed. Blue is too low, orange too high; white is right.",
            charts.colour_bar(-0.5, 0.5, "mm", diverging=True),
            frame.pitch_mm,
        ),
        captioned(
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
    return captioned(
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
