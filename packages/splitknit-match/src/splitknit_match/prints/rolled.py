"""The rolled-equivalent print: a capture with mirrors as one finger around its front, laid flat."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from splitknit import preset_settings, read_capture
from splitknit.errors import naming, require
from splitknit.finger.ridges import ink
from splitknit.io.mesh import triangulate, write_ply
from splitknit.model import Array, BoolArray, FloatArray, Progress
from splitknit_match.prints.make import Print
from splitknit_match.prints.print_map import PrintMap, resample, unrolled_map
from splitknit_match.prints.sources import Source
from splitknit_match.prints.unroll import (
    NODES_MM,
    RINGS,
    SurfaceGrid,
    extrapolated,
    longest_run,
    unroll,
)
from splitknit_match.rolled.chart import Chart
from splitknit_match.rolled.finger import Rolled, rolled_finger
from splitknit_match.rolled.views import find_mirror_views


def print_around(
    path: Path, preset: str, place: str, ppi: float, progress: Progress
) -> tuple[Source, Print, Rolled]:
    """A capture folder as one finger around its front, laid flat as `place`: what is printed, the
    print, the finger.

    Raises BadInput if it is not a capture, has no mirrors beside the finger, fewer than two views
    can be used, or there are no ridges or too little skin.
    """
    require(
        (path / "capture.json").is_file(),
        f"'{path}' is not a capture folder (capture.json); a rolled finger is made from a capture"
        " with mirrors.",
    )

    def make() -> tuple[Source, Print, Rolled]:
        capture = read_capture(path)
        chosen = preset_settings(preset)
        progress("views", 0.08)
        views = find_mirror_views(capture, chosen)
        rolled = rolled_finger(
            capture,
            views,
            chosen.metric,
            lambda stage, fraction: progress(stage, 0.15 + 0.55 * fraction),
        )
        # the chart takes the part of the input's pixels
        source = Source(
            "capture",
            rolled.blended.known,
            rolled.chart.pitch_mm,
            np.eye(3),
            rolled.chart.shape,
            ridge_mm=rolled.blended.relief_mm,
            preset=preset,
            hashes=capture.hashes,
            subject=capture.subject,
        )
        progress("printing", 0.75)
        print_map, distortion = _laid_flat(rolled, place, ppi)
        inked, weight = resample(rolled.blended.relief_mm, source.mask, source.pitch_mm, print_map)
        return (
            source,
            Print(ink(inked, weight, ppi), weight, print_map, inked, True, distortion),
            rolled,
        )

    return naming(path, make)


def _skin_points(rolled: Rolled, points: Array) -> FloatArray:
    """(n, m, 3) points in the finger's own frame: x right, y to the tip, z to the camera; NaN where
    not known."""
    local = (points - rolled.chart.centre_mm) @ rolled.chart.axes.T
    return np.where(rolled.blended.known[..., None], local, np.nan).astype(np.float32)


def _laid_flat(rolled: Rolled, kind: str, ppi: float) -> tuple[PrintMap, dict[str, float]]:
    """The chart laid flat, and how far that stretches it: all of the skin weighs the same, however
    it is turned."""
    step = max(1, round(NODES_MM / rolled.chart.pitch_mm))
    margin = RINGS + 1  # nodes beyond the chart's ends
    points = _skin_points(rolled, rolled.points_mm.astype(float))[::step, ::step].astype(float)
    points = np.pad(points, ((margin, margin), (margin, margin), (0, 0)), constant_values=np.nan)
    inside = np.pad(rolled.blended.known[::step, ::step], margin)
    first = -step * margin
    chart_from_node = np.array([[step, 0.0, first], [0.0, step, first], [0.0, 0.0, 1.0]])
    grid = SurfaceGrid(extrapolated(points, RINGS), inside, chart_from_node, NODES_MM)
    unrolled = unroll(grid, kind, centre_weight=0.0)
    return unrolled_map(unrolled, kind, ppi, None), unrolled.distortion


def rolled_facts(rolled: Rolled) -> dict[str, Any]:
    """Coverage and views: for ``report.json``."""
    chart = rolled.chart
    around = _coverage_deg(chart, rolled.blended.known, rolled.normals.astype(float))
    # the first 14 mm below the tip's cap
    rows = (chart.length_mm <= 0) & (chart.length_mm >= -14.0) & (around > 0)
    median = round(float(np.median(around[rows])), 1) if rows.any() else 0.0
    return {**rolled.facts, "coverage_deg": {"median": median}}


def write_rolled(target: Path, rolled: Rolled) -> dict[str, Any]:
    """Write the skin into a folder as a mesh, ``rolled.ply``: mm, x right, y to the tip, z to the
    camera; return the facts.
    """
    relief = rolled.blended.relief_mm
    points = _skin_points(
        rolled, rolled.points_mm.astype(float) + relief[..., None] * rolled.normals
    )
    used = rolled.blended.known & np.isfinite(points[..., 2])
    faces, _ = triangulate(used)
    vertices = points[used].astype(np.float32)
    normals = (rolled.normals.astype(float) @ rolled.chart.axes.T)[used].astype(np.float32)
    relief = relief[used]
    shade = np.clip(0.5 + relief / (6.0 * max(float(relief.std()), 1e-6)), 0.0, 1.0).astype(
        np.float32
    )
    words = ["rolled-equivalent finger, mm; quality is the relief"]
    write_ply(target / "rolled.ply", (vertices, normals, shade), faces, words)
    return {**rolled_facts(rolled), "mesh_points": len(vertices)}


def _coverage_deg(chart: Chart, known: BoolArray, normals: Array) -> Array:
    """(n,) range of directions, around the finger, of the skin's normals that each row shows
    without a gap; degrees.

    A row over the straight part of the finger counts its longest run of known pixels. The direction
    is that of the normal about the finger's axis, not that of the ray: what a flat view calls
    slant.
    """
    local = normals @ chart.axes.T
    around = np.arctan2(local[..., 0], local[..., 2])
    result = np.zeros(chart.shape[0])
    for row, nodes in enumerate(known):
        run = longest_run(nodes)
        if run.size:
            result[row] = np.rad2deg(np.ptp(np.unwrap(around[row, run])))
    return result
