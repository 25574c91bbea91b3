"""Building blocks of the parts: prisms, turned profiles, joints. Needs build123d; imported where parts are made."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from build123d import Axis, Face, Plane, Pos, Rot, Solid, Vector, Wire
from numpy.typing import NDArray

from splitknit.rig.dimensions import RigDimensions
from splitknit.rig.part_settings import (
    JOINT_CLEARANCE_MM,
    JOINT_FOOT_MM,
    JOINT_INSERT_DEPTH_MM,
    JOINT_INSERT_HOLE_MM,
    JOINT_LUG_MM,
    JOINT_LUG_RADIUS_MM,
    JOINT_RIDGE_MM,
    JOINT_RING_MM,
    JOINT_SCREW_HOLE_MM,
)

Shape = Any
"""A solid of build123d."""
Points = Sequence[tuple[float, float]]
Point = Sequence[float] | NDArray[np.float64]


def cylinder(radius: float, low: float, high: float, x: float = 0.0, y: float = 0.0) -> Shape:
    """Return an upright cylinder between two heights."""
    return Pos(x, y, low) * Solid.make_cylinder(radius, high - low)


def rod(radius: float, start: Point, end: Point, start_radius: float | None = None) -> Shape:
    """Return a cylinder between two points, or a cone if it starts with another radius."""
    first, last = (Vector(*(float(value) for value in point)) for point in (start, end))
    way = last - first
    plane = Plane(origin=first, z_dir=way)
    if start_radius is not None:
        return Solid.make_cone(start_radius, radius, way.length, plane)
    return Solid.make_cylinder(radius, way.length, plane)


def cone(low_radius: float, high_radius: float, low: float, high: float) -> Shape:
    """Return an upright truncated cone about the z axis."""
    return Pos(0, 0, low) * Solid.make_cone(low_radius, high_radius, high - low)


def box(x: tuple[float, float], y: tuple[float, float], z: tuple[float, float]) -> Shape:
    """Return a box between its bounds."""
    return Pos(x[0], y[0], z[0]) * Solid.make_box(x[1] - x[0], y[1] - y[0], z[1] - z[0])


def prism_y(outline: Points, start: float, end: float) -> Shape:
    """Return the outline (x, z) extruded along y."""
    return _extruded([(x, start, z) for x, z in outline], (0.0, end - start, 0.0))


def prism_x(outline: Points, start: float, end: float) -> Shape:
    """Return the outline (y, z) extruded along x."""
    return _extruded([(start, y, z) for y, z in outline], (end - start, 0.0, 0.0))


def turned(outline: Points) -> Shape:
    """Return the outline (radius, z) turned about the z axis."""
    return Solid.revolve(_face([(r, 0.0, z) for r, z in outline]), 360.0, Axis.Z)


def turned_to(azimuth_deg: float, shape: Shape) -> Shape:
    """Turn a shape about the z axis."""
    return Rot(0, 0, azimuth_deg) * shape


def fused(first: Shape, others: Iterable[Shape]) -> Shape:
    """Return one solid of many."""
    return one(first.fuse(*others))


def cut(first: Shape, others: Iterable[Shape]) -> Shape:
    """Return the first without the others."""
    return one(first.cut(*others))


def common(first: Shape, second: Shape) -> Shape:
    """Return what two shapes share."""
    return one(first.intersect(second))


def one(shape: Shape) -> Shape:
    """Return the only solid of a result of fusing or cutting.

    Raises
    ------
    RuntimeError
        If there is not exactly one: a dimension that the checks let through tears a part.
    """
    solids = shape.solids()
    if len(solids) != 1:
        raise RuntimeError(f"a part fell into {len(solids)} pieces")
    return solids[0]


def _face(points: Sequence[tuple[float, float, float]]) -> Shape:
    return Face(Wire.make_polygon([Vector(*point) for point in points], close=True))


def _extruded(points: Sequence[tuple[float, float, float]], way: tuple[float, float, float]) -> Shape:
    return Solid.extrude(_face(points), Vector(*way))


def ridge(dimensions: RigDimensions, z: float) -> Shape:
    """Return the ridge on a part's upper face: a ring whose outer flank leans inwards by 45 deg."""
    joint, bore = dimensions.settings.joint, dimensions.bore_mm
    top = z + joint.ridge_height_mm
    outside = bore + JOINT_RIDGE_MM
    return turned(
        [(bore, z - 0.2), (outside, z - 0.2), (outside, z), (outside - joint.ridge_height_mm, top), (bore, top)]
    )


