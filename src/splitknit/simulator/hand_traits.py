"""What makes fingers look like their owner's: forms of the pad, creases and ridge depths, with their spread."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Trait:
    """A normally distributed number that is cut off."""

    mean: float
    spread: float
    low: float
    high: float
    sided: bool = False
    """Whether the left hand has it mirrored."""


TRAITS: Mapping[str, Trait] = {
    "thickness": Trait(0.80, 0.05, 0.68, 0.92),
    "squareness": Trait(0.18, 0.09, 0.02, 0.40),
    "tip_length": Trait(1.02, 0.12, 0.78, 1.30),
    "tip_squareness": Trait(0.12, 0.10, 0.0, 0.38),
    "taper": Trait(0.06, 0.025, 0.01, 0.12),
    "pad_bulge": Trait(0.06, 0.025, 0.01, 0.12),
    "pad_center": Trait(0.50, 0.06, 0.38, 0.62),
    "neck": Trait(0.03, 0.012, 0.005, 0.06),
    "arching_per_mm": Trait(0.0015, 0.0010, -0.0005, 0.004),
    "sideways_mm": Trait(0.0, 0.35, -0.9, 0.9, sided=True),
    "skew": Trait(0.0, 0.03, -0.08, 0.08, sided=True),
    "tip_drop": Trait(2.0, 0.5, 0.8, 3.2),
    "ridge_depth": Trait(65.0, 13.0, 40.0, 95.0),
    "depth_variation": Trait(0.12, 0.03, 0.05, 0.2),
    "pore_depth": Trait(25.0, 6.0, 10.0, 45.0),
    "pore_darkening": Trait(0.06, 0.02, 0.0, 0.12),
    "first_depth": Trait(0.38, 0.09, 0.2, 0.6),
    "first_width": Trait(0.28, 0.05, 0.18, 0.42),
    "first_tilt": Trait(0.0, 0.04, -0.1, 0.1, sided=True),
    "first_bow": Trait(0.003, 0.006, -0.01, 0.015),
    "first_reach": Trait(10.5, 1.2, 8.0, 13.0),
    "first_darkening": Trait(0.22, 0.06, 0.08, 0.4),
    "second_depth": Trait(0.48, 0.08, 0.3, 0.6),
    "second_width": Trait(0.34, 0.05, 0.2, 0.5),
    "second_tilt": Trait(0.0, 0.03, -0.1, 0.1, sided=True),
    "second_bow": Trait(0.0, 0.005, -0.01, 0.01),
    "second_reach": Trait(11.5, 1.2, 8.0, 14.0),
    "second_darkening": Trait(0.25, 0.06, 0.08, 0.4),
}
"""Means, spreads and limits are those of :func:`splitknit.simulator.finger.draw_finger`, where their sources stand; the
tip's drop (for a finger 13.5 mm thick) is ours: a fingertip ends near its nail, not half-way down."""
