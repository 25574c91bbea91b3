"""Which rig would the thesis's own experiment choose? Sweeps of height, radius, power, tilt and
resolution.

    python validation/thesis/rigs.py  # all sweeps: 15 minutes of one core; may be interrupted
    python validation/thesis/rigs.py --report  # only the tables (some are kept in tables/rig)
    python validation/thesis/rigs.py --heights 100 140 --radii 40 52.5 80 --method metric

Every sweep grows in a folder of its own in ``validation/out/rig`` (one file a rig), so that a run
that was stopped goes on where it was. ``rigs.json`` beside this script holds the figures that the
tables follow from.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rig_candidates import BuildSettings, RigCandidate, grid
from rig_study import ThesisStudy
from scipy import stats

HERE = Path(__file__).resolve().parent
OUT = HERE.parent / "out" / "rig"
RESULTS = HERE / "rigs.json"

HEIGHTS_MM = (100.0, 120.0, 140.0, 170.0, 200.0)
RADII_MM = (35.0, 45.0, 52.5, 65.0, 80.0, 100.0)
PX_PER_MM = 10.0
COMPARED = ("low", "high", "worse_by", "worse_low", "worse_high", "as_good")
"""What is kept of each comparison with the best, in this order."""


@dataclass(frozen=True, slots=True)
class Sweep:
    """One question."""

    asks: str
    study: ThesisStudy
    candidates: tuple[RigCandidate, ...]


def _sweep(  # noqa: PLR0917
    asks: str,
    fingers: int,
    heights: Sequence[float] = (140.0,),
    radii: Sequence[float] = (52.5,),
    powers: Sequence[float] = (1.0,),
    tilts: Sequence[float | None] = (None,),
    resolutions: Sequence[float] = (PX_PER_MM,),
    **study: Any,
) -> Sweep:
    candidates = grid(heights, radii, powers, tilts, resolutions)
    return Sweep(asks, ThesisStudy(fingers=fingers, **study), candidates)


POWERS_W = (0.005, 0.01, 0.03, 0.1, 0.4, 1.0, 3.0)
METRIC: dict[str, Any] = {"method": "metric", "material": "skin"}
plane = partial(_sweep, "height and radius", heights=HEIGHTS_MM, radii=RADII_MM)
power = partial(_sweep, "power", powers=POWERS_W)
tilt = partial(_sweep, "tilt", tilts=(0.0, 10.0, 20.0, 30.0, None))
resolution = partial(_sweep, "resolution", resolutions=(5.0, 7.5, 10.0, 15.0, 20.0))
SWEEPS: dict[str, Sweep] = {
    "ea_opaque": plane(8),
    "ea_poisson_opaque": plane(4, method="ea-poisson"),
    "ea_skin": plane(4, material="skin"),
    "metric_skin": plane(
        6, heights=(100.0, 140.0, 200.0), radii=(35.0, 52.5, 80.0, 100.0), **METRIC
    ),
    "near_ea_opaque": plane(4, heights=(50.0, 70.0, 85.0), radii=(52.5, 65.0, 80.0, 100.0)),
    "parallel_ea_opaque": plane(
        8,
        heights=(100.0, 140.0, 200.0),
        radii=(52.5, 80.0),
        build=BuildSettings(view="orthographic"),
    ),
    "power_ea_opaque": power(4),
    "power_metric_skin": power(3, **METRIC),
    "tilt_ea_opaque": tilt(4),
    "tilt_metric_skin": tilt(3, **METRIC),
    "resolution_ea_opaque": resolution(4),
    "resolution_metric_skin": resolution(3, **METRIC),
    "renderer_power": power(
        4, powers=(0.01, 0.03, 0.1, 0.3, 0.7, 1.0, 1.5, 2.0, 3.0, 10.0), camera="renderer"
    ),
    "renderer": _sweep(
        "height, radius and power under one fixed exposure",
        *(3, (100.0, 140.0, 180.0), (35.0, 52.5, 70.0), (0.3, 1.0, 3.0)),
        camera="renderer",
    ),
}


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--report", action="store_true", help="tables from rigs.json alone")
    parser.add_argument(
        "--sweeps", nargs="*", choices=SWEEPS, metavar="NAME", help=f"of {', '.join(SWEEPS)}"
    )
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--scratch", type=Path, default=OUT)
    own = parser.add_argument_group(
        "a sweep of your own, which is printed and not kept in rigs.json"
    )
    own.add_argument(
        "--heights", type=float, nargs="+", help="of camera and LEDs over the finger plane, mm"
    )
    own.add_argument(
        "--radii", type=float, nargs="+", default=[52.5], help="of the circle of LEDs, mm"
    )
    own.add_argument("--powers", type=float, nargs="+", default=[1.0], help="of one LED, W")
    own.add_argument(
        "--method", choices=("ea", "ea-poisson", "metric"), default="ea", help="metric: on skin"
    )
    own.add_argument("--fingers", type=int, default=2)
    chosen = parser.parse_args(arguments)
    if chosen.heights:
        axes = (chosen.heights, chosen.radii, chosen.powers)
        material = "skin" if chosen.method == "metric" else "opaque"
        sweep = _sweep("own", chosen.fingers, *axes, method=chosen.method, material=material)
        folder = chosen.scratch / f"own_{chosen.method}_{chosen.fingers}"
        print("\n".join(table("own", measured(sweep, folder, chosen.workers))))
        return 0
    results = (
        json.loads(RESULTS.read_text())
        if RESULTS.exists() and (chosen.report or chosen.sweeps)
        else {}
    )
    if not chosen.report:
        for name in chosen.sweeps or SWEEPS:
            results[name] = measured(SWEEPS[name], chosen.scratch / name, chosen.workers)
        RESULTS.write_text(
            json.dumps(results, separators=(",", ":")).replace("},{", "},\n{") + "\n"
        )
    for name, result in results.items():
        print("\n".join(table(name, result)))
    return 0


def table(name: str, result: Mapping[str, Any]) -> list[str]:
    """Lines of one sweep: every rig with its distances in mm (95 % intervals), the smallest
    first."""
    lines = [
        (
            f"{name}: {result['method']}, {result['material']}, {result['camera']},"
            f" {result['fingers']} fingers"
        ),
        ("height radius power  tilt px/mm  Hausdorff (=: as good as the best)   whole  ridges"),
    ]
    rows = [row for row in result["rows"] if row["status"] == "done"]
    for row in sorted(rows, key=lambda row: row["hausdorff_mm"]):
        its = dict(zip(COMPARED, row["compared"]["hausdorff"], strict=True))
        interval = (
            ""
            if its["low"] is None
            else f" ({its['low']:.3f} to {its['high']:.3f}), {its['worse_by']:+.3f} mm"
        )
        marks = " =" * its["as_good"]
        tilt = "centre" if row["tilt_deg"] is None else f"{row['tilt_deg']:g}"
        lines.append(
            f"{row['height_mm']:6g} {row['radius_mm']:6g} {row['power_w']:5g} {tilt:>6}"
            f" {row['px_per_mm']:5g}  {row['hausdorff_mm']:.3f}{interval}{marks}  "
            f" {row['whole_mm']:.3f}  {row['ridge_correlation']:.3f}"
        )
    return lines + [f"{row['name']}: {row['reason']}" for row in result["rows"] if row["reason"]]


def sweep_rigs(
    out: Path, candidates: Sequence[RigCandidate], study: ThesisStudy, workers: int = 1
) -> list[dict[str, Any]]:
    """Records of all candidates in their order; each is kept in `out` when it is finished, and not
    measured again."""
    out.mkdir(parents=True, exist_ok=True)
    files = {candidate: out / f"{candidate.name}.json" for candidate in candidates}
    waiting = [candidate for candidate, file in files.items() if not file.is_file()]
    with ProcessPoolExecutor(workers) as pool:
        for k, (candidate, record) in enumerate(
            zip(waiting, pool.map(study.record, waiting), strict=True), start=1
        ):
            files[candidate].write_text(json.dumps(record), encoding="ascii")
            print(f"\r{out.name} {k}/{len(waiting)}", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return [json.loads(file.read_text(encoding="ascii")) for file in files.values()]


def _mean_interval(values: Sequence[float]) -> tuple[float, float, float]:
    """Mean of `values` and Student's interval about it; one value alone has no interval: (value,
    -inf, inf)."""
    numbers = np.asarray(values, dtype=np.float64)
    mean = float(numbers.mean())
    if numbers.size == 1:
        return mean, -np.inf, np.inf
    half = float(stats.t.ppf(0.975, numbers.size - 1) * numbers.std(ddof=1) / np.sqrt(numbers.size))
    return mean, mean - half, mean + half


def _compare_with_best(records: Sequence[dict[str, Any]], figure: str) -> dict[str, dict[str, Any]]:
    """How much worse than the best every measured candidate is, finger by finger, by name, for a
    figure that is minimised: ``value`` and ``low``, ``high`` (95 % interval of the mean over the
    fingers; None for one finger), ``worse_by`` and ``worse_low``, ``worse_high`` (of the paired
    difference), and ``as_good``: that interval holds zero.
    """
    values = {
        record["candidate"]["name"]: np.array([f[figure] for f in record["fingers"]])
        for record in records
        if record["status"] == "done"
    }
    if not values:
        sys.exit(
            f"not one of the {len(records)} rigs can be built and measured: {records[0]['reason']}"
        )
    best = min(values, key=lambda name: (float(values[name].mean()), name))
    compared: dict[str, dict[str, Any]] = {}
    for name, own in values.items():
        ends = zip(
            ("value", "low", "high", "worse_by", "worse_low", "worse_high"),
            (*_mean_interval(own), *_mean_interval(own - values[best])),
            strict=True,
        )
        row: dict[str, Any] = {end: value if np.isfinite(value) else None for end, value in ends}
        compared[name] = {
            **row,
            "as_good": row["worse_low"] is None or row["worse_low"] <= 0.0,
            "best": name == best,
        }
    return compared


def measured(asked: Sweep, out: Path, workers: int) -> dict[str, Any]:
    """Sweep, and what the tables follow from."""
    records = sweep_rigs(out, asked.candidates, asked.study, workers)
    summaries = {
        objective: _compare_with_best(records, f"{objective}_mm")
        for objective in ("hausdorff", "whole", "rms")
    }
    rows = []
    for record in records:
        row = {name: value for name, value in record["candidate"].items() if name != "name"}
        row |= {
            "name": record["candidate"]["name"],
            "status": record["status"],
            "reason": record["reason"],
        }
        if record["mean"] is not None:
            row |= {key: round(value, 5) for key, value in record["mean"].items()}
            row["compared"] = {
                objective: [_short(its[row["name"]][key]) for key in COMPARED]
                for objective, its in summaries.items()
            }
        rows.append(row)
    study = asked.study
    asks = {
        "method": study.method,
        "material": study.material,
        "camera": study.camera,
        "fingers": study.fingers,
    }
    best = {
        objective: next(name for name, row in its.items() if row["best"])
        for objective, its in summaries.items()
    }
    return {
        "asks": asked.asks,
        **asks,
        "best": best,
        "rows": rows,
    }


def _short(value: float | bool | None) -> float | bool | None:
    return round(value, 4) if isinstance(value, float) else value


if __name__ == "__main__":
    sys.exit(main())
