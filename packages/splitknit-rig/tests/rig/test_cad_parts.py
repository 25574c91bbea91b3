"""The parts as solids and as triangles, for the thesis's rig and for another one. Needs build123d."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from splitknit.errors import BadInput
from splitknit.model import Camera, Led, Rig, default_rig
from splitknit.settings import override
from splitknit_rig.rig import assembly
from splitknit_rig.rig.assembly import STACK, STACK_BELOW, build_parts
from splitknit_rig.rig.dimensions import (
    POCKET_MM,
    SCREWS_A_DEG,
    SCREWS_B_DEG,
    _mirror_front,
    dimensions_of,
    holder_places,
)
from splitknit_rig.rig.films import film_mounts, with_films
from splitknit_rig.rig.part_reports import _check_soundness, _first_hits, report_part
from splitknit_rig.rig.part_settings import (
    CAMERA_LENS_TO_CONNECTOR_MM,
    JOINT_PLATE_MM,
    MIRROR_LONG_MM,
    MIRROR_THICK_MM,
    PCB_OVER_PI_MM,
    PCB_PARTS_MM,
    PI_POST_HEIGHT_MM,
    PartSettings,
)

build123d = pytest.importorskip("build123d", reason="build123d (extra 'rig') is not installed")

pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("default::DeprecationWarning"),  # of build123d and what it imports
]
SMALL_LEDS = {"led.nir_diameter_mm": 3.0, "led.nir_flange_mm": 3.8, "led.nir_flange_to_light_mm": 3.2}


def other_rig():
    azimuths = 2 * np.pi * np.arange(6) / 6
    heights = (123.0, 120.0, 120.0, 121.5, 120.0, 130.0)
    leds = tuple(
        Led(band="nir" if k % 2 else "white", position_mm=(40 * math.cos(a), 40 * math.sin(a), heights[k]))
        for k, a in enumerate(azimuths)
    )
    return Rig(Camera(px_per_mm=75.7, image_size=(2200, 3200), height_mm=120.0), leds)


@pytest.fixture(scope="module", params=["thesis", "other"])
def rig(request):
    """Dimensions and parts by name."""
    if request.param == "thesis":
        dimensions = dimensions_of(default_rig())
    else:
        dimensions = dimensions_of(other_rig(), override(PartSettings(), SMALL_LEDS))
    return dimensions, {part.kind.name: part for part in build_parts(dimensions)}


def shared_volume(first, second):
    found = first.intersect(second)
    return 0.0 if found is None else sum(solid.volume for solid in found.solids())


def test_each_part_is_one_valid_solid_and_prints(rig):
    dimensions, parts = rig
    assert list(parts) == [kind.name for kind in assembly.KINDS]
    for name, part in parts.items():
        assert part.solid.is_valid, name
        assert len(part.solid.solids()) == 1
        triangles = assembly.as_printed(part, assembly.triangles_of(part))
        _, faults, volume_mm3 = _check_soundness(triangles)
        assert faults == 0, name
        assert volume_mm3 == pytest.approx(part.solid.volume, rel=1e-2)
        assert triangles[..., 2].min() == 0
        report = report_part(part.kind, triangles, dimensions.settings.printer)
        verdicts = {check: verdict["ok"] for check, verdict in report["checks"].items()}
        assert verdicts == {"watertight": True, "wall": name != "nail", "bed": True, "overhang": True}, name
    assert "on purpose" in parts["nail"].kind.remedy


def test_holes_of_the_step_file_look_at_the_finger(rig, tmp_path):
    dimensions, parts = rig
    assembly.write_step(tmp_path / "frame.step", parts["frame"])
    frame = build123d.import_step(tmp_path / "frame.step")
    cylinders = [face for face in frame.faces() if face.geom_type == build123d.GeomType.CYLINDER]
    found = set()
    for hole in dimensions.holes:
        for face in cylinders:
            axis = face.axis_of_rotation
            direction = np.array([axis.direction.X, axis.direction.Y, axis.direction.Z])
            point = np.array([axis.position.X, axis.position.Y, axis.position.Z])
            past_origin = np.linalg.norm(np.cross(point, direction))
            past_light = np.linalg.norm(np.cross(point - hole.light_mm, direction))
            if past_light < 0.01 and abs(abs(direction @ hole.back) - 1) < 1e-6:
                assert past_origin < 0.1
                found.add((hole.index, round(face.radius, 3)))
    for hole in dimensions.holes:
        assert (hole.index, round(hole.radius_mm, 3)) in found
        assert (hole.index, round(hole.pocket_radius_mm, 3)) in found


def test_an_led_fits_its_hole_and_shines_freely(rig):
    """A model of the LED, pushed in up to its flange, touches nothing; pushed 0.3 mm further it does."""
    dimensions, parts = rig
    frame = parts["frame"].solid
    for hole in (*dimensions.holes[:2], dimensions.holes[3], dimensions.holes[5]):
        small = hole.radius_mm < 2
        body, flange = (1.5, 1.9) if small else (2.5, 2.95)

        def led(further, hole=hole, body=body, flange=flange):
            front = hole.shoulder_mm - further
            plane = build123d.Plane(origin=tuple(hole.at(front)), z_dir=tuple(-hole.back))
            parts = build123d.Solid.make_cylinder(body, hole.shoulder_mm, plane)
            plane = build123d.Plane(origin=tuple(hole.at(front)), z_dir=tuple(hole.back))
            return parts.fuse(build123d.Solid.make_cylinder(flange, 1.0, plane))

        assert shared_volume(led(0.0), frame) < 1e-6
        assert shared_volume(led(0.3), frame) > 0.5
        beam = build123d.Solid.make_cone(
            hole.radius_mm * 0.9,
            20.0,
            float(np.linalg.norm(hole.light_mm)),
            build123d.Plane(origin=tuple(hole.light_mm), z_dir=tuple(-hole.back)),
        )
        for name in STACK[1:]:
            assert shared_volume(beam, parts[name].solid) < 1e-6, name


@pytest.mark.parametrize("stack", [STACK, STACK_BELOW])
def test_stacked_parts_do_not_cut_each_other_and_do_hold(rig, stack):
    _, parts = rig
    for first, second in itertools.combinations(stack, 2):
        assert shared_volume(parts[first].solid, parts[second].solid) < 1e-6, (first, second)
    for lower, upper in itertools.pairwise(stack):
        aside = build123d.Pos(0.5, 0, 0) * parts[upper].solid
        assert shared_volume(parts[lower].solid, aside) > 0.1, (lower, upper)  # the ridge stops it
        pressed = build123d.Pos(0, 0, -0.1) * parts[upper].solid
        assert shared_volume(parts[lower].solid, pressed) > 10, (lower, upper)  # faces meet


def test_screws_go_through_one_part_into_the_next(rig):
    dimensions, parts = rig
    joints = ((STACK, 0), (STACK, 1), (STACK, 2), (STACK, 3), (STACK_BELOW, 0))
    heights = (dimensions.floor_z_mm, dimensions.frame_z_mm, dimensions.box_z_mm, dimensions.lid_z_mm)
    for stack, joint in joints:
        z = heights[joint]
        for azimuth in SCREWS_B_DEG if joint % 2 else SCREWS_A_DEG:
            place = build123d.Rot(0, 0, azimuth) * build123d.Pos(dimensions.screw_mm, 0, 0)
            screw = place * build123d.Pos(0, 0, z - 4) * build123d.Solid.make_cylinder(1.5, 8.4)
            head = place * build123d.Pos(0, 0, z + 4.41) * build123d.Solid.make_cylinder(2.75, 3.0)
            for name in stack:
                assert shared_volume(parts[name].solid, screw) < 1e-6, (name, azimuth)
                assert shared_volume(parts[name].solid, head) < 1e-6, (name, azimuth)
            wide = place * build123d.Pos(0, 0, z - 3) * build123d.Solid.make_cylinder(2.5, 6.0)
            assert shared_volume(parts[stack[joint]].solid, wide) > 10
            assert shared_volume(parts[stack[joint + 1]].solid, wide) > 10


def test_only_one_turn_fits():
    for azimuths in (SCREWS_A_DEG, SCREWS_B_DEG):
        for turn in range(1, 360):
            turned = {round((azimuth + turn) % 360) for azimuth in azimuths}
            assert turned != {round(azimuth) for azimuth in azimuths}


def test_boards_and_cable_fit(rig):
    dimensions, parts = rig
    floor = dimensions.box_z_mm + JOINT_PLATE_MM
    low = floor + PI_POST_HEIGHT_MM
    pi = build123d.Pos(-42.5 - 3, -28, low) * build123d.Solid.make_box(3 + 85, 56, 1.5 + 16)
    plug = build123d.Rot(0, 0, 70) * build123d.Pos(40, 0, dimensions.lid_z_mm - 20.3)
    plug = plug * build123d.Rot(0, 90, 0) * build123d.Solid.make_cylinder(6.3, 60)  # 12.4 mm wide, through the wall
    over = low + 1.5 + PCB_OVER_PI_MM
    pcb = build123d.Pos(-45, -35, over) * build123d.Solid.make_box(90, 70, 1.6 + PCB_PARTS_MM - 0.1)
    y = -CAMERA_LENS_TO_CONNECTOR_MM
    eye = build123d.Pos(-12.5, y, dimensions.board_z_mm) * build123d.Solid.make_box(25, 24, 8)
    lens = build123d.Pos(0, 0, dimensions.frame_z_mm - 12) * build123d.Solid.make_cylinder(7.0, 30)
    for thing in (pi, pcb, eye, lens, plug):
        for name in STACK:
            assert shared_volume(thing, parts[name].solid) < 1e-6, name
    post = build123d.Pos(*(21 / 2, 12.5), dimensions.board_z_mm - 1) * build123d.Solid.make_cylinder(2.4, 0.9)
    assert shared_volume(post, parts["frame"].solid) > 10


def test_what_calibrates_stands_on_the_finger_plane(rig):
    dimensions, parts = rig
    bounds = parts["nail"].solid.bounding_box()
    ends = [bounds.min.Z, bounds.max.Z]
    assert ends == pytest.approx([0.0, dimensions.nail_mm])
    for name in ("calibration_disc", "calibration_disc_flat"):
        disc = parts[name].solid
        highest = disc.bounding_box().max.Z
        assert highest == pytest.approx(0.0)
        for other in ("base", "cylinder", "nail"):
            assert shared_volume(disc, parts[other].solid) < 1e-6
        aside = build123d.Pos(0.5, 0, 0) * disc
        assert shared_volume(aside, parts["base"].solid) > 0.1  # the pocket holds it
    centres = set()
    for face in parts["calibration_disc"].solid.faces():
        if face.geom_type == build123d.GeomType.CYLINDER and abs(face.radius - 0.75) < 1e-6:
            axis = face.axis_of_rotation
            centres.add((round(axis.position.X, 3) + 0.0, round(axis.position.Y, 3) + 0.0))
    assert (0.0, 0.0) in centres
    assert (10.0, -20.0) in centres
    assert len(centres) == 21
    assert shared_volume(parts["calibration_dots"].solid, parts["calibration_disc_flat"].solid) < 1e-6


def test_mirrors_stand_beside_the_finger_at_45_deg(rig):
    dimensions, parts = rig
    holder = parts["mirror_holder"].solid
    x, y, _ = holder_places(dimensions)[0]
    local = build123d.Pos(-x, -y, 0) * holder
    placed = [
        build123d.Pos(px, py, 0) * build123d.Rot(0, 0, turn) * local for px, py, turn in holder_places(dimensions)
    ]
    for shape in placed:
        assert shared_volume(shape, parts["base"].solid) < 1e-6
        assert shared_volume(shape, parts["cylinder"].solid) < 1e-6
        aside = build123d.Pos(0.5, 0.5, 0) * shape
        assert shared_volume(aside, parts["base"].solid) > 0.1  # the pocket holds it
    for first, second in itertools.combinations(placed, 2):
        assert shared_volume(first, second) < 1e-6
    mirror = dimensions.settings.mirror
    u, v = _mirror_front()
    foot = dimensions.floor_z_mm - POCKET_MM
    glass = build123d.Solid.make_box(mirror.wide_mm, MIRROR_LONG_MM, MIRROR_THICK_MM)
    glass = (
        build123d.Pos(x + u, y - MIRROR_LONG_MM / 2, foot + v)
        * build123d.Rot(0, -45, 0)
        * (build123d.Pos(0, 0, -MIRROR_THICK_MM) * glass)
    )
    assert shared_volume(glass, holder) < 1e-6
    pressed = build123d.Pos(0.5, 0, -0.5) * glass
    assert shared_volume(pressed, holder) > 50  # it lies on the ramp along its whole length


def test_a_finger_goes_in_from_either_side(rig):
    """A finger of 16 mm on its back in the groove; and pad down over the window, its pad at the finger plane."""
    dimensions, parts = rig
    start, end = dimensions.niche_y_mm - 30, dimensions.stop_y_mm - 7
    radius = dimensions.settings.finger.pad_height_mm / 2
    axis = build123d.Plane(origin=(0, start, -radius), z_dir=(0, 1, 0))
    finger = build123d.Solid.make_cylinder(radius, end - start, axis)
    tip = build123d.Pos(0, end, -radius) * build123d.Solid.make_sphere(radius, angle1=-90, angle2=90)
    finger = finger.fuse(tip)
    for name in ("base", "cylinder"):
        assert shared_volume(finger, parts[name].solid) < 0.5
    assert shared_volume(finger, parts["window_base"].solid) < 12  # touches: groove and ledge
    lifted = build123d.Pos(0, 0, 0.5) * finger
    assert shared_volume(lifted, parts["window_base"].solid) > 5  # it rests there
    lowered = build123d.Pos(0, 0, -0.5) * finger
    assert shared_volume(lowered, parts["base"].solid) > 5
    picture = build123d.Pos(-8, -14, 0.05) * build123d.Solid.make_box(16, 14 + dimensions.stop_y_mm - 4, 100)
    for name in ("base", "window_base", "cylinder"):
        assert shared_volume(picture, parts[name].solid) < 1e-6  # nothing in front of the pad


def test_every_led_lights_the_whole_pad(rig):
    """Straight lines from all LEDs to the finger plane, between the picture's border and the fingertip."""
    dimensions, parts = rig
    y = np.arange(-dimensions.field_mm[1] / 2, dimensions.stop_y_mm - 2, 1.0)
    places = np.stack(np.meshgrid(np.arange(-8.0, 9.0, 4.0), y), axis=-1).reshape(-1, 2)
    pad = np.column_stack([places, np.zeros(len(places))])
    for base in ("base", "window_base"):
        names = (base, "cylinder", "frame")
        mesh = np.concatenate([assembly.triangles_of(parts[name]) for name in names]).astype(float)
        for hole in dimensions.holes:
            way = hole.light_mm - pad
            length = np.linalg.norm(way, axis=1)
            distance, _ = _first_hits(mesh, pad, way / length[:, None], 200.0)
            assert np.all(distance > length - 0.1), (base, hole.index)


