"""The pictures of the report, each with a caption that explains what is seen and what good looks
like."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from splitknit.finger.regions import erode
from splitknit.imaging.geometry import (
    bounding_box,
    height_gradients,
    local_mean,
    normals_from_gradients,
)
from splitknit.io.pictures import (
    ColourArray,
    PictureFrame,
    colour,
    fields_to_frame,
    normal_colours,
    on_paper,
    to_frame,
    upright_turn,
)
from splitknit.model import BoolArray, FloatArray
from splitknit.observation.films import picture_bytes
from splitknit.reconstruction import Comparison, Reconstruction
from splitknit.report.photos import Picture, captioned, colour_bar, is_finger
from splitknit.units import MILLIMETRES


@dataclass(frozen=True, slots=True, eq=False)
class _SmallFields:
    """A reconstruction's fields, averaged over a picture's pixels: what the pictures are drawn
    from."""

    frame: PictureFrame
    weight: FloatArray  # (h, w) in [0, 1], fraction of the pixel inside the mask
    height_mm: FloatArray
    ridge_mm: FloatArray
    shape_mm: FloatArray
    normals: FloatArray  # (h, w, 3)


def small_fields(result: Reconstruction, frame: PictureFrame) -> _SmallFields:
    """Bring a reconstruction onto a picture's frame, all fields at once."""
    fields = (result.height_mm, result.ridge_mm, result.shape_mm, result.normals)
    small, weight = fields_to_frame(fields, result.mask, frame)
    return _SmallFields(frame, weight, *small)


def _normals_picture(result: Reconstruction, small: _SmallFields) -> Picture:
    """Show the normals, turned with the finger."""
    turn = upright_turn(result.input_from_upright).astype(np.float32)
    level = np.einsum("ij,hwj->hwi", turn, small.normals[..., :2])
    upright = np.concatenate([level, small.normals[..., 2:]], axis=-1)
    details = "details as fine lines on top, and no blotches."
    up = "upwards"
    if is_finger(result):
        details = "the ridges as fine lines on top, and no blotches."
        up = "to the tip"
    return captioned(
        "Surface normals",
        on_paper(normal_colours(upright), small.weight),
        f"Direction of the surface: red grows to the right, green {up}, blue towards the camera. "
        f"Good: colours change smoothly, with {details}",
        small.frame.pitch_mm,
    )


def _field_picture(  # noqa: PLR0917
    title: str,
    field: tuple[FloatArray, FloatArray],
    limits: tuple[float, float],
    unit: str,
    caption: str,
    pitch_mm: float,
    *,
    diverging: bool = False,
) -> Picture:
    """A field (h, w) with its weight in the colours of a scale between `limits`."""
    values, weight = field
    legend = colour_bar(*limits, unit, diverging=diverging)
    return captioned(
        title,
        on_paper(colour(values, *limits, diverging=diverging), weight),
        caption,
        pitch_mm,
        legend,
    )


def _relief_picture(result: Reconstruction, small: _SmallFields) -> Picture:
    """Show the ridges and valleys in micrometres, or in pixels where the scale is unknown."""
    weight = small.weight
    caption = (
        "Height of the ridges above their surroundings, without the shape of the finger. Yellow is"
        " high. Good: even, unbroken ridges from edge to edge, some 40 to 100 µm from valley to"
        " top."
    )
    if not is_finger(result):
        caption = (
            "Height of fine details above their surroundings, without the shape; the rim is left"
            " out. Yellow is high."
        )
        weight = _without_rim(weight > 0) * weight
    low_mm, high_mm = relief_limits(result)
    name, per_mm = result.unit.fitting(high_mm - low_mm)
    limits = per_mm * low_mm, per_mm * high_mm
    relief = per_mm * small.ridge_mm, weight
    return _field_picture("Relief", relief, limits, name, caption, small.frame.pitch_mm)


_DETAIL = 1 / 20
"""Standard deviation of the Gaussian that separates an object's details from its shape, over the
square root of its area: 1 mm on a coin of 20 mm, 10 mm on a stone of 200 mm."""


def _detail_px(mask: BoolArray) -> float:
    return _DETAIL * float(np.sqrt(np.count_nonzero(mask)))


def details_of_object(result: Reconstruction) -> Reconstruction:
    """The result with the relief that an object's page shows: heights less their Gaussian mean,
    whose width follows the object's size (`_DETAIL`)."""
    sigma_px = _detail_px(result.mask)
    known = result.mask & np.isfinite(result.height_mm)
    height_mm = np.where(known, result.height_mm, 0.0).astype(np.float32)
    mean_mm, _ = local_mean(height_mm, known, sigma_px)
    shape_mm = np.where(known, mean_mm, np.nan).astype(np.float32)
    return replace(result, shape_mm=shape_mm, ridge_mm=result.height_mm - shape_mm)


