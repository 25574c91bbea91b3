"""How people lay their fingers down: ranges of poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splitknit.errors import require
from splitknit.model import Camera
from splitknit.simulator.finger import Pose
from splitknit.simulator.lens import picture_on_plane


@dataclass(frozen=True, slots=True)
class PoseRanges:
    """Ranges from which a finger's pose is drawn, evenly."""

    yaw_deg: tuple[float, float] = (-10.0, 10.0)
    """Turn about the camera's axis, counter-clockwise in the image (the tip turns to the left); 34 deg at most."""
    pitch_deg: tuple[float, float] = (-4.0, 4.0)
    """Turn about the x axis, positive lifts the tip towards the camera; 34 deg at most."""
    roll_deg: tuple[float, float] = (-8.0, 8.0)
    """Turn about the finger's own axis, positive turns the pad to the right; 34 deg at most."""
    x_mm: tuple[float, float] = (-2.5, 2.5)
    """Where the middle of the distal phalanx lies beside the image centre."""
    insertion_mm: tuple[float, float] = (25.0, 28.0)
    """From the lower image border to the tip; cut to what the picture holds."""
    height_mm: tuple[float, float] = (-0.5, 0.5)
    """z of the highest point of the pad."""

    def __post_init__(self) -> None:
        for name in ("yaw_deg", "pitch_deg", "roll_deg", "x_mm", "insertion_mm", "height_mm"):
            low, high = getattr(self, name)
            require(bool(np.isfinite([low, high]).all()) and low <= high, f"pose range {name} must be (low, high).")

    def draw(self, rng: np.random.Generator, camera: Camera) -> Pose:
        """Return one pose; every range takes one number from `rng`, in a fixed order."""
        yaw, pitch, roll, x, insertion, height = (
            float(low + (high - low) * rng.random())
            for low, high in (
                self.yaw_deg,
                self.pitch_deg,
                self.roll_deg,
                self.x_mm,
                self.insertion_mm,
                self.height_mm,
            )
        )
        _, lower, upper = picture_on_plane(camera)
        return Pose(
            yaw_rad=float(np.deg2rad(yaw)),
            pitch_rad=float(np.deg2rad(pitch)),
            roll_rad=float(np.deg2rad(roll)),
            x_mm=x,
            insertion_mm=min(insertion, upper - lower - 0.6),
            height_mm=height,
        )
