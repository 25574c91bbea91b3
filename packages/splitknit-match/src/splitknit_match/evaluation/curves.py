"""Curves of an evaluation as SVG files, by matplotlib: the same bytes for the same scores."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from splitknit.errors import importing
from splitknit_match.evaluation.rates import Roc, Values, roc
from splitknit_match.evaluation.scores import Scores

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#8A8A8A", "#AA3377", "#B8860B")  # colour-blind safe
Band = tuple[Values, Values, Values]
"""FAR, and the limits of the GAR there."""
_STYLE = {
    "svg.hashsalt": "splitknit",
    "font.family": "DejaVu Sans",  # comes with matplotlib
    "font.size": 9,
    "axes.grid": True,
    "axes.prop_cycle": f"cycler('color', {list(COLOURS)})",
    "grid.color": "#e2e2e2",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
}


def chart(draw: Callable[..., None], wide: float = 4.9, high: float = 3.2, count: int = 1) -> bytes:
    """An SVG file of what `draw` puts on axes, three beside each other where there are `count`;
    sizes of each in inches, words as outlines. Raises BadInput without matplotlib.
    """
    with importing(
        "curves need matplotlib: python -m pip install 'splitknit-match[plot]', or make install"
        " EXTRAS=plot."
    ):
        import matplotlib
        from matplotlib.figure import Figure
    stream = io.BytesIO()
    columns, rows = min(count, 3), -(-count // 3)
    with matplotlib.rc_context():  # whatever the user's own style
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(_STYLE)
        figure = Figure((wide * columns, high * rows), layout="constrained")
        axes = figure.subplots(rows, columns, squeeze=False).ravel()
        for ax in axes[count:]:
            ax.set_axis_off()
        draw(*axes[:count])
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    return stream.getvalue()


def percent(axis: Any) -> None:
    """Write an axis's fractions in percent."""
    from matplotlib.ticker import FuncFormatter

    axis.set_major_formatter(FuncFormatter(lambda fraction, place: f"{100 * fraction:.6g} %"))


def draw_roc(ax: Any, curves: Sequence[tuple[str, Scores, Band | None]]) -> None:
    """GAR over FAR, the latter on a logarithmic axis down to one impostor, with bands of FAR, low
    and high GAR."""
    lowest = 1.0 / max(2, *(scores.impostor.size for _, scores, _ in curves))
    for name, scores, band in curves:
        curve = _corners(roc(scores.genuine, scores.impostor))
        (line,) = ax.step(*curve, where="post", label=name)
        if band is not None:
            ax.fill_between(*band, color=line.get_color(), alpha=0.15, linewidth=0)
    ax.set(xscale="log", xlim=(lowest, 1.0), xlabel="FAR", ylabel="GAR")
    ax.set_ylim(top=1.005)
    percent(ax.xaxis)
    percent(ax.yaxis)
    ax.legend()


def draw_det(ax: Any, curves: Sequence[tuple[str, Scores, Band | None]]) -> None:
    """FRR over FAR on probit axes: two normal distributions give a straight line; grey is where
    both are equal; with bands as :func:`draw_roc`."""
    from scipy.special import ndtr, ndtri

    ends = np.array([1e-5, 0.99])
    ax.plot(ends, ends, color="#999999", linestyle=":")
    for name, scores, band in curves:
        far, gar = _corners(roc(scores.genuine, scores.impostor))
        (line,) = ax.step(np.clip(far, *ends), np.clip(1.0 - gar, *ends), where="post", label=name)
        if band is not None:
            limits = (np.clip(1.0 - gars, *ends) for gars in band[1:])
            x = np.clip(band[0], *ends)
            ax.fill_between(x, *limits, color=line.get_color(), alpha=0.15, linewidth=0)
    ticks = [1e-5, 1e-4, 1e-3, 0.01, 0.05, 0.2, 0.5, 0.8, 0.95]
    for set_scale, axis in ((ax.set_xscale, ax.xaxis), (ax.set_yscale, ax.yaxis)):
        set_scale("function", functions=(lambda rate: ndtri(np.clip(rate, 1e-9, 1 - 1e-9)), ndtr))
        axis.set_ticks(ticks)
        percent(axis)
    ax.set(xlim=ends, ylim=ends, xlabel="FAR", ylabel="FRR")
    ax.tick_params(axis="x", labelrotation=45)
    ax.legend()


def draw_scores(ax: Any, scores: Scores) -> None:
    """Histograms of both classes, and the threshold of equal errors."""
    sides = [side[~np.isnan(side)] for side in (scores.genuine, scores.impostor)]
    edges = np.histogram_bin_edges(np.concatenate(sides), 60)
    for side, name in zip(sides, ("genuine", "impostor"), strict=True):
        ax.hist(
            side,
            edges,
            weights=np.full(side.size, 1.0 / side.size),
            histtype="stepfilled",
            alpha=0.4,
            label=name,
        )
    threshold = roc(scores.genuine, scores.impostor).equal_error().threshold
    if threshold is not None:
        ax.axvline(threshold, color="#222222", linestyle=":", label="EER")
    ax.set(title=scores.name, xlabel="score", ylabel="fraction of its class")
    percent(ax.yaxis)
    ax.legend()


def _corners(curve: Roc) -> tuple[Values, Values]:
    """FAR and GAR where the GAR is about to change or has changed: all that a staircase needs."""
    far, gar = curve.far, curve.gar
    change = np.flatnonzero(np.diff(gar))
    places = np.unique(np.concatenate([[0], change, change + 1, [gar.size - 1]]))
    return far[places], gar[places]
