"""A whole population, reconstructed in all cases and compared: what is missing, in chunks, by several processes.

Scores of the store come back as :class:`splitknit_match.evaluation.scores.Scores`, and as CSV files.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from splitknit import BadInput
from splitknit.errors import Refused, given_folders, open_at_once, require
from splitknit.io.atomic import atomic_file, hold, private_modes, sweep
from splitknit.io.targets import check_file
from splitknit.model import no_progress
from splitknit.verbs import Progress
from splitknit_match.batch.chunks import Table, read_chunk
from splitknit_match.batch.execution import Cluster, connected, run_tasks
from splitknit_match.batch.features import FeatureTask, MinutiaeTask, extract_minutiae, reconstruct_group
from splitknit_match.batch.matchers import READY, Matcher, matcher
from splitknit_match.batch.population import (
    Block,
    CaptureRef,
    Population,
    all_pairs,
    blocks_of,
    missing_pairs,
    read_population,
)
from splitknit_match.batch.reading import Place, drop_cached, stored_places
from splitknit_match.batch.scores import ScoreTask, score_block
from splitknit_match.batch.settings import BatchSettings, Case
from splitknit_match.batch.store import Store, check_store_target, open_store
from splitknit_match.evaluation.protocol import Comparisons
from splitknit_match.evaluation.scores import Scores, ids_of, score_table

_KINDS = ("finger", "subject", "session")
_CSV_BEGINS = b"label,score,finger_a,finger_b,subject_a,subject_b,session_a,session_b"


def to_scores(table: Table, column: str = "similarity") -> Scores:
    """Comparisons of the store (:meth:`~splitknit_match.batch.store.Store.scores`), to be evaluated. `column`: what is
    the score; of a ``dissimilarity...``, 1 - its value; NaN where nothing was compared.
    """
    require(column in table, f"the scores hold no column '{column}'; they have {list(table)}.")
    score = np.array(table[column], dtype=np.float64)
    score = 1.0 - score if column.startswith("dissimilarity") else score
    score[~table["compared"]] = np.nan
    sides = [[_names_of(one) for one in table[side].tolist()] for side in ("a", "b")]
    ids = {kind: ids_of(*([names[kind] for names in side] for side in sides)) for kind in _KINDS}
    return Scores(table["genuine"], score, **ids, name=column)


def _write_csv(path: Path, table: Table) -> None:
    """Write comparisons as a score file, with the matcher's own columns; blank where nothing was compared."""
    sides = [[_names_of(one) for one in table[side].tolist()] for side in ("a", "b")]
    own = [name for name in table if name not in ("a", "b", "genuine", "similarity", "compared")]
    numbers = {name: np.array(table[name], dtype=np.float64) for name in ("similarity", *own)}
    for values in numbers.values():
        values[~table["compared"]] = np.nan
    scores = {"score": numbers.pop("similarity").tolist(), **{name: each.tolist() for name, each in numbers.items()}}
    names = {kind: ([one[kind] for one in sides[0]], [one[kind] for one in sides[1]]) for kind in _KINDS}
    with atomic_file(path) as stream:
        stream.write(score_table(table["genuine"].tolist(), names, scores))


@lru_cache(maxsize=4096)
def _names_of(capture: str) -> dict[str, str]:
    """Finger (of the world), subject and session of a capture's name.

    >>> _names_of("S01/session_2/right_index")
    {'finger': 'S01/right_index', 'subject': 'S01', 'session': '2'}
    """
    subject, session, finger = parts if len(parts := capture.split("/")) == 3 else ("", "", "")
    cure = "run the batch again."
    require(bool(subject), f"{capture[:60]!a} names no capture, such as S01/session_2/right_index; {cure}")
    return {"finger": f"{subject}/{finger}", "subject": subject, "session": session.removeprefix("session_")}


@dataclass(frozen=True, slots=True)
class _Run:
    """One call of :func:`run_batch`."""

    store: Store
    population: Population
    settings: BatchSettings
    jobs: int
    client: Any
    device: str
    progress: Progress
    peaks_mb: list[float] = field(default_factory=list)

    def done(self, work: Callable[[Any], Any], tasks: Sequence[Any], words: str, sizes: Sequence[int]) -> list[Any]:
        """Do tasks, saying how far they are."""
        total, made, results = max(sum(sizes), 1), 0, []
        if tasks:
            self.progress(words, 0.0)
        for result in run_tasks(work, tasks, self.jobs, self.client, self.device):
            results.append(result)
            made += result.size
            self.peaks_mb.append(result.peak_memory_mb)
            self.progress(words, made / total)
        return results