def _without_rim(inside: BoolArray) -> BoolArray:
    """An object's mask without its rim, where steep sides distort the separation of details and
    shape; the whole mask if nothing else is left."""
    inner = erode(inside, _detail_px(inside))
    return inner if inner.any() else inside


def relief_limits(result: Reconstruction) -> tuple[float, float]:
    """Limits of the colour scale of the relief in mm, rounded to two digits, from where the surface
    faces the camera."""
    facing = facing_relief_mm(result)
    relief = (facing if facing.size else result.ridge_mm[result.mask])[::3]
    low, high = np.nanpercentile(relief, (3.0, 98.0))
    margin = 0.1 * (high - low) + 1e-6
    return float(f"{low - margin:.2g}"), float(f"{high + margin:.2g}")


def facing_relief_mm(result: Reconstruction) -> FloatArray:
    """The relief (N,) where it is known and the surface faces the camera, in the order of the rows;
    of an opaque thing without its rim."""
    box = bounding_box(result.mask)
    relief = result.ridge_mm[box]
    inside = result.mask[box]
    if not is_finger(result):
        inside = _without_rim(np.pad(inside, 1))[1:-1, 1:-1]
    facing = inside & (result.normals[box][..., 2] > np.cos(np.pi / 4)) & np.isfinite(relief)
    return np.asarray(relief[facing])


def _shape_picture(result: Reconstruction, small: _SmallFields) -> Picture:
    """Show the finger without ridges, with contour lines."""
    unit = result.unit
    values = unit.heights(small.shape_mm)
    weight = small.weight
    top = float(np.percentile(values[weight > 0.5], 99.9))
    depth = values - top
    low = float(np.percentile(depth[weight > 0.5], 0.5))
    tens = 10.0 ** float(np.floor(np.log10(max(-low, 1e-6))))
    step = tens / 2 if -low > 3 * tens else tens / 5 if -low > 1.5 * tens else tens / 10
    picture = colour(depth, low, 0.0)
    level = np.floor(depth / step).astype(np.float32)
    line = cv2.morphologyEx(level, cv2.MORPH_GRADIENT, np.ones((2, 2), np.uint8)) > 0
    picture[line & (weight > 0.9)] = (20, 20, 20)
    return captioned(
        "Shape",
        on_paper(picture, weight),
        (
            "Height of the finger without its ridges, below its highest point; a line every"
            f" {step:g} {unit.name}. Good: smooth, rounded contours that close towards the tip,"
            " with no dents and no waves at the edge."
            if is_finger(result)
            else (
                f"Height without fine details, below the highest point; a line every {step:g}"
                f" {unit.name}."
            )
        ),
        small.frame.pitch_mm,
        colour_bar(round(low, 1), 0.0, unit.name),
    )


def _uncertainty_picture(result: Reconstruction, small: _SmallFields) -> Picture | None:
    """Show the standard deviation of the relief, if the pipeline gives one."""
    if result.uncertainty_um is None:
        return None
    known = result.mask & np.isfinite(result.uncertainty_um)
    if not known.any():
        return None
    title = "Uncertainty of the relief"
    caption = (
        "Skin blurs what light shows of the ridges, and specular reflection covers it; both are"
        " undone as far as simulated skin teaches it. This is the standard deviation (one sigma) of"
        " what is left. Good: small against the relief."
    )
    if not is_finger(result):
        title = "Uncertainty of the heights"
        caption = (
            "Standard deviation (one sigma) of the heights, as far as it is known. Good: small"
            " against them."
        )
    elif result.facts.get("heights") == "measured":
        caption = (
            "Ridges are measured by what the skin's surface reflects, which shows least where the"
            " finger turns away. This is the standard deviation (one sigma) of their height. Good:"
            " small against the relief."
        )
    optics = result.facts.get("optics", {})
    if optics.get("relief_by") == "network" and "gain_uncertainty" in optics:
        caption += (
            " It includes a common factor of all heights, whose standard deviation is"
            f" {100 * optics['gain_uncertainty']:.0f} %."
        )
    values, weight = to_frame(result.uncertainty_um, known, small.frame)
    high = float(np.percentile(values[weight > 0.5], 98))
    picture = on_paper(colour(values, 0.0, high), weight)
    name, per_mm = MILLIMETRES.fitting(high / 1000)
    legend = colour_bar(0.0, float(f"{per_mm * high / 1000:.2g}"), name)
    return captioned(title, picture, caption, small.frame.pitch_mm, legend)


def _specular_picture(result: Reconstruction, small: _SmallFields) -> Picture | None:
    """Show what the surface reflects, of a polarised capture."""
    if result.specular is None:
        return None
    values, weight = to_frame(
        result.specular, result.mask & np.isfinite(result.specular), small.frame
    )
    return captioned(
        "Specular image",
        on_paper(picture_bytes(values)[..., None].repeat(3, axis=2), weight),
        "What the surface itself reflects, under all lights: the parallel less the crossed images,"
        " of even brightness. Bright flanks face half-way between camera and lights. Good: sharp,"
        " unbroken ridges, pores as dots.",
        small.frame.pitch_mm,
    )


