"""Rigs that cannot be built are refused, each in one sentence with the remedy."""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.rig import part_settings as sizes
from splitknit.rig.dimensions import LedHole, RigDimensions
from splitknit.rig.films import film_mounts

_SAMPLES = 400
_MIN_SEAT_MM = 0.6
"""An LED's flange rests on three layers at least."""


def check_dimensions(dimensions: RigDimensions) -> None:
    """Refuse what cannot be printed, put together, or lit and seen through, naming the LED or dimension at fault."""
    _check_bed(dimensions)
    _check_height(dimensions)
    _check_finger(dimensions)
    for first, second in itertools.combinations(dimensions.holes, 2):
        _check_pair(first, second)
    for hole in dimensions.holes:
        _check_hole(hole, dimensions)
        _check_camera(hole, dimensions)
        _check_beam(hole, dimensions)
    if dimensions.films is not None:
        film_mounts(dimensions)  # refuses LEDs that leave no room


def _check_bed(dimensions: RigDimensions) -> None:
    printer = dimensions.settings.printer
    circle = max(float(np.hypot(*hole.light_mm[:2])) for hole in dimensions.holes)
    bed = min(printer.bed_x_mm, printer.bed_y_mm)
    size = 2 * dimensions.outside_mm
    require(
        size <= bed,
        f"the LEDs stand up to {circle:.1f} mm from the camera's axis and the picture is "
        f"{dimensions.field_mm[0]:.0f} x {dimensions.field_mm[1]:.0f} mm, so that the parts are {size:.0f} mm wide, "
        f"more than the printer's bed of {bed:g} mm (printer.bed_x_mm, printer.bed_y_mm).",
    )
    high = dimensions.cylinder_mm + sizes.JOINT_RIDGE_HIGH_MM
    require(
        high <= printer.bed_z_mm,
        f"the cylinder is {high:.0f} mm high, more than the printer's {printer.bed_z_mm:g} mm (printer.bed_z_mm).",
    )


def _check_height(dimensions: RigDimensions) -> None:
    least = dimensions.frame_z_mm + sizes.JOINT_PLATE_MM + 1.0
    above = math.ceil(10 * (least - dimensions.camera_height_mm)) / 10
    require(
        dimensions.board_z_mm >= least,
        f"the camera's board would lie at {dimensions.board_z_mm:.1f} mm, inside the LED frame, which ends at "
        f"{least - 1.0:.1f} mm; set camera.board_above_lens_mm to {above:g} or more, "
        f"or lower the LEDs against the camera.",
    )
    nearest = math.hypot(
        sizes.CAMERA_HOLE_X_MM / 2,
        min(sizes.CAMERA_LENS_TO_HOLES_MM, sizes.CAMERA_HOLE_Y_MM - sizes.CAMERA_LENS_TO_HOLES_MM),
    )
    room = nearest - sizes.CAMERA_POST_HOLE_MM / 2 - sizes.MIN_WALL_MM
    behind = dimensions.camera_height_mm > dimensions.frame_z_mm
    require(
        dimensions.lens_hole_mm <= room,
        f"the lens's opening of {2 * dimensions.lens_hole_mm:.1f} mm leaves no wall beside the screws of the camera's "
        f"board, {2 * room:.1f} mm is the maximum; set camera.barrel_mm smaller"
        + (" or bring the camera nearer to the LEDs' height." if behind else "."),
    )
    roof = dimensions.floor_z_mm + dimensions.niche_roof_mm + dimensions.settings.joint.wall_mm
    require(
        roof <= dimensions.frame_z_mm - 20.0,
        f"the LEDs' frame at {dimensions.frame_z_mm:.0f} mm is too low over the hand's niche, which ends at "
        f"{roof:.0f} mm; set finger.hand_width_mm or finger.hand_height_mm smaller.",
    )


def _check_pair(first: LedHole, second: LedHole) -> None:
    least = sizes.MIN_WALL_MM
    needed = first.pocket_radius_mm + second.pocket_radius_mm + least
    for one, other in ((first.shoulder_mm, second.shoulder_mm), (first.back_mm, second.back_mm)):
        gap = float(np.linalg.norm(first.at(one) - second.at(other)))
        require(
            gap >= needed,
            f"LEDs {first.index} and {second.index} are {gap:.1f} mm apart at their flanges, but need {needed:.1f} mm "
            f"with a wall between them; use fewer or smaller LEDs or a larger circle.",
        )
    gap = float(np.linalg.norm(first.light_mm - second.light_mm))
    needed = first.radius_mm + second.radius_mm + least
    require(
        gap >= needed,
        f"LEDs {first.index} and {second.index} are {gap:.1f} mm apart, but their holes need {needed:.1f} mm.",
    )


def _check_hole(hole: LedHole, dimensions: RigDimensions) -> None:
    require(
        hole.tilt_deg <= 45.0,
        f"LED {hole.index} is tilted by {hole.tilt_deg:.0f} deg, but its hole can be printed up to 45 deg; raise the "
        f"LEDs, bring them nearer to the axis, or give them another aim.",
    )
    start = max(hole.level_mm(dimensions.frame_z_mm) + hole.lean_mm, sizes.LED_TIP_FREE_MM)
    land = hole.shoulder_mm - start
    require(
        land >= _MIN_SEAT_MM,
        f"LED {hole.index} at {hole.light_mm[2]:.1f} mm would rest on {max(land, 0):.1f} mm of plastic instead of "
        f"{_MIN_SEAT_MM:g} mm, as the frame's lower face is at {dimensions.frame_z_mm:.1f} mm; take LEDs with a "
        f"longer body (led.white_flange_to_light_mm, led.nir_flange_to_light_mm) or smaller ones.",
    )


