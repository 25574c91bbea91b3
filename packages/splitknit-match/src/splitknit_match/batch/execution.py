"""Tasks done by processes of this computer, or by the workers of a Dask cluster; results as they come."""

from __future__ import annotations

import contextlib
import importlib
import ipaddress
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

from splitknit import BadInput
from splitknit.errors import importing, require, with_given_folders
from splitknit.io.provenance import provenance
from splitknit.networks.unet import running, use_device
from splitknit.workers import run_jobs

Task = TypeVar("Task")
Done = TypeVar("Done")
AHEAD = 3  # tasks that the scheduler is given for each thread of the cluster: one under way, two waiting
PATIENCE_S = 30.0  # how long a cluster is waited for


@dataclass(frozen=True, slots=True)
class Cluster:
    """A Dask scheduler, and the certificates by which it and this computer recognise each other. Raises BadInput if the
    address is none, or anyone in the network could send code to the workers and `insecure` is not set.
    """

    address: str  # ``tls://HOST:PORT``, or ``tcp://HOST:PORT`` for a scheduler on this computer
    ca_file: Path | None = None  # PEM file of the CA that signed the scheduler's certificate; else Dask's configuration
    cert_file: Path | None = None  # PEM file of this computer's certificate; the same
    key_file: Path | None = None  # PEM file of its key, where `cert_file` does not hold it
    insecure: bool = False  # allow ``tcp://`` to another computer

    def __post_init__(self) -> None:
        found = re.fullmatch(r"(tls|tcp)://(?:([^\s:/\[\]]+)|\[([0-9A-Fa-f:.]+)\]):([0-9]{1,5})", self.address)
        if found is None or not 0 < int(found[4]) < 65536:
            fault = f"'{self.address}' is not the address of a cluster"
            raise BadInput(f"{fault}: name tls://HOST:PORT, or tcp://127.0.0.1:PORT for one on this computer.")
        require(self.cert_file is not None or self.key_file is None, "a cluster's key needs its certificate as well.")
        if found[1] == "tls":
            return
        fault = f"certificates are for tls://, but the cluster is '{self.address}'"
        require(self.ca_file is None and self.cert_file is None, f"{fault}; name tls://HOST:PORT.")
        require(
            self.insecure or _is_loopback(found[2] or found[3]),
            f"the cluster '{self.address}' is on another computer, without encryption: anyone who reaches its port can "
            "send code that its workers run, and read the fingerprints; use tls:// and certificates "
            "(docs/guide/batch.md), "
            "or `insecure_cluster` in a network that only you can reach.",
        )


def _distributed() -> Any:
    with importing("a cluster needs distributed, which is missing ({error}); install 'splitknit-match[cluster]'."):
        return importlib.import_module("distributed")


@contextlib.contextmanager
def connected(cluster: Cluster) -> Iterator[Any]:
    """Give the client of a cluster that has a worker; BadInput if it cannot be reached, or certificates do not fit."""
    distributed = _distributed()
    security = _security(distributed, cluster)
    try:
        client = _client(distributed, cluster.address, security)
    except (OSError, ValueError, TypeError, RuntimeError) as error:
        fault = f"the cluster '{cluster.address}' cannot be reached ({_cause(error)})"
        cure = "start a scheduler and workers, with certificates of the same CA for tls:// (docs/guide/batch.md),"
        raise BadInput(f"{fault}; {cure} and name the scheduler's address.") from error
    try:
        try:
            client.wait_for_workers(1, timeout=PATIENCE_S)
        except (TimeoutError, OSError) as error:
            message = f"the cluster '{cluster.address}' has no workers; start some (docs/guide/batch.md)."
            raise BadInput(message) from error
        yield client
    finally:
        client.close(timeout=5)


def run_tasks(
    work: Callable[[Task], Done], tasks: Sequence[Task], jobs: int, client: Any = None, device: str = "cpu"
) -> Iterator[Done]:
    """Do all tasks, by several processes on one thread each; yield each result once, in the order of their ends.

    `work`: function of a module, so that processes find it; doing a task twice must leave what doing it once leaves;
    `jobs`: 1: in this process; `client`: of :func:`connected`, whose workers do the tasks instead; `device`: on which
    networks run. Raises BadInput if a process is killed, the cluster is lost, or one of its own from `work`.
    """
    require(1 <= jobs <= 1024, f"jobs must be 1 to 1024, but it is {jobs}.")
    if not tasks:
        return iter(())
    if client is not None:
        return _on_cluster(with_given_folders(work), tasks, client, device)
    return _here(work, tasks, device) if jobs == 1 or len(tasks) == 1 else _in_processes(work, tasks, jobs, device)


def _on_one_thread(device: str) -> None:
    """There are as many workers as cores: a second thread of each wins no time and takes memory."""
    import cv2

    cv2.setNumThreads(1)
    use_device(device, threads=1)


def _in_cluster_worker(work: Callable[[Task], Done], task: Task, version: str, device: str) -> Done:
    """Do a task in a worker of a cluster, which must have the same software."""
    own = provenance()["version"]
    require(version == own, f"a worker of the cluster has splitknit {own}, and this is {version}; use one version.")
    _on_one_thread(device)
    return work(task)


