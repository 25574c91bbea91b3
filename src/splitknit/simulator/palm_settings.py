"""Ranges that palms are drawn from."""

from __future__ import annotations

from dataclasses import dataclass

from splitknit.errors import require


@dataclass(frozen=True, slots=True)
class PalmSettings:
    """Ranges that a palm is drawn from."""

    size_mm: tuple[float, float] = (44.0, 34.0)
    """Width and height of the patch."""
    pitch_mm: float = 0.05
    """Grid pitch of the patch's relief."""
    period_mm: tuple[float, float] = (0.48, 0.62)
    """Mean ridge period."""
    period_variation: float = 0.06
    """Relative standard deviation within a palm, over distances of about 5 mm."""
    ridge_depth_um: tuple[float, float] = (20.0, 60.0)
    """Mean height of ridges over valleys: flatter than on fingers."""
    turn_per_mm: float = 0.02
    """Standard deviation of the steady turn of the ridges' direction, rad/mm, along each axis."""
    delta_share: float = 0.15
    """Share of the patches that hold a triradius."""
    principal: tuple[int, int] = (0, 3)
    """Principal lines in the patch, inclusive."""
    principal_depth_um: tuple[float, float] = (90.0, 280.0)
    """Of the principal lines, 0 to 300."""
    wrinkles: tuple[int, int] = (10, 60)
    """Finer lines, inclusive."""
    wrinkle_depth_um: tuple[float, float] = (18.0, 50.0)
    """Of the finer lines, 0 to 100."""
    darkening: tuple[float, float] = (0.05, 0.25)
    """Loss of diffuse reflectance at the bottom of a line of 0.2 mm."""
    mottling: tuple[float, float] = (0.01, 0.06)
    """Standard deviation of the blotches' diffuse reflectance, over distances of about 2 mm."""
    radius_mm: tuple[float, float] = (35.0, 150.0)
    """Radii of curvature of the patch along its two axes."""

    def __post_init__(self) -> None:
        require(min(self.size_mm) >= 4.0, f"palm.size_mm must be at least 4 mm each way, but it is {self.size_mm}.")
        for name, low, high in (
            ("period_mm", 0.3, 1.0),
            ("ridge_depth_um", 0.0, 200.0),
            ("principal", 0, 10),
            ("principal_depth_um", 0.0, 300.0),
            ("wrinkles", 0, 400),
            ("wrinkle_depth_um", 0.0, 100.0),
            ("darkening", 0.0, 0.8),
            ("mottling", 0.0, 0.2),
            ("radius_mm", 20.0, 1e6),
        ):
            least, most = getattr(self, name)
            require(
                low <= least <= most <= high,
                f"palm.{name} must be (low, high) within {low} to {high}, but it is ({least}, {most}).",
            )
        require(
            0 < self.pitch_mm <= self.period_mm[0] / 8,
            f"palm.pitch_mm must be an eighth of the least ridge period or less, but it is {self.pitch_mm}.",
        )
        require(0 <= self.period_variation <= 0.15, "palm.period_variation must lie in [0, 0.15].")
        require(0 <= self.turn_per_mm <= 0.2, "palm.turn_per_mm must lie in [0, 0.2].")
        require(0 <= self.delta_share <= 1, "palm.delta_share must lie in [0, 1].")
