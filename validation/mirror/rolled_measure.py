"""One capture with mirrors, rolled, against its truth: coverage, surface, ridges by slant."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from splitknit.imaging.geometry import sampled_at
from splitknit.io.capture import read_capture
from splitknit.presets import preset_settings
from splitknit.skin.images import MetricSettings
from splitknit_match.prints.rolled import rolled_facts
from splitknit_match.rolled.finger import STEEPEST_DEG, Blended, Rolled, rolled_finger
from splitknit_match.rolled.register import ridges_of
from splitknit_match.rolled.views import find_mirror_views

BANDS_DEG = ((0, 30), (30, 60), (60, 90), (90, 110))
"""Bands of the angle between the skin and the camera's axis."""
CAP_MM = 0.0
"""Upper end of the rows that are measured: the tip's cap."""
BASE_MM = 14.0
"""How far down from the cap rows are measured; creases lie below."""
PIXEL_STEP = 2
"""Every so many of the chart's pixels."""


def measure(folder: Path) -> dict[str, Any]:
    """Roll a capture and compare it with its truth."""
    capture = read_capture(folder)
    chosen = preset_settings("metric")
    views = find_mirror_views(capture, chosen)
    rolled = rolled_finger(capture, views, MetricSettings())
    front = front_alone(rolled)
    with np.load(folder / "truth.npz") as arrays:
        truth = {
            name: arrays[name]
            for name in arrays.files
            if name.startswith(("body_", "mirror_", "view_", "relief_um", "mask", "chart_mm"))
        }
    facts = rolled_facts(rolled)
    return {
        "pattern_of": folder.name,
        "coverage_deg": facts["coverage_deg"]["median"],
        "coverage_front_deg": rolled_facts(front)["coverage_deg"]["median"],
        "views": list(rolled.names),
        "views_meet": facts["views_meet"],
        "surface_rms_mm": _surface_error(rolled, truth),
        "cut": [view.name for view in views if view.cut],
        "ridges_apart_um": ridges_apart(rolled, truth),
        **against_truth(rolled, front, truth),
    }


def front_alone(rolled: Rolled) -> Rolled:
    """The same finger as its front shows it, as far as any view is used: the same relief, without
    the mirrors'."""
    facing = rolled.normals[..., 2] > np.cos(np.deg2rad(STEEPEST_DEG))
    known = rolled.blended.known & (rolled.view_reliefs[0] != 0) & facing
    relief = np.where(known, rolled.view_reliefs[0], np.float32(0.0)).astype(np.float32)
    fractions = np.stack([known.astype(np.float32)])
    blended = Blended(relief, known, fractions)
    return replace(rolled, blended=blended, names=("front",), view_reliefs=rolled.view_reliefs[:1])


def against_truth(rolled: Rolled, front: Rolled, truth: dict[str, Any]) -> dict[str, Any]:
    """Every point of the print against the truth at the pixel of the image that it was taken
    from."""
    pitch = rolled.chart.pitch_mm * PIXEL_STEP
    slant = np.rad2deg(np.arccos(np.clip(rolled.normals[::PIXEL_STEP, ::PIXEL_STEP, 2], -1.0, 1.0)))
    length = rolled.chart.length_mm[::PIXEL_STEP, None]
    region = (length <= CAP_MM) & (length >= -BASE_MM)
    by_view = [_truth_of(rolled, k, truth) for k in range(len(rolled.names))]
    best = np.argmax(rolled.blended.fractions[:, ::PIXEL_STEP, ::PIXEL_STEP], axis=0)
    result: dict[str, Any] = {}
    for name, combined in (("rolled", rolled), ("front", front)):
        known = combined.blended.known[::PIXEL_STEP, ::PIXEL_STEP]
        seen = ridges_of(
            np.ascontiguousarray(combined.blended.relief_mm[::PIXEL_STEP, ::PIXEL_STEP]),
            known,
            pitch,
        )
        # where two views are mixed, the truth is that of the one that counts more: ridges that do
        # not meet cost
        there = (
            np.take_along_axis(np.stack(by_view), best[None], axis=0)[0]
            if name == "rolled"
            else by_view[0]
        )
        known = known & np.isfinite(there)
        there = ridges_of(np.nan_to_num(there).astype(np.float32), known, pitch)
        result[name] = _by_band(there, seen, known & region, slant)
    return result


