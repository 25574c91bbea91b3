"""The `metric` method: near lights on opaque things, analysis by synthesis on skin."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from splitknit import steps
from splitknit.errors import require
from splitknit.findings import Finding
from splitknit.imaging.geometry import gradients_from_normals
from splitknit.imaging.light_field import light_vectors_at
from splitknit.imaging.view import View, view_of
from splitknit.integration.knit import crossover
from splitknit.methods.photographs import FingerBand, FingerPhotographs, FingerSurface, side_unused
from splitknit.methods.photometry import (
    MAX_SLOPE,
    OPAQUE,
    by_rows,
    colour_albedo,
    distant_normals,
    integrated,
    ridge_relief,
    ridge_response,
    slopes_of,
)
from splitknit.model import BoolArray, FloatArray
from splitknit.photometric.forward import Explanation, fitted_gloss
from splitknit.photometric.near_light import near_light
from splitknit.plausible import RELIEF
from splitknit.presets import HeightSettings, NormalsSettings, Parameters, PipelineSettings
from splitknit.skin.diffusion import Diffusion, SkinSettings
from splitknit.skin.grid import BandImages, Grid, Slopes, smooth_step
from splitknit.skin.images import SEPARATED_BY, MetricSettings, SkinImages, working_images
from splitknit.skin.learned import (
    GAIN_UNCERTAINTY,
    Networks,
    features,
    refined_shape,
    relief_by_network,
    relief_network,
    relief_of_output,
    stated_deviation,
    variance_restored,
)
from splitknit.skin.light import slant_of
from splitknit.skin.polarised import polarised_heights, specular_images
from splitknit.skin.relief import KNIT_MM, ReliefEstimate, detail_of, relief_by_shading
from splitknit.skin.shape import (
    CoarseImages,
    Shape,
    coarse_images,
    coarse_shape,
    on_fine_grid,
    white_light_on,
)
from splitknit.steps import step

COLOURED = (
    "the skin blurs the light of each coloured LED differently, which this preset does not undo;"
    " use lin, ea or another of the published cases."
)
NO_SPECULAR = (
    "the difference of the parallel and the crossed series shows hardly any specular reflection"
    " (matt or wet skin, or films that are not crossed): ridge heights are modelled, as without"
    " films."
)
SIDE_MISFIT = (
    "{} of the white images lit from the side do not fit the others and are left out: check these"
    " LEDs' places and their films, if any, which must let the skin's mirror reflection pass the"
    " camera's film."
)
HARDLY_MEASURED = (
    "the ridges are hardly measured: {:.0f um} rms with an expected error of {:.0f um}."
)
LITTLE_GLOSS_NOTE = (
    "the skin shows hardly any specular reflection: ridge heights follow from its brightness, and "
    "may all be off by a common factor (standard deviation {:.0f} %)."
)
WET = (
    "{:.0f} % of the light does not fit a matt surface (up to 5 % is usual), as of a wet, glossy"
    " or very dark finger: its ridges may come out at half their height (standard deviation of the"
    " factor {:.0f} %); dry it, or use polarising films."
)
ODD_RELIEF = (
    "give `material` opaque for what is not live skin (a cast, a render), else check `px_per_mm`, "
    "and take colour photographs, as grey ones leave glare in the relief"
)
GLOSSY = (
    "the object shines: a lobe of gloss, one for the whole object, explains the photographs to"
    " {:.1f} %; it is used, and bends the surface where materials differ."
)
NO_WHITE = (
    "the images lit from the side are not used: the skin is too dry or too matt for its specular"
    " reflection to be separated by colour (films separate it)."
)


def metric_opaque(white: FingerBand, nir: FingerBand, p: Parameters) -> FingerSurface:
    """The `metric` method for opaque things: near lights, robust weights, masked integration.

    A near-infrared band, where there is one, gives the shape by a crossover of frequencies. On
    glossy things a lobe of gloss is fitted together with the normals.
    """
    slopes, albedo, normals, gloss = near_slopes(white, p.photometry.normals, p.height)
    findings = (*doubt_of_walls(*slopes, white.inside), *note_of_gloss(gloss))
    height_mm = integrated(slopes, white, p.height)
    relief = ridge_relief(slopes, white, p.shapelets)
    if nir != white:
        shape = integrated(near_slopes(nir, p.photometry.normals, p.height)[0], nir, p.height)
        height_mm = crossover(height_mm, shape, ridge_response(white, p.shapelets), white.inside)
    shape, colour = height_mm - relief, colour_albedo(white, albedo)
    return FingerSurface(height_mm, relief, shape, albedo, normals, colour, findings=findings)


def note_of_gloss(gloss: Explanation | None) -> tuple[Finding, ...]:
    """That a lobe of gloss is part of the model."""
    if gloss is None:
        return ()
    return (Finding("glossy", GLOSSY.format(100 * gloss.misfit)),)


WALL_PART = 0.002  # fraction of a surface whose slopes are cut from which it has walls
WALL_OF_STEEP = 0.25
"""Fraction of the pixels steeper than a quarter of the longest slope whose slopes are cut, from
which a surface has walls: 0.09 on the ball, 0.6 to 0.8 on the coins. Chosen on: simulated objects
(a ball, coins with rims of 80 to 89 deg). Range: 0.09 to 0.6."""


def doubt_of_walls(
    gradient_x: FloatArray,
    gradient_y: FloatArray,
    inside: BoolArray,
) -> tuple[Finding, ...]:
    """A note where the surface (h, w) has walls, as a coin's rim: slopes longer than `MAX_SLOPE`,
    which are cut.

    A ball has few of these (3 % of its view) beside many slopes that are nearly as steep.
    """
    steepness = np.hypot(gradient_x, gradient_y)[inside]
    cut = int((steepness > 0.999 * MAX_SLOPE).sum())
    steep = int((steepness > 0.25 * MAX_SLOPE).sum())
    if cut < WALL_PART * inside.sum() or cut < WALL_OF_STEEP * steep:
        return ()
    message = (
        f"the object has steep walls: {100 * cut / steepness.size:.1f} % of the surface is steeper"
        f" than {np.rad2deg(np.arctan(MAX_SLOPE)):.0f} deg, where slopes are cut, so that heights"
        " drop too little there; give a `mask` that ends inside a rim, or photograph walls from"
        " another side."
    )
    return (Finding("steep-walls", message),)


@dataclass(frozen=True, slots=True, eq=False)
class SkinSurface:
    """Reconstructed skin on the working grid; heights are finite everywhere and valid inside the
    mask."""

    shape_mm: FloatArray
    relief_mm: FloatArray
    deviation_mm: FloatArray
    """Standard deviation of the relief: noise, what denoising removed, and model error."""
    albedo: FloatArray  # brightness of one channel of the white band, relative
    facts: Mapping[str, Any]


RELIEF_ROUNDS = 2  # estimates of the relief


def metric_skin(
    bands: tuple[BandImages, ...],
    grid: Grid,
    skin: SkinSettings,
    p: MetricSettings,
    networks: Networks | None = None,
) -> SkinSurface:
    """The `metric` method for skin: analysis by synthesis.

    The current surface predicts what photometric stereo measures on it behind the skin's
    scattering; the residual corrects it: first the shape on a coarse grid, from all bands, then the
    relief on a fine grid, from the white band.

    `bands`: the white band first (red, green, blue, or one channel called ``green``), then
    near-infrared if there is one; `grid`: fine grid of the images; `skin`: assumed optics; `p`:
    grids and iterations; `networks`: that estimate the relief and refine the shape
    (:mod:`splitknit.skin.learned`); without them, the relief follows from the shading of the white
    band's last channel, blue.
    """
    images = coarse_images(bands, grid, p.plane_mm)
    shape = coarse_shape(images, skin.optics(images.channels), p.coarse_steps)
    white = bands[0].channels
    colour = {name: shape.brightness[name] / shape.brightness[white[0]] for name in white}
    optics = skin.optics(images.channels, colour)
    if networks is None:
        smooth = on_fine_grid(shape.height_mm, images)
        light = white_light_on(shape.height_mm, images)
        estimate = relief_by_shading(images.white, grid, smooth, light, optics[white[-1]])
    else:
        rounds = p.rounds or RELIEF_ROUNDS
        smooth, estimate = relief_and_shape(images, shape, optics, networks, rounds)
    detail = detail_of(smooth, estimate.trust, grid)  # of the shape, beyond the crossover: creases
    facts = {
        "scattering_per_mm": {name: optics[name].scattering_per_mm for name in sorted(optics)},
        "absorption_per_mm": {name: optics[name].absorption_per_mm for name in sorted(optics)},
        "colour": colour,
        "glare": dict(shape.glare),
        **estimate.facts,
    }
    return SkinSurface(
        smooth - detail, estimate.relief_mm + detail, estimate.deviation_mm, estimate.albedo, facts
    )


SIDE_ROUNDS = 3
"""Estimates of the relief behind films with lights to the side: the second refinement of the shape
adds a seventh of the first, a third hardly anything. Surfaces of nine simulated fingers differ by
-1.8 [-3.2, -0.4] um of 51, ridges below 60 deg by +0.07 [-0.10, 0.25] um of 4.6; the surface of a
path-traced one by -5 um of 24. With front lights alone a third may worsen the surface
(docs/explain/tried.md). Chosen on: simulated fingers (seeds 8101 to 8105 of
validation/path_traced/polarised.py, not 7101, 7102, 7107 and 7108). Range: 3 to 4."""
UNKNOWN_MM = 0.02  # standard deviation of the relief where no network gives a first one
FAINT = 3.0  # specular reflection over noise below which heights do not follow from it


def metric_polarised(
    images: SkinImages, skin: SkinSettings, p: MetricSettings, networks: Networks | None = None
) -> SkinSurface:
    """The `metric` method behind films.

    The crossed series gives the shape, without specular reflection, and both together a first
    relief; from there their difference, the specular image, measures the heights. Where there is
    hardly any specular reflection (matt or wet skin), the result is that of :func:`metric_skin`.

    `images`: whose `bands` are as without films, and whose `crossed` is not None. `skin`, `p`,
    `networks`: as for :func:`metric_skin`.
    """
    crossed, grid, side = images.crossed, images.grid, images.side
    assert crossed is not None
    white = replace(crossed, unpolarised=images.bands[0])
    rounds = p.rounds or (RELIEF_ROUNDS if side is None else SIDE_ROUNDS)
    first = metric_skin((white, *images.bands[1:]), grid, skin, replace(p, rounds=rounds), networks)
    start = first
    if networks is None:  # a relief by shading alone would lead astray
        start = replace(
            first,
            relief_mm=0 * first.relief_mm,
            deviation_mm=np.full_like(first.deviation_mm, UNKNOWN_MM),
        )
    height_mm, error_mm, fit = _specular_heights(
        images, (crossed, side and side[1]), start, films=True
    )
    if fit["specular_over_noise"] < FAINT:
        modelled = metric_skin(images.bands, grid, skin, p, networks)
        return replace(modelled, facts={**modelled.facts, "specular": fit})
    rest = height_mm - first.shape_mm
    return _with_heights(first, rest, error_mm, grid, relief_by="polarised", specular=fit)


WHITE_ROUGHNESS = 0.45
"""Roughness up to which white light shows ridges better than the front lights alone."""
WHITE_SCATTERED = 10.0
"""Scattered over specular light up to which white light shows ridges better: beyond either limit
one of eight fingers gets worse."""
RED_PART = 0.5
"""Part of the red light, in the colour of the skin, that is taken from the blue to leave white
light. Chosen on: path-traced fingers (validation/path_traced/polarised.py). Range: 0.3 to 0.65."""
SHAPE_MM = 2.0
"""Standard deviation of the Gaussian mean of the heights that white light does not show: it follows
from how much of the light is scattered, which colours show only roughly. Chosen on: simulated
fingers (and path-traced ones, docs/explain/tried.md)."""
COLOUR_MM = 1.0  # standard deviation of the Gaussian mean whose colour is that of the skin


def metric_side(
    images: SkinImages, skin: SkinSettings, p: MetricSettings, networks: Networks | None = None
) -> SkinSurface:
    """The `metric` method under lights to the side, without films.

    As :func:`metric_polarised`, but the specular image is what is white in the photographs, with
    light of short paths in the skin, and contributes to the shape only detail finer than
    `SHAPE_MM`.

    `images`: whose `side` is not None, and `crossed` None.
    """
    grid, white, side = images.grid, images.bands[0], images.side
    assert side is not None
    first = metric_skin(images.bands, grid, skin, p, networks)
    red, blue = (grid.smooth(white.stack[c].mean(axis=0), grid.mask, COLOUR_MM) for c in (0, 2))
    part = RED_PART * blue / np.maximum(red, 1e-6)
    matt = without_white(white, part), without_white(side[0], part)
    height_mm, error_mm, fit = _specular_heights(images, matt, first, films=False)
    used = (
        fit["specular_over_noise"] >= FAINT
        and fit["roughness"] <= WHITE_ROUGHNESS
        and fit["scattered_over_specular"] <= WHITE_SCATTERED
        and fit["side_lights"]
    )
    if not used:
        return replace(first, facts={**first.facts, "specular": fit})
    rest = height_mm - first.shape_mm
    rest -= grid.smooth(rest, grid.mask, SHAPE_MM)
    return _with_heights(first, rest, error_mm, grid, relief_by="side", specular=fit)


def _with_heights(
    first: SkinSurface, rest: FloatArray, error_mm: FloatArray, grid: Grid, **facts: Any
) -> SkinSurface:
    """The first surface with what heights measured by the specular image have beyond its shape."""
    slow = grid.smooth(rest, grid.mask, KNIT_MM)
    return SkinSurface(
        first.shape_mm + slow, rest - slow, error_mm, first.albedo, {**first.facts, **facts}
    )


def _specular_heights(
    images: SkinImages, matt: tuple[BandImages, BandImages | None], start: SkinSurface, films: bool
) -> tuple[FloatArray, FloatArray, dict[str, float]]:
    """What :func:`polarised_heights` finds from `start`; `matt`: the white band, and that under
    lights to the side, without specular reflection."""
    grid = images.grid
    shape_mm = start.shape_mm
    specular = specular_images(images.bands[0], matt[0], images.parallel, grid, shape_mm)
    if images.side is not None:
        assert matt[1] is not None
        both, _, rig = images.side
        of_side = specular_images(both, matt[1], rig, grid, shape_mm)
        specular = replace(
            specular,
            stack=np.concatenate([specular.stack, of_side.stack]),
            rig=replace(specular.rig, leds=specular.rig.leds + of_side.rig.leds),
            noise=min(specular.noise, of_side.noise),
        )
    return polarised_heights(specular, grid, shape_mm + start.relief_mm, start.deviation_mm, films)


def without_white(band: BandImages, part: FloatArray) -> BandImages:
    """Images (red, green, blue) less what is white in them, blue less `part` (h, w) of the red:
    about as behind crossed films."""
    return replace(band, stack=band.stack - (band.stack[2] - part * band.stack[0]) / 2)


_TURNED = (1, 3)
"""Quarter turns averaged with the upright image in the relief estimate."""


def relief_and_shape(
    images: CoarseImages,
    shape: Shape,
    optics: Mapping[str, Diffusion],
    networks: Networks,
    rounds: int,
) -> tuple[FloatArray, ReliefEstimate]:
    """Smooth shape (h, w) on the fine grid and the relief on it by networks, each from the other.

    The relief network runs on the first shape alone: upright, as input to the shape network, then
    in two more orientations, averaged with it. On the refined shape only what is computed from its
    output changes. A minimum-mean-square-error estimate shrinks, so its variance is restored. Of a
    crossed series, the last step re-estimates the relief from the images without films; the two
    estimates differ.
    """
    grid, network, films = images.fine, networks.relief, images.white.unpolarised
    refinements = rounds - 1 if networks.shape is not None else 0
    if films is not None and not refinements:
        images, films = replace(images, white=films), None
    smooth = on_fine_grid(shape.height_mm, images)
    light = features(images.white, grid, smooth, white_light_on(shape.height_mm, images))
    upright, levels = network(light.fields), light.level[:2] * grid.mask
    output = (
        upright if films is not None else relief_network(network, _TURNED, upright)(light.fields)
    )
    del light
    first = relief_of_output(upright, levels, grid, smooth)
    for _ in range(refinements):
        assert networks.shape is not None
        shape = refined_shape(shape, first.relief_mm, images, optics, networks.shape)
        smooth = on_fine_grid(shape.height_mm, images)
    if films is None:
        return smooth, variance_restored(relief_of_output(output, levels, grid, smooth))
    light = features(
        films, grid, smooth, white_light_on(shape.height_mm, replace(images, white=films))
    )
    relief = relief_by_network(light, grid, smooth, relief_network(network, _TURNED))
    relief = variance_restored(relief)
    of_crossed = variance_restored(first).relief_mm - relief.relief_mm
    # beyond 30 deg the first estimate is too low and the second too high: from 40 deg on their mean
    part = smooth_step((slant_of(smooth, grid.pitch_mm) - 30.0) / 10.0) / 2
    return smooth, replace(relief, relief_mm=relief.relief_mm + part * of_crossed)


def opaque_surface(photographs: FingerPhotographs, settings: PipelineSettings) -> FingerSurface:
    """The surface of an opaque thing."""
    white, nir = photographs.white_and_nir(settings, settings.metric.plane_mm)
    parameters = settings.parameters(bool(white.light.colours), white.material)
    surface = metric_opaque(white, nir, parameters)
    shape_source = "white" if nir == white else "nir"
    stated = photographs.finger.facts
    places_sd = stated.get("light_places_sd", 0.0)
    misfit = stated.get("matt_misfit", _UNSEEN_MISFIT)
    factor_sd = math.hypot(min(math.sqrt(misfit), _LARGEST_FACTOR), places_sd)
    tilt_sd = min(_TILT_OF_FACTOR * factor_sd, _LARGEST_TILT)
    facts = {
        "shape_source": shape_source,
        "separation": OPAQUE,
        "heights": "measured",
        "height_factor_sd": round(factor_sd, 3),
    }
    deviation_um = factor_deviation_um(
        surface.height_mm, white.inside, white.pitch_mm, factor_sd, tilt_sd
    )
    findings = (*surface.findings, *_note_of_factor(factor_sd, tilt_sd))
    return replace(surface, uncertainty_um=deviation_um, facts=facts, findings=findings)


_UNSEEN_MISFIT = 0.06  # where too few photographs show it: that of DiLiGenT's bear
_NOTED_FACTOR = 0.1
_LARGEST_FACTOR = 0.5
"""Shading that is not matt bends slopes by a factor, whose standard deviation is about the root of
a matt surface's misfit, up to this. Errors of the factor's logarithm, in units of the stated
deviation, have an rms of 0.85, 22 of 24 within two, on DiLiGenT's bear and ball, 14 rendered
objects of gloss and metal, and eight matt ones (validation/objects)."""
_TILT_OF_FACTOR = 0.1  # deviation of the whole's tilt, in rad, over the factor's
_LARGEST_TILT = 0.02  # in rad: up to 1.4 deg on the same objects
FACTOR = (
    "all heights may be off by one factor, by {:.0f} % (standard deviation), and the whole tilted"
    " by {:.1f} deg: gloss, a tone curve of the camera and ambient light bend the shading in the"
    " same way; compare a height that you know."
)


def _note_of_factor(factor_sd: float, tilt_sd: float) -> tuple[Finding, ...]:
    if factor_sd < _NOTED_FACTOR:
        return ()
    words = FACTOR.format(100 * factor_sd, math.degrees(tilt_sd))
    return (Finding("height-factor", words),)


def factor_deviation_um(
    height_mm: FloatArray, inside: BoolArray, pitch_mm: float, factor_sd: float, tilt_sd: float
) -> FloatArray:
    """(H, W) standard deviation in um of heights whose common factor, and whose tilt in rad along
    either axis, have these standard deviations."""
    rows, columns = np.indices(height_mm.shape, dtype=np.float32)
    fields = np.stack([height_mm, pitch_mm * columns, pitch_mm * rows])
    fields -= fields[:, inside].mean(axis=1)[:, None, None]
    fields *= np.array([factor_sd, tilt_sd, tilt_sd], dtype=np.float32)[:, None, None]
    return np.asarray(1000.0 * np.sqrt((fields * fields).sum(axis=0)), dtype=np.float32)


JPEG_LOSS = 0.3
"""Fraction of the relief that JPEG may have taken, as a standard deviation: 0.06 to 0.31 was taken
at 15 to 30 px/mm. Chosen on: simulated fingers (two, qualities of 60 to 97). Range: 0.06 to
0.31."""
JPEG_LOSS_COARSE = 0.9
"""Fraction of the relief that JPEG may have taken below `JPEG_COARSE` px/mm: 0.75 and more at 11.
Chosen on: simulated fingers (two, qualities of 60 to 97)."""
JPEG_COARSE = 14.0
"""Scale below which JPEG takes far more of the relief, in px/mm. Chosen on: simulated fingers (two,
qualities of 60 to 97). Range: 11 to 15."""

WET_RESIDUAL = (0.05, 0.12)
"""Fraction of a finger's light that fits no matt surface at which the factor of its ridges' heights
is as well known as ever, and as badly as of a wet one. Measured: 0.01 to 0.03, dark skin 0.05, half
wet 0.08 to 0.10, wet 0.12 to 0.15. Chosen on: simulated fingers (21), two path-traced ones."""
WET_GAIN = 0.6
"""Standard deviation of that factor on wet fingers. Ridges came out 0.38 to 0.54 times as high,
half wet 0.52 to 0.88, glossy 0.71 to 0.93. Chosen on: the same fingers."""


def skin_surface(photographs: FingerPhotographs, settings: PipelineSettings) -> FingerSurface:
    """The surface of skin."""
    require(not photographs.observation.white.colours, COLOURED)
    finger, bands = photographs.finger, photographs.bands(settings)
    side = photographs.observation.side
    images = working_images(bands, side, finger.window, finger.inside, settings.metric)
    unused = () if side is None or images.side is not None else (side_unused(side.photographs),)
    jpeg_loss = 0.0
    if "jpeg" in finger.facts:
        coarse = photographs.observation.rig.camera.px_per_mm < JPEG_COARSE
        jpeg_loss = JPEG_LOSS_COARSE if coarse else JPEG_LOSS
    unexplained = finger.facts.get("light_residual", 0.0)
    wet_sd = float(np.interp(unexplained, WET_RESIDUAL, (0.0, WET_GAIN)))
    surface = _on_pixels(images, settings, jpeg_loss, wet_sd)
    wet: tuple[Finding, ...] = ()
    if wet_sd > 0.25 and surface.facts["optics"]["relief_by"] == "network":
        factor = surface.facts["optics"]["gain_uncertainty"]
        wet = (Finding("wet-finger", WET.format(100 * unexplained, 100 * factor)),)
    return replace(surface, findings=(*unused, *wet, *surface.findings))


def undoes_blur(material: str, skin: SkinSettings) -> bool:
    """Whether subsurface scattering is undone: as the settings say, else where the capture's
    material is skin."""
    return material == "skin" if skin.invert_blur is None else skin.invert_blur


@step("surface")
def _on_pixels(
    images: SkinImages, settings: PipelineSettings, jpeg_loss: float, wet_sd: float
) -> FingerSurface:
    """The surface of skin, on the window's pixels; `jpeg_loss`: fraction of the relief's height,
    `wet_sd`: standard deviation of its factor by wetness."""
    skin, p = settings.skin, settings.metric
    networks = _reporting(images.networks)
    if images.crossed is not None:
        surface = metric_polarised(images, skin, p, networks)
    elif images.side is not None:
        surface = metric_side(images, skin, p, networks)
    else:
        surface = metric_skin(images.bands, images.grid, skin, p, networks)
    shape_mm = images.on_pixels(surface.shape_mm)
    ridge_mm = images.on_pixels(surface.relief_mm)
    relief_by = surface.facts["relief_by"]
    deviation_mm = surface.deviation_mm
    if relief_by == "network":
        gain = math.hypot(GAIN_UNCERTAINTY, wet_sd)
        surface = replace(surface, facts={**surface.facts, "gain_uncertainty": gain})
        deviation_mm = stated_deviation(surface.relief_mm, deviation_mm, images.grid, gain)
    deviation_mm = np.hypot(images.on_pixels(deviation_mm), jpeg_loss * ridge_mm)
    return FingerSurface(
        shape_mm + ridge_mm,
        ridge_mm,
        shape_mm,
        images.on_pixels(surface.albedo),
        uncertainty_um=deviation_mm * 1000.0,
        facts={
            "shape_source": "nir" if len(images.bands) > 1 else "white",
            "separation": SEPARATED_BY[relief_by],
            "heights": "measured" if relief_by == "polarised" else "modelled",
            "optics": surface.facts,
        },
        findings=_findings_on(images, surface),
    )


def _reporting(networks: Networks | None) -> Networks | None:
    """The networks; each run of the relief network is reported as progress."""
    if networks is None:
        return None
    relief, runs, done = networks.relief, len(_TURNED) + 1, 0

    def reported(fields: FloatArray) -> FloatArray:
        nonlocal done
        output, done = relief(fields), done + 1
        steps.report("surface", min(done / (runs + 1), 1.0))
        return output

    return replace(networks, relief=reported)


LITTLE_GLOSS = 0.015
"""Mean specular reflection over the diffuse light, as the network estimates it, below which there
may be none. Chosen on: simulated fingers (boundaries of all kinds)."""
DOUBTFUL = 0.5
"""Expected error of the relief, over the relief's rms height, from which a warning is due."""


