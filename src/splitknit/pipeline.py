"""The algorithm: from a capture to a metric fingerprint.

:func:`ea`, :func:`ea_split`, :func:`snk` and :func:`snk_by_crossover` are the thesis's cases (chapter 3), with
:func:`smoothed_surface` Kumar's; :func:`metric_opaque` and :func:`metric_skin` are the default method of this package.
:func:`reconstruct` chooses one of them, and its parameters, from the settings (:mod:`splitknit.presets`). Time,
progress and results that several cases share wrap the steps from outside (:mod:`splitknit.steps`).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from splitknit import steps
from splitknit.errors import BadInput, Note, require
from splitknit.finger.contrast import clahe
from splitknit.finger.locate import Finger, FingerSettings, prepared_capture
from splitknit.finger.mask import MaskSettings
from splitknit.finger.orientation import as_it_lies
from splitknit.finger.ridge_period import ridge_period, scale_of_ridges
from splitknit.finger.steady import find_steady_finger
from splitknit.imaging.band import has_colour, linear_channels, linear_stack
from splitknit.imaging.coloured import balanced
from splitknit.imaging.films import aligned
from splitknit.imaging.geometry import (
    gradients_from_normals,
    smoothed,
    wide_blur,
)
from splitknit.imaging.light_field import flat_promised
from splitknit.imaging.polarised import doubts_of_series, specular_of, without_films
from splitknit.imaging.view import view_of
from splitknit.integration.frankot_chellappa import frankot_chellappa
from splitknit.integration.knit import add, crossover
from splitknit.integration.poisson import poisson, trusted_height
from splitknit.integration.rays import place
from splitknit.integration.shapelets import REFERENCE_PX_PER_MM, ShapeletSettings, shapelet_response, shapelets
from splitknit.mirrors.settings import MirrorShapeSettings
from splitknit.model import UNKNOWN_SCALE, Band, BoolArray, Capture, FloatArray, Reconstruction, Rig
from splitknit.networks.augmentation import UPRIGHT
from splitknit.photometric.frames import doubts_of_lights, fit_lights
from splitknit.photometric.hanrahan_krueger import hanrahan_krueger
from splitknit.photometric.lambertian import lambertian
from splitknit.photometric.near_light import NearLightSettings, near_light
from splitknit.photometric.robust import robust
from splitknit.photometric.shading import Shading, read_shading, shading_slopes
from splitknit.plausible import RELIEF, RIDGE_PERIOD, TOP, VIEW
from splitknit.presets import (
    PRESETS,
    DirectSettings,
    EnhanceSettings,
    HeightSettings,
    NormalsSettings,
    Parameters,
    Photometry,
    PipelineSettings,
    preset_settings,
)
from splitknit.separation.direct import direct_light, direct_of_enhanced
from splitknit.settings import override
from splitknit.skin.diffusion import Diffusion, SkinSettings
from splitknit.skin.grid import BandImages, Grid, smooth_step
from splitknit.skin.images import SEPARATED_BY, MetricSettings, SkinImages, working_images
from splitknit.skin.learned import (
    LITTLE_GLOSS,
    Networks,
    features,
    refined_shape,
    relief_by_network,
    relief_network,
    variance_restored,
)
from splitknit.skin.light import slant_of
from splitknit.skin.polarised import polarised_heights, specular_images
from splitknit.skin.relief import KNIT_MM, ReliefEstimate, detail_of, measure, relief_by_colour
from splitknit.skin.shape import CoarseImages, Shape, coarse_images, coarse_shape, on_fine_grid, white_light_on
from splitknit.steps import IN_MEMORY, Memory, shared, step

if TYPE_CHECKING:
    from splitknit.mirrors.captured import SeenInMirrors

__all__ = ["PRESETS", "Memory", "PipelineSettings", "preset_settings", "reconstruct"]

Slopes = tuple[FloatArray, FloatArray]
"""dz/dx and dz/dy (h, w), y up."""
TURNED = (5, 6)
"""Orientations (by 90 and 270 degrees) that are averaged with the upright one in the last relief estimate."""
SLOW_MM = 0.32
"""Standard deviation of the Gaussian whose mean is the slow part of a surface that is not split: the ridge band's."""
DOUBTFUL = 0.5
"""Expected error of the relief, over the relief's rms height, from which a warning is due."""
USUAL_PERIOD_MM = 0.45
NO_SPECULAR = (
    "the difference of the parallel and the crossed series shows hardly any specular reflection (matt or wet skin, or "
    "films that are not crossed): ridge heights are modelled, as without films."
)
NO_PLACE_FOR_MIRRORS = (
    "this preset keeps the visible surface whole, so that a shape from mirrors has no place in it: take `preset` "
    "metric or snk."
)
OPAQUE = "none (opaque material)"
FEW_EXTRAPOLATED = 0.001
"""Fraction of a surface steeper than what was calibrated, above which that is noted."""
FRAME_SIDE = 300
"""Images of at least so many pixels a side are enough to detect in which frame the lights were measured."""


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
    if memory is not None:
        memory.check(capture)
    require("white" in capture.bands, "the capture has no band 'white'; every reconstruction needs it.")
    notes = TOP.notes(chosen.top_mm, "it is the setting top_mm")
    capture, doubt = _with_working_scale(capture)
    if capture.shading is not None:
        require(
            chosen.method == "metric" and capture.material == "opaque" and chosen.shape.source != "mirror",
            "a calibrated shading goes with the preset metric and opaque things alone.",
        )
        with steps.timed_run(progress, memory) as seconds:
            result = _shaded_result(capture)
        return replace(result, preset=preset, settings=asdict(chosen), timings_s=dict(seconds))
    capture = _with_promised_light(capture)
    with steps.timed_run(progress, memory) as seconds:
        capture, finger = locate_finger(capture, chosen.finding())
        specular = specular_of(capture, finger.mask)
        mirrors = None
        if chosen.shape.source == "mirror":
            require(not chosen.visible_alone, NO_PLACE_FOR_MIRRORS)
            mirrors = _views_in_mirrors(capture, chosen.mask, chosen.shape.mirror)
        bands, no_nir = _bands_of(capture, chosen.shape.source == "nir" and not chosen.visible_alone)
        if chosen.method == "metric" and undoes_blur(capture.material, chosen.skin):
            images = _linear_images(capture, bands, finger, chosen.metric)
            capture, bands = replace(capture, bands={}), ()  # the photographs go here, where nobody else holds them
            steps.images_are_read()
            surface = _skin_surface(images, chosen.skin, chosen.metric)
        else:
            white, nir = (FingerBand(capture, band, finger, chosen.metric.plane_mm) for band in (bands[0], bands[-1]))
            p = chosen.parameters(bool(white.band.colours), capture.material)
            method = metric_opaque if chosen.method == "metric" else THESIS[chosen.knit.method]
            surface = smoothed_surface(method(white, nir, p), white, chosen.smooth.sigma_mm)
            separated = OPAQUE if chosen.method == "metric" else _separation_of(chosen.direct, capture.material)
            surface = replace(
                surface,
                facts={
                    "shape_source": "white" if nir == white else "nir",
                    "separation": separated,
                    "heights": "measured",
                },
            )
        if mirrors is not None:
            detail = None if chosen.method == "thesis" else surface.shape_mm
            finger, surface = _with_mirror_shape(finger, surface, mirrors, chosen.shape.mirror, detail)
        result = _finished(capture, finger, surface, chosen.top_mm)
    warnings = (*notes, *doubt, *finger.warnings, *no_nir, *surface.warnings, *_doubt_of_scale(capture, result))
    result = replace(
        result, preset=preset, whole=chosen.whole, settings=asdict(chosen), warnings=warnings, timings_s=dict(seconds),
        specular=specular,
    )  # fmt: skip
    return result if capture.rig.camera.scale_known else _in_pixels(result)


