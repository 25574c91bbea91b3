"""Every dimension of the printed parts, from the rig file and the settings.

All places are in the rig's frame (``docs/explain/conventions.md``). Heights of the parts are
stacked in that frame, base lowest; with the camera below the whole stack is turned over.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np

from hardware import sizes
from hardware.sizes import Array
from splitknit.errors import require
from splitknit.model import Led, Rig
from splitknit_rig.capture.pins import RigFilms, rig_films
from splitknit_simulator.light.films import side_lights

_NAIL_STEP_MM = 0.5  # nails are whole numbers of it high


def shadow_tips(rig: Rig, nail_mm: float, place_mm: tuple[float, float] = (0.0, 0.0)) -> Array:
    """(L, 2) where each LED, not at the side, throws the shadow of a nail's tip, mm."""
    leds = _places(rig)
    place = np.asarray(place_mm, dtype=np.float64)
    stretch = nail_mm / (leds[:, 2] - nail_mm)
    return np.asarray(place + (place - leds[:, :2]) * stretch[:, None])


def _nail_height(rig: Rig, offset_mm: float, margin_mm: float, radius_mm: float) -> float:
    """Greatest height (mm, in half mm) of a nail up to `offset_mm` from the middle along x and y
    whose shadows' tips stay `margin_mm` inside the picture, and outside the nail's foot.
    """
    camera = rig.camera
    half = np.array([camera.image_size[1], camera.image_size[0]]) / camera.px_per_mm / 2 - margin_mm
    leds = _places(rig)
    best = float(leds[:, 2].min()) / 3
    for place in itertools.product((-offset_mm, 0.0, offset_mm), repeat=2):
        away = np.asarray(place) - leds[:, :2]  # (L, 2) the way of the shadow
        room = np.where(away >= 0, half - place, half + place)
        stretch = np.maximum((room / np.maximum(np.abs(away), 1e-9)).min(axis=1), 0.0)
        best = min(best, float((leds[:, 2] * stretch / (1 + stretch)).min()))
    height = math.floor(best / _NAIL_STEP_MM + 1e-9) * _NAIL_STEP_MM
    require(
        height >= 4.0,
        f"the picture of {2 * (half[0] + margin_mm):.0f} x {2 * (half[1] + margin_mm):.0f} mm is"
        f" too small for the shadows of a nail up to {offset_mm:g} mm from its middle; take a rig"
        " with a larger picture.",
    )
    nearest = float(np.hypot(*shadow_tips(rig, height).T).min())
    require(
        nearest >= radius_mm + 0.5,
        f"a nail of {height:g} mm hides the shadow of an LED under its foot of {radius_mm:g} mm"
        " radius, as that LED stands nearly above it.",
    )
    return height


