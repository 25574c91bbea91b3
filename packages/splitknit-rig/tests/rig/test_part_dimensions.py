"""Dimensions follow from the rig file; rigs that cannot be built are refused in one sentence."""

from __future__ import annotations

import ast
import math
from dataclasses import replace
from importlib import resources

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.model import Camera, Led, Rig, default_rig
from splitknit.settings import override
from splitknit_rig.rig.assembly import FILM_KINDS, KINDS, SIDE_KIND
from splitknit_rig.rig.dimension_checks import check_dimensions
from splitknit_rig.rig.dimensions import (
    _mirror_front,
    _nail_height,
    dimensions_of,
    mirror_profile,
    mirror_reach,
    shadow_tips,
)
from splitknit_rig.rig.part_reports import dimension_table
from splitknit_rig.rig.part_settings import (
    JOINT_CLEARANCE_MM,
    JOINT_PLATE_MM,
    MIRROR_THICK_MM,
    WIRE_ROOM_MM,
    PartSettings,
)
from splitknit_simulator.rigs import built_rig


def ring(count=6, radius=40.0, height=120.0, camera=None, **changes):
    camera = Camera(px_per_mm=75.7, image_size=(2200, 3200), height_mm=camera or height)
    azimuths = 2 * np.pi * np.arange(count) / count
    leds = tuple(
        Led(band="nir" if k % 2 else "white", position_mm=(radius * math.cos(a), radius * math.sin(a), height))
        for k, a in enumerate(azimuths)
    )
    return Rig(replace(camera, **changes), leds)


def settings(**changes):
    return override(PartSettings(), {name.replace("__", "."): value for name, value in changes.items()})


def refused(words, rig, **changes):
    with pytest.raises(BadInput) as caught:
        check_dimensions(dimensions_of(rig, settings(**changes)))
    message = str(caught.value)
    assert words in message
    assert "\n" not in message
    return message


def test_holes_are_tilted_by_the_geometry():
    dimensions = dimensions_of(default_rig())
    check_dimensions(dimensions)
    assert len(dimensions.holes) == 14
    for hole in dimensions.holes:
        assert hole.tilt_deg == pytest.approx(math.degrees(math.atan(52.5 / 140)))
    low = dimensions_of(ring(radius=40, height=120))
    assert low.holes[0].tilt_deg == pytest.approx(math.degrees(math.atan(40 / 120)))


def test_a_hole_follows_the_leds_own_aim():
    rig = ring()
    aimed = replace(rig.leds[0], aim=(-0.2, 0.0, -1.0))
    dimensions = dimensions_of(replace(rig, leds=(aimed, *rig.leds[1:])))
    assert dimensions.holes[0].tilt_deg == pytest.approx(math.degrees(math.atan(0.2)))
    assert np.allclose(dimensions.holes[0].back, np.array([0.2, 0.0, 1.0]) / math.hypot(0.2, 1.0))
    assert dimensions.holes[1].tilt_deg == pytest.approx(math.degrees(math.atan(40 / 120)))


def test_the_stack_puts_lights_and_camera_at_their_heights():
    dimensions = dimensions_of(default_rig())
    lowest = 140 + dimensions.holes[0].radius_mm * math.sin(math.radians(dimensions.holes[0].tilt_deg))
    assert lowest < dimensions.frame_z_mm < lowest + 1  # the domes stand free below the frame
    assert dimensions.board_z_mm == 140 + dimensions.settings.camera.board_above_lens_mm
    assert dimensions.groove_z_mm == -dimensions.settings.finger.pad_height_mm
    assert dimensions.cylinder_mm == dimensions.frame_z_mm - dimensions.floor_z_mm
    assert dimensions.box_z_mm >= dimensions.board_z_mm + WIRE_ROOM_MM
    assert dimensions.lid_z_mm - dimensions.box_z_mm - JOINT_PLATE_MM > 40
    other = dimensions_of(ring(radius=40, height=120))
    assert dimensions.cylinder_mm - other.cylinder_mm == pytest.approx(20, abs=0.2)