def with_scale(
    capture: Capture, px_per_mm: float | None = None, ridge_period_mm: float | None = None
) -> tuple[Capture, str]:
    """Give a capture the scale that nobody has measured yet.

    `px_per_mm`: pixels a millimetre on the object; `ridge_period_mm`: instead, the distance of the finger's ridges on
    the skin; 0.45 is usual, people differ by 8 % (standard deviation), and heights with the scale. Raises BadInput if
    the capture has a scale, both ways are given, a number is no scale or no distance of ridges, or no ridges are found.

    Returns the capture with the scale (the same one where neither is given), and how the scale was found in the ridges
    and how well it is known, else an empty text.
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


def _doubt_of_scale(capture: Capture, result: Reconstruction) -> tuple[str, ...]:
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
    plain = PRESETS["ea"]
    capture, thing = locate_finger(replace(capture, material="opaque"), plain.finding())
    white = FingerBand(capture, capture.bands["white"], thing)
    result = _finished(capture, thing, ea(white, white, plain.parameters(False, "opaque")), plain.top_mm)
    return result.normals, result.mask


def _with_working_scale(capture: Capture) -> tuple[Capture, tuple[str, ...]]:
    """Skin at a plausible scale, and a note where its scale is odd: methods for skin work in mm.

    Where the scale is unknown, that at which the ridges lie as usual; it is still marked as unknown.
    """
    camera = capture.rig.camera
    if capture.material != "skin":
        return capture, ()
    if camera.scale_known:
        view_mm = max(capture.shape) / camera.px_per_mm
        return capture, VIEW.notes(view_mm, f"check the scale of {camera.px_per_mm:g} px/mm (--px-per-mm)")
    found = ridge_period(*_plain_normals(capture))
    camera = replace(camera, px_per_mm=found.period_px / USUAL_PERIOD_MM)
    return replace(capture, rig=replace(capture.rig, camera=camera)), ()


def _in_pixels(result: Reconstruction) -> Reconstruction:
    """A result whose scale nobody has measured, in pixels: heights, and every number and word of its facts."""
    px = 1.0 / result.pitch_mm

    def words(text: str) -> str:
        return text.in_px(px) if isinstance(text, Note) else text

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


# The methods: photographs of the finger in, a surface in the finger's window out. Arrays are (h, w), finite inside the
# mask, heights in mm.


@dataclass(frozen=True, slots=True)
class FingerBand:
    """One band's photographs of the finger."""

    capture: Capture
    band: Band
    finger: Finger
    plane_mm: float = 0.0
    """Assumed mean height of the surface above the finger plane, for near lights."""

    @property
    def rig(self) -> Rig:
        """`rig.leds[k]` lights photograph k."""
        return self.capture.rig.select(self.band.lights)

    @property
    def inside(self) -> BoolArray:
        """(h, w) pixels of the window that are reconstructed."""
        return self.finger.inside

    @property
    def px_per_mm(self) -> float:
        """Scale on the finger plane."""
        return self.capture.rig.camera.px_per_mm

    @property
    def pitch_mm(self) -> np.float32:
        """Side of a pixel on the finger plane."""
        return np.float32(self.capture.rig.camera.pitch_mm)