def _places(rig: Rig) -> Array:
    side = side_lights(rig.leds)
    places = [led.position_mm for k, led in enumerate(rig.leds) if k not in side]
    require(None not in places, "the nail's height needs the place of every LED (position_mm).")
    return np.asarray(places, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class LedHole:
    """A tilted hole for one LED; distances along its axis count from the light, away from the
    finger."""

    index: int
    band: str
    light_mm: Array  # (3,) the LED's place in the rig file: the middle of its dome
    back: Array  # (3,) unit vector along the hole, away from the finger
    radius_mm: float
    pocket_radius_mm: float  # behind the shoulder, where the flange rests
    shoulder_mm: float
    back_mm: float  # where the pocket ends

    @property
    def tilt_deg(self) -> float:
        """Angle between the hole and the camera's axis."""
        return math.degrees(math.acos(min(1.0, float(self.back[2]))))

    def at(self, distance_mm: float) -> Array:
        """(3,) point on the axis."""
        return np.asarray(self.light_mm + distance_mm * self.back)

    @property
    def lean_mm(self) -> float:
        """How much farther along the axis a level face meets the hole's one side than its axis."""
        return self.radius_mm * math.tan(math.radians(self.tilt_deg))

    def level_mm(self, z: float) -> float:
        """Where the axis meets a level face at the height `z`."""
        return (z - float(self.light_mm[2])) / float(self.back[2])

    @property
    def radius_taken_mm(self) -> float:
        """How far from the camera's axis the LED reaches while it is pushed in from behind."""
        # its dome is at the pocket's end
        waiting = self.at(self.back_mm + self.shoulder_mm + self.radius_mm)
        outside = float(np.hypot(*waiting[:2])) + self.pocket_radius_mm * float(self.back[2])
        return max(outside, float(np.hypot(*self.light_mm[:2])) + self.radius_mm)


def _led_hole(index: int, led: Led, settings: SimpleNamespace) -> LedHole:
    """Return the hole of one LED. Raises BadInput if the LED has no place."""
    require(
        led.position_mm is not None and not led.also,
        f"LED {index} of the rig has no position_mm (it is distant light or a group), but parts"
        " need its place.",
    )
    sizes_of = ("diameter_mm", "flange_mm", "flange_to_light_mm")
    band = "white" if led.band == "white" else "nir"
    diameter, flange, shoulder = (getattr(settings, f"{band}_{name}") for name in sizes_of)
    return LedHole(
        index=index,
        band=led.band,
        light_mm=np.asarray(led.position_mm, dtype=np.float64),
        back=-led.axis,
        radius_mm=diameter / 2 + sizes.LED_CLEARANCE_MM,
        pocket_radius_mm=flange / 2 + sizes.LED_CLEARANCE_MM,
        shoulder_mm=shoulder,
        back_mm=shoulder + sizes.LED_POCKET_MM,
    )


SCREWS_A_DEG = (35.0, 145.0, 215.0, 335.0)
"""Azimuths of the screws between base and cylinder, and between frame and box: uneven, so that
parts fit one way."""
SCREWS_B_DEG = (0.0, 90.0, 180.0, 280.0)
"""Azimuths between cylinder and frame, and between box and lid: out of the way of a screwdriver for
the others."""
_COS_45 = math.sqrt(0.5)  # mirrors and films lean by 45 deg
# depth of the base's shallow pockets, which hold mirror holders and calibration disc in place
POCKET_MM = 1.0
_GROOVE_IN_FLOOR_MM = 0.4  # the groove's bottom lies this much below the base's upper face


@dataclass(frozen=True, slots=True, eq=False)
class RigDimensions:
    """What the parts are made from. Heights (`..._z_mm`) and places are in the rig's frame."""

    settings: SimpleNamespace
    camera_height_mm: float
    field_mm: tuple[float, float]  # width (x) and height (y) of the picture on the finger plane
    holes: tuple[LedHole, ...]
    # side lights, each in a lamp of its own that is pushed through the cylinder's wall
    sides: tuple[LedHole, ...]
    bore_mm: float  # inner radius of cylinder, frame and box
    floor_z_mm: float  # upper face of the base, the joint between base and cylinder
    frame_z_mm: float  # lower face of the frame, the joint between cylinder and frame
    box_z_mm: float
    lid_z_mm: float
    board_z_mm: float  # front of the camera's board
    stop_y_mm: float  # where the fingertip stops
    niche_y_mm: float  # outer face of the niche's end wall, with the opening for the finger
    opening_radius_mm: float
    nail_mm: float  # height of the nail's tip over the finger plane
    outer_mm: float  # outer radius of the tubes
    ring_mm: float  # outer radius of floors and of the tubes' ends
    screw_mm: float  # radius of the circle of screws
    outside_mm: float  # radius that everything fits into
    base_z_mm: float  # lowest face of the base
    top_z_mm: float  # upper face of the lid
    cylinder_mm: float  # height of the cylinder between its joints
    niche_inner_y_mm: float  # inner face of the niche's end wall
    groove_z_mm: float  # bottom of the finger's groove
    groove_width_mm: float  # width of the finger's groove at its rim
    groove_radius_mm: float  # radius of the groove's round bottom
    block_mm: float  # half the width of the block that holds the groove
    disc_radius_mm: float  # radius of the calibration disc: as large as the niche allows
    lens_hole_mm: float  # radius of the frame's opening for the lens
    # azimuths of the screws between base and cylinder: beside the lamps, if any
    base_screws_deg: tuple[float, ...]
    films: RigFilms | None

    @property
    def lit_corners(self) -> Array:
        """(9, 3) border and middle of what every LED must light: the last phalanx, as far as the
        picture shows it."""
        half = min(self.field_mm[0] / 2, self.disc_radius_mm)
        start = max(-self.field_mm[1] / 2, self.stop_y_mm - sizes.FINGER_PHALANX_MM)
        ends = (start, (start + self.stop_y_mm) / 2, self.field_mm[1] / 2)
        return np.array([(x, y, 0.0) for x in (-half, 0.0, half) for y in ends])


def dimensions_of(rig: Rig, settings: SimpleNamespace) -> RigDimensions:
    """Work out all dimensions, not yet checked: see :func:`hardware.checks.check_dimensions`.
    Raises BadInput if an LED has no place, or the picture is too small for a nail's shadows.
    """
    camera, finger = rig.camera, settings.finger
    rows, columns = camera.image_size
    field = (columns / camera.px_per_mm, rows / camera.px_per_mm)
    led_holes = [_led_hole(index, led, settings.led) for index, led in enumerate(rig.leds)]
    side = side_lights(rig.leds)
    holes = tuple(hole for hole in led_holes if hole.index not in side)
    require(len(holes) > 0, "the rig has no LEDs around the camera; parts cannot be drawn for it.")
    # the lowest LED's dome stands free below the frame, those of higher ones in funnels
    frame_z = min(
        float(hole.light_mm[2])
        + hole.radius_mm * math.sin(math.radians(hole.tilt_deg))
        + sizes.LED_TIP_FREE_MM
        for hole in holes
    )
    board_z = camera.height_mm + settings.camera.board_above_lens_mm
    plate_top = frame_z + sizes.JOINT_PLATE_MM
    highest = max(
        board_z, plate_top, *(float(hole.at(hole.back_mm)[2]) + hole.radius_mm for hole in holes)
    )
    # 45 deg, below a lug
    gusset = sizes.JOINT_RIDGE_MM + 2 * sizes.JOINT_LUG_RADIUS_MM + 0.1 - settings.joint.wall_mm
    lug_room = 2 * sizes.JOINT_LUG_MM + sizes.JOINT_INSERT_DEPTH_MM + gusset
    box_z = max(highest + sizes.WIRE_ROOM_MM, frame_z + lug_room)
    films = rig_films(rig)
    if films is not None and films.kind == "servo":
        box_z = max(box_z, plate_top + sizes.SERVO_HIGH_MM)
    second = sizes.SECOND_BOARD_MM if films is not None and films.kind == "neighbours" else 0.0
    boards = sizes.PI_POST_HEIGHT_MM + 1.5 + sizes.PCB_OVER_PI_MM + 1.6 + sizes.PCB_PARTS_MM
    lid_z = max(box_z + sizes.JOINT_PLATE_MM + boards + second, box_z + lug_room)
    stop_y = min(field[1] / 2 - finger.tip_margin_mm, sizes.FINGER_PHALANX_MM / 2)
    # about the thickest finger, an ellipse that lies on the floor
    angle = np.linspace(0.0, np.pi, 361)
    x = finger.widest_mm / 2 * np.cos(angle)
    z = sizes.FINGER_THICKEST_MM / 2 * (1 + np.sin(angle))
    wall = settings.joint.wall_mm
    bore = _bore(holes, settings, field)
    floor_z = _GROOVE_IN_FLOOR_MM - finger.pad_height_mm
    screw = bore + sizes.JOINT_RIDGE_MM + sizes.JOINT_LUG_RADIUS_MM + 0.1
    niche_y = stop_y - finger.reach_mm
    half, depth = (finger.widest_mm + sizes.FINGER_CLEARANCE_MM) / 2, finger.groove_depth_mm
    behind = max(0.0, camera.height_mm - frame_z)  # a lens behind the frame must see past its edge
    return RigDimensions(
        settings=settings,
        camera_height_mm=float(camera.height_mm),
        field_mm=field,
        holes=holes,
        sides=tuple(led_holes[k] for k in side),
        bore_mm=bore,
        floor_z_mm=floor_z,
        frame_z_mm=frame_z,
        box_z_mm=box_z,
        lid_z_mm=lid_z,
        board_z_mm=board_z,
        stop_y_mm=stop_y,
        niche_y_mm=niche_y,
        opening_radius_mm=float(np.hypot(x, z).max()) + sizes.FINGER_CLEARANCE_MM,
        nail_mm=_nail_height(rig, sizes.NAIL_OFFSET_MM, sizes.NAIL_MARGIN_MM, sizes.NAIL_RADIUS_MM),
        outer_mm=bore + wall,
        ring_mm=bore + wall + sizes.JOINT_RING_MM,
        screw_mm=screw,
        outside_mm=screw + sizes.JOINT_LUG_RADIUS_MM,
        base_z_mm=floor_z - sizes.JOINT_PLATE_MM,
        top_z_mm=lid_z + sizes.JOINT_PLATE_MM,
        cylinder_mm=frame_z - floor_z,
        niche_inner_y_mm=niche_y + wall,
        groove_z_mm=-finger.pad_height_mm,
        groove_width_mm=2 * half,
        groove_radius_mm=(half * half + depth * depth) / (2 * depth),
        block_mm=half + wall,
        disc_radius_mm=math.floor(-niche_y - wall - 1.0),
        lens_hole_mm=settings.camera.barrel_mm / 2
        + 0.4
        + behind * math.hypot(*field) / 2 / camera.height_mm,
        base_screws_deg=(35.0, 145.0, 222.0, 354.0) if side else SCREWS_A_DEG,
        films=films,
    )


def _bore(
    holes: tuple[LedHole, ...], settings: SimpleNamespace, field: tuple[float, float]
) -> float:
    """Return the inner radius, in steps of half a millimetre: LEDs, picture, and boards must
    fit."""
    board = settings.board
    wanted = [
        max(hole.radius_taken_mm for hole in holes) + 0.5,
        math.hypot(*field) / 2 + 3.0,
        math.hypot(sizes.PI_X_MM / 2 + sizes.PI_OVERHANG_MM, sizes.PI_Y_MM / 2) + 1.0,
        math.hypot(board.pcb_x_mm, board.pcb_y_mm) / 2 + 0.8,
    ]
    return math.ceil(2 * max(wanted)) / 2


_LIP_WALL_MM = 1.2


def _mirror_front() -> tuple[float, float]:
    """Return the lower front edge of a mirror: distance from its holder's front, height over the
    holder's foot, mm."""
    slack = sizes.JOINT_CLEARANCE_MM
    return (slack + _LIP_WALL_MM) * _COS_45 + 0.2, (
        sizes.MIRROR_THICK_MM + slack
    ) * _COS_45 + _LIP_WALL_MM


def mirror_profile(settings: SimpleNamespace) -> list[tuple[float, float]]:
    """Outline of a mirror holder: distance from its front, height over its foot, mm. The reflecting
    face starts at :func:`_mirror_front` and leans by 45 deg away from the finger; a lip holds its
    lower edge.
    """
    slack = sizes.JOINT_CLEARANCE_MM
    front = np.array(_mirror_front())
    along = np.array([_COS_45, _COS_45])
    behind = np.array([_COS_45, -_COS_45])
    low = front + (sizes.MIRROR_THICK_MM + slack) * behind
    high = low + settings.mirror.wide_mm * along
    lip = sizes.MIRROR_LIP_MM * along
    inside = front - slack * behind
    outside = front - (slack + _LIP_WALL_MM) * behind
    # where the lip's outer face, at 45 deg, meets the holder's front
    start = outside[1] - outside[0]
    corners = [high, low, inside, inside + lip, outside + lip]
    back = float(high[0]) + settings.joint.wall_mm
    outline = [
        (0.0, 0.0),
        (back, 0.0),
        (back, float(high[1])),
        *((float(u), float(v)) for u, v in corners),
    ]
    return [*outline, (0.0, float(start))]


def holder_depth(settings: SimpleNamespace) -> float:
    """Return the depth of a mirror holder, away from the finger, mm."""
    return mirror_profile(settings)[1][0]


def holder_places(dimensions: RigDimensions) -> list[tuple[float, float, float]]:
    """Return for the right, left and tip holder: x, y of the middle of its front edge, and its turn
    in degrees."""
    d = dimensions
    side = d.block_mm + sizes.MIRROR_GAP_MM
    middle = d.stop_y_mm + 1.0 - sizes.MIRROR_LONG_MM / 2
    tip = d.stop_y_mm + d.settings.joint.wall_mm + sizes.MIRROR_GAP_MM
    return [(side, middle, 0.0), (-side, middle, 180.0), (0.0, tip, 90.0)]


# The lamp of a side light, along the LED's axis: a turned body with a collar that fits the
# cylinder's outer wall.


@dataclass(frozen=True, slots=True)
class SideLamp:
    """Distances in mm along the LED's axis from the light towards the finger, and radii. All side
    lamps are alike."""

    wall_mm: float  # to the cylinder's outer face
    mouth_mm: float  # to the lamp's end, just inside the cylinder
    # of the opening there, which lights the last phalanx as far as the picture shows it, and its
    # flanks
    mouth_radius_mm: float
    film_mm: float  # side of the square piece of film
    body_mm: float  # radius around LED and film
    plug_mm: float  # radius in the cylinder's wall
    collar_mm: float  # radius of the collar that meets the cylinder


SIDE_FILM_AT_MM = 4.0  # from a side light to its film: in front of the dome


def side_lamp(d: RigDimensions) -> SideLamp:
    """Work out the lamp of the side lights; BadInput if they are not alike or stand inside the
    cylinder."""
    lights, back = (
        np.array([getattr(hole, name) for hole in d.sides]) for name in ("light_mm", "back")
    )
    beside = np.hypot(lights[:, 0], lights[:, 1])
    hole = d.sides[0]
    apart = float(np.ptp([beside, lights[:, 2], 90.0 * back[:, 2]], axis=1).max())
    require(
        apart <= 1.0,
        "the side lights' lamps are alike, so all must stand equally high and far from the axis,"
        f" and be aimed alike; in the rig file they differ by {apart:.1f} mm.",
    )
    level = float(np.hypot(*hole.back[:2]))
    least = 14.0
    wall, mouth = (float(beside[0] - radius) / level for radius in (d.outer_mm, d.bore_mm - 1.0))
    require(
        wall >= least,
        f"the side lights stand {beside[0]:.1f} mm from the axis, but outside the tube of"
        f" {d.outer_mm:.1f} mm they need {d.outer_mm + least * level:.1f} mm.",
    )
    half, deep = d.settings.finger.widest_mm / 2, d.settings.finger.pad_height_mm / 2
    pad = np.clip(d.lit_corners, (-half, -np.inf, 0.0), (half, np.inf, 0.0))
    ways = np.concatenate([pad, pad - (0.0, 0.0, deep)]) - lights[:, None]  # (LEDs, points, 3)
    along = np.einsum("kpc,kc->kp", ways, -back)
    off = np.linalg.norm(ways + along[..., None] * back[:, None], axis=-1)
    radius = mouth * float((off / along).max()) + 0.8 * hole.radius_mm
    film = 2 * (hole.radius_mm + (radius - hole.radius_mm) * SIDE_FILM_AT_MM / mouth) + 1.2
    body, plug = film * _COS_45 + 2 * sizes.MIN_WALL_MM, radius + sizes.MIN_WALL_MM
    return SideLamp(wall, mouth, radius, film, body, plug, max(plug + 2.5, body))
