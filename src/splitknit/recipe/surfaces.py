"""From images to a surface: the thesis's way, and ours for opaque things (for skin: :mod:`splitknit.recipe.skin`)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from splitknit.finger import clahe
from splitknit.imaging import Window, has_colour, linear_channels, linear_stack
from splitknit.imaging.geometry import gradients_from_normals
from splitknit.imaging.view import view_of
from splitknit.integration import ShapeletSettings, frankot_chellappa, poisson, shapelet_response, shapelets
from splitknit.integration.knit import add, crossover
from splitknit.model import Band, BoolArray, Capture, FloatArray, Rig
from splitknit.photometric import NearLightSettings, hanrahan_krueger, lambertian, near_light, robust
from splitknit.recipe.coloured import balanced
from splitknit.recipe.finger import Finger, finger_key
from splitknit.recipe.memory import Memory
from splitknit.recipe.presets import REFERENCE_PX_PER_MM, PipelineSettings
from splitknit.recipe.smooth import smoothed
from splitknit.recipe.stopwatch import Stopwatch
from splitknit.separation.direct import direct_light, direct_of_enhanced

NO_NIR = "there is no near-infrared band: the shape comes from the white band, in which {} bend it."


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceParts:
    """A surface in the finger's window, finite inside the mask."""

    height_mm: FloatArray
    ridge_mm: FloatArray
    shape_mm: FloatArray
    albedo: FloatArray
    uncertainty_um: FloatArray | None
    facts: Mapping[str, Any]
    warnings: tuple[str, ...]


def thesis(
    capture: Capture, finger: Finger, settings: PipelineSettings, watch: Stopwatch, memory: Memory
) -> SurfaceParts:
    """Cases EA, PR and SnK: distant lights, least squares, Frankot-Chellappa and shapelets.

    `memory` keeps the slopes, which cases with other shapelets or another way to knit share.

    References
    ----------
    The thesis, sections 3.3.1 to 3.3.3 and 5.4.
    """
    mask = finger.wider[finger.window]
    pitch = np.float32(capture.rig.camera.pitch_mm)
    white, nir, warnings = ridge_and_shape_bands(capture, settings)
    seen = *finger_key(settings), settings.normals
    split = "visible", *seen, settings.enhance, settings.direct
    gradients, albedo = memory(split, partial(_visible, capture, white, finger, settings, watch))
    with watch("surface"):
        ridge = shapelets(*gradients, mask, _bank(settings, capture)) * pitch
        if settings.knit.method == "none":
            height = _integrate(gradients, mask, settings) * pitch
            shape = height - ridge
        else:
            slopes = memory(("below", *seen, nir is white), partial(_below, capture, nir, finger, settings))
            shape = _integrate(slopes, mask, settings) * pitch
            height, ridge = _knitted(ridge, shape, gradients, mask, settings, capture)
        if settings.smooth.sigma_mm > 0:
            sigma_px = settings.smooth.sigma_mm * capture.rig.camera.px_per_mm
            height, ridge = smoothed(height, mask, sigma_px), smoothed(ridge, mask, sigma_px)
            shape = height - ridge
    return SurfaceParts(height, ridge, shape, albedo, None, facts_of(capture, settings, white, nir), warnings)


def _visible(
    capture: Capture, white: Band, finger: Finger, settings: PipelineSettings, watch: Stopwatch
) -> tuple[tuple[FloatArray, FloatArray], FloatArray]:
    """Slopes and albedo of the white band: enhanced, and of direct light alone, where the settings say so."""
    mask = finger.wider[finger.window]
    with watch("light"):
        visible = _grey(capture, white, finger.window)
        if settings.lights.balance and white.colours:
            visible = balanced(visible, capture.rig, white, finger.mask[finger.window])
        if settings.enhance.clahe:
            visible = _enhanced(visible, mask, capture, settings)
        if _draws_direct(capture, settings):
            visible = _direct(capture, white, finger.window, visible * mask, settings)
    with watch("normals"):
        normals, albedo = _distant_normals(visible, capture.rig.select(white.lights), mask, settings)
        return _slopes(normals, finger, capture, settings), albedo