def test_files_are_the_same_every_time(tmp_path):
    dimensions = dimensions_of(other_rig())
    for run in ("a", "b"):
        (tmp_path / run).mkdir()
        parts = {part.kind.name: part for part in build_parts(dimensions)}
        assembly.write_assembly(tmp_path / run / "up.step", [parts[name] for name in STACK])
        assembly.write_assembly(tmp_path / run / "down.step", [parts[name] for name in STACK_BELOW], below=True)
        assembly.write_step(tmp_path / run / "nail.step", parts["nail"])
    for name in ("up.step", "down.step", "nail.step"):
        first, second = ((tmp_path / run / name).read_bytes() for run in ("a", "b"))
        assert first == second, name
    up, down = (build123d.import_step(tmp_path / "a" / name) for name in ("up.step", "down.step"))
    ends = [up.bounding_box().max.Z, down.bounding_box().min.Z]
    assert ends == pytest.approx([dimensions.top_z_mm, -dimensions.top_z_mm])
    assert len(up.solids()) == len(down.solids()) == 5


def test_a_rig_that_cannot_be_built_is_not_drawn():
    dimensions = dimensions_of(default_rig(), override(PartSettings(), {"printer.bed_x_mm": 100.0}))
    with pytest.raises(BadInput, match="more than the printer's bed of 100 mm"):
        build_parts(dimensions)


