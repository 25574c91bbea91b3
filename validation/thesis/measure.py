"""Rates of trials with intervals, and their differences, as rows of tables."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from itertools import combinations, product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from trials import Table, Trial
from variants import VARIANTS, Known, Variant, judged

from splitknit_match.evaluation.intervals import (
    TARGETS,
    BootstrapSettings,
    Interval,
    bootstrap,
    differences,
)
from splitknit_match.evaluation.scores import Scores
from tables import Row

METHODS = ("finger", "subject")


@dataclass(frozen=True, slots=True, eq=False)
class Work:
    """What the tasks of a table share."""

    table: Table
    known: Known
    passing: NDArray[np.bool_]
    settings: BootstrapSettings

    def judged(self, trial: Trial, variant: Variant) -> Scores | None:
        return judged(self.table.pairs, trial, variant, self.known, self.passing)


def rate_rows(
    work: Work, trials: Sequence[Trial], jobs: int = 1, variants: Sequence[Variant] = VARIANTS
) -> list[Row]:
    """One row for each trial and variant."""
    return _in_parallel(_rate_row, work, list(product(trials, variants)), jobs)


def difference_rows(
    work: Work, groups: Iterable[Sequence[Trial]], variants: Sequence[Variant], jobs: int = 1
) -> list[Row]:
    """One row for each two trials of a group and each variant: first minus second, on the same
    comparisons."""
    tasks = [
        (*two, variant)
        for group in groups
        for two in combinations(group, 2)
        for variant in variants
    ]
    return _in_parallel(_difference_row, work, tasks, jobs)


def _rate_row(work: Work, trial: Trial, variant: Variant) -> Row:
    head = {
        "case": trial.case,
        "matcher": trial.matcher,
        "attribute": trial.attribute,
        **asdict(variant),
    }
    scores = work.judged(trial, variant)
    methods = METHODS if variant.kept not in ("pairs", "fingers") else METHODS[:1]
    return {**head, **(_nothing() if scores is None else rates_of(scores, work.settings, methods))}


def _difference_row(work: Work, first: Trial, second: Trial, variant: Variant) -> Row:
    head = {
        "first": first.label,
        "second": second.label,
        "matcher": first.matcher,
        "attribute": first.attribute,
        **asdict(variant),
    }
    sides = [work.judged(trial, variant) for trial in (first, second)]
    if sides[0] is None or sides[1] is None:
        return {**head, **_nothing()}
    return {**head, **differences_of(sides[0], sides[1], work.settings)}


def rates_of(scores: Scores, settings: BootstrapSettings, methods: Sequence[str] = METHODS) -> Row:
    """GAR at each FAR that the impostors can support, EER and d', each by finger and by subject."""
    impostors = int(np.sum(~scores.label))
    intervals = {
        way: bootstrap(scores, way, settings).figures
        for way in methods_of(scores)
        if way in methods
    }
    row: Row = {
        "genuine": int(scores.label.sum()),
        "impostors": impostors,
        "failures": int(np.isnan(scores.score).sum()),
        "fingers": 0 if scores.finger is None else int(np.unique(scores.finger.codes).size),
        "subjects": 0 if scores.subject is None else int(np.unique(scores.subject.codes).size),
    }
    for name, label, reduce in (
        ("least_genuine", True, np.nanmin),
        ("median_genuine", True, np.nanmedian),
        ("median_impostor", False, np.nanmedian),
        ("largest_impostor", False, np.nanmax),
    ):
        row[name] = float(reduce(scores.score[scores.label == label]))
    for target in TARGETS:
        row[f"accepts@{target:g}"] = allowed(target, impostors)
        supported = allowed(target, impostors) >= 1
        row |= _limits(f"gar@{target:g}", intervals, f"gar@{target:g}" if supported else "")
    return row | _limits("eer", intervals, "eer") | _limits("d_prime", intervals, "d_prime")


def differences_of(first: Scores, second: Scores, settings: BootstrapSettings) -> Row:
    """First minus second."""
    impostors = int(np.sum(~first.label))
    intervals = {
        method: differences(first, second, method, settings) for method in methods_of(first)
    }
    row: Row = {"genuine": int(first.label.sum()), "impostors": impostors}
    for target in TARGETS:
        supported = allowed(target, impostors) >= 1
        row |= _limits(f"gar@{target:g}", intervals, f"gar@{target:g}" if supported else "")
    return row | _limits("eer", intervals, "eer") | _limits("d_prime", intervals, "d_prime")


def allowed(target: float, impostors: int) -> int:
    """How many impostors may be accepted at a FAR."""
    return int(target * impostors * (1 + 1e-12))


def methods_of(scores: Scores) -> tuple[str, ...]:
    """Ways of drawing for which there are three to draw at least."""
    ids = {"finger": scores.finger, "subject": scores.subject}
    return tuple(
        m
        for m in METHODS
        if (clusters := ids[m]) is not None and np.unique(clusters.codes).size >= 3
    )


def _limits(name: str, intervals: dict[str, Any], figure: str) -> Row:
    """The value and its limits by each way of drawing; blank where the figure is not supported."""
    row: Row = {name: None}
    for method in METHODS:
        interval: Interval | None = intervals.get(method, {}).get(figure)
        row[f"{name}_low_{method}"] = None if interval is None else interval.low
        row[f"{name}_high_{method}"] = None if interval is None else interval.high
        row[name] = row[name] if interval is None else interval.value
    return row


def _nothing() -> Row:
    return {"genuine": 0, "impostors": 0}


_shared: list[Any] = []
"""Of a worker: the function and what its tasks share."""


def _in_parallel(
    work_on: Callable[..., Row], work: Work, tasks: Sequence[tuple[Any, ...]], jobs: int
) -> list[Row]:
    if jobs <= 1 or len(tasks) <= 1:
        return [work_on(work, *task) for task in tasks]
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(
        jobs, mp_context=context, initializer=_fraction, initargs=(work_on, work)
    ) as pool:
        return list(pool.map(_one, tasks))


def _fraction(work_on: Callable[..., Row], work: Work) -> None:
    _shared[:] = [work_on, work]


def _one(task: tuple[Any, ...]) -> Row:
    work_on, work = _shared
    row: Row = work_on(work, *task)
    return row
