"""Simulated fingers to train the relief's network on, and how many."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splitknit.apps.training.scene_ranges import (
    Range,
    Scene,
    SceneRanges,
    draw_base,
    draw_finger_of,
    moved_rig,
)
from splitknit.errors import require
from splitknit.model import default_rig
from splitknit.simulator.light.renderer import RenderSettings
from splitknit.simulator.scene import TwinSettings


@dataclass(frozen=True, slots=True)
class ReliefData(SceneRanges):
    """How many fingers, and the ranges from which each is drawn."""

    fingers: int = 160
    """Of which pieces are taken to train on; about 35 MB each on disk."""
    crops: int = 5
    """Pieces of each, every one with its own skin, lights and exposure."""
    crop_px: int = 420
    """Side of a piece as it is rendered."""
    crop_usual_share: float = 0.7
    """Part of these fingers whose images have the size `scale`; the others' is drawn from `other_scale`."""
    whole_fingers: int = 116
    """That are trained on as a whole, through the front end of a reconstruction; about 60 MB each on disk."""
    held_out: int = 6
    """Further whole ones, for the learning curve and the card."""
    first: int = 7000
    """Number of the first finger for pieces; everything about a finger follows from its number."""
    first_whole: int = 5000
    """Number of the first whole finger."""
    scale: float = 0.5
    """Size of the images relative to the full frame of 2200 x 3200 pixels."""
    other_scale: Range = (0.38, 0.62)
    """Of the other fingers."""
    other_scale_share: float = 0.25
    """Part of the whole fingers that have another size."""

    def __post_init__(self) -> None:
        SceneRanges.__post_init__(self)
        self._check_counts(
            ("fingers", 1, 100_000),
            ("crops", 1, 1000),
            ("crop_px", 1, 2000),
            ("whole_fingers", 0, 100_000),
            ("held_out", 1, 1000),
            ("first", 0, 900_000),
            ("first_whole", 0, 900_000),
        )
        self._check_shares("other_scale_share", "crop_usual_share")
        require(
            0 < self.scale <= 1 and self.other_scale[0] > 0 and self.other_scale[1] <= 1,
            "data.scale and data.other_scale must lie in (0, 1].",
        )


def draw_scene(number: int, data: ReliefData) -> Scene:
    """Draw the finger `number`, its skin's ranges, camera and lights."""
    rng = np.random.default_rng([number, 77])

    def between(limits: Range) -> float:
        return float(rng.uniform(*limits))

    other = rng.random() < data.other_scale_share
    scale = between(data.other_scale) if other else data.scale
    base = draw_base(rng, data)
    finger = draw_finger_of(number, rng, data)
    sharp = rng.random() < 1 - data.aperture_share
    aperture_mm = 0.0 if sharp else between(data.aperture_mm)
    rig = default_rig(scale, int(rng.integers(1000)))
    if rng.random() < data.other_rig_share:
        rig = moved_rig(rig, rng, data)
    settings = TwinSettings(scale=scale, skin=data.skin(base), render=RenderSettings(aperture_mm=aperture_mm))
    return Scene(number, finger, rig, settings)
