"""A finger that does not lie still while it is photographed: drift, tremor, small turns, and skin that slips.

A hand that holds still for seconds drifts slowly, as a random walk, and trembles at 8 to 12 Hz by a small part of that.
The finger turns a little with it (yaw and roll), and where it rests on something its skin slips over the bone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class HandMotion:
    """How far and how a finger moves during a capture. Every number is ours unless a source is named."""

    amplitude_mm: float = 0.0
    """Largest distance, over all pairs of shots, between the places of the finger's middle; 0 = it lies still."""
    shot_s: float = 0.5
    """Time from shot to shot; the thesis takes 14 in 7 s."""
    exposure_s: float = 0.02
    """Time that a shot takes; tremor blurs it."""
    tremor_share: float = 0.05
    """Standard deviation of the tremor over the amplitude of the drift."""
    tremor_hz: tuple[float, float] = (8.0, 12.0)
    """Physiological tremor (Elble and Koller 1990)."""
    yaw_deg_per_mm: float = 1.5
    """Largest difference of yaw between two shots, for each mm of amplitude."""
    roll_deg_per_mm: float = 1.5
    """The same of the roll about the finger's axis."""
    slip_share: float = 0.1
    """Largest slip of the skin between two shots, over the amplitude."""
    slip_smooth_mm: float = 5.0
    """Length over which the slip is smooth."""

    def __post_init__(self) -> None:
        require(
            0 <= self.amplitude_mm <= 3, f"motion.amplitude_mm must lie in [0, 3], but it is {self.amplitude_mm:g}."
        )
        require(0 < self.shot_s <= 10, f"motion.shot_s must lie in (0, 10], but it is {self.shot_s:g}.")
        require(0 <= self.exposure_s <= self.shot_s, "motion.exposure_s must lie between 0 and motion.shot_s.")
        low, high = self.tremor_hz
        require(0 < low <= high <= 30, "motion.tremor_hz must be two rising frequencies of at most 30 Hz.")
        require(0 <= self.tremor_share <= 0.5, "motion.tremor_share must lie in [0, 0.5].")
        for name in ("yaw_deg_per_mm", "roll_deg_per_mm"):
            require(0 <= getattr(self, name) <= 10, f"motion.{name} must lie in [0, 10].")
        require(0 <= self.slip_share <= 0.5, "motion.slip_share must lie in [0, 0.5].")
        require(2 <= self.slip_smooth_mm <= 30, "motion.slip_smooth_mm must lie in [2, 30].")


@dataclass(frozen=True, slots=True, eq=False)
class MotionPath:
    """Where the finger is in each of N shots, against the reference shot, whose values are zero."""

    time_s: Array
    """(N,)"""
    shift_mm: Array
    """(N, 2): x right, y up."""
    speed_mm_per_s: Array
    """(N, 2) of the tremor, at the middle of the exposure."""
    yaw_rad: Array
    """(N,)"""
    roll_rad: Array
    """(N,)"""
    slip: Array
    """(N, 2): shares of two drawn fields of slip."""
    reference: int


def draw_path(rng: np.random.Generator, shots: int, settings: HandMotion, reference: int | None = None) -> MotionPath:
    """Draw a path.

    Parameters
    ----------
    rng : of the path
    shots : N, in the order in which they are taken
    settings : of the motion
    reference : shot in which the path is zero; None: the middle one of the first half, which is that of the white band
    """
    require(shots >= 2, f"motion needs at least 2 shots, but there are {shots}.")
    reference = shots // 4 if reference is None else reference
    require(0 <= reference < shots, f"the reference shot must lie in 0 to {shots - 1}, but it is {reference}.")
    time: Array = np.asarray(np.arange(shots) * settings.shot_s, dtype=np.float64)
    drift = _walk(rng, shots, 2)
    frequency = rng.uniform(*settings.tremor_hz, (3, 2))
    phase = rng.uniform(0.0, 2.0 * np.pi, (3, 2))
    angle = 2.0 * np.pi * frequency * time[:, None, None] + phase
    tremor = np.sin(angle).sum(axis=1) * (settings.tremor_share * np.sqrt(2.0 / 3.0))
    speed = (2.0 * np.pi * frequency * np.cos(angle)).sum(axis=1) * (settings.tremor_share * np.sqrt(2.0 / 3.0))
    path = drift / _spread(drift) + tremor
    scale = settings.amplitude_mm / _spread(path)
    yaw, roll = (walk[:, 0] / _spread(walk) for walk in (_walk(rng, shots, 1), _walk(rng, shots, 1)))
    slip = _walk(rng, shots, 2)
    slip = slip / _spread(slip)

    def against(values: Array) -> Array:
        return np.asarray(values - values[reference])

    turned = np.deg2rad(settings.amplitude_mm)
    return MotionPath(
        time_s=time,
        shift_mm=against(path * scale),
        speed_mm_per_s=speed * scale,
        yaw_rad=against(yaw * turned * settings.yaw_deg_per_mm),
        roll_rad=against(roll * turned * settings.roll_deg_per_mm),
        slip=against(slip * settings.amplitude_mm * settings.slip_share),
        reference=reference,
    )


def _walk(rng: np.random.Generator, steps: int, width: int) -> Array:
    """(N, W) random walk."""
    return np.cumsum(rng.standard_normal((steps, width)), axis=0)


def _spread(path: Array) -> float:
    """Largest distance between two of its points."""
    return float(np.linalg.norm(path[:, None] - path[None], axis=-1).max())
