"""The folder of an evaluation: one HTML page that needs nothing else, and the same facts as JSON."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray
from scipy.special import ndtri

from splitknit.evaluation.facts import Result
from splitknit.evaluation.rates import Histograms, Roc, histograms, roc
from splitknit.evaluation.study import FORMAT, EvaluationSettings, evaluate_scores
from splitknit.io.atomic import atomic_folder
from splitknit.io.provenance import json_text
from splitknit.io.targets import check_target
from splitknit.model import Progress, no_progress
from splitknit.report import render
from splitknit.report.charts import SERIES_COLOURS, open_svg, round_ticks, segment, text_at

if TYPE_CHECKING:
    from splitknit.evaluation.gallery_scores import GalleryScores


def evaluate_to_folder(
    files: Sequence[Path],
    out: Path,
    settings: EvaluationSettings,
    *,
    exclusions: Path | None = None,
    gallery: GalleryScores | None = None,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Evaluate score files and write the report; or the scores of the gallery that `files` names, and write them too.

    Raises
    ------
    BadInput
        If a file cannot be used; nothing is written then.
    """
    check_target(out, "report.json", "an earlier evaluation", form=FORMAT)
    found = evaluate_scores(files, settings, exclusions=exclusions, gallery=gallery, progress=progress)
    progress("report", 1.0)
    html = _page(found.facts, found.results)
    with atomic_folder(out) as folder:
        for name, data in found.tables.items():
            (folder / name).write_bytes(data)
        (folder / "report.html").write_text(html, encoding="utf-8")
        (folder / "report.json").write_text(json_text(found.facts), encoding="utf-8")
    return found.facts


DRAWN_BY = {"plain": "comparisons", "finger": "fingers", "subject": "subjects"}


def _page(facts: Mapping[str, Any], results: Sequence[Result]) -> str:
    """Return the report of `facts`; the charts come from the scores themselves."""
    systems = facts["systems"]
    bootstrap = systems[facts["system"]]["bootstrap"]
    return render(
        "evaluation.html",
        facts=facts,
        systems=systems,
        first=systems[facts["system"]],
        targets=list(facts["gar_at_far"]),
        bootstrap=bootstrap,
        confidence=f"{100 * bootstrap['confidence']:g} %",
        drawn_by=DRAWN_BY,
        pictures=_pictures(results, systems),
        turned=facts["settings"]["dissimilarity"],
        rate=_rate,
        interval=interval,
        change=_change,
        number=_number,
        far=lambda key: f"{100 * float(key):g} %",
    )


def _rate(value: float | None) -> str:
    """A fraction in percent: two decimals, more where it is small."""
    if value is None:
        return "-"
    hundred = 100 * value
    if hundred != 0 and abs(hundred) < 0.1:
        return f"{hundred:.2g} %"
    return f"{hundred:.2f} %"


def interval(found: Mapping[str, float] | None) -> str:
    """A fraction with its interval."""
    if found is None:
        return "-"
    return f"{_rate(found['value'])} ({_bare(found['low'])} to {_bare(found['high'])})"


def _change(found: Mapping[str, float]) -> str:
    """A difference of fractions in percentage points, with its interval."""
    return f"{100 * found['value']:+.2f} ({100 * found['low']:+.2f} to {100 * found['high']:+.2f})"


def _number(found: Mapping[str, float] | None, decimals: int = 3) -> str:
    """A plain number with its interval."""
    if found is None:
        return "-"
    return f"{found['value']:.{decimals}f} ({found['low']:.{decimals}f} to {found['high']:.{decimals}f})"


def _bare(value: float) -> str:
    return _rate(value).removesuffix(" %")


def _pictures(results: Sequence[Result], systems: Mapping[str, Any]) -> dict[str, list[Markup]]:
    """ROC and DET of all systems together, a histogram each, and the CMC where there is one."""
    curves, bands = [], []
    most = 1
    for result in results:
        scores = result.scores
        curve = roc(scores.genuine, scores.impostor)
        facts = systems[scores.name]
        far, low, high = (np.array(facts["roc"][name]) for name in ("far", "low", "high"))
        band = (far, low, high) if far.size else None
        curves.append((scores.name, curve))
        bands.append((scores.name, curve, band if len(results) <= 3 else None))
        most = max(most, int(np.sum(~scores.label)))
    lowest = float(np.clip(1.0 / most, 1e-7, 1e-2))
    found = [(name, np.array(one["cmc"]["rate"])) for name, one in systems.items() if one["cmc"] is not None]
    return {
        "rates": [roc_chart(bands, lowest), _det_chart(curves, lowest)],
        "histograms": [
            _histogram_chart(
                result.scores.name,
                histograms(result.scores.genuine, result.scores.impostor),
                systems[result.scores.name]["equal_error"]["threshold"],
            )
            for result in results
        ],
        "cmc": [_cmc_chart(found)] if found else [],
    }


# Charts of an evaluation as inline SVG: ROC, DET, score histograms, CMC.

