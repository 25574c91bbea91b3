"""Rigs that cannot be built are refused, each in one sentence with the remedy."""

from __future__ import annotations

import itertools
import math

import numpy as np

from hardware import sizes
from hardware.films import film_mounts
from hardware.geometry import LedHole, RigDimensions, side_lamp
from splitknit.errors import require

_SAMPLES = 400
_MIN_SEAT_MM = 0.6  # an LED's flange rests on three layers at least


def check_dimensions(d: RigDimensions) -> None:
    """Refuse what cannot be printed, put together, or lit and seen through, naming the LED or
    dimension at fault."""
    _check_bed(d)
    _check_height(d)
    _check_finger(d)
    for first, second in itertools.combinations(d.holes, 2):
        _check_pair(first, second)
    for hole in d.holes:
        _check_hole(hole, d)
        _check_camera(hole, d)
        _check_beam(hole, d)
    if d.sides:
        _check_sides(d)
    if d.films is not None:
        film_mounts(d)  # refuses LEDs that leave no room


def _check_bed(d: RigDimensions) -> None:
    printer = d.settings.printer
    circle = max(float(np.hypot(*hole.light_mm[:2])) for hole in d.holes)
    bed = min(printer.bed_x_mm, printer.bed_y_mm)
    size = 2 * d.outside_mm
    require(
        size <= bed,
        f"the LEDs stand up to {circle:.1f} mm from the camera's axis and the picture is "
        f"{d.field_mm[0]:.0f} x {d.field_mm[1]:.0f} mm, so that the parts are {size:.0f} mm wide, "
        f"more than the printer's bed of {bed:g} mm (printer.bed_x_mm, printer.bed_y_mm).",
    )
    high, most = d.cylinder_mm + sizes.JOINT_RIDGE_HIGH_MM, printer.bed_z_mm
    words = (
        f"the cylinder is {high:.0f} mm high, more than the printer's {most:g} mm"
        " (printer.bed_z_mm)."
    )
    require(high <= most, words)


def _check_height(d: RigDimensions) -> None:
    least = d.frame_z_mm + sizes.JOINT_PLATE_MM + 1.0
    above = math.ceil(10 * (least - d.camera_height_mm)) / 10
    require(
        d.board_z_mm >= least,
        f"the camera's board would lie at {d.board_z_mm:.1f} mm, inside the LED frame, which ends"
        f" at {least - 1.0:.1f} mm; set camera.board_above_lens_mm to {above:g} or more, or lower"
        " the LEDs against the camera.",
    )
    beside = min(
        sizes.CAMERA_LENS_TO_HOLES_MM, sizes.CAMERA_HOLE_Y_MM - sizes.CAMERA_LENS_TO_HOLES_MM
    )
    nearest = math.hypot(sizes.CAMERA_HOLE_X_MM / 2, beside)
    room = nearest - sizes.CAMERA_POST_HOLE_MM / 2 - sizes.MIN_WALL_MM
    behind = d.camera_height_mm > d.frame_z_mm
    require(
        d.lens_hole_mm <= room,
        f"the lens's opening of {2 * d.lens_hole_mm:.1f} mm leaves no wall beside the screws of the"
        f" camera's board, {2 * room:.1f} mm is the maximum; set camera.barrel_mm smaller"
        + (" or bring the camera nearer to the LEDs' height." if behind else "."),
    )
    finger, wall = d.settings.finger, d.settings.joint.wall_mm
    roof = (
        d.floor_z_mm
        + finger.hand_height_mm
        + finger.hand_width_mm / 2
        + wall * math.sqrt(2.0)
        + wall
    )
    require(
        roof <= d.frame_z_mm - 20.0,
        f"the LEDs' frame at {d.frame_z_mm:.0f} mm is too low over the hand's niche, which ends at "
        f"{roof:.0f} mm; set finger.hand_width_mm or finger.hand_height_mm smaller.",
    )


