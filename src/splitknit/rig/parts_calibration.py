"""What stands in the finger's place to calibrate the rig: disc with dots at every centimetre, and nail."""

from __future__ import annotations

import math

from splitknit.rig.dimensions import RigDimensions
from splitknit.rig.solids import Shape, box, cone, cut, cylinder, fused, turned

_BORDER_MM = 2.0
_PEG_SLACK_MM = 0.1


def disc_dots(dimensions: RigDimensions) -> list[tuple[float, float]]:
    """Return x and y of the disc's dots: multiples of the spacing, one of them in the middle."""
    step = dimensions.settings.calibration.dot_spacing_mm
    wall = dimensions.settings.joint.wall_mm
    reach = dimensions.disc_radius_mm - wall - dimensions.settings.calibration.dot_mm / 2 - _BORDER_MM
    count = int(reach // step)
    steps = range(-count, count + 1)
    return [(i * step, j * step) for i in steps for j in steps if math.hypot(i, j) * step <= reach]


def disc_part(dimensions: RigDimensions) -> Shape:
    """Return the disc with recessed dots; its face is the finger plane, its skirt stands in the base's ring pocket."""
    depth = dimensions.settings.calibration.dot_depth_mm
    return cut(_cup(dimensions), _dots(dimensions, depth, dimensions.settings.calibration.dot_mm / 2))


def flat_disc_part(dimensions: RigDimensions) -> Shape:
    """Return the disc whose dots are the pegs of another part, flush with its face."""
    calibration = dimensions.settings.calibration
    return cut(_cup(dimensions), _dots(dimensions, calibration.disc_mm + 1.0, calibration.dot_mm / 2))


def dots_part(dimensions: RigDimensions) -> Shape:
    """Return a sheet with pegs that are pushed into the flat disc from behind."""
    d, calibration = dimensions, dimensions.settings.calibration
    low, high = -calibration.disc_mm - d.settings.printer.least_wall_mm, -calibration.disc_mm
    radius = d.disc_radius_mm - d.settings.joint.wall_mm - d.settings.joint.clearance_mm
    peg = calibration.dot_mm / 2 - _PEG_SLACK_MM
    return fused(cylinder(radius, low, high), [cylinder(peg, high - 0.3, 0.0, x, y) for x, y in disc_dots(d)])


def _dots(dimensions: RigDimensions, depth: float, radius: float) -> list[Shape]:
    return [cylinder(radius, -depth, 1.0, x, y) for x, y in disc_dots(dimensions)]


def _cup(dimensions: RigDimensions) -> Shape:
    """Disc and skirt; a notch lets the groove's block through."""
    d, wall = dimensions, dimensions.settings.joint.wall_mm
    outside, thick = d.disc_radius_mm, d.settings.calibration.disc_mm
    foot = d.floor_z_mm - d.pocket_mm
    inside = outside - wall
    body = turned([(0.0, 0.0), (outside, 0.0), (outside, foot), (inside, foot), (inside, -thick), (0.0, -thick)])
    half = d.block_mm + 2 * d.settings.joint.clearance_mm
    rim = d.groove_z_mm + d.settings.finger.groove_depth_mm
    return cut(body, [box((-half, half), (-outside - 1.0, -5.0), (foot - 1.0, rim + 0.5))])


def nail_part(dimensions: RigDimensions) -> Shape:
    """Return the nail: a cone on the finger plane, as sharp as the nozzle allows."""
    tip = dimensions.settings.printer.nozzle_mm / 2
    return cone(dimensions.settings.calibration.nail_radius_mm, tip, 0.0, dimensions.nail_mm)