def _below(capture: Capture, nir: Band, finger: Finger, settings: PipelineSettings) -> tuple[FloatArray, FloatArray]:
    """Slopes of the band of the shape."""
    invisible = _grey(capture, nir, finger.window)
    rig = capture.rig.select(nir.leds)
    below, _ = _distant_normals(invisible, rig, finger.wider[finger.window], settings)
    return _slopes(below, finger, capture, settings)


def metric_opaque(capture: Capture, finger: Finger, settings: PipelineSettings, watch: Stopwatch) -> SurfaceParts:
    """Near lights, robust weights, masked integration, crossover: for things that do not scatter light inside."""
    mask = finger.wider[finger.window]
    pitch = np.float32(capture.rig.camera.pitch_mm)
    white, nir, warnings = ridge_and_shape_bands(capture, settings)
    gradients, albedo = _iterated(capture, white, finger, settings, watch)
    with watch("surface"):
        visible = _integrate(gradients, mask, settings) * pitch
        ridge = shapelets(*gradients, mask, _bank(settings, capture)) * pitch
    height = visible
    if nir is not white:
        slopes, _ = _iterated(capture, nir, finger, settings, watch)
        with watch("surface"):
            below = _integrate(slopes, mask, settings) * pitch
            height = crossover(visible, below, _response(settings, capture), mask)
    facts = {**facts_of(capture, settings, white, nir), "separation": "none (opaque material)"}
    return SurfaceParts(height, ridge, height - ridge, albedo, None, facts, warnings)


def ridge_and_shape_bands(capture: Capture, settings: PipelineSettings) -> tuple[Band, Band, tuple[str, ...]]:
    """The band of the ridges and that of the shape."""
    white = capture.bands["white"]
    if settings.shape.source != "nir":
        return white, white, ()
    if settings.method == "thesis" and settings.knit.method == "none":
        return white, white, ()
    if "nir" not in capture.bands:
        skin = capture.material == "skin"
        return white, white, (NO_NIR.format("ridges, scattering and glare" if skin else "ridges and glare"),)
    return white, capture.bands["nir"], ()


def _direct(
    capture: Capture, white: Band, window: Window, visible: FloatArray, settings: PipelineSettings
) -> FloatArray:
    """What the network takes for direct in the grey images, zero outside the skin."""
    if not (settings.direct.from_colours and has_colour(white)):
        return direct_light(visible, settings.direct.network)
    colours = np.moveaxis(linear_channels(white, capture.encoding, ("red", "green", "blue"), window), 0, 1)
    return direct_of_enhanced(visible, colours * (visible > 0)[:, None], settings.direct.network)


def _draws_direct(capture: Capture, settings: PipelineSettings) -> bool:
    """Whether the network of direct light is asked: what does not scatter inside has direct light alone."""
    return settings.direct.method == "network" and capture.material == "skin"


def facts_of(capture: Capture, settings: PipelineSettings, white: Band, nir: Band) -> dict[str, Any]:
    """Where the shape came from and how light was separated."""
    separation = "none"
    if settings.direct.method == "network":
        separation = "none (opaque material: all light is direct)"
        if _draws_direct(capture, settings):
            separation = f"direct light by the network '{settings.direct.network}'"
    return {"shape_source": "white" if nir is white else "nir", "separation": separation}


def _grey(capture: Capture, band: Band, window: Window) -> FloatArray:
    return np.maximum(linear_stack(band, capture.encoding, "grey", window), np.float32(0.0))


def _enhanced(stack: FloatArray, mask: BoolArray, capture: Capture, settings: PipelineSettings) -> FloatArray:
    px_per_mm = capture.rig.camera.px_per_mm
    return np.stack([clahe(image, px_per_mm, settings.enhance.cells, mask=mask) for image in stack])


