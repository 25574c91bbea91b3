"""The thesis's matching experiments on a simulated population: one command each, figures and plots
beside this file.

    python validation/thesis/run.py all --store STORE --population POPULATION
    python validation/thesis/run.py fusion|cases|matchers|sensitivity|failures|normals \\
        --store STORE --population POPULATION
    python validation/thesis/run.py scales|descriptors|figures --population POPULATION
    python validation/thesis/run.py family|people --store STORE --population POPULATION
    python validation/thesis/report.py     # tables for reading, from what lies here

``all`` may be stopped at any moment: the same command goes on. A part is made again only if the
population, the store, the options or the version changed since; within a part finished captures and
comparisons are kept in --scratch.

STORE is what ``splitknit batch`` made of POPULATION, a folder of ``splitknit simulate population``.
A store that is not finished is taken as far as it goes: a table has the comparisons that all of its
cases have, and says so.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from experiments import PARTS, WITHOUT_STORE, run_part
from variants import FINGER_LIMIT_DEG, GATE, PAIR_LIMIT_DEG

from splitknit.io.atomic import atomic_file
from splitknit.io.provenance import provenance, settings_hash
from tables import Row

HERE = Path(__file__).resolve().parent
CASES = ("snk", "pr", "ea", "pr-split", "ea-split", "metric")


def main(arguments: Sequence[str] | None = None) -> int:
    options = parse(arguments)
    parts = PARTS if options.part == "all" else (options.part,)
    options.out.mkdir(parents=True, exist_ok=True)
    truth = read_truth(options.population)
    for part in parts:
        inputs = inputs_of(options, part)
        if len(parts) > 1 and finished(options.out, part, inputs):
            print(part, "is finished", flush=True)
            continue
        started = time.perf_counter()
        facts = run_part(part, options, None if part in WITHOUT_STORE else _store(options), truth)
        facts |= {"seconds": round(time.perf_counter() - started, 1), "inputs_sha256": inputs}
        _remember(options.out / "runs.json", part, facts | _origin(options))
        print(part, json.dumps(facts), flush=True)
    return 0


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """Options of a call."""
    return _parser().parse_args(arguments)


def finished(out: Path, part: str, inputs: str) -> bool:
    """Whether a part has its table, made of the same."""
    runs = out / "runs.json"
    known = json.loads(runs.read_text(encoding="utf-8")) if runs.is_file() else {}
    return known.get(part, {}).get("inputs_sha256") == inputs and (out / f"{part}.csv").is_file()


def inputs_of(options: argparse.Namespace, part: str) -> str:
    """Hash of what a part's figures follow from: options, version, population and the files of the
    store."""
    names = ("cases", "people", "fraction")
    chosen = {name: str(getattr(options, name)) for name in names}
    store = options.store if part not in WITHOUT_STORE else None
    files = [] if store is None else sorted(path for path in store.rglob("*.npz") if path.is_file())
    sizes = [[Path(os.path.relpath(path, store)).as_posix(), path.stat().st_size] for path in files]
    captures = len(list(options.population.glob("*/session_*/*/impression.json")))
    return settings_hash([chosen, _origin(options), sizes, captures])


def read_truth(population: Path) -> dict[str, Row]:
    """``impression.json`` of each capture that is there, by its name."""
    files = sorted(population.glob("*/session_*/*/impression.json"))
    if not files:
        raise SystemExit(
            f"'{population}' holds no impression.json: name a folder of splitknit simulate"
            " population."
        )
    return {
        file.parent.relative_to(population).as_posix(): json.loads(file.read_text("utf-8"))
        for file in files
    }


def _remember(file: Path, part: str, facts: Row) -> None:
    known = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
    known[part] = facts
    with atomic_file(file) as stream:
        stream.write((json.dumps(known, indent=1, sort_keys=True) + "\n").encode("utf-8"))


def _origin(options: argparse.Namespace) -> Row:
    """What the figures follow from."""
    population = json.loads((options.population / "population.json").read_text(encoding="utf-8"))
    store = options.store / "store.json" if options.store is not None else None
    cases = (
        json.loads(store.read_text(encoding="utf-8"))["cases"]
        if store is not None and store.is_file()
        else {}
    )
    return {
        "version": provenance()["version"], "seed": options.seed, "replicates": options.replicates,
        "gate": GATE, "finger_limit_deg": FINGER_LIMIT_DEG, "pair_limit_deg": PAIR_LIMIT_DEG,
        "population_seed": population.get("settings", {}).get("seed"),
        "population_scale": population.get("settings", {}).get("scale"),
        "population_sha256": population["settings_sha256"],
        "cases_sha256": {name: case["settings_sha256"] for name, case in sorted(cases.items())},
    }  # fmt: skip


def _store(options: argparse.Namespace) -> Any:
    from splitknit_match.batch.store import Store

    if options.store is None:
        raise SystemExit("--store is needed: the folder that splitknit batch wrote.")
    return Store(options.store)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("part", choices=[*PARTS, "family", "people", "all"])
    parser.add_argument("--population", type=Path, required=True)
    parser.add_argument("--store", type=Path, default=None)
    parser.add_argument("--out", type=Path, default=HERE, help="of tables and plots")
    parser.add_argument(
        "--scratch",
        type=Path,
        default=HERE.parent / "out" / "thesis",
        help="what parts keep to go on when stopped",
    )
    parser.add_argument("--cases", nargs="+", default=list(CASES))
    parser.add_argument(
        "--people",
        type=int,
        default=5,
        help="whose fingers scales and descriptors take, from the first on",
    )
    parser.add_argument(
        "--fraction", type=float, default=1.0, help="of the impostor pairs, in normals"
    )
    parser.add_argument(
        "--captures", type=int, default=24, help="of the part figures, each of another finger"
    )
    parser.add_argument("--replicates", type=int, default=300)
    parser.add_argument("--seed", type=int, default=680)
    parser.add_argument("--jobs", type=int, default=2)
    return parser


if __name__ == "__main__":
    sys.exit(main())
