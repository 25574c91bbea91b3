"""Figures as SVG files: ROC curves over a logarithmic FAR, rates over bins of a factor, lines and
bars."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from splitknit_match.evaluation.curves import chart, draw_roc, percent
from splitknit_match.evaluation.intervals import BootstrapSettings, bootstrap
from splitknit_match.evaluation.scores import Scores
from tables import Row

PAINTS = ("#D55E00", "#0072B2", "#F0B895", "#99C7E0")
"""EA and SnK here, EA and SnK in the thesis."""


def save(picture: bytes, file: Path) -> None:
    """Write a chart as a file of its own."""
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(picture)


def roc_figure(
    curves: Sequence[tuple[str, Scores]],
    settings: BootstrapSettings,
    published: Sequence[tuple[str, float, float]] = (),
    banded: int = 2,
) -> bytes:
    """ROC of several trials; the first `banded` with the band of a bootstrap by finger;
    `published`: the thesis's points, each a name, FAR and GAR."""
    drawn: list[tuple[str, Scores, Any]] = [(name, scores, None) for name, scores in curves]
    for place, (name, scores) in enumerate(curves[:banded]):
        intervals = bootstrap(scores, "finger", settings)
        drawn[place] = (
            name,
            scores,
            (intervals.curve_far, intervals.curve_low, intervals.curve_high),
        )

    def draw(ax: Any) -> None:
        for k, (name, far, gar) in enumerate(published):
            side, away = (("left", 6), ("right", -6))[k % 2]
            ax.plot(far, gar, "x", color="black", markersize=8)
            ax.annotate(
                name, (far, gar), (away, -8), textcoords="offset points", fontsize=7, ha=side
            )
        draw_roc(ax, drawn)
        lowest = min((0.2 * far for _, far, _ in published), default=1.0)
        ax.set_xlim(left=min(lowest, ax.get_xlim()[0]))

    return chart(draw)


def bins_figure(
    series: Sequence[tuple[str, Sequence[Row]]], figure: str, x_label: str, y_label: str
) -> bytes:
    """A rate over the mean of a factor in each bin, with the interval of the first and last series
    as a band."""
    known = {name: [row for row in rows if row[figure] is not None] for name, rows in series}
    if not any(known.values()):
        return b""

    def draw(ax: Any) -> None:
        for name, rows in known.items():
            x = [row["mean_factor"] for row in rows]
            (line,) = ax.plot(
                x, [row[figure] for row in rows], marker="o", markersize=3, label=name
            )
            if name in (series[0][0], series[-1][0]):
                low, high = ([row[figure + end] for row in rows] for end in ("_low", "_high"))
                ax.fill_between(x, low, high, color=line.get_color(), alpha=0.15, linewidth=0)
        ax.set(xlabel=x_label, ylabel=y_label)
        percent(ax.yaxis)
        ax.legend()

    return chart(draw)


def lines_figure(
    lines: Sequence[tuple[str, Any, Any]], x_label: str, y_label: str, **axes: Any
) -> bytes:
    """Curves (name, x, y); `axes`: further properties of matplotlib's axes."""

    def draw(ax: Any) -> None:
        for name, x, y in lines:
            ax.plot(x, y, label=name)
        ax.set(xlabel=x_label, ylabel=y_label, **axes)
        ax.legend()

    return chart(draw)


def bars_figure(
    groups: Sequence[tuple[str, Sequence[tuple[str, float, tuple[float, float] | None]]]],
) -> bytes:
    """Upright bars in groups: of each a label and bars of a name, a percentage (NaN where too few
    impostors support it) and the ends of its interval."""
    names = dict.fromkeys(name for _, bars in groups for name, *_ in bars)

    def draw(ax: Any) -> None:
        for name, paint in zip(names, PAINTS, strict=False):
            for place, (_, bars) in enumerate(groups):
                for offset, (of_bar, value, ends) in enumerate(bars):
                    if of_bar == name:
                        errors = None if ends is None else [[value - ends[0]], [ends[1] - value]]
                        x = place + 0.2 * offset
                        ax.bar(
                            x,
                            value,
                            0.18,
                            color=paint,
                            yerr=errors,
                            label=name if place == 0 else None,
                        )
                        words = "too\nfew" if np.isnan(value) else f"{value:.1f}"
                        ax.annotate(words, (x, 2.0), ha="center", fontsize=7)
        ax.set_xticks(np.arange(len(groups)) + 0.3, [label for label, _ in groups])
        ax.set(xlim=(-0.2, len(groups) - 0.2), ylim=(0, 100), ylabel="%")
        ax.legend(ncols=2, loc="upper left", bbox_to_anchor=(0, 1.25))

    return chart(draw, wide=6.0)
