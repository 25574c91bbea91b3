"""The back of a finger at its last joint: no ridges, but creases across it that are its owner's.

Number, places and forms of the creases are our choice, after pictures of minor finger knuckles (A. Kumar and Z. Xu,
"Personal identification using minor finger knuckle patterns from palm dorsal surface", IEEE TIFS 11, 2016). The nail
is not simulated: :func:`knuckle_pose` keeps it out of view.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from splitknit_simulator.finger.finger import FingerPose, SimulatedFinger, draw_finger
from splitknit_simulator.finger.skin_map import FlexionCrease, SkinRelief


def draw_knuckle(seed: int, session: int = 0) -> SimulatedFinger:
    """Draw the back of the finger that :func:`splitknit_simulator.finger.finger.draw_finger` draws for `seed`.

    Creases stay; how deep all of them are changes by a fifth from `session` to session, as the joint bends.
    """
    finger, rng = draw_finger(seed), np.random.default_rng([seed, 0xD02])
    bent = float(np.exp(0.2 * np.random.default_rng([seed, session, 0xD03]).standard_normal()))
    count = int(rng.integers(9, 14))
    places = np.linspace(-6.5, 6.5, count) + rng.normal(0.0, 0.35, count)
    creases = tuple(
        FlexionCrease(
            v_mm=float(place),
            depth_mm=float(np.clip(bent * 0.16 * np.exp(0.4 * rng.standard_normal() - (place / 6.0) ** 2), 0.02, 0.4)),
            width_mm=float(rng.uniform(0.14, 0.3)),
            tilt=float(rng.normal(0.0, 0.07)),
            bow_per_mm=float(np.sign(place) * rng.uniform(0.0, 0.012)),
            reach_mm=float(rng.uniform(3.0, 8.0)),
            side_lines=int(rng.integers(0, 4)),
            darkening=0.15,
        )
        for place in places
    )
    skin = SkinRelief(0.0, pore_depth_um=0.0, pore_darkening=0.0, undulation_mm=0.02, creases=creases)
    return replace(finger, skin=skin, shape=replace(finger.shape, pad_bulge=0.0, neck=-0.05))


def knuckle_pose(rng: np.random.Generator) -> FingerPose:
    """Draw how the back of a finger lies: its last joint in the middle of the picture, its tip beyond the border."""
    return FingerPose(
        yaw_rad=float(rng.uniform(-0.1, 0.1)), pitch_rad=float(rng.uniform(-0.05, 0.05)),
        roll_rad=float(rng.uniform(-0.1, 0.1)), x_mm=float(rng.uniform(-2.0, 2.0)),
        insertion_mm=float(rng.uniform(38.0, 41.0)), height_mm=float(rng.uniform(-0.5, 0.5)),
    )  # fmt: skip
