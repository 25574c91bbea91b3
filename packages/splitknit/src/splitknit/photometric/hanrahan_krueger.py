"""Photometric stereo of two-layer skin: Hanrahan and Krueger's reflectance, fitted pixel by pixel."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from splitknit.errors import check_lights, check_mask, check_stack, require
from splitknit.imaging.chunks import for_each_chunk, gather
from splitknit.imaging.view import View
from splitknit.model import BoolArray, FloatArray, Rig
from splitknit.photometric.equations import solve, unit_normals
from splitknit.photometric.hanrahan_krueger_fit import HanrahanKruegerSettings, Pixels, fitted
from splitknit.photometric.lambertian import lambertian
from splitknit.photometric.near_light import near_light, near_scene
from splitknit.photometric.robust import robust_fit, strengths

_LIGHTS_A_CHUNK = 64
"""Chunks are as small as for this many images: some forty arrays of a chunk are at work at once."""
_FAINT = 1e-4
"""Pixels darker than this part of the median count as this bright: a black pixel has no scale of its own."""

_Cut = Callable[[slice], tuple[BoolArray, FloatArray, FloatArray]]


@dataclass(frozen=True, slots=True, eq=False)
class SkinFit:
    """What the fit found beside normals and albedo, and how it went; (H, W), NaN, zero or false outside the mask."""

    fraction: FloatArray
    """W of the epidermis: scattering over scattering and absorption, in (0, 1). Thickness, scattering and absorption
    themselves cannot be separated: the images depend on W and on the optical depth alone."""
    depth: FloatArray
    """Optical depth of the epidermis: its thickness times scattering and absorption."""
    misfit: FloatArray
    """Root mean square of the weighted residuals, relative to the albedo."""
    iterations: FloatArray
    converged: BoolArray


def hanrahan_krueger(
    stack: Any, lights: Any, mask: Any = None, settings: HanrahanKruegerSettings | None = None
) -> tuple[FloatArray, FloatArray, SkinFit]:
    """Normals, albedo and layers of skin under distant lights, seen along z.

    Every pixel has five unknowns: the normal (2), the matt base, and W and optical depth of the epidermis; the dermis,
    the phase functions and the refractive index are the same everywhere (:class:`SkinLayers`). Seven images determine
    little of the two last unknowns: they are held to typical skin with the spreads of the settings.

    Parameters
    ----------
    stack, lights, mask
        As of :func:`splitknit.photometric.lambertian`.
    settings : HanrahanKruegerSettings, optional

    Returns
    -------
    normals : (H, W, 3) float32
        Unit vectors, z > 0; zero outside the mask, (0, 0, 1) where all images are black.
    albedo : (H, W) float32
        The matt base where it faces light and camera, in units of the images at a light of strength one; NaN outside
        the mask.
    fit : SkinFit

    Raises
    ------
    BadInput
        As :func:`splitknit.photometric.lambertian`, or if all images are black.

    References
    ----------
    P. Hanrahan and W. Krueger, "Reflection from layered surfaces due to subsurface scattering", SIGGRAPH 1993; W. Xie,
    Z. Song and R. C. Chung, "Real-time three-dimensional fingerprint acquisition via a new photometric stereo means",
    Optical Engineering 52 (2013); the thesis, (2.1) to (2.3).

    Examples
    --------
    >>> import numpy as np
    >>> lights = np.array([[0.0, 0.6, 0.8], [0.6, 0.0, 0.8], [0.0, 0.0, 1.0]])
    >>> stack = np.tile((0.5 * lights @ [0.0, 0.0, 1.0])[:, None, None], (1, 2, 2))
    >>> normals, albedo, fit = hanrahan_krueger(stack, lights)
    >>> bool(normals[0, 0, 2] > 0.999), bool(fit.converged.all())
    (True, True)
    """
    chosen = settings if settings is not None else HanrahanKruegerSettings()
    images = check_stack(stack, least=3)
    vectors = check_lights(lights, images.shape[0])
    inside = check_mask(mask, (images.shape[1], images.shape[2]))
    scale = float(np.linalg.norm(vectors, axis=1).mean())
    directions = (vectors / scale).astype(np.float32)

    def cut(chunk: slice) -> tuple[BoolArray, FloatArray, FloatArray]:
        return inside[chunk], directions, gather(images, chunk, inside[chunk])

    typical = _median(lambertian(images, vectors, inside)[1], inside) * scale
    normals, albedo, fit = _run(cut, images, inside, typical, chosen)
    return normals, np.asarray(albedo / np.float32(scale)), fit


def hanrahan_krueger_near(  # noqa: PLR0917
    stack: Any,
    rig: Rig,
    surface_mm: Any,
    mask: Any = None,
    settings: HanrahanKruegerSettings | None = None,
    view: View | None = None,
) -> tuple[FloatArray, FloatArray, SkinFit]:
    """As :func:`hanrahan_krueger`, with a light vector of its own for every pixel.

    The camera is taken to look along z; for a perspective camera give a `view` along its rays, which turns the lights
    into the pixels' own frames.

    Parameters
    ----------
    stack : (L, H, W) linear light, three images at least
    rig : Rig
        `rig.leds[k]` lights image k.
    surface_mm : (H, W) or a number, z of the current surface, mm; NaN is allowed outside the mask
    mask : (H, W) bool, optional
        The surface; by default where `surface_mm` is finite.
    settings : HanrahanKruegerSettings, optional
    view : View, optional

    Returns
    -------
    normals, albedo, fit
        As of :func:`hanrahan_krueger`: (H, W, 3) unit length, (H, W), and what was found of the skin.

    Raises
    ------
    BadInput
        As of :func:`splitknit.photometric.near_light`.

    References
    ----------
    P. Hanrahan and W. Krueger, "Reflection from layered surfaces due to subsurface scattering", SIGGRAPH 1993.
    """
    chosen = settings if settings is not None else HanrahanKruegerSettings()
    scene = near_scene(check_stack(stack, least=3)[None], rig, surface_mm, mask, view)

    def cut(chunk: slice) -> tuple[BoolArray, FloatArray, FloatArray]:
        here, lights, part = scene.cut(chunk)
        return here, lights, part[0]

    plain = near_light(stack, rig, surface_mm, mask, view=view, robust=False)
    return _run(cut, scene.images[0], scene.mask, _median(plain[1], scene.mask), chosen)


def _median(albedo: FloatArray, inside: BoolArray) -> float:
    typical = float(np.median(albedo[inside]))
    require(typical > 0, "more than half of the surface is black in all images; there is nothing to fit skin to.")
    return typical


def _run(
    cut: _Cut, images: FloatArray, inside: BoolArray, typical: float, settings: HanrahanKruegerSettings
) -> tuple[FloatArray, FloatArray, SkinFit]:
    """Fit all chunks; `typical` is the median albedo, which stands for the base reflectance of the settings."""
    count, rows, columns = images.shape
    exposure = np.pi * typical / (settings.base_reflectance * settings.layers.refractive_index**2)
    normals = np.zeros((rows, columns, 3), dtype=np.float32)
    albedo, fraction, depth, misfit = (np.full((rows, columns), np.nan, dtype=np.float32) for _ in range(4))
    iterations = np.zeros((rows, columns), dtype=np.float32)
    converged = np.zeros((rows, columns), dtype=np.bool_)

    def work(chunk: slice) -> None:
        if not inside[chunk].any():
            return
        here, lights, part = cut(chunk)
        if settings.weights == "robust":
            g, weights = robust_fit(part, lights)
        else:
            g, weights = solve(part, lights, None), np.ones_like(part)
        start = np.maximum(unit_normals(g)[1], np.float32(_FAINT * typical))
        per_pixel = lights if lights.ndim == 3 else lights[..., None]
        length = strengths(lights)
        pixels = Pixels(
            part,
            np.sqrt(weights) / (np.float32(settings.noise) * start),
            per_pixel / length[:, None],
            length,
            start,
            float(exposure),
            settings,
        )
        unit, minimum = fitted(pixels, g)
        normals[chunk][here] = unit.T
        albedo[chunk][here] = start * np.exp(minimum.parameters[2])
        fraction[chunk][here] = 1 / (1 + np.exp(-minimum.parameters[3]))
        depth[chunk][here] = np.exp(minimum.parameters[4])
        squares = np.maximum(minimum.cost - pixels.held(minimum.parameters), 0)
        misfit[chunk][here] = settings.noise * np.sqrt(squares / np.maximum(weights.sum(axis=0), 1e-6))
        iterations[chunk][here] = minimum.iterations
        converged[chunk][here] = minimum.converged

    for_each_chunk(work, rows, columns, max(count, _LIGHTS_A_CHUNK))
    return normals, albedo, SkinFit(fraction, depth, misfit, iterations, converged)
