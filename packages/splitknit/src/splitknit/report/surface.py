"""A result's surface in the upright frame: sections between two points of it, and the surface
inside a page.

Places are those of ``phalange.ply``: x right, y to the fingertip, z to the camera. All lengths are
in mm.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.imaging.geometry import bounding_box, local_mean, sampled_at
from splitknit.io.images import png_bytes
from splitknit.io.pictures import data_uri, upright_places, upright_turn
from splitknit.model import Array, BoolArray, FloatArray
from splitknit.reconstruction import Reconstruction
from splitknit.report import template
from splitknit.report.photos import round_step
from splitknit.units import MILLIMETRES, LengthUnit


@dataclass(frozen=True, slots=True, eq=False)
class ResultSurface:
    """A result cropped to its mask; fields are (h, w), NaN outside the mask."""

    x_mm: FloatArray
    y_mm: FloatArray
    height_mm: FloatArray
    ridge_mm: FloatArray
    pitch_mm: float
    turn: Array
    """(2, 2): from (x, y) of the rig's frame to the upright one."""
    corner_mm: Array
    """(2,) x and y of the first pixel if the camera's rays were parallel."""
    unit: LengthUnit = MILLIMETRES
    origin_px: tuple[int, int] = (0, 0)
    """Column and row of the first pixel in the input."""
    factor_sd: float | None = None
    """Standard deviation of the factor that all heights share; None where it is not known."""

    def places_mm(self, input_px: Array) -> Array:
        """(2, N) x and y of places (N, 2), columns and rows of the input; NaN beside the
        surface."""
        place = np.asarray(input_px, dtype=np.float64).T - np.array(self.origin_px)[:, None]
        return np.stack([sample(self.x_mm, place), sample(self.y_mm, place)])

    def locate(self, x_mm: Array, y_mm: Array) -> Array:
        """Column and row (2, ...) where the surface has these x and y; iterated where the rays
        spread."""
        wanted = np.stack([x_mm, y_mm])
        corner = self.corner_mm.reshape(2, *(1,) * x_mm.ndim)
        place = self._steps(wanted - corner)
        for _ in range(4):
            reached = np.stack([sample(self.x_mm, place), sample(self.y_mm, place)])
            place = place + self._steps(np.nan_to_num(wanted - reached))
        return place

    def _steps(self, vectors_mm: Array) -> Array:
        """Columns and rows (2, ...) of x and y (2, ...)."""
        right, up = np.tensordot(self.turn.T, vectors_mm, axes=1) / self.pitch_mm
        return np.stack([right, -up])


@dataclass(frozen=True, slots=True, eq=False)
class Section:
    """A cut through the surface between two points, and its figures."""

    along_mm: Array  # (N,) distance in the finger plane from the first point
    x_mm: Array
    y_mm: Array
    height_mm: Array  # (N,), NaN where there is no surface
    figures: dict[str, Any]
    """``flat_mm``, ``height_difference_mm`` between the ends, ``height_range_mm`` from lowest to
    highest, its standard deviation ``height_range_sd_mm`` (None: unknown), and ``steep_mm``: how
    much of `flat_mm` is steeper than `STEEP`, where the range is a lower limit."""


def surface_in(result: Reconstruction) -> ResultSurface:
    """The surface of a result; BadInput if it holds no height."""
    known = result.mask & np.isfinite(result.height_mm)
    require(known.any(), "the result holds no heights; reconstruct the capture again.")
    surface = upright_surface(
        (result.height_mm, result.ridge_mm),
        known,
        result.pitch_mm,
        result.input_from_upright,
        xy_mm=None if result.x_mm is None or result.y_mm is None else (result.x_mm, result.y_mm),
        unit=result.unit,
    )
    return replace(surface, factor_sd=result.facts.get("height_factor_sd"))


def upright_surface(
    heights_mm: tuple[FloatArray, FloatArray],
    known: BoolArray,
    pitch_mm: float,
    input_from_upright: Array,
    *,
    xy_mm: tuple[FloatArray, FloatArray] | None,
    unit: LengthUnit = MILLIMETRES,
) -> ResultSurface:
    """The surface of fields (H, W) on a camera's pixel grid: heights and relief; x and y of a
    perspective camera."""
    box = bounding_box(known)
    grid = known.shape, pitch_mm, input_from_upright
    x, y = upright_places(*grid, box, xy_mm)
    first = (slice(box[0].start, box[0].start + 1), slice(box[1].start, box[1].start + 1))

    def masked(field: NDArray[Any]) -> FloatArray:
        return np.where(known[box], field, np.nan).astype(np.float32)

    return ResultSurface(
        masked(x),
        masked(y),
        masked(heights_mm[0][box]),
        masked(np.nan_to_num(heights_mm[1][box])),
        pitch_mm,
        upright_turn(input_from_upright),
        np.ravel(upright_places(*grid, first, None)),
        unit,
        (box[1].start, box[0].start),
    )


