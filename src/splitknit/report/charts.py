"""Small charts as inline SVG: line profiles, bars and colour bars. No scripts, no external resources."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import NDArray

from splitknit.io.pictures import colour
from splitknit.model import FloatArray

INK = "#222222"
SERIES_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#8A8A8A")
"""Colour-blind safe; lines differ in dashes as well."""
_DASHES = ("", "5 3", "2 2", "8 3 2 3")


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """One curve of a chart; NaN interrupts it."""

    label: str
    x: NDArray[np.floating]
    y: NDArray[np.floating]


def line_chart(
    lines: Sequence[Line], x_label: str, y_label: str, *, size: tuple[int, int] = (400, 190), equal: bool = False
) -> Markup:
    """Draw curves over one pair of axes, `size` (width, height); `equal` gives both axes the same scale."""
    width, height = size
    left, right, top, bottom = 52, 10, 22, 36
    all_x = np.concatenate([line.x[np.isfinite(line.y)] for line in lines])
    all_y = np.concatenate([line.y[np.isfinite(line.y)] for line in lines])
    if all_x.size < 2:
        return Markup('<p class="note">Nothing to draw.</p>')
    x_low, x_high = float(all_x.min()), float(all_x.max())
    y_low, y_high = float(all_y.min()), float(all_y.max())
    y_low, y_high = y_low - 0.05 * (y_high - y_low), y_high + 0.05 * (y_high - y_low)
    x_scale = (width - left - right) / max(x_high - x_low, 1e-9)
    if equal:
        height = int(np.clip(x_scale * (y_high - y_low) + top + bottom, 130, 420))
    y_scale = (height - top - bottom) / max(y_high - y_low, 1e-9)

    def to_x(value: float) -> float:
        return left + (value - x_low) * x_scale

    def to_y(value: float) -> float:
        return height - bottom - (value - y_low) * y_scale

    parts = [open_svg(width, height, f"{y_label} against {x_label}")]
    for tick in round_ticks(x_low, x_high, 7):
        parts.append(segment((to_x(tick), top), (to_x(tick), height - bottom)))
        parts.append(text_at(to_x(tick), height - bottom + 13, f"{tick:g}", "middle"))
    for tick in round_ticks(y_low, y_high, 5):
        parts.append(segment((left, to_y(tick)), (width - right, to_y(tick))))
        parts.append(text_at(left - 5, to_y(tick) + 4, f"{tick:g}", "end"))
    parts.append(text_at((left + width - right) / 2, height - 5, x_label, "middle"))
    parts.append(text_at(4, 12, y_label, "start"))
    for k, line in enumerate(lines):
        stroke, dash = SERIES_COLOURS[k % len(SERIES_COLOURS)], _DASHES[k % len(_DASHES)]
        for piece in _pieces(line):
            points = " ".join(f"{to_x(float(x)):.1f},{to_y(float(y)):.1f}" for x, y in piece)
            parts.append(
                f'<polyline points="{points}" fill="none" stroke="{stroke}" stroke-width="1.5" '
                f'stroke-dasharray="{dash}"/>'
            )
    offset = float(width - right)
    for k, line in reversed(list(enumerate(lines))):
        stroke, dash = SERIES_COLOURS[k % len(SERIES_COLOURS)], _DASHES[k % len(_DASHES)]
        parts.append(text_at(offset, 12, line.label, "end"))
        offset -= 6.4 * len(line.label) + 8
        parts.append(segment((offset - 20, 8), (offset, 8), stroke, dash, 2))
        offset -= 32
    return Markup("".join(parts) + "</svg>")


def bar_chart(values: Sequence[float], labels: Sequence[str], unit: str = "", *, width: int = 200) -> Markup:
    """Horizontal bars from zero, each with its value."""
    finite = [abs(float(v)) for v in values if np.isfinite(v)]
    longest, row = max(finite, default=0.0), 15
    left = 10 + 7 * max((len(name) for name in labels), default=0)
    scale = (width - left - 50) / longest if longest > 0 else 0.0
    parts = [open_svg(width, row * len(values) + 4, "bar chart")]
    for k, (value, label) in enumerate(zip(values, labels, strict=True)):
        y = k * row + 3
        length = abs(float(value)) * scale if np.isfinite(value) else 0.0
        parts.append(text_at(left - 5, y + 10, label, "end"))
        parts.append(f'<rect x="{left}" y="{y}" width="{length:.1f}" height="12" fill="{SERIES_COLOURS[0]}"/>')
        parts.append(text_at(left + length + 4, y + 10, f"{float(value):.3g} {unit}".strip(), "start"))
    return Markup("".join(parts) + "</svg>")


def colour_bar(low: float, high: float, unit: str, *, diverging: bool = False, width: int = 220) -> Markup:
    """A bar that explains :func:`splitknit.io.pictures.colour`."""
    steps = 32
    shades = colour(np.linspace(0.0, 1.0, steps, dtype=np.float32)[None], 0.0, 1.0, diverging=diverging)[0]
    step = (width - 20) / steps
    parts = [open_svg(width, 30, f"colour scale from {low:g} to {high:g} {unit}")]
    for k, (r, g, b) in enumerate(shades):
        parts.append(
            f'<rect x="{10 + k * step:.2f}" y="2" width="{step + 0.4:.2f}" height="10" fill="rgb({r},{g},{b})" '
            'shape-rendering="crispEdges"/>'
        )
    parts.append(text_at(10, 25, f"{low:.3g}", "start"))
    parts.append(text_at(width / 2, 25, f"{(low + high) / 2:.3g} {unit}", "middle"))
    parts.append(text_at(width - 10, 25, f"{high:.3g}", "end"))
    return Markup("".join(parts) + "</svg>")


def line_through(
    field: FloatArray, input_from_upright: NDArray[np.float64], start: tuple[float, float], end: tuple[float, float]
) -> FloatArray:
    """Values of `field` (H, W) at about one sample a pixel from `start` to `end` (column, row of the upright frame)."""
    import cv2  # charts without data need no image library

    count = int(np.hypot(end[0] - start[0], end[1] - start[1])) + 2
    upright = np.stack([np.linspace(start[0], end[0], count), np.linspace(start[1], end[1], count), np.ones(count)])
    column, row = (input_from_upright @ upright)[:2].astype(np.float32)
    sampled = cv2.remap(
        field, column[None], row[None], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=(float("nan"),)
    )
    return np.asarray(sampled[0], dtype=np.float32)


def _pieces(line: Line) -> list[NDArray[np.float64]]:
    """Stretches without NaN, thinned to what a screen can show."""
    known = np.isfinite(line.y)
    step = max(1, int(known.sum()) // 1200)
    points = np.stack([line.x, line.y], axis=1).astype(np.float64)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], known, [False]]).astype(np.int8)))
    return [points[a:b:step] for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a > 1]


def round_ticks(low: float, high: float, count: int) -> list[float]:
    """Round values from `low` to `high`, about `count` of them."""
    span = high - low
    if not span > 0:
        return [low]
    step = 10.0 ** np.floor(np.log10(span / count))
    step *= next((m for m in (1, 2, 5, 10) if span / (m * step) <= count), 10)
    first = int(np.ceil(low / step - 1e-9))
    return [float(k * step) for k in range(first, int(np.floor(high / step + 1e-9)) + 1)]


def open_svg(width: float, height: float, title: str, font_px: int = 11) -> str:
    """Begin a chart; ``</svg>`` ends it."""
    return (
        f'<svg viewBox="0 0 {width:g} {height:g}" width="{width:g}" height="{height:g}" role="img" '
        f'aria-label="{escape(title)}" font-family="sans-serif" font-size="{font_px}" fill="{INK}">'
    )


def text_at(x: float, y: float, words: str, anchor: str) -> str:
    """A label of a chart."""
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(words)}</text>'


def segment(
    start: tuple[float, float], end: tuple[float, float], paint: str = "#e2e2e2", dash: str = "", width: float = 1
) -> str:
    """A straight line of a chart, by default one of its grid."""
    dashes = f' stroke-dasharray="{dash}"' if dash else ""
    return (
        f'<line x1="{start[0]:.1f}" y1="{start[1]:.1f}" x2="{end[0]:.1f}" y2="{end[1]:.1f}" stroke="{paint}" '
        f'stroke-width="{width:g}"{dashes}/>'
    )
