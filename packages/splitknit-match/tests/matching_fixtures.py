"""Simulated fingers without photographs: true surfaces, each finger in several poses."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from splitknit.nominal import default_rig
from splitknit_match.matching.ridge_band import RidgeBand, ridge_band
from splitknit_match.matching.template import Template, make_template
from splitknit_match.matching.thesis import FingerImages, finger_images
from splitknit_simulator.finger.finger import FingerPose, draw_finger, finger_surface

SCALE = 0.15
POSES = (
    FingerPose(insertion_mm=26.0),
    FingerPose(insertion_mm=27.0, yaw_rad=0.14, roll_rad=0.12, x_mm=1.0),
    FingerPose(insertion_mm=25.0, yaw_rad=-0.17, roll_rad=-0.05, pitch_rad=0.05),
)


@dataclass(frozen=True, slots=True, eq=False)
class Impression:
    """Impression of a finger in one pose."""

    finger: int
    pose: FingerPose
    ridge_mm: np.ndarray
    shape_mm: np.ndarray
    mask: np.ndarray
    normals: np.ndarray
    pitch_mm: float

    def band(self) -> RidgeBand:
        return ridge_band(self.ridge_mm, self.mask, self.pitch_mm, self.shape_mm)

    def template(self) -> Template:
        return make_template(self.band())

    def images(self) -> FingerImages:
        return finger_images(
            self.normals,
            self.normals,
            self.ridge_mm,
            self.mask,
            self.pitch_mm,
            input_from_upright=np.eye(3),
            upright_size=self.mask.shape,
        )


@pytest.fixture(scope="session")
def impressions() -> list[Impression]:
    """Three impressions of each of three fingers."""
    camera = default_rig(SCALE).camera
    drawn = []
    for seed, pattern in enumerate(("left_loop", "whorl", "left_loop")):
        finger = draw_finger(700 + seed, pattern)
        master = finger.master()
        for pose in POSES:
            seen = finger_surface(replace(finger, printed=master), pose, camera)
            ridge = seen.height_mm - seen.shape_mm
            surface = ridge, seen.shape_mm, seen.mask, seen.normals
            drawn.append(Impression(seed, pose, *surface, camera.pitch_mm))
    return drawn


@pytest.fixture(scope="session")
def templates(impressions: list[Impression]) -> list[Template]:
    """The template of each impression."""
    return [impression.template() for impression in impressions]
