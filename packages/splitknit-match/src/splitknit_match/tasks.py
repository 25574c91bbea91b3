"""Tasks of batches and searches, by processes of this computer or the workers of a Dask cluster.

Processes of this computer are those of :mod:`splitknit.workers`, not Dask's: two captures took 33 s
of processor time by a local cluster and 23 s by processes, and a local cluster opens ports through
which every user of the computer can run code.
"""

from __future__ import annotations

import contextlib
import importlib
import ipaddress
import logging
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import urlsplit

from splitknit import BadInput
from splitknit.errors import importing, refusing, require
from splitknit.files import with_given_folders
from splitknit.io.paging import one_heap
from splitknit.io.provenance import provenance
from splitknit.networks.unet import network_threads, use_network_threads
from splitknit.workers import run_jobs

Task = TypeVar("Task")
R = TypeVar("R")
_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Done:
    """What a task of a batch did."""

    size: int  # reconstructions, comparisons, or tables
    seconds: float = 0.0  # time of one core, where it is counted
    failures: tuple[str, ...] = ()  # case, capture and sentence of each failure to acquire
    unreadable: tuple[tuple[str, str], ...] = ()  # name and sentence of captures that are damaged


Work = Callable[[Task], Done]


def run_tasks(
    work: Work[Task], tasks: Sequence[Task], jobs: int, client: Any = None
) -> Iterator[Done]:
    """Do all tasks, by `jobs` processes on one thread each, if memory allows (1: this process), or
    by the workers of a cluster's `client`; yield results as they come.

    `work`: function of a module; doing a task twice must leave what doing it once leaves. Raises
    BadInput if a process is killed, the cluster is lost, or one of its own from `work`.
    """
    if client is not None:
        yield from on_cluster(client, tasks, with_given_folders(work))
        return
    import cv2

    jobs = min(jobs, len(tasks), workers_that_fit())
    threads, before = cv2.getNumThreads(), network_threads()
    try:
        here = before if jobs < 2 else 1
        job = partial(_in_worker, work, here)
        for _, done in run_jobs(job, tasks, jobs, "what is finished"):
            yield done
    finally:
        cv2.setNumThreads(threads)
        use_network_threads(before)


WORKER_BYTES = 1_200_000_000
"""Memory of one worker: a full frame by `metric` takes 0.9 GB."""


def workers_that_fit() -> int:
    """Workers that the memory holds that is available now; any number where it is not known."""
    with contextlib.suppress(OSError):
        text = Path("/proc/meminfo").read_text(encoding="ascii")
        if available := re.search(r"MemAvailable: +(\d+) kB", text):
            return max(1, 1024 * int(available[1]) // WORKER_BYTES)
    return 1024


def _in_worker(work: Callable[[Task], R], threads: int, task: Task) -> R:
    """Do a task; as there are as many workers as cores, a second thread would win no time."""
    import cv2

    cv2.setNumThreads(1)
    use_network_threads(threads)
    return work(task)


def job_of(work: Callable[[Task], R]) -> Callable[[Task], R]:
    """What a worker of a cluster is given to do."""
    return partial(_in_cluster_worker, work, str(provenance()["version"]))


def _in_cluster_worker(work: Callable[[Task], R], version: str, task: Task) -> R:
    """Do a task in a worker of a cluster, which must have the same software."""
    own = provenance()["version"]
    require(
        version == own,
        f"a worker of the cluster has splitknit {own}, and this is {version}; use one version.",
    )
    one_heap()  # Dask lets glibc return memory at once, which doubles the processor time
    return _in_worker(work, 1, task)


PATIENCE_S = 30.0  # how long a cluster is waited for


@contextlib.contextmanager
def connected(address: str) -> Iterator[Any]:
    """Give the client of a Dask scheduler that has a worker.

    `address`: ``tls://HOST:PORT``, with the certificates of Dask's configuration; or
    ``tcp://HOST:PORT`` of this computer. Raises BadInput for another address, or a scheduler that
    cannot be reached, does not fit the certificates, or has no worker.
    """
    fault = f"'{address}' is not the address of a scheduler: name tls://HOST:PORT,"
    fault += " or tcp://127.0.0.1:PORT for one on this computer."
    with refusing(fault):
        parts = urlsplit(address)
        plain = address == f"{parts.scheme}://{parts.netloc}"
        require(plain and parts.scheme in ("tls", "tcp") and (parts.hostname and parts.port), fault)
    encrypted = parts.scheme == "tls"
    require(
        encrypted or _is_loopback(parts.hostname or ""),
        f"the scheduler '{address}' is on another computer, without encryption: anyone who reaches"
        " its port can send code that its workers run, and read the fingerprints; use tls:// and"
        " certificates (docs/guide/batch.md).",
    )
    with importing(
        "a cluster needs distributed, which is missing; install 'splitknit-match[cluster]'."
    ):
        distributed = importlib.import_module("distributed")
    try:
        checked = {"tls_ciphers": None, "tls_min_version": None}  # Python's, not those configured
        security = distributed.Security(require_encryption=encrypted, **checked)
        client = distributed.Client(
            address, timeout=PATIENCE_S, set_as_default=False, security=security
        )
    except (OSError, ValueError, TypeError, RuntimeError, AssertionError) as error:
        raise BadInput(
            f"the scheduler '{address}' cannot be reached ({_cause(error)}); start it and its"
            " workers, tls:// with certificates of one CA (docs/guide/batch.md)."
        ) from error
    try:
        try:
            client.wait_for_workers(1, timeout=PATIENCE_S)
        except (TimeoutError, OSError) as error:
            raise BadInput(
                f"the scheduler '{address}' has no workers; start some (docs/guide/batch.md)."
            ) from error
        yield client
    finally:
        client.close(timeout=5)


def _is_loopback(host: str) -> bool:
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _cause(error: BaseException) -> str:
    while error.__cause__ is not None:
        error = error.__cause__
    return str(getattr(error, "strerror", None) or error) or "no answer in time"


AHEAD = 3
"""Tasks that a scheduler is given for each thread of its workers. Chosen on: speed."""


def on_cluster(client: Any, tasks: Sequence[Any], work: Callable[[Task], R]) -> Iterator[R]:
    """Do tasks, or futures of them, by the workers of a client; yield results as they come.

    Tasks of a worker that dies are done by another. The scheduler holds a few tasks for each thread
    of its workers, however many there are in all.
    """
    distributed = importlib.import_module("distributed")
    job = job_of(work)
    waiting = iter(tasks)

    def submitted(count: int) -> list[Any]:
        return [client.submit(job, task, pure=False) for task in islice(waiting, count)]

    try:
        threads = max(sum(client.nthreads().values()), 1)
        futures = distributed.as_completed(submitted(AHEAD * threads), loop=client.loop)
        known = set(client.nthreads())
        for future in futures:
            there = set(client.nthreads())
            for address in known - there:
                _log.warning("the worker %s was lost; others do its tasks again.", address)
            known = there
            yield future.result()
            futures.update(submitted(1))
    except distributed.KilledWorker as error:
        raise BadInput(
            "several workers were killed at one task, perhaps for want of memory: give them more,"
            " and run the same again; a batch keeps what is finished."
        ) from error
    except (
        distributed.comm.CommClosedError,
        distributed.client.FutureCancelledError,
        OSError,
    ) as error:
        raise BadInput(
            "the cluster was lost: start it and run the same again; a batch keeps what is finished."
        ) from error
