"""Tasks done by processes of this computer; results as they come."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

from splitknit.batch.packages import load
from splitknit.check import BadInput, require

Task = TypeVar("Task")
Done = TypeVar("Done")
_KILLED = (
    "a worker was killed, perhaps for want of memory; what is finished is kept: run the same again, with fewer jobs if "
    "memory was short."
)


def run_tasks(work: Callable[[Task], Done], tasks: Sequence[Task], jobs: int) -> Iterator[Done]:
    """Do all tasks, each on one thread; yield their results in the order in which they are done.

    Parameters
    ----------
    work : function of a module, so that processes find it
    tasks : in the order in which they are begun
    jobs : processes; 1: in this process

    Raises
    ------
    BadInput
        If a process is killed, or one of its own from `work`.
    """
    require(1 <= jobs <= 1024, f"jobs must be 1 to 1024, but it is {jobs}.")
    if jobs == 1 or len(tasks) <= 1:
        yield from _here(work, tasks)
        return
    joblib = load("joblib", "batch")
    from joblib.externals.loky.process_executor import BrokenProcessPool  # type: ignore[import-untyped]  # noqa: PLC0415

    with joblib.parallel_config(backend="loky", inner_max_num_threads=1):
        pool = joblib.Parallel(
            n_jobs=min(jobs, len(tasks)), return_as="generator_unordered", batch_size=1, pre_dispatch="2*n_jobs"
        )
        results = pool(joblib.delayed(in_worker)(work, task, os.getpid()) for task in tasks)
        try:
            yield from results
        except BrokenProcessPool as error:
            raise BadInput(_KILLED) from error
        finally:
            results.close()


def in_worker(work: Callable[[Task], Done], task: Task, parent: int) -> Done:
    """Do a task in a worker: OpenCV on one thread, and an end when the run that started it is no more."""
    import cv2  # noqa: PLC0415

    cv2.setNumThreads(1)
    _watch(parent)
    return work(task)


_watched: set[int] = set()


def _watch(parent: int) -> None:
    if parent in _watched or os.getppid() != parent:
        return
    _watched.add(parent)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _here(work: Callable[[Task], Done], tasks: Sequence[Task]) -> Iterator[Done]:
    import cv2  # noqa: PLC0415

    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        for task in tasks:
            yield work(task)
    finally:
        cv2.setNumThreads(threads)
