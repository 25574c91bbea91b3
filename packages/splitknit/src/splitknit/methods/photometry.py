"""From linear images to slopes and heights: what the thesis's cases and the `metric` method of
opaque things share."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from splitknit.errors import require
from splitknit.imaging.geometry import gradients_from_normals, smoothed
from splitknit.imaging.pixels import GREY_WEIGHTS
from splitknit.imaging.view import view_of
from splitknit.integration.frankot_chellappa import frankot_chellappa
from splitknit.integration.poisson import piecewise, poisson
from splitknit.integration.shapelets import (
    REFERENCE_PX_PER_MM,
    ShapeletSettings,
    shapelet_response,
    shapelets,
)
from splitknit.methods.photographs import FingerBand
from splitknit.model import Array, BoolArray, FloatArray
from splitknit.observation.light import LIGHT_BYTES, Light
from splitknit.photometric.lambertian import lambertian
from splitknit.photometric.robust import robust
from splitknit.presets import HeightSettings, NormalsSettings
from splitknit.skin.grid import Slopes
from splitknit.steps import step

IMPOSSIBLE = (
    "the integrated heights exceed what the slopes allow over the width of the surface; give a"
    " `mask` that ends inside the steep rim."
)
OPAQUE = "none (opaque material)"


@step("light")
def grey_light(light: Light) -> FloatArray:
    """(L, h, w) linear grey images."""
    return light.grey


def by_rows(
    photographs: FingerBand,
    solve: Callable[[FloatArray, slice], tuple[FloatArray, FloatArray]],
    *,
    without_clipped: bool = False,
) -> tuple[FloatArray, FloatArray]:
    """Normals and albedo by a method that works pixel by pixel on the linear images of some rows.

    `without_clipped`: a clipped value of an opaque thing becomes zero, which robust weights take
    for shadow. All rows at once, or strips of rows where the images take more than
    :data:`splitknit.observation.light.LIGHT_BYTES`.
    """
    light, inside = photographs.light, photographs.inside
    opaque = photographs.material == "opaque" and light.crossed is None and not light.colours
    normals = np.zeros((*inside.shape, 3), dtype=np.float32)
    albedo = np.full(inside.shape, np.nan, dtype=np.float32)
    for part, strip in strips(light, channels=1):
        if inside[part].any():
            images = grey_light(strip)
            if without_clipped and opaque:
                images[strip.clipped] = 0.0
            normals[part], albedo[part] = solve(images, part)
    return normals, albedo


def strips(light: Light, channels: int) -> Iterator[tuple[slice, Light]]:
    """Strips of a window: slices of rows and their light, sized so that `channels` channels fit
    into memory."""
    rows, columns = light.window
    height, width = light.shape
    count = max(1, LIGHT_BYTES // (4 * channels * len(light.lights) * width))
    for top in range(0, height, count):
        part = slice(top, min(top + count, height))
        yield part, light.at(1, (slice(rows.start + part.start, rows.start + part.stop), columns))


@step("normals")
def colour_albedo(photographs: FingerBand, albedo: FloatArray) -> FloatArray | None:
    """Albedo (h, w, 3) in red, green and blue, whose luma is the grey `albedo` (h, w); None of
    photographs without colour.

    The colour of a pixel is taken from the photographs in which it is no brighter than on average;
    highlights, which have the lamp's colour, are in the others.
    """
    if not photographs.light.has_colour:
        return None
    colour = np.zeros((*albedo.shape, 3), dtype=np.float32)
    # three channels, as many of what is dimmer than the mean, grey, and a byte of comparison
    for part, strip in strips(photographs.light, channels=8):
        light = strip.stack
        grey = np.tensordot(GREY_WEIGHTS, light, axes=1)
        mean = (light * (grey <= grey.mean(axis=0))).sum(axis=1)
        gain = albedo[part] / np.maximum(np.tensordot(GREY_WEIGHTS, mean, axes=1), 1e-12)
        colour[part] = np.moveaxis(np.maximum(mean * gain, 0.0), 0, -1)
    return np.nan_to_num(colour, copy=False)


@step("normals")
def distant_normals(
    images: FloatArray, lights: Array, inside: BoolArray, p: NormalsSettings
) -> tuple[FloatArray, FloatArray]:
    """Normals (h, w, 3) and albedo by photometric stereo under distant lights (L, 3)."""
    if p.method == "robust":
        return robust(images, lights, inside)
    return lambertian(images, lights, inside)


MAX_SLOPE = 6.0  # steeper slopes are shortened to this


@step("normals")
def slopes_of(normals: FloatArray, photographs: FingerBand) -> Slopes:
    """Slopes of normals of the rig's frame, in the frames of the pixels' rays."""
    view = view_of(photographs.rig.camera, *photographs.finger.window, along_rays=True)
    own = np.moveaxis(view.turned(np.moveaxis(normals, -1, 0)[None])[0], 0, -1)
    return gradients_from_normals(own, photographs.inside, MAX_SLOPE)


_LEAST_CERTAINTY = 0.003
"""Certainty of slopes beyond 4 (76 deg), which shadows and the longest slope bend more than noise
does. The coins have the same heights over the whole range; the balls 1.62 um at 0.01, 1.48 at
0.003, 1.36 at 0.001, where the integration takes four times as long as at 0.01. Chosen on:
simulated objects (coins with rims of 60 to 89 deg; then photographed balls in a gel). Range: 0.0001
to 0.01."""


@step("surface")
def integrated(slopes: Slopes, photographs: FingerBand, p: HeightSettings) -> FloatArray:
    """(h, w) heights in mm of slopes: masked least squares, one that keeps steps, or
    Frankot-Chellappa."""
    if p.method == "frankot_chellappa":
        return frankot_chellappa(*slopes, photographs.inside) * photographs.pitch_mm
    inside = photographs.inside
    if p.method == "piecewise":
        height = piecewise(*slopes, inside)
    else:
        # 1 / variance of a slope, of a normal's noise
        certainty = 1.0 / np.square(1.0 + slopes[0] ** 2 + slopes[1] ** 2)
        height = poisson(*slopes, inside, np.maximum(certainty, _LEAST_CERTAINTY))
    steepest = float(np.hypot(*slopes).max())
    depth, across = (
        np.nanmax(height) - np.nanmin(height),
        sum(inside.any(axis=k).sum() for k in (0, 1)),
    )
    require(depth <= max(steepest * across, 1.0), IMPOSSIBLE)
    return height * photographs.pitch_mm


@step("surface")
def ridge_relief(slopes: Slopes, photographs: FingerBand, p: ShapeletSettings) -> FloatArray:
    """(h, w) relief in mm that a bank of shapelets extracts from slopes (thesis, section
    3.3.1.3)."""
    return shapelets(*slopes, photographs.inside, _bank(photographs, p)) * photographs.pitch_mm


SLOW_MM = 0.32
"""Standard deviation of the Gaussian that separates the relief of an unsplit surface: that of the
ridge band."""


@step("surface")
def fast_part(height_mm: FloatArray, photographs: FingerBand) -> FloatArray:
    """(h, w) relief in mm of a surface that is not split: its height less its slow part, for
    pictures and prints.

    The slow part is a Gaussian mean, taken twice: the second finds what the first missed at the
    outline and on curves.
    """
    sigma_px = SLOW_MM * photographs.px_per_mm
    rest = height_mm - smoothed(height_mm, photographs.inside, sigma_px)
    return rest - smoothed(rest, photographs.inside, sigma_px)


def ridge_response(photographs: FingerBand, p: ShapeletSettings) -> Callable[[Array], Any]:
    """Gain of the shapelets by frequency, held constant beyond their finest scale so that a
    crossover keeps all detail."""
    bank = _bank(photographs, p)
    return lambda omega: shapelet_response(np.minimum(omega, np.sqrt(2.0) / bank.sigma_px), bank)


def _bank(photographs: FingerBand, p: ShapeletSettings) -> ShapeletSettings:
    """The shapelets at the photographs' scale; the thesis gives them in its own pixels."""
    return replace(p, sigma_px=p.sigma_px * (photographs.px_per_mm / REFERENCE_PX_PER_MM))
