"""Jobs done by several processes that end with the run that started them; results as they come."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from itertools import islice
from typing import TypeVar

from splitknit.errors import BadInput
from splitknit.files import with_given_folders
from splitknit.interrupts import UNFINISHED
from splitknit.io.paging import one_heap

Job = TypeVar("Job")
Done = TypeVar("Done")
_GRACE_S = 1.0
"""Time for workers that are ended to remove what they have half written."""


def run_jobs(
    work: Callable[[Job], Done], jobs: Sequence[Job], workers: int, kept: str
) -> Iterator[tuple[Job, Done]]:
    """Do all jobs; yield each with its result: in order by one worker (this process), as they come
    by several. `work`: function of a module; `kept`: what stays if a process is killed, for the
    message. Raises BadInput then, or `work`'s own; the other jobs are given up.
    """
    if workers == 1 or len(jobs) < 2:
        for job in jobs:
            yield job, work(job)
        return
    # a second thread of each worker wins no time
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(min(workers, len(jobs)), mp_context=context, initializer=_begin)
    rest = iter(jobs)
    work = with_given_folders(work)
    running: dict[Future[Done], Job] = {}
    earlier = set(multiprocessing.active_children())
    try:
        while True:
            # few enough that an interrupt waits for little
            for job in islice(rest, 2 * workers - len(running)):
                with _interrupts_for_us_alone():
                    running[pool.submit(_whole, work, job)] = job
            if not running:
                earlier |= set(multiprocessing.active_children())  # idle: they end by themselves
                return
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                yield running.pop(future), future.result()
    except BrokenProcessPool as error:
        raise BadInput(
            f"a worker was killed, perhaps for want of memory; {kept} is kept: run the same again,"
            " with fewer workers."
        ) from error
    finally:
        # at work still: an error, or an interrupt
        ours = set(multiprocessing.active_children()) - earlier
        for process in ours:
            process.terminate()
        end = time.monotonic() + _GRACE_S
        for process in ours:
            process.join(max(0.0, end - time.monotonic()))
            process.kill()
        pool.shutdown(wait=True, cancel_futures=True)


def _whole(work: Callable[[Job], Done], job: Job) -> Done:
    """Do a job in a worker; at SIGTERM end the worker, after its temporary files are gone."""
    try:
        return work(job)
    except SystemExit:
        os._exit(1)


@contextlib.contextmanager
def _interrupts_for_us_alone() -> Iterator[None]:
    """Start processes that Ctrl-C, delivered here at the end, does not reach: each would show a
    traceback."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _end_once(number: int, _: object) -> None:
    """End this worker; a second SIGTERM, of a pool that lost another worker, must not cut the
    cleaning short."""
    if UNFINISHED.depth:
        UNFINISHED.signal = number
        return
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    sys.exit(1)


def _begin() -> None:
    """In a new worker: one thread for OpenCV, one heap, and an end when the run that started it is
    no more."""
    import cv2

    signal.signal(signal.SIGTERM, _end_once)
    cv2.setNumThreads(1)
    one_heap()
    parent = multiprocessing.parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
