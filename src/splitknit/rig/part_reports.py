"""What is said of each part: size, mass, and whether it prints; nothing outside the limits goes without a word."""

from __future__ import annotations

from typing import Any

import numpy as np

from splitknit.rig.assembly import PartKind
from splitknit.rig.mesh_checks import check_soundness, thinnest_wall
from splitknit.rig.print_settings import PrinterSettings
from splitknit.rig.printable import overhang
from splitknit.rig.stl import Triangles

_FACETS_MM = 0.1
"""How much thinner facets make a round wall."""


def report_part(kind: PartKind, triangles: Triangles, printer: PrinterSettings) -> dict[str, Any]:
    """Check one part as it lies on the bed.

    Parameters
    ----------
    kind : PartKind
    triangles : (N, 3, 3), mm, as read from the STL file
    printer : its limits

    Returns
    -------
    dict with ``title``, ``quantity``, ``print``, ``size_mm``, ``volume_cm3``, ``mass_g`` (solid), ``checks`` and
    ``findings``: sentences, one for everything that is outside a limit or wants a hand.

    Raises
    ------
    RuntimeError
        If the mesh is not watertight: our failure, never the rig's.
    """
    sound = check_soundness(triangles)
    if not sound.watertight:
        raise RuntimeError(f"the mesh of part '{kind.name}' is not closed: {sound.open_edges} open edges")
    wall = thinnest_wall(triangles)
    hanging = overhang(triangles, printer.overhang_deg, printer.layer_mm)
    points = triangles.reshape(-1, 3).astype(np.float64)
    size = points.max(axis=0) - points.min(axis=0)
    fits = bool((size <= (printer.bed_x_mm, printer.bed_y_mm, printer.bed_z_mm)).all())
    thick = wall.thickness_mm >= printer.least_wall_mm - _FACETS_MM
    bridged = hanging.bridge_mm <= printer.bridge_mm
    volume = sound.volume_mm3 / 1000.0
    findings = [kind.remedy] if kind.remedy else []
    if not fits:
        findings.append(f"It is {size[0]:.0f} x {size[1]:.0f} x {size[2]:.0f} mm, larger than the printer's bed.")
    if not thick:
        x, y, z = wall.place_mm
        findings.append(
            f"Its thinnest place measures {wall.thickness_mm:.2f} mm, less than {printer.least_wall_mm:g} mm, at "
            f"x {x:.0f}, y {y:.0f}, z {z:.0f} mm on the bed."
        )
    if not bridged:
        findings.append(
            f"A ceiling {hanging.bridge_z_mm:.1f} mm above the bed spans {hanging.bridge_mm:.1f} mm of air, more than "
            f"{printer.bridge_mm:g} mm: print it with support there."
        )
    elif hanging.bridge_mm > 0:
        findings.append(
            f"{hanging.steep_mm2:.0f} mm² ({100 * hanging.share:.1f} % of its surface) lean further than "
            f"{printer.overhang_deg:g} deg; the longest bridge is {hanging.bridge_mm:.1f} mm, "
            f"{hanging.bridge_z_mm:.1f} mm above the bed: no support."
        )
    return {
        "title": kind.title,
        "quantity": kind.quantity,
        "needed": kind.needed,
        "print": {"face_on_bed": "upper" if kind.face_down else "lower", "colour": kind.colour},
        "size_mm": [round(float(value), 2) for value in size],
        "volume_cm3": round(volume, 3),
        "mass_g": round(volume * printer.density_g_per_cm3, 1),
        "checks": {
            "watertight": {"ok": True, "triangles": sound.triangles, "edges": sound.edges},
            "wall": {
                "ok": bool(thick),
                "smallest_mm": round(wall.thickness_mm, 2),
                "at_mm": [round(float(value), 1) for value in wall.place_mm],
                "least_mm": printer.least_wall_mm,
                "places": wall.samples,
            },
            "bed": {"ok": fits, "bed_mm": [printer.bed_x_mm, printer.bed_y_mm, printer.bed_z_mm]},
            "overhang": {
                "ok": bridged,
                "limit_deg": printer.overhang_deg,
                "steep_mm2": round(hanging.steep_mm2, 1),
                "share": round(hanging.share, 5),
                "bridge_mm": round(hanging.bridge_mm, 1),
                "bridge_z_mm": round(hanging.bridge_z_mm, 1),
                "bridge_limit_mm": printer.bridge_mm,
            },
        },
        "findings": findings,
    }
