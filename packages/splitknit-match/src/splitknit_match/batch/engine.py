"""A whole population, reconstructed in all cases and compared: what is missing, and the scores as
files."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from splitknit import BadInput
from splitknit.errors import Refused, refusing, require
from splitknit.files import given_folders
from splitknit.findings import Finding
from splitknit.io.atomic import write_file
from splitknit.io.provenance import provenance, settings_hash
from splitknit.io.targets import check_file
from splitknit.model import Progress, no_progress
from splitknit_match.batch.cases import Case, preset_cases
from splitknit_match.batch.features import extract_minutiae, reconstruct_capture
from splitknit_match.batch.matchers import matcher_of
from splitknit_match.batch.population import (
    Population,
    all_pairs,
    blocks_of,
    chosen_pairs,
    read_population,
)
from splitknit_match.batch.store import (
    SCORES,
    SUFFIX,
    Place,
    Store,
    Table,
    locked,
    open_store,
    read_origin,
    read_table,
    write_table,
)
from splitknit_match.evaluation.protocol import Comparisons
from splitknit_match.evaluation.scores import score_table
from splitknit_match.tasks import Done, Task, Work, connected, run_tasks

_CSV_BEGINS = b"label,score,finger_a,finger_b,subject_a,subject_b,session_a,session_b"


@dataclass(frozen=True, slots=True)
class _Run:
    """A store, what it is filled with, and who does it."""

    store: Store
    population: Population
    impostors: float
    seed: int
    jobs: int
    client: Any
    progress: Progress

    def done(self, work: Work[Task], tasks: Sequence[Task], words: str) -> list[Done]:
        """Do tasks, reporting progress."""
        results = []
        for result in run_tasks(work, tasks, self.jobs, self.client):
            results.append(result)
            self.progress(words, len(results) / len(tasks))
        return results


def run_batch(
    population: str | Path,
    out: str | Path,
    *,
    cases: Sequence[Case] = preset_cases(),
    matchers: Sequence[str] = ("ridge",),
    impostors: float = 1.0,
    seed: int = 0,
    surfaces: bool = True,
    jobs: int = 2,
    scheduler: str | None = None,
    progress: Progress = no_progress,
) -> dict[str, Any]:
    """Do what the store lacks; return the facts.

    A population that is still being filled is taken as far as it is complete. A run may be killed
    at any time; the next one goes on.

    Parameters
    ----------
    population : str or Path
        Folder of ``splitknit simulate population`` or of an enrolment.
    out : str or Path
        Folder of the store, with score files that ``splitknit evaluate`` reads in ``csv``.
    cases : sequence of Case
        Methods of reconstruction, each of its own name.
    matchers : sequence of str
        Names in ``MATCHERS``, or your own (``module:function``, as of
        :func:`splitknit_match.match`); none: reconstruct only.
    impostors, seed : float, int
        Fraction of the comparisons of different fingers that is made, 0 to 1, and which.
    surfaces : bool
        Keep the surfaces, about 3.7 MB a reconstruction at 30 px/mm: the thesis's matcher needs
        them.
    jobs : int
        Processes at most.
    scheduler : str, optional
        Address of a Dask scheduler, whose workers do it instead; they must see both folders under
        the same names.

    Raises
    ------
    Refused
        When all else is done, if captures cannot be read: they get no row, and the next run looks
        at them again.
    BadInput
        If the population holds no capture, the store is of something else, damaged or being
        written, a worker is killed, or the scheduler cannot be reached or must not be used.
    """
    _check(cases, matchers, impostors, jobs)
    people, folder = Path(population), Path(out)
    compared = [(case, name) for case in cases for name in matchers]
    files = [folder / "csv" / f"{case.name}_{name}.csv" for case, name in compared]
    with contextlib.ExitStack() as stack:
        stack.enter_context(given_folders((people, folder)))
        for file in files:
            check_file(file, "a score file of a batch", lambda data: data.startswith(_CSV_BEGINS))
        captures = read_population(people)
        client = scheduler and stack.enter_context(connected(scheduler))
        folder = folder.resolve()
        stack.enter_context(locked(folder))
        case_documents = {case.name: case.document() for case in cases}
        documents = {name: matcher_of(name).document for name in matchers}
        pairs = {"impostors": impostors, "seed": seed}
        store = open_store(folder, captures.sha256, case_documents, documents, pairs)
        run = _Run(store, captures, impostors, seed, jobs, client, progress)
        facts = {"out": str(out), **_reconstruct(run, cases, surfaces)}
        facts["findings"] = [finding.facts for finding in _findings(facts)]
        try:
            facts["scores"] = [_compare(run, case, name) for case, name in compared]
            for (case, name), file in zip(compared, files, strict=True):
                write_scores(file, store.scores(case.name, name))
        except BadInput as error:
            reason = str(error).rstrip(".")
            _require_readable(facts, f"the others are reconstructed, but not compared ({reason})")
            raise
    facts["csv"] = [str(file) for file in files]
    _require_readable(facts, "the others are done")
    return facts


def _check(cases: Sequence[Case], matchers: Sequence[str], impostors: float, jobs: int) -> None:
    require(1 <= jobs <= 1024, f"jobs must be 1 to 1024, but it is {jobs}.")
    require(0 <= impostors <= 1, f"impostors must be from 0 to 1, but it is {impostors}.")
    require(cases, "a batch needs at least one case.")
    names = {case.name for case in cases}
    require(len(names) == len(cases), "two cases have one name; give each its own.")
    for name in matchers:
        matcher_of(name)


def _reconstruct(run: _Run, cases: Sequence[Case], surfaces: bool) -> dict[str, Any]:
    """Reconstruct the captures that a case lacks; return the facts."""
    started = time.perf_counter()
    finished = {case.name: run.store.places("features", case.name) for case in cases}
    population = run.population
    tasks = []
    for capture in population.captures:
        lacking = [case for case in cases if capture.name not in finished[case.name]]
        if lacking:
            tasks.append((capture, lacking))
    people = population.folder.resolve()
    work = partial(reconstruct_capture, run.store.folder, people, population.sha256, surfaces)
    results = run.done(work, tasks, "reconstructing")
    unreadable = sorted(capture for result in results for capture in result.unreadable)
    count, lacking_count = len(population.captures), sum(len(lacking) for _, lacking in tasks)
    return {
        "captures": count,
        "planned": population.planned,
        "cases": [case.name for case in cases],
        "reconstructed": sum(result.size for result in results),
        "found": count * len(cases) - lacking_count,
        "failures": sorted(failure for result in results for failure in result.failures),
        "unreadable": [{"capture": name, "reason": reason} for name, reason in unreadable],
        "reconstruction_s": time.perf_counter() - started,
    }


def _findings(facts: Mapping[str, Any]) -> list[Finding]:
    """What a reader of the scores has to know."""
    findings = []
    if waiting := facts["planned"] - facts["captures"]:
        words = (
            f"{waiting} captures of the plan are not there yet; run the same again when they are."
        )
        findings.append(Finding("captures-missing", words))
    if failures := facts["failures"]:
        words = f"{len(failures)} failures to acquire now; the first: {failures[0]}"
        findings.append(Finding("failure-to-acquire", words))
    return findings


def _require_readable(facts: dict[str, Any], others: str) -> None:
    unreadable = facts["unreadable"]
    if unreadable:
        first = f"{unreadable[0]['capture']}: {unreadable[0]['reason'].rstrip('.')}"
        raise Refused(
            f"{len(unreadable)} of {facts['captures']} captures cannot be read (first: {first}),"
            f" {others}; copy them again, or remove them, and run the same again.",
            facts,
        )


def _compare(run: _Run, case: Case, name: str) -> dict[str, Any]:
    """Make the comparisons of a case by a matcher that the store lacks; return the facts."""
    if matcher_of(name).source == "minutiae":
        features, target = (
            run.store.folder / kind / case.name for kind in ("features", "minutiae")
        )
        files = run.store.files("features", case.name)
        lacking = [file for file in files if not (target / file.relative_to(features)).is_file()]
        run.done(partial(extract_minutiae, features, target), lacking, f"{case.name}: minutiae")
    origin = {
        "case": case.name,
        "case_sha256": case.document()["settings_sha256"],
        "matcher": name,
        "population_sha256": run.population.sha256,
        "seed": run.seed,
    }
    work = partial(compare_block, run.store.folder / "scores" / case.name / name, name, origin)
    results = run.done(work, _blocks(run, case.name, name), f"{case.name}: {name}")
    compared = sum(result.size for result in results)
    seconds = sum(result.seconds for result in results)
    return {
        "case": case.name,
        "matcher": name,
        "compared": compared,
        "ms_per_comparison": 1000 * seconds / compared if compared else None,
    }


def _blocks(run: _Run, case: str, name: str) -> list[Block]:
    """Comparisons that the store lacks. Raises BadInput if all captures are of one session."""
    matcher = matcher_of(name)
    places = run.store.places(matcher.source, case)
    captures = [capture for capture in run.population.captures if capture.name in places]
    number = {capture.name: k for k, capture in enumerate(captures)}
    finished = [
        number[a] * len(captures) + number[b]
        for file in run.store.files(f"scores/{case}", name)
        for a, b in zip(*read_table(file, ["a", "b"]).values(), strict=True)
        if a in number and b in number
    ]
    blocks = []
    every = all_pairs(captures, run.impostors, run.seed)
    for block in blocks_of(every, captures, matcher.fingers):
        pairs = chosen_pairs(block, ~np.isin(block.a * len(captures) + block.b, finished))
        used = np.unique([pairs.a, pairs.b]).tolist()
        names = {k: captures[k].name for k in used}
        if names:
            blocks.append(Block(pairs, names, {k: places[names[k]] for k in used}))
    return blocks


@dataclass(frozen=True, slots=True)
class Block:
    """Comparisons that are made together."""

    pairs: Comparisons
    names: Mapping[int, str]  # of the captures that are compared
    places: Mapping[int, Place]  # where the matcher's input is


def compare_block(folder: Path, name: str, origin: Mapping[str, Any], block: Block) -> Done:
    """Make the comparisons of a block by the matcher `name`, and write their table."""
    started = time.thread_time()
    matcher, names, places = matcher_of(name), block.names, block.places
    missing = dict.fromkeys(("similarity", *matcher.columns), math.nan)
    earlier = {int(a): matcher.database(places[a]) for a in np.unique(block.pairs.a)}
    rows = []
    query = None
    previous = -1
    columns = (block.pairs.a, block.pairs.b, block.pairs.genuine)
    for a, b, genuine in zip(*(column.tolist() for column in columns), strict=True):
        if b != previous:  # one query after the other
            query, previous = matcher.query(places[b]), b
        compared = earlier[a] is not None and query is not None
        values = matcher.compare(earlier[a], query) if compared else missing
        row = {"a": names[a], "b": names[b], "genuine": genuine}
        rows.append(row | {"similarity": values["similarity"], "compared": compared} | values)
    inputs = {names[k]: read_origin(places[k].file)["inputs"][names[k]] for k in names}
    origin = {**provenance(matcher.document, inputs), "kind": "scores", "kind_version": 1, **origin}
    content = settings_hash([origin, [(row["a"], row["b"]) for row in rows]])
    write_table(folder / f"{content[:24]}{SUFFIX}", rows, origin)
    return Done(len(rows), time.thread_time() - started)


def write_scores(path: Path, table: Table) -> None:
    """Write comparisons of a store as a score file, with the matcher's own columns; what was not
    compared is blank.
    """
    names: dict[str, list[list[str]]] = {"finger": [], "subject": [], "session": []}
    with refusing("a table of scores names no capture, such as S01/session_2/right_index."):
        for side in "ab":
            parts = [capture.split("/") for capture in table[side].tolist()]
            names["finger"].append([f"{subject}/{finger}" for subject, _, finger in parts])
            names["subject"].append([subject for subject, _, _ in parts])
            names["session"].append([session.removeprefix("session_") for _, session, _ in parts])
    own = {name: column.tolist() for name, column in table.items() if name not in SCORES}
    scores = {"score": table["similarity"].tolist(), **own}
    sides = {kind: (a, b) for kind, (a, b) in names.items()}
    write_file(path, score_table(table["genuine"].tolist(), sides, scores))
