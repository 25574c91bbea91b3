"""Settings of the printed parts, in mm and degrees: what the rig file does not contain. What follows from the rig file
(LED places, camera height, field of view) is worked out in :mod:`splitknit_rig.rig.dimensions`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from splitknit import Checked, Limits, require


@dataclass(frozen=True, slots=True)
class PrinterSettings(Checked):
    """The printer and what it can do without support."""

    bed_x_mm: Annotated[float, Limits(0.05, 1000)] = 220.0
    """Largest print, along x."""
    bed_y_mm: Annotated[float, Limits(0.05, 1000)] = 220.0
    """Largest print, along y."""
    bed_z_mm: Annotated[float, Limits(0.05, 1000)] = 250.0
    """Largest print, its height."""


NOZZLE_MM = 0.4  # width of the nozzle: the calibration nail's tip is as wide
LAYER_MM = 0.2  # height of a layer: the step in which a part is looked through for what hangs over
MIN_WALL_MM = 1.2  # three lines of a 0.4 mm nozzle
MAX_OVERHANG_DEG = 45.0  # faces that look down and lean further than this from the vertical need a look
BRIDGE_MM = 10.0  # longest bridge over air that is printed without support
DENSITY_G_PER_CM3 = 1.24  # PLA


@dataclass(frozen=True, slots=True)
class _JointSettings(Checked):
    """How parts meet: a tapered ridge in a tapered groove, and M3 screws in lugs."""

    wall_mm: Annotated[float, Limits(0.05, 1000)] = 2.4
    """Thickness of all upright walls; at least 1.2."""


JOINT_CLEARANCE_MM = 0.2  # between parts that slide into each other, on each side
JOINT_PLATE_MM = 4.4  # thickness of floors and of the lid: 1.2 mm and more remain below the groove
JOINT_RIDGE_MM = 2.4  # width of the ridge at its foot; its flank leans by 45 deg
JOINT_RIDGE_HIGH_MM = 1.2  # height of the ridge
JOINT_RING_MM = 4.0  # how far the ends of a tube are thickened beyond the wall
JOINT_LUG_RADIUS_MM = 5.0  # half the width of the lugs that the screws go through
JOINT_LUG_MM = 4.0  # thickness of the lug under a screw's head: M3 x 8 then reaches through a 4 mm insert
JOINT_SCREW_HOLE_MM = 3.4  # diameter of the hole that an M3 screw passes freely
JOINT_INSERT_HOLE_MM = 4.0  # for a heat-set insert M3 x 4
JOINT_INSERT_DEPTH_MM = 6.0  # depth of that hole: the insert, and room below it for the screw's end
JOINT_FOOT_MM = 8.5  # pockets for stick-on rubber feet of 8 mm, on base and lid


@dataclass(frozen=True, slots=True)
class LedSettings(Checked):
    """The LEDs: round, with a flange that rests on a shoulder of the hole."""

    white_diameter_mm: Annotated[float, Limits(0.05, 1000)] = 5.0
    """Diameter of the white LEDs' body; the hole is wider by the clearance."""
    nir_diameter_mm: Annotated[float, Limits(0.05, 1000)] = 5.0
    """Diameter of the NIR LEDs' body; 3 for the small ones (then also `nir_flange_mm` 3.8, `nir_flange_to_light_mm`
    2.9)."""
    white_flange_mm: Annotated[float, Limits(0.05, 1000)] = 5.9
    """Diameter of the white LEDs' flange, which rests on the shoulder."""
    nir_flange_mm: Annotated[float, Limits(0.05, 1000)] = 5.9
    """Diameter of the NIR LEDs' flange."""
    white_flange_to_light_mm: Annotated[float, Limits(0.05, 1000)] = 5.2
    """From the flange's front to the middle of the dome, which is the LED's `position_mm` in the rig file."""
    nir_flange_to_light_mm: Annotated[float, Limits(0.05, 1000)] = 5.2
    """The same of the NIR LEDs."""


LED_CLEARANCE_MM = 0.1  # clearance of the hole, on each side
LED_POCKET_MM = 3.0  # depth of the pocket behind the shoulder, for flange and glue
LED_TIP_FREE_MM = 0.5  # the frame's lower face stays at least this much behind every LED's light


