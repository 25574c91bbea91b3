"""Simulated fingers to train the network that mends the shape on, and how many."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splitknit.apps.training.scene_ranges import Range, Scene, SceneRanges, draw_base, draw_finger_of, moved_rig
from splitknit.errors import require
from splitknit.model import default_rig
from splitknit.simulator.light.renderer import RenderSettings
from splitknit.simulator.scene import TwinSettings


@dataclass(frozen=True, slots=True)
class ShapeData(SceneRanges):
    """How many fingers, and the ranges from which each is drawn.

    The network that ships learned from about 160 such fingers. Some 60 of them had the twin's usual rim exponent; here
    it varies from finger to finger.
    """

    fingers: int = 160
    """To train on; about 4 MB each on disk."""
    held_out: int = 8
    """Further ones, for the learning curve and the card."""
    first: int = 5000
    """Number of the first finger; everything about a finger follows from its number."""
    scale: Range = (0.36, 0.5)
    """Size of the images relative to the full frame of 2200 x 3200 pixels."""
    rim_exponent: Range = (0.0, 1.0)
    """Of the light at the finger's outline, see :class:`splitknit.simulator.light.renderer.RenderSettings`: the least
    certain part of the twin's physics."""
    gain: float = 0.93
    """Mean height of the relief that the reconstruction is given, over the true one."""
    gain_spread: float = 0.06
    """Its standard deviation from finger to finger."""

    def __post_init__(self) -> None:
        SceneRanges.__post_init__(self)
        self._check_counts(("fingers", 1, 100_000), ("held_out", 1, 1000), ("first", 0, 900_000))
        require(self.scale[0] > 0 and self.scale[1] <= 1, "data.scale must lie in (0, 1].")
        require(
            self.rim_exponent[0] >= 0 and self.rim_exponent[1] <= 1,
            "data.rim_exponent must lie in [0, 1].",
        )
        require(
            0 < self.gain <= 2 and 0 <= self.gain_spread <= 0.2,
            "data.gain must lie in (0, 2] and data.gain_spread in [0, 0.2].",
        )


def draw_shape_scene(number: int, data: ShapeData) -> tuple[Scene, float]:
    """Draw the finger `number`, its skin's ranges, camera and lights, and the gain of the relief."""
    rng = np.random.default_rng([number, 77])
    scale = float(rng.uniform(*data.scale))
    rim = float(rng.uniform(*data.rim_exponent))
    base = draw_base(rng, data)
    finger = draw_finger_of(number, rng, data)
    sharp = rng.random() < 1 - data.aperture_share
    aperture_mm = 0.0 if sharp else float(rng.uniform(*data.aperture_mm))
    rig = default_rig(scale, int(rng.integers(1000)))
    if rng.random() < data.other_rig_share:
        rig = moved_rig(rig, rng, data)
    render = RenderSettings(aperture_mm=aperture_mm, rim_exponent=rim)
    gain = max(float(rng.normal(data.gain, data.gain_spread)), 0.1)
    return Scene(number, finger, rig, TwinSettings(scale=scale, skin=data.skin(base), render=render)), gain
