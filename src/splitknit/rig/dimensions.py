"""Every dimension of the printed parts, from the rig file and the settings.

All places are in the rig's frame (``docs/conventions.md``): the finger plane is z = 0, the fingertip points to +y, the
camera stands at z = `height_mm`. Heights of the parts are stacked in that frame, base lowest; with the camera below the
whole stack is turned over.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from splitknit.errors import require
from splitknit.model import Rig
from splitknit.rig.led_holes import LedHole, led_hole
from splitknit.rig.nail import nail_height
from splitknit.rig.part_settings import PartSettings

SCREWS_A_DEG = (35.0, 145.0, 215.0, 335.0)
"""Azimuths of the screws between base and cylinder, and between frame and box: uneven, so that parts fit one way."""
SCREWS_B_DEG = (0.0, 90.0, 180.0, 280.0)
"""Azimuths between cylinder and frame, and between box and lid: out of the way of a screwdriver for the others."""
_HALF = math.sqrt(0.5)
_GROOVE_IN_FLOOR_MM = 0.4
"""The groove's bottom lies this much below the base's upper face."""


@dataclass(frozen=True, slots=True, eq=False)
class RigDimensions:
    """What the parts are made from. Heights (`..._z_mm`) and places are in the rig's frame."""

    settings: PartSettings
    camera_height_mm: float
    field_mm: tuple[float, float]
    """Width (x) and height (y) of the picture on the finger plane."""
    holes: tuple[LedHole, ...]
    bore_mm: float
    """Inner radius of cylinder, frame and box."""
    floor_z_mm: float
    """Upper face of the base, the joint between base and cylinder."""
    frame_z_mm: float
    """Lower face of the frame, the joint between cylinder and frame."""
    box_z_mm: float
    lid_z_mm: float
    board_z_mm: float
    """Front of the camera's board."""
    stop_y_mm: float
    """Where the fingertip stops."""
    niche_y_mm: float
    """Outer face of the niche's end wall, with the opening for the finger."""
    opening_radius_mm: float
    nail_mm: float
    """Height of the nail's tip over the finger plane."""

    @property
    def outer_mm(self) -> float:
        """Outer radius of the tubes."""
        return self.bore_mm + self.settings.joint.wall_mm

    @property
    def ring_mm(self) -> float:
        """Outer radius of floors and of the tubes' ends."""
        return self.outer_mm + self.settings.joint.ring_mm

    @property
    def screw_mm(self) -> float:
        """Radius of the circle of screws."""
        joint = self.settings.joint
        return self.bore_mm + joint.ridge_mm + joint.lug_radius_mm + 0.1

    @property
    def outside_mm(self) -> float:
        """Radius that everything fits into."""
        return self.screw_mm + self.settings.joint.lug_radius_mm

    @property
    def base_z_mm(self) -> float:
        """Lowest face of the base."""
        return self.floor_z_mm - self.settings.joint.plate_mm

    @property
    def top_z_mm(self) -> float:
        """Upper face of the lid."""
        return self.lid_z_mm + self.settings.joint.plate_mm

    @property
    def cylinder_mm(self) -> float:
        """Height of the cylinder between its joints."""
        return self.frame_z_mm - self.floor_z_mm

    @property
    def niche_inner_y_mm(self) -> float:
        """Inner face of the niche's end wall."""
        return self.niche_y_mm + self.settings.joint.wall_mm

    @property
    def niche_roof_mm(self) -> float:
        """Highest point of the niche, outside, above the floor."""
        finger, wall = self.settings.finger, self.settings.joint.wall_mm
        return finger.hand_height_mm + finger.hand_width_mm / 2 + wall / _HALF

    @property
    def groove_z_mm(self) -> float:
        """Bottom of the finger's groove."""
        return -self.settings.finger.pad_height_mm

    @property
    def groove_width_mm(self) -> float:
        """Width of the finger's groove at its rim."""
        return self.settings.finger.widest_mm + self.settings.finger.clearance_mm

    @property
    def groove_radius_mm(self) -> float:
        """Radius of the groove's round bottom."""
        half, depth = self.groove_width_mm / 2, self.settings.finger.groove_depth_mm
        return (half * half + depth * depth) / (2 * depth)

    @property
    def block_mm(self) -> float:
        """Half the width of the block that holds the groove."""
        return self.groove_width_mm / 2 + self.settings.joint.wall_mm

    @property
    def disc_radius_mm(self) -> float:
        """Of the calibration disc: as large as the niche allows."""
        return math.floor(-self.niche_inner_y_mm - 1.0)

    @property
    def lens_hole_mm(self) -> float:
        """Radius of the frame's opening for the lens."""
        opening = self.settings.camera.barrel_mm / 2 + 0.4
        above = max(0.0, self.camera_height_mm - self.frame_z_mm)  # a lens behind the frame must see past its edge
        return opening + above * math.hypot(*self.field_mm) / 2 / self.camera_height_mm

    @property
    def pocket_mm(self) -> float:
        """Depth of the shallow pockets of the base that hold mirror holders and calibration disc in place."""
        return 1.0