@pytest.fixture(scope="module", params=["servo", "hand", "neighbours"])
def filmed(request):
    """Dimensions and parts by name of the thesis's rig with films."""
    dimensions = dimensions_of(with_films(default_rig(), request.param))
    return dimensions, {part.kind.name: part.solid for part in build_parts(dimensions)}


def test_films_holders_print_and_touch_nothing_else(filmed):
    dimensions, parts = filmed
    names = [name for name in ("analyser_plate", "analyser", "film_ring") if name in parts]
    assert len(names) == (2 if dimensions.films.kind == "neighbours" else 3)
    for kind in assembly.FILM_KINDS:
        if kind.name in parts:
            part = assembly.RigPart(kind, parts[kind.name])
            report = report_part(
                kind, assembly.as_printed(part, assembly.triangles_of(part)), dimensions.settings.printer
            )
            assert all(verdict["ok"] for verdict in report["checks"].values()), kind.name
    for first, second in itertools.combinations([*STACK, *names], 2):
        assert shared_volume(parts[first], parts[second]) < 1e-6, (first, second)
    for x, y in (
        *film_mounts(dimensions).ring_posts,
        *film_mounts(dimensions).plate_posts,
    ):  # a screw's head over every post
        z = dimensions.frame_z_mm + JOINT_PLATE_MM + 0.01
        head = build123d.Pos(x, y, z) * build123d.Solid.make_cylinder(2.8, 2.4)
        assert shared_volume(head, parts["frame"]) < 1e-6


