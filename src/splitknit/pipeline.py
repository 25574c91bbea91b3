"""The algorithm: from a capture to a metric fingerprint, one named step a line.

:func:`split_and_knit` is the thesis's algorithm (chapter 3), :func:`metric` the default method of this package, and
:func:`reconstruct` takes the one that a preset names. Time, progress and results that several cases share wrap the
steps from outside (:mod:`splitknit.steps`); every choice is a field of the settings (:mod:`splitknit.presets`).
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from splitknit import steps
from splitknit.errors import BadInput, require
from splitknit.finger.contrast import clahe
from splitknit.finger.locate import Finger, FingerSettings, prepared_capture
from splitknit.finger.ridge_period import ridge_period, scale_of_ridges
from splitknit.finger.steady import find_steady_finger
from splitknit.imaging.band import has_colour, linear_channels, linear_stack
from splitknit.imaging.coloured import LightsSettings, balanced
from splitknit.imaging.geometry import gradients_from_normals, smoothed
from splitknit.imaging.view import view_of
from splitknit.integration.frankot_chellappa import frankot_chellappa
from splitknit.integration.knit import add, crossover
from splitknit.integration.poisson import poisson
from splitknit.integration.rays import place
from splitknit.integration.shapelets import REFERENCE_PX_PER_MM, ShapeletSettings, shapelet_response, shapelets
from splitknit.model import UNKNOWN_SCALE, Band, BoolArray, Capture, FloatArray, Reconstruction, Rig
from splitknit.photometric.frames import doubts_of_lights, fit_lights
from splitknit.photometric.hanrahan_krueger import hanrahan_krueger
from splitknit.photometric.lambertian import lambertian
from splitknit.photometric.near_light import NearLightSettings, near_light
from splitknit.photometric.robust import robust
from splitknit.plausible import RELIEF, RIDGE_PERIOD, TOP, VIEW
from splitknit.presets import (
    PRESETS,
    DirectSettings,
    EnhanceSettings,
    NormalsSettings,
    PipelineSettings,
    preset_settings,
)
from splitknit.separation.direct import direct_light, direct_of_enhanced
from splitknit.settings import override
from splitknit.skin.diffusion import SkinSettings
from splitknit.skin.grid import BandImages, Grid
from splitknit.skin.images import HOW, SkinImages, working_images
from splitknit.skin.learned import LITTLE_GLOSS, Networks, can_learn, relief_by_network, with_its_power
from splitknit.skin.relief import detail_of
from splitknit.skin.surface import CoarseShape, MetricSettings, SkinSurface, relief_by_colour
from splitknit.steps import IN_MEMORY, Memory, shared, step

if TYPE_CHECKING:
    from splitknit.mirrors.captured import SeenInMirrors

__all__ = ["PRESETS", "Memory", "PipelineSettings", "metric", "preset_settings", "reconstruct", "split_and_knit"]

Slopes = tuple[FloatArray, FloatArray]
"""dz/dx and dz/dy (h, w), y up."""
WAYS = (0, 5, 6)
"""Ways to lay the finger down for the relief's network: upright in every round, turned by 90 and by 270 degrees in the
last, which takes the mean of these two and of what was drawn upright in the round before."""
SLOW_MM = 0.32
"""Standard deviation of the Gaussian whose mean is the slow part of a surface that is not split: the ridge band's."""
DOUBTFUL = 0.5
"""Expected error of the relief, over the relief's rms height, from which a warning is due."""
USUAL_PERIOD_MM = 0.45
NO_NIR = (
    "there is no near-infrared band: the shape comes from the white band, in which ridges, scattering and specular "
    "reflection bend it."
)
FRAME_SIDE = 300
"""Images of at least so many pixels a side are enough to see in which frame the lights were measured."""