def _groove_depth(dimensions: RigDimensions) -> float:
    """Return the width, and for its 45 deg flank the depth, of the groove that takes a ridge."""
    return JOINT_RIDGE_MM + JOINT_CLEARANCE_MM


def groove(dimensions: RigDimensions, z: float) -> Shape:
    """Return what to cut from the lower face of a floor: a groove for the ridge below, without a flat roof."""
    bore, depth = dimensions.bore_mm, _groove_depth(dimensions)
    inside = bore - 0.3
    outside = bore + depth
    below = 0.5
    return turned([(inside, z - below), (outside, z - below), (outside, z), (inside, z + outside - inside)])


def tube(dimensions: RigDimensions, low: float, high: float, floor_mm: float = 0.0) -> Shape:
    """Return a tube with thickened ends, a groove at its lower and a ridge at its upper end.

    `floor_mm` closes it at the bottom by a floor of that thickness.
    """
    joint, bore = dimensions.settings.joint, dimensions.bore_mm
    outer, ring, top = dimensions.outer_mm, dimensions.ring_mm, high + joint.ridge_height_mm
    foot = max(JOINT_LUG_MM, floor_mm)
    outside = [(ring, low), (ring, low + foot), (outer, low + foot)]
    outside += [(outer, high - 2 * JOINT_RING_MM), (ring, high - JOINT_RING_MM), (ring, high)]
    outside += [(bore + JOINT_RIDGE_MM, high), (bore + JOINT_RIDGE_MM - joint.ridge_height_mm, top), (bore, top)]
    if floor_mm > 0:
        body = turned([(0.0, low), *outside, (bore, low + floor_mm), (0.0, low + floor_mm)])
        return cut(body, [groove(dimensions, low)])
    depth = _groove_depth(dimensions)
    return turned([(bore + depth, low), *outside, (bore, low + depth)])


def head_lugs(dimensions: RigDimensions, z: float, thickness: float, azimuths_deg: Sequence[float]) -> list[Shape]:
    """Return lugs under the heads of screws, at a part's lower face."""
    start = dimensions.bore_mm + _groove_depth(dimensions) + 0.3
    return [turned_to(angle, _lug_outline(dimensions, start, z, z + thickness)) for angle in azimuths_deg]


def head_holes(dimensions: RigDimensions, z: float, azimuths_deg: Sequence[float]) -> list[Shape]:
    """Return the clearance holes of these lugs."""
    joint = dimensions.settings.joint
    hole = cylinder(JOINT_SCREW_HOLE_MM / 2, z - 1.0, z + joint.plate_mm + JOINT_LUG_MM, x=dimensions.screw_mm)
    return [turned_to(angle, hole) for angle in azimuths_deg]


def insert_lugs(dimensions: RigDimensions, z: float, azimuths_deg: Sequence[float]) -> list[Shape]:
    """Return lugs for heat-set inserts below a part's upper face, each with a 45 deg support."""
    start, end = dimensions.outer_mm - 0.3, dimensions.outside_mm
    deep = JOINT_INSERT_DEPTH_MM + 1.0
    profile = [(start, z), (end, z), (end, z - deep), (start, z - deep - (end - start))]
    gusset = prism_y(profile, -JOINT_LUG_RADIUS_MM, JOINT_LUG_RADIUS_MM)
    plan = _lug_outline(dimensions, start, z - deep - (end - start) - 1.0, z)
    return [turned_to(angle, common(gusset, plan)) for angle in azimuths_deg]


def insert_holes(dimensions: RigDimensions, z: float, deep: float, azimuths_deg: Sequence[float]) -> list[Shape]:
    """Return the holes for heat-set inserts, from a part's upper face down."""
    hole = cylinder(JOINT_INSERT_HOLE_MM / 2, z - deep, z + 1.0, x=dimensions.screw_mm)
    return [turned_to(angle, hole) for angle in azimuths_deg]


def feet(dimensions: RigDimensions, z: float, into: float, azimuths_deg: Sequence[float]) -> list[Shape]:
    """Return pockets for stick-on feet, 0.8 mm deep; `into` is +1 for a lower face and -1 for an upper one."""
    radius = JOINT_FOOT_MM / 2
    low, high = sorted((z - into * 0.5, z + into * 0.8))
    pocket = cylinder(radius, low, high, x=dimensions.bore_mm - 2 * radius)
    return [turned_to(angle, pocket) for angle in azimuths_deg]


def _lug_outline(dimensions: RigDimensions, start: float, low: float, high: float) -> Shape:
    radius, centre = JOINT_LUG_RADIUS_MM, dimensions.screw_mm
    plate = box((start, centre), (-radius, radius), (low, high))
    return one(plate.fuse(cylinder(radius, low, high, x=centre)))