def _truth_of(rolled: Rolled, view: int, truth: dict[str, Any]) -> NDArray[np.float32]:
    """(n, m) true relief, mm, at the pixels at which one view shows the chart's points; NaN beside
    it."""
    name = rolled.names[view]
    relief, mask = (
        ("relief_um", "mask")
        if name == "front"
        else (f"view_{name}_relief_um", f"view_{name}_mask")
    )
    field = np.where(truth[mask], truth[relief] * np.float32(1e-3), np.float32(np.nan)).astype(
        np.float32
    )
    places = rolled.places[view, ::PIXEL_STEP, ::PIXEL_STEP]
    return sampled_at(field, places[..., 0], places[..., 1], outside=np.nan)


def ridges_apart(rolled: Rolled, truth: dict[str, Any]) -> dict[str, float | None]:
    """How far apart (rms, um) the skin lies that the front and each mirror show at one place of the
    print, where both count: by the skin's own coordinates."""
    skin = []
    for view, name in enumerate(rolled.names):
        place, mask = (
            ("chart_mm", "mask")
            if name == "front"
            else (f"view_{name}_chart_mm", f"view_{name}_mask")
        )
        field = np.where(truth[mask][..., None], truth[place], np.float32(np.nan)).astype(
            np.float32
        )
        at = rolled.places[view, ::PIXEL_STEP, ::PIXEL_STEP]
        parts = [
            sampled_at(np.ascontiguousarray(field[..., k]), at[..., 0], at[..., 1], outside=np.nan)
            for k in range(2)
        ]
        skin.append(np.stack(parts, axis=-1))
    length = rolled.chart.length_mm[::PIXEL_STEP, None]
    fractions = rolled.blended.fractions[:, ::PIXEL_STEP, ::PIXEL_STEP]
    result: dict[str, float | None] = {}
    for view, name in enumerate(rolled.names[1:], start=1):
        apart = np.linalg.norm(skin[view] - skin[0], axis=-1)
        both = (
            (np.minimum(fractions[0], fractions[view]) > 0.2)
            & (length <= CAP_MM)
            & (length >= -BASE_MM)
        )
        values = apart[both & np.isfinite(apart)]
        result[name] = (
            round(1000.0 * float(np.sqrt((values**2).mean())), 1) if values.size > 100 else None
        )
    return result


def _surface_error(rolled: Rolled, truth: dict[str, Any]) -> float:
    """Root mean square distance of the smooth surface from the true one, mm."""
    points = truth["body_shape_mm"].astype(np.float64)
    stride = 8
    length = rolled.chart.length_mm[::stride]
    region = (
        rolled.blended.known[::stride, ::stride]
        & ((length <= CAP_MM) & (length >= -BASE_MM))[:, None]
    )
    places = rolled.points_mm[::stride, ::stride][region].astype(np.float64)
    _, index = cKDTree(points.reshape(-1, 3)).query(places)
    normals = truth["body_normals"].reshape(-1, 3)[index]
    off = ((places - points.reshape(-1, 3)[index]) * normals).sum(axis=1)
    return round(float(np.sqrt((off**2).mean())), 3)


def _by_band(there: Any, seen: Any, known: Any, slant: Any) -> dict[str, float | None]:
    result: dict[str, float | None] = {}
    for low, high in BANDS_DEG:
        where = known & (slant >= low) & (slant < high)
        enough = int(where.sum()) > 500
        result[f"{low}-{high}"] = (
            round(float(np.corrcoef(there[where], seen[where])[0, 1]), 3) if enough else None
        )
    beyond = known & (slant >= 60)
    enough = int(beyond.sum()) > 500
    result["beyond 60"] = (
        round(float(np.corrcoef(there[beyond], seen[beyond])[0, 1]), 3) if enough else None
    )
    return result
