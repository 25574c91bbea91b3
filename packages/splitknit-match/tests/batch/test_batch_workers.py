"""Workers that are killed: nothing is lost, nothing is counted twice."""

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

from batch_stores import run, tables
from clusters import local_cluster
from refusals import bad_input
from splitknit.cli.main import main
from splitknit.networks.unet import network_threads
from splitknit_match import tasks
from splitknit_match.batch.store import Store
from splitknit_match.tasks import AHEAD, Done, connected, run_tasks

HERE, TWO = 1, 2


def double(value):
    return Done(2 * value)


def threads_of(value):
    return Done(network_threads())


def die(value):
    if value == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return Done(value)


def sizes(work, values, *workers):
    return sorted(done.size for done in run_tasks(work, values, *workers))


@contextmanager
def when_begun(out, act):
    """Do something as soon as the first chunk is there."""
    done, stop = threading.Event(), threading.Event()

    def watch():
        while not stop.is_set():
            if list(out.glob("features/ea/*/*/*.npz")):
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


@pytest.mark.slow
def test_tasks_here_and_in_processes_give_the_same():
    assert (
        sizes(double, range(7), HERE) == sizes(double, range(7), TWO) == [2 * k for k in range(7)]
    )
    assert sizes(double, [], TWO) == []


def test_a_killed_process_ends_the_run_with_one_sentence():
    with bad_input("a worker was killed") as error:
        sizes(die, range(4), TWO)
    assert "run the same again" in str(error.value)


def test_workers_are_as_many_as_memory_holds(monkeypatch):
    assert tasks.workers_that_fit() >= 1
    monkeypatch.setattr(tasks, "WORKER_BYTES", 1 << 60)
    assert tasks.workers_that_fit() == 1
    assert sizes(threads_of, range(3), 3) == [network_threads()] * 3  # in this process


def test_a_package_that_is_missing_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    missing = bad_input(r"distributed.*splitknit-match\[cluster\]")
    with missing, connected("tcp://127.0.0.1:1"):
        pass


def certificates(folder):
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
        subprocess.run(
            ["openssl", *command.split()], cwd=folder, check=True, capture_output=True, timeout=60
        )
    return folder


def configured(folder):
    """Dask with a folder's certificates, as its environment variables would set them."""
    import dask

    files = {"ca-file": "ca.pem", "client.cert": "cert.pem", "client.key": "key.pem"}
    return dask.config.set(
        {f"distributed.comm.tls.{name}": str(folder / file) for name, file in files.items()}
    )


@pytest.fixture(scope="module")
def tls(tmp_path_factory):
    """Address of a cluster, the certificates of its CA, and those of another one."""
    distributed = pytest.importorskip("distributed")
    folder = tmp_path_factory.mktemp("tls")
    good, foreign = certificates(folder / "good"), certificates(folder / "other")
    pair = {
        f"tls_{role}_{kind}": str(good / f"{kind}.pem")
        for role in ("scheduler", "worker", "client")
        for kind in ("cert", "key")
    }
    security = distributed.Security(
        require_encryption=True, tls_ca_file=str(good / "ca.pem"), **pair
    )
    with local_cluster(1, processes=False, protocol="tls://", security=security) as cluster:
        yield cluster.scheduler_address, good, foreign


def listening():
    """Ports that this process listens on."""
    import psutil

    return sum(
        connection.status == "LISTEN" for connection in psutil.Process().net_connections("tcp")
    )


@pytest.mark.parametrize(
    "address",
    [
        "nonsense://",
        "127.0.0.1:8786",
        "http://127.0.0.1:8786",
        "inproc://127.0.0.1/1/1",
        "tls://host",
        "tls://host:0",
        "tls://host:99999",
        "tls://host:8786/",
        "ucx://host:8786",
        "tcp://127.0.0.1:8786\n",
        "tcp://[::1:8786",
        "",
    ],
)
def test_other_addresses_are_refused(address):
    with bad_input("is not the address of a scheduler"), connected(address):
        pass


