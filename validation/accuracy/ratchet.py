"""Stored figures may improve, not slip by more than 1 %.

python validation/accuracy/ratchet.py  # exit code 1 and a line for each figure that slipped
python validation/accuracy/ratchet.py --update  # keep the better of stored and new figures
python validation/accuracy/ratchet.py --reset  # take the new figures

The new figures are those of results.json. After ``--reset``, the commit says why the twin changed.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from summary import ROWS

HERE = Path(__file__).resolve().parent
THRESHOLDS = HERE / "thresholds.json"
MAX_LOSS = 0.01
COMPARED_SETTINGS = ("scale", "fingers", "impressions", "first_seed")
"""What must agree for figures to be comparable."""
Tree = Mapping[str, Any]


def stored(results: Tree) -> dict[str, Any]:
    """The figures of ``results.json`` that are kept: means, and refusals."""
    population = results["population"]
    presets = {
        name: {
            **{key: preset["figures"][key]["mean"] for key in ROWS if key in preset["figures"]},
            "refused": len(preset["refused"]),
        }
        for name, preset in population["presets"].items()
    }
    return {**{key: population[key] for key in COMPARED_SETTINGS}, "presets": presets}


def slipped(results: Tree, thresholds: Tree) -> list[str]:
    """Return a sentence for each figure that slipped by more than :data:`MAX_LOSS`."""
    figures_now = stored(results)
    worse = [
        f"{key} is {figures_now[key]}, but the stored figures were made with {thresholds[key]}"
        for key in COMPARED_SETTINGS
        if figures_now[key] != thresholds[key]
    ]
    for preset, figures in thresholds["presets"].items():
        now = figures_now["presets"].get(preset, {})
        for key, before in figures.items():
            if key not in now:
                worse.append(f"{preset}: {key} is missing")
            elif _is_worse(key, now[key], before):
                worse.append(f"{preset}: {key} slipped from {before:g} to {now[key]:g}")
    return worse


def _is_worse(key: str, now: float, before: float) -> bool:
    if key == "refused":
        return now > before
    better = ROWS[key].better
    if better == "one":
        return abs(now - 1.0) > abs(before - 1.0) + MAX_LOSS
    return now > before * (1.0 + MAX_LOSS) if better == "low" else now < before * (1.0 - MAX_LOSS)


def tightened(results: Tree, thresholds: Tree) -> dict[str, Any]:
    """The better of the two for every figure."""
    figures_now = stored(results)
    for preset, figures in thresholds["presets"].items():
        for key, before in figures.items():
            now = figures_now["presets"][preset][key]
            cost = (lambda value: value) if key == "refused" else ROWS[key].cost
            figures_now["presets"][preset][key] = min(now, before, key=cost)
    return figures_now


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--update", action="store_true")
    parser.add_argument("--reset", action="store_true")
    parser.add_argument("--results", type=Path, default=HERE / "results.json")
    options = parser.parse_args(arguments)
    results = json.loads(options.results.read_text())
    if options.reset:
        kept = stored(results)
        worse = []
    else:
        thresholds = json.loads(THRESHOLDS.read_text())
        worse = slipped(results, thresholds)
        kept = tightened(results, thresholds) if options.update and not worse else thresholds
    if kept:
        THRESHOLDS.write_text(json.dumps(kept, indent=1, sort_keys=True) + "\n", encoding="ascii")
    print("\n".join(worse) or "no figure slipped")
    return int(bool(worse))


if __name__ == "__main__":
    sys.exit(main())
