"""A batch among objects: the same tables as in folders, nothing half there, no disk that computers share."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from batch_stores import EA, chunks
from splitknit.cli.main import main
from splitknit.errors import BadInput
from splitknit_match.batch.engine import run_batch
from splitknit_match.batch.objects import (
    Objects,
    captures_at_hand,
    files_below,
    location,
    stored_bytes,
    whole_file,
)
from splitknit_match.batch.population import read_population
from splitknit_match.batch.settings import preset_cases
from splitknit_match.batch.store import Store

fsspec = pytest.importorskip("fsspec")
RIDGE = replace(EA, matchers=("ridge",))
SECRET = "not-to-be-seen-0815"


def upload(folder: Path, target: Objects) -> None:
    for file in sorted(folder.rglob("*")):
        if file.is_file():
            with whole_file(Objects(f"{target}/{file.relative_to(folder).as_posix()}")) as stream:
                stream.write(file.read_bytes())


def tables(out: Objects) -> dict[str, bytes]:
    """Every Parquet object of a store by its place."""
    names = [name for name in files_below(out, deep=True) if name.endswith(".parquet")]
    return {name: stored_bytes(Objects(f"{out}/{name}"), 10**9) for name in names}


@pytest.fixture
def memory(people: Path) -> Iterator[Objects]:
    """A place in this process's memory that holds the population."""
    place = Objects("memory://bucket")
    upload(people, place / "people")
    yield place
    fsspec.filesystem("memory").store.clear()


class Ranges(fsspec.spec.AbstractBufferedFile):  # type: ignore[misc, name-defined]  # fsspec is not typed
    """An object that is read in ranges, as in S3."""

    def _fetch_range(self, start: int, end: int) -> bytes:
        return bytes(self.fs.cat_file(self.path, start=start, end=end))


