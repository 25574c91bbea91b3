"""Workers that are killed: nothing is lost, nothing is counted twice."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from batch_stores import EA, chunks

from splitknit.batch import BatchSettings, Store, preset_cases, run_batch
from splitknit.batch.execution import run_tasks
from splitknit.batch.packages import load
from splitknit.check import BadInput

ONE = replace(EA, matchers=("ridge",), chunk_captures=1)


def double(value: int) -> int:
    return 2 * value


def die(value: int) -> int:
    if value == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return value


@contextmanager
def when_begun(out: Path, act: Callable[[], None]) -> Iterator[threading.Event]:
    """Do something as soon as the first chunk is there."""
    done, stop = threading.Event(), threading.Event()

    def watch() -> None:
        while not stop.is_set():
            if list(out.glob("features/ea/*.parquet")):
                act()
                done.set()
                return
            time.sleep(0.02)

    thread = threading.Thread(target=watch)
    thread.start()
    try:
        yield done
    finally:
        stop.set()
        thread.join()


def test_tasks_here_and_in_processes_give_the_same() -> None:
    assert sorted(run_tasks(double, range(7), 1)) == sorted(run_tasks(double, range(7), 2)) == [2 * k for k in range(7)]
    assert list(run_tasks(double, [], 2)) == []


def test_a_killed_process_ends_the_run_with_one_sentence() -> None:
    with pytest.raises(BadInput, match="a worker was killed") as error:
        list(run_tasks(die, range(4), 2))
    assert "run the same again" in str(error.value)


def test_packages_that_are_missing_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    for module, extra in (("joblib", "batch"), ("distributed", "cluster")):
        monkeypatch.setitem(sys.modules, module, None)
        with pytest.raises(BadInput, match=rf"{module}.*splitknit\[{extra}\]"):
            load(module, extra)


def test_a_cluster_that_is_not_there(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("splitknit.batch.execution.PATIENCE_S", 0.5)
    with pytest.raises(BadInput, match="cannot be reached"):
        list(run_tasks(double, [1], 1, "tcp://127.0.0.1:9"))
    with pytest.raises(BadInput, match="cannot be reached"):
        list(run_tasks(double, [1], 1, "nonsense://"))


@pytest.mark.slow
def test_a_killed_worker_of_a_cluster_loses_nothing(people: Path, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    out = tmp_path / "cluster"
    settings = BatchSettings(cases=preset_cases(("ea",)), matchers=("ridge", "thesis"), chunk_captures=1)
    with distributed.LocalCluster(
        n_workers=3, threads_per_worker=1, dashboard_address=None, silence_logs="CRITICAL"
    ) as cluster:
        pids = [worker.pid for worker in cluster.workers.values()]
        with when_begun(out, lambda: os.kill(pids[0], signal.SIGKILL)) as killed:
            facts = run_batch(people, out, settings, cluster=cluster.scheduler_address)
    assert killed.is_set()
    assert facts["reconstructed"] == 4
    run_batch(people, tmp_path / "here", settings, jobs=1)
    assert chunks(out) == chunks(tmp_path / "here")
    for matcher in settings.matchers:
        assert Store(out).scores("ea", matcher).num_rows == 4


RUN = """
import sys
from pathlib import Path
from splitknit.batch import BatchSettings, preset_cases, run_batch
settings = BatchSettings(cases=preset_cases(("ea",)), matchers=(), chunk_captures=1)
try:
    run_batch(Path(sys.argv[1]), Path(sys.argv[2]), settings, jobs=2)
except KeyboardInterrupt:
    sys.exit("interrupted")
"""


@pytest.mark.slow
def test_ctrl_c_ends_the_run_and_its_processes_quietly(people: Path, tmp_path: Path) -> None:
    out = tmp_path / "stopped"
    run = subprocess.Popen(
        [sys.executable, "-c", RUN, str(people), str(out)], stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    with when_begun(out, lambda: os.killpg(run.pid, signal.SIGINT)) as stopped:
        _, err = run.communicate()
    assert stopped.is_set()
    assert (run.returncode, err) == (1, "interrupted\n")
    assert not list(out.rglob("*.tmp"))
    assert 0 < Store(out).features("ea").num_rows < 4


@pytest.mark.slow
def test_a_run_that_was_killed_goes_on(people: Path, reconstructed: Path, tmp_path: Path) -> None:
    out = tmp_path / "killed"
    run = subprocess.Popen(
        [sys.executable, "-c", RUN, str(people), str(out)], stderr=subprocess.DEVNULL, start_new_session=True
    )
    with when_begun(out, run.kill) as killed:
        run.wait()
    assert killed.is_set()
    time.sleep(1.5)  # its processes notice
    there = chunks(out)
    assert there
    facts = run_batch(people, out, replace(EA, chunk_captures=1), jobs=1)
    assert facts["found"] == len(there)
    assert facts["reconstructed"] == 4 - len(there)
    assert there.items() <= chunks(out).items()
    assert Store(out).features("ea").equals(Store(reconstructed).features("ea"))