def section(
    surface: ResultSurface, start_mm: tuple[float, float], end_mm: tuple[float, float]
) -> Section:
    """Cut the surface between two points given by x and y. Raises BadInput if the points are not
    finite, far away, equal, or neither lies on the surface.
    """
    ends = np.array([start_mm, end_mm], dtype=np.float64)
    require(
        np.isfinite(ends).all() and float(np.abs(ends).max()) <= 40_000,
        "the two points must be finite and on the surface.",
    )
    flat_mm = float(np.hypot(*(ends[1] - ends[0])))
    require(flat_mm >= surface.pitch_mm, "the two points are the same; choose two that are apart.")
    count = int(min(20_000, max(2.0, np.ceil(flat_mm / surface.pitch_mm)))) + 1
    fraction = np.linspace(0.0, 1.0, count)
    x, y = ends[0][:, None] + fraction * (ends[1] - ends[0])[:, None]
    place = surface.locate(x, y)
    height = sample(surface.height_mm, place)
    require(
        np.isfinite(height).any(),
        "no surface lies between the two points; choose points on the surface.",
    )
    rise = float(height[-1] - height[0])
    extent = float(np.nanmax(height) - np.nanmin(height))
    step_mm = flat_mm / (count - 1)
    figures = {
        "flat_mm": flat_mm,
        "height_difference_mm": None if np.isnan(rise) else rise,
        "height_range_mm": extent,
        "height_range_sd_mm": None if surface.factor_sd is None else surface.factor_sd * extent,
        "steep_mm": step_mm * float(np.sum(np.abs(np.diff(height)) > STEEP * step_mm)),
    }
    return Section(fraction * flat_mm, x, y, height, figures)


STEEP = 2.7
"""Slope (70 deg) above which a wall's height is a lower limit: such walls lie in the shadow of most
lights. Source: rendered walls 3.17 mm high under 6 to 12 lights, of which 2 to 3 % are lost at
76 deg, 16 % at 83 deg, and half where they are vertical."""


def section_svg(cut: Section) -> str:
    """A section as a chart: heights above the lowest, over the distance."""
    name, per_mm = MILLIMETRES.fitting(cut.figures["height_range_mm"])
    heights = per_mm * (cut.height_mm - np.nanmin(cut.height_mm))
    chart: str = template("section.svg").render(
        points=np.column_stack([cut.along_mm, heights]).round(4).tolist(),
        columns=ticks(cut.along_mm[-1]),
        rows=ticks(max(heights.max(), 1e-6)),
        unit=name,
    )
    return chart


def ticks(end: float) -> list[float]:
    """Round numbers from zero to `end`, at most ten, and `end`."""
    return [*np.arange(0.0, end, round_step(end / 4)).tolist(), float(end)]


def sample(field: FloatArray, place: Array) -> Array:
    """Bilinear values of `field` (h, w) at columns and rows (2, ...); NaN beyond its border."""
    column, row = place
    return sampled_at(field, column, row, outside=np.nan).astype(np.float64)


# The surface inside a page: three fields on a regular grid, as pictures, drawn by
# `static/surface.js`.


@dataclass(frozen=True, slots=True, eq=False)
class PageSurface:
    """A surface as a page shows it."""

    title: str
    surface: ResultSurface
    albedo: FloatArray | None = None
    """(h, w) or (h, w, 3) relative, on the surface's grid."""
    minutiae: Array = field(default_factory=lambda: np.empty((0, 3)))
    """(N, 3): x and y in mm, and direction in rad, counter-clockwise from x."""


@dataclass(frozen=True, slots=True)
class Scene:
    """What a page needs to draw surfaces: data, scripts, and the hashes of these for the page's
    content security policy."""

    titles: Sequence[str]
    data: Markup
    scripts: Sequence[Markup]
    policy: str
    minutiae: bool


def scene(surfaces: Sequence[PageSurface]) -> Scene:
    """The 3D view of a page: one surface, or two in one frame to compare them."""
    scripts = _scripts()
    hashes = (base64.b64encode(hashlib.sha256(script.encode()).digest()) for script in scripts)
    data = json.dumps([_encoded(surface) for surface in surfaces], allow_nan=False)
    return Scene(
        titles=[surface.title for surface in surfaces],
        data=Markup(data.replace("<", "\\u003c")),  # ends no script element
        scripts=scripts,
        policy=" ".join(f"'sha256-{digest.decode()}'" for digest in hashes),
        minutiae=any(len(surface.minutiae) for surface in surfaces),
    )


