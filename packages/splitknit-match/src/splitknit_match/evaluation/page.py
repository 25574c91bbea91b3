"""The folder of an evaluation: one HTML page that needs nothing else, the same facts as JSON, and
curves as SVG."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from splitknit import BadInput
from splitknit.io.atomic import atomic_folder
from splitknit.io.provenance import json_text, plain_json, report_head
from splitknit.report import template
from splitknit_match.evaluation import curves
from splitknit_match.evaluation.evaluate import Evaluation, Result
from splitknit_match.evaluation.intervals import BootstrapSettings, Interval
from splitknit_match.evaluation.rates import CONFIDENCE, roc

FORMAT = "splitknit-evaluation"
_DRAWN_BY = {"plain": "comparisons", "finger": "fingers", "subject": "subjects"}


def write_evaluation(
    evaluation: Evaluation, out: Path, tables: Mapping[str, bytes], settings: Mapping[str, Any]
) -> dict[str, Any]:
    """Write the page, the facts (returned), the curves and further `tables` into the folder `out`,
    all or nothing; `settings`: what was asked for, to be reported.
    """
    try:
        charts, uncharted = _charts(evaluation.results), ""
    except BadInput as error:  # no matplotlib
        charts, uncharted = {}, str(error)
    files = {**tables, **charts}
    facts = _facts(evaluation, settings) | {"files": ["report.html", "report.json", *files]}
    page = template(Path(__file__).with_name("evaluation.html")).render(
        facts=facts,
        drawn_by=_DRAWN_BY,
        charts={name: base64.b64encode(data).decode() for name, data in charts.items()},
        uncharted=uncharted[:1].upper() + uncharted[1:],
        rate=_percent,
        interval=interval,
        change=_change,
        number=_number,
        far=lambda key: f"{100 * float(key):g} %",
    )
    with atomic_folder(out) as folder:
        for name, data in files.items():
            (folder / name).write_bytes(data)
        (folder / "report.html").write_text(str(page), encoding="utf-8")
        (folder / "report.json").write_text(json_text(facts), encoding="utf-8")
    return facts


def _facts(evaluation: Evaluation, settings: Mapping[str, Any]) -> dict[str, Any]:
    bootstrap = evaluation.bootstrap
    systems = {result.scores.name: _system(result, bootstrap) for result in evaluation.results}
    first = next(iter(systems))
    return {
        **report_head(FORMAT),
        "system": first,
        **_rates(evaluation.results[0].intervals.figures, bootstrap.targets),
        "systems": systems,
        "differences": [
            {
                "first": difference.first,
                "second": difference.second,
                "method": difference.method,
                **_rates(difference.figures, bootstrap.targets),
            }
            for difference in evaluation.differences
        ],
        "fusions": {
            method: {
                "method": method,
                "systems": list(fused.systems),
                "dealt_by": fused.by,
                "folds": fused.folds,
                "seed": bootstrap.seed,
                "models": len(fused.models),
                "mean_weights": dict(zip(fused.systems, fused.weights.tolist(), strict=True)),
                "missing": dict(zip(fused.systems, fused.missing, strict=True)),
            }
            for method, fused in evaluation.fused.items()
        },
        "findings": [finding.facts for finding in evaluation.findings],
        "settings": {**settings, "bootstrap": plain_json(bootstrap)},
        "inputs_sha256": dict(evaluation.inputs_sha256),
    }


def _rates(figures: Mapping[str, Interval], targets: Sequence[float]) -> dict[str, Any]:
    """The table of rates: each with its interval."""
    return {
        "eer": asdict(figures["eer"]),
        "gar_at_far": {f"{far:g}": asdict(figures[f"gar@{far:g}"]) for far in targets},
        "auc": asdict(figures["auc"]),
        "d_prime": asdict(figures["d_prime"]) if "d_prime" in figures else None,
    }


def _system(result: Result, settings: BootstrapSettings) -> dict[str, Any]:
    scores, intervals = result.scores, result.intervals
    curve = roc(scores.genuine, scores.impostor)
    missing = [int(np.isnan(side).sum()) for side in (scores.genuine, scores.impostor)]
    fnmr = {}
    for far in settings.targets:
        gar = intervals.figures[f"gar@{far:g}_made"]
        fnmr[f"{far:g}"] = {"value": 1.0 - gar.value, "low": 1.0 - gar.high, "high": 1.0 - gar.low}
    gars = curve.gars(intervals.curve_far)
    return {
        **_rates(intervals.figures, settings.targets),
        "fnmr_at_fmr": fnmr,
        "comparisons": {"genuine": scores.genuine.size, "impostor": scores.impostor.size},
        "failures_to_acquire": {
            "genuine": missing[0],
            "impostor": missing[1],
            "rate": sum(missing) / scores.score.size,
        },
        "equal_error": asdict(curve.equal_error()),
        "operating_points": {f"{far:g}": asdict(curve.at_far(far)) for far in settings.targets},
        "bootstrap": {
            "method": intervals.method,
            "drawn": intervals.drawn,
            "replicates": settings.replicates,
            "confidence": CONFIDENCE,
            "seed": settings.seed,
        },
        "roc": {
            "far": intervals.curve_far.tolist(),
            "gar": gars,
            "low": np.minimum(intervals.curve_low, gars).tolist(),
            "high": np.maximum(intervals.curve_high, gars).tolist(),
        },
    }


def _charts(results: Sequence[Result]) -> dict[str, bytes]:
    """Curves of all systems together, and a histogram of each."""
    banded = []
    for result in results:
        band = result.intervals.curve_far, result.intervals.curve_low, result.intervals.curve_high
        banded.append((result.scores.name, result.scores, band if band[0].size else None))

    def histograms(*axes: Any) -> None:
        for ax, result in zip(axes, results, strict=True):
            curves.draw_scores(ax, result.scores)

    return {
        "roc.svg": curves.chart(lambda ax: curves.draw_roc(ax, banded)),
        "det.svg": curves.chart(lambda ax: curves.draw_det(ax, banded), 4.2, 4.2),
        "scores.svg": curves.chart(histograms, count=len(results)),
    }


def _percent(rate: float) -> str:
    return f"{100 * rate:.2g} %" if 0 < abs(100 * rate) < 0.1 else f"{100 * rate:.2f} %"


def interval(rate: Mapping[str, float]) -> str:
    """A fraction with its interval."""
    low, high = (_percent(rate[end]).removesuffix(" %") for end in ("low", "high"))
    return f"{_percent(rate['value'])} ({low} to {high})"


def _change(rate: Mapping[str, float]) -> str:
    return f"{100 * rate['value']:+.2f} ({100 * rate['low']:+.2f} to {100 * rate['high']:+.2f})"


def _number(figure: Mapping[str, float] | None, decimals: int) -> str:
    if figure is None:
        return "-"
    value, low, high = (f"{figure[name]:.{decimals}f}" for name in ("value", "low", "high"))
    return f"{value} ({low} to {high})"