def _distant_normals(
    stack: FloatArray, rig: Rig, mask: BoolArray, settings: PipelineSettings
) -> tuple[FloatArray, FloatArray]:
    lights = rig.light_vectors()
    if settings.enhance.clahe:  # equalised images have no common scale of brightness
        lights = lights / np.linalg.norm(lights, axis=1, keepdims=True)
    if settings.normals.method == "robust":
        return robust(stack, lights, mask, settings.normals.robust)
    if settings.normals.method == "hanrahan_krueger":
        normals, albedo, _ = hanrahan_krueger(stack, lights, mask, settings.normals.hanrahan_krueger)
        return normals, albedo
    return lambertian(stack, lights, mask)


def _slopes(
    normals: FloatArray, finger: Finger, capture: Capture, settings: PipelineSettings
) -> tuple[FloatArray, FloatArray]:
    """Slopes of normals of the rig's frame, in the frames of the pixels' rays."""
    view = view_of(capture.rig.camera, *finger.window, along_rays=True)
    own = np.moveaxis(view.turned(np.moveaxis(normals, -1, 0)[None])[0], 0, -1)
    return gradients_from_normals(own, finger.wider[finger.window], settings.normals.max_slope)


def _integrate(gradients: tuple[FloatArray, FloatArray], mask: BoolArray, settings: PipelineSettings) -> FloatArray:
    """Heights in pixels."""
    if settings.height.method == "frankot_chellappa":
        return frankot_chellappa(*gradients, mask, settings.height.padding)
    steepness = 1.0 / np.sqrt(1.0 + gradients[0] ** 2 + gradients[1] ** 2)
    return poisson(*gradients, mask, steepness, settings.height.poisson)


def _bank(settings: PipelineSettings, capture: Capture) -> ShapeletSettings:
    """The shapelets, their sizes in pixels brought to this camera's scale."""
    scale = capture.rig.camera.px_per_mm / REFERENCE_PX_PER_MM
    return replace(settings.shapelets, sigma_px=settings.shapelets.sigma_px * scale)


def _response(settings: PipelineSettings, capture: Capture) -> Any:
    bank = _bank(settings, capture)
    plateau = bank.sigma_px

    def response(omega: Any) -> Any:
        # beyond the bank's finest scale its response falls again; the crossover keeps all that is finer
        return shapelet_response(np.minimum(omega, np.sqrt(2.0) / plateau), bank)

    return response


def _knitted(  # noqa: PLR0917
    ridge: FloatArray,
    shape: FloatArray,
    gradients: tuple[FloatArray, FloatArray],
    mask: BoolArray,
    settings: PipelineSettings,
    capture: Capture,
) -> tuple[FloatArray, FloatArray]:
    if settings.knit.method == "addition":
        return add(ridge, shape, mask), ridge
    visible = _integrate(gradients, mask, settings) * np.float32(capture.rig.camera.pitch_mm)
    height = crossover(visible, shape, _response(settings, capture), mask)
    return height, height - shape


def _iterated(
    capture: Capture, band: Band, finger: Finger, settings: PipelineSettings, watch: Stopwatch
) -> tuple[tuple[FloatArray, FloatArray], FloatArray]:
    """Slopes and albedo of one band; near lights and the surface in turns."""
    mask = finger.wider[finger.window]
    rig = capture.rig.select(band.lights)
    with watch("light"):
        stack = linear_stack(band, capture.encoding, "grey", finger.window)
    if settings.normals.method != "near_light":
        with watch("normals"):
            normals, albedo = _distant_normals(stack, rig, mask, settings)
        return _slopes(normals, finger, capture, settings), albedo
    pitch = np.float32(capture.rig.camera.pitch_mm)
    view = view_of(capture.rig.camera, *finger.window, along_rays=True)
    near = NearLightSettings(robust=settings.normals.robust)
    surface: FloatArray | float = settings.metric.plane_mm
    distant = all(led.position_mm is None for led in rig.leds)
    rounds = 1 if distant else settings.normals.rounds
    for turn in range(rounds):
        with watch("normals"):
            normals, albedo = near_light(stack, rig, surface, mask, settings=near, view=view)
            gradients = gradients_from_normals(normals, mask, settings.normals.max_slope)
        if turn < rounds - 1:
            with watch("surface"):
                height = _integrate(gradients, mask, settings) * pitch
                surface = (height + np.float32(settings.metric.plane_mm)).astype(np.float32)
    return gradients, albedo
