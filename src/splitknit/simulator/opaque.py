"""An opaque finger: matt as painted plaster, no light below the surface, no gloss (Lambert's law and nothing else)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from splitknit.errors import require
from splitknit.model import FloatArray, Led
from splitknit.simulator.lighting import UNIT, Patch, cut_out
from splitknit.simulator.surface import Surface


def render_opaque(surface: Surface, leds: Sequence[Led], albedo: float = 0.5) -> tuple[tuple[slice, slice], FloatArray]:
    """Photograph a Lambertian finger under each of `leds`, without noise.

    Parameters
    ----------
    surface : the finger on the camera's pixels
    leds : L lights; what shares an exposure (`also`) adds
    albedo : diffuse reflectance, 0 to 1

    Returns
    -------
    window : rows and columns of the finger in the frame
    light : (L, h, w) radiance inside the window, in the units of the rig's intensities; zero outside the finger

    Notes
    -----
    Attached shadows are black; cast shadows are not modelled (a finger pad casts none on itself but in its creases).

    References
    ----------
    J. H. Lambert, Photometria, 1760: radiance = albedo / pi times irradiance, and irradiance = intensity times the
    cosine of incidence over the squared distance.
    """
    require(0.0 < albedo <= 1.0, f"the albedo must lie in (0, 1], but it is {albedo}.")
    patch = cut_out(surface)
    light = np.stack([sum((_irradiance(patch, one) for one in (led, *led.also)), np.float32(0.0)) for led in leds])
    return patch.window, np.asarray(light * np.float32(albedo / np.pi), dtype=np.float32)


def _irradiance(patch: Patch, led: Led) -> FloatArray:
    """(h, w) light of one LED on the surface."""
    if led.position_mm is None:
        towards = np.asarray(led.direction, dtype=np.float64) / np.linalg.norm(np.asarray(led.direction))
        strength: Any = led.intensity
        cosine = towards[0] * patch.nx + towards[1] * patch.ny + towards[2] * patch.nz
    else:
        dx, dy, dz = (p - at for p, at in zip(led.position_mm, (patch.x, patch.y, patch.z), strict=True))
        squared = dx * dx + dy * dy + dz * dz
        distance = np.sqrt(squared)
        strength = led.intensity * UNIT / squared
        if led.lobe_exponent > 0.0:
            along = -(dx * led.axis[0] + dy * led.axis[1] + dz * led.axis[2]) / distance
            strength = strength * np.maximum(along, 0.0) ** led.lobe_exponent
        cosine = (dx * patch.nx + dy * patch.ny + dz * patch.nz) / distance
    return np.asarray(np.where(patch.mask, strength * np.maximum(cosine, 0.0), 0.0), dtype=np.float32)
