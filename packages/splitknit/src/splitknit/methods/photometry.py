"""From linear images to slopes and heights: what the thesis's cases and the `metric` method of
opaque things share."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from splitknit.errors import require
from splitknit.imaging.band import (
    CHANNELS,
    GREY_WEIGHTS,
    has_colour,
    linear_channels,
    linear_stack,
)
from splitknit.imaging.geometry import gradients_from_normals, smoothed
from splitknit.imaging.view import view_of
from splitknit.integration.frankot_chellappa import frankot_chellappa
from splitknit.integration.poisson import poisson
from splitknit.integration.shapelets import (
    REFERENCE_PX_PER_MM,
    ShapeletSettings,
    shapelet_response,
    shapelets,
)
from splitknit.methods.parameters import CLIPPED, LEAST_CERTAINTY, MAX_SLOPE, SLOW_MM
from splitknit.methods.photographs import FingerBand
from splitknit.model import Array, BoolArray, FloatArray
from splitknit.parameters import IN_MEMORY
from splitknit.photometric.lambertian import lambertian
from splitknit.photometric.robust import robust
from splitknit.presets import HeightSettings, NormalsSettings
from splitknit.skin.grid import Slopes
from splitknit.steps import let_go, step

IMPOSSIBLE = (
    "the integrated heights exceed what the slopes allow over the width of the surface; give a"
    " `mask` that ends inside the steep rim."
)
OPAQUE = "none (opaque material)"

linear_grey = step("light")(linear_stack)


def by_rows(
    photographs: FingerBand,
    solve: Callable[[FloatArray, slice], tuple[FloatArray, FloatArray]],
    *,
    without_clipped: bool = False,
) -> tuple[FloatArray, FloatArray]:
    """Normals and albedo by a method that works pixel by pixel on the linear images of some rows.

    `without_clipped`: a clipped value of an opaque thing becomes zero, which robust weights take
    for shadow. All rows at once, or strips of rows where the images take more than
    :data:`splitknit.parameters.IN_MEMORY`.
    """
    band, inside, encoding = photographs.band, photographs.inside, photographs.capture.encoding
    drop = (
        without_clipped
        and photographs.capture.material == "opaque"
        and band.crossed is None
        and not band.colours
    )
    rows, columns = photographs.finger.window
    height, width = inside.shape
    strip = max(1, IN_MEMORY // (4 * len(band.lights) * width))

    def light(window: tuple[slice, slice]) -> FloatArray:
        images = linear_grey(band, encoding, "grey", window)
        if drop:
            clips = int(CLIPPED * np.iinfo(band.pixels.dtype).max)
            for image, stored in zip(images, band.pixels, strict=True):
                image[(stored[window] >= clips).any(axis=-1)] = 0.0
                let_go(band.pixels)
        return images

    normals = np.zeros((height, width, 3), dtype=np.float32)
    albedo = np.full((height, width), np.nan, dtype=np.float32)
    for top in range(0, height, strip):
        part = slice(top, min(top + strip, height))
        if inside[part].any():
            here = slice(rows.start + part.start, rows.start + part.stop)
            normals[part], albedo[part] = solve(light((here, columns)), part)
    return normals, albedo


@step("normals")
def colour_albedo(photographs: FingerBand, albedo: FloatArray) -> FloatArray | None:
    """Albedo (h, w, 3) in red, green and blue, whose luma is the grey `albedo` (h, w); None of
    photographs without colour.

    Its colour is that of the photographs in which a pixel is no brighter than in their mean: there
    are highlights, which have the lamp's colour, in the others.
    """
    band = photographs.band
    if not has_colour(band):
        return None
    rows, columns = photographs.finger.window
    height, width = albedo.shape
    colour = np.zeros((height, width, 3), dtype=np.float32)
    # three channels, as many of what is dimmer than the mean, grey, and a byte of comparison
    strip = max(1, IN_MEMORY // (4 * 8 * len(band.lights) * width))
    for top in range(0, height, strip):
        part = slice(top, min(top + strip, height))
        here = slice(rows.start + part.start, rows.start + part.stop)
        light = linear_channels(
            band, photographs.capture.encoding, tuple(CHANNELS), (here, columns)
        )
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


@step("normals")
def slopes_of(normals: FloatArray, photographs: FingerBand) -> Slopes:
    """Slopes of normals of the rig's frame, in the frames of the pixels' rays."""
    view = view_of(photographs.capture.rig.camera, *photographs.finger.window, along_rays=True)
    own = np.moveaxis(view.turned(np.moveaxis(normals, -1, 0)[None])[0], 0, -1)
    return gradients_from_normals(own, photographs.inside, MAX_SLOPE)


@step("surface")
def integrated(slopes: Slopes, photographs: FingerBand, p: HeightSettings) -> FloatArray:
    """(h, w) heights in mm of slopes: masked least squares, or Frankot-Chellappa."""
    if p.method == "frankot_chellappa":
        return frankot_chellappa(*slopes, photographs.inside) * photographs.pitch_mm
    inside = photographs.inside
    # 1 / variance of a slope, of a normal's noise
    certainty = 1.0 / np.square(1.0 + slopes[0] ** 2 + slopes[1] ** 2)
    height = poisson(*slopes, inside, np.maximum(certainty, LEAST_CERTAINTY))
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
    """Gain of the shapelets by frequency; beyond their finest scale it stays, so that a crossover
    keeps all detail."""
    bank = _bank(photographs, p)
    return lambda omega: shapelet_response(np.minimum(omega, np.sqrt(2.0) / bank.sigma_px), bank)


def _bank(photographs: FingerBand, p: ShapeletSettings) -> ShapeletSettings:
    """The shapelets at the photographs' scale; the thesis gives them in its own pixels."""
    return replace(p, sigma_px=p.sigma_px * (photographs.px_per_mm / REFERENCE_PX_PER_MM))
