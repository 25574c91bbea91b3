"""The printed parts as solids: bases and mirror holder, tubes and lid, calibration disc and nail;
and below them what they are made of. Needs build123d; imported where parts are made.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from build123d import Axis, Face, Plane, Pos, Rot, Solid, Vector, Wire

from hardware import films, sizes
from hardware.films import film_mounts
from hardware.geometry import (
    POCKET_MM,
    SCREWS_A_DEG,
    SCREWS_B_DEG,
    SIDE_FILM_AT_MM,
    LedHole,
    RigDimensions,
    holder_depth,
    holder_places,
    mirror_profile,
    side_lamp,
)
from hardware.sizes import Array

Shape = Any
"""A solid of build123d."""
_Points = Sequence[tuple[float, float]]
_Point = Sequence[float] | Array
_LEVER_HALF_MM = 2.2  # half the width of the analyser's lever
_PEG_MM = 2.2  # radius of the pegs that stop it
_FEET_DEG = (45.0, 135.0, 225.0, 315.0)
_FAR_MM = 500.0  # beyond every part


def _base_part(d: RigDimensions) -> Shape:
    """The finger lies on its back in a round groove up to a low wall; pockets take mirror holders
    and the disc."""
    finger, end = d.settings.finger, d.stop_y_mm + d.settings.joint.wall_mm
    low, rim = d.floor_z_mm - POCKET_MM, d.groove_z_mm + finger.groove_depth_mm
    groove, slack = (-d.groove_width_mm / 2, d.groove_width_mm / 2), sizes.JOINT_CLEARANCE_MM
    disc = _ring(
        d.disc_radius_mm - d.settings.joint.wall_mm - slack,
        d.disc_radius_mm + slack,
        low,
        d.floor_z_mm + 1.0,
    )
    plate = _cut(_plate(d), [*_mirror_pockets(d), disc, *_feet(d, d.base_z_mm, 1.0)])
    block = _box((-d.block_mm, d.block_mm), (d.niche_y_mm - 2.0, end), (low, rim))
    stop = _box(groove, (d.stop_y_mm - 1.0, end), (low, d.groove_z_mm + finger.stop_height_mm))
    middle = d.groove_z_mm + d.groove_radius_mm
    trough = _rod(d.groove_radius_mm, (0.0, -_FAR_MM, middle), (0.0, d.stop_y_mm, middle))
    above = _box(groove, (-_FAR_MM, d.stop_y_mm), (rim, rim + _FAR_MM))
    return _cut(_fused(plate, [block, stop]), [trough, above])


def _window_base_part(d: RigDimensions) -> Shape:
    """Base for the camera below: the finger lies pad down over an open window, its middle phalanx
    in a 45 deg groove that fills the cylinder's opening, its tip on a 45 deg ledge; the pad touches
    nothing.
    """
    wall, half = d.settings.joint.wall_mm, d.groove_width_mm / 2
    low, floor = d.base_z_mm, d.floor_z_mm
    start = -d.field_mm[1] / 2 - 2.0  # the window begins outside the picture
    radius = d.opening_radius_mm - sizes.JOINT_CLEARANCE_MM
    plug = _rod(radius, (0.0, d.niche_y_mm - 2.0, floor), (0.0, start, floor))
    plug = _cut(plug, [_box((-_FAR_MM, _FAR_MM), (-_FAR_MM, _FAR_MM), (-_FAR_MM, floor - 0.2))])
    rails = _box(
        (-half - wall, half + wall), (start - 1.0, d.stop_y_mm + wall), (floor - 0.2, -1.0)
    )
    body = _fused(_plate(d), [plug, rails])
    # a finger that touches the finger plane has half the pad's height as its radius
    apex = d.settings.finger.pad_height_mm / 2 * (math.sqrt(2.0) - 1.0)
    under = [
        (-half, low - 1.0),
        (half, low - 1.0),
        (half, apex - half),
        (0.0, apex),
        (-half, apex - half),
    ]
    cavity = _prism_y(under, -_FAR_MM, start + 0.1)
    window = _box((-half, half), (start, d.stop_y_mm), (low - 1.0, _FAR_MM))
    return _fused(_cut(body, [cavity, window, _free_light(d, start, apex + wall)]), [_ledge(d)])


def _free_light(d: RigDimensions, start: float, height: float) -> Shape:
    """Cut the plug down from the opening towards the window, so that it throws no shadow on the
    pad."""
    top, near = d.floor_z_mm + d.opening_radius_mm + 1.0, d.niche_inner_y_mm + 0.5
    end = min(start, near + top - height)
    slope = [
        (near, top),
        (end, top - (end - near)),
        (start + 1.0, top - (end - near)),
        (start + 1.0, top),
    ]
    return _prism_x(slope, -d.bore_mm, d.bore_mm)


def _ledge(d: RigDimensions) -> Shape:
    """A wedge at the window's end, where the fingertip rests and stops; it hides the last 2 mm of
    the tip."""
    half, wall = d.groove_width_mm / 2, d.settings.joint.wall_mm
    deep, end = 2.0, d.stop_y_mm
    # a round tip touches wall and wedge
    rest = -d.settings.finger.pad_height_mm / 2 * (2.0 - math.sqrt(2.0))
    outline = [
        (end + wall / 2, rest),
        (end, rest),
        (end - deep, rest + deep),
        (end + wall / 2, rest + deep),
    ]
    return _prism_x(outline, -half - wall / 2, half + wall / 2)


def _plate(d: RigDimensions) -> Shape:
    """Floor with ridge and lugs for inserts; no ridge where the hand's niche is."""
    low, high = d.base_z_mm, d.floor_z_mm
    half = d.settings.finger.hand_width_mm / 2 + d.settings.joint.wall_mm + 1.0
    hand = _box((-half, half), (-_FAR_MM, 0.0), (high - 0.2, high + _FAR_MM))
    ring = _ridge(d, high).cut(hand)
    lugs = _head_lugs(d, low, high - low, d.base_screws_deg)
    body = _fused(_ring(0.0, d.ring_mm, low, high), [*ring.solids(), *lugs])
    return _cut(body, _insert_holes(d, high, high - low + 1.0, d.base_screws_deg))