def reconstruct(
    capture: Capture | str | os.PathLike[str],
    preset: str = "metric",
    settings: Mapping[str, Any] | PipelineSettings | None = None,
    progress: Callable[[str, float], None] | None = None,
    *,
    memory: Memory | None = None,
) -> Reconstruction:
    """Reconstruct one finger.

    Parameters
    ----------
    capture : Capture, or the path of a capture folder
        From :func:`splitknit.read_capture` or a simulator.
    preset : a name of :data:`PRESETS`
    settings : mapping from ``stage.field`` to a value (or nested mappings), or whole settings, optional
        Changes to the preset. Whole settings that are those of a preset are named by it in the result.
    progress : called with the name of the stage and the fraction done, optional
    memory : what several cases of this very capture share, optional
        Saves time; changes nothing.

    Returns
    -------
    Reconstruction
        On the input's pixel grid.

    Raises
    ------
    BadInput
        If the capture shows no finger, lacks a band, a setting is not known, or the memory is another capture's.

    Examples
    --------
    >>> import splitknit
    >>> capture, truth = splitknit.simulate_capture(1, settings={"scale": 0.08})
    >>> splitknit.reconstruct(capture, "snk", {"shapelets.scales": 4}).height_mm.shape
    (176, 256)

    References
    ----------
    A. Srivastava, "Split and Knit Algorithm for 3D fingerprint reconstruction using Single Camera", chapter 3.
    """
    if isinstance(settings, PipelineSettings):
        chosen = settings
        preset = next((name for name in (preset, *PRESETS) if PRESETS.get(name) == settings), preset)
    else:
        chosen = override(preset_settings(preset), settings or {})
    if not isinstance(capture, Capture):
        from splitknit.io.capture import read_capture  # large, and needed for paths alone

        capture = read_capture(capture)
    memory = Memory(capture) if memory is None else memory
    memory.check(capture)
    require("white" in capture.bands, "the capture has no band 'white'; every reconstruction needs it.")
    notes = TOP.notes(chosen.top_mm, "it is the setting top_mm")
    if capture.material == "skin" and not capture.rig.camera.scale_known:
        capture = _with_working_scale(capture)
    elif capture.material == "skin":
        scale = capture.rig.camera.px_per_mm
        notes += VIEW.notes(max(capture.shape) / scale, f"check the scale of {scale:g} px/mm (--px-per-mm)")
    algorithm = split_and_knit if chosen.method == "thesis" else metric
    with steps.running(progress, memory) as seconds:
        result = algorithm(capture, chosen)
    result = replace(result, warnings=(*notes, *result.warnings, *doubt_of_scale(capture, result)))
    if not capture.rig.camera.scale_known:
        result = _in_pixels(result)
    return replace(
        result, preset=preset, whole=chosen.whole, settings=asdict(chosen), hashes=capture.hashes,
        timings_s=dict(seconds),
    )  # fmt: skip


def with_scale(
    capture: Capture, px_per_mm: float | None = None, ridge_period_mm: float | None = None
) -> tuple[Capture, str]:
    """Give a capture the scale that nobody has measured yet.

    Parameters
    ----------
    capture : Capture
        Its scale is unknown.
    px_per_mm : pixels a millimetre on the object
    ridge_period_mm : instead, the distance of the finger's ridges along the skin
        0.45 is usual; people differ by 8 % (standard deviation), and heights with the scale.

    Returns
    -------
    capture : Capture
        With the scale; the same one where neither is given.
    note : str
        How the scale was found in the ridges, and how well it is known; else empty.

    Raises
    ------
    BadInput
        If the capture has a scale, both ways are given, a number is no scale or no distance of ridges, or no ridges are
        found.

    Examples
    --------
    >>> from splitknit.pipeline import with_scale
    >>> capture, note = with_scale(splitknit.read_capture("photos_imported"), ridge_period_mm=0.45)  # doctest: +SKIP
    """
    if px_per_mm is None and ridge_period_mm is None:
        return capture, ""
    camera, note = capture.rig.camera, ""
    require(not camera.scale_known, f"it has a scale already: {camera.px_per_mm:g} px/mm in its rig file.")
    if ridge_period_mm is not None:
        normals, mask = _plain_normals(capture)
        px_per_mm, note = scale_of_ridges(normals, mask, px_per_mm, ridge_period_mm)
    camera = replace(camera, px_per_mm=px_per_mm or camera.px_per_mm, scale_known=True)
    origin = {**capture.rig.provenance, **({"scale": note} if note else {})}
    return replace(capture, rig=replace(capture.rig, camera=camera, provenance=origin)), note


def doubt_of_scale(capture: Capture, result: Reconstruction) -> tuple[str, ...]:
    """A note where the ridges of skin lie oddly far apart by a scale that a person stated, without a calibrated rig."""
    camera = capture.rig.camera
    stated = camera.scale_known and all(led.position_mm is None for led in capture.rig.leds)
    if not stated or capture.material != "skin" or "scale" in capture.rig.provenance:
        return ()
    try:
        found = ridge_period(result.normals, result.mask)
    except BadInput:  # too coarse to show any
        return ()
    period_mm, (low, high) = found.period_px * result.pitch_mm, RIDGE_PERIOD.possible
    remedy = f"check the scale of {camera.px_per_mm:g} px/mm (--px-per-mm)"
    return RIDGE_PERIOD.notes(float(np.clip(period_mm, low, high)), remedy)


