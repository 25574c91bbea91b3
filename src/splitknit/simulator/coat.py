"""What lies on the skin, or what its surface has become: water, scales, grains, scars, a gloss with a direction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.model import FloatArray

WATER = 1.333
"""Refractive index of water (Hale and Querry 1973)."""


@dataclass(frozen=True, slots=True, eq=False)
class Film:
    """Water on the skin, seen from above."""

    share: FloatArray
    """(H, W) share of the pixel that is under water."""
    normals: FloatArray
    """(H, W, 3) unit normals of the water's surface, those of the skin where there is none."""
    roughness: FloatArray
    """(H, W) GGX alpha of the water's surface, with the bend inside a pixel."""


@dataclass(frozen=True, slots=True, eq=False)
class Grains:
    """Opaque grains that rest on the skin, as N discs in the picture."""

    column: NDArray[np.float64]
    row: NDArray[np.float64]
    radius_px: NDArray[np.float64]
    albedo: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Coat:
    """What the light meets before bare skin, on the camera's pixels; None is what there is not."""

    kind: str
    severity: float
    share: FloatArray
    """(H, W) share of each pixel that is affected."""
    roughness: FloatArray | None = None
    """(H, W) GGX alpha of the skin across its ridges; None: the skin's own everywhere."""
    roughness_along: FloatArray | None = None
    """(H, W) GGX alpha along `along`; None: as across."""
    along: FloatArray | None = None
    """(H, W, 3) unit vectors along the ridges, in the surface."""
    film: Film | None = None
    scales: FloatArray | None = None
    """(H, W) diffuse white reflectance of horny scales above the skin."""
    grains: Grains | None = None
    tint: Mapping[str, float] = field(default_factory=dict)
    """For each channel: diffuse reflectance of the affected skin over that of the rest."""

    def truth(self) -> dict[str, NDArray[Any]]:
        """Arrays by name for the capture's truth."""
        return {
            "condition_kind": np.array(self.kind),
            "condition_severity": np.array(self.severity),
            "condition_share": self.share.astype(np.float16),
        }
