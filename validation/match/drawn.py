"""True surfaces of single fingers, laid down once, as impostor tables need them."""

from __future__ import annotations

import numpy as np

from splitknit.finger.orientation import find_upright
from splitknit.model import Surface, default_rig
from splitknit_simulator.finger.finger import PoseRanges, draw_finger, finger_surface

PHALANGE_MM = 20.0
"""Of each finger so much is used, from the tip on: what a reconstruction keeps."""


def drawn_surface(seed: int, scale: float) -> Surface:
    """Finger `seed`, seen by a camera of `scale`."""
    camera = default_rig(scale).camera
    pose = PoseRanges().draw(np.random.default_rng([seed, 7]), camera)
    seen = finger_surface(draw_finger(seed), pose, camera)
    first = int(np.argmax(seen.mask.any(axis=1)))
    mask = seen.mask.copy()
    mask[first + round(PHALANGE_MM * camera.px_per_mm) :] = False
    upright = find_upright(mask)
    return Surface(
        seen.height_mm - seen.shape_mm, seen.shape_mm, seen.normals, mask, camera.pitch_mm,
        upright.input_from_upright, upright.size,
    )  # fmt: skip
