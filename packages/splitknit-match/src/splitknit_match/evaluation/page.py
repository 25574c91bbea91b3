"""The folder of an evaluation: one HTML page that needs nothing else, and the same facts as JSON."""

from __future__ import annotations

import datetime
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from scipy.special import ndtri

from splitknit.io.atomic import atomic_folder
from splitknit.io.provenance import json_text, plain_json, provenance
from splitknit.report import template
from splitknit.report.charts import Axis, Curve, Values, line_chart, percent_marks, round_marks
from splitknit_match.evaluation import rates
from splitknit_match.evaluation.facts import Cmc, Result, cmc, rank_one_interval
from splitknit_match.evaluation.intervals import CONFIDENCE, BootstrapSettings, Interval
from splitknit_match.evaluation.rates import Roc, histograms, roc
from splitknit_match.evaluation.study import Difference, Evaluation

FORMAT = "splitknit-evaluation"
_FILES = ("report.html", "report.json")


def write_evaluation(found: Evaluation, out: Path) -> dict[str, Any]:
    """Write the page, the facts (returned) and the tables of an evaluation into the folder `out`, all or nothing."""
    facts = _facts_of(found)
    html = _page(facts, found.results)
    with atomic_folder(out) as folder:
        for name, data in found.tables.items():
            (folder / name).write_bytes(data)
        (folder / "report.html").write_text(html, encoding="utf-8")
        (folder / "report.json").write_text(json_text(facts), encoding="utf-8")
    return facts


def _facts_of(found: Evaluation) -> dict[str, Any]:
    settings, fused = found.settings, found.fused
    systems = {result.scores.name: _system_facts(result, settings.bootstrap) for result in found.results}
    first = found.results[0].scores.name
    facts = {
        "format": FORMAT,
        "version": 1,
        "software": {"name": "splitknit", "version": provenance()["version"], "python": platform.python_version()},
        "written_at": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "system": first,
        "eer": systems[first]["eer"],
        "gar_at_far": systems[first]["gar_at_far"],
        "systems": systems,
        "differences": [_difference_facts(one, settings.bootstrap) for one in found.differences],
        "notes": list(found.notes),
        "settings": plain_json(settings),
        "files": [*_FILES, *found.tables],
    }
    about = {
        method: {
            "method": method,
            "systems": list(one.systems),
            "dealt_by": one.by,
            "folds": one.folds,
            "seed": settings.bootstrap.seed,
            "models": len(one.models),
            "mean_weights": one.mean_weights(),
            "missing": dict(zip(one.systems, one.missing, strict=True)),
        }
        for method, one in fused.items()
    }
    if about:
        facts |= {"fusion": next(iter(about.values()))} if len(about) == 1 else {"fusions": about}
    return facts | {"inputs_sha256": dict(found.inputs_sha256), "timings_s": dict(found.timings_s)}


def _system_facts(result: Result, settings: BootstrapSettings) -> dict[str, Any]:
    scores, figures = result.scores, result.intervals.figures
    genuine, impostor = np.sort(scores.genuine), np.sort(scores.impostor)
    targets = settings.targets
    missing = [int(np.isnan(side).sum()) for side in (genuine, impostor)]
    equal = rates.equal_error(genuine, impostor)
    made = {far: figures[f"gar@{far:g}_made"] for far in targets}
    missed = {far: Interval(1.0 - one.value, 1.0 - one.high, 1.0 - one.low) for far, one in made.items()}
    return {
        "eer": asdict(figures["eer"]),
        "gar_at_far": {f"{far:g}": asdict(figures[f"gar@{far:g}"]) for far in targets},
        "fnmr_at_fmr": {f"{far:g}": asdict(one) for far, one in missed.items()},
        "eer_of_fmr_and_fnmr": asdict(figures["eer_made"]),
        "auc": asdict(figures["auc"]),
        "d_prime": asdict(figures["d_prime"]) if "d_prime" in figures else None,
        "comparisons": {"genuine": genuine.size, "impostor": impostor.size},
        "failures_to_acquire": {
            "genuine": missing[0],
            "impostor": missing[1],
            "rate_genuine": missing[0] / genuine.size,
            "rate_impostor": missing[1] / impostor.size,
            "rate": sum(missing) / scores.score.size,
        },
        "equal_error": asdict(equal),
        "operating_points": {f"{far:g}": asdict(rates.gar_at_far(genuine, impostor, far)) for far in targets},
        "operating_points_made": {
            f"{far:g}": asdict(rates.gar_at_far(genuine, impostor, far, counting="made")) for far in targets
        },
        "bootstrap": {
            "method": result.primary,
            "drawn": result.intervals.drawn,
            "replicates": settings.replicates,
            "confidence": CONFIDENCE,
            "seed": settings.seed,
        },
        "intervals": {
            method: {
                "drawn": found.drawn,
                "eer": asdict(found.figures["eer"]),
                "gar_at_far": {f"{far:g}": asdict(found.figures[f"gar@{far:g}"]) for far in targets},
            }
            for method, found in result.by_method.items()
        },
        "roc": _curve(result),
        "cmc": _cmc_facts(cmc(scores), settings),
    }


