"""The dimensions: what ``dimensions.toml`` says, and the constants that nobody has varied yet.
Lengths in mm."""

from __future__ import annotations

import tomllib
from argparse import ArgumentParser, Namespace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require

Array = NDArray[np.float64]
DIMENSIONS = Path(__file__).with_name("dimensions.toml")


def arguments(description: str, out: str) -> Namespace:
    """Command line of a script: its file of dimensions and its folder."""
    parser = ArgumentParser(description=description)
    parser.add_argument(
        "--dimensions", type=Path, default=DIMENSIONS, help="file of dimensions (TOML)"
    )
    parser.add_argument("--out", type=Path, default=Path(out), help="folder to write")
    return parser.parse_args()


def read_dimensions(
    path: Path = DIMENSIONS, changes: dict[str, Any] | None = None
) -> SimpleNamespace:
    """The dimensions of a file, of ``dimensions.toml`` where it says nothing. BadInput if a name is
    unknown.

    >>> read_dimensions(changes={"finger": {"pad_height_mm": 11.0}}).finger.pad_height_mm
    11.0
    """
    read = [tomllib.loads(source.read_text(encoding="utf-8")) for source in (DIMENSIONS, path)]
    table = _merged(_merged(*read), changes or {})
    file = table["rig"]["file"]
    table["rig"]["file"] = file and str(path.parent / file)
    return _checked(_spaces(table))


def _merged(table: dict[str, Any], changes: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    for name, value in changes.items():
        require(
            name in table and isinstance(value, dict) == isinstance(table[name], dict),
            f"'{prefix}{name}' is not a dimension; known are"
            f" {', '.join(prefix + key for key in table)}.",
        )
    return {
        name: (
            _merged(value, changes.get(name, {}), f"{prefix}{name}.")
            if isinstance(value, dict)
            else changes.get(name, value)
        )
        for name, value in table.items()
    }


def _spaces(table: Any) -> Any:
    if not isinstance(table, dict):
        return table
    return SimpleNamespace(**{name: _spaces(value) for name, value in table.items()})


def _checked(s: SimpleNamespace) -> SimpleNamespace:
    wall, finger = s.joint.wall_mm, s.finger
    require(
        wall >= MIN_WALL_MM,
        f"joint.wall_mm is {wall:g}, thinner than the minimum of {MIN_WALL_MM:g} mm.",
    )
    require(
        finger.stop_height_mm < finger.pad_height_mm,
        f"finger.stop_height_mm is {finger.stop_height_mm:g}, but the stop must end below the"
        f" finger plane, {finger.pad_height_mm:g} mm above the groove (finger.pad_height_mm).",
    )
    require(
        finger.groove_depth_mm < finger.stop_height_mm,
        f"finger.groove_depth_mm is {finger.groove_depth_mm:g}, but the stop is only"
        f" {finger.stop_height_mm:g} mm high (finger.stop_height_mm).",
    )
    return s


NOZZLE_MM = 0.4  # width of the nozzle: the calibration nail's tip is as wide
MIN_WALL_MM = 1.2  # three lines of a 0.4 mm nozzle
DENSITY_G_PER_CM3 = 1.24  # PLA


JOINT_CLEARANCE_MM = 0.2  # between parts that slide into each other, on each side
JOINT_PLATE_MM = 4.4  # thickness of floors and of the lid: 1.2 mm and more remain below the groove
JOINT_RIDGE_MM = 2.4  # width of the ridge at its foot; its flank leans by 45 deg
JOINT_RIDGE_HIGH_MM = 1.2  # height of the ridge
JOINT_RING_MM = 4.0  # how far the ends of a tube are thickened beyond the wall
JOINT_LUG_RADIUS_MM = 5.0  # half the width of the lugs that the screws go through
# thickness of the lug under a screw's head: M3 x 8 then reaches through a 4 mm insert
JOINT_LUG_MM = 4.0
JOINT_SCREW_HOLE_MM = 3.4  # diameter of the hole that an M3 screw passes freely
JOINT_INSERT_HOLE_MM = 4.0  # for a heat-set insert M3 x 4
JOINT_INSERT_DEPTH_MM = 6.0  # depth of that hole: the insert, and room below it for the screw's end
JOINT_FOOT_MM = 8.5  # pockets for stick-on rubber feet of 8 mm, on base and lid

LED_CLEARANCE_MM = 0.1  # clearance of the hole, on each side
LED_POCKET_MM = 3.0  # depth of the pocket behind the shoulder, for flange and glue
LED_TIP_FREE_MM = 0.5  # the frame's lower face stays at least this much behind every LED's light

FINGER_THICKEST_MM = 24.0  # thumb at its joint, 95th percentile of men: what the opening must pass
# around the widest and thickest finger in the opening; on both sides together in the groove
FINGER_CLEARANCE_MM = 2.0
FINGER_PHALANX_MM = 30.0
"""From the tip backwards what must be lit by every LED; in a large picture it lies in the
middle."""


CAMERA_BOARD_X_MM = 25.0  # size of the camera's board along x: no LED may stand where it is
CAMERA_HOLE_X_MM = 21.0  # distance of the board's holes along x
CAMERA_HOLE_Y_MM = 12.5  # distance of its two lines of holes along y
CAMERA_LENS_TO_HOLES_MM = 0.0
"""From the lens's axis to the line of the nearer two holes; the other two lie `CAMERA_HOLE_Y_MM`
further."""
# from the lens's axis to the edge with the flat cable's connector
CAMERA_LENS_TO_CONNECTOR_MM = 9.5
CAMERA_POST_MM = 5.0  # diameter of the posts that carry the board
CAMERA_POST_HOLE_MM = 1.7  # for self-tapping M2 screws

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
# from the circuit's board to a second one above it, for further LEDs: spacers M3 x 20
SECOND_BOARD_MM = 20.0
# height of a servo's body, with its wires, over its ears, which lie on the frame's floor
SERVO_HIGH_MM = 19.0
SERVO_MM = (12.6, 23.2)  # hole for a servo's body
SERVO_SHAFT_MM = 6.2  # from the end of that hole to the servo's shaft
SERVO_SCREWS_MM = 28.0  # distance of the screws through a servo's ears
BOARD_POST_MM = 7.0  # diameter of the posts that carry both boards
CABLE_HOLE_MM = 16.0  # passes a USB-C plug and the LEDs' supply
SLOT_X_MM = 24.0  # length, along x, of the floor's openings for flat cable and LED wires
SLOT_Y_MM = 8.0  # width of these openings
WIRE_ROOM_MM = 10.0  # above the camera's board and the LEDs, for their wires

DOT_SPACING_MM = 10.0  # from dot to dot, along x and along y; one dot is in the middle
DISC_MM = 2.4  # thickness of the disc
DOT_DEPTH_MM = 0.6  # depth of recessed dots; the disc stays at least 1.2 mm thick below them
NAIL_OFFSET_MM = 6.0  # how far from the middle the nail may stand, along rows and along columns
NAIL_MARGIN_MM = 2.0  # between the farthest shadow tip and the border of the picture
NAIL_RADIUS_MM = 2.5  # radius of the nail's foot: every shadow's tip must fall outside it

MIRROR_LONG_MM = 30.0  # length of a mirror, along its lower edge
MIRROR_THICK_MM = 2.0  # thickness of a mirror's glass
MIRROR_GAP_MM = 1.0  # between the groove's block and a holder
MIRROR_LIP_MM = 0.8  # how much of the mirror's lower edge the lip covers
