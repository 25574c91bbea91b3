"""The batch engine: processor time of a comparison by each matcher, seconds of a reconstruction, disk, memory.

    python benchmarks/bench_batch.py [--scale 0.4] [--fingers 3]      # makes a small population first
    python benchmarks/bench_batch.py --store STORE                    # what a store that is there took

Comparisons are measured in processor time of one core, which others on the machine change little; reconstructions by
the clock.
"""

from __future__ import annotations

import argparse
import json
import shutil
from pathlib import Path

from splitknit.batch.engine import run_batch
from splitknit.batch.settings import BatchSettings, preset_cases
from splitknit.batch.simulate import simulate_population
from splitknit.batch.store import Store
from splitknit.capture.enrolment import FINGERS
from splitknit.simulator.population.sessions import PopulationSettings
from timing import machine

OUT = Path(__file__).parent / "out" / "batch"
ALL_PAIRS = 173_400
"""Of 170 fingers in four sessions."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--store", type=Path, default=None)
    parser.add_argument("--scale", type=float, default=0.4)
    parser.add_argument("--fingers", type=int, default=3)
    options = parser.parse_args()
    peak = None
    store = options.store
    if store is None:
        people, store = OUT / "people", OUT / "store"
        shutil.rmtree(OUT, ignore_errors=True)
        settings = PopulationSettings(scale=options.scale)
        simulate_population(people, settings, subjects=2, sessions=2, fingers=FINGERS[: options.fingers])
        batch = BatchSettings(cases=preset_cases(("metric", "ea")), matchers=("ridge", "thesis", "minutiae"))
        peak = run_batch(people, store, batch, jobs=1)["peak_memory_mb"]
    print(f"Batch, {machine()}")
    rows: list[list[str]] = []
    for case in Store(store).cases():
        rows += reconstructions(store, case) + comparisons(store, case)
    head = ["case", "what", "how many", "each", f"{ALL_PAIRS} of them, two cores"]
    for row in (head, ["---"] * len(head), *rows):
        print(f"| {' | '.join(row)} |")
    if peak is not None:
        print(f"Most memory of the process: {peak:.0f} MB.")


def reconstructions(store: Path, case: str) -> list[list[str]]:
    seconds = list(Store(store).seconds(case).values())
    if not seconds:
        return []
    size = sum(file.stat().st_size for file in Store(store).files("features", case)) / len(seconds)
    each = f"{sum(seconds) / len(seconds):.2f} s by the clock, {size / 1e6:.1f} MB"
    return [[case, "reconstruction", str(len(seconds)), each, ""]]


def comparisons(store: Path, case: str) -> list[list[str]]:
    rows = []
    for folder in sorted((store / "timings" / case).glob("*")):
        facts = [json.loads(file.read_text()) for file in folder.glob("*.json")] if folder.is_dir() else []
        if folder.name == "extraction":
            seconds = [value for fact in facts for value in fact.values()]
            rows.append([case, "minutiae of a print", str(len(seconds)), f"{mean_ms(seconds):.0f} ms by the clock", ""])
        elif facts:
            pairs = sum(fact["pairs"] for fact in facts)
            each = sum(fact["processor_s"] for fact in facts) / pairs
            whole = f"{each * ALL_PAIRS / 2 / 3600:.2f} h"
            rows.append([case, folder.name, str(pairs), f"{1000 * each:.1f} ms of one core", whole])
    return rows


def mean_ms(seconds: list[float]) -> float:
    return 1000 * sum(seconds) / max(len(seconds), 1)


if __name__ == "__main__":
    main()