def test_leds_may_stand_at_different_heights():
    rig = ring()
    high = replace(rig.leds[0], position_mm=(40.0, 0.0, 124.0))
    dimensions = dimensions_of(replace(rig, leds=(high, *rig.leds[1:])))
    check_dimensions(dimensions)
    assert dimensions.frame_z_mm == dimensions_of(rig).frame_z_mm
    for seed in range(3):
        check_dimensions(dimensions_of(built_rig(seed)))


def test_the_bore_holds_leds_boards_and_picture():
    wide = dimensions_of(default_rig())
    assert wide.bore_mm > 52.5 + 5
    assert wide.bore_mm >= max(hole.radius_taken_mm for hole in wide.holes)
    narrow = dimensions_of(ring(radius=40))
    board = narrow.settings.board
    assert narrow.bore_mm >= math.hypot(board.pcb_x_mm, board.pcb_y_mm) / 2
    assert narrow.bore_mm < wide.bore_mm
    small = dimensions_of(ring(radius=40), settings(board__pcb_x_mm=60.0, board__pcb_y_mm=50.0))
    assert small.bore_mm >= math.hypot(85 / 2 + 3, 28)


def test_bands_may_have_leds_of_other_sizes():
    changes = {"led__nir_diameter_mm": 3.0, "led__nir_flange_mm": 3.8, "led__nir_flange_to_light_mm": 3.2}
    dimensions = dimensions_of(default_rig(), settings(**changes))
    assert {(hole.band, round(2 * hole.radius_mm, 1)) for hole in dimensions.holes} == {("white", 5.2), ("nir", 3.2)}


def test_the_finger_stops_in_the_picture_and_fits_the_opening():
    dimensions = dimensions_of(default_rig())
    rows_mm = 2200 / 75.7
    assert dimensions.stop_y_mm == pytest.approx(rows_mm / 2 - 3)
    assert dimensions.stop_y_mm - dimensions.niche_y_mm == pytest.approx(45)
    angle = np.linspace(0, np.pi, 50)
    thumb = np.hypot(13 * np.cos(angle), 12 + 12 * np.sin(angle))  # 26 x 24 mm, lying on the floor
    assert np.all(thumb + 2 <= dimensions.opening_radius_mm + 1e-9)
    assert dimensions.groove_width_mm == 28


def test_shadows_of_the_nail_stay_in_the_picture():
    rig = default_rig()
    height = dimensions_of(rig).nail_mm
    assert height == 14.0
    half = np.array([3200, 2200]) / 75.7 / 2
    for x in (-6, 0, 6):
        for y in (-6, 0, 6):
            assert np.all(np.abs(shadow_tips(rig, height, (x, y))) <= half - 2 + 1e-9)
    higher = np.array([np.abs(shadow_tips(rig, height + 0.5, (x, y))) for x in (-6, 6) for y in (-6, 6)])
    assert np.any(higher > half - 2)
    assert _nail_height(rig, 0.0, 2.0, 2.5) > height


def test_a_shadow_lies_on_the_line_from_the_led_through_the_tip():
    rig = ring()
    tips = shadow_tips(rig, 12.0, (3.0, -2.0))
    for led, tip in zip(rig.leds, tips, strict=True):
        ray = np.array([3.0, -2.0, 12.0]) - np.array(led.position_mm)
        down = np.array(led.position_mm) - ray * led.position_mm[2] / ray[2]
        assert np.allclose(down, [*tip, 0.0])


def test_a_mirror_leans_by_45_deg_and_fits_its_holder():
    parts = PartSettings()
    front = np.array(_mirror_front())
    profile = np.array(mirror_profile(parts))
    along, behind = np.array([1, 1]) / math.sqrt(2), np.array([1, -1]) / math.sqrt(2)
    fractions = (profile - front) @ np.stack([along, behind], axis=1)
    ramp = fractions[np.isclose(fractions[:, 1], MIRROR_THICK_MM + JOINT_CLEARANCE_MM)]
    assert len(ramp) == 2
    assert np.ptp(ramp[:, 0]) == pytest.approx(parts.mirror.wide_mm)
    signed = 0.5 * np.sum(profile[:, 0] * np.roll(profile[:, 1], -1) - profile[:, 1] * np.roll(profile[:, 0], -1))
    assert signed > 50


