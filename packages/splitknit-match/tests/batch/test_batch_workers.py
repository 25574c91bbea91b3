"""Workers that are killed: nothing is lost, nothing is counted twice."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from batch_stores import EA, chunks, rows_of
from splitknit.cli.main import main
from splitknit.errors import BadInput
from splitknit.networks.unet import running
from splitknit_match.batch.engine import _feature_tasks, run_batch
from splitknit_match.batch.execution import AHEAD, Cluster, connected, run_tasks
from splitknit_match.batch.population import read_population
from splitknit_match.batch.settings import BatchSettings, preset_cases
from splitknit_match.batch.store import Store

ONE = replace(EA, matchers=("ridge",), chunk_captures=1)


def double(value: int) -> int:
    return 2 * value


def threads_of(value: int) -> int:
    return running().threads


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
            if list(out.glob("features/ea/*.npz")):
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


def test_a_package_that_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with (
        pytest.raises(BadInput, match=r"distributed.*splitknit-match\[cluster\]"),
        connected(Cluster("tcp://127.0.0.1:1")),
    ):
        pass


def certificates(folder: Path) -> Path:
    """Write a CA, a certificate that it signed, and the key of that."""
    if shutil.which("openssl") is None:
        pytest.skip("no openssl to make certificates")
    folder.mkdir()
    new = "-newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes"
    for command in (
        f"req -x509 {new} -days 1 -subj /CN=ca -keyout ca_key.pem -out ca.pem",
        f"req {new} -subj /CN=node -keyout key.pem -out node.csr",
        "x509 -req -in node.csr -CA ca.pem -CAkey ca_key.pem -CAcreateserial -days 1 -out cert.pem",
    ):
        subprocess.run(["openssl", *command.split()], cwd=folder, check=True, capture_output=True, timeout=60)
    return folder


def options(folder: Path) -> list[str]:
    return [f"--cluster-{name}={folder / file}.pem" for name, file in (("ca", "ca"), ("cert", "cert"), ("key", "key"))]


@pytest.fixture(scope="module")
def tls(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, Path, Path]]:
    """Address of a cluster, the certificates of its CA, and those of another one."""
    distributed = pytest.importorskip("distributed")
    folder = tmp_path_factory.mktemp("tls")
    good, other = certificates(folder / "good"), certificates(folder / "other")
    pair = {
        f"tls_{role}_{kind}": str(good / f"{kind}.pem")
        for role in ("scheduler", "worker", "client")
        for kind in ("cert", "key")
    }
    security = distributed.Security(require_encryption=True, tls_ca_file=str(good / "ca.pem"), **pair)
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, protocol="tls://", host="127.0.0.1", security=security,
        dashboard_address="127.0.0.1:0", silence_logs="CRITICAL",
    ) as cluster:  # fmt: skip
        yield cluster.scheduler_address, good, other


def listening() -> int:
    """Ports that this process listens on."""
    import psutil

    return sum(one.status == "LISTEN" for one in psutil.Process().net_connections("tcp"))


@pytest.mark.parametrize(
    "address",
    ["nonsense://", "127.0.0.1:8786", "http://127.0.0.1:8786", "inproc://127.0.0.1/1/1", "tls://host", "tls://host:0",
     "tls://host:99999", "tls://host:8786/", "ucx://host:8786", "tcp://127.0.0.1:8786\n", ""],
)  # fmt: skip
def test_other_addresses_are_refused(address: str) -> None:
    with pytest.raises(BadInput, match="is not the address of a cluster"):
        Cluster(address)


def test_code_goes_to_other_computers_only_encrypted_or_on_demand() -> None:
    for host in ("people.example", "10.0.0.1", "127.0.0.1.example", "0.0.0.0", "[::]", "[2001:db8::1]"):
        with pytest.raises(BadInput, match="can send code that its workers run"):
            Cluster(f"tcp://{host}:8786")
        Cluster(f"tcp://{host}:8786", insecure=True)
        Cluster(f"tls://{host}:8786")
    for host in ("127.0.0.1", "127.1.2.3", "localhost", "[::1]"):
        Cluster(f"tcp://{host}:8786")
    with pytest.raises(BadInput, match="certificates are for tls://"):
        Cluster("tcp://127.0.0.1:8786", Path("ca.pem"))
    with pytest.raises(BadInput, match="needs its certificate"):
        Cluster("tls://127.0.0.1:8786", Path("ca.pem"), key_file=Path("key.pem"))


def test_a_cluster_that_is_not_there(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("splitknit_match.batch.execution.PATIENCE_S", 0.5)
    said = r"cannot be reached \(.*(refused|no answer in time)"  # the second on a busy machine
    with pytest.raises(BadInput, match=said), connected(Cluster("tcp://127.0.0.1:9")):
        pass


@pytest.mark.slow
def test_a_cluster_is_used_by_whom_its_ca_knows(
    tls: tuple[str, Path, Path], people: Path, tmp_path: Path, capsys: Any
) -> None:
    address, good, other = tls
    words = ["batch", str(people), "--cases", "ea", "--matchers", "none", "--cluster"]
    refused, out = str(tmp_path / "refused"), tmp_path / "store"
    mixed = [*options(other)[:1], *options(good)[1:]], [*options(good)[:1], *options(other)[1:]]
    for wrong, said in (
        ([address, *options(other)], "certificate verify failed"),
        ([address, *mixed[0]], "certificate verify failed"),
        ([address, *mixed[1]], "cannot be reached"),
        ([address], "needs certificates: name --cluster-ca"),
        ([address, *options(tmp_path)], "No such file"),
        ([address, *options(good)[:2], f"--cluster-key={other / 'key.pem'}"], "KEY_VALUES_MISMATCH"),
        ([address.replace("tls", "tcp")], "cannot be reached"),
        (["tcp://10.0.0.1:8786"], "--insecure-cluster"),
    ):
        assert main([*words, *wrong, "--out", refused]) == 2
        err = capsys.readouterr().err
        assert said in err and err.count("\n") == 1
    assert not Path(refused).exists()
    assert main([*words, address, *options(good), "--out", str(out)]) == 0
    capsys.readouterr()
    run_batch(people, tmp_path / "here", BatchSettings(cases=preset_cases(("ea",)), matchers=()), jobs=1)
    assert chunks(out) == chunks(tmp_path / "here")
    assert main(["batch", str(people), "--out", str(out), "--insecure-cluster"]) == 2
    assert "name it with --cluster" in capsys.readouterr().err


class Counted(list[int]):
    """Tasks that know how many of them were begun."""

    begun = 0

    def __iter__(self) -> Iterator[int]:
        for task in super().__iter__():
            self.begun += 1
            yield task


def test_the_scheduler_is_given_few_tasks_at_a_time(tls: tuple[str, Path, Path]) -> None:
    address, good, _ = tls
    files = [good / f"{name}.pem" for name in ("ca", "cert", "key")]
    tasks = Counted(range(20))
    with connected(Cluster(address, *files)) as client:
        for number, _ in enumerate(run_tasks(double, tasks, 1, client), start=1):
            assert tasks.begun <= number + AHEAD  # of one thread
    assert tasks.begun == 20


def test_a_small_population_keeps_several_jobs_at_work(people: Path, tmp_path: Path) -> None:
    population, store = read_population(people), Store(tmp_path)
    settings = BatchSettings(cases=preset_cases(("ea",)), matchers=())
    assert [len(task.captures) for task in _feature_tasks(store, population, settings)] == [1] * 4
    large = replace(population, planned=680)
    assert [len(task.captures) for task in _feature_tasks(store, large, settings)] == [4]


def test_each_of_several_jobs_runs_networks_on_one_thread() -> None:
    before = running()
    assert set(run_tasks(threads_of, range(4), 2)) == {1}
    assert set(run_tasks(threads_of, range(4), 1)) == {2}
    assert running() == before


def test_the_client_opens_no_port_and_dask_s_configuration_weakens_nothing(tls: tuple[str, Path, Path]) -> None:
    import dask

    address, good, other = tls
    files = {"ca-file": "ca.pem", "client.cert": "cert.pem", "client.key": "key.pem"}
    configured = {f"distributed.comm.tls.{name}": str(good / file) for name, file in files.items()}
    before = listening()
    with dask.config.set(configured), connected(Cluster(address)) as client:
        assert list(run_tasks(double, [4], 1, client)) == [8]
        assert listening() == before
    weak = {"distributed.comm.require-encryption": False, "distributed.comm.tls.ciphers": "eNULL:aNULL"}
    wrong = Cluster(address, other / "ca.pem", good / "cert.pem", good / "key.pem")
    with dask.config.set(weak):
        with pytest.raises(BadInput, match="verify failed"), connected(wrong):
            pass
        with connected(replace(wrong, ca_file=good / "ca.pem")) as client:
            assert list(run_tasks(double, [4], 1, client)) == [8]


def test_the_page_s_commands_make_certificates_and_start_a_cluster_with_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Commands of docs/guide/batch.md: what OpenSSL writes is taken, and Dask understands its options."""
    pytest.importorskip("distributed")
    from distributed.cli.dask_scheduler import main as scheduler
    from distributed.cli.dask_worker import main as worker

    page = (Path(__file__).resolve().parents[4] / "docs" / "guide" / "batch.md").read_text(encoding="utf-8")
    making, starting = re.findall(r"```sh\n(.*?)```", page[page.index("## On several computers") :], re.DOTALL)[:2]
    monkeypatch.chdir(tmp_path)
    subprocess.run(["sh", "-e"], input=making, text=True, check=True, capture_output=True)
    assert (tmp_path / "ca-key.pem").stat().st_mode & 0o77 == 0
    lines = [shlex.split(line, comments=True) for line in starting.replace("\\\n", " ").splitlines()]
    commands = {line[1]: line[2:] for line in lines if line[:1] == ["dask"]}
    for name, command in (("scheduler", scheduler), ("worker", worker)):
        understood = command.make_context(name, commands[name]).params
        assert not understood["dashboard"]
        assert [understood[f"tls_{kind}"] for kind in ("ca_file", "cert", "key")] == [
            str(tmp_path / file) for file in ("ca.pem", "cert.pem", "key.pem")
        ]
    subprocess.run(["openssl", "verify", "-CAfile", "ca.pem", "cert.pem"], check=True, capture_output=True)


