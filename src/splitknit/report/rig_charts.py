"""Charts of a sweep of rigs, as SVG: a heat map over height and radius, a scatter of the Pareto front, error bars."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup, escape

from splitknit.io.pictures import colour
from splitknit.report.charts import INK, SERIES_COLOURS

BLUE, ORANGE, GREEN, GREY = SERIES_COLOURS
BORDER = "#ffffff"


@dataclass(frozen=True, slots=True)
class Cell:
    """One rig in the heat map."""

    column: float
    row: float
    value: float | None
    """None where it was refused or failed."""
    note: str
    """What is said in the cell in the place of a value."""
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
    series: int = 0


def heat_map(cells: Sequence[Cell], x_label: str, y_label: str, unit: str, *, title: str = "") -> Markup:
    """A table of coloured cells: low values are dark, the best has a frame, those as good a dot, others stripes."""
    columns, rows = sorted({one.column for one in cells}), sorted({one.row for one in cells}, reverse=True)
    known = [one.value for one in cells if one.value is not None]
    low, high = (min(known), max(known)) if known else (0.0, 1.0)
    wide, tall, left, top = 76, 40, 64, 30
    half = 3.0 * len(y_label) + 4  # of the upright label, which few rows are too short for
    middle = max(top + tall * len(rows) / 2, half)
    width, height = max(left + wide * len(columns) + 12, left + 220), max(top + tall * len(rows) + 78, middle + half)
    parts = [_open(width, height, title or f"{y_label} against {x_label}"), _stripes()]
    parts.append(_text(left, 16, title, "start", bold=True))
    for one in cells:
        x, y = left + wide * columns.index(one.column), top + tall * rows.index(one.row)
        if one.value is None:
            fill, ink, words = "url(#stripes)", "#555555", one.note
        else:
            red, green, blue = _shade(one.value, low, high)
            fill = f"rgb({red},{green},{blue})"
            ink = "#ffffff" if 0.299 * red + 0.587 * green + 0.114 * blue < 130 else INK
            words = f"{one.value:#.3g}".rstrip(".") + (" •" if one.as_good and not one.best else "")
        parts.append(
            f'<rect x="{x}" y="{y}" width="{wide}" height="{tall}" fill="{fill}" stroke="{BORDER}" stroke-width="1.5"/>'
        )
        parts.append(_text(x + wide / 2, y + tall / 2 + 4, words, "middle", ink=ink, bold=one.best))
    for one in cells:  # frames last: no neighbour covers them
        x, y = left + wide * columns.index(one.column), top + tall * rows.index(one.row)
        if one.best:
            parts.append(_frame(x + 2, y + 2, wide - 4, tall - 4, paint=ORANGE))
        if one.thesis:
            inset = 6 if one.best else 2
            parts.append(_frame(x + inset, y + inset, wide - 2 * inset, tall - 2 * inset, paint="#000000", dash="4 3"))
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


def scatter(
    dots: Sequence[Dot], x_label: str, y_label: str, *, series: Sequence[str] = (), title: str = "", log_x: bool = False
) -> Markup:
    """Points over two axes; those on the front are filled, the thesis's has a ring; error bars where there are any.

    Points of a series are joined by a line where no series has a front.
    """
    width, height, left, right, top, bottom = 520, 300, 56, 16, 42, 42
    x_values = np.array([_place(dot.x, log_x) for dot in dots])
    y_values = np.array([v for dot in dots for v in (dot.y, dot.low, dot.high) if v is not None])
    x_low, x_high = _padded(float(x_values.min()), float(x_values.max()))
    y_low, y_high = _padded(float(y_values.min()), float(y_values.max()))

    def to_x(value: float) -> float:
        return left + (_place(value, log_x) - x_low) / (x_high - x_low) * (width - left - right)

    def to_y(value: float) -> float:
        return height - bottom - (value - y_low) / (y_high - y_low) * (height - top - bottom)

    parts = [_open(width, height, title or f"{y_label} against {x_label}"), _text(left, 14, title, "start", bold=True)]
    own = sorted({dot.x for dot in dots})
    marks = own if len(own) <= 10 and not any(dot.front for dot in dots) else _nice(x_low, x_high, log_x)
    for mark in marks:
        parts.append(_line(to_x(mark), top, to_x(mark), height - bottom, "#e2e2e2"))
        parts.append(_text(to_x(mark), height - bottom + 14, f"{mark:.3g}", "middle"))
    for mark in _nice(y_low, y_high, False):
        parts.append(_line(left, to_y(mark), width - right, to_y(mark), "#e2e2e2"))
        parts.append(_text(left - 5, to_y(mark) + 4, f"{mark:g}", "end"))
    parts.append(_text((left + width - right) / 2, height - 8, x_label, "middle"))
    parts.append(_text(4, 32, y_label, "start"))
    offset = float(width - right)
    for k, name in reversed(list(enumerate(series))):
        parts.append(_text(offset, 32, name, "end"))
        offset -= 6.2 * len(name) + 10
        parts.append(f'<circle cx="{offset:.1f}" cy="28" r="4" fill="{SERIES_COLOURS[k % 4]}"/>')
        offset -= 14
    if not any(dot.front for dot in dots):
        for k in sorted({dot.series for dot in dots}):
            along = sorted((dot for dot in dots if dot.series == k), key=lambda dot: dot.x)
            points = " ".join(f"{to_x(dot.x):.1f},{to_y(dot.y):.1f}" for dot in along)
            parts.append(f'<polyline points="{points}" fill="none" stroke="{SERIES_COLOURS[k % 4]}" opacity="0.6"/>')
    places = [(to_x(dot.x), to_y(dot.y), dot.label) for dot in dots]
    parts += _labels([place for place in places if place[2]], [place[:2] for place in places], width - right)
    for dot in sorted(dots, key=lambda dot: dot.front):  # over the words' halos
        x, y, paint = to_x(dot.x), to_y(dot.y), SERIES_COLOURS[dot.series % 4]
        if dot.low is not None and dot.high is not None:
            parts.append(_line(x, to_y(dot.low), x, to_y(dot.high), paint))
        solid = dot.front or not any(one.front for one in dots)
        fill = paint if solid else "#ffffff"
        parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{4 if solid else 3}" fill="{fill}" stroke="{paint}"/>')
        if dot.thesis:
            parts.append(
                f'<circle cx="{x:.1f}" cy="{y:.1f}" r="8" fill="none" stroke="#000000" stroke-dasharray="4 3"/>'
            )
    return Markup("".join(parts) + "</svg>")


def standalone(chart: Markup) -> bytes:
    """The chart as an SVG file."""
    text = str(chart)  # plain text first: the markup's own replace() would escape what is put in
    return text.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1).encode()


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
                parts.append(_text(start, level, words, "start", halo=True))
                break
    return parts


def _shade(value: float, low: float, high: float) -> tuple[int, int, int]:
    shades = colour(np.array([[value]], dtype=np.float32), low, max(high, low + 1e-9))[0, 0]
    return int(shades[0]), int(shades[1]), int(shades[2])


def _padded(low: float, high: float) -> tuple[float, float]:
    margin = 0.06 * (high - low) or 0.1 * abs(high) or 1.0
    return low - margin, high + margin


def _place(value: float, log: bool) -> float:
    return float(np.log10(value)) if log else value


def _nice(low: float, high: float, log: bool) -> list[float]:
    """Round numbers between two limits (logarithms of the limits where `log`)."""
    if log:
        return [10.0**k for k in range(int(np.ceil(low)), int(np.floor(high)) + 1)]
    step = 10.0 ** np.floor(np.log10((high - low) / 5))
    step *= next((m for m in (1, 2, 5, 10) if (high - low) / (m * step) <= 6), 10)
    return [round(k * step, 10) for k in range(int(np.ceil(low / step)), int(np.floor(high / step)) + 1)]


def _open(width: float, height: float, title: str) -> str:
    return (
        f'<svg viewBox="0 0 {width:g} {height:g}" width="{width:g}" height="{height:g}" role="img" '
        f'aria-label="{escape(title)}" font-family="sans-serif" font-size="11" fill="{INK}">'
        f'<rect width="{width:g}" height="{height:g}" fill="#ffffff"/>'
    )


def _stripes() -> str:
    return (
        '<defs><pattern id="stripes" width="8" height="8" patternUnits="userSpaceOnUse" '
        'patternTransform="rotate(45)"><rect width="8" height="8" fill="#f4f4f4"/>'
        '<rect width="3" height="8" fill="#e0e0e0"/></pattern></defs>'
    )


def _text(
    x: float, y: float, words: str, anchor: str, *, ink: str = INK, bold: bool = False, halo: bool = False
) -> str:
    weight = ' font-weight="600"' if bold else ""
    if halo:  # words stay legible over points
        weight += ' paint-order="stroke" stroke="#ffffff" stroke-width="3" stroke-linejoin="round"'
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{ink}"{weight}>{escape(words)}</text>'


def _line(x1: float, y1: float, x2: float, y2: float, paint: str) -> str:
    return f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="{paint}"/>'


def _frame(x: float, y: float, width: float, height: float, *, paint: str, dash: str = "") -> str:
    return (
        f'<rect x="{x}" y="{y}" width="{width}" height="{height}" fill="none" stroke="{paint}" stroke-width="2" '
        f'stroke-dasharray="{dash}"/>'
    )
