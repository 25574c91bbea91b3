"""The simulated finger as the camera sees it: what the geometry hands to the optics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from splitknit.types import BoolArray, Camera, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """One posed finger on the camera's pixel grid (orthographic view along -z)."""

    camera: Camera
    height_mm: FloatArray
    """(H, W) z of the skin with ridges, NaN outside `mask`."""
    shape_mm: FloatArray
    """(H, W) z of the same finger without ridges, pores and creases, NaN outside `mask`."""
    normals: FloatArray
    """(H, W, 3) unit normals of `height_mm`, zero outside `mask`."""
    shape_normals: FloatArray
    """(H, W, 3) unit normals of `shape_mm`, zero outside `mask`."""
    relief_um: FloatArray
    """(H, W) displacement of the skin along the shape's normal: 0 at ridge tops, negative in valleys, zero outside."""
    mask: BoolArray
    """(H, W) true where the camera sees the finger."""
    pigment: FloatArray
    """(H, W) multiplier of the diffuse reflectance (creases and pores are darker), one on plain skin."""
    landmarks: Mapping[str, Any] = field(default_factory=dict)
    """What the geometry knows: tip and flexion creases in pixels, pose, pattern, cores and deltas in pixels."""
