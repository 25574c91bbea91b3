"""Figures as SVG files: ROC curves over a logarithmic FAR, and rates over bins of a factor."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from tables import Row

from splitknit.evaluation.intervals import BootstrapSettings, bootstrap
from splitknit.evaluation.rates import roc
from splitknit.evaluation.scores import Scores
from splitknit.report.charts import Axis, Curve, line_chart, percent_marks, standalone
from splitknit.report.evaluation import roc_chart


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
