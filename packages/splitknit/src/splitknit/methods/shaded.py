"""The surface of an opaque thing whose shading was calibrated on balls: slopes follow from a table, not from lights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from splitknit.errors import require
from splitknit.finger.locate import Finger
from splitknit.finger.orientation import as_it_lies
from splitknit.imaging.geometry import wide_blur
from splitknit.integration.poisson import trusted_height
from splitknit.methods.photographs import FingerPhotographs, FingerSurface
from splitknit.methods.photometry import OPAQUE, SLOW_MM, linear_grey
from splitknit.model import BoolArray, Capture, FloatArray, coarse_grid
from splitknit.photometric.shading import (
    BETWEEN,
    Shading,
    flat_of_fall_off,
    place_polynomials,
    place_terms,
    read_shading,
    shading_slopes,
)
from splitknit.presets import PipelineSettings
from splitknit.steps import step

FEW_EXTRAPOLATED = 0.001
"""Fraction of a surface steeper than what was calibrated, above which that is noted."""


def shaded_surface(photographs: FingerPhotographs, settings: PipelineSettings) -> FingerSurface:
    """Slopes by the shading that the capture names, then their integral, weighted by the inverse of their variance.

    `settings.height.level` alone varies it. The result's uncertainty is the standard deviation of a height against its
    surroundings, over about the diameter of a ball.
    """
    shading, inside = photographs.shading, photographs.finger.mask
    assert shading is not None
    images = linear_grey(photographs.bands[0], photographs.capture.encoding, "grey")
    gradient, deviation = _slopes(shading, images)
    albedo = images.mean(axis=0)
    del images  # nobody else holds these large arrays
    if not inside.all():
        gradient *= inside
    height_mm = _trusted_height(gradient, deviation, inside) * np.float32(shading.pitch_mm)
    level = _bend(height_mm, gradient, inside, settings.height.level)
    height_mm -= level
    relief = _fast_part(height_mm, inside, SLOW_MM / shading.pitch_mm)
    deviation *= np.float32(1000.0 * shading.height_mm_per_slope)
    facts, notes = _steeper_than_calibrated(gradient, shading, inside)
    bend = level[inside]
    if settings.height.level > 0:
        facts |= {"level_order": settings.height.level, "level_removed_um": 1000.0 * float(np.ptp(bend))}
    if settings.height.level > 0 and not bend.any():
        notes = (*notes, "less than a twentieth of the surface is flat, so that no bend of the field was removed.")
    return FingerSurface(
        height_mm, relief, height_mm - relief, albedo,
        uncertainty_um=deviation, whole=True, facts=facts, warnings=notes,
    )  # fmt: skip


def everything_in_view(capture: Capture, settings: PipelineSettings) -> FingerPhotographs:
    """The photographs of a capture that names a shading: nothing is looked for in them, and the calibration has the
    scale. Raises BadInput if the material, the settings or the mask do not go with a shading."""
    opaque = settings.method == "metric" and capture.material == "opaque" and settings.shape.source != "mirror"
    require(opaque, "a calibrated shading goes with the preset metric and opaque things alone.")
    assert capture.shading is not None
    shading = read_shading(capture.shading)
    inside = np.ones(capture.shape, dtype=bool) if capture.mask is None else capture.mask
    require(bool(inside.any()), "the mask is empty; it must be white where the object is.")
    finger = Finger(inside, inside, np.s_[:, :], as_it_lies(inside), {}, {}, ())
    camera = replace(capture.rig.camera, px_per_mm=1.0 / shading.pitch_mm, scale_known=True)
    band, kind = capture.bands["white"], shading.facts.get("flat")
    if band.flat is None and kind == BETWEEN:
        light = flat_of_fall_off(shading.fall_off, shading.image_size)
        code = np.stack([coarse_grid(image) for image in light / light.max()])
        linear = "the calibration divides by the light between its balls, which goes with linear photographs."
        require(capture.encoding == "linear", linear)
        band = replace(band, flat=np.rint(65535.0 * code).astype(np.uint16))
    lacks = "the shading was calibrated over photographs of the flat gel, without which slopes lean from edge to edge"
    require(band.flat is not None or kind != "photographs", f"{lacks}: name their folder with `flat`.")
    bands = {**capture.bands, "white": band}
    capture = replace(capture, rig=replace(capture.rig, camera=camera), bands=bands)
    return FingerPhotographs(capture, finger, (band,), shading=shading)


_FLAT_SLOPE = 0.1
"""Slope up to which a place is of the flat part; with 0.05, and with all places, the bend is the same to 0.1 um."""
_LEVELLED = 20_000


@step("surface")
def _bend(height_mm: FloatArray, gradient: FloatArray, inside: BoolArray, order: int) -> FloatArray:
    """(H, W) slow bend of the field, which a sensor cannot know: a polynomial of the place fitted robustly to what is
    flat; zeros for the order 0, or where less than a twentieth is flat.

    Source: ISO 25178-2, F-operator (removal of form).
    """
    flat = inside & (gradient[0] ** 2 + gradient[1] ** 2 < np.float32(_FLAT_SLOPE**2))
    if order == 0 or flat.sum() < 0.05 * inside.sum():
        return np.zeros_like(height_mm)
    every = max(1, int(np.sqrt(flat.sum() / _LEVELLED)))  # a grid: one place more moves none of the others
    rows, columns = every * np.array(np.nonzero(flat[::every, ::every]))
    count = (order + 1) * (order + 2) // 2
    terms = place_terms(height_mm.shape, columns, rows, count).astype(np.float64)
    values, weights = height_mm[rows, columns].astype(np.float64), np.ones(len(rows))
    for _ in range(20):
        weighted = terms * weights
        found = np.linalg.solve(weighted @ terms.T, weighted @ values)
        rest = values - found @ terms
        weights = 1.0 / (1.0 + (rest / max(3.0 * float(np.median(np.abs(rest))), 1e-9)) ** 2)
    return np.asarray(place_polynomials(found[None], height_mm.shape)[0])


def _steeper_than_calibrated(
    gradient: FloatArray, shading: Shading, inside: BoolArray
) -> tuple[dict[str, object], tuple[str, ...]]:
    """Facts for the result, and a warning where slopes are extrapolated."""
    extrapolated = float(np.mean((gradient[0] ** 2 + gradient[1] ** 2 > np.float32(shading.max_slope**2))[inside]))
    facts = {
        "slopes": "calibrated on balls",
        "separation": OPAQUE,
        "heights": "measured",
        "max_slope_calibrated": shading.max_slope,
        "extrapolated": extrapolated,
    }
    note = (
        f"{100 * extrapolated:.1f} % of the surface is steeper than the balls of the calibration showed (a slope of "
        f"{shading.max_slope:.2f}, {np.rad2deg(np.arctan(shading.max_slope)):.0f} deg): its slopes are extrapolated."
    )
    return facts, (note,) if extrapolated > FEW_EXTRAPOLATED else ()


_slopes = step("normals")(shading_slopes)


@step("surface")
def _trusted_height(gradient: FloatArray, deviation: FloatArray, inside: BoolArray) -> FloatArray:
    """(H, W) height in pixels, slopes weighted by the inverse of their variance."""
    trust = (deviation.min() / deviation) ** 2
    if not inside.all():
        trust *= inside
    return trusted_height(gradient[0], gradient[1], trust)


@step("surface")
def _fast_part(height: FloatArray, inside: BoolArray, sigma_px: float) -> FloatArray:
    """:func:`fast_part` for large fields: means on a coarser copy."""
    share = np.maximum(wide_blur(inside.astype(np.float32), sigma_px), np.float32(1e-6))
    rest: FloatArray = height * inside
    for _ in range(2):
        rest -= wide_blur(rest, sigma_px) / share
        rest *= inside
    return rest
