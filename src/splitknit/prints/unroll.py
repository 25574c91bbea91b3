"""Unrolling a finger: where its skin lies when it is laid flat.

Four ways: ``free`` (along the skin, then relaxed until nothing is stretched more than it must be), ``arc`` (along the
skin, row by row), ``tube`` (one circle a cross-section) and ``cylinder`` (one for all).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.prints.unroll_distortion import Distortion, distortion
from splitknit.prints.unroll_free import arc_lengths, relaxed
from splitknit.prints.unroll_grid import GridSettings, SurfaceGrid
from splitknit.prints.unroll_tube import on_cylinder, on_tube

Array = NDArray[np.float64]
KINDS = ("free", "arc", "tube", "cylinder")


@dataclass(frozen=True, slots=True)
class UnrollSettings:
    """How the skin is laid flat."""

    kind: Literal["free", "arc", "tube", "cylinder"] = "free"
    """``free``, ``arc``, ``tube`` or ``cylinder`` (``--surface`` goes before it)."""
    iterations: int = 10
    """Rounds of relaxation at most (``free``)."""
    centre_weight: float = 4.0
    """Skin weighs with this power of the cosine of its slant (``free``): 0 spreads the distortion evenly, large keeps
    the middle true and lets the sides give."""
    smooth_mm: float = 2.0
    """Standard deviation along the finger over which the tube's circles are smoothed."""
    slant_deg: float = 70.0
    """Skin steeper than this is left out of the print: the camera hardly sees it."""
    grid: GridSettings = field(default_factory=lambda: GridSettings(pitch_mm=0.5))
    """How coarse and smooth the shape is taken."""

    def __post_init__(self) -> None:
        require(self.kind in KINDS, f"unroll.kind must be one of {', '.join(KINDS)}, but it is '{self.kind}'.")
        require(self.iterations >= 0, f"unroll.iterations must not be negative, but it is {self.iterations}.")
        require(0 <= self.centre_weight <= 20, "unroll.centre_weight must lie between 0 and 20.")
        require(10 <= self.slant_deg <= 85, f"unroll.slant_deg must lie in [10, 85], but it is {self.slant_deg}.")
        require(np.isfinite(self.smooth_mm) and self.smooth_mm > 0, "unroll.smooth_mm must be a positive number.")


@dataclass(frozen=True, slots=True, eq=False)
class Unrolled:
    """The nodes of a surface, laid flat."""

    grid: SurfaceGrid
    flat_mm: Array
    """(n, m, 2) u to the right and v to the tip, as the camera sees them; NaN where unknown."""
    distortion: Distortion


def unroll(grid: SurfaceGrid, settings: UnrollSettings | None = None) -> Unrolled:
    """Lay a surface flat.

    Parameters
    ----------
    grid : SurfaceGrid
        From :func:`splitknit.prints.unroll_grid.surface_grid`.
    settings : UnrollSettings, optional

    Raises
    ------
    BadInput
        If there is too little surface.
    """
    settings = settings or UnrollSettings()
    if settings.kind == "cylinder":
        flat = on_cylinder(grid)
    elif settings.kind == "tube":
        flat = on_tube(grid, settings.smooth_mm)
    else:
        flat = arc_lengths(grid)
        if settings.kind == "free":
            flat = relaxed(grid, flat, settings.iterations, settings.centre_weight)
    # what the map does not reach is not known
    reached = np.isfinite(flat).all(axis=2)
    grid = replace(grid, inside=grid.inside & reached)
    return Unrolled(grid, flat, distortion(grid.points_mm, flat, grid.inside))
