"""The rolled-equivalent print: a capture with mirrors as one finger around its front, laid flat."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy
from numpy.typing import NDArray

from splitknit import read_capture
from splitknit.errors import naming, require
from splitknit.imaging.polarised import without_films
from splitknit.io.mesh import surface_mesh, write_ply
from splitknit.model import BoolArray, FloatArray
from splitknit.verbs import Progress
from splitknit_match.prints.print_map import PrintMap, unrolled_map
from splitknit_match.prints.sources import Source
from splitknit_match.prints.unroll import KINDS, NODES_MM, Unrolled, unroll
from splitknit_match.prints.unroll_grid import RINGS, SurfaceGrid, extrapolated
from splitknit_match.rolled.blend import seam_lines, seam_steps
from splitknit_match.rolled.chart import Chart

if TYPE_CHECKING:
    from splitknit_match.rolled.blend import RolledSettings
    from splitknit_match.rolled.finger import Rolled

Array = NDArray[np.float64]
SIDE_MM, TIP_MM = 14.0, 0.0
"""Coverage is reported for the rows from the tip's cap downwards, as far as this."""


def read_rolled(path: Path, preset: str, settings: RolledSettings, progress: Progress) -> tuple[Source, Rolled]:
    """A capture folder as one finger around its front.

    Raises BadInput if it is not a capture, has no mirrors beside the finger, or fewer than two views can be used.
    """
    from splitknit import preset_settings
    from splitknit_match.rolled.finger import rolled_finger
    from splitknit_match.rolled.views import find_mirror_views
    from splitknit_match.rolled.work import ReliefSettings

    require(
        (path / "capture.json").is_file(),
        f"'{path}' is not a capture folder (capture.json); a rolled finger is made from a capture with mirrors.",
    )

    def make() -> tuple[Source, Rolled]:
        capture = without_films(read_capture(path))
        chosen = preset_settings(preset)
        progress("views", 0.08)
        views = find_mirror_views(capture, chosen, chosen.shape.mirror)
        relief = ReliefSettings(chosen.metric, chosen.shapelets)
        made = rolled_finger(
            capture, views, relief, settings, lambda stage, fraction: progress(stage, 0.15 + 0.55 * fraction)
        )
        return _source(made, preset, capture.hashes, capture.subject), made

    return naming(path, make)


def _source(rolled: Rolled, preset: str, hashes: Any, subject: Any) -> Source:
    """What prints need: the chart takes the part of the input's pixels."""
    return Source(
        "capture", rolled.blended.known, rolled.chart.pitch_mm, np.eye(3), rolled.chart.shape,
        ridge_mm=rolled.blended.relief_mm, preset=preset, hashes=hashes, subject=subject,
    )  # fmt: skip


def _skin_points(rolled: Rolled, ridges: bool = True) -> FloatArray:
    """(n, m, 3) the skin in the finger's own frame: x right, y to the tip, z to the camera; NaN where not known."""
    points = rolled.points_mm.astype(np.float64)
    if ridges:
        points = points + rolled.blended.relief_mm[..., None] * rolled.normals
    local = (points - rolled.chart.centre_mm) @ rolled.chart.axes.T
    return np.where(rolled.blended.known[..., None], local, np.nan).astype(np.float32)


def laid_flat(rolled: Rolled, kind: str, ppi: float) -> tuple[Unrolled, PrintMap]:
    """The chart laid flat: all of the skin weighs the same, however it is turned.

    Raises BadInput if `kind` is unknown, or there is too little skin.
    """
    require(kind in KINDS, f"a rolled finger is laid flat {' or '.join(KINDS)}, not on the {kind}.")
    step = max(1, round(NODES_MM / rolled.chart.pitch_mm))
    room = RINGS + 1  # nodes beyond the chart's ends
    around = ((room, room), (room, room))
    points = _skin_points(rolled, ridges=False)[::step, ::step].astype(np.float64)
    points = np.pad(points, (*around, (0, 0)), constant_values=np.nan)
    inside = np.pad(rolled.blended.known[::step, ::step], around)
    nodes = extrapolated(points, RINGS)
    chart_from_node = np.array([[step, 0.0, -room * step], [0.0, step, -room * step], [0.0, 0.0, 1.0]])
    grid = SurfaceGrid(nodes, inside, chart_from_node, NODES_MM)
    unrolled = unroll(grid, kind, centre_weight=0.0)
    return unrolled, unrolled_map(unrolled, kind, ppi, None)


