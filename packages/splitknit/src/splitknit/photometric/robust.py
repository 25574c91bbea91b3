"""Photometric stereo that leaves out shadowed and glossy lights, pixel by pixel."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.checks import check_lights, check_mask, check_stack
from splitknit.imaging.chunks import gather
from splitknit.imaging.robust import cauchy
from splitknit.model import FloatArray
from splitknit.photometric.equations import (
    conditioning,
    length,
    moment_matrix,
    shading,
    solve,
    surface_by_chunks,
)

# Which lights to trust at a pixel: shadows are left out, highlights lose weight.
#
# A light counts as shadowed where its image is darker than a part of what the brightest light
# gives; the rest is fitted by least squares, and each residual, relative to the albedo, sets a new
# weight (iteratively reweighted least squares, Cauchy weights). Glare and interreflection only ever
# add light, and shadow has been left out already: a residual below the fit is mostly the fit's own
# tilt towards a highlight and is forgiven more.


def _lit_weights(
    images: FloatArray, lights: FloatArray
) -> tuple[FloatArray, NDArray[np.intp], NDArray[np.intp]]:
    """One where a light reaches the pixel and zero in shadow, (L, n); the pixels with any shadow;
    the weak of these.

    A pixel is weak where its lit lights do not determine a normal (fewer than three, or all near
    one plane). It keeps every light, weighted by the square of what it gives: the brightest decide,
    and the system stays solvable.
    """
    peak = np.maximum(images.max(axis=0), 1e-20)
    lit = images > 0.03 * peak  # a light is in shadow below this part of the brightest one's
    weights = lit.astype(np.float32)
    shadowed = np.flatnonzero(
        np.add.reduce(lit.view(np.uint8), axis=0, dtype=np.uint16) < images.shape[0]
    )
    weak = shadowed[:0]
    if shadowed.size:
        nearby = lights if lights.ndim == 2 else lights[:, :, shadowed]
        # pivot over the trace; three neighbours on the rig give 4e-3
        weak = shadowed[conditioning(moment_matrix(nearby, weights[:, shadowed])) < 5e-4]
        # faintest lights count as a hundredth of the brightest one
        soft = np.maximum(images[:, weak] / peak[weak], 1e-2)
        weights[:, weak] = soft * soft
    return weights, shadowed, weak


def robust_fit(images: FloatArray, lights: FloatArray) -> FloatArray:
    """Albedo-scaled normals (3, n) from images (L, n).

    `lights` is (L, 3), or (L, 3, n) where they differ from pixel to pixel. Images are divided by
    the strengths of their lights first: what a matt surface leaves unexplained grows with a light,
    and no light counts more for being bright.
    """
    strength = length(np.moveaxis(lights, 1, 0))
    images = images / (strength[:, None] if lights.ndim == 2 else strength)
    lights = lights / strength[:, None]
    weights, shadowed, weak = _lit_weights(images, lights)
    if lights.ndim == 2:  # one matrix serves all pixels that every light reaches
        inverse = np.linalg.pinv(lights.astype(np.float64)).astype(np.float32)
        g: FloatArray = np.einsum("ik,kn->in", inverse, images)
        if shadowed.size:
            g[:, shadowed] = solve(images[:, shadowed], lights, weights[:, shadowed])
    else:
        g = solve(images, lights, weights if shadowed.size else None)
    worst = _misfit(images, lights, weights, g).max(axis=0)
    worst[weak] = 0.0  # no light can be spared there
    doubtful = np.flatnonzero(worst > 0.5)  # else the least-squares fit stays: saves time
    if doubtful.size:
        _reweight(images, lights, weights, g, doubtful)
    return g


def _reweight(
    images: FloatArray,
    lights: FloatArray,
    weights: FloatArray,
    g: FloatArray,
    active: NDArray[np.intp],
) -> None:
    """Iterate the pixels `active` in place; a pixel leaves when its g moves by less than a
    thousandth of its length."""
    part, usable, here = images[:, active], weights[:, active], g[:, active]
    nearby = lights if lights.ndim == 2 else lights[:, :, active]
    for _ in range(20):
        trust = usable * cauchy(_misfit(part, nearby, usable, here), 1.0)
        fresh = solve(part, nearby, trust)
        g[:, active] = fresh
        moving = np.flatnonzero(length(fresh - here) > 1e-3 * length(fresh))
        if not moving.size:
            return
        active = active[moving]
        part, usable, here = part[:, moving], usable[:, moving], fresh[:, moving]
        if nearby.ndim == 3:
            nearby = nearby[:, :, moving]


_FORGIVENESS = 2.0
"""Residuals below the fit get this many times the tolerance: light adds, it does not subtract.
Chosen on: real photographs (DiLiGenT's bear). Range: 2 to 4."""


def _misfit(
    images: FloatArray, lights: FloatArray, usable: FloatArray, g: FloatArray
) -> FloatArray:
    """Size of every residual in units of its tolerance, (L, n); zero where a light is not used."""
    residual = images - shading(g, lights)
    albedo = np.maximum(length(g), 1e-20)
    # residual, relative to the albedo, at which a light's weight has fallen to one half
    residual /= albedo * 0.03
    residual *= usable > 0
    misfit = np.maximum(residual, residual * (-1 / _FORGIVENESS))
    return np.minimum(misfit, 100.0)  # a pixel without light keeps weights that sum to something


def robust(stack: Any, lights: Any, mask: Any = None) -> tuple[FloatArray, FloatArray]:
    """Normals and albedo under distant lights, from the lights that are neither shadowed nor glossy
    at a pixel.

    Parameters
    ----------
    stack, lights, mask
        As of :func:`splitknit.photometric.lambertian`; five images or more for an effect on
        highlights.

    Returns
    -------
    normals, albedo
        As of :func:`splitknit.photometric.lambertian`: (H, W, 3) unit vectors, and (H, W).

    Raises
    ------
    BadInput
        As :func:`splitknit.photometric.lambertian`.

    References
    ----------
    P. W. Holland and R. E. Welsch, "Robust regression using iteratively reweighted least-squares",
    Communications in Statistics A6 (1977), for the weights; S. Ikehata, D. Wipf, Y. Matsushita and
    K. Aizawa, "Robust photometric stereo using sparse regression", CVPR 2012, for the view of
    shadow and specular reflection as sparse errors.
    """
    images = check_stack(stack, least=3)
    count, rows, columns = images.shape
    checked = check_lights(lights, count)
    scale = float(np.linalg.norm(checked, axis=1).mean())
    vectors = (checked / scale).astype(np.float32)
    inside = check_mask(mask, (rows, columns))
    normals, albedo = surface_by_chunks(
        inside, count, lambda chunk, here: robust_fit(gather(images, chunk, here), vectors)
    )
    return normals, albedo / scale
