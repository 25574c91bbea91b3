"""Reports on the parts: dimensions, size, mass, and whether each prints; nothing beyond the limits goes unreported."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from splitknit import Array, BoolArray, Rig
from splitknit_rig.rig import part_settings as sizes
from splitknit_rig.rig.assembly import PartKind, Triangles
from splitknit_rig.rig.dimensions import LedHole, RigDimensions, mirror_reach, shadow_tips, side_lamp
from splitknit_rig.rig.films import FilmMounts, film_mounts, side_film_deg
from splitknit_rig.rig.part_settings import PrinterSettings


def dimension_table(rig: Rig, dimensions: RigDimensions) -> dict[str, Any]:
    """Return the dimensions of the rig and of its parts, mm and degrees."""
    d = dimensions
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
            "may_stand_off_middle_mm": sizes.NAIL_OFFSET_MM,
            "shadow_lengths_mm": [round(float(math.hypot(x, y)), 2) for x, y in shadows],
        },
        "calibration_disc_diameter_mm": 2 * d.disc_radius_mm,
        "mirrors": {
            "size_mm": [sizes.MIRROR_LONG_MM, d.settings.mirror.wide_mm, sizes.MIRROR_THICK_MM],
            **{name: {k: round(v, 2) for k, v in view.items()} for name, view in mirror_reach(d).items()},
        },
        "leds": [_led(hole) for hole in d.holes],
        "hardware": {
            "screws_m3x8": 16,
            "heat_set_inserts_m3x4": 16,
            "screws_m2x8": 4,
            "screws_m25x8": 4,
            "screws_m3x10_self_tapping": 4,
            "leds_white": sum(hole.band == "white" for hole in (*d.holes, *d.sides)),
            "leds_nir": sum(hole.band != "white" for hole in (*d.holes, *d.sides)),
            "insert_hole_mm": sizes.JOINT_INSERT_HOLE_MM,
        },
        **({} if d.films is None else {"films": _films(film_mounts(d))}),
        **({"side_lights": _sides(d)} if d.sides else {}),
    }


def _sides(d: RigDimensions) -> dict[str, Any]:
    lamp = side_lamp(d)
    return {
        "lamps": len(d.sides),
        "hole_in_cylinder_mm": round(2 * (lamp.plug_mm + sizes.JOINT_CLEARANCE_MM), 2),
        "piece_mm": round(lamp.film_mm - 2 * sizes.JOINT_CLEARANCE_MM, 1),
        "leds": [{**_led(hole), "film_axis_deg": round(side_film_deg(hole.light_mm.tolist()), 1)} for hole in d.sides],
    }


def _films(mounts: FilmMounts) -> dict[str, Any]:
    return {
        "kind": mounts.kind,
        "piece_mm": round(mounts.piece_mm - 2 * sizes.JOINT_CLEARANCE_MM, 1),
        "analyser_piece_mm": round(mounts.analyser_piece_mm - 2 * sizes.JOINT_CLEARANCE_MM, 1),
        "axes_of_leds": [axis or None for _, _, axis in mounts.windows],
        "screws_m3x10_self_tapping": len(mounts.ring_posts) + len(mounts.plate_posts),
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


_FACETS_MM = 0.1  # how much thinner facets make a round wall


def report_part(kind: PartKind, triangles: Triangles, printer: PrinterSettings) -> dict[str, Any]:
    """Check one part, `triangles` (N, 3, 3) in mm as in the STL file, as it lies on the bed; return its row of
    ``parts.json``, with ``findings``: sentences. Raises RuntimeError if the mesh is not watertight: an internal error.
    """
    edges, faults, volume_mm3 = _check_soundness(triangles)
    if faults or volume_mm3 <= 0:
        raise RuntimeError(f"the mesh of part '{kind.name}' is not closed: {faults} open or turned edges")
    thickness, place, samples = _thinnest_wall(triangles)
    steep_mm2, fraction, bridge_mm, bridge_z_mm = _overhang(triangles)
    points = triangles.reshape(-1, 3).astype(np.float64)
    size = points.max(axis=0) - points.min(axis=0)
    fits = bool((size <= (printer.bed_x_mm, printer.bed_y_mm, printer.bed_z_mm)).all())
    thick = thickness >= sizes.MIN_WALL_MM - _FACETS_MM
    bridged = bridge_mm <= sizes.BRIDGE_MM
    volume = volume_mm3 / 1000.0
    findings = [kind.remedy] if kind.remedy else []
    if not fits:
        findings.append(f"It is {size[0]:.0f} x {size[1]:.0f} x {size[2]:.0f} mm, larger than the printer's bed.")
    if not thick:
        x, y, z = place
        findings.append(
            f"Its thinnest place measures {thickness:.2f} mm, less than {sizes.MIN_WALL_MM:g} mm, at "
            f"x {x:.0f}, y {y:.0f}, z {z:.0f} mm on the bed."
        )
    if not bridged:
        findings.append(
            f"A ceiling {bridge_z_mm:.1f} mm above the bed spans {bridge_mm:.1f} mm of air, more than "
            f"{sizes.BRIDGE_MM:g} mm: print it with support there."
        )
    elif bridge_mm > 0:
        findings.append(
            f"{steep_mm2:.0f} mm² ({100 * fraction:.1f} % of its surface) lean further than {sizes.MAX_OVERHANG_DEG:g} "
            f"deg; the longest bridge is {bridge_mm:.1f} mm, {bridge_z_mm:.1f} mm above the bed: no support."
        )
    return {
        "title": kind.title,
        "quantity": kind.quantity,
        "needed": kind.needed,
        "print": {"face_on_bed": "upper" if kind.face_down else "lower", "colour": kind.colour},
        "size_mm": [round(float(value), 2) for value in size],
        "volume_cm3": round(volume, 3),
        "mass_g": round(volume * sizes.DENSITY_G_PER_CM3, 1),
        "checks": {
            "watertight": {"ok": True, "triangles": len(triangles), "edges": edges},
            "wall": {
                "ok": bool(thick),
                "smallest_mm": round(thickness, 2),
                "at_mm": [round(float(value), 1) for value in place],
                "least_mm": sizes.MIN_WALL_MM,
                "places": samples,
            },
            "bed": {"ok": fits, "bed_mm": [printer.bed_x_mm, printer.bed_y_mm, printer.bed_z_mm]},
            "overhang": {
                "ok": bridged,
                "limit_deg": sizes.MAX_OVERHANG_DEG,
                "steep_mm2": round(steep_mm2, 1),
                "share": round(fraction, 5),
                "bridge_mm": round(bridge_mm, 1),
                "bridge_z_mm": round(bridge_z_mm, 1),
                "bridge_limit_mm": sizes.BRIDGE_MM,
            },
        },
        "findings": findings,
    }


# What hangs in the air while a part is printed: steep faces, and what each layer has to bridge.

_PITCH_MM = 0.25  # spacing of the grid on which layers are drawn


def _overhang(triangles: Triangles, limit_deg: float = sizes.MAX_OVERHANG_DEG) -> tuple[float, float, float, float]:
    """Area (mm^2) of faces of a closed mesh (N, 3, 3; mm, as printed, on the bed) that look down and lean further than
    the limit from the vertical, but the lowest; its fraction of the surface; the longest way over air in a layer (mm);
    and that layer's height (mm). Layers are drawn on a grid where there are steep faces; the way over air is twice the
    distance to what lies below, also where one side alone holds it, which is on the safe side. One degree of lean is
    forgiven, for facets.
    """
    corners = np.asarray(triangles, dtype=np.float64)
    normals, areas = _normals_and_areas(corners)
    down = -normals[:, 2]
    bed = float(corners[..., 2].min())
    on_bed = corners[..., 2].max(axis=1) < bed + 0.01
    steep = (down > np.sin(np.deg2rad(limit_deg + 1.0))) & ~on_bed
    area = float(areas[steep].sum())
    best, height = 0.0, 0.0
    for layer in _layers_over(corners[steep][..., 2] - bed):
        width = _bridge(corners, bed + (layer + 0.5) * sizes.LAYER_MM)
        if width > best:
            best, height = width, layer * sizes.LAYER_MM
    return area, area / float(areas.sum()), best, height


def _normals_and_areas(corners: Array) -> tuple[Array, Array]:
    """Unit normals (N, 3) of triangles, zero where one has no area, and their areas (N,)."""
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(across, axis=1)
    normals = np.divide(across, lengths[:, None], out=np.zeros_like(across), where=lengths[:, None] > 0)
    return np.asarray(normals), np.asarray(lengths / 2)


def _layers_over(heights: Array) -> list[int]:
    """Numbers of the layers that lie on steep faces, whose corners have these heights (N, 3) over the bed."""
    layers: set[int] = set()
    for low, high in zip(heights.min(axis=1), heights.max(axis=1), strict=True):
        layers.update(range(int(low // sizes.LAYER_MM), int(high // sizes.LAYER_MM) + 2))
    return sorted(layer for layer in layers if layer > 0)


def _bridge(corners: Array, z: float) -> float:
    plan = corners[..., :2].reshape(-1, 2)
    low, high = plan.min(axis=0) - 2 * _PITCH_MM, plan.max(axis=0) + 2 * _PITCH_MM
    columns, rows = np.ceil((high - low) / _PITCH_MM).astype(int)
    layer, below = (_slice_mask(corners, at, low, (int(rows), int(columns))) for at in (z, z - sizes.LAYER_MM))
    if not bool(layer.any()):
        return 0.0
    if not bool(below.any()):
        return float("inf")
    away = np.asarray(ndimage.distance_transform_edt(~below))
    reach = float(away[layer].max()) * _PITCH_MM
    return 2.0 * reach if reach > sizes.LAYER_MM + _PITCH_MM else 0.0


def _slice_mask(corners: Array, z: float, low: Array, shape: tuple[int, int], pitch_mm: float = _PITCH_MM) -> BoolArray:
    """Which points of a grid of `shape` from `low` (2,) lie inside a closed mesh at the height `z`, off its corners."""
    heights = corners[..., 2] - z
    above = heights > 0
    cut = above.any(axis=1) & ~above.all(axis=1)
    points, heights, above = corners[cut], heights[cut], above[cut]
    count = above.sum(axis=1)
    alone = np.where(count == 1, above.argmax(axis=1), above.argmin(axis=1))  # the corner on its own side
    rows = np.arange(len(points))
    ends, from_height, from_point = [], heights[rows, alone], points[rows, alone, :2]
    for step in (1, 2):
        other = (alone + step) % 3
        fraction = from_height / (from_height - heights[rows, other])
        ends.append(from_point + fraction[:, None] * (points[rows, other, :2] - from_point))
    (x, y), (to_x, to_y) = (((point - low) / pitch_mm).T for point in ends)  # in columns and rows
    row, side = np.nonzero((y > (grid := np.arange(shape[0])[:, None])) != (to_y > grid))
    crossed = x[side] + (row - y[side]) / (to_y - y)[side] * (to_x - x)[side]
    parity = np.zeros((shape[0], shape[1] + 1), dtype=np.int64)
    np.add.at(parity, (row, np.clip(np.ceil(crossed), 0, shape[1]).astype(np.int64)), 1)
    return np.asarray(np.cumsum(parity, axis=1)[:, :-1] % 2 == 1)


# Checks of a closed triangle mesh: watertight, volume, thinnest wall.
#
# They look at the triangles that the STL file holds, not at the solid they came from.

_SAMPLES = 4000  # points on the surface at which walls are measured, beside one for each triangle
_REACH_MM = 8.0  # walls thicker than this are not looked at


def _check_soundness(triangles: Triangles) -> tuple[int, int, float]:
    """Number of edges of a mesh (N, 3, 3), of those not between just two triangles of opposite sense, and its volume in
    mm^3, negative inside out. Corners are the same point if their numbers are.
    """
    corners = np.asarray(triangles, dtype=np.float32)
    _, index = np.unique(corners.reshape(-1, 3) + np.float32(0.0), axis=0, return_inverse=True)
    ways = np.stack([index.ravel(), np.roll(index.reshape(-1, 3), -1, axis=1).ravel()], axis=1)  # from corner to corner
    edges, edge = np.unique(np.sort(ways, axis=1), axis=0, return_inverse=True)
    turns = np.where(ways[:, 0] < ways[:, 1], 1, -1)
    faulty = (np.bincount(edge.ravel()) != 2) | (np.bincount(edge.ravel(), weights=turns) != 0)
    exact = corners.astype(np.float64)
    cross = np.cross(exact[:, 1] - exact[:, 0], exact[:, 2] - exact[:, 0])
    return len(edges), int(faulty.sum()), float(np.einsum("ij,ij->", exact[:, 0], cross) / 6.0)


def _thinnest_wall(triangles: Triangles) -> tuple[float, Array, int]:
    """Thinnest wall up to 8 mm between faces that look away from each other within 25 deg, its place (3,), and from how
    many points it was sought, drawn by area, at least one a triangle.
    """
    corners = np.asarray(triangles, dtype=np.float64)
    normals, areas = _normals_and_areas(corners)
    rng, sound = np.random.default_rng(0), np.flatnonzero(areas > 1e-6)
    faces = np.concatenate([sound, rng.choice(len(corners), size=_SAMPLES, p=areas / areas.sum())])
    weights = rng.dirichlet((1.0, 1.0, 1.0), size=len(faces))
    weights[: len(sound)] = 1.0 / 3.0
    points = np.einsum("ij,ijk->ik", weights, corners[faces])
    inwards = -normals[faces]
    distance, hit = _first_hits(corners, points + 1e-4 * inwards, inwards, _REACH_MM)
    met = (hit >= 0) & (np.einsum("ij,ij->i", normals[faces], normals[np.maximum(hit, 0)]) < -np.cos(np.deg2rad(25)))
    if not bool(met.any()):
        return _REACH_MM, points[0], len(points)
    thickness = np.where(met, distance, np.inf)
    thinnest = int(np.argmin(thickness))
    return float(thickness[thinnest]) + 1e-4, points[thinnest], len(points)


# Where short rays meet a triangle mesh: cell by cell of a grid, so that each looks at the triangles around it only.

_TINY = 1e-12
_AT_ONCE = 400_000  # pairs of rays and triangles that are looked at together: what fits into the processor's cache


def _first_hits(corners: Array, origins: Array, directions: Array, reach_mm: float) -> tuple[Array, NDArray[np.int64]]:
    """Each ray's distance (R,) to the first triangle it meets within reach, or infinity, and that triangle. T. Moeller
    and B. Trumbore, "Fast, minimum storage ray/triangle intersection", Journal of Graphics Tools 2(1), 1997.

    >>> import numpy as np
    >>> floor = np.array([[[0.0, 0.0, 0.0], [9.0, 0.0, 0.0], [0.0, 9.0, 0.0]]])
    >>> _first_hits(floor, np.array([[1.0, 1.0, 3.0]]), np.array([[0.0, 0.0, -1.0]]), 5.0)[0].tolist()
    [3.0]
    """
    distance = np.full(len(origins), np.inf)
    triangle = np.full(len(origins), -1, dtype=np.int64)
    low, high = corners.min(axis=1), corners.max(axis=1)
    cells = np.floor(origins / reach_mm).astype(np.int64)
    _, cell_of, counts = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(cell_of.ravel(), kind="stable")
    for members in np.split(order, np.cumsum(counts)[:-1]):
        ends = origins[members] + reach_mm * directions[members]
        lowest = np.minimum(origins[members], ends).min(axis=0)
        highest = np.maximum(origins[members], ends).max(axis=0)
        near = np.flatnonzero((low <= highest).all(axis=1) & (high >= lowest).all(axis=1))
        if len(near) == 0:
            continue
        for some in np.array_split(members, max(1, len(members) * len(near) // _AT_ONCE)):
            found, index = _hits(corners[near], origins[some], directions[some])
            met = found <= reach_mm
            distance[some] = np.where(met, found, np.inf)
            triangle[some] = np.where(met, near[index], -1)
    return distance, triangle


def _hits(corners: Array, origins: Array, directions: Array) -> tuple[Array, NDArray[np.int64]]:
    """Distances (R,) and triangles (R,) of the first hits among all of `corners` (T, 3, 3)."""
    base, edge1, edge2 = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    # triple products, arranged so that only matrix products of (R, 3) by (3, T) are needed
    normal = np.cross(edge1, edge2)
    determinant = -directions @ normal.T
    inverse = np.divide(1.0, determinant, out=np.zeros_like(determinant), where=np.abs(determinant) > _TINY)
    moment = np.cross(origins, directions)  # (o - b) x d = o x d - b x d
    u = (moment @ edge2.T + directions @ np.cross(base, edge2).T) * inverse
    v = (moment @ edge1.T + directions @ np.cross(base, edge1).T) * -inverse
    t = (origins @ normal.T - (base * normal).sum(axis=1)) * inverse
    edge = 1e-9
    met = (inverse != 0) & (u >= -edge) & (v >= -edge) & (u + v <= 1 + edge) & (t > 1e-6)
    t = np.where(met, t, np.inf)
    index = t.argmin(axis=1)
    return np.asarray(t[np.arange(len(origins)), index]), index.astype(np.int64)
