"""Charts as inline SVG: curves and points over two axes, bars, heat maps. No scripts, no external resources."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import NDArray

from splitknit.io.pictures import colour

Values = NDArray[np.float64]
_Points = Callable[[NDArray[np.floating] | float, NDArray[np.floating] | float], Values]
"""From values of x and y to pixels (..., 2)."""
_INK = "#222222"
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#8A8A8A", "#AA3377", "#B8860B")
"""Colour-blind safe; curves differ in dashes as well."""
_BOLD = ' font-weight="600"'
_GRID = "#e2e2e2"
_DASHES = ("", "6 3", "2 2", "9 3 2 3")
_WIDTH, _LEFT, _RIGHT, _TOP, _BOTTOM = 470, 58, 24, 12, 40


@dataclass(frozen=True, slots=True)
class Axis:
    """From values to 0 ... 1, with marks."""

    label: str
    low: float
    high: float
    marks: tuple[tuple[float, str], ...]
    scale: Callable[[Values], Values] = np.asarray

    def place(self, values: NDArray[np.floating] | float) -> Values:
        """Where values lie between the ends, those beyond on the ends."""
        inside = np.clip(np.asarray(values, dtype=np.float64), self.low, self.high)
        ends = self.scale(np.array([self.low, self.high]))
        return np.asarray((self.scale(inside) - ends[0]) / (ends[1] - ends[0]))


def axis_over(label: str, values: NDArray[np.floating], *, pad: float = 0.05) -> Axis:
    """An axis over all of `values`, and by the fraction `pad` further, with marks at round numbers."""
    low, high = float(values.min()), float(values.max())
    margin = pad * (high - low) or (0.0 if high > low else 0.1 * abs(high) or 1.0)
    low, high = low - margin, high + margin
    return Axis(label, low, high, tuple((v, f"{v:g}") for v in round_marks(low, high, 6)))


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """A line, interrupted by NaN, with, perhaps, a band."""

    label: str
    """In the legend; an empty one makes it a thin grey line for comparison."""
    x: NDArray[np.floating]
    y: NDArray[np.floating]
    band: tuple[Values, Values, Values] | None = None
    """x, low, high."""
    filled: bool = False
    """Whether the area beneath is tinted."""
    dots: bool = False
    """Whether its points are marked."""


def line_chart(curves: Sequence[Curve], x: Axis, y: Axis, *, title: str = "", height: int = 260) -> Markup:
    """Curves over two axes, with a legend of as many lines as it needs."""
    parts, points = _begin(x, y, title, height, [curve.label for curve in curves if curve.label])
    floor = points(x.low, y.low)[1]
    k = 0
    for curve in curves:
        if curve.label:
            parts += _drawn(curve, k, points, floor)
            k += 1
        else:
            start, end = points(curve.x, curve.y)
            parts.append(_segment(start, end, "#999999", "3 4"))
    return Markup("".join(parts) + "</svg>")


def profile_chart(curves: Sequence[Curve], x_label: str, y_label: str, *, equal: bool = False) -> Markup:
    """Curves over axes that hold all of their points; `equal` gives both axes the same scale."""
    all_x = np.concatenate([curve.x[np.isfinite(curve.y)] for curve in curves])
    all_y = np.concatenate([curve.y[np.isfinite(curve.y)] for curve in curves])
    if all_x.size < 2:
        return Markup('<p class="note">Nothing to draw.</p>')
    x, y, height = axis_over(x_label, all_x, pad=0.0), axis_over(y_label, all_y), 220
    if equal:
        scale = (_WIDTH - _LEFT - _RIGHT) / (x.high - x.low)
        height = int(np.clip(scale * (y.high - y.low), 80, 370)) + _TOP + _BOTTOM
    return line_chart(curves, x, y, height=height)


def _begin(x: Axis, y: Axis, title: str, height: int, legend: Sequence[str]) -> tuple[list[str], _Points]:
    """Begin a chart: parts of its SVG, and a function from values of x and y to pixels (..., 2)."""
    rows, first = _legend_rows(legend), _TOP + 20 * bool(title)
    top = first + 18 * len(rows) + 12
    height += top - _TOP
    wide, tall = _WIDTH - _LEFT - _RIGHT, height - top - _BOTTOM

    def points(xs: NDArray[np.floating] | float, ys: NDArray[np.floating] | float) -> Values:
        return np.stack([_LEFT + wide * x.place(xs), top + tall * (1 - y.place(ys))], axis=-1)

    parts = [_open(_WIDTH, height, title or f"{y.label} against {x.label}")]
    if title:
        parts.append(_text(6, 16, title, "start", _BOLD))
    for k, row in enumerate(rows):
        offset = float(_LEFT)
        for index, label, long in row:
            level = first + 18 * k
            parts.append(_segment((offset, level), (offset + 22, level), *_stroke(index), 2))
            parts.append(_text(offset + 27, level + 4, label, "start"))
            offset += long
    for value, words in x.marks:
        place = points(value, y.low)[0]
        parts.append(_segment((place, top), (place, height - _BOTTOM), _GRID))
        parts.append(_text(place, height - _BOTTOM + 15, words, "middle"))
    for value, words in y.marks:
        place = points(x.low, value)[1]
        parts.append(_segment((_LEFT, place), (_WIDTH - _RIGHT, place), _GRID))
        parts.append(_text(_LEFT - 5, place + 4, words, "end"))
    parts.append(_text(_LEFT + wide / 2, height - 6, x.label, "middle"))
    parts.append(_text(6, top - 9, y.label, "start"))
    return parts, points


def _stroke(k: int) -> tuple[str, str]:
    """Colour and dashes of the k-th curve."""
    return _COLOURS[k % len(_COLOURS)], _DASHES[k % len(_DASHES)]


def _drawn(curve: Curve, k: int, points: _Points, floor: float) -> list[str]:
    (paint, dash), parts = _stroke(k), []
    if curve.band is not None:
        at, low, high = curve.band
        around = np.concatenate([points(at, low), points(at, high)[::-1]])
        parts.append(f'<polygon points="{_written(around)}" fill="{paint}" fill-opacity="0.13"/>')
    dashes = f' stroke-dasharray="{dash}"' if dash else ""
    known = np.concatenate([[False], np.isfinite(curve.y), [False]])
    edges = np.flatnonzero(np.diff(known.astype(np.int8)))
    for start, end in edges.reshape(-1, 2):
        line = _thinned(points(curve.x[start:end], curve.y[start:end]))
        if curve.filled:
            parts.append(f'<polygon points="{_written(line)}" fill="{paint}" fill-opacity="0.2"/>')
        parts.append(f'<polyline points="{_written(line)}" fill="none" stroke="{paint}" stroke-width="1.6"{dashes}/>')
        if curve.dots:
            parts += [f'<circle cx="{cx:.1f}" cy="{cy:.1f}" r="2.6" fill="{paint}"/>' for cx, cy in line]
    return parts


def _thinned(points: Values) -> Values:
    """Points at least 0.4 px from the last one kept; the ends stay, and so do corners of a staircase that is coarse."""
    kept = [0]
    for k in range(1, len(points) - 1):
        if np.abs(points[k] - points[kept[-1]]).max() >= 0.4:
            kept.append(k)
    return points[[*kept, len(points) - 1]]


def _legend_rows(labels: Sequence[str]) -> list[list[tuple[int, str, float]]]:
    """Number, words and width of each entry of the legend, in rows that fit."""
    rows: list[list[tuple[int, str, float]]] = [[]] if labels else []
    used = 0.0
    for k, label in enumerate(labels):
        shown = label if len(label) <= 52 else label[:49] + "..."
        long = 40 + 6.6 * len(shown)
        if rows[-1] and used + long > _WIDTH - _LEFT:
            rows.append([])
            used = 0.0
        rows[-1].append((k, shown, long))
        used += long
    return rows


def round_marks(low: float, high: float, count: int) -> list[float]:
    """Round numbers from `low` to `high`, about `count` of them."""
    span = high - low
    if not span > 0:
        return [low]
    step = 10.0 ** np.floor(np.log10(span / count))
    step *= next((m for m in (1, 2, 5, 10) if span / (m * step) <= count), 10)
    first, last = int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9))
    return [float(k * step) for k in range(first, last + 1)]


def percent_marks(fractions: Iterable[float]) -> tuple[tuple[float, str], ...]:
    """Marks of an axis in percent, each as short as it can be."""
    return tuple((fraction, f"{100 * fraction:.6g} %") for fraction in fractions)


def bar_chart(values: Sequence[float]) -> Markup:
    """Horizontal bars from zero, numbered, each with its value."""
    finite = [abs(float(v)) for v in values if np.isfinite(v)]
    longest, row, width = max(finite, default=0.0), 15, 200
    left = 10 + 7 * len(str(max(0, len(values) - 1)))
    scale = (width - left - 50) / longest if longest > 0 else 0.0
    parts = [_open(width, row * len(values) + 4, "bar chart")]
    for k, value in enumerate(values):
        y = k * row + 3
        length = abs(float(value)) * scale if np.isfinite(value) else 0.0
        parts.append(_text(left - 5, y + 10, str(k), "end"))
        parts.append(f'<rect x="{left}" y="{y}" width="{length:.1f}" height="12" fill="{_COLOURS[0]}"/>')
        parts.append(_text(left + length + 4, y + 10, f"{float(value):.3g}", "start"))
    return Markup("".join(parts) + "</svg>")


def colour_bar(low: float, high: float, unit: str, *, diverging: bool = False) -> Markup:
    """A bar that explains :func:`splitknit.io.pictures.colour`."""
    steps, width = 32, 220
    shades = colour(np.linspace(0.0, 1.0, steps, dtype=np.float32)[None], 0.0, 1.0, diverging=diverging)[0]
    step = (width - 20) / steps
    parts = [_open(width, 30, f"colour scale from {low:g} to {high:g} {unit}")]
    for k, (r, g, b) in enumerate(shades):
        place = f'x="{10 + k * step:.2f}" y="2" width="{step + 0.4:.2f}" height="10"'
        parts.append(f'<rect {place} fill="rgb({r},{g},{b})" shape-rendering="crispEdges"/>')
    parts.append(_text(10, 25, f"{low:.3g}", "start"))
    parts.append(_text(width / 2, 25, f"{(low + high) / 2:.3g} {unit}", "middle"))
    parts.append(_text(width - 10, 25, f"{high:.3g}", "end"))
    return Markup("".join(parts) + "</svg>")


def standalone(chart: str) -> bytes:
    """The chart as an SVG file, on white."""
    text = str(chart)  # plain text first: the markup's own replace() would escape what is put in
    text = text.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1)
    return text.replace(">", '><rect width="100%" height="100%" fill="#ffffff"/>', 1).encode()


def _open(width: float, height: float, title: str) -> str:
    """Begin a chart."""
    size = f'viewBox="0 0 {width:g} {height:g}" width="{width:g}" height="{height:g}"'
    words = f'role="img" aria-label="{escape(title)}" font-family="sans-serif" font-size="11"'
    return f'<svg {size} {words} fill="{_INK}">'


def _text(x: float, y: float, words: str, anchor: str, style: str = "") -> str:
    """A label of a chart; `style` holds further attributes."""
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"{style}>{escape(words)}</text>'


def _segment(start: Iterable[float], end: Iterable[float], paint: str, dash: str = "", width: float = 1) -> str:
    """A straight line between two points (x, y)."""
    (x1, y1), (x2, y2) = start, end
    dashes = f' stroke-dasharray="{dash}"' if dash else ""
    line = f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}"'
    return f'{line} stroke="{paint}" stroke-width="{width:g}"{dashes}/>'


def _written(points: Values) -> str:
    return " ".join(f"{px:.1f},{py:.1f}" for px, py in points)