def _mirror_pockets(d: RigDimensions) -> list[Shape]:
    slack = sizes.JOINT_CLEARANCE_MM
    half, z = sizes.MIRROR_LONG_MM / 2 + slack, (d.floor_z_mm - POCKET_MM, d.floor_z_mm + 1.0)
    near = -slack
    far = holder_depth(d.settings) + slack
    (right, middle, _), _, (_, tip, _) = holder_places(d)
    y = (middle - half, middle + half)
    return [
        _box((right + near, right + far), y, z),
        _box((-right - far, -right - near), y, z),
        _box((-half, half), (tip + near, tip + far), z),
    ]


def _mirror_holder_part(d: RigDimensions) -> Shape:
    """Return the holder of one mirror, in the place of the right one; left and tip are the same,
    turned."""
    x, y, _ = holder_places(d)[0]
    foot, half = d.floor_z_mm - POCKET_MM, sizes.MIRROR_LONG_MM / 2
    outline = [(x + u, foot + v) for u, v in mirror_profile(d.settings)]
    return _prism_y(outline, y - half, y + half)


_CAMERA_HOLES = tuple(
    itertools.product(
        (-sizes.CAMERA_HOLE_X_MM / 2, sizes.CAMERA_HOLE_X_MM / 2),
        (-sizes.CAMERA_LENS_TO_HOLES_MM, sizes.CAMERA_HOLE_Y_MM - sizes.CAMERA_LENS_TO_HOLES_MM),
    )
)
"""x and y of the camera board's holes; its connector lies on the hand's side (-y)."""
_PI_FIRST_MM = sizes.PI_X_MM / 2 - sizes.PI_HOLE_EDGE_MM
_PI_HOLES = tuple(
    itertools.product(
        (_PI_FIRST_MM, _PI_FIRST_MM - sizes.PI_HOLE_X_MM),
        (-sizes.PI_HOLE_Y_MM / 2, sizes.PI_HOLE_Y_MM / 2),
    )
)
"""x and y of the Raspberry Pi's holes: the board in the middle, USB sockets at -x, power socket at
+y."""
_CABLE_DEG = 70.0
"""Azimuth of the cable hole: at the back, on the side of the Pi's power socket, beside lugs and
boards."""


