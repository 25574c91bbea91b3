"""The simulated finger as the camera sees it: what the geometry hands to the optics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit import Camera
from splitknit.model import Array, BoolArray, FloatArray
from splitknit_simulator.camera.lens import SightLines, sight_lines

Window = tuple[slice, slice]
"""Rows and columns of a part of a picture."""
Truth = dict[str, NDArray[Any]]
"""What the twin knows, arrays by name: see ``docs/explain/simulator.md``."""
WATER_INDEX = 1.333
"""Refractive index of water. Source: Hale and Querry 1973."""


def soft_step(place: Array) -> Array:
    """A cubic from 0 at `place` 0 and below to 1 at 1 and above, level at both ends."""
    inside = np.clip(place, 0.0, 1.0)
    return inside * inside * (3.0 - 2.0 * inside)


@dataclass(frozen=True, slots=True, eq=False)
class Film:
    """Water on the skin, seen from above."""

    fraction: FloatArray  # (H, W) fraction of the pixel that is under water
    # (H, W, 3) unit normals of the water's surface, those of the skin where there is none
    normals: FloatArray
    roughness: FloatArray  # (H, W) GGX alpha of the water's surface, with the bend inside a pixel


@dataclass(frozen=True, slots=True, eq=False)
class Grains:
    """Opaque grains that rest on the skin, as N discs in the picture."""

    column: Array
    row: Array
    radius_px: Array
    albedo: Array


@dataclass(frozen=True, slots=True, eq=False)
class Coat:
    """What the light meets before bare skin, on the camera's pixels; None is what there is not."""

    kind: str
    severity: float
    fraction: FloatArray  # (H, W) fraction of each pixel that is affected
    # (H, W) GGX alpha of the skin across its ridges; None: the skin's own everywhere
    roughness: FloatArray | None = None
    roughness_along: FloatArray | None = None  # (H, W) GGX alpha along `along`; None: as across
    along: FloatArray | None = None  # (H, W, 3) unit vectors along the ridges, in the surface
    film: Film | None = None
    # (H, W) diffuse white reflectance of horny scales above the skin
    scales: FloatArray | None = None
    grains: Grains | None = None
    # for each channel: diffuse reflectance of the affected skin over that of the rest
    tint: Mapping[str, float] = field(default_factory=dict)

    def truth(self) -> Truth:
        """Arrays by name for the capture's truth."""
        return {
            "condition_kind": np.array(self.kind),
            "condition_severity": np.array(self.severity),
            "condition_share": self.fraction.astype(np.float16),
        }


@dataclass(frozen=True, slots=True, eq=False)
class Texture:
    """What varies over the skin's surface and is not relief, on the camera's pixels."""

    gloss: FloatArray  # (H, W) specular reflection over its mean: sweat
    # (H, W) how much darker blood makes green light, as a natural logarithm: mottled skin
    blood: FloatArray
    # (4, H, W) factor of red, green, blue and near-infrared light from within the skin, the same in
    # all images: the sensor's fixed pattern, or the noise of a light-transport simulation that all
    # lights share
    grain: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedSurface:
    """One posed finger on the camera's pixel grid: each pixel's values belong to the first point
    that its ray meets.

    Heights are z in the rig's frame and normals are vectors of that frame, whatever the camera.
    """

    camera: Camera
    height_mm: FloatArray  # (H, W) z of the skin with ridges, NaN outside `mask`
    # (H, W) z of the same finger without ridges, pores and creases, NaN outside `mask`
    shape_mm: FloatArray
    normals: FloatArray  # (H, W, 3) unit normals of `height_mm`, zero outside `mask`
    shape_normals: FloatArray  # (H, W, 3) unit normals of `shape_mm`, zero outside `mask`
    # (H, W) displacement of the skin along the shape's normal: 0 at ridge tops, negative in
    # valleys, zero outside
    relief_um: FloatArray
    mask: BoolArray  # (H, W) true where the camera sees the finger
    # (H, W) multiplier of the diffuse reflectance (creases and pores are darker), one on plain skin
    pigment: FloatArray
    # what the geometry knows: tip and flexion creases in pixels, pose, pattern, cores and deltas in
    # pixels
    landmarks: Mapping[str, Any] = field(default_factory=dict)
    # (H, W, 2) u and v of the points on the skin's map, mm; None unless it was asked for
    chart: FloatArray | None = None
    coat: Coat | None = None  # what lies on the skin; None where it is clean and bare
    texture: Texture | None = None  # mottled blood and patches of sweat; None: even

    def sight(self, window: Window = (slice(None), slice(None))) -> SightLines:
        """Lines of sight of the pixels in these rows and columns; the skin's points lie on them."""
        rows, columns = (
            np.arange(size)[part] for size, part in zip(self.mask.shape, window, strict=True)
        )
        return sight_lines(self.camera, columns[None, :], rows[:, None])
