"""The batch engine: time of a reconstruction and of a comparison by each matcher, and disk.

    python benchmarks/bench_batch.py [--scale 0.4] [--fingers 3]      # makes a small population first
    python benchmarks/bench_batch.py --store STORE                    # what a store that is there took

Comparisons are in processor time of one core, which others on the machine change little; reconstructions by the clock.
"""

from __future__ import annotations

import argparse
import json
import shutil
from pathlib import Path

from splitknit.io.enrolment import FINGERS
from splitknit_match.batch.engine import run_batch
from splitknit_match.batch.settings import BatchSettings, preset_cases
from splitknit_match.batch.store import Store
from splitknit_simulator.population.folder import simulate_population
from splitknit_simulator.population.sessions import PopulationSettings
from timing import machine

OUT = Path(__file__).parent / "out" / "batch"
ALL_PAIRS = 173_400
"""Of 170 fingers in four sessions."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--store", type=Path, default=None)
    parser.add_argument("--scale", type=float, default=0.4)
    parser.add_argument("--fingers", type=int, default=3)
    parser.add_argument("--cases", default="metric,ea")
    options = parser.parse_args()
    print(f"Batch, {machine()}")
    if options.store is not None:
        print_store(options.store)
        return
    shutil.rmtree(OUT, ignore_errors=True)
    population = PopulationSettings(scale=options.scale)
    simulate_population(OUT / "people", population, subjects=2, sessions=2, fingers=FINGERS[: options.fingers])
    cases = preset_cases(tuple(options.cases.split(",")))
    settings = BatchSettings(cases=cases, matchers=("ridge", "thesis", "minutiae"), chunk_captures=2)
    facts = run_batch(OUT / "people", OUT / "store", settings, jobs=1)
    print_store(OUT / "store")
    print(f"Most memory of the process: {facts['peak_memory_mb']:.0f} MB.")


def print_store(folder: Path) -> None:
    head = ["case", "what", "how many", "each", f"{ALL_PAIRS} of them, two cores"]
    rows = [head, ["---"] * len(head)]
    for case in Store(folder).document()["cases"]:
        rows += reconstructions(folder, case) + comparisons(folder, case)
    for row in rows:
        print(f"| {' | '.join(row)} |")


def reconstructions(folder: Path, case: str) -> list[list[str]]:
    seconds = list(Store(folder).seconds(case).values())
    if not seconds:
        return []
    size = sum(file.stat().st_size for file in Store(folder).files("features", case)) / len(seconds)
    each = f"{sum(seconds) / len(seconds):.2f} s by the clock, {size / 1e6:.1f} MB"
    return [[case, "reconstruction", str(len(seconds)), each, ""]]


def comparisons(folder: Path, case: str) -> list[list[str]]:
    rows = []
    for place in sorted(one for one in (folder / "timings" / case).iterdir() if one.is_dir()):
        facts = [json.loads(file.read_bytes()) for file in sorted(place.glob("*.json"))]
        if place.name == "extraction":
            seconds = [value for fact in facts for value in fact.values()]
            each = f"{1000 * sum(seconds) / max(len(seconds), 1):.0f} ms by the clock"
            rows.append([case, "minutiae of a print", str(len(seconds)), each, ""])
        elif facts and "pairs" in facts[0]:
            pairs = sum(fact["pairs"] for fact in facts)
            pair_s = sum(fact["processor_s"] for fact in facts) / pairs
            whole = f"{pair_s * ALL_PAIRS / 2 / 3600:.2f} h"
            rows.append([case, place.name, f"{pairs:.0f}", f"{1000 * pair_s:.1f} ms of one core", whole])
    return rows


if __name__ == "__main__":
    main()