def test_the_analyser_turns_by_90_degrees_between_its_stops(filmed):
    dimensions, parts = filmed
    if dimensions.films.kind == "neighbours":
        return
    for turn in (0.0, 30.0, 60.0, 90.0, -2.0, 92.0):
        turned = build123d.Rot(0, 0, turn) * parts["analyser"]
        assert (shared_volume(turned, parts["analyser_plate"]) > 0.01) == (turn in (-2.0, 92.0)), turn
        assert shared_volume(turned, parts["frame"]) < 1e-6
    lens = build123d.Pos(0, 0, 132.0) * build123d.Solid.make_cylinder(7.5, 8.0)
    assert shared_volume(lens, parts["analyser"]) < 1e-6


def test_light_passes_the_windows_and_the_analyser(filmed):
    """From every LED to all that it must light, and from there to the lens; films lie square to the rig."""
    dimensions, parts = filmed
    names = [name for name in ("analyser_plate", "analyser", "film_ring", "frame", "cylinder") if name in parts]
    mesh = np.concatenate(
        [assembly.triangles_of(assembly.RigPart(assembly.KINDS[0], parts[name])) for name in names]
    ).astype(float)
    corners = dimensions.lit_corners
    for hole in dimensions.holes:
        way = hole.light_mm - corners
        length = np.linalg.norm(way, axis=1)
        assert np.all(_first_hits(mesh, corners, way / length[:, None], 200.0)[0] > length - 0.1), hole.index
    x, y = np.array(dimensions.field_mm) / 2
    seen = np.array([(i * x, j * y, 0.0) for i in (-1, 0, 1) for j in (-1, 0, 1)])
    for pupil in ((2.5, 0.0), (0.0, -2.5), (-1.8, 1.8)):
        way = np.array([*pupil, dimensions.camera_height_mm]) - seen
        length = np.linalg.norm(way, axis=1)
        assert np.all(_first_hits(mesh, seen, way / length[:, None], 200.0)[0] > length - 8.0)
    axes = [axis for _, _, axis in film_mounts(dimensions).windows]
    assert axes == ["x"] * 7 + [""] * 7 + ["y"] * (len(axes) - 14)


