"""A whole population, reconstructed in all cases and compared: what is missing, in chunks, by several processes."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from splitknit.batch.execution import Cluster, connected, run_tasks
from splitknit.batch.export import write_csv
from splitknit.batch.features import reconstruct_group
from splitknit.batch.lock import alone
from splitknit.batch.matchers import READY, matcher
from splitknit.batch.packages import load
from splitknit.batch.population import Population, read_population
from splitknit.batch.prints import extract_minutiae
from splitknit.batch.reading import forget
from splitknit.batch.scores import score_block
from splitknit.batch.settings import BatchSettings
from splitknit.batch.solids import SOLIDS, extract_solids
from splitknit.batch.stages import feature_tasks, minutiae_tasks, score_tasks, solid_tasks, voted_tasks
from splitknit.batch.store import Store, check_target, open_store, sweep
from splitknit.batch.voted import extract_voted
from splitknit.errors import require

Progress = Callable[[str, float], None]


def no_progress(stage: str, share: float) -> None:
    """Say nothing."""


@dataclass(frozen=True, slots=True)
class _Run:
    """One call of :func:`run_batch`."""

    store: Store
    population: Population
    settings: BatchSettings
    jobs: int
    client: Any
    progress: Progress
    peaks_mb: list[float] = field(default_factory=list)

    def done(self, work: Callable[[Any], Any], tasks: Sequence[Any], words: str, sizes: Sequence[int]) -> list[Any]:
        """Do tasks, saying how far they are."""
        total, made, results = max(sum(sizes), 1), 0, []
        if tasks:
            self.progress(words, 0.0)
        for result in run_tasks(work, tasks, self.jobs, self.client):
            results.append(result)
            made += result.size
            self.peaks_mb.append(result.peak_memory_mb)
            self.progress(words, made / total)
        return results


def run_batch(
    population: Path,
    out: Path,
    settings: BatchSettings | None = None,
    *,
    jobs: int = 2,
    cluster: str | Cluster | None = None,
    csv: Path | None = None,
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
    cluster : Cluster or its address; its workers do it instead, and must see both folders under the same names
    csv : folder for score files that ``splitknit evaluate --scores`` reads; ``csv`` in the store where it is missing
    progress : called with words and the share that is done

    Raises
    ------
    BadInput
        If the population holds no capture, the store is of something else, damaged or being written by another run, a
        worker is killed, or the cluster cannot be reached or must not be used.
    """
    started = time.perf_counter()
    settings = settings or BatchSettings()
    load("pyarrow", "batch")
    require(1 <= jobs <= 1024, f"jobs must be 1 to 1024, but it is {jobs}.")
    cluster = Cluster(cluster) if isinstance(cluster, str) else cluster
    there = read_population(population)
    with contextlib.ExitStack() as stack:
        client = None if cluster is None else stack.enter_context(connected(cluster))
        check_target(out)
        folder = out.resolve()
        stack.enter_context(alone(folder))
        run = _Run(open_store(folder, there, settings), there, settings, jobs, client, progress)
        sweep(folder)
        facts = _reconstruct(run) | {"scores": _match(run)}
        written = _export(run, folder / "csv" if csv is None else csv)
    return (
        {"out": str(out)}
        | facts
        | {"csv": written, "peak_memory_mb": max(run.peaks_mb, default=None), "seconds": time.perf_counter() - started}
    )


def _reconstruct(run: _Run) -> dict[str, Any]:
    started = time.perf_counter()
    tasks = feature_tasks(run.store, run.population, run.settings)
    sizes = [sum(len(names) for _, names in task.cases) for task in tasks]
    results = run.done(reconstruct_group, tasks, "reconstructing", sizes)
    return {
        "captures": len(run.population.captures),
        "planned": run.population.planned,
        "cases": [case.name for case in run.settings.cases],
        "reconstructed": sum(sizes),
        "found": len(run.population.captures) * len(run.settings.cases) - sum(sizes),
        "failures": sorted(failure for result in results for failure in result.failures),
        "reconstruction_s": time.perf_counter() - started,
    }


def _match(run: _Run) -> list[dict[str, Any]]:
    facts = []
    for case in run.settings.cases:
        for name in run.settings.matchers:
            started = time.perf_counter()
            using = matcher(name, run.settings.matching)
            if using.source == "minutiae":
                prints = minutiae_tasks(run.store, case)
                run.done(extract_minutiae, prints, f"{case.name}: minutiae", [1] * len(prints))
            if using.source == "voted":
                sets = voted_tasks(run.store, run.population, case, run.settings)
                run.done(extract_voted, sets, f"{case.name}: voted minutiae", [1] * len(sets))
            if using.source in SOLIDS:
                chunks = solid_tasks(run.store, case, using.source, run.settings)
                run.done(extract_solids, chunks, f"{case.name}: {using.source}", [1] * len(chunks))
            extraction_s = time.perf_counter() - started
            tasks = score_tasks(run.store, run.population, run.settings, case, using)
            sizes = [len(task.pairs) for task in tasks]
            results = run.done(score_block, tasks, f"{case.name}: {name}", sizes)
            work_s = sum(result.seconds for result in results)
            facts.append(
                {
                    "case": case.name,
                    "matcher": name,
                    "compared": sum(sizes),
                    "extraction_s": extraction_s,
                    "seconds": time.perf_counter() - started,
                    "ms_per_comparison": 1000 * work_s / sum(sizes) if tasks else None,
                }
            )
    READY.forget()
    forget()
    return facts


def _export(run: _Run, folder: Path) -> list[str]:
    files = []
    for case in run.settings.cases:
        for name in run.settings.matchers:
            run.progress(f"{case.name}: {name}, CSV", 1.0)
            file = folder / f"{case.name}_{name}.csv"
            write_csv(file, run.store.scores(case.name, name))
            files.append(str(file))
    return files
