"""Heat maps and scatters of rigs, as inline SVG."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import NDArray

from splitknit.io.pictures import colour
from splitknit.report.charts import _BOLD, _COLOURS, _INK, Axis, _axis_over, _begin, _open, _segment, _text

_BLACK_DASHES = 'stroke="#000000" stroke-dasharray="4 3"'
_HALO = ' paint-order="stroke" stroke="#ffffff" stroke-width="3" stroke-linejoin="round"'
"""Words stay legible over points."""
_STRIPES = (
    '<defs><pattern id="stripes" width="8" height="8" patternUnits="userSpaceOnUse" '
    'patternTransform="rotate(45)"><rect width="8" height="8" fill="#f4f4f4"/>'
    '<rect width="3" height="8" fill="#e0e0e0"/></pattern></defs>'
)


@dataclass(frozen=True, slots=True)
class Cell:
    """One rig in the heat map."""

    column: float
    row: float
    value: float | None
    """None where it was refused or failed."""
    note: str
    """Text of the cell instead of a value."""
    best: bool = False
    as_good: bool = False
    thesis: bool = False


@dataclass(frozen=True, slots=True)
class Dot:
    """One rig in a scatter or on an axis."""

    x: float
    y: float
    label: str = ""
    front: bool = False
    thesis: bool = False
    low: float | None = None
    high: float | None = None
    series: str = ""
    """In the legend; dots of one are joined by a line where none is on the front."""


def heat_map(cells: Sequence[Cell], x_label: str, y_label: str, unit: str, *, title: str = "") -> Markup:
    """A table of coloured cells: low values are dark, the best has a frame, those as good a dot, others stripes."""
    columns, rows = sorted({one.column for one in cells}), sorted({one.row for one in cells}, reverse=True)
    known = [one.value for one in cells if one.value is not None]
    low, high = (min(known), max(known)) if known else (0.0, 1.0)
    wide, tall, left, top = 76, 40, 64, 30
    half = 3.0 * len(y_label) + 4  # of the upright label, which few rows are too short for
    middle = max(top + tall * len(rows) / 2, half)
    width, height = max(left + wide * len(columns) + 12, left + 220), max(top + tall * len(rows) + 78, middle + half)
    parts = [_open(width, height, title or f"{y_label} against {x_label}"), _STRIPES]
    parts.append(_text(left, 16, title, "start", _BOLD))
    for one in cells:
        x, y = left + wide * columns.index(one.column), top + tall * rows.index(one.row)
        if one.value is None:
            fill, ink, words = "url(#stripes)", "#555555", one.note
        else:
            shade = colour(np.array([[one.value]], dtype=np.float32), low, max(high, low + 1e-9))[0, 0]
            red, green, blue = (int(part) for part in shade)
            fill = f"rgb({red},{green},{blue})"
            ink = "#ffffff" if 0.299 * red + 0.587 * green + 0.114 * blue < 130 else _INK
            words = f"{one.value:#.3g}".rstrip(".") + (" •" if one.as_good and not one.best else "")
        parts.append(
            f'<rect x="{x}" y="{y}" width="{wide}" height="{tall}" fill="{fill}" stroke="#ffffff" stroke-width="1.5"/>'
        )
        parts.append(
            _text(x + wide / 2, y + tall / 2 + 4, words, "middle", f' fill="{ink}"{_BOLD if one.best else ""}')
        )
    for one in cells:  # frames last: no neighbour covers them
        x, y = left + wide * columns.index(one.column), top + tall * rows.index(one.row)
        if one.best:
            parts.append(_frame(x + 2, y + 2, wide - 4, tall - 4, f'stroke="{_COLOURS[1]}"'))
        if one.thesis:
            inset = 6 if one.best else 2
            parts.append(_frame(x + inset, y + inset, wide - 2 * inset, tall - 2 * inset, _BLACK_DASHES))
    for k, value in enumerate(columns):
        parts.append(_text(left + wide * (k + 0.5), top + tall * len(rows) + 14, f"{value:g}", "middle"))
    for k, value in enumerate(rows):
        parts.append(_text(left - 6, top + tall * (k + 0.5) + 4, f"{value:g}", "end"))
    bottom = top + tall * len(rows)
    parts.append(_text(left + wide * len(columns) / 2, bottom + 30, x_label, "middle"))
    parts.append(
        f'<text x="14" y="{middle:.1f}" text-anchor="middle" transform="rotate(-90 14 {middle:.1f})">'
        f"{escape(y_label)}</text>"
    )
    parts.append(_text(left, bottom + 50, unit, "start"))
    parts.append(_text(left, bottom + 66, "orange: best; •: as good; dashed: the thesis's", "start"))
    return Markup("".join(parts) + "</svg>")


def _log_axis(label: str, values: NDArray[np.floating], *, pad: float) -> Axis:
    """A logarithmic axis over all of `values`, and by the fraction `pad` further, with marks at powers of ten."""
    ends = _axis_over(label, np.log10(values), pad=pad)
    marks = [10.0**k for k in range(int(np.ceil(ends.low)), int(np.floor(ends.high)) + 1)]
    return Axis(label, 10.0**ends.low, 10.0**ends.high, tuple((v, f"{v:.3g}") for v in marks), np.log10)


def scatter(dots: Sequence[Dot], x_label: str, y_label: str, *, title: str = "", log_x: bool = False) -> Markup:
    """Points over two axes; those on the front are filled, the thesis's has a ring; error bars where there are any."""
    own = sorted({dot.x for dot in dots})
    any_front = any(dot.front for dot in dots)
    x = (_log_axis if log_x else _axis_over)(x_label, np.array(own), pad=0.06)
    if len(own) <= 10 and not any_front:
        x = replace(x, marks=tuple((value, f"{value:.3g}") for value in own))
    y = _axis_over(
        y_label, np.array([v for dot in dots for v in (dot.y, dot.low, dot.high) if v is not None]), pad=0.06
    )
    series = list(dict.fromkeys(dot.series for dot in dots))
    legend = [name for name in series if name]
    parts, points = _begin(x, y, title, 258, legend)
    paints = {name: _COLOURS[k % len(_COLOURS)] for k, name in enumerate(series)}
    if not any_front:
        for name, paint in paints.items():
            along = sorted((dot.x, dot.y) for dot in dots if dot.series == name)
            line = " ".join(f"{px:.1f},{py:.1f}" for px, py in points(*np.array(along).T))
            parts.append(f'<polyline points="{line}" fill="none" stroke="{paint}" opacity="0.6"/>')
    places = [(*points(dot.x, dot.y), dot.label) for dot in dots]
    parts += _labels([place for place in places if place[2]], [place[:2] for place in places], points(x.high, y.low)[0])
    for dot in sorted(dots, key=lambda dot: dot.front):  # over the words' halos
        (px, py), paint = points(dot.x, dot.y), paints[dot.series]
        if dot.low is not None and dot.high is not None:
            parts.append(_segment(points(dot.x, dot.low), points(dot.x, dot.high), paint))
        solid = dot.front or not any_front
        fill = paint if solid else "#ffffff"
        parts.append(f'<circle cx="{px:.1f}" cy="{py:.1f}" r="{4 if solid else 3}" fill="{fill}" stroke="{paint}"/>')
        if dot.thesis:
            parts.append(f'<circle cx="{px:.1f}" cy="{py:.1f}" r="8" fill="none" {_BLACK_DASHES}/>')
    return Markup("".join(parts) + "</svg>")


def _labels(
    wanted: Sequence[tuple[float, float, str]], points: Sequence[tuple[float, float]], right: float
) -> list[str]:
    """Labels beside their points; one that would cover another, or a point, is left out."""
    taken = [(x - 4.0, x + 4.0, y + 4.0) for x, y in points]
    parts = []
    for x, y, words in wanted:
        long = 6.0 * len(words)
        sides = [start for start in (x + 8, x - 8 - long) if start >= 60 and start + long < right]
        for start, level in ((side, y + shift) for side in sides for shift in (4, -9, 17)):
            if all(abs(level - other) > 9 or start > end or start + long < begin for begin, end, other in taken):
                taken.append((start, start + long, level))
                parts.append(_text(start, level, words, "start", _HALO))
                break
    return parts


def _frame(x: float, y: float, width: float, height: float, stroke: str) -> str:
    return f'<rect x="{x}" y="{y}" width="{width}" height="{height}" fill="none" stroke-width="2" {stroke}/>'