def _check_pair(first: LedHole, second: LedHole) -> None:
    leds = f"LEDs {first.index} and {second.index}"
    needed = first.pocket_radius_mm + second.pocket_radius_mm + sizes.MIN_WALL_MM
    for first_mm, second_mm in (
        (first.shoulder_mm, second.shoulder_mm),
        (first.back_mm, second.back_mm),
    ):
        gap = float(np.linalg.norm(first.at(first_mm) - second.at(second_mm)))
        require(
            gap >= needed,
            f"{leds} are {gap:.1f} mm apart at their flanges, but need {needed:.1f} mm with a wall"
            " between them; use fewer or smaller LEDs or a larger circle.",
        )
    gap = float(np.linalg.norm(first.light_mm - second.light_mm))
    needed = first.radius_mm + second.radius_mm + sizes.MIN_WALL_MM
    require(gap >= needed, f"{leds} are {gap:.1f} mm apart, but their holes need {needed:.1f} mm.")


def _check_hole(hole: LedHole, d: RigDimensions) -> None:
    require(
        hole.tilt_deg <= 45.0,
        f"LED {hole.index} is tilted by {hole.tilt_deg:.0f} deg, but its hole can be printed up to"
        " 45 deg; raise the LEDs, bring them nearer to the axis, or give them another aim. (From"
        " 60 deg on they get lamps of their own.)",
    )
    land = hole.shoulder_mm - max(hole.level_mm(d.frame_z_mm) + hole.lean_mm, sizes.LED_TIP_FREE_MM)
    require(
        land >= _MIN_SEAT_MM,
        f"LED {hole.index} at {hole.light_mm[2]:.1f} mm would rest on {max(land, 0):.1f} mm of"
        f" plastic instead of {_MIN_SEAT_MM:g} mm, as the frame's lower face is at"
        f" {d.frame_z_mm:.1f} mm; take LEDs with a longer body (led.white_flange_to_light_mm,"
        " led.nir_flange_to_light_mm) or smaller ones.",
    )


def _check_camera(hole: LedHole, d: RigDimensions) -> None:
    """Keep LEDs clear of the camera's board and of the lens's opening, which passes the whole
    view."""
    away = min(float(np.hypot(*hole.at(s)[:2])) for s in (0.0, hole.back_mm))
    connector = sizes.CAMERA_LENS_TO_CONNECTOR_MM
    end = max(connector, d.settings.camera.board_y_mm - connector, sizes.CAMERA_HOLE_Y_MM + 4.0)
    board = math.hypot(sizes.CAMERA_BOARD_X_MM / 2, end)
    needed = max(d.lens_hole_mm, board) + hole.pocket_radius_mm + d.settings.joint.wall_mm
    require(
        away >= needed,
        f"LED {hole.index} is {away:.1f} mm from the camera's axis, where the camera sits; it needs"
        f" {needed:.1f} mm.",
    )


def _check_beam(hole: LedHole, d: RigDimensions) -> None:
    """Nothing may stand between the LED and the last phalanx, as far as the picture shows it."""
    fraction = np.linspace(0.0, 0.999, _SAMPLES)[:, None, None]
    way = hole.light_mm + fraction * (d.lit_corners - hole.light_mm)  # (samples, corners, 3)
    finger, wall = d.settings.finger, d.settings.joint.wall_mm
    x = np.abs(way[..., 0])
    y = way[..., 1]
    z = way[..., 2] - d.floor_z_mm
    roof = finger.hand_height_mm + finger.hand_width_mm / 2 + wall * math.sqrt(2.0) - x
    in_niche = np.asarray(
        (y < d.niche_inner_y_mm) & (x < finger.hand_width_mm / 2 + wall) & (z < roof)
    )
    require(
        not bool(in_niche.any()),
        f"the light of LED {hole.index} would be cut by the roof of the hand's niche; set"
        " finger.reach_mm larger, or finger.hand_width_mm or finger.hand_height_mm smaller.",
    )
    camera = d.settings.camera
    lens = np.hypot(way[..., 0], way[..., 1]) < camera.barrel_mm / 2
    lens &= way[..., 2] > d.camera_height_mm - camera.barrel_front_mm
    words = (
        f"the light of LED {hole.index} would be cut by the lens; move the LED outwards or down."
    )
    require(not bool(lens.any()), words)