def _findings_on(images: SkinImages, surface: SkinSurface) -> tuple[Finding, ...]:
    """Notes where the ridges' heights are hardly known, known up to a common factor, or odd."""
    facts = surface.facts
    notes = [*images.findings]
    modelled = facts["relief_by"] not in {"polarised", "side"}
    if modelled and "specular" in facts:
        unused = NO_WHITE if images.crossed is None else NO_SPECULAR
        notes.insert(0, Finding("specular-unused", unused))
    if images.side is not None:
        fitting = facts.get("specular", {}).get("side_lights", 0)
        misfits = round(len(images.side[2].leds) - fitting)
        if misfits and not (fitting and modelled):  # else the note above says why they are unused
            notes.append(Finding("side-misfit", SIDE_MISFIT.format(misfits)))
    if facts["relief_by"] == "network":
        error, relief = facts["relief_error_um"], facts["relief_rms_um"]
        if error > DOUBTFUL * relief:
            lengths = (relief / 1000.0, error / 1000.0)
            notes.append(Finding("hardly-measured", HARDLY_MEASURED, lengths_mm=lengths))
        if facts["gloss"] < LITTLE_GLOSS:
            little = LITTLE_GLOSS_NOTE.format(100 * facts["gain_uncertainty"])
            notes.append(Finding("little-gloss", little))
    heights = surface.relief_mm[images.grid.mask]
    relief_um = (
        1000.0 * float(np.subtract(*np.percentile(heights, (95, 5)))) if heights.size else 0.0
    )
    return (*notes, *RELIEF.notes(relief_um, ODD_RELIEF))


