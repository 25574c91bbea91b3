"""Views of simulated fingers in mirrors, as masks, without any photograph."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from splitknit.mirrors.mirror import MirrorShape
from splitknit.mirrors.views import Views
from splitknit.model import BoolArray, FloatArray, Mirror, Rig
from splitknit_simulator.finger.finger import FingerPose, draw_finger, finger_surface, placement_of
from splitknit_simulator.finger.raycast import PlacedFinger
from splitknit_simulator.finger.shape import FingerBody
from splitknit_simulator.finger.skin_map import skin_map
from splitknit_simulator.mirror_view import mirror_view
from splitknit_simulator.rigs import MirrorSettings, mirror_rig

SCALE = 0.2


@dataclass(frozen=True)
class Scene:
    """A finger between mirrors that stand where they truly are."""

    rig: Rig
    views: Views
    shape_mm: FloatArray
    mask: BoolArray

    def rms_mm(self, shape: MirrorShape) -> float:
        """Of a shape against the truth, mean removed, 0.33 mm inside the outline."""
        _, _, z = shape.points(slice(None), slice(None))
        common = np.isfinite(z) & self.mask
        depth = cv2.distanceTransform(np.pad(common, 1).astype(np.uint8), cv2.DIST_L2, 5)[
            1:-1, 1:-1
        ]
        return float(np.std((z - self.shape_mm)[depth > 0.33 * self.rig.camera.px_per_mm]))


def turned(mirror: Mirror, turn_deg: float, lean_deg: float, shift_mm: float) -> Mirror:
    """A mirror turned about the camera's axis, leaned about its own level axis, and shifted along
    its normal."""
    corners = np.asarray(mirror.corners_mm)
    middle, normal = corners.mean(axis=0), mirror.normal
    level = np.cross([0.0, 0.0, 1.0], normal)
    lean = cv2.Rodrigues(np.deg2rad(-lean_deg) * level / np.linalg.norm(level))[0]
    turn = cv2.Rodrigues(np.deg2rad(turn_deg) * np.array([0.0, 0.0, 1.0]))[0]
    moved = (corners - middle) @ (turn @ lean).T + middle + shift_mm * normal
    return replace(mirror, corners_mm=tuple(tuple(float(v) for v in corner) for corner in moved))


def scene(
    seed: int,
    names: tuple[str, ...] = ("left", "right", "tip"),
    pose: FingerPose | None = None,
    model: str = "orthographic",
) -> Scene:
    """The masks of a drawn finger's views."""
    rig = mirror_rig(MirrorSettings(names=names, nir=False, model=model), SCALE)
    finger = draw_finger(seed)
    body, master = FingerBody(finger.shape), finger.master()
    pose = pose or FingerPose(yaw_rad=0.06, pitch_rad=0.02, roll_rad=0.0, insertion_mm=28.5)
    placement, skin = placement_of(body, pose, rig.camera), skin_map(master, finger.skin)
    front = finger_surface(replace(finger, printed=master), pose, rig.camera)
    masks = {
        m.name: mirror_view(PlacedFinger(body, skin, placement), rig.camera, m).mask
        for m in rig.mirrors
    }
    return Scene(rig, Views(front.mask, masks, 1), front.shape_mm, front.mask)
