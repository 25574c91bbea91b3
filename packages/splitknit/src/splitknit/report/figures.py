"""The pictures of the report. What is seen on each, and what good looks like, stands in
``templates/words.html``."""

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
from splitknit.report.photos import Picture, captioned, colour_bar, is_finger, round_step
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
    picture = on_paper(normal_colours(upright), small.weight)
    return captioned("Surface normals", picture, pitch_mm=small.frame.pitch_mm)


def _field_picture(
    title: str,
    field: tuple[FloatArray, FloatArray],
    limits: tuple[float, float],
    unit: str,
    pitch_mm: float,
    *,
    diverging: bool = False,
) -> Picture:
    """A field (h, w) with its weight in the colours of a scale between `limits`."""
    values, weight = field
    legend = colour_bar(*limits, unit, diverging=diverging)
    picture = on_paper(colour(values, *limits, diverging=diverging), weight)
    return captioned(title, picture, pitch_mm=pitch_mm, legend=legend)


def _relief_picture(result: Reconstruction, small: _SmallFields) -> Picture:
    """Show the ridges and valleys in micrometres, or in pixels where the scale is unknown."""
    weight = small.weight
    if not is_finger(result):
        weight = _without_rim(weight > 0) * weight
    low_mm, high_mm = relief_limits(result)
    name, per_mm = result.unit.fitting(high_mm - low_mm)
    limits = per_mm * low_mm, per_mm * high_mm
    relief = per_mm * small.ridge_mm, weight
    return _field_picture("Relief", relief, limits, name, small.frame.pitch_mm)


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
    step = round_step(max(-low, 1e-6) / 6)
    picture = colour(depth, low, 0.0)
    level = np.floor(depth / step).astype(np.float32)
    line = cv2.morphologyEx(level, cv2.MORPH_GRADIENT, np.ones((2, 2), np.uint8)) > 0
    picture[line & (weight > 0.9)] = (20, 20, 20)
    return captioned(
        "Shape",
        on_paper(picture, weight),
        f"A line every {step:g} {unit.name}.",
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
    title = f"Uncertainty of the {'relief' if is_finger(result) else 'heights'}"
    deviation_mm, weight = to_frame(result.uncertainty_um / 1000, known, small.frame)
    high_mm = float(np.percentile(deviation_mm[weight > 0.5], 98))
    name, per_mm = MILLIMETRES.fitting(high_mm)
    field = per_mm * deviation_mm, weight
    limits = 0.0, float(f"{per_mm * high_mm:.2g}")
    return _field_picture(title, field, limits, name, small.frame.pitch_mm)


def _specular_picture(result: Reconstruction, small: _SmallFields) -> Picture | None:
    """Show what the surface reflects, of a polarised capture."""
    if result.specular is None:
        return None
    values, weight = to_frame(
        result.specular, result.mask & np.isfinite(result.specular), small.frame
    )
    return captioned(
        "Specular image",
        on_paper(picture_bytes(values)[..., None], weight),
        pitch_mm=small.frame.pitch_mm,
    )


MISFIT = 0.5
"""Highest value of the colour scale of the misfit."""


def _misfit_picture(result: Reconstruction, small: _SmallFields) -> Picture | None:
    """Show where photographs contradict given normals."""
    if result.misfit is None:
        return None
    field = to_frame(result.misfit, result.mask & np.isfinite(result.misfit), small.frame)
    limits = 0.0, MISFIT
    return _field_picture("Misfit of the normal map", field, limits, "", small.frame.pitch_mm)


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


def print_picture(prints: NDArray[np.uint8]) -> Picture:
    """Show the print, cut to the finger."""
    dark = prints < 250
    if dark.any():
        prints = prints[bounding_box(dark, 8)]
    return captioned("Print", prints, pitch_mm=25.4 / 500)


def error_pictures(
    results: Sequence[Reconstruction], comparisons: Sequence[Comparison], frame: PictureFrame
) -> list[Picture]:
    """Maps of the errors."""
    signed = partial(_field_picture, pitch_mm=frame.pitch_mm, diverging=True)
    errors = []
    for result, comparison in zip(results, comparisons, strict=True):
        surface_mm = comparison.height_error_mm
        surface = to_frame(surface_mm, np.isfinite(surface_mm), frame)
        ridges = to_frame(comparison.ridge_error_um, comparison.band, frame)
        errors += [
            signed(f"Surface error, {result.preset}", surface, (-0.5, 0.5), "mm"),
            signed(f"Ridge error, {result.preset}", ridges, (-50.0, 50.0), "µm"),
        ]
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
