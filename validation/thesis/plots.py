"""Figures as SVG files: ROC curves over a logarithmic FAR, and rates over bins of a factor."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np

from splitknit.report.charts import Axis, Curve, line_chart, percent_marks, standalone
from splitknit_match.evaluation.intervals import BootstrapSettings, bootstrap
from splitknit_match.evaluation.page import roc_chart
from splitknit_match.evaluation.rates import roc
from splitknit_match.evaluation.scores import Scores
from tables import Row

PAINTS = ("#D55E00", "#0072B2", "#F0B895", "#99C7E0")
"""EA and SnK here, EA and SnK in the thesis."""


def save(chart: str, file: Path) -> None:
    """Write a chart as a file of its own."""
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(standalone(chart))


def roc_figure(curves: Sequence[tuple[str, Scores]], settings: BootstrapSettings, banded: int = 2) -> str:
    """ROC of several trials; the first `banded` with the band of a bootstrap by finger."""
    drawn = []
    for k, (name, scores) in enumerate(curves):
        band = None
        if k < banded:
            found = bootstrap(scores, "finger", settings)
            band = (found.curve_far, found.curve_low, found.curve_high)
        drawn.append((name, roc(scores.genuine, scores.impostor), band))
    impostors = min(int(np.sum(~scores.label)) for _, scores in curves)
    return str(roc_chart(drawn, 10.0 ** np.ceil(np.log10(1.0 / impostors) - 1e-9)))


def bins_figure(series: Sequence[tuple[str, Sequence[Row]]], figure: str, x_label: str, y_label: str) -> str:
    """A rate over the mean of a factor in each bin, with the interval of the first and last series as a band."""
    curves, lowest, xs = [], 1.0, []
    for name, rows in series:
        known = [row for row in rows if row[figure] is not None]
        if not known:
            continue
        x = np.array([row["mean_factor"] for row in known])
        y, low, high = (np.array([row[figure + end] for row in known]) for end in ("", "_low", "_high"))
        curves.append(Curve(name, x, y, (x, low, high) if name in (series[0][0], series[-1][0]) else None, dots=True))
        lowest, xs = min(lowest, float(low.min())), [*xs, *x]
    if not curves:
        return ""
    floor = float(np.floor(lowest * 10) / 10)
    ends = float(min(xs)), float(max([*xs, min(xs) + 1e-6]))
    step = next(s for s in (0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 100) if (ends[1] - ends[0]) / s <= 9)
    marks = np.arange(np.ceil(ends[0] / step), np.floor(ends[1] / step) + 1) * step
    y_marks = np.arange(round(floor * 10), 11, 2 if floor < 0.45 else 1) / 10
    axes = (
        Axis(x_label, *ends, tuple((float(v), f"{v:g}") for v in np.round(marks, 6))),
        Axis(y_label, floor, 1.0, percent_marks(map(float, y_marks))),
    )
    return str(line_chart(curves, *axes, title=f"{y_label} over {x_label}"))


def bars_figure(groups: Sequence[tuple[str, Sequence[tuple[str, float, tuple[float, float] | None]]]]) -> str:
    """Upright bars in groups: of each a label and bars of a name, a percentage and the ends of its interval."""
    names = dict.fromkeys(name for _, bars in groups for name, *_ in bars)
    colours = dict(zip(names, PAINTS, strict=False))
    wide, high, left, top, foot = 34, 220, 46, 34, 26
    step = (len(colours) + 1) * wide
    width, floor = left + step * len(groups) + 10, top + high
    parts = [
        f'<svg viewBox="0 0 {width} {floor + foot}" width="{width}" height="{floor + foot}" role="img" '
        'aria-label="bars" font-family="sans-serif" font-size="11" fill="#222222">'
    ]
    for k, (name, paint) in enumerate(colours.items()):
        parts += [_bar(left + 118 * k, 8, 11, 11, paint), _words(left + 118 * k + 16, 18, name, "start")]
    for mark in range(0, 101, 20):
        parts += [_bar(left, floor - high * mark / 100, width - left - 10, 0.5, "#bbbbbb")]
        parts += [_words(left - 5, floor - high * mark / 100 + 4, f"{mark} %", "end")]
    for k, (label, bars) in enumerate(groups):
        for n, (name, value, ends) in enumerate(bars):
            x, y = left + k * step + wide * (n + 0.5), floor - high * value / 100
            parts += [
                _bar(x, y, wide - 4, floor - y, colours[name]),
                _words(x + 15, floor - 5, f"{value:.1f}", "middle"),
            ]
            if ends is not None:
                below, above = (floor - high * end / 100 for end in ends)
                parts.append(_bar(x + 14, above, 1.5, below - above, "#000000"))
        parts.append(_words(left + (k + 0.5) * step, floor + 17, label, "middle"))
    return "".join(parts) + "</svg>"


def _bar(x: float, y: float, width: float, height: float, paint: str) -> str:
    return f'<rect x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}" fill="{paint}"/>'


def _words(x: float, y: float, words: str, anchor: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape(words)}</text>'