def _difference_facts(one: Difference, settings: BootstrapSettings) -> dict[str, Any]:
    figures = one.figures
    return {
        "first": one.first,
        "second": one.second,
        "method": one.method,
        "eer": asdict(figures["eer"]),
        "gar_at_far": {f"{far:g}": asdict(figures[f"gar@{far:g}"]) for far in settings.targets},
        "auc": asdict(figures["auc"]),
        "d_prime": asdict(figures["d_prime"]) if "d_prime" in figures else None,
    }


def _cmc_facts(found: Cmc | None, settings: BootstrapSettings) -> dict[str, Any] | None:
    if found is None:
        return None
    low, high = rank_one_interval(found, replicates=settings.replicates, seed=settings.seed)
    return {
        "gallery": found.gallery,
        "probes": found.rank.size,
        "probes_left_out": found.left_out,
        "rank_1": {"value": float(found.rate[0]), "low": low, "high": high},
        "rate": found.rate[:100].tolist(),
    }


def _curve(result: Result) -> dict[str, Any]:
    """The GAR at some FARs with its band; the whole staircase is in the page."""
    found, scores = result.intervals, result.scores
    genuine, impostor = np.sort(scores.genuine), np.sort(scores.impostor)
    gar = [rates.gar_at_far(genuine, impostor, float(far)).gar for far in found.curve_far]
    low, high = np.minimum(found.curve_low, gar), np.maximum(found.curve_high, gar)
    return {"far": found.curve_far.tolist(), "gar": gar, "low": low.tolist(), "high": high.tolist()}


_DRAWN_BY = {"plain": "comparisons", "finger": "fingers", "subject": "subjects"}


def _page(facts: Mapping[str, Any], results: Sequence[Result]) -> str:
    """Return the report of `facts`; the charts come from the scores themselves."""
    systems = facts["systems"]
    bootstrap = systems[facts["system"]]["bootstrap"]
    html = template(Path(__file__).with_name("evaluation.html")).render(
        facts=facts,
        systems=systems,
        first=systems[facts["system"]],
        targets=list(facts["gar_at_far"]),
        bootstrap=bootstrap,
        confidence=f"{100 * bootstrap['confidence']:g} %",
        drawn_by=_DRAWN_BY,
        pictures=_pictures(results, systems),
        turned=facts["settings"]["dissimilarity"],
        rate=_rate,
        interval=interval,
        change=_change,
        number=_number,
        far=lambda key: f"{100 * float(key):g} %",
    )
    return str(html)


def _rate(value: float | None) -> str:
    if value is None:
        return "-"
    small = 0 < abs(100 * value) < 0.1
    return f"{100 * value:.2g} %" if small else f"{100 * value:.2f} %"


def interval(found: Mapping[str, float] | None) -> str:
    """A fraction with its interval."""
    if found is None:
        return "-"
    return f"{_rate(found['value'])} ({_bare(found['low'])} to {_bare(found['high'])})"


def _change(found: Mapping[str, float]) -> str:
    return f"{100 * found['value']:+.2f} ({100 * found['low']:+.2f} to {100 * found['high']:+.2f})"


def _number(found: Mapping[str, float] | None, decimals: int = 3) -> str:
    if found is None:
        return "-"
    return f"{found['value']:.{decimals}f} ({found['low']:.{decimals}f} to {found['high']:.{decimals}f})"


def _bare(value: float) -> str:
    return _rate(value).removesuffix(" %")


def _pictures(results: Sequence[Result], systems: Mapping[str, Any]) -> dict[str, list[Markup]]:
    """ROC and DET of all systems together, a histogram each, and the CMC where there is one."""
    curves = [(one.scores.name, roc(one.scores.genuine, one.scores.impostor)) for one in results]
    banded = []
    for name, curve in curves:
        far, low, high = (np.array(systems[name]["roc"][part]) for part in ("far", "low", "high"))
        banded.append((name, curve, (far, low, high) if far.size and len(results) <= 3 else None))
    count = max(1, *(int(np.sum(~one.scores.label)) for one in results))
    lowest = float(np.clip(1.0 / count, 1e-7, 1e-2))
    found = [(name, np.array(one["cmc"]["rate"])) for name, one in systems.items() if one["cmc"] is not None]
    return {
        "rates": [roc_chart(banded, lowest), _det_chart(curves, lowest)],
        "histograms": [
            _histogram_chart(
                result.scores.name,
                *histograms(result.scores.genuine, result.scores.impostor),
                systems[result.scores.name]["equal_error"]["threshold"],
            )
            for result in results
        ],
        "cmc": [_cmc_chart(found)] if found else [],
    }