@dataclass(frozen=True, slots=True)
class _FingerSettings(Checked):
    """Fingers of men and women, and how they lie.

    British adults of 19 to 65 years (5th percentile of women to 95th of men, mm): thumb breadth 17 to 26, index finger
    breadth 16 to 23, thumb thickness 15 to 24, index finger thickness 14 to 21, index finger length 60 to 79, little
    finger length 43 to 63 (breadth and thickness at the proximal joint; the last phalanx is about a quarter thinner):
    S. Pheasant, "Bodyspace: Anthropometry, Ergonomics and the Design of Work", 2nd edition, 1996, table of the hand.
    """

    widest_mm: Annotated[float, Limits(0.05, 1000)] = 26.0
    """Largest finger width: the thumb, 95th percentile of men."""
    pad_height_mm: Annotated[float, Limits(0.05, 1000)] = 14.0
    """Thickness of the last phalanx: the groove's bottom lies this far below the finger plane."""
    groove_depth_mm: Annotated[float, Limits(0.05, 1000)] = 6.0
    """From the groove's rim to its bottom; less than `finger.stop_height_mm`."""
    reach_mm: Annotated[float, Limits(0.05, 1000)] = 45.0
    """From the finger's stop to where the hand must stay outside: the little finger of most women is as long."""
    hand_width_mm: Annotated[float, Limits(0.05, 1000)] = 80.0
    """Width of the niche in front of the opening: knuckles of the fingers beside it."""
    hand_height_mm: Annotated[float, Limits(0.05, 1000)] = 16.0
    """Height of the niche at its sides; its roof then rises at 45 deg."""
    tip_margin_mm: Annotated[float, Limits(0.05, 1000)] = 3.0
    """From the fingertip at the stop to the upper border of the picture, at least."""
    stop_height_mm: Annotated[float, Limits(0.05, 1000)] = 9.0
    """Height of the stop over the groove's bottom; lower than the tip's pad, so that it throws no shadow on it."""


FINGER_THICKEST_MM = 24.0  # thumb at its joint, 95th percentile of men: what the opening must pass
FINGER_CLEARANCE_MM = 2.0  # around the widest and thickest finger in the opening; on both sides together in the groove
FINGER_PHALANX_MM = 30.0
"""From the tip backwards what must be lit by every LED; in a large picture it lies in the middle."""


@dataclass(frozen=True, slots=True)
class _CameraSettings(Checked):
    """The camera's board (Raspberry Pi camera v2: 25 x 24 mm, holes 21 x 12.5 mm, M2) and its lens."""

    board_y_mm: Annotated[float, Limits(0.05, 1000)] = 24.0
    """Length of the board along y."""
    board_above_lens_mm: Annotated[float, Limits(0.05, 1000)] = 12.0
    """From the lens's centre to the board's front: 12 mm for an M12 holder, about 5 for the stock lens."""
    barrel_mm: Annotated[float, Limits(0.05, 1000)] = 15.0
    """Diameter of the lens where it passes the frame: M12 lenses and the round part of their holders have 14."""
    barrel_front_mm: Annotated[float, Limits(0.05, 1000)] = 8.0
    """How far the lens reaches below its centre of projection, towards the finger."""


CAMERA_BOARD_X_MM = 25.0  # size of the camera's board along x: no LED may stand where it is
CAMERA_HOLE_X_MM = 21.0  # distance of the board's holes along x
CAMERA_HOLE_Y_MM = 12.5  # distance of its two lines of holes along y
CAMERA_LENS_TO_HOLES_MM = 0.0
"""From the lens's axis to the line of the nearer two holes; the other two lie `hole_y_mm` further."""
CAMERA_LENS_TO_CONNECTOR_MM = 9.5  # from the lens's axis to the edge with the flat cable's connector
CAMERA_POST_MM = 5.0  # diameter of the posts that carry the board
CAMERA_POST_HOLE_MM = 1.7  # for self-tapping M2 screws


@dataclass(frozen=True, slots=True)
class BoardSettings(Checked):
    """Raspberry Pi 4B (85 x 56 mm, holes 58 x 49 mm, M2.5) and the LED circuit's board above it."""

    pcb_x_mm: Annotated[float, Limits(0.05, 1000)] = 90.0
    """Size of the circuit's board along x."""
    pcb_y_mm: Annotated[float, Limits(0.05, 1000)] = 70.0
    """Size of the circuit's board along y: 90 x 70 is a common size of prototype board."""
    pcb_hole_x_mm: Annotated[float, Limits(0.05, 1000)] = 84.0
    """Distance of the circuit's holes along x."""
    pcb_hole_y_mm: Annotated[float, Limits(0.05, 1000)] = 64.0
    """Distance of the circuit's holes along y."""