Values = NDArray[np.float64]
COLOURS = (*SERIES_COLOURS, "#AA3377", "#B8860B")
DASHES = ("", "6 3", "2 2", "9 3 2 3")
WIDTH, LEFT, RIGHT, TOP, BOTTOM = 470, 58, 24, 12, 40
PROBIT_TICKS = (1e-5, 1e-4, 1e-3, 0.01, 0.05, 0.2, 0.5, 0.8, 0.95, 0.99)


@dataclass(frozen=True, slots=True)
class Axis:
    """From values to 0 ... 1, with marks."""

    label: str
    low: float
    high: float
    marks: tuple[tuple[float, str], ...]
    scale: Callable[[Values], Values] = np.asarray

    def place(self, values: Values | float) -> Values:
        """Where values lie between the ends, those beyond on the ends."""
        inside = np.clip(np.asarray(values, dtype=np.float64), self.low, self.high)
        ends = self.scale(np.array([self.low, self.high]))
        return np.asarray((self.scale(inside) - ends[0]) / (ends[1] - ends[0]))


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """A line with, perhaps, a band."""

    label: str
    x: Values
    y: Values
    band: tuple[Values, Values, Values] | None = None
    """x, low, high."""
    filled: bool = False
    """Whether the area beneath is tinted."""


def roc_chart(curves: Sequence[tuple[str, Roc, tuple[Values, Values, Values] | None]], lowest: float) -> Markup:
    """GAR over FAR, the latter on a logarithmic axis down to `lowest`, with bands of FAR, low and high GAR."""
    marks = tuple((10.0**k, short_percent(10.0**k)) for k in range(int(np.ceil(np.log10(lowest) - 1e-9)), 1))
    drawn = [Curve(name, *_stairs(roc.far, roc.gar), band) for name, roc, band in curves]
    least = min(float(curve.y[curve.x <= lowest].max()) for curve in drawn)
    floor = float(np.floor(min(least, 0.9) * 10) / 10)
    y_marks = tuple((v, short_percent(v)) for v in round_ticks(floor, 1.0, 6))
    x = Axis("FAR (log), fraction of impostors accepted", lowest, 1.0, marks, np.log10)
    return plot_curves(
        drawn, x, Axis("GAR", floor, 1.0, y_marks), height=300, title="ROC: genuine accept rate over FAR"
    )


def _det_chart(curves: Sequence[tuple[str, Roc]], lowest: float) -> Markup:
    """FRR over FAR on probit axes, on which two normal distributions give a straight line."""
    worst = max(float(np.min(np.maximum(roc.far, roc.frr))) for _, roc in curves)
    high = next(tick for tick in (0.5, 0.8, 0.95, 0.99, 0.999) if tick > worst or tick == 0.999)
    low = min(0.01, max((tick for tick in PROBIT_TICKS if tick <= max(lowest, 1e-5)), default=1e-5))
    marks = tuple((tick, short_percent(tick)) for tick in PROBIT_TICKS if low <= tick <= high)
    drawn = [Curve(name, *_stairs(roc.far, roc.frr)) for name, roc in curves]
    axes = (Axis(label, low, high, marks, ndtri) for label in ("FAR (probit)", "FRR"))
    return plot_curves(drawn, *axes, height=360, title="DET: false reject rate over FAR", diagonal=True)


def _histogram_chart(name: str, fractions: Histograms, threshold: float | None) -> Markup:
    """Fractions of genuine and impostor scores in each bin, and where both rates are equal."""
    edges = np.repeat(fractions.edges, 2)
    drawn = [
        Curve(label, edges, np.concatenate([[0.0], np.repeat(side, 2), [0.0]]), filled=True)
        for label, side in (("genuine", fractions.genuine), ("impostor", fractions.impostor))
    ]
    top = max(float(fractions.genuine.max()), float(fractions.impostor.max()))
    steps = round_ticks(0.0, top, 5)
    x_marks = tuple((v, f"{v:g}") for v in round_ticks(float(edges[0]), float(edges[-1]), 7))
    x = Axis("score", float(edges[0]), float(edges[-1]), x_marks)
    y = Axis("fraction of its class", 0.0, max(top * 1.05, 1e-9), tuple((v, short_percent(v)) for v in steps))
    return plot_curves(drawn, x, y, height=240, title=f"Scores of {name}", upright=threshold)


def _cmc_chart(curves: Sequence[tuple[str, Values]]) -> Markup:
    """Fraction of probes whose finger is among the first n of the gallery."""
    longest = max(2, min(20, max(rate.size for _, rate in curves)))
    floor = float(np.floor(min([*(float(rate[0]) for _, rate in curves), 0.95]) * 10) / 10)
    drawn = [Curve(name, np.arange(1.0, 1 + rate[:20].size), rate[:20]) for name, rate in curves]
    x = Axis("rank", 1.0, float(longest), tuple((float(k), str(k)) for k in _whole_marks(longest)))
    y = Axis("found", floor, 1.0, tuple((v, short_percent(v)) for v in round_ticks(floor, 1.0, 6)))
    return plot_curves(drawn, x, y, height=260, title="CMC: identification among all", dots=True)