def _cylinder_part(d: RigDimensions) -> Shape:
    """The cylinder holds LEDs and camera at their height over the finger. The hand comes into a
    niche with a 45 deg roof, whose end wall has the semicircular opening for the finger.
    """
    low, high = d.floor_z_mm, d.frame_z_mm
    lugs = _head_lugs(d, low, sizes.JOINT_LUG_MM, d.base_screws_deg) + _insert_lugs(
        d, high, SCREWS_B_DEG
    )
    niche = _prism_y(_niche(d, d.settings.joint.wall_mm), -d.outer_mm - 10.0, d.niche_inner_y_mm)
    body = _fused(
        _tube(d, low, high), [*lugs, _common(niche, _cylinder(d.outer_mm - 0.3, low, high))]
    )
    hand = _prism_y(_niche(d, 0.0, below=5.0), -d.outside_mm - 10.0, d.niche_y_mm)
    opening = _rod(
        d.opening_radius_mm, (0.0, d.niche_y_mm - 1.0, low), (0.0, d.niche_inner_y_mm + 1.0, low)
    )
    holes = _head_holes(d, low, d.base_screws_deg)
    holes += _insert_holes(d, high, sizes.JOINT_INSERT_DEPTH_MM, SCREWS_B_DEG)
    for side in d.sides:
        lamp = side_lamp(d)
        radius = lamp.plug_mm + sizes.JOINT_CLEARANCE_MM
        holes.append(_rod(radius, side.at(10.0 - lamp.wall_mm), side.at(-lamp.mouth_mm - 10.0)))
    if d.films is not None and d.films.kind == "hand":
        y = films.ROD_Y_MM
        z = film_mounts(d).rod_z_mm
        holes.append(_rod(1.4, (d.bore_mm - 5.0, y, z), (d.outside_mm + 5.0, y, z)))
    return _cut(body, [hand, opening, *holes])


def _niche(d: RigDimensions, wall: float, below: float = 0.0) -> list[tuple[float, float]]:
    """Outline (x, z) of the hand's niche, `wall` mm larger than its inside."""
    finger, floor = d.settings.finger, d.floor_z_mm
    half = finger.hand_width_mm / 2 + wall
    roof = floor + finger.hand_height_mm + finger.hand_width_mm / 2 + wall * math.sqrt(2.0)
    return [
        (-half, floor - below),
        (half, floor - below),
        (half, roof - half),
        (0.0, roof),
        (-half, roof - half),
    ]


def _frame_part(d: RigDimensions) -> Shape:
    """The frame: tilted holes with shoulders for the LEDs, posts for the camera's board, the lens's
    opening."""
    low, high = d.frame_z_mm, d.box_z_mm
    lugs = _head_lugs(d, low, sizes.JOINT_PLATE_MM, SCREWS_B_DEG) + _insert_lugs(
        d, high, SCREWS_A_DEG
    )
    # cuts what stands out of frame and wall
    inside = _cylinder(d.bore_mm + d.settings.joint.wall_mm / 2, low + 0.1, high)
    ends = [(h.pocket_radius_mm, h.at(h.level_mm(low) - 3.0), h.at(h.back_mm)) for h in d.holes]
    bosses = [
        _common(_rod(radius + d.settings.joint.wall_mm, start, end), inside)
        for radius, start, end in ends
    ]
    top, board = low + sizes.JOINT_PLATE_MM, d.board_z_mm
    posts = [_cylinder(sizes.CAMERA_POST_MM / 2, top - 0.5, board, x, y) for x, y in _CAMERA_HOLES]
    body = _fused(_tube(d, low, high, sizes.JOINT_PLATE_MM), [*lugs, *bosses, *posts])
    holes = [_cylinder(d.lens_hole_mm, low - 1.0, board + 1.0)]
    for hole in d.holes:
        holes.append(
            _rod(hole.radius_mm, hole.at(hole.level_mm(low) - 8.0), hole.at(hole.shoulder_mm + 0.5))
        )
        holes += _funnel(hole, d)
        holes.append(
            _rod(hole.pocket_radius_mm, hole.at(hole.shoulder_mm), hole.at(hole.back_mm + 6.0))
        )
    holes += [
        _cylinder(sizes.CAMERA_POST_HOLE_MM / 2, low + 1.2, board + 1.0, x, y)
        for x, y in _CAMERA_HOLES
    ]
    holes += [_first_led_mark(d), *_film_screws(d)]
    holes += _head_holes(d, low, SCREWS_B_DEG)
    holes += _insert_holes(d, high, sizes.JOINT_INSERT_DEPTH_MM, SCREWS_A_DEG)
    return _cut(body, holes)


def _funnel(hole: LedHole, d: RigDimensions) -> list[Shape]:
    """Free the dome of an LED that lies higher than the lowest one; the funnel's roof leans by 45
    deg at most."""
    start = sizes.LED_TIP_FREE_MM
    near = hole.level_mm(d.frame_z_mm) - hole.lean_mm
    if near >= start:
        return []
    long = start - near + 2 * hole.lean_mm + 2.0
    wider = long * math.tan(math.radians(max(44.0 - hole.tilt_deg, 5.0)))
    return [_rod(hole.radius_mm, hole.at(start - long), hole.at(start), hole.radius_mm + wider)]


