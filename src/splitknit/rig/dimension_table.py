"""The dimensions as they are written to ``parts.json``: numbers a person wants to measure or to type."""

from __future__ import annotations

import math
from typing import Any

from splitknit.model import Rig
from splitknit.rig.dimensions import RigDimensions
from splitknit.rig.led_holes import LedHole
from splitknit.rig.mirror_shape import mirror_view
from splitknit.rig.nail import shadow_tips


def dimension_table(rig: Rig, dimensions: RigDimensions) -> dict[str, Any]:
    """Return the dimensions of the rig and of its parts, mm and degrees."""
    d, joint = dimensions, dimensions.settings.joint
    shadows = shadow_tips(rig, d.nail_mm)
    return {
        "picture_mm": [round(value, 2) for value in d.field_mm],
        "camera_height_mm": d.camera_height_mm,
        "bore_radius_mm": d.bore_mm,
        "outer_radius_mm": d.outer_mm,
        "screw_circle_radius_mm": round(d.screw_mm, 2),
        "total_height_mm": round(d.top_z_mm - d.base_z_mm, 2),
        "cylinder_height_mm": round(d.cylinder_mm, 2),
        "heights_over_finger_plane_mm": {
            "base_bottom": round(d.base_z_mm, 2),
            "groove_bottom": round(d.groove_z_mm, 2),
            "base_to_cylinder": round(d.floor_z_mm, 2),
            "cylinder_to_frame": round(d.frame_z_mm, 2),
            "camera_board_front": round(d.board_z_mm, 2),
            "frame_to_box": round(d.box_z_mm, 2),
            "box_to_lid": round(d.lid_z_mm, 2),
            "top": round(d.top_z_mm, 2),
        },
        "finger": {
            "opening_radius_mm": round(d.opening_radius_mm, 2),
            "groove_width_mm": d.groove_width_mm,
            "groove_length_mm": round(d.stop_y_mm - d.niche_y_mm + 2.0, 2),
            "groove_depth_mm": d.settings.finger.groove_depth_mm,
            "groove_radius_mm": round(d.groove_radius_mm, 2),
            "tip_stops_at_y_mm": round(d.stop_y_mm, 2),
            "hand_stays_outside_y_mm": round(d.niche_y_mm, 2),
        },
        "lens_opening_diameter_mm": round(2 * d.lens_hole_mm, 2),
        "nail": {
            "height_mm": d.nail_mm,
            "may_stand_off_middle_mm": d.settings.calibration.nail_offset_mm,
            "shadow_lengths_mm": [round(float(math.hypot(x, y)), 2) for x, y in shadows],
        },
        "calibration_disc_diameter_mm": 2 * d.disc_radius_mm,
        "mirrors": {
            "size_mm": [d.settings.mirror.long_mm, d.settings.mirror.wide_mm, d.settings.mirror.thick_mm],
            **{name: {k: round(v, 2) for k, v in view.items()} for name, view in mirror_view(d).items()},
        },
        "leds": [_led(hole) for hole in d.holes],
        "hardware": {
            "screws_m3x8": 16,
            "heat_set_inserts_m3x4": 16,
            "screws_m2x8": 4,
            "screws_m25x8": 4,
            "screws_m3x10_self_tapping": 4,
            "leds_white": sum(hole.band == "white" for hole in d.holes),
            "leds_nir": sum(hole.band != "white" for hole in d.holes),
            "insert_hole_mm": joint.insert_hole_mm,
        },
    }


def _led(hole: LedHole) -> dict[str, Any]:
    x, y, z = (float(value) for value in hole.light_mm)
    return {
        "led": hole.index,
        "band": hole.band,
        "position_mm": [round(x, 3), round(y, 3), round(z, 3)],
        "azimuth_deg": round(math.degrees(math.atan2(y, x)) % 360.0, 2),
        "tilt_deg": round(hole.tilt_deg, 2),
        "hole_diameter_mm": round(2 * hole.radius_mm, 2),
        "shoulder_behind_light_mm": hole.shoulder_mm,
    }
