"""What either way to the relief returns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from splitknit.model import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ReliefEstimate:
    """Ridges on the fine grid, beside a smooth shape."""

    relief_mm: FloatArray
    """(h, w) along the line of sight, free of its local mean, zero outside the mask."""
    deviation_mm: FloatArray
    """(h, w) its standard deviation."""
    spread: float
    """How many times as steep as in `relief_mm` the ridges are taken to be."""
    trust: FloatArray
    """(h, w) in [0, 1]: fades out towards grazing slopes and the outline."""
    albedo: FloatArray
    """(h, w) diffuse brightness of the first channel, relative."""
    glare: FloatArray | None = None
    """(L, h, w) light that the surface mirrors in each white image, where it is known."""
    facts: Mapping[str, Any] = field(default_factory=dict)
