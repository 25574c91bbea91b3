"""A whole population, reconstructed in all cases: what is missing, in chunks, by several processes."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from splitknit.batch.execution import run_tasks
from splitknit.batch.features import FeatureTask, reconstruct_group
from splitknit.batch.lock import alone
from splitknit.batch.packages import load
from splitknit.batch.population import CaptureRef, Population, read_population
from splitknit.batch.settings import BatchSettings
from splitknit.batch.store import Store, check_target, open_store, sweep
from splitknit.check import require

Progress = Callable[[str, float], None]


def no_progress(stage: str, share: float) -> None:
    """Say nothing."""


def run_batch(
    population: Path,
    out: Path,
    settings: BatchSettings | None = None,
    *,
    jobs: int = 2,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Do what the store lacks; return the facts.

    A population that is still being filled is taken as far as it is complete, and a later run takes the rest. A run may
    be killed at any time; the next one goes on.

    Parameters
    ----------
    population : folder of ``splitknit simulate population`` or of an enrolment
    out : folder of the store
    settings : BatchSettings, optional
    jobs : processes; nothing but time depends on their number
    progress : called with words and the share that is done

    Raises
    ------
    BadInput
        If the population holds no capture, the store is of something else, damaged or being written by another run, or
        a worker is killed.
    """
    started = time.perf_counter()
    settings = settings or BatchSettings()
    load("pyarrow", "batch")
    require(1 <= jobs <= 1024, f"jobs must be 1 to 1024, but it is {jobs}.")
    there = read_population(population)
    check_target(out)
    with alone(out):
        store = open_store(out, there, settings)
        sweep(out)
        facts = _reconstruct(store, there, settings, jobs, progress)
    return facts | {"seconds": time.perf_counter() - started}


def feature_tasks(store: Store, population: Population, settings: BatchSettings) -> list[FeatureTask]:
    """Captures that a case lacks, in groups that do not depend on what is there already."""
    lacking = [(case, store.captures(case.name)) for case in settings.cases]
    groups: dict[int, list[CaptureRef]] = {}
    for capture in population.captures:
        groups.setdefault(capture.place // settings.chunk_captures, []).append(capture)
    tasks = []
    for group, captures in sorted(groups.items()):
        wanted = [
            (case, tuple(capture.name for capture in captures if capture.name not in found)) for case, found in lacking
        ]
        missing = tuple((case, names) for case, names in wanted if names)
        if missing:
            named = {name for _, names in missing for name in names}
            chosen = tuple(capture for capture in captures if capture.name in named)
            tasks.append(
                FeatureTask(
                    group,
                    population.folder,
                    population.sha256,
                    store.folder,
                    chosen,
                    missing,
                    settings.matching,
                    images=True,
                )
            )
    return tasks


def _reconstruct(
    store: Store, population: Population, settings: BatchSettings, jobs: int, progress: Progress
) -> dict[str, Any]:
    tasks = feature_tasks(store, population, settings)
    rows = sum(len(names) for task in tasks for _, names in task.cases)
    done = 0
    failures: list[str] = []
    progress("reconstructing", 0.0)
    for result in run_tasks(reconstruct_group, tasks, jobs):
        done += result.rows
        failures += result.failures
        progress("reconstructing", done / max(rows, 1))
    return {
        "out": str(store.folder),
        "captures": len(population.captures),
        "planned": population.planned,
        "cases": [case.name for case in settings.cases],
        "reconstructed": rows,
        "found": len(population.captures) * len(settings.cases) - rows,
        "failures": failures,
    }
