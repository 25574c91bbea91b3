"""Settings of the rolled-equivalent finger."""

from __future__ import annotations

from dataclasses import dataclass, field

from splitknit.check import require
from splitknit.fuse import BlendSettings, DisparitySettings, SearchSettings


@dataclass(frozen=True, slots=True)
class RolledSettings:
    """How views from the front and in mirrors become one finger."""

    around_deg: float = 105.0
    """The chart reaches this far to either side of the front."""
    pitch_mm: float = 0.035
    """Of the chart: finer than what the camera resolves."""
    exponent: float = 2.3
    """Of the finger's sections before its ridges tell more: 2 is an ellipse, more is squarer."""
    elastic_steps_mm: tuple[tuple[float, float, float], ...] = ((4.0, 0.7, 2.0), (2.5, 0.3, 1.2))
    """Of the warp at the end, which takes up what is left: squares, reach, and the standard deviation over which the
    shifts are smoothed, step by step."""
    turns: int = 1
    """How often the views' ridges are found on the surface as it is known by then."""
    poses_free: bool = True
    """Whether the ridges may correct the mirrors' poses."""
    elastic: bool = True
    """Whether what is left between the views is taken up by a smooth warp."""
    slope_prior: float = 0.5
    """How much slopes that the lights hardly tell are held to the shape's: variance of the images' relative error over
    that of the slopes."""
    search: SearchSettings = field(default_factory=SearchSettings)
    disparity: DisparitySettings = field(default_factory=DisparitySettings)
    blend: BlendSettings = field(default_factory=BlendSettings)

    def __post_init__(self) -> None:
        require(30.0 <= self.around_deg <= 150.0, "rolled.around_deg must lie in [30, 150].")
        require(0.01 <= self.pitch_mm <= 0.2, "rolled.pitch_mm must lie in [0.01, 0.2].")
        require(1.5 <= self.exponent <= 4.0, "rolled.exponent must lie in [1.5, 4].")
        require(1 <= self.turns <= 5, "rolled.turns must lie between 1 and 5.")