def test_a_servo_and_its_horn_fit(filmed):
    dimensions, parts = filmed
    if dimensions.films.kind != "servo":
        return
    top = dimensions.frame_z_mm + JOINT_PLATE_MM
    body = build123d.Pos(-28 - 6.1, -5.9, top - 4.3) * build123d.Solid.make_box(12.2, 22.8, 22.7)
    ears = build123d.Pos(-28 - 6.1, -5.9 - 4.75, top) * build123d.Solid.make_box(12.2, 32.3, 2.5)
    horns = [
        build123d.Pos(-28, 0, top - 4.3 - 5.8)
        * build123d.Rot(0, 0, turn)
        * (build123d.Pos(0, -3, 0) * build123d.Solid.make_box(16, 6, 4))
        for turn in (45.0, 90.0, 135.0)
    ]
    for thing in (body, ears, *horns):
        for name in ("frame", "box", "film_ring", "analyser_plate", "analyser", "cylinder"):
            assert shared_volume(thing, parts[name]) < 1e-6, name


@pytest.mark.parametrize(
    ("azimuths", "radius", "films", "words"),
    [
        ((0.7, 2.0, 3.14, 5.0), 33.0, "servo", "LED 2 stands where the analyser's servo must be"),
        ((0.4, 2.0, 3.14, 5.0), 40.0, "hand", "the analyser's rod would cut the light of LED 0"),
        ((0.7, 2.0, 3.6, 5.0), 40.0, "servo", "31.* mm from the camera's axis, where .* mm are taken"),
        ((0.7, 2.0, 3.6, 5.0), 33.0, "hand", "25.* mm from the camera's axis, where .* mm are taken"),
        ((0.7, 0.87, 3.0, 5.0), 40.0, "hand", r"films of LEDs 0 and 1, squares of \d\.\d mm, would overlap"),
    ],
)
def test_leds_that_leave_no_room_for_films_are_named(azimuths, radius, films, words):
    leds = tuple(Led("white", position_mm=(radius * math.cos(a), radius * math.sin(a), 120.0)) for a in azimuths)
    with pytest.raises(BadInput, match=words):
        film_mounts(dimensions_of(with_films(Rig(other_rig().camera, leds), films)))


def test_films_of_upright_leds_do_not_fit_into_the_tube():
    leds = tuple(replace(led, aim=(0.0, 0.0, -1.0)) for led in other_rig().leds)
    wide = [replace(led, position_mm=(1.55 * led.position_mm[0], 1.55 * led.position_mm[1], 120.0)) for led in leds]
    with pytest.raises(BadInput, match="out of the tube of"):
        film_mounts(dimensions_of(with_films(Rig(other_rig().camera, tuple(wide)), "hand")))