def scene_of(result: Reconstruction, title: str) -> Scene:
    """One result, with its own brightness."""
    surface = surface_in(result)
    known = result.mask & np.isfinite(result.height_mm)
    albedo = result.albedo if result.colour is None else result.colour
    return scene([PageSurface(title, surface, albedo[bounding_box(known)])])


@cache
def _scripts() -> list[Markup]:
    """three.js, and what draws with it."""
    files = ("three/three.min.js", "surface.js")
    return [
        Markup((Path(__file__).parent / "static" / file).read_text(encoding="utf-8"))
        for file in files
    ]


_MOST_POINTS = 400_000
"""Points of a surface inside a page at most."""


def _encoded(page: PageSurface) -> dict[str, Any]:
    """Shape, relief and brightness on a regular grid of x and y."""
    surface = page.surface
    unit = surface.unit
    known = np.isfinite(surface.height_mm)
    thinning = max(1.0, float(np.sqrt(known.sum() / _MOST_POINTS)))
    pitch_mm = thinning * surface.pitch_mm
    left = float(np.nanmin(surface.x_mm))
    top = float(np.nanmax(surface.y_mm))
    columns = int((float(np.nanmax(surface.x_mm)) - left) / pitch_mm) + 1
    rows = int((top - float(np.nanmin(surface.y_mm))) / pitch_mm) + 1
    x, y = np.meshgrid(left + pitch_mm * np.arange(columns), top - pitch_mm * np.arange(rows))
    place = surface.locate(x, y)

    def gridded(field: FloatArray) -> Array:
        return sample(_averaged(field, known, thinning), place)

    return {
        "title": page.title,
        "rows": rows,
        "columns": columns,
        "left": left * unit.per_mm,
        "top": top * unit.per_mm,
        "pitch": pitch_mm * unit.per_mm,
        "unit": unit.name,
        "small": unit.small,
        "factor_sd": surface.factor_sd,
        "steep": STEEP,
        "shape": _in_16_bits(gridded(surface.height_mm - surface.ridge_mm) * unit.per_mm, 0.001),
        "ridge": _in_16_bits(gridded(surface.ridge_mm) * unit.per_mm, 0.0002),
        "brightness": None
        if page.albedo is None
        else _coded([gridded(part) for part in np.moveaxis(np.atleast_3d(page.albedo), -1, 0)]),
        "minutiae": np.round(page.minutiae, 4).tolist(),
    }


def _coded(albedo: Sequence[Array]) -> str:
    """Brightness for people, grey or red, green and blue, as JPEG; black where it is not known."""
    known = np.nan_to_num(np.dstack(albedo), posinf=0.0, neginf=0.0)
    brightest = max(float(np.percentile(known, 99.5)), 1e-6)
    fraction = np.clip(known / brightest, 0.0, 1.0)
    code = np.round(255 * fraction ** (1 / 2.2)).astype(np.uint8)
    return data_uri(code, photo=True).partition(",")[2]


def _averaged(field: FloatArray, known: BoolArray, side: float) -> FloatArray:
    """Mean of the field around every known pixel, over about `side` pixels; NaN elsewhere."""
    if side < 1.5:
        return field
    mean, _ = local_mean(np.where(known, field, np.float32(0.0)), known, side / np.sqrt(12))
    return np.where(known, mean, np.float32(np.nan))


def _in_16_bits(values: Array, step: float) -> dict[str, Any]:
    """A field as PNG: red and green are the high and low byte of its level, zero where it is not
    known."""
    known = np.isfinite(values)
    inside = values[known] if known.any() else np.zeros(1)
    low, high = float(inside.min()), float(inside.max())
    step = max(step, (high - low) / 65_000)
    level = np.where(known, np.round((np.nan_to_num(values) - low) / step) + 1, 0)
    level = level.astype(np.uint16)
    picture = np.dstack([level >> 8, level & 255, np.zeros_like(level)]).astype(np.uint8)
    # in an eighth of level 6's time, a quarter larger
    png = png_bytes(picture, cv2.IMWRITE_PNG_STRATEGY_RLE, cv2.IMWRITE_PNG_FILTER_UP)
    return {"png": base64.b64encode(png).decode(), "low": low, "step": step}