def _check_camera(hole: LedHole, dimensions: RigDimensions) -> None:
    """Keep LEDs clear of the camera's board and of the lens's opening, which passes the whole view."""
    camera = dimensions.settings.camera
    own = hole.pocket_radius_mm + dimensions.settings.joint.wall_mm
    away = min(float(np.hypot(*hole.at(s)[:2])) for s in (0.0, hole.back_mm))
    ends = (
        sizes.CAMERA_LENS_TO_CONNECTOR_MM,
        camera.board_y_mm - sizes.CAMERA_LENS_TO_CONNECTOR_MM,
        sizes.CAMERA_HOLE_Y_MM + 4.0,
    )
    board = math.hypot(sizes.CAMERA_BOARD_X_MM / 2, max(ends))
    needed = max(dimensions.lens_hole_mm, board) + own
    require(
        away >= needed,
        f"LED {hole.index} is {away:.1f} mm from the camera's axis, where the camera sits; it needs {needed:.1f} mm "
        f"at least.",
    )


def _check_beam(hole: LedHole, dimensions: RigDimensions) -> None:
    """Nothing may stand between the LED and the last phalanx, as far as the picture shows it."""
    corners = dimensions.lit_corners
    fraction = np.linspace(0.0, 0.999, _SAMPLES)[:, None, None]
    way = hole.light_mm + fraction * (corners - hole.light_mm)  # (samples, corners, 3)
    require(
        not bool(_in_niche(way, dimensions).any()),
        f"the light of LED {hole.index} would be cut by the roof of the hand's niche; set finger.reach_mm larger, "
        f"or finger.hand_width_mm or finger.hand_height_mm smaller.",
    )
    camera = dimensions.settings.camera
    lens = (np.hypot(way[..., 0], way[..., 1]) < camera.barrel_mm / 2) & (
        way[..., 2] > dimensions.camera_height_mm - camera.barrel_front_mm
    )
    require(
        not bool(lens.any()), f"the light of LED {hole.index} would be cut by the lens; move the LED outwards or down."
    )


def _in_niche(points: NDArray[np.float64], dimensions: RigDimensions) -> NDArray[np.bool_]:
    finger, wall = dimensions.settings.finger, dimensions.settings.joint.wall_mm
    x, y, z = np.abs(points[..., 0]), points[..., 1], points[..., 2] - dimensions.floor_z_mm
    roof = finger.hand_height_mm + finger.hand_width_mm / 2 + wall * math.sqrt(2.0) - x
    return np.asarray((y < dimensions.niche_inner_y_mm) & (x < finger.hand_width_mm / 2 + wall) & (z < roof))


def _check_finger(dimensions: RigDimensions) -> None:
    finger, joint = dimensions.settings.finger, dimensions.settings.joint
    half = finger.hand_width_mm / 2 + joint.wall_mm
    require(
        half >= dimensions.opening_radius_mm + joint.wall_mm,
        f"the niche of {finger.hand_width_mm:g} mm is narrower than the opening of "
        f"{2 * dimensions.opening_radius_mm:.0f} mm for the finger; set finger.hand_width_mm to "
        f"{2 * dimensions.opening_radius_mm:.0f} or more.",
    )
    room = dimensions.screw_mm * math.sin(math.radians(90.0 - 35.0)) - sizes.JOINT_LUG_RADIUS_MM
    require(
        half < room,
        f"the niche of {finger.hand_width_mm:g} mm would cut the screws' lugs beside it; set finger.hand_width_mm to "
        f"{2 * (room - joint.wall_mm) - 1:.0f} or less.",
    )
    require(
        dimensions.niche_inner_y_mm <= -dimensions.groove_width_mm / 2 - 2.0,
        f"the opening for the finger would lie {-dimensions.niche_inner_y_mm:.0f} mm from the axis, too near to the "
        f"finger pad; set finger.reach_mm larger.",
    )
    chord = math.sqrt(max(dimensions.bore_mm**2 - half**2, 0.0))
    require(
        -dimensions.niche_y_mm <= chord,
        f"the niche of {finger.hand_width_mm:g} mm does not reach the opening, {-dimensions.niche_y_mm:.0f} mm from "
        f"the axis: the tube of {dimensions.bore_mm:g} mm radius is narrower there; set finger.reach_mm to "
        f"{finger.reach_mm - (-dimensions.niche_y_mm - chord):.0f} or less.",
    )
    least = sizes.DISC_MM + sizes.MIN_WALL_MM + 0.3
    require(
        finger.pad_height_mm - finger.stop_height_mm >= least,
        f"the finger's stop of {finger.stop_height_mm:g} mm leaves no room under the calibration disc; set "
        f"finger.stop_height_mm to {finger.pad_height_mm - least:g} or less.",
    )
