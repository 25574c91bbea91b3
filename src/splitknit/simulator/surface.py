"""The simulated finger as the camera sees it: what the geometry hands to the optics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from splitknit.errors import require
from splitknit.model import BoolArray, Camera, FloatArray
from splitknit.simulator.coat import Coat


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """One posed finger on the camera's pixel grid: each pixel's values belong to the first point that its ray meets.

    Heights are z in the rig's frame and normals are vectors of that frame, whatever the camera.
    """

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
    x_mm: FloatArray | None = None
    """(H, W) x of the points of `height_mm`, NaN outside `mask`; None for an orthographic camera, whose grid tells."""
    y_mm: FloatArray | None = None
    """(H, W) y of the same points."""
    chart: FloatArray | None = None
    """(H, W, 2) u and v of the points on the skin's map, mm; None unless it was asked for."""
    coat: Coat | None = None
    """What lies on the skin; None where it is clean and bare."""

    def __post_init__(self) -> None:
        require(
            (self.x_mm is None) == (self.y_mm is None) == (self.camera.model == "orthographic"),
            "a surface needs x_mm and y_mm where its camera is perspective, and neither where it is orthographic.",
        )