def rolled_facts(rolled: Rolled) -> dict[str, Any]:
    """Coverage, seams, views: for ``report.json``."""
    chart = rolled.chart
    around = _coverage_deg(chart, rolled.blended.known, rolled.normals.astype(np.float64))
    rows = (chart.length_mm <= TIP_MM) & (chart.length_mm >= -SIDE_MM) & (around > 0)
    every = max(1, round(1.0 / chart.pitch_mm))
    seams = {}
    for place, name in enumerate(rolled.names[1:], start=1):
        line = seam_lines(rolled.blended.fractions, 0, place)
        both = np.minimum(rolled.blended.fractions[0], rolled.blended.fractions[place]) > 0.2
        other = rolled.view_reliefs[place][both]
        apart = other - rolled.view_reliefs[0][both]
        correlation = np.corrcoef(rolled.view_reliefs[0][both], other)[0, 1] if int(both.sum()) > 100 else None
        steps = seam_steps(_evened(rolled), line, chart.pitch_mm) if line.any() else np.zeros(0)
        seams[name] = {
            "length_mm": round(float(line.any(axis=1).sum()) * chart.pitch_mm, 2),
            "step_rms_um": round(1000.0 * float(np.sqrt((steps**2).mean())), 2) if steps.size else None,
            "views_differ_um": round(1000.0 * float(apart.std()), 2) if apart.size else None,
            "views_correlate": None if correlation is None else round(float(correlation), 3),
        }
    return {
        **rolled.facts,
        "coverage_deg": {
            "median": round(float(np.median(around[rows])), 1) if rows.any() else 0.0,
            "p10": round(float(np.percentile(around[rows], 10)), 1) if rows.any() else 0.0,
            "rows_mm": [round(float(v), 2) for v in chart.length_mm[::every]],
            "rows": [round(float(v), 1) for v in around[::every]],
        },
        "share_of_views": {
            name: round(float(rolled.blended.fractions[k][rolled.blended.known].mean()), 3)
            for k, name in enumerate(rolled.names)
        },
        "seams": seams,
    }


def write_rolled(target: Path, rolled: Rolled) -> dict[str, Any]:
    """Write the skin into a folder as a mesh, ``rolled.ply``: mm, x right, y to the tip, z to the camera; return the
    facts.
    """
    points = _skin_points(rolled)
    vertices, faces, index = surface_mesh(points[..., 0], points[..., 1], points[..., 2], rolled.blended.known)
    used = index >= 0
    normals = (rolled.normals.astype(np.float64) @ rolled.chart.axes.T)[used].astype(np.float32)
    relief = rolled.blended.relief_mm[used]
    shade = np.clip(0.5 + relief / np.float32(6.0 * max(float(relief.std()), 1e-6)), 0.0, 1.0).astype(np.float32)
    words = ["rolled-equivalent finger, mm; quality is the relief"]
    write_ply(target / "rolled.ply", (vertices, normals, shade), faces, words)
    return {**rolled_facts(rolled), "mesh_points": len(vertices)}


def _evened(rolled: Rolled, sigma_mm: float = 0.3) -> FloatArray:
    """(n, m) the relief without its ridges, mm: a seam would be a step in it."""
    import cv2  # large

    weight = rolled.blended.known.astype(np.float32)
    size = sigma_mm / rolled.chart.pitch_mm
    mean = cv2.GaussianBlur(rolled.blended.relief_mm * weight, (0, 0), size)
    return np.asarray(mean / np.maximum(cv2.GaussianBlur(weight, (0, 0), size), 1e-3), dtype=np.float32)


def _coverage_deg(chart: Chart, known: BoolArray, normals: Array) -> Array:
    """(n,) range of directions, around the finger, of the skin's normals that each row shows without a gap; degrees.

    A row over the straight part of the finger counts its longest run of known pixels. The direction is that of the
    normal about the finger's axis, not that of the ray: what a flat view calls slant.
    """
    local = normals @ chart.axes.T
    around = np.rad2deg(np.arctan2(local[..., 0], local[..., 2]))
    result = np.zeros(chart.shape[0])
    for row in range(chart.shape[0]):
        labels, count = scipy.ndimage.label(known[row])
        if count == 0:
            continue
        longest = 1 + int(np.argmax(np.bincount(labels[labels > 0])[1:]))
        places = np.flatnonzero(labels == longest)
        result[row] = float(np.ptp(np.unwrap(np.deg2rad(around[row, places])))) * 180.0 / np.pi
    return result
