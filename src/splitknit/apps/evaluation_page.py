"""The page of an evaluation: one HTML file that needs nothing else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from markupsafe import Markup

from splitknit.apps.evaluation_charts import cmc_chart, det_chart, histogram_chart, roc_chart
from splitknit.apps.evaluation_facts import Result
from splitknit.apps.pages import render
from splitknit.evaluation.histograms import histograms
from splitknit.evaluation.rates import roc

DRAWN_BY = {"plain": "comparisons", "finger": "fingers", "subject": "subjects"}


def page(facts: Mapping[str, Any], results: Sequence[Result]) -> str:
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
        rate=rate,
        interval=interval,
        change=change,
        number=number,
        far=lambda key: f"{100 * float(key):g} %",
    )


def rate(value: float | None) -> str:
    """A share in percent: two decimals, more where it is small."""
    if value is None:
        return "-"
    hundred = 100 * value
    if hundred != 0 and abs(hundred) < 0.1:
        return f"{hundred:.2g} %"
    return f"{hundred:.2f} %"


def interval(found: Mapping[str, float] | None) -> str:
    """A share with its interval."""
    if found is None:
        return "-"
    return f"{rate(found['value'])} ({_bare(found['low'])} to {_bare(found['high'])})"


def change(found: Mapping[str, float]) -> str:
    """A difference of shares in percentage points, with its interval."""
    return f"{100 * found['value']:+.2f} ({100 * found['low']:+.2f} to {100 * found['high']:+.2f})"


def number(found: Mapping[str, float] | None, decimals: int = 3) -> str:
    """A plain number with its interval."""
    if found is None:
        return "-"
    return f"{found['value']:.{decimals}f} ({found['low']:.{decimals}f} to {found['high']:.{decimals}f})"


def _bare(value: float) -> str:
    return rate(value).removesuffix(" %")


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
        "rates": [roc_chart(bands, lowest), det_chart(curves, lowest)],
        "histograms": [
            histogram_chart(
                result.scores.name,
                histograms(result.scores.genuine, result.scores.impostor),
                systems[result.scores.name]["equal_error"]["threshold"],
            )
            for result in results
        ],
        "cmc": [cmc_chart(found)] if found else [],
    }