def _first_led_mark(d: RigDimensions) -> Shape:
    """A dimple in the frame's upper face beside LED 0, towards the camera."""
    first, top = d.holes[0], d.frame_z_mm + sizes.JOINT_PLATE_MM
    back = first.at(first.back_mm)[:2]
    place = back * (
        1.0 - (first.pocket_radius_mm + d.settings.joint.wall_mm + 3.0) / float(np.hypot(*back))
    )
    return _cylinder(1.2, top - 0.8, top + 1.0, float(place[0]), float(place[1]))


def _box_part(d: RigDimensions) -> Shape:
    """Return the circuit box: posts for the Raspberry Pi and, higher, the LED circuit; a cable hole
    near the top."""
    low, high = d.box_z_mm, d.lid_z_mm
    floor = low + sizes.JOINT_PLATE_MM
    lugs = _head_lugs(d, low, sizes.JOINT_PLATE_MM, SCREWS_A_DEG) + _insert_lugs(
        d, high, SCREWS_B_DEG
    )
    posts, screws = [], []
    x, y = d.settings.board.pcb_hole_x_mm / 2, d.settings.board.pcb_hole_y_mm / 2
    pcb = tuple(itertools.product((-x, x), (-y, y)))
    pi_top = floor + sizes.PI_POST_HEIGHT_MM
    pcb_top = pi_top + 1.5 + sizes.PCB_OVER_PI_MM
    for places, top, hole in (
        (_PI_HOLES, pi_top, sizes.PI_POST_HOLE_MM),
        (pcb, pcb_top, sizes.PCB_POST_HOLE_MM),
    ):
        for x, y in places:
            posts.append(_cylinder(sizes.BOARD_POST_MM / 2, floor - 0.5, top, x, y))
            screws.append(_cylinder(hole / 2, max(low + 1.2, top - 12.0), top + 1.0, x, y))
    body = _fused(_tube(d, low, high, sizes.JOINT_PLATE_MM), [*lugs, *posts])
    x, y = sizes.SLOT_X_MM / 2, sizes.SLOT_Y_MM / 2
    slots = [
        _box((-x, x), (place - y, place + y), (low - 1.0, floor + 1.0)) for place in (0.0, -14.0)
    ]
    holes = _head_holes(d, low, SCREWS_A_DEG)
    holes += _insert_holes(d, high, sizes.JOINT_INSERT_DEPTH_MM, SCREWS_B_DEG)
    radius = sizes.CABLE_HOLE_MM / 2
    z = d.lid_z_mm - 2 * sizes.JOINT_RING_MM - 1.0 - radius * math.sqrt(2.0)
    near, far = d.bore_mm - 5.0, d.ring_mm + 5.0
    half = radius * math.sqrt(0.5)
    point = _prism_y([(-half, z + half), (half, z + half), (0.0, z + 2 * half)], near, far)
    cable_hole = _turned_to(
        _CABLE_DEG - 90.0, _fused(_rod(radius, (0.0, near, z), (0.0, far, z)), [point])
    )
    return _cut(body, [*slots, *screws, cable_hole, *holes])


def _lid_part(d: RigDimensions) -> Shape:
    """Return the lid: closes the box against light; with the camera below it is the foot."""
    low, high = d.lid_z_mm, d.top_z_mm
    body = _fused(_ring(0.0, d.ring_mm, low, high), _head_lugs(d, low, high - low, SCREWS_B_DEG))
    return _cut(body, [_groove(d, low), *_feet(d, high, -1.0), *_head_holes(d, low, SCREWS_B_DEG)])


_DOT_BORDER_MM = 2.0  # between the outermost dots and the wall
_PEG_SLACK_MM = 0.1