# Charts of an evaluation: ROC, DET, score histograms, CMC.

_PROBIT_TICKS = (1e-5, 1e-4, 1e-3, 0.01, 0.05, 0.2, 0.5, 0.8, 0.95, 0.99)


def roc_chart(curves: Sequence[tuple[str, Roc, tuple[Values, Values, Values] | None]], lowest: float) -> Markup:
    """GAR over FAR, the latter on a logarithmic axis down to `lowest`, with bands of FAR, low and high GAR."""
    marks = [10.0**k for k in range(int(np.ceil(np.log10(lowest) - 1e-9)), 1)]
    drawn = [Curve(name, *_stairs(roc.far, roc.gar), band) for name, roc, band in curves]
    least = min(float(curve.y[curve.x <= lowest].max()) for curve in drawn)
    x = Axis("FAR (log), fraction of impostors accepted", lowest, 1.0, percent_marks(marks), np.log10)
    return line_chart(drawn, x, _axis_to_one("GAR", min(least, 0.9)), title="ROC: GAR over FAR", height=300)


def _det_chart(curves: Sequence[tuple[str, Roc]], lowest: float) -> Markup:
    """FRR over FAR on probit axes: two normal distributions give a straight line; grey is where both are equal."""
    worst = max(float(np.min(np.maximum(roc.far, roc.frr))) for _, roc in curves)
    high = next(tick for tick in (0.5, 0.8, 0.95, 0.99, 0.999) if tick > worst or tick == 0.999)
    low = min(0.01, max((tick for tick in _PROBIT_TICKS if tick <= max(lowest, 1e-5)), default=1e-5))
    marks = percent_marks(tick for tick in _PROBIT_TICKS if low <= tick <= high)
    ends = np.array([low, high])
    drawn = [Curve("", ends, ends), *(Curve(name, *_stairs(roc.far, roc.frr)) for name, roc in curves)]
    axes = (Axis(label, low, high, marks, ndtri) for label in ("FAR (probit)", "FRR"))
    return line_chart(drawn, *axes, title="DET: FRR over FAR", height=360)


def _histogram_chart(name: str, edges: Values, genuine: Values, impostor: Values, threshold: float | None) -> Markup:
    """Fractions of genuine and impostor scores in each bin, and where both rates are equal."""
    edges = np.repeat(edges, 2)
    both = {"genuine": genuine, "impostor": impostor}
    heights = {name: np.concatenate([[0.0], np.repeat(side, 2), [0.0]]) for name, side in both.items()}
    drawn = [Curve(name, edges, height, filled=True) for name, height in heights.items()]
    low, high = float(edges[0]), float(edges[-1])
    top = max(float(genuine.max()), float(impostor.max()))
    x = Axis("score", low, high, tuple((v, f"{v:g}") for v in round_marks(low, high, 7)))
    y = Axis("fraction of its class", 0.0, max(top * 1.05, 1e-9), percent_marks(round_marks(0.0, top, 5)))
    if threshold is not None and low < threshold < high:
        drawn.append(Curve("EER", np.full(2, threshold), np.array([y.low, y.high])))
    return line_chart(drawn, x, y, title=f"Scores of {name}", height=240)


def _cmc_chart(curves: Sequence[tuple[str, Values]]) -> Markup:
    """Fraction of probes whose finger is among the first n of the gallery."""
    longest = max(2, min(20, max(rate.size for _, rate in curves)))
    drawn = [Curve(name, np.arange(1.0, 1 + rate[:20].size), rate[:20], dots=True) for name, rate in curves]
    marks = sorted({1, *range(5, longest + 1, 5)}) if longest > 6 else range(1, longest + 1)
    x = Axis("rank", 1.0, float(longest), tuple((float(k), str(k)) for k in marks))
    y = _axis_to_one("found", min([*(float(rate[0]) for _, rate in curves), 0.95]))
    return line_chart(drawn, x, y, title="CMC: identification among all")


def _axis_to_one(label: str, least: float) -> Axis:
    """Fractions from the tenth below `least` to one."""
    floor = float(np.floor(least * 10) / 10)
    return Axis(label, floor, 1.0, percent_marks(round_marks(floor, 1.0, 6)))


def _stairs(far: Values, rate: Values) -> tuple[Values, Values]:
    """Corners with those between that an axis-parallel line needs: FAR rises first."""
    return np.repeat(far, 2)[1:], np.repeat(rate, 2)[:-1]