def _plain_normals(capture: Capture) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Normals of the white band by plain photometric stereo, where nothing of a finger is looked for."""
    surface = split_and_knit(replace(capture, material="opaque"), PRESETS["ea"])
    return surface.normals, surface.mask


def _with_working_scale(capture: Capture) -> Capture:
    """A finger whose scale is unknown, at the scale at which its ridges lie as usual: methods for skin work in mm."""
    found = ridge_period(*_plain_normals(capture))
    camera = replace(capture.rig.camera, px_per_mm=found.period_px / USUAL_PERIOD_MM)
    return replace(capture, rig=replace(capture.rig, camera=camera))


def _in_pixels(result: Reconstruction) -> Reconstruction:
    """A result whose scale nobody has measured, in pixels: heights, and every number and word of its facts."""
    px = 1.0 / result.pitch_mm

    def words(text: str) -> str:
        units = {"mm": px, "um": px / 1000.0}
        return re.sub(r"(\d+(?:\.\d+)?) (mm|um)\b", lambda m: f"{float(m[1]) * units[m[2]]:.3g} px", text)

    def facts(value: Any, factor: float = 1.0) -> Any:
        if isinstance(value, Mapping):
            return dict(entry(str(key), item) for key, item in value.items())
        if isinstance(value, list | tuple):
            return [facts(item, factor) for item in value]
        if isinstance(value, str):
            return words(value)
        return value * factor if isinstance(value, float) else value

    def entry(name: str, value: Any) -> tuple[str, Any]:
        for unit, other, factor in (("_per_mm", "_per_px", 1 / px), ("_mm2", "_px2", px * px), ("_mm", "_px", px),
                                    ("_um", "_px", px / 1000.0)):  # fmt: skip
            if name.endswith(unit):
                return name.removesuffix(unit) + other, facts(value, factor)
        return name, facts(value)

    def scaled(part: FloatArray) -> FloatArray:
        return (part * np.float32(px)).astype(np.float32)

    return replace(
        result,
        height_mm=scaled(result.height_mm),
        ridge_mm=scaled(result.ridge_mm),
        shape_mm=scaled(result.shape_mm),
        uncertainty_um=None,  # of micrometres
        pitch_mm=1.0,
        scale_known=False,
        quality=facts(result.quality),
        facts=facts(result.facts) | {"scale": "unknown, heights in pixels", "assumed_px_per_mm": px},
        warnings=(UNKNOWN_SCALE, *(words(warning) for warning in result.warnings)),
    )


def split_and_knit(capture: Capture, settings: PipelineSettings) -> Reconstruction:
    """Split and Knit: relief from white light, shape from near-infrared light, and both in one surface.

    References
    ----------
    The thesis, chapter 3; its cases EA and PR (section 5.4) neither split nor knit: the visible surface stays whole.
    """
    capture, finger = locate_finger(capture, settings.finding())
    mirrors = views_in_mirrors(capture, settings)
    white, nir, warnings = bands_of(capture, settings)

    # Split: direct visible light shows the ridges, near-infrared light the shape beneath them.
    seen_by = settings.lights, settings.enhance, settings.direct, settings.normals
    slopes, albedo, normals = visible_slopes(capture, white, finger, *seen_by)
    if visible_alone(settings):
        height_mm = integrate(slopes, finger, capture, settings)
        whole = settings.knit.method == "whole"
        ridge_mm = fast_part(height_mm, finger, capture) if whole else ridge_relief(slopes, finger, capture, settings)
        shape_mm = height_mm - ridge_mm
    else:
        ridge_mm = ridge_relief(slopes, finger, capture, settings)
        below = shape_slopes(capture, nir, finger, settings.enhance, settings.normals)
        shape_mm = integrate(below, finger, capture, settings)
        # Knit: the sum of both.
        height_mm, ridge_mm = knit(ridge_mm, shape_mm, slopes, finger, capture, settings)
    if settings.smooth.sigma_mm > 0:
        height_mm, ridge_mm, shape_mm = smooth(height_mm, ridge_mm, finger, capture, settings)

    facts = {"shape_source": source_of(white, nir), "separation": separation_of(capture, settings)}
    surface = Surface(height_mm, ridge_mm, shape_mm, albedo, None, facts, warnings, normals)
    return finished(capture, *with_mirror_shape(finger, surface, mirrors, settings), settings)


def metric(capture: Capture, settings: PipelineSettings) -> Reconstruction:
    """The `metric` method: near lights; on skin, scattering and specular light undone by analysis and synthesis.

    Opaque things need no model of skin: near lights with robust weights, masked integration, and a crossover of the
    bands.
    """
    capture, finger = locate_finger(capture, settings.finding())
    mirrors = views_in_mirrors(capture, settings)
    if undoes_blur(capture, settings):
        surface = skin_surface(linear_images(capture, finger, settings), settings)
    else:
        surface = opaque_surface(capture, finger, settings)
    return finished(capture, *with_mirror_shape(finger, surface, mirrors, settings), settings)


def reconstruct_skin(  # noqa: PLR0917
    bands: tuple[BandImages, ...],
    grid: Grid,
    skin: SkinSettings,
    settings: MetricSettings,
    progress: Callable[[float], None] | None = None,
    networks: Networks | None = None,
) -> SkinSurface:
    """Shape and relief of skin, by analysis and synthesis.

    A current surface predicts what photometric stereo would find on it behind the skin's blur; the difference from what
    it did find corrects the surface: first the shape on a coarse grid, from all bands, then the ridges on a fine grid,
    from the colours of the white band. What ridges and skin of other optics still bend the shape by, a network that
    sees both takes away, and the ridges are found again on the better shape.

    Parameters
    ----------
    bands : the white band first (red, green, blue, or one channel called ``green``), then near-infrared if there is one
    grid : fine grid of the images
    skin : assumed optics
    settings : MetricSettings
    progress : called with the fraction done
    networks : that estimate the relief and correct the shape, see :mod:`splitknit.skin.learned`; without them, relief
        and specular reflection are separated by their colours
    """
    white = bands[0]
    learned = networks if settings.relief == "network" and can_learn(white, grid.pitch_mm) else None
    shape = CoarseShape.of(bands, grid, skin, settings)  # near-light photometric stereo of the last band, integrated
    for _ in range(settings.coarse_steps):
        # Shape: normals are predicted behind scattering, compared with those of all bands, the difference integrated.
        shape.correct(settings.coarse)
    shape.see_colour()
    relief = np.zeros(grid.shape, dtype=np.float32)
    drawn: FloatArray | None = None
    rounds = 1 if learned is not None and learned.shape is None else settings.rounds
    for turn in range(rounds):
        if turn > 0 and learned is not None and learned.shape is not None:
            shape.mend(learned.shape, relief)
        smooth = shape.placed()
        # Relief: what the slopes of the white band's colours lack on that shape, without blur and specular reflection.
        if learned is not None:
            last = turn == rounds - 1
            ways, before = (WAYS if turn == 0 else WAYS[1:], drawn) if last else (WAYS[:1], None)
            found = relief_by_network(white, grid, smooth, shape.light(), learned.relief, ways=ways, before=before)
            drawn = found.drawn
        else:
            other = shape.optics_of(1 + skin.scattering_uncertainty)
            found = relief_by_colour(
                white, grid, smooth, shape.light(), shape.optics, other, shape.found.brightness, relief,
                settings.by_colour,
            )  # fmt: skip
        relief = found.relief_mm
        if progress is not None:
            progress((turn + 1) / (rounds + 1))
    if learned is not None:
        found = with_its_power(found)
        relief = found.relief_mm
    detail = detail_of(smooth, found.trust, grid)
    facts = {**shape.facts(), **found.facts}
    return SkinSurface(smooth - detail, relief + detail, found.deviation_mm, found.albedo, facts)


# The steps. Arrays (h, w) lie on the finger's window; heights are in mm and finite inside the mask.


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """A surface in the finger's window, finite inside the mask."""

    height_mm: FloatArray
    ridge_mm: FloatArray
    shape_mm: FloatArray
    albedo: FloatArray
    uncertainty_um: FloatArray | None
    facts: Mapping[str, Any]
    warnings: tuple[str, ...]
    normals: FloatArray | None = None
    """(h, w, 3) as photometric stereo found them, in the rig's frame; None where the surface was found otherwise."""