@pytest.mark.slow
def test_a_killed_worker_of_a_cluster_loses_nothing(people: Path, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    out = tmp_path / "cluster"
    settings = BatchSettings(cases=preset_cases(("ea",)), matchers=("ridge", "thesis"), chunk_captures=1)
    with distributed.LocalCluster(
        n_workers=3, threads_per_worker=1, dashboard_address="127.0.0.1:0", silence_logs="CRITICAL"
    ) as cluster:
        pids = [worker.pid for worker in cluster.workers.values()]
        with when_begun(out, lambda: os.kill(pids[0], signal.SIGKILL)) as killed:
            facts = run_batch(people, out, settings, cluster=cluster.scheduler_address)
    assert killed.is_set()
    assert facts["reconstructed"] == 4
    run_batch(people, tmp_path / "here", settings, jobs=1)
    assert chunks(out) == chunks(tmp_path / "here")
    for matcher in settings.matchers:
        assert len(Store(out).scores("ea", matcher)["a"]) == 4


RUN = """
import sys
from pathlib import Path
from splitknit_match.batch.engine import run_batch
from splitknit_match.batch.settings import BatchSettings, preset_cases
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
    assert 0 < len(Store(out).features("ea")["capture"]) < 4


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
    assert rows_of(Store(out).features("ea")) == rows_of(Store(reconstructed).features("ea"))


MANY_KILLED = """
import os, random, signal, sys, time
from pathlib import Path
sys.path.insert(0, sys.argv[3])
from batch_stores import chunks
from splitknit_match.batch.engine import run_batch
from splitknit_match.batch.settings import BatchSettings, preset_cases
people, folder = map(Path, sys.argv[1:3])
settings = BatchSettings(cases=preset_cases(("ea",)), matchers=("ridge",), chunk_captures=1)

def contents(out):
    others = (*out.glob("csv/*"), out / "store.json")
    return chunks(out) | {file.relative_to(out).as_posix(): file.read_bytes() for file in others}

began = time.monotonic()
run_batch(people, folder / "sound", settings, jobs=1)
whole_s, sound, hits, stores = time.monotonic() - began, contents(folder / "sound"), 0, 0
random.seed(7)
while hits < 3:
    out = folder / str(stores)
    child = os.fork()
    if child == 0:
        try:
            run_batch(people, out, settings, jobs=1)
            os._exit(0)
        finally:
            os._exit(1)
    time.sleep(random.uniform(0, 0.6 * whole_s))
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    hits += os.WIFSIGNALED(status)
    assert status == 0 or os.WIFSIGNALED(status), "it failed before it was killed"
    assert chunks(out).items() <= sound.items(), "a chunk differs"
    if status == 0:
        assert contents(out) == sound, "a store differs"
        stores += 1
run_batch(people, out, settings, jobs=1)
assert contents(out) == sound, "the finished store differs"
assert not [left for left in out.rglob("*.tmp") if any(left.iterdir())], "something half-written is left"
print("sound")
"""


@pytest.mark.slow
def test_kills_at_any_moment_lose_and_change_no_byte(people: Path, tmp_path: Path) -> None:
    arguments = [str(people), str(tmp_path), str(Path(__file__).parents[1])]
    found = subprocess.run([sys.executable, "-c", MANY_KILLED, *arguments], capture_output=True, text=True, check=False)
    assert found.stdout == "sound\n", found.stderr