def test_mirrors_show_the_finger_and_need_a_wider_picture():
    near = mirror_reach(dimensions_of(default_rig()))
    assert near["side"]["lowest_mm"] < -10
    assert near["side"]["highest_mm"] > 0
    assert near["side"]["share_in_picture"] < 0.3  # 757 px/cm is too near for mirrors
    wide = replace(default_rig(), camera=replace(default_rig().camera, px_per_mm=45.0))
    far = mirror_reach(dimensions_of(wide, settings(finger__tip_margin_mm=22.0)))
    assert far["side"]["share_in_picture"] == 1
    assert far["tip"]["share_in_picture"] == 1


def test_impossible_rigs_are_refused():
    assert "LEDs stand up to 100.0 mm" in refused("more than the printer's bed of 220 mm", ring(radius=100))
    refused("the cylinder is", ring(height=260))
    refused("LEDs 0 and 1 are", ring(count=40))
    refused("LED 0 is 15.0 mm from the camera's axis, where the camera sits", ring(radius=15))
    refused("LED 0 is 40.0 mm from the camera's axis, where the camera sits", ring(), camera__board_y_mm=60.0)
    refused("too low over the hand's niche", ring(height=50, radius=30))
    refused("lower the LEDs against the camera", ring(camera=110))
    refused("opening", ring(radius=30, height=80, camera=130))
    refused("has no position_mm", replace(default_rig(), leds=(Led("white", direction=(0.0, 0.0, 1.0)),)))
    refused("tilted by", ring(radius=90, height=80, count=4), printer__bed_x_mm=300.0, printer__bed_y_mm=300.0)
    rig = ring()
    refused("too small for the shadows", replace(default_rig(), camera=replace(rig.camera, image_size=(800, 3200))))


def test_leds_whose_light_is_cut_are_refused():
    refused("cut by the lens", ring(radius=30, height=140), camera__barrel_front_mm=130.0)
    refused("cut by the roof", ring(radius=50, height=100), finger__hand_height_mm=26.0, finger__reach_mm=31.0)


def test_impossible_settings_are_refused():
    rig = default_rig()
    refused("the niche of 40 mm is narrower than the opening", rig, finger__hand_width_mm=40.0)
    refused("would cut the screws' lugs", rig, finger__hand_width_mm=118.0, finger__hand_height_mm=2.0)
    refused("does not reach the opening", rig, finger__reach_mm=75.0)
    refused("too near to the finger pad", rig, finger__reach_mm=20.0)
    refused("leaves no wall beside the screws", rig, camera__barrel_mm=18.0)
    refused("LED 0 at 140.0 mm would rest on 0.0 mm of plastic", rig, led__white_flange_to_light_mm=1.5)
    refused("no room under the calibration disc", rig, finger__stop_height_mm=12.0)
    for name, value, words in (
        ("joint__wall_mm", 1.0, "thinner than the minimum"),
        ("finger__stop_height_mm", 15.0, "below the finger plane"),
        ("finger__groove_depth_mm", 9.5, "the stop is only 9 mm high"),
        ("led__white_diameter_mm", float("nan"), "led.white_diameter_mm must be from 0.05 to 1000, but it is nan"),
    ):
        with pytest.raises(BadInput, match=words):
            settings(**{name: value})


def test_the_table_names_every_led():
    rig = default_rig()
    table = dimension_table(rig, dimensions_of(rig))
    assert [led["led"] for led in table["leds"]] == list(range(14))
    assert table["leds"][1]["azimuth_deg"] == pytest.approx(360 / 7, abs=0.01)
    assert {led["tilt_deg"] for led in table["leds"]} == {20.56}
    assert table["hardware"]["leds_white"] == table["hardware"]["leds_nir"] == 7
    heights = list(table["heights_over_finger_plane_mm"].values())
    assert heights == sorted(heights)


def test_every_part_has_its_maker():
    """Read from the source: the module itself needs build123d."""
    tree = ast.parse((resources.files("splitknit_rig.rig") / "parts.py").read_text(encoding="utf-8"))
    tables = {node.target.id: node.value for node in tree.body if isinstance(node, ast.AnnAssign)}
    makers = [key.value for key in tables["MAKERS"].keys]
    assert sorted(makers) == sorted(kind.name for kind in (*KINDS, *FILM_KINDS, SIDE_KIND))