@shared
@step("finger")
def locate_finger(capture: Capture, settings: FingerSettings) -> tuple[Capture, Finger]:
    """Segmentation mask, pose, crease and quality; where the finger moved between the shots, that is undone."""
    lit, notes = prepared_capture(capture, settings)
    steady, finger = find_steady_finger(lit, settings)
    facts, doubts = doubt_of_lights(steady, finger)
    return steady, replace(finger, facts={**finger.facts, **facts}, warnings=(*notes, *finger.warnings, *doubts))


def doubt_of_lights(capture: Capture, finger: Finger) -> tuple[dict[str, Any], tuple[str, ...]]:
    """How well the white photographs fit their lights, and a warning where another order or frame fits better."""
    band = capture.bands["white"]
    if band.colours:
        return {}, ()
    step = np.s_[:, :: (every := max(1, max(capture.shape) // FRAME_SIDE)), ::every]
    some = replace(band, pixels=band.pixels[step], ambient=None if band.ambient is None else band.ambient[step[1:]])
    stack = linear_stack(some, capture.encoding, "grey")
    fit = fit_lights(stack, capture.rig.select(band.lights).light_vectors(), finger.wider[step[1:]])
    facts = {
        "light_residual": round(fit.residual, 4),
        "light_residual_per_image": [round(each, 4) for each in fit.residual_per_image],
    }
    return facts, doubts_of_lights(fit, [Path(file).name for file in band.files])


def bands_of(capture: Capture, settings: PipelineSettings) -> tuple[Band, Band, tuple[str, ...]]:
    """The band of the ridges, that of the shape, and a warning where they are one by necessity."""
    white = capture.bands["white"]
    if settings.shape.source != "nir" or visible_alone(settings):
        return white, white, ()
    if "nir" not in capture.bands:
        return white, white, (NO_NIR,) if capture.material == "skin" else ()
    return white, capture.bands["nir"], ()


def visible_alone(settings: PipelineSettings) -> bool:
    """Whether the white band gives the whole surface: the thesis's cases that knit nothing."""
    return settings.method == "thesis" and settings.knit.method in {"none", "whole"}


@shared
def visible_slopes(  # noqa: PLR0917
    capture: Capture,
    white: Band,
    finger: Finger,
    lights: LightsSettings,
    enhance: EnhanceSettings,
    direct: DirectSettings,
    photometric: NormalsSettings,
) -> tuple[Slopes, FloatArray, FloatArray]:
    """Slopes, albedo and normals of the direct visible light (thesis, section 3.3.1): contrast, separation, normals."""
    rig = capture.rig.select(white.lights)
    by_network = direct.method == "network" and capture.material == "skin"  # else all light is direct
    if by_network or enhance.clahe or (lights.balance and white.colours):
        images = grey_images(capture, white, finger)
        if lights.balance and white.colours:
            images = balanced(images, capture.rig, white, finger.mask[finger.window])
        if enhance.clahe:
            images = equalised(images, finger, capture, enhance)
        if by_network:
            images = direct_images(images, capture, white, finger, direct)
        normals, albedo = distant_normals(images, rig, finger.inside, enhance, photometric)
    else:

        def distant(images: FloatArray, part: slice) -> tuple[FloatArray, FloatArray]:
            images = np.maximum(images, np.float32(0.0))
            return distant_normals(images, rig, finger.inside[part], enhance, photometric)

        normals, albedo = pixel_by_pixel(capture, white, finger)(distant)
    return slopes_of(normals, finger, capture, photometric), albedo, normals


@shared
def shape_slopes(
    capture: Capture, nir: Band, finger: Finger, enhance: EnhanceSettings, photometric: NormalsSettings
) -> Slopes:
    """Slopes from the band of the shape (thesis, section 3.3.2)."""
    images = grey_images(capture, nir, finger)
    normals, _ = distant_normals(images, capture.rig.select(nir.leds), finger.inside, enhance, photometric)
    return slopes_of(normals, finger, capture, photometric)


@step("light")
def grey_images(capture: Capture, band: Band, finger: Finger) -> FloatArray:
    """(L, h, w) linear grey images."""
    return np.maximum(linear_stack(band, capture.encoding, "grey", finger.window), np.float32(0.0))


@step("light")
def equalised(images: FloatArray, finger: Finger, capture: Capture, enhance: EnhanceSettings) -> FloatArray:
    """Contrast-limited adaptive histogram equalisation of every image."""
    px_per_mm = capture.rig.camera.px_per_mm
    return np.stack([clahe(image, px_per_mm, enhance.cells, mask=finger.inside) for image in images])


@step("light")
def direct_images(
    images: FloatArray, capture: Capture, white: Band, finger: Finger, direct: DirectSettings
) -> FloatArray:
    """Direct light in the grey images, zero outside the skin, by the network of the thesis."""
    inside = images * finger.inside
    if not (direct.from_colours and has_colour(white)):
        return direct_light(inside, direct.network)
    channels = linear_channels(white, capture.encoding, ("red", "green", "blue"), finger.window)
    colours = np.moveaxis(channels, 0, 1)
    return direct_of_enhanced(inside, colours * (inside > 0)[:, None], direct.network)


Solve = Callable[[FloatArray, slice], tuple[FloatArray, FloatArray]]
"""Normals and albedo of some rows of the window, from their images: a method that works pixel by pixel."""


def pixel_by_pixel(capture: Capture, band: Band, finger: Finger) -> Callable[[Solve], tuple[FloatArray, FloatArray]]:
    """What applies a method to the linear images of a band: all rows at once, or strips of rows where the images take
    more than :data:`splitknit.steps.IN_MEMORY`; then each method reads them anew.
    """
    rows, columns = finger.window
    height, width = finger.inside.shape
    step = max(1, IN_MEMORY // (4 * len(band.lights) * width))
    whole = linear_grey(band, capture.encoding, "grey", finger.window) if step >= height else None

    def apply(solve: Solve) -> tuple[FloatArray, FloatArray]:
        if whole is not None:
            return solve(whole, slice(None))
        normals = np.zeros((height, width, 3), dtype=np.float32)
        albedo = np.full((height, width), np.nan, dtype=np.float32)
        for top in range(0, height, step):
            part = slice(top, min(top + step, height))
            if finger.inside[part].any():
                here = slice(rows.start + part.start, rows.start + part.stop)
                images = linear_grey(band, capture.encoding, "grey", (here, columns))
                normals[part], albedo[part] = solve(images, part)
                del images  # before the next ones are made
        return normals, albedo

    return apply


@step("normals")
def distant_normals(
    images: FloatArray, rig: Rig, inside: BoolArray, enhance: EnhanceSettings, photometric: NormalsSettings
) -> tuple[FloatArray, FloatArray]:
    """Normals (h, w, 3) and albedo by photometric stereo under distant lights."""
    lights = rig.light_vectors()
    if enhance.clahe:  # equalised images have no common scale of brightness
        lights = lights / np.linalg.norm(lights, axis=1, keepdims=True)
    if photometric.method == "robust":
        return robust(images, lights, inside, photometric.robust)
    if photometric.method == "hanrahan_krueger":
        normals, albedo, _ = hanrahan_krueger(images, lights, inside, photometric.hanrahan_krueger)
        return normals, albedo
    return lambertian(images, lights, inside)


@step("normals")
def slopes_of(normals: FloatArray, finger: Finger, capture: Capture, photometric: NormalsSettings) -> Slopes:
    """Slopes of normals of the rig's frame, in the frames of the pixels' rays."""
    view = view_of(capture.rig.camera, *finger.window, along_rays=True)
    own = np.moveaxis(view.turned(np.moveaxis(normals, -1, 0)[None])[0], 0, -1)
    return gradients_from_normals(own, finger.inside, photometric.max_slope)


@steps.reads_last
@step("light")
def linear_images(capture: Capture, finger: Finger, settings: PipelineSettings) -> SkinImages:
    """Linear images of the white band, and of that of the shape, on the working grid."""
    white, nir, warnings = bands_of(capture, settings)
    refuse_coloured_leds(white)
    bands = (white,) if nir is white else (white, nir)
    images = working_images(capture, bands, finger.window, finger.inside, settings.metric)
    return replace(images, warnings=(*warnings, *images.warnings))


@step("surface")
def skin_surface(images: SkinImages, settings: PipelineSettings) -> Surface:
    """The surface of skin by :func:`reconstruct_skin`, on the window's pixels."""
    skin = reconstruct_skin(images.bands, images.grid, settings.skin, settings.metric, _report_surface, images.networks)
    shape_mm, ridge_mm, albedo = (images.on_pixels(part) for part in (skin.shape_mm, skin.relief_mm, skin.albedo))
    deviation_um = images.on_pixels(skin.deviation_mm) * np.float32(1000.0)
    facts = {
        "shape_source": "nir" if len(images.bands) > 1 else "white",
        "separation": HOW[skin.facts["relief_by"]],
        "optics": skin.facts,
    }
    some = skin.relief_mm[images.grid.mask > 0.5]
    relief_um = 1000.0 * float(np.subtract(*np.percentile(some, (95, 5)))) if some.size else 0.0
    remedy = (
        "give --material opaque for what is no living skin (a cast, a render), else check --px-per-mm, and take colour "
        "photographs, as grey ones leave glare in the relief"
    )
    notes = (*images.warnings, *doubts_of(skin.facts), *RELIEF.notes(relief_um, remedy))
    return Surface(shape_mm + ridge_mm, ridge_mm, shape_mm, albedo, deviation_um, facts, notes)


def opaque_surface(capture: Capture, finger: Finger, settings: PipelineSettings) -> Surface:
    """The surface of a thing that does not scatter light inside."""
    white, nir, warnings = bands_of(capture, settings)
    slopes, albedo, normals = near_slopes(capture, white, finger, settings)
    height_mm = integrate(slopes, finger, capture, settings)
    ridge_mm = ridge_relief(slopes, finger, capture, settings)
    if nir is not white:
        below, _, _ = near_slopes(capture, nir, finger, settings)
        shape_mm = integrate(below, finger, capture, settings)
        height_mm = crossover(height_mm, shape_mm, ridge_response(capture, settings), finger.inside)
    facts = {"shape_source": source_of(white, nir), "separation": "none (opaque material)"}
    return Surface(height_mm, ridge_mm, height_mm - ridge_mm, albedo, None, facts, warnings, normals)


def source_of(white: Band, nir: Band) -> str:
    """The band that the shape comes from."""
    return "white" if nir is white else "nir"


def near_slopes(
    capture: Capture, band: Band, finger: Finger, settings: PipelineSettings
) -> tuple[Slopes, FloatArray, FloatArray]:
    """Slopes, albedo and normals of one band of an opaque thing: near lights and the surface that they reach, in
    turns."""
    rig, photometric = capture.rig.select(band.lights), settings.normals
    apply = pixel_by_pixel(capture, band, finger)
    if photometric.method != "near_light":
        normals, albedo = apply(
            lambda images, part: distant_normals(images, rig, finger.inside[part], settings.enhance, photometric)
        )
        return slopes_of(normals, finger, capture, photometric), albedo, normals
    view = view_of(capture.rig.camera, *finger.window, along_rays=True)
    near = NearLightSettings(robust=photometric.robust)
    surface = np.full(finger.inside.shape, settings.metric.plane_mm, dtype=np.float32)

    def lit(images: FloatArray, part: slice) -> tuple[FloatArray, FloatArray]:
        inside, rays = finger.inside[part], view.of_rows(part)
        return near_normals(images, rig, surface[part], inside, settings=near, view=rays)

    distant = all(led.position_mm is None for led in rig.leds)
    for turn in range(rounds := 1 if distant else photometric.rounds):
        normals, albedo = apply(lit)
        slopes = gradients_from_normals(normals, finger.inside, photometric.max_slope)
        if turn < rounds - 1:
            height = integrate(slopes, finger, capture, settings)
            surface = (height + np.float32(settings.metric.plane_mm)).astype(np.float32)
    return slopes, albedo, view.in_rig(normals)


@step("surface")
def integrate(slopes: Slopes, finger: Finger, capture: Capture, settings: PipelineSettings) -> FloatArray:
    """(h, w) heights in mm of slopes: masked least squares, or Frankot-Chellappa."""
    pitch = np.float32(capture.rig.camera.pitch_mm)
    if settings.height.method == "frankot_chellappa":
        return frankot_chellappa(*slopes, finger.inside, settings.height.padding) * pitch
    steepness = 1.0 / np.sqrt(1.0 + slopes[0] ** 2 + slopes[1] ** 2)
    return poisson(*slopes, finger.inside, steepness, settings.height.poisson) * pitch


@step("surface")
def ridge_relief(slopes: Slopes, finger: Finger, capture: Capture, settings: PipelineSettings) -> FloatArray:
    """(h, w) relief in mm that a bank of shapelets finds in slopes (thesis, section 3.3.1.3)."""
    return shapelets(*slopes, finger.inside, _bank(capture, settings)) * np.float32(capture.rig.camera.pitch_mm)


@step("surface")
def fast_part(height_mm: FloatArray, finger: Finger, capture: Capture) -> FloatArray:
    """(h, w) relief in mm of a surface that is not split: its height less its slow part, for pictures and prints.

    The slow part is a Gaussian mean, and that of what the first one missed beside the outline and on the curved finger.
    """
    sigma_px = SLOW_MM * capture.rig.camera.px_per_mm
    rest = height_mm - smoothed(height_mm, finger.inside, sigma_px)
    return rest - smoothed(rest, finger.inside, sigma_px)


@step("surface")
def knit(  # noqa: PLR0917
    ridge_mm: FloatArray,
    shape_mm: FloatArray,
    slopes: Slopes,
    finger: Finger,
    capture: Capture,
    settings: PipelineSettings,
) -> tuple[FloatArray, FloatArray]:
    """Height and relief of both parts in one surface (thesis, section 3.3.3), or by a crossover of frequencies."""
    if settings.knit.method == "addition":
        return add(ridge_mm, shape_mm, finger.inside), ridge_mm
    visible = integrate(slopes, finger, capture, settings)
    height_mm = crossover(visible, shape_mm, ridge_response(capture, settings), finger.inside)
    return height_mm, height_mm - shape_mm


def ridge_response(capture: Capture, settings: PipelineSettings) -> Callable[[NDArray[np.float64]], Any]:
    """Gain of the shapelets by frequency; beyond their finest scale it stays, so that a crossover keeps all detail."""
    bank = _bank(capture, settings)
    return lambda omega: shapelet_response(np.minimum(omega, np.sqrt(2.0) / bank.sigma_px), bank)


def _bank(capture: Capture, settings: PipelineSettings) -> ShapeletSettings:
    """The shapelets at the capture's scale; the thesis gives them in its own pixels."""
    scale = capture.rig.camera.px_per_mm / REFERENCE_PX_PER_MM
    return replace(settings.shapelets, sigma_px=settings.shapelets.sigma_px * scale)


@step("surface")
def smooth(
    height_mm: FloatArray, ridge_mm: FloatArray, finger: Finger, capture: Capture, settings: PipelineSettings
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Height, relief and shape after a Gaussian over the finished surface (Kumar's case)."""
    sigma_px = settings.smooth.sigma_mm * capture.rig.camera.px_per_mm
    height_mm, ridge_mm = (smoothed(part, finger.inside, sigma_px) for part in (height_mm, ridge_mm))
    return height_mm, ridge_mm, height_mm - ridge_mm


linear_grey = step("light")(linear_stack)
near_normals = step("normals")(near_light)


def _report_surface(fraction: float) -> None:
    steps.report("surface", fraction)


def doubts_of(facts: Mapping[str, Any]) -> tuple[str, ...]:
    """Warnings where the ridges' heights are hardly known, or only up to a common factor."""
    if facts["relief_by"] != "network":
        return ()
    error, relief, gain = facts["relief_error_um"], facts["relief_rms_um"], facts["gain_uncertainty"]
    notes = []
    if error > DOUBTFUL * relief:
        notes.append(f"the ridges are hardly measured: {relief:.0f} um rms with an expected error of {error:.0f} um.")
    if facts["gloss"] < LITTLE_GLOSS:
        notes.append(
            "the skin shows hardly any specular reflection: its brightness tells the ridges' heights, which may all be "
            f"off by a common factor (standard deviation {100 * gain:.0f} %)."
        )
    return tuple(notes)


def undoes_blur(capture: Capture, settings: PipelineSettings) -> bool:
    """Whether subsurface scattering is undone: as the settings say, else where the capture's material is skin."""
    wanted = settings.skin.invert_blur
    return capture.material == "skin" if wanted is None else wanted


def refuse_coloured_leds(white: Band) -> None:
    """Refuse a band of coloured LEDs, whose light the skin blurs differently."""
    require(
        not white.colours,
        "the skin blurs the light of each coloured LED differently, which this preset does not undo; use lin, ea "
        "or another of the published cases.",
    )


def separation_of(capture: Capture, settings: PipelineSettings) -> str:
    """How direct light was separated in the thesis's cases."""
    if settings.direct.method != "network":
        return "none"
    if capture.material != "skin":
        return "none (opaque material: all light is direct)"
    return f"direct light by the network '{settings.direct.network}'"


@step("finger")
def views_in_mirrors(capture: Capture, settings: PipelineSettings) -> SeenInMirrors | None:
    """What mirrors beside the finger show, where the shape comes from them; else None."""
    if settings.shape.source != "mirror":
        return None
    from splitknit.mirrors.captured import seen_in_mirrors  # large, and needed where there are mirrors

    require(
        not visible_alone(settings),
        "this preset keeps the visible surface whole, so that a shape from mirrors has no place in it: take --preset "
        "metric or snk.",
    )
    return seen_in_mirrors(capture, settings.mask, settings.shape.mirror)


def with_mirror_shape(
    finger: Finger, surface: Surface, mirrors: SeenInMirrors | None, settings: PipelineSettings
) -> tuple[Finger, Surface]:
    """The surface on the shape from mirrors, and the finger as far as the mirrors show it; unchanged without them."""
    if mirrors is None:
        return finger, surface
    from splitknit.mirrors.captured import mirror_shape_of

    detail = None if settings.method == "thesis" else surface.shape_mm
    shape_mm, mask, facts = mirror_shape_of(finger, mirrors, settings.shape.mirror, detail)
    return replace(finger, mask=mask), replace(
        surface, height_mm=shape_mm + surface.ridge_mm, shape_mm=shape_mm, facts={**surface.facts, **facts}
    )


@step("result")
def finished(capture: Capture, finger: Finger, surface: Surface, settings: PipelineSettings) -> Reconstruction:
    """The window's surface in the full image, cut to the mask, with the normals of the knitted height."""
    mask, window, camera = finger.mask, finger.window, capture.rig.camera
    inside = mask[window]
    done = place(surface.height_mm, surface.shape_mm, inside, camera, window, settings.top_mm)

    def whole(part: FloatArray) -> FloatArray:
        image = np.full(mask.shape, np.nan, dtype=np.float32)
        np.copyto(image[window], part, where=inside)
        return image

    parallel = done.x_mm is None or done.y_mm is None

    def whole_normals(part: FloatArray) -> FloatArray:
        image = np.zeros((*mask.shape, 3), dtype=np.float32)
        np.copyto(image[window], part, where=inside[..., None])  # no negative zeros, which pack badly
        return image

    return Reconstruction(
        height_mm=whole(done.height_mm),
        ridge_mm=whole(surface.ridge_mm if parallel else done.height_mm - done.shape_mm),
        shape_mm=whole(done.shape_mm),
        mask=mask,
        normals=whole_normals(done.normals),
        normals_measured=None if surface.normals is None else whole_normals(surface.normals),
        albedo=whole(surface.albedo),
        pitch_mm=camera.pitch_mm,
        x_mm=None if done.x_mm is None else whole(done.x_mm),
        y_mm=None if done.y_mm is None else whole(done.y_mm),
        input_from_upright=finger.upright.input_from_upright,
        upright_size=finger.upright.size,
        preset="",
        uncertainty_um=None if surface.uncertainty_um is None else whole(surface.uncertainty_um),
        quality=finger.quality,
        facts={"material": capture.material, **finger.facts, **surface.facts},
        warnings=(*finger.warnings, *surface.warnings),
    )
