"""How accurate are the presets on fingers of the digital twin?

    python validation/accuracy/run.py                          # 24 drawn fingers: metric, ea, snk
    python validation/accuracy/report.py  # docs/experiments/accuracy.md, tables/ from results.json

One JSON per finger lands in ``validation/out/accuracy`` under a hash of the package's sources, so
that a run that was stopped goes on where it was, and results of other code are never mixed in. One
process a core; figures do not depend on how many. The population of ``results.json`` is replaced.
"""

from __future__ import annotations

import argparse
import concurrent.futures
import json
import multiprocessing
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
OUT = HERE.parent / "out" / "accuracy"
PRESETS = ("metric", "ea", "snk")


def main(arguments: Sequence[str] | None = None) -> int:
    options = _parser().parse_args(arguments)
    # before numpy is imported: one thread of linear algebra a process
    os.environ.update(
        dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    )
    from measure import Case, source_hash

    from report import population_csv

    presets = tuple(options.presets)
    seeds = range(options.first_seed, options.first_seed + options.fingers)
    cases = [Case(seed, k, options.scale) for seed in seeds for k in range(options.impressions)]
    code = source_hash()
    measured = _measure_all(
        cases, presets, options.scratch / f"{code[:12]}_{options.scale:g}", options.workers
    )
    results = _read(options.out)
    common = {
        "source_sha256": code,
        "scale": options.scale,
        "first_seed": seeds.start,
        "fingers": len(seeds),
    }
    results["population"] = _population(
        measured, presets, {**common, "impressions": options.impressions}
    )
    options.out.write_text(
        json.dumps(_rounded(results), indent=1, sort_keys=True) + "\n", encoding="ascii"
    )
    print(population_csv(results["population"]))
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--fingers", type=int, default=24)
    parser.add_argument(
        "--first-seed", type=int, default=1000, help="fingers have this seed and those that follow"
    )
    parser.add_argument(
        "--impressions",
        type=int,
        default=1,
        help="captures of each finger, each in a pose of its own",
    )
    parser.add_argument("--scale", type=float, default=0.5, help="1 = 3200 x 2200 pixels")
    parser.add_argument("--presets", nargs="+", default=PRESETS)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes")
    parser.add_argument("--out", type=Path, default=HERE / "results.json")
    parser.add_argument("--scratch", type=Path, default=OUT, help="folder of the single results")
    return parser


def _measure_all(
    cases: Sequence[Any], presets: Sequence[str], folder: Path, workers: int
) -> list[dict[str, Any]]:
    """Results of all cases in their order; those that are on disk already are not measured
    again."""
    folder.mkdir(parents=True, exist_ok=True)
    wanted = {
        case.name: case for case in cases if not _holds(folder / f"{case.name}.json", presets)
    }
    context = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(
        workers, mp_context=context, initializer=_one_thread
    ) as pool:
        for job in [
            pool.submit(_measure_one, case, tuple(presets), folder) for case in wanted.values()
        ]:
            job.result()
    return [json.loads((folder / f"{case.name}.json").read_text()) for case in cases]


def _holds(file: Path, presets: Sequence[str]) -> bool:
    return file.is_file() and set(presets) <= set(json.loads(file.read_text())["presets"])


def _one_thread() -> None:
    import cv2

    cv2.setNumThreads(1)


def _measure_one(case: Any, presets: tuple[str, ...], folder: Path) -> None:
    from measure import measure

    file = folder / f"{case.name}.json"
    result = measure(case, presets)
    partial = file.with_suffix(".partial")
    partial.write_text(json.dumps(result, indent=1))
    partial.replace(file)


def _population(
    measured: Sequence[Any], presets: Sequence[str], common: dict[str, Any]
) -> dict[str, Any]:
    from summary import ROWS, summarise

    reported = [name for name, row in ROWS.items() if row.least is not None]
    singles = [
        {
            "seed": m["seed"],
            "impression": m["impression"],
            "pattern": m["drawn"]["pattern"],
            "scattering": m["drawn"]["skin_scattering_factor"],
            "glare": m["drawn"]["skin_glare"],
            "roughness": m["drawn"]["skin_roughness"],
            "melanin": m["drawn"]["skin_melanin"],
            "figures": {
                preset: {name: m["presets"][preset]["figures"][name] for name in reported}
                for preset in presets
                if "figures" in m["presets"][preset]
            },
        }
        for m in measured
    ]
    return {**common, "presets": summarise(measured, presets), "singles": singles}


def _read(file: Path) -> dict[str, Any]:
    return (
        dict(json.loads(file.read_text()))
        if file.is_file()
        else {"format": "splitknit-accuracy", "version": 1}
    )


def _rounded(value: Any) -> Any:
    """Five digits: what is committed should not change where nothing did."""
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    return float(f"{value:.5g}") if isinstance(value, float) else value


if __name__ == "__main__":
    sys.exit(main())