def _disc_dots(d: RigDimensions) -> list[tuple[float, float]]:
    """Return x and y of the disc's dots: multiples of the spacing, one of them in the middle."""
    step = sizes.DOT_SPACING_MM
    reach = (
        d.disc_radius_mm
        - d.settings.joint.wall_mm
        - d.settings.calibration.dot_mm / 2
        - _DOT_BORDER_MM
    )
    steps = range(-int(reach // step), int(reach // step) + 1)
    return [(i * step, j * step) for i in steps for j in steps if math.hypot(i, j) * step <= reach]


def _dots_part(d: RigDimensions) -> Shape:
    """Return a sheet with pegs that are pushed into the flat disc from behind."""
    low, high = -sizes.DISC_MM - sizes.MIN_WALL_MM, -sizes.DISC_MM
    radius = d.disc_radius_mm - d.settings.joint.wall_mm - sizes.JOINT_CLEARANCE_MM
    peg = d.settings.calibration.dot_mm / 2 - _PEG_SLACK_MM
    return _fused(
        _cylinder(radius, low, high),
        [_cylinder(peg, high - 0.3, 0.0, x, y) for x, y in _disc_dots(d)],
    )


def _disc_part(d: RigDimensions, depth: float) -> Shape:
    """Return the disc with recessed dots; its face is the finger plane, its skirt stands in the
    base's ring pocket."""
    radius = d.settings.calibration.dot_mm / 2
    # Disc and skirt
    outside, thick, foot = d.disc_radius_mm, sizes.DISC_MM, d.floor_z_mm - POCKET_MM
    inside = outside - d.settings.joint.wall_mm
    body = _turned(
        [
            (0.0, 0.0),
            (outside, 0.0),
            (outside, foot),
            (inside, foot),
            (inside, -thick),
            (0.0, -thick),
        ]
    )
    half = d.block_mm + 2 * sizes.JOINT_CLEARANCE_MM
    rim = d.groove_z_mm + d.settings.finger.groove_depth_mm
    cup = _cut(body, [_box((-half, half), (-outside - 1.0, -5.0), (foot - 1.0, rim + 0.5))])
    return _cut(cup, [_cylinder(radius, -depth, 1.0, x, y) for x, y in _disc_dots(d)])


# Holders of polarising films.


def _film_screws(d: RigDimensions) -> list[Shape]:
    """What a rig with films has in the frame's floor: holes for the posts' screws, and the servo's
    opening."""
    if d.films is None:
        return []
    mounts = film_mounts(d)
    low = d.frame_z_mm
    high = low + sizes.JOINT_PLATE_MM + 1.0
    posts = [*mounts.ring_posts, *mounts.plate_posts]
    holes = [_cylinder(sizes.JOINT_SCREW_HOLE_MM / 2, low - 1.0, high, x, y) for x, y in posts]
    if mounts.kind == "servo":
        (wide, long), near, x = sizes.SERVO_MM, -sizes.SERVO_SHAFT_MM, -films.LINK_MM
        holes.append(_box((x - wide / 2, x + wide / 2), (near, near + long), (low - 1.0, high)))
        for side in (-0.5, 0.5):
            y = near + long / 2 + side * sizes.SERVO_SCREWS_MM
            holes.append(_cylinder(sizes.CAMERA_POST_HOLE_MM / 2, low + 1.2, high, x, y))
    return holes


def _posts(places: _Points, low: float, high: float) -> tuple[list[Shape], list[Shape]]:
    """Return posts up to the frame, and the holes for their self-tapping screws."""
    radius = sizes.PCB_POST_HOLE_MM / 2
    deep = max(low - 3.0, high - 7.0)
    posts = [_cylinder(films.POST_MM, low - 0.5, high, x, y) for x, y in places]
    return posts, [_cylinder(radius, deep, high + 1.0, x, y) for x, y in places]


def _film_pocket(
    place: tuple[float, float], side: float, z: tuple[float, float], axis: str
) -> list[Shape]:
    """Return a square pocket between two heights, and marks of its film's axis beyond two of its
    edges."""
    (x, y), half = place, side / 2
    long = [half + 1.4 if way == axis else 0.4 for way in "xy"]
    pocket = _box((x - half, x + half), (y - half, y + half), z)
    return [pocket, _box((x - long[0], x + long[0]), (y - long[1], y + long[1]), z)]


def _film_ring_part(d: RigDimensions) -> Shape:
    """Return the ring below the LEDs: a window for each, and for the white ones a pocket for film
    over it."""
    mounts = film_mounts(d)
    high, low = mounts.ring_z_mm, mounts.ring_z_mm - films.FILM_MM - sizes.MIN_WALL_MM
    posts, screws = _posts(mounts.ring_posts, high, d.frame_z_mm)
    ring = _fused(
        _ring(mounts.ring_mm[0], d.bore_mm - 2 * sizes.JOINT_CLEARANCE_MM, low, high), posts
    )
    cuts = [_cylinder(mounts.window_mm, low - 1.0, high + 1.0, x, y) for x, y, _ in mounts.windows]
    for x, y, axis in mounts.windows:
        if axis:
            cuts += _film_pocket((x, y), mounts.piece_mm, (high - films.FILM_MM, high + 1.0), axis)
    return _cut(ring, [*cuts, *screws])


def _analyser_part(d: RigDimensions) -> Shape:
    """Return the analyser in its parallel position: body, flange, lever, collar around the lens;
    film from below."""
    mounts = film_mounts(d)
    camera = d.settings.camera
    radius, lens = mounts.turning_mm, camera.barrel_mm / 2 + 0.6
    low, middle, high = (mounts.plate_z_mm + up for up in (-films.PLATE_MM, 0.0, films.FLANGE_MM))
    top = d.camera_height_mm - camera.barrel_front_mm + 3.0
    lever = _box((0.0, films.LEVER_MM + 1.9), (-_LEVER_HALF_MM, _LEVER_HALF_MM), (middle, high))
    wire = _cylinder(
        0.65 if mounts.kind == "servo" else 0.8, middle - 1.0, high + 1.0, films.LEVER_MM
    )
    collar = _cylinder(lens + 1.2, high - 0.5, top)
    flange = _cylinder(radius + 1.2, middle, high)
    body = _turned_to(
        45.0, _cut(_fused(_cylinder(radius, low, high), [flange, lever, collar]), [wire])
    )
    pocket = _film_pocket(
        (0.0, 0.0), mounts.analyser_piece_mm, (low - 1.0, low + films.FILM_MM), "x"
    )
    return _cut(
        body,
        [_cylinder(mounts.aperture_mm, low - 1.0, top), _cylinder(lens, high, top + 1.0), *pocket],
    )


def _analyser_plate_part(d: RigDimensions) -> Shape:
    """Return the plate before the lens: the analyser turns in it by 90 deg between two stops, or
    its film is fixed."""
    mounts = film_mounts(d)
    low, high = mounts.plate_z_mm - films.PLATE_MM, mounts.plate_z_mm
    posts, cuts = _posts(mounts.plate_posts, high, d.frame_z_mm)
    plate = _cylinder(
        max(math.hypot(*place) for place in mounts.plate_posts) + films.POST_MM, low, high
    )
    if mounts.kind == "neighbours":
        cuts += _film_pocket(
            (0.0, 0.0), mounts.analyser_piece_mm, (low - 1.0, low + films.FILM_MM), "x"
        )
        cuts.append(_cylinder(mounts.aperture_mm, low - 1.0, high + 1.0))
        return _cut(_fused(plate, posts), cuts)
    radius = mounts.turning_mm
    away = radius + 1.2 + 0.2 + _PEG_MM  # pegs beside the flange; washers on them hold it down
    apart = math.degrees(math.asin((_LEVER_HALF_MM + _PEG_MM) / away))
    for azimuth in (45.0 - apart, 135.0 + apart, 270.0):
        x = away * math.cos(math.radians(azimuth))
        y = away * math.sin(math.radians(azimuth))
        posts.append(_cylinder(_PEG_MM, high - 0.5, high + films.FLANGE_MM + 0.3, x, y))
        cuts.append(_cylinder(sizes.CAMERA_POST_HOLE_MM / 2, low - 1.0, high + 9.0, x, y))
    return _cut(
        _fused(plate, posts),
        [*cuts, _cylinder(radius + sizes.JOINT_CLEARANCE_MM, low - 1.0, high + 1.0)],
    )


def side_places(d: RigDimensions) -> list[Any]:
    """Return where the lamps of the side lights are in the rig; each is drawn about z, with the
    light at the origin."""
    lights = [(hole.light_mm, -hole.back) for hole in d.sides]
    return [Plane(tuple(at), (-at[1], at[0], 0.0), tuple(way)).location for at, way in lights]


def _side_lamp_part(d: RigDimensions) -> Shape:
    """A side light's lamp as printed: the LED from below, a slit for film from its upper side in
    the rig (-y), a collar whose face fits the cylinder, and the plug through its wall.
    """
    lamp = side_lamp(d)
    hole = d.sides[0]
    low = -d.sides[0].back_mm
    plug, collar, body = lamp.plug_mm, lamp.collar_mm, lamp.body_mm
    lean = collar * float(hole.back[2]) / math.hypot(float(hole.back[0]), float(hole.back[1]))
    foot, top = lamp.wall_mm - lean - sizes.MIN_WALL_MM, lamp.wall_mm + lean + 5.0
    outline = [
        (0.0, low),
        (body, low),
        (body, foot - collar + body),
        (collar, foot),
        (collar, top),
        (0.0, top),
    ]
    outside = _cylinder(d.outer_mm + sizes.JOINT_CLEARANCE_MM / 2, -_FAR_MM, _FAR_MM)
    shape = _cut(_turned(outline), [side_places(d)[0].inverse() * outside])
    shape = _fused(shape, [_cylinder(plug, lamp.wall_mm - lean - 1.0, lamp.mouth_mm)])
    film, start = lamp.film_mm / 2, hole.radius_mm
    slit = _box(
        (-film, film),
        (-_FAR_MM, film),
        (SIDE_FILM_AT_MM - 0.1, SIDE_FILM_AT_MM + films.FILM_MM + 0.1),
    )
    wide, end = lamp.mouth_radius_mm, lamp.mouth_mm
    light = _turned([(0.0, 0.0), (start, 0.0), (wide, end), (wide, end + 1.0), (0.0, end + 1.0)])
    flange = -hole.shoulder_mm
    behind = _cylinder(start, -hole.shoulder_mm - 0.5, 0.1)
    return _cut(shape, [light, slit, behind, _cylinder(hole.pocket_radius_mm, low - 1.0, flange)])


MAKERS: dict[str, Callable[[RigDimensions], Shape]] = {
    "base": _base_part,
    "window_base": _window_base_part,
    "mirror_holder": _mirror_holder_part,
    "cylinder": _cylinder_part,
    "frame": _frame_part,
    "box": _box_part,
    "lid": _lid_part,
    "calibration_disc": lambda d: _disc_part(d, sizes.DOT_DEPTH_MM),
    "calibration_disc_flat": lambda d: _disc_part(d, sizes.DISC_MM + 1.0),
    "calibration_dots": _dots_part,
    "nail": lambda d: (
        Pos(0, 0, 0) * Solid.make_cone(sizes.NAIL_RADIUS_MM, sizes.NOZZLE_MM / 2, d.nail_mm)
    ),
    "film_ring": _film_ring_part,
    "analyser": _analyser_part,
    "analyser_plate": _analyser_plate_part,
    "side_lamp": _side_lamp_part,
}
"""What draws each part."""


def _cylinder(radius: float, low: float, high: float, x: float = 0.0, y: float = 0.0) -> Shape:
    return Pos(x, y, low) * Solid.make_cylinder(radius, high - low)


def _rod(radius: float, start: _Point, end: _Point, start_radius: float | None = None) -> Shape:
    """Return a cylinder between two points, or a cone if it starts with another radius."""
    first, last = (Vector(*(float(value) for value in point)) for point in (start, end))
    length = (last - first).length
    plane = Plane(origin=first, z_dir=last - first)
    if start_radius is not None:
        return Solid.make_cone(start_radius, radius, length, plane)
    return Solid.make_cylinder(radius, length, plane)


def _box(x: tuple[float, float], y: tuple[float, float], z: tuple[float, float]) -> Shape:
    return Pos(x[0], y[0], z[0]) * Solid.make_box(x[1] - x[0], y[1] - y[0], z[1] - z[0])


def _prism_y(outline: _Points, start: float, end: float) -> Shape:
    """Return the outline (x, z) extruded along y."""
    return Solid.extrude(_face([(x, start, z) for x, z in outline]), Vector(0.0, end - start, 0.0))


def _prism_x(outline: _Points, start: float, end: float) -> Shape:
    """Return the outline (y, z) extruded along x."""
    return Solid.extrude(_face([(start, y, z) for y, z in outline]), Vector(end - start, 0.0, 0.0))


def _ring(inside: float, outside: float, low: float, high: float) -> Shape:
    return _turned([(inside, low), (outside, low), (outside, high), (inside, high)])


def _turned(outline: _Points) -> Shape:
    return Solid.revolve(_face([(r, 0.0, z) for r, z in outline]), 360.0, Axis.Z)


def _turned_to(azimuth_deg: float, shape: Shape) -> Shape:
    return Rot(0, 0, azimuth_deg) * shape


def _fused(first: Shape, others: Iterable[Shape]) -> Shape:
    return _one(first.fuse(*others))


def _cut(first: Shape, others: Iterable[Shape]) -> Shape:
    return _one(first.cut(*others))


def _common(first: Shape, second: Shape) -> Shape:
    return _one(first.intersect(second))


def _one(shape: Shape) -> Shape:
    """Return the only solid of a result of fusing or cutting; a dimension that the checks let
    through may tear it."""
    solids = shape.solids()
    if len(solids) != 1:
        raise RuntimeError(f"a part fell into {len(solids)} pieces")
    return solids[0]


def _face(points: Sequence[tuple[float, float, float]]) -> Shape:
    return Face(Wire.make_polygon([Vector(*point) for point in points], close=True))


def _ridge(d: RigDimensions, z: float) -> Shape:
    """Return the ridge on a part's upper face: a ring whose outer flank leans inwards by 45 deg."""
    bore, outside, high = d.bore_mm, d.bore_mm + sizes.JOINT_RIDGE_MM, sizes.JOINT_RIDGE_HIGH_MM
    return _turned(
        [
            (bore, z - 0.2),
            (outside, z - 0.2),
            (outside, z),
            (outside - high, z + high),
            (bore, z + high),
        ]
    )


_GROOVE_MM = sizes.JOINT_RIDGE_MM + sizes.JOINT_CLEARANCE_MM
"""Width, and for its 45 deg flank the depth, of the groove that takes a ridge."""


def _groove(d: RigDimensions, z: float) -> Shape:
    """Return what to cut from the lower face of a floor: a groove for the ridge below, without a
    flat roof."""
    inside, outside = d.bore_mm - 0.3, d.bore_mm + _GROOVE_MM
    return _turned(
        [(inside, z - 0.5), (outside, z - 0.5), (outside, z), (inside, z + outside - inside)]
    )


def _tube(d: RigDimensions, low: float, high: float, floor_mm: float = 0.0) -> Shape:
    """Return a tube with thickened ends, a groove at its lower and a ridge at its upper end, and a
    floor, if any."""
    bore, outer, ring, ridge = d.bore_mm, d.outer_mm, d.ring_mm, d.bore_mm + sizes.JOINT_RIDGE_MM
    foot = low + max(sizes.JOINT_LUG_MM, floor_mm)
    top = high + sizes.JOINT_RIDGE_HIGH_MM
    outside = [(ring, low), (ring, foot), (outer, foot), (outer, high - 2 * sizes.JOINT_RING_MM)]
    outside += [(ring, high - sizes.JOINT_RING_MM), (ring, high)]
    outside += [(ridge, high), (ridge - sizes.JOINT_RIDGE_HIGH_MM, top), (bore, top)]
    if floor_mm > 0:
        body = _turned([(0.0, low), *outside, (bore, low + floor_mm), (0.0, low + floor_mm)])
        return _cut(body, [_groove(d, low)])
    return _turned([(bore + _GROOVE_MM, low), *outside, (bore, low + _GROOVE_MM)])


def _head_lugs(
    d: RigDimensions, z: float, thickness: float, azimuths_deg: Sequence[float]
) -> list[Shape]:
    """Return lugs under the heads of screws, at a part's lower face."""
    start = d.bore_mm + _GROOVE_MM + 0.3
    return [_turned_to(angle, _lug_outline(d, start, z, z + thickness)) for angle in azimuths_deg]


def _head_holes(d: RigDimensions, z: float, azimuths_deg: Sequence[float]) -> list[Shape]:
    """Return the clearance holes of these lugs."""
    high = z + sizes.JOINT_PLATE_MM + sizes.JOINT_LUG_MM
    hole = _cylinder(sizes.JOINT_SCREW_HOLE_MM / 2, z - 1.0, high, x=d.screw_mm)
    return [_turned_to(angle, hole) for angle in azimuths_deg]


def _insert_lugs(d: RigDimensions, z: float, azimuths_deg: Sequence[float]) -> list[Shape]:
    """Return lugs for heat-set inserts below a part's upper face, each with a 45 deg support."""
    start, end, low = d.outer_mm - 0.3, d.outside_mm, z - (sizes.JOINT_INSERT_DEPTH_MM + 1.0)
    profile = [(start, z), (end, z), (end, low), (start, low - (end - start))]
    gusset = _prism_y(profile, -sizes.JOINT_LUG_RADIUS_MM, sizes.JOINT_LUG_RADIUS_MM)
    plan = _lug_outline(d, start, low - (end - start) - 1.0, z)
    return [_turned_to(angle, _common(gusset, plan)) for angle in azimuths_deg]


def _insert_holes(
    d: RigDimensions, z: float, deep: float, azimuths_deg: Sequence[float]
) -> list[Shape]:
    """Return the holes for heat-set inserts, from a part's upper face down."""
    hole = _cylinder(sizes.JOINT_INSERT_HOLE_MM / 2, z - deep, z + 1.0, x=d.screw_mm)
    return [_turned_to(angle, hole) for angle in azimuths_deg]


def _feet(d: RigDimensions, z: float, into: float) -> list[Shape]:
    """Return pockets for stick-on feet, 0.8 mm deep; `into` is +1 for a lower face and -1 for an
    upper one."""
    radius = sizes.JOINT_FOOT_MM / 2
    low, high = sorted((z - into * 0.5, z + into * 0.8))
    pocket = _cylinder(radius, low, high, x=d.bore_mm - 2 * radius)
    return [_turned_to(angle, pocket) for angle in _FEET_DEG]


def _lug_outline(d: RigDimensions, start: float, low: float, high: float) -> Shape:
    radius, centre = sizes.JOINT_LUG_RADIUS_MM, d.screw_mm
    plate = _box((start, centre), (-radius, radius), (low, high))
    return _fused(plate, [_cylinder(radius, low, high, x=centre)])
