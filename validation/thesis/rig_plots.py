"""Heat maps of rigs, as inline SVG."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup, escape

from splitknit.io.pictures import colour
from splitknit.report.charts import _BOLD, _COLOURS, _INK, _open, _text

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


def _frame(x: float, y: float, width: float, height: float, stroke: str) -> str:
    return f'<rect x="{x}" y="{y}" width="{width}" height="{height}" fill="none" stroke-width="2" {stroke}/>'