def near_slopes(
    photographs: FingerBand, p: NormalsSettings, height: HeightSettings
) -> tuple[Slopes, FloatArray, FloatArray, Explanation | None]:
    """Slopes, albedo, normals and gloss of one band of an opaque thing: near lights and the surface
    that they reach, in turns."""
    rig, inside = photographs.rig, photographs.inside
    if p.method != "near_light":
        lights = rig.light_vectors()
        normals, albedo = by_rows(
            photographs,
            lambda images, rows: distant_normals(images, lights, inside[rows], p),
            without_clipped=p.method == "robust",
        )
        return slopes_of(normals, photographs), albedo, normals, None
    view = view_of(rig.camera, *photographs.finger.window, along_rays=True)
    surface = np.full(inside.shape, photographs.plane_mm, dtype=np.float32)

    def lit(images: FloatArray, rows: slice) -> tuple[FloatArray, FloatArray]:
        own = view.of_rows(rows)
        return _near_normals(images, rig, surface[rows], inside[rows], view=own, gloss=gloss)

    gloss = gloss_of(photographs, view)
    distant = all(led.position_mm is None for led in rig.leds)
    # rounds of near-light photometric stereo and integration
    for turn in range(rounds := 1 if distant else 3):
        normals, albedo = by_rows(photographs, lit, without_clipped=True)
        slopes = gradients_from_normals(normals, inside, MAX_SLOPE)
        if turn < rounds - 1:
            surface = integrated(slopes, photographs, height) + photographs.plane_mm
    return slopes, albedo, view.in_rig(normals), gloss


GLOSS_PIXELS = 10_000  # enough for a lobe, and quick


@step("normals")
def gloss_of(photographs: FingerBand, view: View) -> Explanation | None:
    """The lobe of a thing that shines, from some of its pixels under white lights; None of a matt
    one."""
    light, inside = photographs.light, photographs.inside
    if light.colours or light.crossed is not None:
        return None
    every = max(1, round(float(np.sqrt(inside.sum() / GLOSS_PIXELS))))
    chosen = np.zeros_like(inside)
    chosen[::every, ::every] = inside[::every, ::every]
    few = light.sampled(every)
    images = np.where(few.clipped, 0.0, few.grey)[:, inside[::every, ::every]]
    x, y, z = view.points(np.full(inside.shape, photographs.plane_mm, dtype=np.float32))
    vectors = light_vectors_at(photographs.rig, x[chosen], y[chosen], z[chosen])
    return fitted_gloss(images.astype(np.float32), view.turned(vectors, where=chosen))


_near_normals = step("normals")(near_light)