def test_code_goes_to_other_computers_only_encrypted():
    for host in (
        "people.example",
        "10.0.0.1",
        "127.0.0.1.example",
        "0.0.0.0",
        "[::]",
        "[2001:db8::1]",
    ):
        with bad_input("can send code that its workers run"), connected(f"tcp://{host}:8786"):
            pass


@pytest.mark.slow
@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "[::1]"])
def test_a_scheduler_that_is_not_there(host, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(tasks, "PATIENCE_S", 0.5)
    refused = bad_input(r"cannot be reached \(.*(refused|no answer in time|Cannot assign)")
    with refused, connected(f"tcp://{host}:9"):
        pass


@pytest.mark.slow
def test_a_cluster_is_used_by_whom_its_ca_knows(tls, people, tmp_path, capsys, monkeypatch):
    address, good, foreign = tls
    monkeypatch.setattr(tasks, "PATIENCE_S", 10.0)
    words = f"batch {people} --cases ea --matchers none".split()
    mixed = tmp_path / "mixed"
    shutil.copytree(foreign, mixed)
    shutil.copy(good / "ca.pem", mixed)  # trusts the scheduler, which does not trust it
    for certificates_of, wrong in (
        (foreign, address),
        (mixed, address),
        (tmp_path, address),
        (good, "tcp" + address[3:]),
    ):
        with configured(certificates_of):
            assert main([*words, "--scheduler", wrong, "--out", str(tmp_path / "refused")]) == 2
        err = capsys.readouterr().err
        assert "cannot be reached" in err and err.count("\n") == 1
    assert not (tmp_path / "refused").exists()
    with configured(good):
        assert main([*words, "--scheduler", address, "--out", str(tmp_path / "store")]) == 0
    capsys.readouterr()
    run(people, tmp_path / "here")
    assert tables(tmp_path / "store") == tables(tmp_path / "here")


class Counted(list[int]):
    """Tasks that know how many of them were begun."""

    begun = 0

    def __iter__(self):
        for task in super().__iter__():
            self.begun += 1
            yield task


def test_the_scheduler_is_given_few_tasks_at_a_time(tls):
    address, good, _ = tls
    values = Counted(range(20))
    with configured(good), connected(address) as client:
        for number, _ in enumerate(run_tasks(double, values, 1, client), start=1):
            assert values.begun <= number + AHEAD  # of one thread
    assert values.begun == 20


@pytest.mark.slow
def test_each_of_several_jobs_runs_networks_on_one_thread():
    before = network_threads()
    assert sizes(threads_of, range(4), TWO) == [1] * 4
    assert sizes(threads_of, range(4), HERE) == [before] * 4
    assert network_threads() == before


def test_the_client_opens_no_port_and_dask_s_configuration_weakens_nothing(tls):
    import dask

    address, good, foreign = tls
    before = listening()
    weak = {
        "distributed.comm.require-encryption": False,
        "distributed.comm.tls.ciphers": "eNULL:aNULL",
    }
    for setting in ({}, weak):
        with configured(good), dask.config.set(setting), connected(address) as client:
            assert sizes(double, [4], 1, client) == [8]
            assert listening() == before
    with configured(foreign), dask.config.set(weak), bad_input("verify failed"), connected(address):
        pass


def test_the_page_s_commands_make_certificates_and_start_a_cluster_with_them(tmp_path, monkeypatch):
    """Commands of docs/guide/batch.md: what OpenSSL writes is taken, and Dask understands its
    options."""
    pytest.importorskip("distributed")
    from distributed.cli.dask_scheduler import main as scheduler
    from distributed.cli.dask_worker import main as worker

    page = (Path(__file__).resolve().parents[4] / "docs" / "guide" / "batch.md").read_text(
        encoding="utf-8"
    )
    making, starting = re.findall(
        r"```sh\n(.*?)```", page[page.index("## On several computers") :], re.DOTALL
    )[:2]
    monkeypatch.chdir(tmp_path)
    subprocess.run(["sh", "-e"], input=making, text=True, check=True, capture_output=True)
    assert (tmp_path / "ca-key.pem").stat().st_mode & 0o77 == 0
    lines = [
        shlex.split(line, comments=True) for line in starting.replace("\\\n", " ").splitlines()
    ]
    commands = {line[1]: line[2:] for line in lines if line[:1] == ["dask"]}
    for name, command in (("scheduler", scheduler), ("worker", worker)):
        understood = command.make_context(name, commands[name]).params
        assert not understood["dashboard"]
        assert [understood[f"tls_{kind}"] for kind in ("ca_file", "cert", "key")] == [
            str(tmp_path / file) for file in ("ca.pem", "cert.pem", "key.pem")
        ]
    subprocess.run(
        ["openssl", "verify", "-CAfile", "ca.pem", "cert.pem"], check=True, capture_output=True
    )


@pytest.mark.slow
def test_a_killed_worker_of_a_cluster_loses_nothing(people, tmp_path, caplog):
    out = tmp_path / "cluster"
    with local_cluster(3) as cluster:
        pids = [worker.pid for worker in cluster.workers.values()]
        with when_begun(out, lambda: os.kill(pids[0], signal.SIGKILL)) as killed:
            facts = run(people, out, "ridge", "thesis", scheduler=cluster.scheduler_address)
    assert killed.is_set()
    assert facts["reconstructed"] == 4
    assert "was lost; others do its tasks again." in caplog.text
    run(people, tmp_path / "here", "ridge", "thesis")
    assert tables(out) == tables(tmp_path / "here")
    for matcher in ("ridge", "thesis"):
        assert len(Store(out).scores("ea", matcher)["a"]) == 4


RUN = """
import sys
from splitknit_match.batch.cases import preset_cases
from splitknit_match.batch.engine import run_batch
try:
    run_batch(*sys.argv[1:], cases=preset_cases(("ea",)), matchers=())
except KeyboardInterrupt:
    sys.exit("interrupted")
"""


@pytest.mark.slow
def test_ctrl_c_ends_the_run_and_its_processes_quietly(people, tmp_path):
    out = tmp_path / "stopped"
    program = subprocess.Popen(
        [sys.executable, "-c", RUN, str(people), str(out)],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    with when_begun(out, lambda: os.killpg(program.pid, signal.SIGINT)) as stopped:
        _, err = program.communicate()
    assert stopped.is_set()
    assert (program.returncode, err) == (1, "interrupted\n")
    assert not list(out.rglob("*.tmp"))
    assert 0 < len(Store(out).features("ea")["capture"]) < 4


MANY_KILLED = """
import os, random, signal, sys, time
from pathlib import Path
sys.path.insert(0, sys.argv[3])
from batch_stores import run, tables
people, folder = map(Path, sys.argv[1:3])

def contents(out):
    others = (*out.glob("csv/*"), out / "store.json")
    return tables(out) | {file.relative_to(out).as_posix(): file.read_bytes() for file in others}

began = time.monotonic()
run(people, folder / "sound", "ridge")
whole_s, sound, hits, stores = time.monotonic() - began, contents(folder / "sound"), 0, 0
random.seed(7)
while hits < 3:
    out = folder / str(stores)
    child = os.fork()
    if child == 0:
        try:
            run(people, out, "ridge")
            os._exit(0)
        finally:
            os._exit(1)
    time.sleep(random.uniform(0, 0.6 * whole_s))
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    hits += os.WIFSIGNALED(status)
    assert status == 0 or os.WIFSIGNALED(status), "it failed before it was killed"
    assert tables(out).items() <= sound.items(), "a table differs"
    if status == 0:
        assert contents(out) == sound, "a store differs"
        stores += 1
run(people, out, "ridge")
assert contents(out) == sound, "the finished store differs"
halves = [folder for folder in out.rglob("*.tmp") if any(folder.iterdir())]
assert not halves, "something half-written is left"
print("sound")
"""


@pytest.mark.slow
def test_kills_at_any_moment_lose_and_change_no_byte(people, tmp_path):
    arguments = [str(people), str(tmp_path), str(Path(__file__).parents[1])]
    process = subprocess.run(
        [sys.executable, "-c", MANY_KILLED, *arguments], capture_output=True, text=True, check=False
    )
    assert process.stdout == "sound\n", process.stderr
