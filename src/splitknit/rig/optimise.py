"""Sweep many rigs on the twin, in parallel, and take up again what was interrupted."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from pathlib import Path
from typing import Any

import numpy as np

from splitknit.errors import BadInput, require
from splitknit.rig.candidates import Candidate
from splitknit.rig.evaluate_rig import DONE, FAILED, REFUSED, evaluate, judge
from splitknit.rig.pareto import OBJECTIVES, compare_with_best, pareto_front
from splitknit.rig.store import SweepFolder
from splitknit.rig.study import Study

THESIS = {"height_mm": 140.0, "radius_mm": 52.5, "power_w": 1.0}
"""What the thesis's sweep chose (4.1.1)."""
Progress = Callable[[str, float], None]
"""Hears what is being done, and the share of the whole that is done."""


def sweep(
    out: Path,
    candidates: Sequence[Candidate],
    study: Study,
    *,
    workers: int = 1,
    progress: Progress = lambda stage, share: None,
) -> list[dict[str, Any]]:
    """Evaluate all candidates and keep each as soon as it is finished.

    Parameters
    ----------
    out : folder; holds nothing, or an earlier sweep of the same study, whose finished candidates are not done again
    candidates : rigs to compare
    study : what is asked of them
    workers : processes; the result does not depend on it
    progress : hears the candidate and the share done

    Returns
    -------
    Records of :func:`splitknit.rig.evaluate_rig.evaluate`, in the order of `candidates`. A failed candidate is tried
    again when the sweep is resumed; done and refused ones are not.

    Raises
    ------
    BadInput
        If there are no candidates, or the folder holds something else.
    """
    require(len(candidates) > 0, "there are no candidates to compare.")
    require(1 <= workers <= 256, f"the number of workers must lie between 1 and 256, but it is {workers}.")
    _check_possible(candidates, study)
    folder = SweepFolder(out, study)
    records: dict[str, dict[str, Any]] = {}
    for candidate in candidates:
        known = folder.read(candidate)
        if known is not None and known["status"] != FAILED:
            records[candidate.name] = known
    waiting = [candidate for candidate in candidates if candidate.name not in records]
    total = len(candidates)
    progress("resuming" if records else "starting", len(records) / total)
    for candidate, record in _evaluated(waiting, study, workers):
        folder.write(candidate, record)
        records[candidate.name] = folder.read(candidate) or record  # as a file tells it, whoever asks
        progress(candidate.name, len(records) / total)
    return [records[candidate.name] for candidate in candidates]


def summarise(records: Sequence[dict[str, Any]], study: Study, objective: str = "hausdorff") -> dict[str, Any]:
    """What a sweep says: the best rig, those as good, the Pareto front, and where the thesis's choice stands.

    Parameters
    ----------
    records : of :func:`sweep`
    study : of the sweep
    objective : ``hausdorff``, ``hausdorff95``, ``rms``, ``whole`` or ``normals``: what is minimised

    Returns
    -------
    dict with ``counts`` (by status), ``objective``, ``best``, ``as_good`` (names), ``pareto`` (names; over the
    objective, the LEDs' power and the size of the box), ``compared`` (by name), ``thesis`` (its row, or None where the
    sweep does not hold it), ``reasons`` (of refused and failed ones, with their number)

    Raises
    ------
    BadInput
        If not one candidate was done; the message says why.
    """
    require(objective in OBJECTIVES, f"the objective must be one of {', '.join(OBJECTIVES)}, not '{objective}'.")
    done = [one for one in records if one["status"] == DONE]
    reasons: dict[str, int] = {}
    for one in records:
        if one["reason"] is not None:
            reasons[one["reason"]] = reasons.get(one["reason"], 0) + 1
    if not done:
        first = max(reasons, key=lambda words: reasons[words])
        require(False, f"not one of the {len(records)} rigs can be built and measured; most often: {first}")
    figure = OBJECTIVES[objective]
    compared = compare_with_best(done, figure)
    costs = [[one["mean"][figure], one["candidate"]["power_w"], Candidate(**_fields(one)).volume_l] for one in done]
    front = pareto_front(np.array(costs, dtype=np.float64))
    names = [one["candidate"]["name"] for one in done]
    best = next(name for name, row in compared.items() if row["best"])
    return {
        "counts": {status: sum(one["status"] == status for one in records) for status in (DONE, REFUSED, FAILED)},
        "objective": objective,
        "figure": figure,
        "fingers": study.fingers,
        "best": best,
        "as_good": [name for name in names if compared[name]["as_good"]],
        "pareto": [name for name, is_on in zip(names, front, strict=True) if is_on],
        "compared": compared,
        "thesis": _thesis(done, compared),
        "reasons": dict(sorted(reasons.items(), key=lambda item: (-item[1], item[0]))),
    }


def _check_possible(candidates: Sequence[Candidate], study: Study) -> None:
    """Refuse, before anything is written, a sweep of which no rig keeps the constraints."""
    reason = ""
    for candidate in candidates:
        try:
            broken = [finding.words for finding in judge(candidate, study) if finding.hard and not finding.ok]
        except BadInput as error:
            broken = [str(error)]
        if not broken:
            return
        reason = reason or broken[0]
    require(False, f"not one of the {len(candidates)} rigs can be built; of the first, {candidates[0].name}: {reason}")


def _thesis(done: Sequence[dict[str, Any]], compared: dict[str, dict[str, Any]]) -> dict[str, Any] | None:
    """The row of the thesis's rig: among several tilts and resolutions, its best."""
    its = [one for one in done if all(one["candidate"][name] == value for name, value in THESIS.items())]
    if not its:
        return None
    name = min((one["candidate"]["name"] for one in its), key=lambda one: compared[one]["value"])
    return {"name": name, **compared[name]}


def _fields(record: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in record["candidate"].items() if name != "name"}


def _evaluated(
    candidates: Sequence[Candidate], study: Study, workers: int
) -> Iterator[tuple[Candidate, dict[str, Any]]]:
    """Records as they are finished; after an interrupt no further candidate is begun."""
    if workers == 1 or len(candidates) < 2:
        for candidate in candidates:
            yield candidate, evaluate(candidate, study)
        return
    context = multiprocessing.get_context("spawn")  # a fork would copy locks that threads of this process hold
    pool = ProcessPoolExecutor(min(workers, len(candidates)), mp_context=context, initializer=_quiet)
    try:
        running: dict[Future[dict[str, Any]], Candidate] = {}
        left = list(reversed(candidates))
        while left or running:
            while left and len(running) < 2 * workers:  # few enough that an interrupt waits for little
                candidate = left.pop()
                running[pool.submit(evaluate, candidate, study)] = candidate
            finished, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in finished:
                yield running.pop(future), future.result()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _quiet() -> None:
    """In a worker: the parent alone hears Ctrl-C; no threads beside those of the other workers."""
    import cv2  # noqa: PLC0415 - of this process only

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    cv2.setNumThreads(1)
