"""Settings of the rolled-equivalent finger."""

from __future__ import annotations

from dataclasses import dataclass, field

from splitknit.errors import require
from splitknit.mirrors.rolled.blend import BlendSettings
from splitknit.mirrors.rolled.search import SearchSettings


@dataclass(frozen=True, slots=True)
class RolledSettings:
    """How views from the front and in mirrors become one finger."""

    around_deg: float = 105.0
    """The chart reaches this far to either side of the front."""
    pitch_mm: float = 0.035
    """Of the chart: finer than what the camera resolves."""
    turns: int = 1
    """How often the views' ridges are found on the surface as it is known by then."""
    slope_prior: float = 0.5
    """How much slopes that the lights hardly determine are held to the shape's: variance of the images' relative error
    over that of the slopes."""
    search: SearchSettings = field(default_factory=SearchSettings)
    blend: BlendSettings = field(default_factory=BlendSettings)

    def __post_init__(self) -> None:
        require(30.0 <= self.around_deg <= 150.0, "rolled.around_deg must lie in [30, 150].")
        require(0.01 <= self.pitch_mm <= 0.2, "rolled.pitch_mm must lie in [0.01, 0.2].")
        require(1 <= self.turns <= 5, "rolled.turns must lie between 1 and 5.")
