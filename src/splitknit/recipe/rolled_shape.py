"""The finger between its mirrors as a smooth body: where it lies, and its chart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from splitknit.mirrors.body import Body
from splitknit.mirrors.rolled import Chart, chart_over
from splitknit.recipe.rolled_body import radius_of, rolled_pad

Array = NDArray[np.float64]

SHAPE_PITCH_MM = 0.25
"""Of the chart on which the smooth finger is kept."""
FAN_DEG = 75.0
"""How far the chart bends over the tip."""
BELOW_MM = 4.0
"""The chart goes on below what the outlines show: light from there matters."""
AROUND_DEG = 172.0
STATIONS = 60


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """A smooth finger on a chart all around it."""

    chart: Chart
    radius_mm: Array
    """(n, m)."""
    half_mm: float
    """Half its typical breadth."""


def shape_of(body: Body) -> Shape:
    """A body on a chart whose axis runs through its sections' middles."""
    u = body.tip_mm - body.length_mm * np.linspace(0.1, 1.0, STATIONS)
    sections = body.sections(u)
    half = float(np.median(sections.a))
    cap = min(half, 0.6 * body.length_mm)
    along, right = np.array([*body.axis, 0.0]), np.array([*body.across, 0.0])
    axes = np.stack([right, along, [0.0, 0.0, 1.0]])
    centre = np.array([*body.origin_mm, float(np.median(sections.z))])
    centre = centre + (body.tip_mm - cap) * along + float(np.median(sections.t)) * right
    lengths = (cap - body.length_mm - BELOW_MM, float(cap * np.deg2rad(FAN_DEG)))
    chart = chart_over(centre, axes, (-AROUND_DEG, AROUND_DEG), lengths, cap, SHAPE_PITCH_MM, cap)
    radius = radius_of(body, chart)
    return Shape(chart, radius + rolled_pad(body, chart, radius), half)