def plot_curves(
    curves: Sequence[Curve],
    x: Axis,
    y: Axis,
    *,
    height: int,
    title: str,
    diagonal: bool = False,
    upright: float | None = None,
    dots: bool = False,
) -> Markup:
    """Curves over two axes, with a legend of as many lines as it needs."""
    rows = _legend_rows([curve.label for curve in curves])
    top = TOP + 18 * len(rows) + 12
    height += top - TOP
    wide, tall = WIDTH - LEFT - RIGHT, height - top - BOTTOM

    def points(xs: Values, ys: Values) -> Values:
        return np.stack([LEFT + wide * x.place(xs), top + tall * (1 - y.place(ys))], axis=1)

    parts = [open_svg(WIDTH, height, title, 12)]
    for k, row in enumerate(rows):
        offset = float(LEFT)
        for index, label, long in row:
            level = TOP + 18 * k
            parts.append(segment((offset, level), (offset + 22, level), COLOURS[index % 6], DASHES[index % 4], 2))
            parts.append(text_at(offset + 27, level + 4, label, "start"))
            offset += long
    for value, words in x.marks:
        place = LEFT + wide * float(x.place(value))
        parts.append(segment((place, top), (place, height - BOTTOM)))
        parts.append(text_at(place, height - BOTTOM + 15, words, "middle"))
    for value, words in y.marks:
        place = top + tall * (1 - float(y.place(value)))
        parts.append(segment((LEFT, place), (WIDTH - RIGHT, place)))
        parts.append(text_at(LEFT - 5, place + 4, words, "end"))
    parts.append(text_at(LEFT + wide / 2, height - 6, x.label, "middle"))
    parts.append(text_at(6, top - 9, y.label, "start"))
    if diagonal:
        parts.append(segment((LEFT, height - BOTTOM), (WIDTH - RIGHT, top), "#999999", "3 4"))
    for k, curve in enumerate(curves):
        parts += _drawn(curve, k, points, height - BOTTOM, dots)
    if upright is not None and x.low < upright < x.high:
        place = LEFT + wide * float(x.place(upright))
        parts.append(segment((place, top), (place, height - BOTTOM), "#555555", "4 3"))
        near = place > LEFT + 0.8 * wide
        parts.append(text_at(place + (-4 if near else 4), top + 11, "EER", "end" if near else "start"))
    return Markup("".join(parts) + "</svg>")


def short_percent(value: float) -> str:
    """A fraction as a percentage, as short as it can be said."""
    return f"{100 * value:.6g} %"


def _drawn(curve: Curve, k: int, points: Callable[[Values, Values], Values], floor: int, dots: bool) -> list[str]:
    paint, parts = COLOURS[k % 6], []
    if curve.band is not None:
        at, low, high = curve.band
        around = np.concatenate([points(at, low), points(at, high)[::-1]])
        parts.append(f'<polygon points="{_written(around)}" fill="{paint}" fill-opacity="0.13"/>')
    line = _thinned(points(curve.x, curve.y))
    if curve.filled:
        parts.append(f'<polygon points="{_written(line)}" fill="{paint}" fill-opacity="0.2"/>')
    dash = f' stroke-dasharray="{DASHES[k % 4]}"' if DASHES[k % 4] else ""
    parts.append(f'<polyline points="{_written(line)}" fill="none" stroke="{paint}" stroke-width="1.6"{dash}/>')
    if dots:
        parts += [f'<circle cx="{cx:.1f}" cy="{cy:.1f}" r="2.6" fill="{paint}"/>' for cx, cy in line]
    return parts


def _stairs(far: Values, rate: Values) -> tuple[Values, Values]:
    """Corners with those between that an axis-parallel line needs: FAR rises first."""
    return np.repeat(far, 2)[1:], np.repeat(rate, 2)[:-1]


def _thinned(points: Values) -> Values:
    """Points at least 0.4 px from the last one kept; the ends stay, and so do corners of a staircase that is coarse."""
    kept = [0]
    for k in range(1, len(points) - 1):
        if np.abs(points[k] - points[kept[-1]]).max() >= 0.4:
            kept.append(k)
    return points[[*kept, len(points) - 1]]


def _legend_rows(labels: Sequence[str]) -> list[list[tuple[int, str, float]]]:
    rows: list[list[tuple[int, str, float]]] = [[]]
    used = 0.0
    for k, label in enumerate(labels):
        shown = label if len(label) <= 52 else label[:49] + "..."
        long = 40 + 6.6 * len(shown)
        if rows[-1] and used + long > WIDTH - LEFT:
            rows.append([])
            used = 0.0
        rows[-1].append((k, shown, long))
        used += long
    return rows


def _whole_marks(longest: int) -> list[int]:
    return sorted({1, *range(5, longest + 1, 5)}) if longest > 6 else list(range(1, longest + 1))


def _written(points: Values) -> str:
    return " ".join(f"{px:.1f},{py:.1f}" for px, py in points)