PI_X_MM = 85.0  # size of the Pi's board along x, without what stands out
PI_Y_MM = 56.0  # size of the Pi's board along y
PI_HOLE_X_MM = 58.0  # distance of the Pi's holes along x
PI_HOLE_Y_MM = 49.0  # distance of the Pi's holes along y
PI_HOLE_EDGE_MM = 3.5  # from the middle of the Pi's first holes to the edge of its board, along x
PI_OVERHANG_MM = 3.0  # how far the USB sockets stand out
PI_POST_HEIGHT_MM = 6.0  # from the box's floor up to the Pi's board
PI_POST_HOLE_MM = 2.1  # for self-tapping M2.5 screws
PCB_OVER_PI_MM = 22.0  # from the Pi's board to the circuit's board: over the USB sockets
PCB_POST_HOLE_MM = 2.5  # for self-tapping M3 screws
PCB_PARTS_MM = 16.0  # room above the circuit's board
SECOND_BOARD_MM = 20.0  # from the circuit's board to a second one above it, for further LEDs: spacers M3 x 20
SERVO_HIGH_MM = 19.0  # height of a servo's body, with its wires, over its ears, which lie on the frame's floor
SERVO_MM = (12.6, 23.2)  # hole for a servo's body
SERVO_SHAFT_MM = 6.2  # from the end of that hole to the servo's shaft
SERVO_SCREWS_MM = 28.0  # distance of the screws through a servo's ears
BOARD_POST_MM = 7.0  # diameter of the posts that carry both boards
CABLE_HOLE_MM = 16.0  # passes a USB-C plug and the LEDs' supply
SLOT_X_MM = 24.0  # length, along x, of the floor's openings for flat cable and LED wires
SLOT_Y_MM = 8.0  # width of these openings
WIRE_ROOM_MM = 10.0  # above the camera's board and the LEDs, for their wires


@dataclass(frozen=True, slots=True)
class _CalibrationSettings(Checked):
    """Calibration disc and nail."""

    dot_mm: Annotated[float, Limits(0.05, 1000)] = 1.5
    """Diameter of the disc's dots."""


DOT_SPACING_MM = 10.0  # from dot to dot, along x and along y; one dot is in the middle
DISC_MM = 2.4  # thickness of the disc
DOT_DEPTH_MM = 0.6  # depth of recessed dots; the disc stays at least 1.2 mm thick below them
NAIL_OFFSET_MM = 6.0  # how far from the middle the nail may stand, along rows and along columns
NAIL_MARGIN_MM = 2.0  # between the farthest shadow tip and the border of the picture
NAIL_RADIUS_MM = 2.5  # radius of the nail's foot: every shadow's tip must fall outside it


@dataclass(frozen=True, slots=True)
class _MirrorSettings(Checked):
    """First-surface mirrors beside the finger, at 45 deg."""

    wide_mm: Annotated[float, Limits(0.05, 1000)] = 20.0
    """Width of a mirror, up its slope."""


MIRROR_LONG_MM = 30.0  # length of a mirror, along its lower edge
MIRROR_THICK_MM = 2.0  # thickness of a mirror's glass
MIRROR_GAP_MM = 1.0  # between the groove's block and a holder
MIRROR_LIP_MM = 0.8  # how much of the mirror's lower edge the lip covers


@dataclass(frozen=True, slots=True)
class PartSettings:
    """All settings of the parts."""

    printer: PrinterSettings = field(default_factory=PrinterSettings)
    joint: _JointSettings = field(default_factory=_JointSettings)
    led: LedSettings = field(default_factory=LedSettings)
    finger: _FingerSettings = field(default_factory=_FingerSettings)
    camera: _CameraSettings = field(default_factory=_CameraSettings)
    board: BoardSettings = field(default_factory=BoardSettings)
    calibration: _CalibrationSettings = field(default_factory=_CalibrationSettings)
    mirror: _MirrorSettings = field(default_factory=_MirrorSettings)

    def __post_init__(self) -> None:
        wall = self.joint.wall_mm
        require(wall >= MIN_WALL_MM, f"joint.wall_mm is {wall:g}, thinner than the minimum of {MIN_WALL_MM:g} mm.")
        require(
            self.finger.stop_height_mm < self.finger.pad_height_mm,
            f"finger.stop_height_mm is {self.finger.stop_height_mm:g}, but the stop must end below the finger plane, "
            f"{self.finger.pad_height_mm:g} mm above the groove (finger.pad_height_mm).",
        )
        require(
            self.finger.groove_depth_mm < self.finger.stop_height_mm,
            f"finger.groove_depth_mm is {self.finger.groove_depth_mm:g}, but the stop is only "
            f"{self.finger.stop_height_mm:g} mm high (finger.stop_height_mm).",
        )
