"""The parts at the finger's end: base with groove, window base for the camera below, mirror holder."""

from __future__ import annotations

import math

from splitknit.rig.dimensions import SCREWS_A_DEG, RigDimensions
from splitknit.rig.mirror_shape import holder_depth, holder_places, mirror_profile
from splitknit.rig.solids import (
    Shape,
    box,
    cut,
    feet,
    fused,
    head_lugs,
    insert_holes,
    prism_x,
    prism_y,
    ridge,
    rod,
    turned,
)

_FEET_DEG = (45.0, 135.0, 225.0, 315.0)
_FAR_MM = 500.0


def base_part(dimensions: RigDimensions) -> Shape:
    """Return the base: the finger lies on its back in a round groove and stops at a low wall.

    Shallow pockets take the mirror holders, a ring-shaped one the calibration disc.
    """
    d, joint, finger = dimensions, dimensions.settings.joint, dimensions.settings.finger
    wall = joint.wall_mm
    floor, rim = d.floor_z_mm, d.groove_z_mm + finger.groove_depth_mm
    plate = _plate(d)
    plate = cut(plate, [*_mirror_pockets(d), _disc_pocket(d), *feet(d, d.base_z_mm, 1.0, _FEET_DEG)])
    block = box((-d.block_mm, d.block_mm), (d.niche_y_mm - 2.0, d.stop_y_mm + wall), (floor - d.pocket_mm, rim))
    stop = box(
        (-d.groove_width_mm / 2, d.groove_width_mm / 2),
        (d.stop_y_mm - 1.0, d.stop_y_mm + wall),
        (floor - d.pocket_mm, d.groove_z_mm + finger.stop_height_mm),
    )
    middle = d.groove_z_mm + d.groove_radius_mm
    trough = rod(d.groove_radius_mm, (0.0, -_FAR_MM, middle), (0.0, d.stop_y_mm, middle))
    above = box((-d.groove_width_mm / 2, d.groove_width_mm / 2), (-_FAR_MM, d.stop_y_mm), (rim, rim + _FAR_MM))
    return cut(fused(plate, [block, stop]), [trough, above])


def window_base_part(dimensions: RigDimensions) -> Shape:
    """Return the base for the camera below: the finger lies pad down over an open window.

    The middle phalanx rests in a 45 deg groove that fills the cylinder's opening, the fingertip on a 45 deg ledge; the
    pad between them touches nothing and comes to the finger plane.
    """
    d, joint, finger = dimensions, dimensions.settings.joint, dimensions.settings.finger
    wall, half = joint.wall_mm, dimensions.groove_width_mm / 2
    low, floor = d.base_z_mm, d.floor_z_mm
    start = -d.field_mm[1] / 2 - 2.0  # the window begins outside the picture
    radius = d.opening_radius_mm - joint.clearance_mm
    plug = rod(radius, (0.0, d.niche_y_mm - 2.0, floor), (0.0, start, floor))
    plug = cut(plug, [box((-_FAR_MM, _FAR_MM), (-_FAR_MM, _FAR_MM), (-_FAR_MM, floor - 0.2))])
    rails = box((-half - wall, half + wall), (start - 1.0, d.stop_y_mm + wall), (floor - 0.2, -1.0))
    body = fused(_plate(d), [plug, rails])
    radius = finger.pad_height_mm / 2  # of the finger that touches the finger plane
    apex = radius * (math.sqrt(2.0) - 1.0)
    groove = [(-half, low - 1.0), (half, low - 1.0), (half, apex - half), (0.0, apex), (-half, apex - half)]
    cavity = prism_y(groove, -_FAR_MM, start + 0.1)
    window = box((-half, half), (start, d.stop_y_mm), (low - 1.0, _FAR_MM))
    ledge = _ledge(d)
    return fused(cut(body, [cavity, window, _free_light(d, start, apex + wall)]), [ledge])


def _free_light(dimensions: RigDimensions, start: float, height: float) -> Shape:
    """Cut the plug down from the opening towards the window, so that it throws no shadow on the pad."""
    d, far = dimensions, dimensions.bore_mm
    top, near = d.floor_z_mm + d.opening_radius_mm + 1.0, d.niche_inner_y_mm + 0.5
    end = min(start, near + top - height)
    slope = [(near, top), (end, top - (end - near)), (start + 1.0, top - (end - near)), (start + 1.0, top)]
    return prism_x(slope, -far, far)


def _ledge(dimensions: RigDimensions) -> Shape:
    """A wedge at the window's end, where the fingertip rests and stops; it hides the last 2 mm of the tip."""
    d, half, wall = dimensions, dimensions.groove_width_mm / 2, dimensions.settings.joint.wall_mm
    deep, end = 2.0, d.stop_y_mm
    rest = -d.settings.finger.pad_height_mm / 2 * (2.0 - math.sqrt(2.0))  # a round tip touches wall and wedge
    outline = [(end + wall / 2, rest), (end, rest), (end - deep, rest + deep), (end + wall / 2, rest + deep)]
    return prism_x(outline, -half - wall / 2, half + wall / 2)


def _plate(dimensions: RigDimensions) -> Shape:
    """Floor with ridge and lugs for inserts; no ridge where the hand's niche is."""
    d, joint = dimensions, dimensions.settings.joint
    low, high = d.base_z_mm, d.floor_z_mm
    disc = turned([(0.0, low), (d.ring_mm, low), (d.ring_mm, high), (0.0, high)])
    half = d.settings.finger.hand_width_mm / 2 + joint.wall_mm + 1.0
    hand = box((-half, half), (-_FAR_MM, 0.0), (high - 0.2, high + _FAR_MM))
    ring = ridge(d, high).cut(hand)
    body = fused(disc, [*ring.solids(), *head_lugs(d, low, high - low, SCREWS_A_DEG)])
    return cut(body, insert_holes(d, high, high - low + 1.0, SCREWS_A_DEG))


def _disc_pocket(dimensions: RigDimensions) -> Shape:
    d, slack = dimensions, dimensions.settings.joint.clearance_mm
    inside, outside = d.disc_radius_mm - d.settings.joint.wall_mm - slack, d.disc_radius_mm + slack
    low, high = d.floor_z_mm - d.pocket_mm, d.floor_z_mm + 1.0
    return turned([(inside, low), (outside, low), (outside, high), (inside, high)])


def _mirror_pockets(dimensions: RigDimensions) -> list[Shape]:
    d, slack = dimensions, dimensions.settings.joint.clearance_mm
    half, z = d.settings.mirror.long_mm / 2 + slack, (d.floor_z_mm - d.pocket_mm, d.floor_z_mm + 1.0)
    near, far = -slack, holder_depth(d.settings) + slack
    (right, middle, _), _, (_, tip, _) = holder_places(d)
    y = (middle - half, middle + half)
    return [
        box((right + near, right + far), y, z),
        box((-right - far, -right - near), y, z),
        box((-half, half), (tip + near, tip + far), z),
    ]


def mirror_holder_part(dimensions: RigDimensions) -> Shape:
    """Return the holder of one mirror, in the place of the right one; left and tip are the same, turned."""
    d = dimensions
    x, y, _ = holder_places(d)[0]
    foot, half = d.floor_z_mm - d.pocket_mm, d.settings.mirror.long_mm / 2
    outline = [(x + u, foot + v) for u, v in mirror_profile(d.settings)]
    return prism_y(outline, y - half, y + half)
