"""The rolled-equivalent finger: photometric stereo from the front and in every mirror, fused around the finger."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit import Capture
from splitknit.errors import require
from splitknit.mirrors.reflection import Glass
from splitknit.model import BoolArray, FloatArray
from splitknit_match.rolled.blend import STEEPEST_DEG, Blended, BlendSettings, RolledSettings, blend
from splitknit_match.rolled.chart import Chart, surface_normals
from splitknit_match.rolled.work import MIN_MEETING, MirrorViews, ReliefSettings, Work

_POWER = 8.0  # views weigh with this power of what their slant leaves: high hands over fast, low mixes over a wide zone
_DEVIATION_FLOOR_UM = 4.0  # added to the relief's standard deviation, so that no view is trusted without limit
Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Rolled:
    """A finger around its front, on its chart."""

    chart: Chart
    points_mm: FloatArray  # (n, m, 3) of the skin without its ridges, rig's frame
    normals: FloatArray  # (n, m, 3)
    blended: Blended
    names: tuple[str, ...]  # names of the views, in the order of ``blended.fractions``
    view_reliefs: FloatArray  # (V, n, m) relief of each view, along the skin's normal; zero where it shows nothing
    places: FloatArray  # (V, n, m, 2) column and row of the image at which each view shows each point
    glasses: tuple[Glass, ...]  # mirrors where the ridges have them
    facts: Mapping[str, object]


SURE_MEETING = 0.4  # correlation of two views' ridges below which it is said that they may not meet


def rolled_finger(
    capture: Capture,
    views: MirrorViews,
    settings: ReliefSettings,
    rolled: RolledSettings | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> Rolled:
    """One finger from its front and its mirrors. `capture`: with the white band. Raises BadInput if the front or every
    mirror beside the finger is missing, or they do not show the same part of the finger.
    """
    chosen = rolled or RolledSettings()
    report = progress or (lambda stage, fraction: None)
    names = [view.name for view in views]
    require("front" in names, "the front view of the finger is missing.")
    sides = [view.name for view in views if view.glass is not None and view.mask is not None]
    require(bool(sides), "no mirror beside the finger shows it.")
    require("white" in capture.bands, "the capture has no band 'white', in which ridges are seen.")
    work = Work(capture, views, settings, chosen)
    report("views", 0.0)
    work.find_ridges()
    report("registration", 0.35)
    for coarse in (True, False, False, False):
        work.register(coarse)
    report("fusion", 0.5)
    return _fused(work)


def _fused(work: Work) -> Rolled:
    chosen = work.rolled
    chart = work.chart(chosen.pitch_mm)
    radius = work.radius_on(chart)
    points = chart.points(radius)
    normals = surface_normals(points)
    names = ("front", *work.glasses)
    sights = work.sights()
    reliefs, deviations, weights, places = [], [], [], []
    for name in names:
        relief, deviation, trust, known = work.seen(name, points, normals)
        weight = _view_weight(sights[name].cosine(normals, points), known, deviation, chart.pitch_mm, chosen.blend)
        reliefs.append(relief)
        deviations.append(deviation)
        weights.append(weight * trust)
        places.append(np.stack(sights[name].pixels(points), axis=-1))
    stacked = np.stack(reliefs).astype(np.float32)
    weighed = np.stack(weights).astype(np.float32)
    weighed[:, _base(weighed[0] > 0) :] = 0.0
    blended = blend(stacked, np.stack(deviations).astype(np.float32), weighed)
    facts = {
        "views": list(names),
        "relief_by": {name: work.reliefs[name].how for name in names},
        "views_meet": dict(work.correlation),
        "warnings": [*work.notes, *_apart(work)],
    }
    return Rolled(
        chart, points.astype(np.float32), normals.astype(np.float32), blended, names, stacked,
        np.stack(places), tuple(work.glasses.values()), facts,
    )  # fmt: skip


def _base(front: BoolArray) -> int:
    """First row below what the front (n, m) shows in nine tenths of its usual breadth: all views end there."""
    breadth = front.sum(axis=1)
    if not breadth.any():
        return len(front)
    return int(np.flatnonzero(breadth >= 0.9 * np.median(breadth[breadth > 0]))[-1]) + 1


def _apart(work: Work) -> list[str]:
    """Views whose ridges do not meet the front's, or may not, in sentences."""
    return [
        f"ridges of the {name} mirror's view {'do' if values[-1] < MIN_MEETING else 'may'} not lie on the front's "
        f"(correlation {values[-1]:.2f}), so that they may be kinked where the views meet: check the mirror's pose in "
        "rig.json, and that ridges are seen in it."
        for name, values in work.correlation.items()
        if values and values[-1] < SURE_MEETING
    ]


def _view_weight(
    cosine: Array, known: BoolArray, deviation_mm: FloatArray, pitch_mm: float, settings: BlendSettings
) -> FloatArray:
    """(n, m) weight of a view on the chart, zero where it shows nothing. `cosine`: of the slant as the view sees it;
    `known`: where it shows the finger; `deviation_mm`: of its relief, along the skin's normal; all (n, m).
    """
    least = np.cos(np.deg2rad(STEEPEST_DEG))
    facing = np.clip((cosine - least) / (1.0 - least), 0.0, 1.0) ** _POWER
    inside = np.asarray(known & (facing > 0), dtype=np.uint8)
    depth = cv2.distanceTransform(np.pad(inside, 1), cv2.DIST_L2, 5)[1:-1, 1:-1] * pitch_mm
    fade = np.clip(depth / settings.fade_mm, 0.0, 1.0)
    fade = fade * fade * (3.0 - 2.0 * fade)
    floor = 1e-3 * _DEVIATION_FLOOR_UM
    smooth = cv2.GaussianBlur(np.where(known, deviation_mm, 0.0).astype(np.float32), (0, 0), 0.5 / pitch_mm)
    fraction = cv2.GaussianBlur(known.astype(np.float32), (0, 0), 0.5 / pitch_mm)
    deviation = smooth / np.maximum(fraction, 1e-3)
    certain = floor**2 / (floor**2 + deviation**2)
    sure = np.clip(4.0 * (1.0 - deviation / (1e-3 * settings.most_deviation_um)), 0.0, 1.0)
    return np.asarray(facing * fade * certain * sure * inside, dtype=np.float32)