@dataclass(frozen=True, slots=True, eq=False)
class FingerSurface:
    """A surface in the finger's window."""

    height_mm: FloatArray
    ridge_mm: FloatArray
    shape_mm: FloatArray
    albedo: FloatArray
    normals: FloatArray | None = None
    """(h, w, 3) measured by photometric stereo, in the rig's frame; None where the method measures none."""
    uncertainty_um: FloatArray | None = None
    facts: Mapping[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


def ea(white: FingerBand, _: FingerBand, p: Parameters) -> FingerSurface:
    """EA and PR (thesis, section 5.4): the visible surface, whole.

    EA is photometric stereo and integration; PR adds contrast enhancement and direct light. The systems of Kumar,
    Zheng, Lin and Xie are EA with other parameters (:mod:`splitknit.presets`).
    """
    normals, albedo = visible_normals(white, p.photometry)
    height_mm = integrated(slopes_of(normals, white, p.max_slope), white, p.height)
    relief = fast_part(height_mm, white)
    return FingerSurface(height_mm, relief, height_mm - relief, albedo, normals)


def ea_split(white: FingerBand, _: FingerBand, p: Parameters) -> FingerSurface:
    """EA or PR with the relief that shapelets extract from the visible surface, as in Split and Knit."""
    normals, albedo = visible_normals(white, p.photometry)
    slopes = slopes_of(normals, white, p.max_slope)
    height_mm = integrated(slopes, white, p.height)
    relief = ridge_relief(slopes, white, p.shapelets)
    return FingerSurface(height_mm, relief, height_mm - relief, albedo, normals)


def snk(white: FingerBand, nir: FingerBand, p: Parameters) -> FingerSurface:
    """Split and Knit (thesis, chapter 3): relief from direct white light, shape from near-infrared light."""
    normals, albedo = visible_normals(white, p.photometry)  # 3.3.1
    relief = ridge_relief(slopes_of(normals, white, p.max_slope), white, p.shapelets)  # 3.3.1.3
    shape = integrated(shape_slopes(nir, p.photometry), nir, p.height)  # 3.3.2
    return FingerSurface(add(relief, shape, white.inside), relief, shape, albedo, normals)  # 3.3.3


def snk_by_crossover(white: FingerBand, nir: FingerBand, p: Parameters) -> FingerSurface:
    """Split and Knit by a crossover of frequencies: H visible + (1 - H) shape, H the gain of the shapelets."""
    normals, albedo = visible_normals(white, p.photometry)
    shape = integrated(shape_slopes(nir, p.photometry), nir, p.height)
    visible = integrated(slopes_of(normals, white, p.max_slope), white, p.height)
    height_mm = crossover(visible, shape, ridge_response(white, p.shapelets), white.inside)
    return FingerSurface(height_mm, height_mm - shape, shape, albedo, normals)


THESIS = {"whole": ea, "none": ea_split, "addition": snk, "crossover": snk_by_crossover}
"""The thesis's cases by ``knit.method``."""


@step("surface")
def smoothed_surface(surface: FingerSurface, white: FingerBand, sigma_mm: float) -> FingerSurface:
    """Kumar's system: a Gaussian over the finished surface; the same surface for a sigma of zero."""
    if sigma_mm == 0:
        return surface
    sigma_px = sigma_mm * white.px_per_mm
    height_mm, ridge_mm = (smoothed(part, white.inside, sigma_px) for part in (surface.height_mm, surface.ridge_mm))
    return replace(surface, height_mm=height_mm, ridge_mm=ridge_mm, shape_mm=height_mm - ridge_mm)


def metric_opaque(white: FingerBand, nir: FingerBand, p: Parameters) -> FingerSurface:
    """The `metric` method for what does not scatter light inside: near lights, robust weights, masked integration.

    A near-infrared band, where there is one, gives the shape by a crossover of frequencies.
    """
    slopes, albedo, normals = near_slopes(white, p.photometry.normals, p.height)
    height_mm = integrated(slopes, white, p.height)
    relief = ridge_relief(slopes, white, p.shapelets)
    if nir != white:
        shape = integrated(near_slopes(nir, p.photometry.normals, p.height)[0], nir, p.height)
        height_mm = crossover(height_mm, shape, ridge_response(white, p.shapelets), white.inside)
    return FingerSurface(height_mm, relief, height_mm - relief, albedo, normals)


def shaded_surface(capture: Capture, shading: Shading, inside: BoolArray) -> FingerSurface:
    """The surface of an opaque thing whose slopes follow from a shading calibrated on balls.

    The result's uncertainty is that of heights against their surroundings, over about a ball. `capture`: its white band
    over its flat images is what the calibration saw; `shading`: of :func:`splitknit.photometric.shading.read_shading`;
    `inside`: (H, W) pixels that are wanted.
    """
    pitch = np.float32(shading.pitch_mm)
    images = _linear_grey(capture.bands["white"], capture.encoding, "grey")
    gradient, deviation = _slopes_of_shading(shading, images)
    albedo = images.mean(axis=0)
    del images
    if not inside.all():
        gradient *= inside
    extrapolated = float(np.mean((gradient[0] ** 2 + gradient[1] ** 2 > np.float32(shading.max_slope**2))[inside]))
    height_mm = _trusted_height(gradient, deviation, inside) * pitch
    relief = _fast_part(height_mm, inside, SLOW_MM / shading.pitch_mm)
    facts = {
        "slopes": "calibrated on balls",
        "separation": OPAQUE,
        "heights": "measured",
        "max_slope_calibrated": shading.max_slope,
        "extrapolated": extrapolated,
    }
    notes = (
        f"{100 * extrapolated:.1f} % of the surface is steeper than the balls of the calibration showed (a slope of "
        f"{shading.max_slope:.2f}, {np.rad2deg(np.arctan(shading.max_slope)):.0f} deg): its slopes are extrapolated.",
    )
    deviation *= np.float32(1000.0 * shading.height_mm_per_slope)
    beyond = extrapolated > FEW_EXTRAPOLATED
    return FingerSurface(height_mm, relief, height_mm - relief, albedo, None, deviation, facts, notes if beyond else ())


@dataclass(frozen=True, slots=True, eq=False)
class SkinSurface:
    """Reconstructed skin on the working grid; heights are finite everywhere and valid inside the mask."""

    shape_mm: FloatArray
    relief_mm: FloatArray
    deviation_mm: FloatArray
    """Standard deviation of the relief: noise, what denoising removed, unknown scattering, and model error."""
    albedo: FloatArray
    """Diffuse brightness of the first channel, relative."""
    facts: Mapping[str, Any]


def metric_skin(
    bands: tuple[BandImages, ...], grid: Grid, skin: SkinSettings, p: MetricSettings, networks: Networks | None = None
) -> SkinSurface:
    """The `metric` method for skin: analysis by synthesis.

    The current surface predicts what photometric stereo measures on it behind the skin's scattering; the residual
    corrects it: first the shape on a coarse grid, from all bands, then the relief on a fine grid, from the white band.

    `bands`: the white band first (red, green, blue, or one channel called ``green``), then near-infrared if there is
    one; `grid`: fine grid of the images; `skin`: assumed optics; `p`: grids and iterations; `networks`: that estimate
    the relief and refine the shape (:mod:`splitknit.skin.learned`); without them, relief and specular reflection are
    separated by their colours.
    """
    images = coarse_images(bands, grid, p.coarse_pitch_mm, p.plane_mm)
    shape = coarse_shape(images, skin.optics(images.channels), p.coarse_steps)
    white = bands[0].channels
    colour = {name: shape.brightness[name] / shape.brightness[white[0]] for name in white}
    optics = skin.optics(images.channels, colour)
    if networks is None:
        smooth = on_fine_grid(shape.height_mm, images)
        light = white_light_on(shape.height_mm, images)
        measured = measure(bands[0], grid, smooth, light, optics, shape.brightness)
        other = skin.optics(images.channels, colour, 1 + skin.scattering_uncertainty)
        repeated = replace(p.by_colour, steps=p.rounds * p.by_colour.steps)
        estimate = relief_by_colour(measured, grid, smooth, other, repeated)
    else:
        smooth, estimate = relief_and_shape(images, shape, optics, networks, p.rounds)
    detail = detail_of(smooth, estimate.trust, grid)  # of the shape, beyond the crossover: creases
    facts = {
        "scattering_per_mm": {name: optics[name].scattering_per_mm for name in sorted(optics)},
        "absorption_per_mm": {name: optics[name].absorption_per_mm for name in sorted(optics)},
        "scattering_assumed": True,
        "colour": colour,
        "glare": {name: {"roughness": r, "strength": s} for name, (r, s) in shape.glare.items()},
        "working_pitch_mm": grid.pitch_mm,
        **estimate.facts,
    }
    return SkinSurface(smooth - detail, estimate.relief_mm + detail, estimate.deviation_mm, estimate.albedo, facts)


def metric_polarised(
    images: SkinImages, skin: SkinSettings, p: MetricSettings, networks: Networks | None = None
) -> SkinSurface:
    """The `metric` method for skin photographed behind films, parallel and crossed.

    The crossed series shows no specular reflection: it gives the shape. Both series together give a first relief, and
    from there their difference, the specular image, measures the heights. Where films show hardly any specular
    reflection (matt or wet skin), the result is that of :func:`metric_skin`.

    `images`: whose `bands` are as without films, and whose `crossed` is not None. `skin`, `p`, `networks`: as for
    :func:`metric_skin`.
    """
    grid, both, crossed = images.grid, images.bands[0], images.crossed
    assert crossed is not None
    first = metric_skin((replace(crossed, unpolarised=both), *images.bands[1:]), grid, skin, p, networks)
    shape, relief, deviation = first.shape_mm, first.relief_mm, first.deviation_mm
    if networks is None:  # a relief by colour alone would lead astray
        relief, deviation = 0 * relief, np.full_like(deviation, UNKNOWN_MM)
    specular = specular_images(both, crossed, images.parallel, grid, shape)
    found = polarised_heights(specular, grid, shape + relief, deviation)
    if found.facts["specular_over_noise"] < FAINT:
        modelled = metric_skin(images.bands, grid, skin, p, networks)
        return replace(modelled, facts={**modelled.facts, "specular": found.facts})
    rest = found.height_mm - shape
    slow = grid.smooth(rest, grid.mask, KNIT_MM)
    unseen = _beyond(UNSEEN_DEG, slant_of(shape, grid.pitch_mm)) * np.float32(networks is not None)
    ridges = np.asarray(rest - slow + unseen * (relief - rest + slow), dtype=np.float32)
    facts = {**first.facts, "relief_by": "polarised", "specular": found.facts}
    return SkinSurface(shape + slow, ridges, found.deviation_mm, first.albedo, facts)


def _beyond(limits_deg: tuple[float, float], slant_deg: FloatArray) -> FloatArray:
    """(h, w) in [0, 1]: from one slant to another."""
    return smooth_step((slant_deg - np.float32(limits_deg[0])) / np.float32(limits_deg[1] - limits_deg[0]))


BOTH_DEG = (30.0, 40.0)
"""Slants between which the first relief becomes the mean of that of both series and that of the crossed one: the one
is too high there, the other too low."""
UNSEEN_DEG = (40.0, 60.0)
"""Slants between which the specular image fades, and the relief becomes the first one."""
UNKNOWN_MM = 0.02
"""Standard deviation of the relief where no network gives a first one."""
FAINT = 3.0
"""Specular reflection over noise below which it says nothing of heights."""


def relief_and_shape(
    images: CoarseImages, shape: Shape, optics: Mapping[str, Diffusion], networks: Networks, rounds: int
) -> tuple[FloatArray, ReliefEstimate]:
    """Smooth shape (h, w) on the fine grid and the relief on it by networks, each from the other, in turns.

    The last relief is the mean over three orientations of the finger, of which the round before gave the upright one;
    its variance is restored, as a minimum-mean-square-error estimate shrinks. Of crossed images that one stands apart:
    the last relief is that of the same images as without films.
    """
    grid, last = images.fine, rounds if networks.shape is not None else 1
    orientations: tuple[int, ...] = (UPRIGHT,)
    earlier: FloatArray | None = None
    estimate: ReliefEstimate | None = None
    for turn in range(1, last + 1):
        before = estimate
        if estimate is not None and networks.shape is not None:
            shape = refined_shape(shape, estimate.relief_mm, images, optics, networks.shape)
        if turn == last:
            orientations = TURNED if estimate is not None else (UPRIGHT, *TURNED)
            if images.white.unpolarised is not None:
                images = replace(images, white=images.white.unpolarised)
            elif estimate is not None:
                earlier = estimate.output
        smooth = on_fine_grid(shape.height_mm, images)
        network = relief_network(networks.relief, orientations, earlier)
        estimate = relief_by_network(
            features(images.white, grid, smooth, white_light_on(shape.height_mm, images)), grid, smooth, network
        )
    assert estimate is not None  # of one round at least
    found = variance_restored(estimate)
    if before is None or earlier is not None:
        return smooth, found
    of_crossed = variance_restored(before).relief_mm - found.relief_mm
    part = _beyond(BOTH_DEG, slant_of(smooth, grid.pitch_mm)) / 2
    return smooth, replace(found, relief_mm=found.relief_mm + part * of_crossed)


# The steps.


@shared
@step("finger")
def locate_finger(capture: Capture, settings: FingerSettings) -> tuple[Capture, Finger]:
    """Segmentation mask, pose, crease and quality; where the finger moved between the shots, that is undone."""
    lit, notes = prepared_capture(capture, settings)
    lit, films = aligned(lit)  # before motion is measured, which would take the shift of the image for one
    steady, finger = find_steady_finger(lit, settings)
    steady = without_films(steady)
    facts, doubts = _doubt_of_lights(steady, finger)
    facts = {**finger.facts, **films, **facts}
    return steady, replace(finger, facts=facts, warnings=(*notes, *finger.warnings, *doubts))


def _doubt_of_lights(capture: Capture, finger: Finger) -> tuple[dict[str, Any], tuple[str, ...]]:
    """How well the white photographs fit their lights, and a warning where another order or frame fits better."""
    band = capture.bands["white"]
    if band.colours:
        return {}, ()
    every = max(1, max(capture.shape) // FRAME_SIDE)
    stack = linear_stack(band.sampled(every), capture.encoding, "grey")
    fit = fit_lights(stack, capture.rig.select(band.lights).light_vectors(), finger.wider[::every, ::every])
    facts = {
        "light_residual": round(fit.residual, 4),
        "light_residual_per_image": [round(each, 4) for each in fit.residual_per_image],
    }
    doubts = doubts_of_lights(fit, [Path(file).name for file in band.files])
    if band.crossed is not None:
        series = replace(band, crossed=None), band.crossed
        parallel, crossed = (linear_stack(one.sampled(every), capture.encoding) for one in series)
        doubts = (*doubts, *doubts_of_series(parallel, crossed, finger.mask[::every, ::every]))
    return facts, doubts


def _bands_of(capture: Capture, from_nir: bool) -> tuple[tuple[Band, ...], tuple[str, ...]]:
    """The white band, the near-infrared one if the shape is to come from it, and a warning where skin lacks it."""
    white = capture.bands["white"]
    if not from_nir:
        return (white,), ()
    if "nir" not in capture.bands:
        note = (
            "there is no near-infrared band: the shape comes from the white band, in which ridges, scattering and "
            "specular reflection bend it."
        )
        return (white,), (note,) if capture.material == "skin" else ()
    return (white, capture.bands["nir"]), ()


@shared
def visible_normals(white: FingerBand, p: Photometry) -> tuple[FloatArray, FloatArray]:
    """Normals (h, w, 3) and albedo of the direct visible light (thesis, section 3.3.1)."""
    if not p.prepares:
        lights, inside = white.rig.light_vectors(), white.inside

        def solve(images: FloatArray, rows: slice) -> tuple[FloatArray, FloatArray]:
            return _distant_normals(np.maximum(images, np.float32(0.0)), lights, inside[rows], p.normals)

        return _by_rows(white, solve)
    images = _grey_images(white)
    if p.balance:
        images = balanced(images, white.capture.rig, white.band, white.finger.mask[white.finger.window])
    if p.enhance.clahe:
        images = _equalised(images, white, p.enhance)
    if p.direct.method == "network":
        images = _direct_images(images, white, p.direct)
    return _distant_normals(images, _lights(white, p.enhance), white.inside, p.normals)


def shape_slopes(nir: FingerBand, p: Photometry) -> Slopes:
    """Slopes from the band of the shape (thesis, section 3.3.2)."""
    normals, _ = _distant_normals(_grey_images(nir), _lights(nir, p.enhance), nir.inside, p.normals)
    return slopes_of(normals, nir, p.normals.max_slope)


def _lights(photographs: FingerBand, enhance: EnhanceSettings) -> NDArray[np.float64]:
    """(L, 3) distant lights; of unit length beside equalised images, which have no common scale of brightness."""
    lights = photographs.rig.light_vectors()
    return lights / np.linalg.norm(lights, axis=1, keepdims=True) if enhance.clahe else lights


@step("light")
def _grey_images(photographs: FingerBand) -> FloatArray:
    """(L, h, w) linear grey images."""
    encoding, window = photographs.capture.encoding, photographs.finger.window
    return np.maximum(linear_stack(photographs.band, encoding, "grey", window), np.float32(0.0))


@step("light")
def _equalised(images: FloatArray, photographs: FingerBand, enhance: EnhanceSettings) -> FloatArray:
    """Contrast-limited adaptive histogram equalisation of every image."""
    scale, inside = photographs.px_per_mm, photographs.inside
    return np.stack([clahe(image, scale, enhance.cells, mask=inside) for image in images])


@step("light")
def _direct_images(images: FloatArray, white: FingerBand, direct: DirectSettings) -> FloatArray:
    """Direct light in the grey images, zero outside the skin, by the network of the thesis."""
    inside = images * white.inside
    if not (direct.from_colours and has_colour(white.band)):
        return direct_light(inside, direct.network)
    encoding, window = white.capture.encoding, white.finger.window
    colours = np.moveaxis(linear_channels(white.band, encoding, ("red", "green", "blue"), window), 0, 1)
    return direct_of_enhanced(inside, colours * (inside > 0)[:, None], direct.network)


def _by_rows(
    photographs: FingerBand, solve: Callable[[FloatArray, slice], tuple[FloatArray, FloatArray]]
) -> tuple[FloatArray, FloatArray]:
    """Normals and albedo by a method that works pixel by pixel on the linear images of some rows.

    All rows at once, or strips of rows where the images take more than :data:`splitknit.steps.IN_MEMORY`.
    """
    band, inside, encoding = photographs.band, photographs.inside, photographs.capture.encoding
    rows, columns = photographs.finger.window
    height, width = inside.shape
    step = max(1, IN_MEMORY // (4 * len(band.lights) * width))
    if step >= height:
        return solve(_linear_grey(band, encoding, "grey", (rows, columns)), slice(None))
    normals = np.zeros((height, width, 3), dtype=np.float32)
    albedo = np.full((height, width), np.nan, dtype=np.float32)
    for top in range(0, height, step):
        part = slice(top, min(top + step, height))
        if inside[part].any():
            here = slice(rows.start + part.start, rows.start + part.stop)
            normals[part], albedo[part] = solve(_linear_grey(band, encoding, "grey", (here, columns)), part)
    return normals, albedo


@step("normals")
def _distant_normals(
    images: FloatArray, lights: NDArray[np.float64], inside: BoolArray, p: NormalsSettings
) -> tuple[FloatArray, FloatArray]:
    """Normals (h, w, 3) and albedo by photometric stereo under distant lights (L, 3)."""
    if p.method == "robust":
        return robust(images, lights, inside, p.robust)
    if p.method == "hanrahan_krueger":
        normals, albedo, _ = hanrahan_krueger(images, lights, inside, p.hanrahan_krueger)
        return normals, albedo
    return lambertian(images, lights, inside)


@step("normals")
def slopes_of(normals: FloatArray, photographs: FingerBand, max_slope: float) -> Slopes:
    """Slopes of normals of the rig's frame, in the frames of the pixels' rays."""
    view = view_of(photographs.capture.rig.camera, *photographs.finger.window, along_rays=True)
    own = np.moveaxis(view.turned(np.moveaxis(normals, -1, 0)[None])[0], 0, -1)
    return gradients_from_normals(own, photographs.inside, max_slope)


def near_slopes(
    photographs: FingerBand, p: NormalsSettings, height: HeightSettings
) -> tuple[Slopes, FloatArray, FloatArray]:
    """Slopes, albedo and normals of one band of an opaque thing: near lights and the surface that they reach, in
    turns."""
    rig, inside = photographs.rig, photographs.inside
    if p.method != "near_light":
        lights = rig.light_vectors()
        normals, albedo = _by_rows(photographs, lambda images, rows: _distant_normals(images, lights, inside[rows], p))
        return slopes_of(normals, photographs, p.max_slope), albedo, normals
    view = view_of(photographs.capture.rig.camera, *photographs.finger.window, along_rays=True)
    near = NearLightSettings(robust=p.robust)
    surface = np.full(inside.shape, photographs.plane_mm, dtype=np.float32)

    def lit(images: FloatArray, rows: slice) -> tuple[FloatArray, FloatArray]:
        return _near_normals(images, rig, surface[rows], inside[rows], settings=near, view=view.of_rows(rows))

    distant = all(led.position_mm is None for led in rig.leds)
    for turn in range(rounds := 1 if distant else p.rounds):
        normals, albedo = _by_rows(photographs, lit)
        slopes = gradients_from_normals(normals, inside, p.max_slope)
        if turn < rounds - 1:
            surface = integrated(slopes, photographs, height) + np.float32(photographs.plane_mm)
    return slopes, albedo, view.in_rig(normals)


@step("surface")
def integrated(slopes: Slopes, photographs: FingerBand, p: HeightSettings) -> FloatArray:
    """(h, w) heights in mm of slopes: masked least squares, or Frankot-Chellappa."""
    if p.method == "frankot_chellappa":
        return frankot_chellappa(*slopes, photographs.inside, p.padding) * photographs.pitch_mm
    certainty = 1.0 / np.square(1.0 + slopes[0] ** 2 + slopes[1] ** 2)  # 1 / variance of a slope, of a normal's noise
    return poisson(*slopes, photographs.inside, certainty, p.poisson) * photographs.pitch_mm


@step("surface")
def ridge_relief(slopes: Slopes, photographs: FingerBand, p: ShapeletSettings) -> FloatArray:
    """(h, w) relief in mm that a bank of shapelets extracts from slopes (thesis, section 3.3.1.3)."""
    return shapelets(*slopes, photographs.inside, _bank(photographs, p)) * photographs.pitch_mm


@step("surface")
def fast_part(height_mm: FloatArray, photographs: FingerBand) -> FloatArray:
    """(h, w) relief in mm of a surface that is not split: its height less its slow part, for pictures and prints.

    The slow part is a Gaussian mean, and that of what the first one missed beside the outline and on the curved finger.
    """
    sigma_px = SLOW_MM * photographs.px_per_mm
    rest = height_mm - smoothed(height_mm, photographs.inside, sigma_px)
    return rest - smoothed(rest, photographs.inside, sigma_px)


def ridge_response(photographs: FingerBand, p: ShapeletSettings) -> Callable[[NDArray[np.float64]], Any]:
    """Gain of the shapelets by frequency; beyond their finest scale it stays, so that a crossover keeps all detail."""
    bank = _bank(photographs, p)
    return lambda omega: shapelet_response(np.minimum(omega, np.sqrt(2.0) / bank.sigma_px), bank)


def _bank(photographs: FingerBand, p: ShapeletSettings) -> ShapeletSettings:
    """The shapelets at the photographs' scale; the thesis gives them in its own pixels."""
    return replace(p, sigma_px=p.sigma_px * (photographs.px_per_mm / REFERENCE_PX_PER_MM))


_linear_grey = step("light")(linear_stack)
_near_normals = step("normals")(near_light)


def undoes_blur(material: str, skin: SkinSettings) -> bool:
    """Whether subsurface scattering is undone: as the settings say, else where the capture's material is skin."""
    return material == "skin" if skin.invert_blur is None else skin.invert_blur


@step("light")
def _linear_images(capture: Capture, bands: tuple[Band, ...], finger: Finger, p: MetricSettings) -> SkinImages:
    """Linear images of the bands on the working grid."""
    require(
        not bands[0].colours,
        "the skin blurs the light of each coloured LED differently, which this preset does not undo; use lin, ea "
        "or another of the published cases.",
    )
    return working_images(capture, bands, finger.window, finger.inside, p)


@step("surface")
def _skin_surface(images: SkinImages, skin: SkinSettings, p: MetricSettings) -> FingerSurface:
    """The surface of skin by :func:`metric_skin`, on the window's pixels."""
    networks = _reporting(images.networks, p.rounds)
    if images.crossed is None:
        found = metric_skin(images.bands, images.grid, skin, p, networks)
    else:
        found = metric_polarised(images, skin, p, networks)
    shape_mm, ridge_mm, albedo = (images.on_pixels(part) for part in (found.shape_mm, found.relief_mm, found.albedo))
    deviation_um = images.on_pixels(found.deviation_mm) * np.float32(1000.0)
    facts = {
        "shape_source": "nir" if len(images.bands) > 1 else "white",
        "separation": SEPARATED_BY[found.facts["relief_by"]],
        "heights": "measured" if found.facts["relief_by"] == "polarised" else "modelled",
        "optics": found.facts,
    }
    some = found.relief_mm[images.grid.mask > 0.5]
    relief_um = 1000.0 * float(np.subtract(*np.percentile(some, (95, 5)))) if some.size else 0.0
    remedy = (
        "give --material opaque for what is no living skin (a cast, a render), else check --px-per-mm, and take colour "
        "photographs, as grey ones leave glare in the relief"
    )
    faint: tuple[str, ...] = ()
    if images.crossed is not None and found.facts["relief_by"] != "polarised":
        faint = (NO_SPECULAR,)
    notes = (*faint, *images.warnings, *_doubts_of(found.facts), *RELIEF.notes(relief_um, remedy))
    return FingerSurface(shape_mm + ridge_mm, ridge_mm, shape_mm, albedo, None, deviation_um, facts, notes)


def _reporting(networks: Networks | None, rounds: int) -> Networks | None:
    """The networks, each run of the relief's one reported as progress."""
    if networks is None:
        return None
    relief, runs, done = networks.relief, max(rounds, len(TURNED)) + 1, 0

    def reported(fields: FloatArray) -> FloatArray:
        nonlocal done
        output, done = relief(fields), done + 1
        steps.report("surface", min(done / (runs + 1), 1.0))
        return output

    return replace(networks, relief=reported)


def _doubts_of(facts: Mapping[str, Any]) -> tuple[str, ...]:
    """Warnings where the ridges' heights are hardly known, or only up to a common factor."""
    if facts["relief_by"] != "network":
        return ()
    error, relief, gain = facts["relief_error_um"], facts["relief_rms_um"], facts["gain_uncertainty"]
    notes: list[str] = []
    if error > DOUBTFUL * relief:
        hardly = "the ridges are hardly measured: {:.0f um} rms with an expected error of {:.0f um}."
        notes.append(Note(hardly, relief / 1000.0, error / 1000.0))
    if facts["gloss"] < LITTLE_GLOSS:
        notes.append(
            "the skin shows hardly any specular reflection: ridge heights follow from its brightness, and may all be "
            f"off by a common factor (standard deviation {100 * gain:.0f} %)."
        )
    return tuple(notes)


def _separation_of(direct: DirectSettings, material: str) -> str:
    """How direct light was separated in the thesis's cases."""
    if direct.method != "network":
        return "none"
    if material != "skin":
        return "none (opaque material: all light is direct)"
    return f"direct light by the network '{direct.network}'"


def _with_promised_light(capture: Capture) -> Capture:
    """Where images are divided by flat ones: with the brightness that the rig's lights have on a flat surface."""
    bands = {
        name: band
        if band.flat is None
        else replace(band, promised=flat_promised(capture.rig.select(band.lights), band.flat.shape))
        for name, band in capture.bands.items()
    }
    return capture if all(band.flat is None for band in bands.values()) else replace(capture, bands=bands)


_slopes_of_shading = step("normals")(shading_slopes)


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


def _shaded_result(capture: Capture) -> Reconstruction:
    """The result of :func:`shaded_surface`, as it lies; everything in view where the capture has no mask."""
    assert capture.shading is not None
    shading = read_shading(capture.shading)
    inside = np.ones(capture.shape, dtype=bool) if capture.mask is None else capture.mask
    require(bool(inside.any()), "the mask is empty; it must be white where the object is.")
    surface = shaded_surface(capture, shading, inside)
    finger = Finger(inside, inside, np.s_[:, :], as_it_lies(inside), {}, {}, ())
    camera = replace(capture.rig.camera, px_per_mm=1.0 / shading.pitch_mm, scale_known=True)
    seen = replace(capture, rig=replace(capture.rig, camera=camera))
    return replace(_finished(seen, finger, surface, 0.0), whole=True, warnings=surface.warnings)


@step("finger")
def _views_in_mirrors(capture: Capture, mask: MaskSettings, mirror: MirrorShapeSettings) -> SeenInMirrors:
    """The finger in mirrors beside it."""
    from splitknit.mirrors.captured import seen_in_mirrors  # large, and needed where there are mirrors

    return seen_in_mirrors(capture, mask, mirror)


def _with_mirror_shape(
    finger: Finger, surface: FingerSurface, mirrors: SeenInMirrors, p: MirrorShapeSettings, detail_mm: FloatArray | None
) -> tuple[Finger, FingerSurface]:
    """The finger as far as the mirrors show it, and the surface on their shape with the detail of another."""
    from splitknit.mirrors.captured import mirror_shape_of

    shape_mm, mask, facts = mirror_shape_of(finger, mirrors, p, detail_mm)
    return replace(finger, mask=mask), replace(
        surface, height_mm=shape_mm + surface.ridge_mm, shape_mm=shape_mm, facts={**surface.facts, **facts}
    )


@step("result")
def _finished(capture: Capture, finger: Finger, surface: FingerSurface, top_mm: float) -> Reconstruction:
    """The window's surface in the full image, cut to the mask, with the normals of the knitted height."""
    mask, window, camera = finger.mask, finger.window, capture.rig.camera
    inside = mask[window]
    done = place(surface.height_mm, surface.shape_mm, inside, camera, window, top_mm)

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
        hashes=capture.hashes,
    )
