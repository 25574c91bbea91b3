"""The batch engine: time of a reconstruction and of a comparison by each matcher, and disk.

    python benchmarks/bench_batch.py [--scale 0.4] [--fingers 3]

Comparisons are in processor time of one core, which others on the machine change little;
reconstructions by the clock.
"""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path

from splitknit.io.enrolment import FINGERS
from splitknit_match.batch.cases import preset_cases
from splitknit_match.batch.engine import run_batch
from splitknit_match.batch.store import Store
from splitknit_simulator.population.folder import simulate_population
from splitknit_simulator.population.sessions import PopulationSettings
from timing import machine

OUT = Path(__file__).parent / "out" / "batch"
ALL_PAIRS = 173_400
"""Of 170 fingers in four sessions."""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scale", type=float, default=0.4)
    parser.add_argument("--fingers", type=int, default=3)
    parser.add_argument("--cases", default="metric,ea")
    options = parser.parse_args()
    print(f"Batch, {machine()}")
    shutil.rmtree(OUT, ignore_errors=True)
    population = PopulationSettings(scale=options.scale)
    simulate_population(
        OUT / "people", population, subjects=2, sessions=2, fingers=FINGERS[: options.fingers]
    )
    cases = preset_cases(tuple(options.cases.split(",")))
    facts = run_batch(
        OUT / "people", OUT / "store", cases=cases, matchers=("ridge", "thesis", "minutiae"), jobs=1
    )
    files = [file for case in cases for file in Store(OUT / "store").files("features", case.name)]
    size = sum(file.stat().st_size for file in files) / len(files)
    reconstruction_s = facts["reconstruction_s"] / facts["reconstructed"]
    print(
        f"A reconstruction of {len(files)}: {reconstruction_s:.2f} s by the clock,"
        f" {size / 1e6:.1f} MB."
    )
    print(
        f"| case | matcher | how many | each | {ALL_PAIRS} of them, two cores |\n| --- | --- | ---"
        " | --- | --- |"
    )
    for scores in facts["scores"]:
        comparison_ms = scores["ms_per_comparison"]
        whole = f"{comparison_ms * ALL_PAIRS / 2 / 3.6e6:.2f} h"
        row = (
            scores["case"],
            scores["matcher"],
            str(scores["compared"]),
            f"{comparison_ms:.1f} ms of one core",
            whole,
        )
        print(f"| {' | '.join(row)} |")


if __name__ == "__main__":
    main()
