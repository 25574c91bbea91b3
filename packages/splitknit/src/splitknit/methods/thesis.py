"""The thesis's cases: EA and PR, and Split and Knit.

References
----------
A. Srivastava, "Split and Knit Algorithm for 3D fingerprint reconstruction using Single Camera",
chapters 3 and 5.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from splitknit.finger.contrast import clahe
from splitknit.imaging.geometry import smoothed
from splitknit.integration.knit import add, crossover
from splitknit.methods.photographs import FingerBand, FingerPhotographs, FingerSurface
from splitknit.methods.photometry import (
    by_rows,
    distant_normals,
    fast_part,
    grey_light,
    integrated,
    ridge_relief,
    ridge_response,
    slopes_of,
)
from splitknit.model import Array, FloatArray
from splitknit.observation.coloured import balanced
from splitknit.presets import (
    DirectSettings,
    EnhanceSettings,
    Parameters,
    Photometry,
    PipelineSettings,
)
from splitknit.separation.direct import direct_light
from splitknit.skin.grid import Slopes
from splitknit.steps import keep, step


def ea(white: FingerBand, _: FingerBand, p: Parameters) -> FingerSurface:
    """EA and PR (thesis, section 5.4): the visible surface, whole.

    EA is photometric stereo and integration; PR adds contrast enhancement and direct light. The
    systems of Kumar, Zheng and Lin are EA with other parameters (:mod:`splitknit.presets`).
    """
    normals, albedo = visible_normals(white, p.photometry)
    height_mm = integrated(slopes_of(normals, white), white, p.height)
    relief = fast_part(height_mm, white)
    return FingerSurface(height_mm, relief, height_mm - relief, albedo, normals, whole=True)


def ea_split(white: FingerBand, _: FingerBand, p: Parameters) -> FingerSurface:
    """EA or PR with the relief that shapelets extract from the visible surface, as in Split and
    Knit."""
    normals, albedo = visible_normals(white, p.photometry)
    slopes = slopes_of(normals, white)
    height_mm = integrated(slopes, white, p.height)
    relief = ridge_relief(slopes, white, p.shapelets)
    return FingerSurface(height_mm, relief, height_mm - relief, albedo, normals)


def snk(white: FingerBand, nir: FingerBand, p: Parameters) -> FingerSurface:
    """Split and Knit (thesis, chapter 3): relief from direct white light, shape from near-infrared
    light."""
    normals, albedo = visible_normals(white, p.photometry)  # 3.3.1
    relief = ridge_relief(slopes_of(normals, white), white, p.shapelets)  # 3.3.1.3
    shape = integrated(shape_slopes(nir, p.photometry), nir, p.height)  # 3.3.2
    return FingerSurface(add(relief, shape, white.inside), relief, shape, albedo, normals)  # 3.3.3


def snk_by_crossover(white: FingerBand, nir: FingerBand, p: Parameters) -> FingerSurface:
    """Split and Knit by a crossover of frequencies: H visible + (1 - H) shape, H the gain of the
    shapelets."""
    normals, albedo = visible_normals(white, p.photometry)
    shape = integrated(shape_slopes(nir, p.photometry), nir, p.height)
    visible = integrated(slopes_of(normals, white), white, p.height)
    height_mm = crossover(visible, shape, ridge_response(white, p.shapelets), white.inside)
    return FingerSurface(height_mm, height_mm - shape, shape, albedo, normals)


CASES = {"whole": ea, "none": ea_split, "addition": snk, "crossover": snk_by_crossover}
"""The thesis's cases by ``knit.method``."""


def thesis_surface(photographs: FingerPhotographs, settings: PipelineSettings) -> FingerSurface:
    """The case that the settings name."""
    white, nir = photographs.white_and_nir(settings, plane_mm=0.0)
    parameters = settings.parameters(bool(white.light.colours), white.material)
    surface = CASES[settings.knit.method](white, nir, parameters)
    facts = {
        "shape_source": "white" if nir == white else "nir",
        "separation": _separation_of(settings.direct, white.material),
        "heights": "measured",
    }
    return replace(smoothed_surface(surface, white, settings.smooth.sigma_mm), facts=facts)


@step("surface")
def smoothed_surface(surface: FingerSurface, white: FingerBand, sigma_mm: float) -> FingerSurface:
    """Kumar's system: a Gaussian over the finished surface; the same surface for a sigma of
    zero."""
    if sigma_mm == 0:
        return surface
    sigma_px = sigma_mm * white.px_per_mm
    height_mm, ridge_mm = (
        smoothed(part, white.inside, sigma_px) for part in (surface.height_mm, surface.ridge_mm)
    )
    return replace(surface, height_mm=height_mm, ridge_mm=ridge_mm, shape_mm=height_mm - ridge_mm)


def visible_normals(white: FingerBand, p: Photometry) -> tuple[FloatArray, FloatArray]:
    """Normals (h, w, 3) and albedo of the direct visible light (thesis, section 3.3.1)."""
    if not p.prepares:
        lights, inside = white.rig.light_vectors(), white.inside

        def solve(images: FloatArray, rows: slice) -> tuple[FloatArray, FloatArray]:
            return distant_normals(np.maximum(images, 0.0), lights, inside[rows], p.normals)

        return by_rows(white, solve)
    images = _grey_images(white)
    if p.balance:
        images = balanced(images, white.rig, white.finger.mask[white.finger.window])
    if p.enhance.clahe:
        enhanced = images = _equalised(images, white, p.enhance)
        keep("enhanced", lambda: enhanced)
    if p.direct.method == "network":
        whole, direct = images, _direct_images(images, white, p.direct)
        keep("direct", lambda: direct)
        keep("global", lambda: whole * white.inside - direct)
        images = direct
    return distant_normals(images, _lights(white, p.enhance), white.inside, p.normals)


def shape_slopes(nir: FingerBand, p: Photometry) -> Slopes:
    """Slopes from the band of the shape (thesis, section 3.3.2)."""
    normals, _ = distant_normals(_grey_images(nir), _lights(nir, p.enhance), nir.inside, p.normals)
    return slopes_of(normals, nir)


def _lights(photographs: FingerBand, enhance: EnhanceSettings) -> Array:
    """(L, 3) distant lights; unit vectors if the images were equalised, as these have no common
    brightness scale."""
    lights = photographs.rig.light_vectors()
    return lights / np.linalg.norm(lights, axis=1, keepdims=True) if enhance.clahe else lights


def _grey_images(photographs: FingerBand) -> FloatArray:
    """(L, h, w) linear grey images, without the negative values of noise."""
    return np.asarray(np.maximum(grey_light(photographs.light), 0.0))


@step("light")
def _equalised(images: FloatArray, photographs: FingerBand, enhance: EnhanceSettings) -> FloatArray:
    """Contrast-limited adaptive histogram equalisation of every image."""
    scale, inside = photographs.px_per_mm, photographs.inside
    return np.stack([clahe(image, scale, enhance.cells, mask=inside) for image in images])


@step("light")
def _direct_images(images: FloatArray, white: FingerBand, direct: DirectSettings) -> FloatArray:
    """Direct light in the grey images, zero outside the skin, by the network of the thesis."""
    return direct_light(images * white.inside, direct.network)


def _separation_of(direct: DirectSettings, material: str) -> str:
    """How direct light was separated in the thesis's cases."""
    if direct.method != "network":
        return "none"
    if material != "skin":
        return "none (opaque material: all light is direct)"
    return f"direct light by the network '{direct.network}'"