def dimensions_of(rig: Rig, settings: PartSettings | None = None) -> RigDimensions:
    """Work out all dimensions.

    Parameters
    ----------
    rig : Rig
        With the place of every LED.
    settings : PartSettings

    Returns
    -------
    RigDimensions
        Not yet checked: see :func:`splitknit.rig.dimension_checks.check_dimensions`.

    Raises
    ------
    BadInput
        If an LED has no place, or the picture is too small for a nail's shadows.

    Examples
    --------
    >>> from splitknit.model import default_rig
    >>> dimensions = dimensions_of(default_rig())
    >>> round(dimensions.holes[0].tilt_deg, 1)
    20.6
    """
    settings = settings or PartSettings()
    camera, finger, joint, nail = rig.camera, settings.finger, settings.joint, settings.calibration
    rows, columns = camera.image_size
    field = (columns / camera.px_per_mm, rows / camera.px_per_mm)
    holes = tuple(led_hole(index, led, settings.led) for index, led in enumerate(rig.leds))
    require(len(holes) > 0, "the rig has no LEDs; parts cannot be drawn for it.")
    frame_z = min(  # the lowest LED's dome stands free below the frame, those of higher ones in funnels
        float(hole.light_mm[2]) + hole.radius_mm * math.sin(math.radians(hole.tilt_deg)) + settings.led.tip_free_mm
        for hole in holes
    )
    board_z = camera.height_mm + settings.camera.board_above_lens_mm
    plate_top = frame_z + joint.plate_mm
    highest = max(board_z, plate_top, *(float(hole.at(hole.back_mm)[2]) + hole.radius_mm for hole in holes))
    lug_room = 2 * joint.lug_mm + joint.insert_depth_mm + _gusset(settings)
    box_z = max(highest + settings.board.wire_room_mm, frame_z + lug_room)
    lid_z = max(box_z + joint.plate_mm + _boards_high(settings), box_z + lug_room)
    stop_y = min(field[1] / 2 - finger.tip_margin_mm, finger.phalanx_mm / 2)
    return RigDimensions(
        settings=settings,
        camera_height_mm=float(camera.height_mm),
        field_mm=field,
        holes=holes,
        bore_mm=_bore(holes, settings, field),
        floor_z_mm=-finger.pad_height_mm + _GROOVE_IN_FLOOR_MM,
        frame_z_mm=frame_z,
        box_z_mm=box_z,
        lid_z_mm=lid_z,
        board_z_mm=board_z,
        stop_y_mm=stop_y,
        niche_y_mm=stop_y - finger.reach_mm,
        opening_radius_mm=_opening(settings),
        nail_mm=nail_height(rig, nail.nail_offset_mm, nail.nail_margin_mm, nail.nail_radius_mm),
    )


def _bore(holes: tuple[LedHole, ...], settings: PartSettings, field: tuple[float, float]) -> float:
    """Return the inner radius, in steps of half a millimetre: LEDs, picture, and boards must fit."""
    board = settings.board
    wanted = [
        max(hole.radius_taken_mm for hole in holes) + 0.5,
        math.hypot(*field) / 2 + 3.0,
        math.hypot(board.pi_x_mm / 2 + board.pi_overhang_mm, board.pi_y_mm / 2) + 1.0,
        math.hypot(board.pcb_x_mm, board.pcb_y_mm) / 2 + 0.8,
    ]
    return math.ceil(2 * max(wanted)) / 2


def _opening(settings: PartSettings) -> float:
    """Return the radius of the semicircle that passes the thickest finger, an ellipse that lies on the floor."""
    angle = np.linspace(0.0, np.pi, 361)
    x = settings.finger.widest_mm / 2 * np.cos(angle)
    z = settings.finger.thickest_mm / 2 * (1 + np.sin(angle))
    return float(np.hypot(x, z).max()) + settings.finger.clearance_mm


def _gusset(settings: PartSettings) -> float:
    """Height of the 45 deg support under a lug."""
    joint = settings.joint
    return joint.ridge_mm + 2 * joint.lug_radius_mm + 0.1 - joint.wall_mm


def _boards_high(settings: PartSettings) -> float:
    board = settings.board
    return board.pi_post_height_mm + 1.5 + board.pcb_over_pi_mm + 1.6 + board.pcb_parts_mm
