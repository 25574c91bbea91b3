"""Tasks done by processes of this computer, or by the workers of a Dask cluster; results as they come."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

from splitknit.batch.packages import load
from splitknit.check import BadInput, require

Task = TypeVar("Task")
Done = TypeVar("Done")
_KILLED = (
    "a worker was killed, perhaps for want of memory; what is finished is kept: run the same again, with fewer jobs if "
    "memory was short."
)
PATIENCE_S = 30.0
"""How long a cluster is waited for."""


def run_tasks(
    work: Callable[[Task], Done], tasks: Sequence[Task], jobs: int, cluster: str | None = None
) -> Iterator[Done]:
    """Do all tasks, each on one thread; yield each one's result once, in the order in which they are done.

    Parameters
    ----------
    work : function of a module, so that processes find it; doing a task twice must leave what doing it once leaves
    tasks : in the order in which they are begun
    jobs : processes; 1: in this process
    cluster : address of a Dask scheduler, such as ``tcp://host:8786``, whose workers do the tasks instead

    Raises
    ------
    BadInput
        If a process is killed, the cluster cannot be reached or is lost, or one of its own from `work`.
    """
    require(1 <= jobs <= 1024, f"jobs must be 1 to 1024, but it is {jobs}.")
    if not tasks:
        return iter(())
    if cluster is not None:
        return _on_cluster(work, tasks, cluster)
    return _here(work, tasks) if jobs == 1 or len(tasks) == 1 else _in_processes(work, tasks, jobs)


def in_worker(work: Callable[[Task], Done], task: Task, parent: int) -> Done:
    """Do a task in a worker: OpenCV on one thread, and an end when the run that started it is no more."""
    import cv2  # noqa: PLC0415

    cv2.setNumThreads(1)
    _watch(parent)
    return work(task)


def on_cluster(work: Callable[[Task], Done], task: Task, version: str) -> Done:
    """Do a task in a worker of a cluster, which must have the same software."""
    import cv2  # noqa: PLC0415

    import splitknit  # noqa: PLC0415

    require(
        version == splitknit.__version__,
        f"a worker of the cluster has splitknit {splitknit.__version__}, and this is {version}; use one version.",
    )
    cv2.setNumThreads(1)
    return work(task)


def peak_memory_mb() -> float:
    """Most memory that this process has had so far."""
    import resource  # noqa: PLC0415 - not on every system

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return float(peak) / (1e6 if sys.platform == "darwin" else 1e3)


def _in_processes(work: Callable[[Task], Done], tasks: Sequence[Task], jobs: int) -> Iterator[Done]:
    joblib = load("joblib", "batch")
    broken = load("joblib.externals.loky.process_executor", "batch").BrokenProcessPool
    with joblib.parallel_config(backend="loky", inner_max_num_threads=1), warnings.catch_warnings():
        # a worker that has grown is replaced; nothing is lost by that
        warnings.filterwarnings("ignore", message="A worker stopped while some jobs were given")
        pool = joblib.Parallel(
            n_jobs=min(jobs, len(tasks)), return_as="generator_unordered", batch_size=1, pre_dispatch="2*n_jobs"
        )
        results = pool(joblib.delayed(in_worker)(work, task, os.getpid()) for task in tasks)
        try:
            yield from results
        except broken as error:
            raise BadInput(_KILLED) from error
        finally:
            results.close()


def _client(distributed: Any, address: str) -> Any:
    """Connect; on a machine under load the client's own thread may not start in its ten seconds, so try again."""
    try:
        return distributed.Client(address, timeout=PATIENCE_S, set_as_default=False)
    except AssertionError:
        return distributed.Client(address, timeout=PATIENCE_S, set_as_default=False)


def _on_cluster(work: Callable[[Task], Done], tasks: Sequence[Task], address: str) -> Iterator[Done]:
    """Tasks of a worker that dies are done by another; a task's result is yielded once."""
    distributed = load("distributed", "cluster")
    version = load("splitknit", "batch").__version__
    try:
        client = _client(distributed, address)
    except (OSError, ValueError, TypeError) as error:
        raise BadInput(
            f"the cluster '{address}' cannot be reached; start a scheduler and workers (dask scheduler, dask worker) "
            "and name its address, such as tcp://host:8786."
        ) from error
    futures: list[Any] = []
    try:
        try:
            client.wait_for_workers(1, timeout=PATIENCE_S)
        except (TimeoutError, OSError) as error:
            raise BadInput(f"the cluster '{address}' has no workers; start some (dask worker {address}).") from error
        futures = [client.submit(on_cluster, work, task, version, pure=False, retries=0) for task in tasks]
        done: set[str] = set()
        for future in distributed.as_completed(futures, loop=client.loop):
            if future.key in done:
                continue
            done.add(future.key)
            yield _result(distributed, future, address)
    finally:
        for future in futures:
            future.release()
        client.close(timeout=5)


def _result(distributed: Any, future: Any, address: str) -> Any:
    try:
        return future.result()
    except distributed.KilledWorker as error:
        raise BadInput(
            "one task was given to several workers and each of them was killed, perhaps for want of memory; what is "
            "finished is kept: give the workers more memory and run the same again."
        ) from error
    except (distributed.comm.CommClosedError, distributed.client.FutureCancelledError, OSError) as error:
        raise BadInput(
            f"the cluster '{address}' was lost; what is finished is kept: start it and run the same again."
        ) from error


_watched: set[int] = set()


def _watch(parent: int) -> None:
    if parent in _watched or os.getppid() != parent:
        return
    _watched.add(parent)
    with contextlib.suppress(ValueError):  # not the main thread
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the run that started us, which ends us

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