def _check_sides(d: RigDimensions) -> None:
    """Keep the lamps of side lights clear of each other, the hand's niche and screws, and their
    light whole."""
    lamp = side_lamp(d)
    half = d.settings.finger.hand_width_mm / 2 + d.settings.joint.wall_mm
    ends = [hole.at(-lamp.wall_mm) for hole in d.sides]
    for hole, end in zip(d.sides, ends, strict=True):
        _check_beam(hole, d)
        require(
            end[1] > 0 or abs(end[0]) - lamp.collar_mm > half,
            f"the lamp of LED {hole.index} would stand in the hand's niche; move the light around"
            " the axis.",
        )
        require(
            end[2] - lamp.collar_mm > d.floor_z_mm + sizes.JOINT_LUG_MM
            and hole.at(hole.back_mm)[2] < d.frame_z_mm,
            f"the lamp of LED {hole.index} at {hole.light_mm[2]:.0f} mm does not fit into the"
            " cylinder's wall; place side lights higher over the finger plane or farther out.",
        )
        screws = d.screw_mm * np.exp(1j * np.deg2rad(d.base_screws_deg))
        free = float(np.abs(screws - complex(end[0], end[1])).min()) > lamp.collar_mm
        require(
            free,
            f"the lamp of LED {hole.index} hides a screw of the base; move the light around the"
            " axis.",
        )
    lights = zip(d.sides, ends, strict=True)
    for (first, first_end), (second, second_end) in itertools.combinations(lights, 2):
        gap = float(np.linalg.norm(first_end - second_end))
        needed = 2 * lamp.collar_mm + sizes.MIN_WALL_MM
        words = (
            f"the lamps of LEDs {first.index} and {second.index} are {gap:.1f} mm apart, but need"
            f" {needed:.1f} mm."
        )
        require(gap >= needed, words)


def _check_finger(d: RigDimensions) -> None:
    finger, joint = d.settings.finger, d.settings.joint
    half = finger.hand_width_mm / 2 + joint.wall_mm
    require(
        half >= d.opening_radius_mm + joint.wall_mm,
        f"the niche of {finger.hand_width_mm:g} mm is narrower than the opening of"
        f" {2 * d.opening_radius_mm:.0f} mm for the finger; set finger.hand_width_mm to"
        f" {2 * d.opening_radius_mm:.0f} or more.",
    )
    room = d.screw_mm * math.sin(math.radians(90.0 - 35.0)) - sizes.JOINT_LUG_RADIUS_MM
    require(
        half < room,
        f"the niche of {finger.hand_width_mm:g} mm would cut the screws' lugs beside it; set"
        f" finger.hand_width_mm to {2 * (room - joint.wall_mm) - 1:.0f} or less.",
    )
    require(
        d.niche_inner_y_mm <= -d.groove_width_mm / 2 - 2.0,
        f"the opening for the finger would lie {-d.niche_inner_y_mm:.0f} mm from the axis, too near"
        " to the finger pad; set finger.reach_mm larger.",
    )
    chord = math.sqrt(max(d.bore_mm**2 - half**2, 0.0))
    require(
        -d.niche_y_mm <= chord,
        f"the niche of {finger.hand_width_mm:g} mm does not reach the opening, {-d.niche_y_mm:.0f}"
        f" mm from the axis: the tube of {d.bore_mm:g} mm radius is narrower there; set"
        f" finger.reach_mm to {finger.reach_mm - (-d.niche_y_mm - chord):.0f} or less.",
    )
    least = sizes.DISC_MM + sizes.MIN_WALL_MM + 0.3
    require(
        finger.pad_height_mm - finger.stop_height_mm >= least,
        f"the finger's stop of {finger.stop_height_mm:g} mm leaves no room under the calibration"
        f" disc; set finger.stop_height_mm to {finger.pad_height_mm - least:g} or less.",
    )