def peak_memory_mb() -> float:
    """Most memory that this process has had so far; 0 on Windows, which does not keep it there."""
    try:
        import resource  # not on every system
    except ImportError:
        return 0.0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return float(peak) / (1e6 if sys.platform == "darwin" else 1e3)


@dataclass(frozen=True, slots=True)
class TaskDone:
    """What a task of a batch did."""

    size: int  # reconstructions, comparisons, or chunks
    seconds: float = 0.0  # time of one core, where it is counted
    failures: tuple[str, ...] = ()  # case, capture and sentence of each failure to acquire
    unreadable: tuple[tuple[str, str], ...] = ()  # name and sentence of each capture that could not be read
    peak_memory_mb: float = field(default_factory=peak_memory_mb)  # peak memory of the process that did it


def _in_processes(work: Callable[[Task], Done], tasks: Sequence[Task], jobs: int, device: str) -> Iterator[Done]:
    for _, done in run_jobs(partial(_in_worker, work, device), tasks, jobs, "what is finished"):
        yield done


def _in_worker(work: Callable[[Task], Done], device: str, task: Task) -> Done:
    _on_one_thread(device)
    return work(task)


def _is_loopback(host: str) -> bool:
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _security(distributed: Any, cluster: Cluster) -> Any:
    """Certificates that are named here, or else in Dask's configuration, which must not weaken what is checked."""
    if cluster.address.startswith("tcp:"):
        return distributed.Security()
    files: dict[str, Any] = {} if cluster.ca_file is None else {"tls_ca_file": str(cluster.ca_file)}
    if cluster.cert_file is not None:
        files["tls_client_cert"] = str(cluster.cert_file)
        files["tls_client_key"] = None if cluster.key_file is None else str(cluster.key_file)
    try:
        security = distributed.Security(require_encryption=True, tls_ciphers=None, tls_min_version=None, **files)
        certain = security.get_connection_args("client")["ssl_context"] is not None
    except (OSError, ValueError) as error:
        cure = "name PEM files of the CA, the certificate and its key."
        raise BadInput(f"the certificates for '{cluster.address}' cannot be used ({_cause(error)}); {cure}") from error
    fault = f"'{cluster.address}' needs certificates: name `cluster_ca`, `cluster_cert` and `cluster_key`,"
    require(certain, f"{fault} or set them in Dask's configuration (docs/guide/batch.md).")
    return security


def _client(distributed: Any, address: str, security: Any) -> Any:
    """Connect; on a machine under load the client's own thread may not start in its ten seconds, so try again."""
    named = {"timeout": PATIENCE_S, "set_as_default": False, "security": security}
    try:
        return distributed.Client(address, **named)
    except AssertionError:
        return distributed.Client(address, **named)


def _cause(error: BaseException) -> str:
    while error.__cause__ is not None:
        error = error.__cause__
    return str(getattr(error, "strerror", None) or error) or "no answer in time"


def _on_cluster(work: Callable[[Task], Done], tasks: Sequence[Task], client: Any, device: str) -> Iterator[Done]:
    """Tasks of a worker that dies are done by another; a task's result is yielded once. The scheduler holds a few tasks
    for each thread of its workers, however many there are in all.
    """
    distributed = _distributed()
    version = provenance()["version"]
    rest = iter(tasks)
    waiting: dict[str, Any] = {}

    def submit() -> list[Any]:
        room = AHEAD * max(sum(client.nthreads().values()), 1) - len(waiting)
        begun = islice(rest, max(room, 0))
        how: Any = {"pure": False, "retries": 0}
        new = [client.submit(_in_cluster_worker, work, task, version, device, **how) for task in begun]
        waiting.update((future.key, future) for future in new)
        return new

    try:
        done = distributed.as_completed(submit(), loop=client.loop)
        for future in done:
            if waiting.pop(future.key, None) is not None:
                result = _result(distributed, future)
                future.release()
                done.update(submit())
                yield result
    finally:
        for future in waiting.values():
            future.release()


def _result(distributed: Any, future: Any) -> Any:
    try:
        return future.result()
    except distributed.KilledWorker as error:
        fault = "one task was given to several workers and each of them was killed, perhaps for want of memory"
        cure = "what is finished is kept: give the workers more memory and run the same again."
        raise BadInput(f"{fault}; {cure}") from error
    except (distributed.comm.CommClosedError, distributed.client.FutureCancelledError, OSError) as error:
        raise BadInput("the cluster was lost; what is finished is kept: start it and run the same again.") from error


def _here(work: Callable[[Task], Done], tasks: Sequence[Task], device: str) -> Iterator[Done]:
    import cv2

    threads, before = cv2.getNumThreads(), running()
    cv2.setNumThreads(1)
    use_device(device)
    try:
        for task in tasks:
            yield work(task)
    finally:
        cv2.setNumThreads(threads)
        use_device(before.device, before.threads)
