"""Light that a surface with two roughnesses reflects: GGX microfacets, anisotropic, pixel by pixel."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitknit.simulator.diffusion import fresnel

Values = NDArray[np.floating]
Vectors = tuple[Values, Values, Values]


def dot(a: Vectors, b: Vectors) -> Values:
    """Inner products of vectors given as three arrays each."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def reflected(
    normal: Vectors,
    light: Vectors,
    view: Vectors,
    across: Values | float,
    *,
    index: float,
    along: Vectors | None = None,
    roughness_along: Values | float | None = None,
) -> Values:
    """(h, w) radiance towards `view` per unit of irradiance that a surface facing the light receives: D G F / (4 n.v).

    Parameters
    ----------
    normal, light, view : three (h, w) arrays each
        Unit vectors; out of the surface, towards the light, towards the camera.
    across : (h, w) or float
        GGX alpha across `along`, and everywhere where there is no direction.
    index : float
        Refractive index of what reflects.
    along : three (h, w) arrays, optional
        Unit vectors in the surface, along which the roughness is `roughness_along`.
    roughness_along : (h, w) or float, optional

    References
    ----------
    Walter et al. 2007, equations (20), (33), (34); Burley 2012 and Heitz 2014, equations (85) and (86), for two
    roughnesses.
    """
    nl, nv = dot(normal, light), np.clip(dot(normal, view), 1e-3, 1.0)
    lv = dot(light, view)
    inverse = 1.0 / np.sqrt(np.maximum(2.0 + 2.0 * lv, 1e-6))
    half = (
        (light[0] + view[0]) * inverse,
        (light[1] + view[1]) * inverse,
        (light[2] + view[2]) * inverse,
    )
    nh = np.clip(dot(normal, half), 0.0, 1.0)
    lit = nl > 0.0
    nl = np.maximum(nl, 1e-4)
    first = across if roughness_along is None else roughness_along
    if along is None:
        first, towards = across, None
    else:
        towards = along

    def squashed(direction: Vectors, cosine: Values, power: int) -> Values:
        """Sum of the squared tangential parts of a direction, times (or over) the squared roughnesses."""
        sine = np.maximum(1.0 - cosine * cosine, 0.0)
        part = np.zeros_like(sine) if towards is None else np.minimum(dot(towards, direction) ** 2, sine)
        one, other = np.square(first), np.square(across)
        if power < 0:
            return np.asarray(part / one + (sine - part) / other)
        return np.asarray(part * one + (sine - part) * other)

    below = squashed(half, nh, -1) + nh * nh
    distribution = 1.0 / (np.pi * first * across * below * below)

    def unshadowed(direction: Vectors, cosine: Values) -> Values:
        return np.asarray(2.0 / (1.0 + np.sqrt(1.0 + squashed(direction, cosine, 1) / (cosine * cosine))))

    shadowing = unshadowed(light, nl) * unshadowed(view, nv)
    mirror = fresnel((lv + 1.0) * inverse, index)
    return np.asarray(np.where(lit, distribution * shadowing * mirror / (4.0 * nv), 0.0))