class Counted:
    """A file system, and what is asked of it."""

    def __init__(self, moved: Counter[str], fs: Any) -> None:
        self.moved, self.fs = moved, fs

    def __getattr__(self, name: str) -> Any:
        def asked(*arguments: Any, **rest: Any) -> Any:
            if name == "open":
                return Ranges(self, *arguments, **rest)
            found = getattr(self.fs, name)(*arguments, **rest)
            if name == "pipe_file":
                self.moved.update(puts=1, written=len(arguments[1]))
            elif name == "cat_file":
                self.moved.update(gets=1, read=len(found))
            elif name == "find":
                self.moved.update(gets=1 + len(found) // 1000)
            elif name in ("info", "isfile"):
                self.moved.update(gets=1)
            else:
                assert name == "invalidate_cache"
            return found

        return asked


@pytest.fixture
def moved(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """Requests and bytes of this process from here on."""
    from fsspec.core import url_to_fs

    counts: Counter[str] = Counter()

    def counted(url: str) -> tuple[Counted, str]:
        fs, path = url_to_fs(url)
        return Counted(counts, fs), path

    monkeypatch.setattr("fsspec.core.url_to_fs", counted)
    return counts


def test_what_a_name_means() -> None:
    assert location("people") == Path("people")
    assert location("s3://bucket/a/b/") == location(Objects("s3://bucket/a/b")) == Objects("s3://bucket/a/b")
    assert ((location("gs://b/x") / "y.parquet").name, (location("gs://b/x") / "y.parquet").stem) == ("y.parquet", "y")
    for url, said in (
        ("https://host/people", "not an object storage"),
        ("s3://bucket", "form s3://BUCKET/PLACE"),
        ("s3://bucket/a/../b", "form s3://BUCKET/PLACE"),
        (f"s3://key:{SECRET}@bucket/people", "names a bucket"),
        (f"s3://bucket/people?secret={SECRET}", "names a bucket"),
    ):
        with pytest.raises(BadInput, match=said) as error:
            location(url)
        assert SECRET not in str(error.value)


@pytest.mark.slow
def test_objects_give_the_tables_of_folders(memory: Objects, people: Path, tmp_path: Path) -> None:
    run_batch(people, tmp_path / "store", RIDGE, jobs=1)
    facts = run_batch(str(memory / "people"), memory / "store", RIDGE, jobs=1)
    assert facts["reconstructed"] == facts["scores"][0]["compared"] == 4
    assert tables(memory / "store") == chunks(tmp_path / "store")
    assert facts["csv"] == ["memory://bucket/store/csv/ea_ridge.csv"]
    assert stored_bytes(memory / "store/csv/ea_ridge.csv", 10**6) == (tmp_path / "store/csv/ea_ridge.csv").read_bytes()
    assert Store(memory / "store").features("ea").equals(Store(tmp_path / "store").features("ea"))
    assert set(Store(memory / "store").seconds("ea")) == set(Store(tmp_path / "store").seconds("ea"))
    again = run_batch(memory / "people", memory / "store", RIDGE, jobs=1)
    assert (again["reconstructed"], again["found"], again["scores"][0]["compared"]) == (0, 4, 0)
    with pytest.raises(BadInput, match="this process alone"):
        run_batch(memory / "people", memory / "store", RIDGE, jobs=2)
    with pytest.raises(BadInput, match="is not a store"):
        run_batch(memory / "people", memory / "people", RIDGE, jobs=1)
    with pytest.raises(BadInput, match="is not a population"):
        run_batch(memory / "nobody", memory / "store", RIDGE, jobs=1)


@pytest.mark.parametrize(
    "name", ["{}", "{}/../../../../../../{}", "../../../../../escaped", "..\\..\\escaped", "a\0b", "C:escaped"]
)
def test_a_key_names_no_file_outside(memory: Objects, name: str, monkeypatch: Any, tmp_path: Path) -> None:
    """Whoever may write into the bucket overwrote any file of the user: keys are names of files."""
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    outside = tmp_path / "escaped"
    outside.write_text("mine")
    capture = read_population(memory / "people").captures[0].name
    key = f"/bucket/people/{capture}/{name.format(outside, outside)}"
    fsspec.filesystem("memory").store[key] = fsspec.implementations.memory.MemoryFile(path=key, data=b"theirs")
    with pytest.raises(BadInput, match="the name of an object"):
        run_batch(memory / "people", memory / "store", EA, jobs=1)
    assert outside.read_text() == "mine"
    assert sorted(os.listdir(tmp_path)) == ["escaped", "temporary"]  # noqa: PTH208


def test_a_store_names_no_capture_outside(memory: Objects, people: Path, tmp_path: Path) -> None:
    for population in (memory / "people", people):
        for name in (str(tmp_path), "../people", "S01/../../x"):
            with (
                pytest.raises(BadInput, match="the name of a capture leaves"),
                captures_at_hand(population, [name]) as there,
            ):
                next(there)


def test_an_object_appears_whole_or_not_at_all(memory: Objects) -> None:
    with contextlib.suppress(KeyboardInterrupt), whole_file(memory / "half") as stream:
        stream.write(b"half of it")
        raise KeyboardInterrupt
    assert files_below(memory) == []


def test_a_storage_that_fails_is_no_failure_to_acquire(
    memory: Objects, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    read_population(memory / "people")
    real = fsspec.filesystem("memory").cat_file

    def lost(self: Any, path: str, **options: Any) -> bytes:
        if path.endswith("white_3.png"):
            raise ConnectionError(f"lost while {SECRET} was sent")
        return bytes(real(path, **options))

    def cut(self: Any, path: str, **options: Any) -> bytes:
        return bytes(real(path, **options))[: 100 if path.endswith("white_3.png") else None]

    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    for fault, said in (
        (lost, r"white_3\.png' cannot be read \(ConnectionError\)"),
        (cut, r"white_3\.png' came with 100 of \d+ bytes"),
    ):
        monkeypatch.setattr(type(fsspec.filesystem("memory")), "cat_file", fault)
        with pytest.raises(BadInput, match=said) as error:
            run_batch(memory / "people", memory / "store", EA, jobs=1)
        assert SECRET not in str(error.value)
    assert tables(memory / "store") == {}
    assert list(tmp_path.iterdir()) == []  # copies of captures are gone


def test_copies_are_private_and_go_with_their_turn(
    memory: Objects, people: Path, monkeypatch: Any, tmp_path: Path
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    names = [capture.name for capture in read_population(people).captures]
    with captures_at_hand(memory / "people", names) as folders:
        for name, folder in zip(names, folders, strict=True):
            assert (folder / name / "white_0.png").read_bytes() == (people / name / "white_0.png").read_bytes()
            assert (folder / name / "truth.npz").stat().st_size == 0
            assert folder.parent.stat().st_mode & 0o77 == 0
            assert len(list(folder.parent.iterdir())) <= 2  # this one and the next
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_work_of_a_batch_by_counting(
    memory: Objects, people: Path, moved: Counter[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three cases: a capture is copied and decoded once, its truth never, and a template is read once for all pairs."""
    from splitknit.io import images
    from splitknit_match.batch import features
    from splitknit_match.batch.settings import BatchSettings, preset_cases

    read: list[str] = []
    decoded: list[str] = []
    real_read, real_decode = features.read_capture, images.StackReader.start

    def read_capture(folder: Path, **rest: Any) -> Any:
        read.append(folder.name)
        return real_read(folder, **rest)

    def start(self: Any, files: Any, *rest: Any) -> Any:
        decoded.extend(str(file) for file in files)
        return real_decode(self, files, *rest)

    monkeypatch.setattr(features, "read_capture", read_capture)
    monkeypatch.setattr(images.StackReader, "start", start)
    settings = BatchSettings(cases=preset_cases(("ea", "ea-split", "kumar")), matchers=("ridge",), chunk_captures=2)
    run_batch(memory / "people", memory / "store", settings, jobs=1)
    done = moved.copy()
    captures = 4
    assert len(read) == captures
    assert len(decoded) == len(set(decoded)) == 16 * captures
    of_captures = sum(
        file.stat().st_size for file in people.rglob("S*/*/*/*") if file.name not in ("truth.npz", "impression.json")
    )
    stored = sum(len(data) for data in tables(memory / "store").values())
    plan = sum((people / name).stat().st_size for name in ("enrolment.json", "population.json"))
    # every table is read in part: names of captures, templates and hashes, and as a whole for the score files
    assert of_captures + plan < done["read"] < of_captures + plan + stored
    assert done["written"] < 1.1 * stored + 20_000  # with store.json, seconds and score files
    assert done["puts"] == 1 + 3 * (2 * 2 + 2 * 1 + 1)  # store; of each case chunks and their seconds, and a score file
    assert done["gets"] <= 160, "more requests than when this was written: 19 of each capture, 28 of each case"


# A real server on this computer, and processes that share nothing but it.


def free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def until(condition: Callable[[], Any], seconds: float = 60.0) -> Any:
    end = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < end, "it does not happen"
        time.sleep(0.1)
    return found


def answers(port: int) -> bool:
    with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1):
        return True
    return False


@contextlib.contextmanager
def program(folder: Path, *words: str) -> Iterator[subprocess.Popen[bytes]]:
    """A program with a folder, a home and temporary files of its own, killed at the end."""
    (folder / "tmp").mkdir(parents=True)
    own = {"HOME": str(folder), "TMPDIR": str(folder / "tmp")}
    with (folder / "said").open("w") as said:
        run = subprocess.Popen([sys.executable, *words], cwd=folder, env=os.environ | own, stdout=said, stderr=said)
    try:
        yield run
    finally:
        run.kill()
        run.wait()


@pytest.fixture
def bucket(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Objects]:
    """An empty bucket of a server that speaks S3, whose address and credentials are in the environment alone."""
    pytest.importorskip("moto")
    pytest.importorskip("s3fs")
    port = free_port()
    here = {"AWS_ENDPOINT_URL": f"http://127.0.0.1:{port}", "AWS_DEFAULT_REGION": "us-east-1"}
    here |= {"AWS_ACCESS_KEY_ID": "key", "AWS_SECRET_ACCESS_KEY": SECRET, "AWS_CONFIG_FILE": str(tmp_path / "none")}
    here |= {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    for name, value in here.items():
        monkeypatch.setenv(name, value)
    with program(tmp_path / "server", "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)):
        until(lambda: answers(port))
        fs = fsspec.filesystem("s3", skip_instance_cache=True)
        fs.mkdir("fingers")
        yield Objects("s3://fingers/batch")
        type(fs).clear_instance_cache()


@pytest.mark.slow
def test_a_cluster_that_shares_no_disk(people: Path, tmp_path: Path, bucket: Objects, capsys: Any) -> None:
    """Scheduler and three workers, each in a folder of its own; stopped and resumed, and one worker killed."""
    pytest.importorskip("distributed")
    copy = Path(shutil.copytree(people, tmp_path / "people"))
    upload(copy, bucket / "people")
    shutil.rmtree(copy)  # from here on the objects are all there is
    port = free_port()
    address, quiet = f"tcp://127.0.0.1:{port}", ("--no-dashboard", "--dashboard-address", "127.0.0.1:0")
    words = ["batch", str(bucket / "people"), "--out", str(bucket / "store"), "--cluster", address]
    with contextlib.ExitStack() as stack:
        scheduler = ("-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", str(port))
        stack.enter_context(program(tmp_path / "scheduler", *scheduler, *quiet))
        until(lambda: answers(port))
        worker = ("-m", "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny")
        workers = [stack.enter_context(program(tmp_path / f"worker{k}", *worker, *quiet)) for k in range(3)]
        with program(tmp_path / "driver", "-m", "splitknit", *words, "--cases", "ea", "--matchers", "none") as run:
            until(lambda: run.poll() is not None or files_below(bucket / "store" / "features" / "ea"), 120.0)
            run.send_signal(signal.SIGINT)
            run.wait(60)
        said = (tmp_path / "driver" / "said").read_text()
        assert run.returncode in (0, 130)  # it may have been done by then
        # before it, distributed may log an exception of its own, where the interrupt meets a call of the scheduler
        assert run.returncode == 0 or said.endswith("splitknit: interrupted; nothing was left half-written.\n")
        assert SECRET not in said
        settings = replace(RIDGE, cases=(*RIDGE.cases, *preset_cases(("ea-split",))), chunk_captures=1)
        with ThreadPoolExecutor(1) as pool:
            going = pool.submit(run_batch, bucket / "people", bucket / "store", settings, cluster=address)
            until(lambda: going.done() or files_below(bucket / "store" / "features" / "ea-split"))
            workers[0].kill()
            facts = going.result()
        assert facts["reconstructed"] + facts["found"] == 8
        assert facts["found"] > 0
        assert main([*words, "--cases", "ea,ea-split", "--csv", str(tmp_path / "csv"), "--json"]) == 0
        assert '"reconstructed": 0' in capsys.readouterr().out
    run_batch(people, tmp_path / "here", settings, jobs=1)
    assert tables(bucket / "store") == chunks(tmp_path / "here")
    for name in ("ea_ridge.csv", "ea-split_ridge.csv"):
        assert (tmp_path / "csv" / name).read_bytes() == (tmp_path / "here" / "csv" / name).read_bytes()
    for name in files_below(bucket / "store", deep=True):
        assert SECRET.encode() not in stored_bytes(Objects(f"{bucket}/store/{name}"), 10**9)
    for k in (1, 2):
        assert not [file for file in (tmp_path / f"worker{k}").rglob("*") if file.suffix in (".png", ".parquet")]


@pytest.mark.slow
def test_a_bucket_that_is_not_there(bucket: Objects, people: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(BadInput, match=r"'s3://nobody/store' does not exist; correct the name, or make the bucket"):
        run_batch(people, Objects("s3://nobody/store"), EA, jobs=1)
    monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{free_port()}")
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "1")
    fsspec.get_filesystem_class("s3").clear_instance_cache()
    with pytest.raises(BadInput, match=r"check the bucket, its rights, the address") as error:
        run_batch(people, bucket / "store", EA, jobs=1)
    assert SECRET not in str(error.value)