MISFIT = 0.5
"""Highest value of the colour scale of the misfit."""


def _misfit_picture(result: Reconstruction, small: _SmallFields) -> Picture | None:
    """Show where photographs contradict given normals."""
    if result.misfit is None:
        return None
    field = to_frame(result.misfit, result.mask & np.isfinite(result.misfit), small.frame)
    caption = (
        "Part of the photographs' light that no matt surface with the given normals explains, rms"
        " over rms. Yellow is much. Good: blue; gloss and shadows are yellow too."
    )
    limits = 0.0, MISFIT
    return _field_picture(
        "Misfit of the normal map", field, limits, "", caption, small.frame.pitch_mm
    )


FIELD_PICTURES = (
    _specular_picture,
    _normals_picture,
    _relief_picture,
    _shape_picture,
    _uncertainty_picture,
    _misfit_picture,
)
"""Each draws a picture of a result and its small fields, or None where the result has no such
field."""


def view_from_above(small: _SmallFields) -> ColourArray:
    """The shaded surface as the camera sees it, upright."""
    covered = small.weight[..., None]
    picture = _shade(small) * covered + 0.965 * (1.0 - covered)
    return np.round(np.clip(picture, 0.0, 1.0) * 255).astype(np.uint8)


def picture_from_above(view: ColourArray, pitch_mm: float, finger: bool) -> Picture:
    """Show the surface of :func:`view_from_above`; `pitch_mm` is the size of a pixel."""
    good = "Good: rounded like a finger, ridges even from edge to edge, no bumps or waves."
    if not finger:
        good = "Good: no bumps or waves that the object does not have."
    return captioned(
        "From above", view, f"Measured surface, lit from the upper left. {good}", pitch_mm
    )


def print_picture(prints: NDArray[np.uint8]) -> Picture:
    """Show the print, cut to the finger."""
    dark = prints < 250
    if dark.any():
        prints = prints[bounding_box(dark, 8)]
    caption = (
        "The relief as ink on paper: ridges dark, mirrored against the camera image, 500 pixels an"
        " inch. "
    )
    caption += "Good: dark, separate ridges with clear endings and forks up to the edge."
    return captioned("Print", prints, caption, 25.4 / 500)


def error_pictures(
    results: Sequence[Reconstruction], comparisons: Sequence[Comparison], frame: PictureFrame
) -> list[Picture]:
    """Maps of the errors."""
    signed = partial(_field_picture, pitch_mm=frame.pitch_mm, diverging=True)
    errors = []
    for result, comparison in zip(results, comparisons, strict=True):
        surface_mm = comparison.height_error_mm
        errors.append(
            signed(
                f"Surface error, {result.preset}",
                to_frame(surface_mm, np.isfinite(surface_mm), frame),
                (-0.5, 0.5),
                "mm",
                "Measured minus true height, mean removed. Blue is too low, orange too high; white"
                " is right.",
            )
        )
        errors.append(
            signed(
                f"Ridge error, {result.preset}",
                to_frame(comparison.ridge_error_um, comparison.band, frame),
                (-50.0, 50.0),
                "µm",
                "Measured minus true relief where the finger's slant is below 60 deg. Ridges that"
                " are seen here are ridges of the wrong height; white is right.",
            )
        )
    return errors


def _shade(surface: _SmallFields) -> FloatArray:
    """Light a height field like matt clay, (H, W, 3) float32 in [0, 1], for display; valleys are
    slightly darker."""
    clay = np.array((0.90, 0.80, 0.70), dtype=np.float32)  # red, green, blue
    towards_key = _unit((-0.55, 0.55, 0.63))
    inside = surface.weight > 0.5
    known = np.where(inside, surface.height_mm, np.nan)
    normals = normals_from_gradients(*height_gradients(known, surface.frame.pitch_mm))
    key = np.clip(normals @ towards_key, 0.0, 1.0)
    fill = np.clip(normals @ _unit((0.70, -0.15, 0.70)), 0.0, 1.0)
    halfway = _unit(towards_key + np.array((0.0, 0.0, 1.0)))  # between the light and the view
    gloss = np.clip(normals @ halfway, 0.0, 1.0) ** 24
    deviation = (
        float(np.sqrt(np.mean(np.square(surface.ridge_mm[inside])))) if inside.any() else 0.0
    )
    depth = np.clip(surface.ridge_mm / max(2.0 * deviation, 1e-6), -1.0, 1.0)
    light = (0.10 + 0.74 * key + 0.20 * fill) * (1.0 + 0.14 * depth)
    shaded = light[..., None] * clay + 0.10 * gloss[..., None]
    return np.asarray(np.clip(shaded, 0.0, 1.0) ** 0.8, dtype=np.float32)


def _unit(direction: ArrayLike) -> FloatArray:
    vector = np.asarray(direction, dtype=np.float32)
    return vector / np.linalg.norm(vector)
