"""The folder of an evaluation: one HTML page that needs nothing else, the same facts as JSON, and curves as SVG."""

from __future__ import annotations

import base64
import datetime
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from splitknit import BadInput
from splitknit.io.atomic import atomic_folder
from splitknit.io.provenance import json_text, plain_json, provenance
from splitknit.report import template
from splitknit_match.evaluation import curves, rates
from splitknit_match.evaluation.evaluate import Evaluation, Result
from splitknit_match.evaluation.fusion import Fused
from splitknit_match.evaluation.intervals import BootstrapSettings, Interval

FORMAT = "splitknit-evaluation"
_DRAWN_BY = {"plain": "comparisons", "finger": "fingers", "subject": "subjects"}


def write_evaluation(
    evaluation: Evaluation, out: Path, tables: Mapping[str, bytes], settings: Mapping[str, Any]
) -> dict[str, Any]:
    """Write the page, the facts (returned), the curves and further `tables` into the folder `out`, all or nothing;
    `settings`: what was asked for, to be reported.
    """
    try:
        charts, uncharted = _charts(evaluation.results), ""
    except BadInput as error:  # no matplotlib
        charts, uncharted = {}, str(error)
    files = {**tables, **charts}
    facts = _facts(evaluation, settings) | {"files": ["report.html", "report.json", *files]}
    pictures = {name: base64.b64encode(data).decode() for name, data in charts.items()}
    with atomic_folder(out) as folder:
        for name, data in files.items():
            (folder / name).write_bytes(data)
        (folder / "report.html").write_text(_page(facts, pictures, uncharted), encoding="utf-8")
        (folder / "report.json").write_text(json_text(facts), encoding="utf-8")
    return facts


def _facts(evaluation: Evaluation, settings: Mapping[str, Any]) -> dict[str, Any]:
    bootstrap = evaluation.bootstrap
    systems = {result.scores.name: _system(result, bootstrap) for result in evaluation.results}
    first = evaluation.results[0].scores.name
    fusions = {method: _fusion(method, fused, bootstrap.seed) for method, fused in evaluation.fused.items()}
    return {
        "format": FORMAT,
        "version": 1,
        "software": {"name": "splitknit", "version": provenance()["version"], "python": platform.python_version()},
        "written_at": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "system": first,
        "eer": systems[first]["eer"],
        "gar_at_far": systems[first]["gar_at_far"],
        "systems": systems,
        "differences": [
            {"first": one.first, "second": one.second, "method": one.method, **_rates(one.figures, bootstrap.targets)}
            for one in evaluation.differences
        ],
        "fusions": fusions,
        "notes": list(evaluation.notes),
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
    roc = rates.roc(scores.genuine, scores.impostor)
    missing = [int(np.isnan(side).sum()) for side in (scores.genuine, scores.impostor)]
    made = {far: intervals.figures[f"gar@{far:g}_made"] for far in settings.targets}
    gar = roc.gars(intervals.curve_far)
    return {
        **_rates(intervals.figures, settings.targets),
        "fnmr_at_fmr": {
            f"{far:g}": {"value": 1.0 - one.value, "low": 1.0 - one.high, "high": 1.0 - one.low}
            for far, one in made.items()
        },
        "comparisons": {"genuine": scores.genuine.size, "impostor": scores.impostor.size},
        "failures_to_acquire": {
            "genuine": missing[0],
            "impostor": missing[1],
            "rate": sum(missing) / scores.score.size,
        },
        "equal_error": asdict(roc.equal_error()),
        "operating_points": {f"{far:g}": asdict(roc.at_far(far)) for far in settings.targets},
        "bootstrap": {
            "method": intervals.method,
            "drawn": intervals.drawn,
            "replicates": settings.replicates,
            "confidence": rates.CONFIDENCE,
            "seed": settings.seed,
        },
        "roc": {
            "far": intervals.curve_far.tolist(),
            "gar": gar,
            "low": np.minimum(intervals.curve_low, gar).tolist(),
            "high": np.maximum(intervals.curve_high, gar).tolist(),
        },
    }


def _fusion(method: str, fused: Fused, seed: int) -> dict[str, Any]:
    return {
        "method": method,
        "systems": list(fused.systems),
        "dealt_by": fused.by,
        "folds": fused.folds,
        "seed": seed,
        "models": len(fused.models),
        "mean_weights": dict(zip(fused.systems, fused.weights.tolist(), strict=True)),
        "missing": dict(zip(fused.systems, fused.missing, strict=True)),
    }


def _page(facts: Mapping[str, Any], charts: Mapping[str, str], uncharted: str) -> str:
    html = template(Path(__file__).with_name("evaluation.html")).render(
        facts=facts,
        drawn_by=_DRAWN_BY,
        charts=charts,
        uncharted=uncharted[:1].upper() + uncharted[1:],
        rate=_rate,
        interval=interval,
        change=_change,
        number=_number,
        far=lambda key: f"{100 * float(key):g} %",
    )
    return str(html)


def _charts(results: Sequence[Result]) -> dict[str, bytes]:
    """Curves of all systems together, and a histogram of each."""
    systems = [result.scores for result in results]
    bands = [(one.intervals.curve_far, one.intervals.curve_low, one.intervals.curve_high) for one in results]
    banded = [band if band[0].size and len(results) <= 3 else None for band in bands]
    named = [scores.name for scores in systems]

    def histograms(*axes: Any) -> None:
        for ax, scores in zip(axes, systems, strict=True):
            threshold = rates.roc(scores.genuine, scores.impostor).equal_error().threshold
            curves.draw_scores(ax, scores, threshold)

    return {
        "roc.svg": curves.chart(lambda ax: curves.draw_roc(ax, list(zip(named, systems, banded, strict=True)))),
        "det.svg": curves.chart(lambda ax: curves.draw_det(ax, list(zip(named, systems, strict=True))), 4.2, 4.2),
        "scores.svg": curves.chart(histograms, count=len(systems)),
    }


def _rate(value: float) -> str:
    small = 0 < abs(100 * value) < 0.1
    return f"{100 * value:.2g} %" if small else f"{100 * value:.2f} %"


def interval(rate: Mapping[str, float]) -> str:
    """A fraction with its interval."""
    low, high = (_rate(rate[end]).removesuffix(" %") for end in ("low", "high"))
    return f"{_rate(rate['value'])} ({low} to {high})"


def _change(rate: Mapping[str, float]) -> str:
    return f"{100 * rate['value']:+.2f} ({100 * rate['low']:+.2f} to {100 * rate['high']:+.2f})"


def _number(figure: Mapping[str, float] | None, decimals: int) -> str:
    if figure is None:
        return "-"
    value, low, high = (f"{figure[name]:.{decimals}f}" for name in ("value", "low", "high"))
    return f"{value} ({low} to {high})"