def run_batch(
    population: str | Path,
    out: str | Path,
    settings: BatchSettings | None = None,
    *,
    jobs: int = 2,
    cluster: str | Cluster | None = None,
    csv: Path | None = None,
    device: str = "cpu",
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Do what the store lacks; return the facts.

    A population that is still being filled is taken as far as it is complete, and a later run takes the rest. A run may
    be killed at any time; the next one goes on. Raises Refused, when all else is done, if captures cannot be read: they
    get no row, and the next run looks at them again. Raises BadInput if the population holds no capture, the store is
    of something else, damaged or being written by another run, a worker is killed, or the cluster cannot be reached or
    must not be used.

    population : folder of ``splitknit simulate population`` or of an enrolment
    out : folder of the store
    cluster : its workers do it instead, and must see both places under the same names
    csv : folder for score files that ``splitknit evaluate`` reads; ``csv`` in the store where it is missing
    device : on which networks run, see :func:`splitknit.networks.unet.use_device`
    """
    started = time.perf_counter()
    settings = settings or BatchSettings()
    require(1 <= jobs <= 1024, f"jobs must be 1 to 1024, but it is {jobs}.")
    cluster = Cluster(cluster) if isinstance(cluster, str) else cluster
    people, folder = Path(population), Path(out)
    into = folder / "csv" if csv is None else csv
    every = [(case.name, name) for case in settings.cases for name in settings.matchers]
    tables = {(case, name): into / f"{case}_{name}.csv" for case, name in every}
    with contextlib.ExitStack() as stack:
        stack.enter_context(given_folders(one for one in (people, folder, csv) if one is not None))
        for table in tables.values():
            check_file(table, "a score file of a batch", lambda data: data.startswith(_CSV_BEGINS))
        there = read_population(people)
        client = None if cluster is None else stack.enter_context(connected(cluster))
        check_store_target(folder)
        folder = folder.resolve()
        stack.enter_context(alone(folder))
        sweep(folder)
        stack.callback(sweep, folder)  # of a worker that an interrupt ended
        run = _Run(open_store(folder, there, settings), there, settings, jobs, client, device, progress)
        facts = {"out": str(out), **_reconstruct(run)}
        try:
            facts["scores"] = _match(run)
            for (case, name), file in tables.items():
                progress(f"{case}: {name}, CSV", 1.0)
                _write_csv(file, run.store.scores(case, name))
        except BadInput as error:
            _require_readable(facts, f"the others are reconstructed, but not compared ({str(error).rstrip('.')})")
            raise
    facts |= {"csv": [str(file) for file in tables.values()], "peak_memory_mb": max(run.peaks_mb, default=None)}
    facts["seconds"] = time.perf_counter() - started
    _require_readable(facts, "the others are done")
    return facts


def _require_readable(facts: dict[str, Any], others: str) -> None:
    unread = facts["unreadable"]
    if unread:
        first = f"{unread[0]['capture']}: {unread[0]['reason'].rstrip('.')}"
        fault = f"{len(unread)} of {facts['captures']} captures cannot be read (first: {first}), {others}"
        raise Refused(f"{fault}; copy them again, or remove them, and run the same again.", facts)


def _reconstruct(run: _Run) -> dict[str, Any]:
    started = time.perf_counter()
    tasks = _feature_tasks(run.store, run.population, run.settings)
    sizes = [sum(len(names) for _, names in task.cases) for task in tasks]
    results = run.done(reconstruct_group, tasks, "reconstructing", sizes)
    unread = sorted(one for result in results for one in result.unreadable)
    return {
        "captures": len(run.population.captures),
        "planned": run.population.planned,
        "cases": [case.name for case in run.settings.cases],
        "reconstructed": sum(result.size for result in results),
        "found": len(run.population.captures) * len(run.settings.cases) - sum(sizes),
        "failures": sorted(failure for result in results for failure in result.failures),
        "unreadable": [{"capture": capture, "reason": reason} for capture, reason in unread],
        "reconstruction_s": time.perf_counter() - started,
    }


def _match(run: _Run) -> list[dict[str, Any]]:
    facts = []
    for case in run.settings.cases:
        for name in run.settings.matchers:
            started = time.perf_counter()
            using = matcher(name, run.settings.matching)
            if using.source != "features":
                chunks = _extraction_tasks(run, case)
                run.done(extract_minutiae, chunks, f"{case.name}: {using.source}", [1] * len(chunks))
            extraction_s = time.perf_counter() - started
            tasks = _score_tasks(run.store, run.population, run.settings, case, using)
            sizes = tasks.sizes()
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
    drop_cached()
    return facts


# One run at a time writes a store.

_FILE = ".lock"


@contextmanager
def alone(store: Path) -> Iterator[None]:
    """Hold the store for this run, a killed one lets go; BadInput if another holds it, or it cannot be written."""
    try:
        stream = os.fdopen(open_at_once(store / _FILE, os.O_CREAT | os.O_WRONLY, private_modes()[0]), "wb")
    except OSError as error:
        raise BadInput(f"cannot write into '{store}': {error.strerror or error}; choose another place.") from error
    with stream:
        hold(stream, f"another run is writing into '{store}'; wait for it, or stop it.")
        yield


# What the store lacks, as tasks: captures to reconstruct, prints whose minutiae are wanted, comparisons.


def _feature_tasks(store: Store, population: Population, settings: BatchSettings) -> list[FeatureTask]:
    """Captures that a case lacks, in groups that do not depend on what is there already."""
    lacking = [(case, store.captures(case.name)) for case in settings.cases]
    groups: dict[int, list[CaptureRef]] = {}
    size = settings.chunk_captures or min(max(population.planned // 32, 1), 10)
    for capture in population.captures:
        groups.setdefault(capture.place // size, []).append(capture)
    tasks = []
    for group, captures in sorted(groups.items()):
        names = [capture.name for capture in captures]
        wanted = [(case, tuple(name for name in names if name not in found)) for case, found in lacking]
        missing = tuple((case, names) for case, names in wanted if names)
        if missing:
            named = {name for _, names in missing for name in names}
            tasks.append(
                FeatureTask(
                    group,
                    population.folder.resolve(),
                    population.sha256,
                    store.folder,
                    tuple(capture for capture in captures if capture.name in named),
                    missing,
                    images=settings.surfaces,
                )
            )
    return tasks


def _extraction_tasks(run: _Run, case: Case) -> list[MinutiaeTask]:
    """Chunks of features beside which there are no minutiae."""
    there = {file.stem for file in run.store.files("minutiae", case.name)}
    files = [file for file in run.store.files("features", case.name) if file.stem not in there]
    return [MinutiaeTask(run.store.folder, case.name, file.stem) for file in files]


def _score_tasks(
    store: Store, population: Population, settings: BatchSettings, case: Case, using: Matcher
) -> _ScoreTasks:
    """Comparisons that are not in the store. Raises BadInput if there are captures of one session only."""
    features = stored_places(store.files("features", case.name))
    places = features if using.source == "features" else stored_places(store.files(using.source, case.name))
    captures = [capture for capture in population.captures if capture.name in places]
    every = all_pairs(captures, settings.impostors, settings.seed)
    pairs = missing_pairs(every, len(captures), _done(store, case.name, using.name, captures))
    case_sha256 = case.document()["settings_sha256"]

    def task(block: Block) -> ScoreTask:
        compared = zip(block.pairs.a.tolist(), block.pairs.b.tolist(), block.pairs.genuine.tolist(), strict=True)
        return ScoreTask(
            store=store.folder,
            case=case.name,
            case_sha256=case_sha256,
            population_sha256=population.sha256,
            matcher=using.name,
            matching=settings.matching,
            block=block.number,
            database=f"{case.name}, {captures[int(block.pairs.a[0])].session}, {block.number // 10_000 % 10_000}",
            pairs=tuple((captures[a].name, captures[b].name, genuine) for a, b, genuine in compared),
            places=_used(block.pairs, captures, places),
            origins=_used(block.pairs, captures, features),
            seed=settings.seed,
        )

    return _ScoreTasks(blocks_of(pairs, captures, using.blocks_for(settings.impostors)), task)


@dataclass(frozen=True, slots=True)
class _ScoreTasks(Sequence[ScoreTask]):
    """Tasks of blocks, each made when it is begun: the names of a million pairs take a hundred megabytes."""

    blocks: list[Block]
    make: Callable[[Block], ScoreTask]

    def __len__(self) -> int:
        return len(self.blocks)

    def __getitem__(self, place: Any) -> Any:
        return self.make(self.blocks[place])

    def sizes(self) -> list[int]:
        """Pairs of each."""
        return [block.pairs.a.size for block in self.blocks]


def _done(store: Store, case: str, matcher: str, captures: list[CaptureRef]) -> np.ndarray[Any, np.dtype[np.int64]]:
    """Comparisons in the store, as ``a * count + b``."""
    number = {capture.name: k for k, capture in enumerate(captures)}
    found: list[int] = []
    for file in store.files(f"scores/{case}", matcher):
        table = read_chunk(file, ["a", "b"])
        for a, b in zip(table["a"].tolist(), table["b"].tolist(), strict=True):
            if a in number and b in number:
                found.append(number[a] * len(captures) + number[b])
    return np.array(found, dtype=np.int64)


def _used(pairs: Comparisons, captures: list[CaptureRef], places: Mapping[str, Place]) -> dict[str, Place]:
    names = [captures[k].name for k in np.unique(np.concatenate([pairs.a, pairs.b])).tolist()]
    return {name: places[name] for name in names}
