"""Which rig would the thesis's own experiment choose? Sweeps of ``splitknit rig optimise`` and what they found.

    python validation/rig/optimise.py                    # all sweeps: 15 minutes of one core; may be interrupted
    python validation/rig/optimise.py --report           # only the tables (as kept in tables/) and the picture of
                                                         # docs/experiments/rig-optimise.md

Every sweep grows in a folder of its own in ``validation/out/rig`` (one file a rig), so that a run that was stopped goes
on where it was. ``optimise.json`` beside this script holds the figures that the report follows from.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
OUT = HERE.parent / "out" / "rig"
RESULTS = HERE / "optimise.json"

sys.path.insert(0, str(HERE))

from thesis_study import ThesisStudy  # noqa: E402

from splitknit_rig.rig.candidates import (  # noqa: E402
    BuildSettings,
    RigCandidate,
    grid,
)
from splitknit_rig.rig.optimise import summarise, sweep_rigs  # noqa: E402

HEIGHTS = (100.0, 120.0, 140.0, 170.0, 200.0)
RADII = (35.0, 45.0, 52.5, 65.0, 80.0, 100.0)
PX = 10.0
COMPARED = ("low", "high", "worse_by", "worse_low", "worse_high", "as_good")
"""What is kept of each comparison with the best, in this order."""


@dataclass(frozen=True, slots=True)
class Sweep:
    """One question."""

    asks: str
    study: ThesisStudy
    candidates: tuple[RigCandidate, ...]


def _plane(fingers: int, heights: Sequence[float] = HEIGHTS, radii: Sequence[float] = RADII, **study: Any) -> Sweep:
    return Sweep(
        "height and radius", ThesisStudy(fingers=fingers, **study), grid(heights, radii, (1.0,), (None,), (PX,))
    )


def _powers(fingers: int, powers: Sequence[float], **study: Any) -> Sweep:
    return Sweep("power", ThesisStudy(fingers=fingers, **study), grid((140.0,), (52.5,), powers, (None,), (PX,)))


def _tilts(fingers: int, **study: Any) -> Sweep:
    tilts = (0.0, 10.0, 20.0, 30.0, None)
    return Sweep("tilt", ThesisStudy(fingers=fingers, **study), grid((140.0,), (52.5,), (1.0,), tilts, (PX,)))


def _resolutions(fingers: int, values: Sequence[float], **study: Any) -> Sweep:
    return Sweep("resolution", ThesisStudy(fingers=fingers, **study), grid((140.0,), (52.5,), (1.0,), (None,), values))


POWERS = (0.005, 0.01, 0.03, 0.1, 0.4, 1.0, 3.0)
METRIC: dict[str, Any] = {"method": "metric", "material": "skin"}
SWEEPS: dict[str, Sweep] = {
    "ea_opaque": _plane(8),
    "ea_poisson_opaque": _plane(4, method="ea-poisson"),
    "ea_skin": _plane(4, material="skin"),
    "metric_skin": _plane(6, (100.0, 140.0, 200.0), (35.0, 52.5, 80.0, 100.0), **METRIC),
    "near_ea_opaque": _plane(4, (50.0, 70.0, 85.0), (52.5, 65.0, 80.0, 100.0)),
    "parallel_ea_opaque": _plane(8, (100.0, 140.0, 200.0), (52.5, 80.0), build=BuildSettings(view="orthographic")),
    "power_ea_opaque": _powers(4, POWERS),
    "power_metric_skin": _powers(3, POWERS, **METRIC),
    "tilt_ea_opaque": _tilts(4),
    "tilt_metric_skin": _tilts(3, **METRIC),
    "resolution_ea_opaque": _resolutions(4, (5.0, 7.5, 10.0, 15.0, 20.0)),
    "resolution_metric_skin": _resolutions(3, (5.0, 7.5, 10.0, 15.0, 20.0), **METRIC),
    "renderer_power": _powers(4, (0.01, 0.03, 0.1, 0.3, 0.7, 1.0, 1.5, 2.0, 3.0, 10.0), camera="renderer"),
    "renderer": Sweep(
        "height, radius and power under one fixed exposure",
        ThesisStudy(fingers=3, camera="renderer"),
        grid((100.0, 140.0, 180.0), (35.0, 52.5, 70.0), (0.3, 1.0, 3.0), (None,), (PX,)),
    ),
}


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--report", action="store_true", help="tables and picture from optimise.json alone")
    parser.add_argument("--sweeps", nargs="*", default=None, metavar="NAME", help=f"of {', '.join(SWEEPS)}")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--scratch", type=Path, default=OUT)
    chosen = parser.parse_args(arguments)
    unknown = set(chosen.sweeps or ()) - set(SWEEPS)
    if unknown:
        parser.error(f"there is no sweep '{min(unknown)}'; known are {', '.join(SWEEPS)}.")
    if not chosen.report:
        results = json.loads(RESULTS.read_text()) if chosen.sweeps and RESULTS.exists() else {}
        for name in chosen.sweeps or SWEEPS:
            results[name] = _run(name, chosen.scratch / name, chosen.workers)
            print(f"{name}: {len(results[name]['rows'])} rigs")
        RESULTS.write_text(json.dumps(results, separators=(",", ":")).replace("},{", "},\n{") + "\n")
    from report import write_report

    print(write_report(json.loads(RESULTS.read_text())))
    return 0


def _run(name: str, out: Path, workers: int) -> dict[str, Any]:
    """Sweep, and keep of it what the report needs."""
    asked = SWEEPS[name]

    def say(stage: str, fraction: float) -> None:
        print(f"\r{name} {100 * fraction:3.0f} % {stage:40s}", end="", file=sys.stderr, flush=True)

    records = sweep_rigs(out, asked.candidates, asked.study, workers=workers, progress=say)
    print(file=sys.stderr)
    summaries = {objective: summarise(records, f"{objective}_mm") for objective in ("hausdorff", "whole", "rms")}
    rows = []
    for one in records:
        row = {name: value for name, value in one["candidate"].items() if name != "name"}
        row |= {"name": one["candidate"]["name"], "status": one["status"], "reason": one["reason"]}
        row["broken"] = [rule["name"] for rule in one["constraints"] if rule["hard"] and not rule["ok"]]
        if one["mean"] is not None:
            row |= {key: round(value, 5) for key, value in one["mean"].items()}
            row["compared"] = {
                objective: [_short(its["compared"][row["name"]][key]) for key in COMPARED]
                for objective, its in summaries.items()
            }
        rows.append(row)
    study = asked.study
    asks = {"method": study.method, "material": study.material, "camera": study.camera, "fingers": study.fingers}
    best = {objective: its["best"] for objective, its in summaries.items()}
    return {"asks": asked.asks, **asks, "best": best, "pareto": summaries["hausdorff"]["pareto"], "rows": rows}


def _short(value: float | bool | None) -> float | bool | None:
    return round(value, 4) if isinstance(value, float) else value


if __name__ == "__main__":
    sys.exit(main())
