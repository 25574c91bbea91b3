"""The batch engine: processor time of a comparison by each matcher, of a reconstruction, disk, bytes moved, memory.

    python benchmarks/bench_batch.py [--scale 0.4] [--fingers 3]      # makes a small population first
    python benchmarks/bench_batch.py --store STORE                    # what a store that is there took

The small population lies among objects in this process's memory, so that every byte and request is counted as it would
be in object storage. From what was measured follows, on paper, a population of `--captures` on `--cores` cores: time,
memory of the scheduler, bytes moved, price. Its own times are processor time of one core, which others on the machine
change little; `seconds` of a store are by the clock.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import pickle
import shutil
import socket
import subprocess
import sys
import time
import tracemalloc
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import fsspec
from fsspec.implementations.memory import MemoryFileSystem
from fsspec.spec import AbstractBufferedFile

from splitknit.io.enrolment import FINGERS
from splitknit_match.batch.chunks import read_chunk
from splitknit_match.batch.engine import _feature_tasks, _score_tasks, run_batch
from splitknit_match.batch.execution import AHEAD, Cluster, connected, run_tasks
from splitknit_match.batch.matchers import matcher
from splitknit_match.batch.objects import Location, Objects, files_below, location, stored_bytes, whole_file
from splitknit_match.batch.population import CaptureRef, all_pairs, blocks_of, read_population
from splitknit_match.batch.reading import Place, drop_cached, small_column
from splitknit_match.batch.settings import BatchSettings, preset_cases
from splitknit_match.batch.store import Store
from splitknit_simulator.population.folder import simulate_population
from splitknit_simulator.population.sessions import PopulationSettings
from timing import machine

OUT = Path(__file__).parent / "out" / "batch"
ALL_PAIRS = 173_400
"""Of 170 fingers in four sessions."""
SESSIONS = 4
PRICES = {"core-hour": 0.04, "gb-month": 0.023, "thousand-gets": 0.0004, "thousand-puts": 0.005}
"""Examples, of no offer, in dollars: of a rented core, of storage, of requests that read and that write."""
CHUNK = 10
"""Captures of a chunk in a large population."""


@dataclass(slots=True)
class Cost:
    """Of one of something."""

    cpu_s: float = 0.0
    read: float = 0.0
    """Bytes."""
    written: float = 0.0
    gets: float = 0.0
    puts: float = 0.0


class Ranges(AbstractBufferedFile):
    """An object that is read in ranges, as in S3."""

    def _fetch_range(self, start: int, end: int) -> bytes:
        return bytes(self.fs.cat_file(self.path, start=start, end=end))


class CountedMemory(MemoryFileSystem):
    """Objects in memory, and what is asked of them."""

    moved: ClassVar[Counter[str]] = Counter()

    def pipe_file(self, path: str, value: bytes, **rest: Any) -> None:
        self.moved.update(puts=1, written=len(value))
        super().pipe_file(path, value, **rest)

    def cat_file(self, path: str, **rest: Any) -> bytes:
        found: bytes = super().cat_file(path, **rest)
        self.moved.update(gets=1, read=len(found))
        return found

    def open(self, path: str, mode: str = "rb", **rest: Any) -> Any:
        return Ranges(self, path, **rest) if mode == "rb" else super().open(path, mode, **rest)

    def find(self, path: str, **rest: Any) -> Any:
        found = super().find(path, **rest)
        self.moved.update(gets=1 + len(found) // 1000)
        return found

    def info(self, path: str, **rest: Any) -> Any:
        self.moved.update(gets=1)
        return super().info(path, **rest)

    def isfile(self, path: str) -> bool:
        self.moved.update(gets=1)
        return bool(super().isfile(path))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--store", default=None)
    parser.add_argument("--scale", type=float, default=0.4)
    parser.add_argument("--fingers", type=int, default=3)
    parser.add_argument("--cases", default="metric,ea")
    parser.add_argument("--captures", type=int, default=10_000, help="of the population on paper")
    parser.add_argument("--cores", type=int, default=64, help="of the cluster on paper")
    parser.add_argument("--impostors", type=float, default=0.02, help="fraction of them that is compared on paper")
    for name, price in PRICES.items():
        parser.add_argument(f"--price-{name}", type=float, default=price, help=f"an example: {price}")
    options = parser.parse_args()
    fsspec.register_implementation("memory", CountedMemory, clobber=True)
    print(f"Batch, {machine()}")
    if options.store is not None:
        print_store(location(options.store))
        return
    people, store = small_population(options), Objects("memory://bench/store")
    cases = preset_cases(tuple(options.cases.split(",")))
    whole = BatchSettings(cases=cases, matchers=("ridge", "thesis", "minutiae"), chunk_captures=2)
    captures = len(read_population(people).captures)
    with counted(captures * len(cases)) as reconstruction:
        peak = run_batch(people, store, BatchSettings(cases=cases, matchers=(), chunk_captures=2), jobs=1)
    tasks = _feature_tasks(Store(Objects("memory://bench/none")), read_population(people), whole)
    ridge = BatchSettings(cases=cases, matchers=("ridge",), chunk_captures=2)
    pairs = len(cases) * len(
        _score_tasks(Store(store), read_population(people), ridge, cases[0], the_ridge(ridge))[0].pairs
    )
    with counted(pairs) as comparison:
        run_batch(people, store, ridge, jobs=1)
    again = run_batch(people, store, whole, jobs=1)
    print_store(store)
    print(f"Most memory of the process: {max(peak['peak_memory_mb'], again['peak_memory_mb']):.0f} MB.")
    print_moved("a reconstruction (a capture is moved once for all cases)", reconstruction)
    print_moved("a comparison by `ridge` of this small population", comparison)
    on_paper(options, reconstruction, Store(store), len(cases), len(pickle.dumps(tasks[0])))


def the_ridge(settings: BatchSettings):  # type: ignore[no-untyped-def]
    return matcher("ridge", settings.matching)


def small_population(options: argparse.Namespace) -> Objects:
    folder, people = OUT / "people", Objects("memory://bench/people")
    shutil.rmtree(OUT, ignore_errors=True)
    settings = PopulationSettings(scale=options.scale)
    simulate_population(folder, settings, subjects=2, sessions=2, fingers=FINGERS[: options.fingers])
    for file in files_below(folder, deep=True):
        with whole_file(Objects(f"{people}/{file}")) as stream:
            stream.write((folder / file).read_bytes())
    return people


@contextmanager
def counted(number: int) -> Iterator[Cost]:
    """Cost of one of `number` things that the block does."""
    cost, before, times = Cost(), CountedMemory.moved.copy(), os.times()
    yield cost
    now = os.times()
    cost.cpu_s = (now.user + now.system - times.user - times.system) / number
    for name in ("read", "written", "gets", "puts"):
        setattr(cost, name, (CountedMemory.moved[name] - before[name]) / number)


def print_store(store: Location) -> None:
    rows: list[list[str]] = []
    for case in Store(store).document()["cases"]:
        rows += reconstructions(store, case) + comparisons(store, case)
    head = ["case", "what", "how many", "each", f"{ALL_PAIRS} of them, two cores"]
    for row in (head, ["---"] * len(head), *rows):
        print(f"| {' | '.join(row)} |")


def print_moved(what: str, cost: Cost) -> None:
    print(
        f"Each of {what}: {cost.cpu_s:.3f} s of processor time, {cost.read / 1e6:.3f} MB read, "
        f"{cost.written / 1e6:.3f} MB written, {cost.gets:.2f} requests that read, {cost.puts:.2f} that write."
    )


def on_paper(options: argparse.Namespace, made_each: Cost, store: Store, cases: int, task_bytes: int) -> None:
    """A large population, from what the small one took."""
    made, fingers = options.captures * cases, options.captures // SESSIONS
    session_pairs = SESSIONS * (SESSIONS - 1) // 2
    compared = session_pairs * (fingers + options.impostors * fingers * (fingers - 1))
    blocks = the_ridge(BatchSettings()).blocks_for(options.impostors)
    tasks = session_pairs * math.ceil(fingers / blocks.database) * math.ceil(fingers / blocks.query)
    sides = min(fingers, blocks.database) + min(fingers, blocks.query)
    chunk = cost_of_a_chunk(store)
    facts = [fact for case in store.document()["cases"] for fact in timings(store.folder, case, "ridge")]
    ridge_s = sum(fact["processor_s"] for fact in facts) / max(sum(fact["pairs"] for fact in facts), 1)
    compare_h, reconstruct_h = cases * compared * ridge_s / 3600, made * made_each.cpu_s / 3600
    chunks_read = cases * tasks * sides / CHUNK
    gets, puts = made * made_each.gets + chunks_read * chunk.gets, made * made_each.puts + 2 * cases * tasks
    block_bytes = bytes_of_a_block(round(compared / tasks), sides)
    scheduler_mb, stored_gb = scheduler_memory(block_bytes, AHEAD * options.cores), made * made_each.written / 1e9
    price = {
        "cores": (compare_h + reconstruct_h) * options.price_core_hour,
        "a month of storage": stored_gb * options.price_gb_month,
        "requests": (gets * options.price_thousand_gets + puts * options.price_thousand_puts) / 1000,
    }
    rows = {
        "time": f"{reconstruct_h:.1f} core-hours to reconstruct, {compare_h:.1f} to compare; "
        f"{(compare_h + reconstruct_h) / options.cores:.2f} h",
        "read": f"{made * made_each.read / 1e9:.0f} GB of captures, {chunks_read * chunk.read / 1e9:.0f} GB of tables",
        "written": f"{stored_gb:.0f} GB",
        "requests": f"{gets:.0f} that read, {puts:.0f} that write",
        "tasks": f"{options.captures / CHUNK:.0f} to reconstruct ({task_bytes / 1e3:.0f} kB), "
        f"{cases * tasks} to compare ({block_bytes / 1e3:.0f} kB)",
        "scheduler": f"{scheduler_mb:.0f} MB, which has {AHEAD * options.cores} tasks at most (measured)",
        "program that plans": f"{planning_mb(options.captures, options.impostors):.0f} MB beside Python's own",
        "price at example rates": f"{sum(price.values()):.2f} dollars, {sum(price.values()) / fingers:.4f} a finger: "
        + ", ".join(f"{name} {value:.2f}" for name, value in price.items()),
    }
    print(
        f"\nOn paper: {options.captures} captures of {fingers} fingers, {cases} cases, {options.cores} cores; `ridge` "
        f"on {cases} x {compared:.0f} comparisons ({options.impostors:.0%} of the impostors).\n\n| what | how much |"
    )
    for name, text in ({"---": "---"} | rows).items():
        print(f"| {name} | {text} |")


def cost_of_a_chunk(store: Store) -> Cost:
    """What a worker reads of a chunk to compare its captures, if it kept nothing: requests, and bytes for ten."""
    files = store.files("features", next(iter(store.document()["cases"])))
    drop_cached()
    with counted(len(files)) as cost:
        for file in files:
            small_column(Place(file, 0), "input_sha256")
            templates = [len(one) for one in read_chunk(file, ["template"]).column("template").to_pylist()]
    cost.read += (CHUNK - len(templates)) * sum(templates) / len(templates)
    return cost


def bytes_of_a_block(pairs: int, sides: int) -> int:
    """Bytes of a task to compare: names of its pairs, and where its sides lie."""
    place = Place(Objects("s3://bucket/store") / "features" / "metric" / "00003-9a514bad3d49.parquet", 3)
    names = [f"S{k:04d}/session_1/right_index" for k in range(sides)]
    places = dict.fromkeys(names, place)
    return len(pickle.dumps(([(names[k % sides], names[k * 7 % sides], False) for k in range(pairs)], places, places)))


def planning_mb(captures: int, impostors: float, sample: int = 1000) -> float:
    """Memory in MB that pairs and blocks take, by that of `sample` captures: it grows with their square."""
    names = [f"S{k // SESSIONS:04d}/session_{k % SESSIONS + 1}/right_index" for k in range(sample)]
    refs = [
        CaptureRef(name, name[:5], f"{name[:5]}/right_index", name[14], k, k // SESSIONS)
        for k, name in enumerate(names)
    ]
    tracemalloc.start()
    blocks_of(all_pairs(refs, impostors, 0), refs, the_ridge(BatchSettings()).blocks_for(impostors))
    peak_mb = tracemalloc.get_traced_memory()[1] / 1e6
    tracemalloc.stop()
    return peak_mb * (captures / sample) ** 2


def scheduler_memory(task_bytes: int, waiting: int) -> float:
    """Most MB of a real scheduler that is given tasks of this size, so many at a time."""
    import psutil  # comes with distributed

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    quiet = ["--no-dashboard", "--dashboard-address", "127.0.0.1:0"]
    port = address.rpartition(":")[2]
    programs = [
        ["distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", port, *quiet],
        ["distributed.cli.dask_worker", address, "--nthreads", str(waiting // AHEAD), "--no-nanny", *quiet],
    ]
    running = [
        subprocess.Popen([sys.executable, "-m", *words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        for words in programs
    ]
    try:
        most = 0
        for _ in range(10):  # a busy machine starts them late
            try:
                with connected(Cluster(address)) as client:
                    payloads = [bytes(os.urandom(task_bytes)) for _ in range(2 * waiting)]
                    for _ in run_tasks(measured_size, payloads, 1, client):
                        most = max(most, psutil.Process(running[0].pid).memory_info().rss)
                return most / 1e6
            except ValueError:
                time.sleep(1)
        return float("nan")
    finally:
        for one in running:
            one.kill()
            one.wait()


def measured_size(payload: bytes) -> int:
    return len(payload)


def reconstructions(store: Location, case: str) -> list[list[str]]:
    seconds = list(Store(store).seconds(case).values())
    if not seconds:
        return []
    size = sum(len(stored_bytes(file, 10**10)) for file in Store(store).files("features", case)) / len(seconds)
    each = f"{sum(seconds) / len(seconds):.2f} s by the clock, {size / 1e6:.1f} MB"
    return [[case, "reconstruction", str(len(seconds)), each, ""]]


def timings(store: Location, case: str, name: str) -> list[dict[str, float]]:
    """What the chunks of a kind took."""
    folder = store / "timings" / case / name
    return [json.loads(stored_bytes(folder / file, 10**7)) for file in files_below(folder) if file.endswith(".json")]


def comparisons(store: Location, case: str) -> list[list[str]]:
    rows = []
    below = files_below(store / "timings" / case, deep=True)
    for name in sorted({file.partition("/")[0] for file in below if "/" in file}):
        facts = timings(store, case, name)
        if name == "extraction":
            seconds = [value for fact in facts for value in fact.values()]
            rows.append([case, "minutiae of a print", str(len(seconds)), f"{mean_ms(seconds):.0f} ms by the clock", ""])
        elif facts and "pairs" in facts[0]:
            pairs = sum(fact["pairs"] for fact in facts)
            each = sum(fact["processor_s"] for fact in facts) / pairs
            whole = f"{each * ALL_PAIRS / 2 / 3600:.2f} h"
            rows.append([case, name, f"{pairs:.0f}", f"{1000 * each:.1f} ms of one core", whole])
    return rows


def mean_ms(seconds: list[float]) -> float:
    return 1000 * sum(seconds) / max(len(seconds), 1)


if __name__ == "__main__":
    main()
