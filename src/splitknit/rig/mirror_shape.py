"""The mirror holders: where the mirrors lie, and what they show."""

from __future__ import annotations

import math

import numpy as np

from splitknit.rig.dimensions import RigDimensions
from splitknit.rig.part_settings import PartSettings

_HALF = math.sqrt(0.5)
_LIP_WALL_MM = 1.2


def mirror_front(settings: PartSettings) -> tuple[float, float]:
    """Return the lower front edge of a mirror: distance from its holder's front, height over the holder's foot, mm."""
    slack = settings.joint.clearance_mm
    return (slack + _LIP_WALL_MM) * _HALF + 0.2, (settings.mirror.thick_mm + slack) * _HALF + _LIP_WALL_MM


def mirror_profile(settings: PartSettings) -> list[tuple[float, float]]:
    """Return the outline of a mirror holder: distance from its front, height over its foot, mm.

    The mirror's reflecting face starts at :func:`mirror_front` and leans by 45 deg away from the finger; a lip holds
    its lower edge.
    """
    mirror, slack, wall = settings.mirror, settings.joint.clearance_mm, settings.joint.wall_mm
    front = np.array(mirror_front(settings))
    along, behind = np.array([_HALF, _HALF]), np.array([_HALF, -_HALF])
    low = front + (mirror.thick_mm + slack) * behind
    high = low + mirror.wide_mm * along
    lip_inside, lip_outside = front - slack * behind, front - (slack + _LIP_WALL_MM) * behind
    start = lip_outside[1] - lip_outside[0]  # where the lip's outer face, at 45 deg, meets the holder's front
    corners = [high, low, lip_inside, lip_inside + mirror.lip_mm * along, lip_outside + mirror.lip_mm * along]
    back = float(high[0]) + wall
    outline = [(0.0, 0.0), (back, 0.0), (back, float(high[1])), *((float(u), float(v)) for u, v in corners)]
    return [*outline, (0.0, float(start))]


def holder_depth(settings: PartSettings) -> float:
    """Return the depth of a mirror holder, away from the finger, mm."""
    return mirror_profile(settings)[1][0]


def holder_places(dimensions: RigDimensions) -> list[tuple[float, float, float]]:
    """Return for the right, left and tip holder: x, y of the middle of its front edge, and its turn in degrees."""
    d = dimensions
    side = d.block_mm + d.settings.mirror.gap_mm
    middle = d.stop_y_mm + 1.0 - d.settings.mirror.long_mm / 2
    tip = d.stop_y_mm + d.settings.joint.wall_mm + d.settings.mirror.gap_mm
    return [(side, middle, 0.0), (-side, middle, 180.0), (0.0, tip, 90.0)]


def mirror_view(dimensions: RigDimensions) -> dict[str, dict[str, float]]:
    """Return what the mirrors show: heights of the finger over the plane (mm), and the share of it in the picture.

    A mirror at 45 deg shows a height of the finger at its own place of that height: the picture must reach there.
    """
    d, mirror = dimensions, dimensions.settings.mirror
    (front, foot), (side, _, _), (_, tip, _) = mirror_front(d.settings), holder_places(d)[0], holder_places(d)[2]
    floor, length = d.floor_z_mm - d.pocket_mm + foot, mirror.wide_mm * _HALF
    view = {}
    for name, start, border in (("side", side + front, d.field_mm[0] / 2), ("tip", tip + front, d.field_mm[1] / 2)):
        first = start + mirror.lip_mm * _HALF
        view[name] = {
            "lowest_mm": floor + mirror.lip_mm * _HALF,
            "highest_mm": floor + length,
            "from_axis_mm": first,
            "to_axis_mm": start + length,
            "share_in_picture": min(1.0, max(0.0, (border - first) / (start + length - first))),
        }
    return view
