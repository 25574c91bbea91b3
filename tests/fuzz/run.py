"""Every reader, on sound files that were changed at random: each input must give a result or one sentence.

    python -m tests.fuzz.run --inputs 100000 --jobs 2       # a number of inputs over all readers
    python -m tests.fuzz.run --hours 8                      # as many as there is time for
    python -m tests.fuzz.run --target image --only 4711     # one input again

An input follows from its target and number alone. It is read in a process of its own kind, one for a block of inputs.
Findings are: a crash; an exception other than ``BadInput`` (and anything beside one printable sentence); more than 3 s
of processor time, or no progress at all; more than 1 GB of memory above what was held before; anything written to
stdout or stderr; any file left behind. Their files are kept. The exit code is 1 if there is one.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import faulthandler
import importlib.util
import json
import math
import mmap
import os
import pickle
import resource
import shutil
import signal
import struct
import sys
import tempfile
import threading
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any

from tests.fuzz import targets
from tests.fuzz.mutators import Files, mutated
from tests.fuzz.targets import TARGETS, Target, put, said
from tqdm import tqdm

import splitknit
from splitknit.errors import BadInput

MAX_S, MAX_MB = 3.0, 1024
IDLE_S = 10.0
"""A process that has used no processor time for so long waits for something that never comes."""
BLOCK = 200
GUARD_MB = 2500
"""Address space beyond what a process begins with: nothing takes the whole machine."""
MIN_REFUSED = 100
"""A target that accepts none of so many inputs tests nothing behind its first check, which is a problem."""
READERS = ("read_", "decode_", "unpack_", "open_", "load_", "import_", "parse_")
NO_READERS = {
    "imaging.band.decode_table": "makes a table, reads nothing",
    "gallery.records.import_records": "writes what prints.from_file.read_print_file reads",
    "capture.pi.open_pi": "opens devices",
    "capture.streams.open_genicam": "opens a device",
    "capture.streams.open_uvc": "opens a device",
    "rig.devices.read_settings": "sorts settings that are read already",
    "prints.rolled.read_rolled": "reconstructs what io.capture.read_capture reads",
    "training.networks.load_torch": "imports a package",
    "simulator.light.skin.load_walks": "reads a table of the package",
}
"""Functions named as readers that need no target, and why."""


@dataclass
class Tally:
    """What became of a target's inputs."""

    accepted: int = 0
    refused: int = 0
    slowest_s: float = 0.0
    slowest: int = -1
    peak_mb: float = 0.0
    largest: int = -1
    findings: list[dict[str, Any]] = field(default_factory=list)


@dataclass
class Block:
    """A child process at work on inputs `begin` to `end` of a target."""

    target: Target
    begin: int
    end: int
    pid: int
    shared: mmap.mmap
    output: int
    """Descriptor of what the child says on stdout and stderr."""
    found: int
    """Descriptor of the findings, one JSON object a line."""
    number: int = -1
    cpu_s: float = 0.0
    started_cpu_s: float = 0.0
    moved_at: float = 0.0


_STATE = struct.Struct("<qqqdqdq")
"""Number at work, accepted, refused, slowest (s, number), peak memory (MB, number)."""


def files_of(target: Target, number: int, samples: list[Files]) -> Files:
    """Return the input `number` of a target."""
    random = Random(f"{target.name}:{number}")
    return mutated(random.choice(samples), samples, random, target.repair)


# --- in the child ------------------------------------------------------------------------------------------------


def _memory_mb(key: bytes) -> float:
    with open("/proc/self/status", "rb") as stream:  # noqa: PTH123 - of every input: Path costs more than the read
        return int(next(line for line in stream if line.startswith(key)).split()[1]) / 1024


def _listed(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*")}


def _judge(target: Target, files: Files, folder: Path, output: int) -> tuple[str, str]:
    """Return ``accepted``, ``refused`` or the kind of finding, and words for it."""
    folder.mkdir()
    put(folder, files)
    before = _listed(folder)
    try:
        target.read(folder, files)
        verdict = "accepted", ""
    except BadInput as error:
        verdict = "refused", ""
        with contextlib.suppress(BadInput):
            try:
                said(error)
            except AssertionError as wrong:
                verdict = "sentence", str(wrong)[:500]
    except BaseException as error:
        last = [one for one in traceback.extract_tb(error.__traceback__) if "splitknit" in one.filename]
        where = f"{Path(last[-1].filename).name}:{last[-1].lineno}" if last else "?"
        verdict = f"{type(error).__name__} at {where}", "".join(traceback.format_exception(error)[-6:])[-2500:]
    said_aloud = os.pread(output, 4000, 0)
    if said_aloud and verdict[0] in ("accepted", "refused"):
        text = said_aloud.decode("utf-8", "replace")
        verdict = f"output: {text.splitlines()[0][-90:]}", text
    os.ftruncate(output, 0)
    os.lseek(output, 0, os.SEEK_SET)
    beside = sorted(_listed(folder) ^ before)
    if beside and verdict[0] in ("accepted", "refused"):
        verdict = "files", f"left behind or removed: {', '.join(beside)[:500]}"
    shutil.rmtree(folder)
    return verdict


def _work(block: Block, samples: list[Files], scratch: Path) -> None:
    """Read the block's inputs; write the state and the findings as they come."""
    os.dup2(block.output, 1)
    os.dup2(block.output, 2)
    sys.stdout, sys.stderr = os.fdopen(1, "w", buffering=1), os.fdopen(2, "w", buffering=1)
    faulthandler.enable(sys.stderr)
    warnings.simplefilter("always")
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    targets.SCRATCH.append(scratch)
    with contextlib.suppress(BadInput):  # imports and caches belong to the base
        _judge(block.target, samples[0], scratch / "first", block.output)
    limit = int(_memory_mb(b"VmSize:") + GUARD_MB) << 20
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    accepted = refused = 0
    slowest, peak = (0.0, -1), (0.0, -1)
    base = _memory_mb(b"VmRSS:")
    for number in range(block.begin, block.end):
        files = files_of(block.target, number, samples)
        _reset_peak()
        held = max(base, _memory_mb(b"VmRSS:"))
        block.shared[: _STATE.size] = _STATE.pack(number, accepted, refused, *slowest, *peak)
        began = _processor_s()
        kind, words = _judge(block.target, files, scratch / str(number), block.output)
        used = _processor_s() - began
        taken = _memory_mb(b"VmHWM:") - held
        slowest, peak = max(slowest, (used, number)), max(peak, (taken, number))
        if kind in ("accepted", "refused"):
            if used > MAX_S:
                kind, words = "slow", f"{used:.1f} s of processor time"
            elif taken > MAX_MB:
                kind, words = "memory", f"{taken:.0f} MB"
        accepted += kind == "accepted"
        refused += kind == "refused"
        if kind not in ("accepted", "refused"):
            os.write(block.found, (json.dumps({"number": number, "kind": kind, "words": words}) + "\n").encode())
    block.shared[: _STATE.size] = _STATE.pack(block.end, accepted, refused, *slowest, *peak)


def _processor_s() -> float:
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def _reset_peak() -> None:
    with open("/proc/self/clear_refs", "w") as stream:  # noqa: PTH123
        stream.write("5")


# --- sound samples, and whether they reach every reader -----------------------------------------------------------


def public_readers() -> dict[tuple[str, str], str]:
    """File and name of every public function of the package that is named as a reader, and its dotted name."""
    root = Path(splitknit.__file__).parent
    found = {}
    for file in root.rglob("*.py"):
        module = ".".join(file.relative_to(root).with_suffix("").parts)
        for node in ast.parse(file.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.FunctionDef) and node.name.startswith(READERS):
                found[str(file), node.name] = f"{module}.{node.name}"
    return found


def _look(scratch: Path, out: Path, chosen: list[Target]) -> None:
    """Make the sound samples, read them, and note which readers were called; in a process of its own."""
    called: set[tuple[str, str]] = set()

    def note(frame: Any, event: str, _: Any) -> None:
        if event == "call":
            called.add((frame.f_code.co_filename, frame.f_code.co_name))

    problems, samples = [], {}
    targets.SCRATCH.append(scratch)
    for target in chosen:
        samples[target.name] = list(target.samples())
        threading.setprofile(note)
        sys.setprofile(note)
        for k, sample in enumerate(samples[target.name]):
            folder = scratch / f"{target.name}-{k}"
            folder.mkdir()
            put(folder, sample)
            try:
                target.read(folder, sample)
            except Exception as error:
                problems.append(f"{target.name}: its sound sample {k} is not accepted: {error!r}")
        sys.setprofile(None)
        threading.setprofile(None)  # type: ignore[arg-type]
    readers = public_readers()
    if len(chosen) == len(TARGETS):
        missing = sorted(name for place, name in readers.items() if place not in called and name not in NO_READERS)
        problems += [f"no target reads a sound sample by splitknit.{name}" for name in missing]
        problems += [
            f"NO_READERS names splitknit.{name}, which is not there" for name in set(NO_READERS) - set(readers.values())
        ]
    out.write_bytes(pickle.dumps((samples, problems)))


def look(scratch: Path, chosen: list[Target]) -> tuple[dict[str, list[Files]], list[str]]:
    """Return the sound samples by target, and what is wrong with them or with the list of targets."""
    out = scratch / "samples"
    pid = os.fork()
    if pid == 0:
        code = 1
        try:
            _look(scratch, out, chosen)
            code = 0
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(code)
    _, status = os.waitpid(pid, 0)
    if status != 0:
        raise SystemExit("the sound samples cannot be made")
    return pickle.loads(out.read_bytes())


# --- the parent --------------------------------------------------------------------------------------------------


class Runner:
    """Blocks of inputs in child processes, watched."""

    def __init__(self, samples: dict[str, list[Files]], scratch: Path, keep: Path, bar: Any) -> None:
        """`keep` is where the files of findings go."""
        self.samples, self.scratch, self.keep, self.bar = samples, scratch, keep, bar
        self.tallies = {name: Tally() for name in samples}
        self.kinds: Counter[tuple[str, str]] = Counter()

    def begin(self, target: Target, begin: int, end: int) -> Block:
        """Start a child."""
        block = Block(target, begin, end, 0, mmap.mmap(-1, 4096), os.memfd_create("output"), os.memfd_create("found"))
        block.shared[: _STATE.size] = _STATE.pack(begin - 1, 0, 0, 0.0, -1, 0.0, -1)
        scratch = Path(tempfile.mkdtemp(dir=self.scratch))
        block.moved_at = time.monotonic()
        block.pid = os.fork()
        if block.pid == 0:
            code = 1
            try:
                _work(block, self.samples[target.name], scratch)
                code = 0
            except BaseException:
                os.write(block.output, traceback.format_exc().encode())
            finally:
                os._exit(code)
        return block

    def done(self, block: Block) -> tuple[int, int] | None:
        """Look after a block: None while it is at work, else which inputs are left to do."""
        pid, status = os.waitpid(block.pid, os.WNOHANG)
        why = None
        if pid == 0:
            why = self._hangs(block)
            if why is None:
                return None
            os.kill(block.pid, signal.SIGKILL)
            os.waitpid(block.pid, 0)
        number, accepted, refused, slow_s, slow, peak_mb, peak = _STATE.unpack(block.shared[: _STATE.size])
        number = max(number, block.begin)  # it may have ended before its first input
        tally = self.tallies[block.target.name]
        tally.accepted += accepted
        tally.refused += refused
        if slow_s > tally.slowest_s:
            tally.slowest_s, tally.slowest = slow_s, slow
        if peak_mb > tally.peak_mb:
            tally.peak_mb, tally.largest = peak_mb, peak
        for line in os.pread(block.found, 1 << 24, 0).decode().splitlines():
            one = json.loads(line)
            self.finding(block.target, one["number"], one["kind"], one["words"])
        if why is None and status != 0:
            sign = os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0
            why = f"crash: {signal.Signals(sign).name}" if sign else "crash: exit"
        if why is not None:
            self.finding(block.target, number, why, os.pread(block.output, 4000, 0).decode("utf-8", "replace"))
        os.close(block.output)
        os.close(block.found)
        block.shared.close()
        finished = number + 1 if why is not None else block.end
        self.bar.update(max(0, finished - block.begin))
        return finished, block.end

    def _hangs(self, block: Block) -> str | None:
        (number, *_) = _STATE.unpack(block.shared[: _STATE.size])
        used, now = _used_s(block.pid), time.monotonic()
        if number != block.number:
            block.number, block.started_cpu_s, block.moved_at = number, used, now
        if used > block.cpu_s + 0.01:
            block.cpu_s, block.moved_at = used, now
        if used - block.started_cpu_s > 3 * MAX_S:
            return "hang: at work without end"
        return "hang: waits without end" if now - block.moved_at > IDLE_S else None

    def finding(self, target: Target, number: int, kind: str, words: str) -> None:
        """Keep the first three of a kind."""
        self.kinds[target.name, kind] += 1
        tally = self.tallies[target.name]
        if self.kinds[target.name, kind] <= 3:
            folder = self.keep / f"{target.name}-{number}"
            if not folder.exists():
                folder.mkdir(parents=True)
                put(folder, files_of(target, number, self.samples[target.name]))
        tally.findings.append({"number": number, "kind": kind, "words": words})

    def run(self, tasks: Iterator[tuple[Target, int, int]], jobs: int) -> None:
        """Do all tasks."""
        running: list[Block] = []
        left: list[tuple[Target, int, int]] = []
        try:
            while True:
                while len(running) < jobs and (task := left.pop() if left else next(tasks, None)) is not None:
                    running.append(self.begin(*task))
                if not running:
                    return
                time.sleep(0.01)
                for block in list(running):
                    rest = self.done(block)
                    if rest is not None:
                        running.remove(block)
                        if rest[0] < rest[1]:
                            left.append((block.target, *rest))
        finally:
            for block in running:
                with contextlib.suppress(ProcessLookupError, ChildProcessError):
                    os.kill(block.pid, signal.SIGKILL)
                    os.waitpid(block.pid, 0)


def _used_s(pid: int) -> float:
    with contextlib.suppress(OSError, IndexError, ValueError):
        values = Path(f"/proc/{pid}/stat").read_bytes().rsplit(b")", 1)[1].split()
        return sum(map(int, values[11:15])) / os.sysconf("SC_CLK_TCK")
    return 0.0


def _tasks(chosen: list[Target], each: int, until: float | None) -> Iterator[tuple[Target, int, int]]:
    """Blocks of all targets by turns, so that a run that is stopped has seen all of them."""
    begin = 0
    while (until is None and begin < each) or (until is not None and time.monotonic() < until):
        for target in chosen:
            if until is None or time.monotonic() < until:
                yield target, begin, begin + BLOCK if until is not None else min(each, begin + BLOCK)
        begin += BLOCK


def main(arguments: list[str] | None = None) -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.run", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--inputs", type=int, default=4000, help="over all targets together (default 4000)")
    parser.add_argument("--hours", type=float, default=None, help="as many as there is time for")
    parser.add_argument("--jobs", type=int, default=2, help="processes at a time (default 2)")
    parser.add_argument("--target", action="append", choices=[one.name for one in TARGETS], help="only these")
    parser.add_argument("--only", type=int, default=None, metavar="N", help="only the input of this number")
    parser.add_argument("--keep", type=Path, default=Path("fuzz-findings"), help="folder for the files of findings")
    parser.add_argument("--json", type=Path, default=None, metavar="FILE", help="write the summary there, too")
    options = parser.parse_args(arguments)
    chosen = [one for one in TARGETS if options.target is None or one.name in options.target]
    each = math.ceil(options.inputs / len(chosen))
    until = None if options.hours is None else time.monotonic() + 3600 * options.hours
    began = time.monotonic()
    for module in ("pyarrow.parquet", "tifffile", "nistitl", "nbis", "cryptography.x509"):
        with contextlib.suppress(ImportError):  # once, here, and not in every child
            importlib.import_module(module)
    with tempfile.TemporaryDirectory(prefix="splitknit-fuzz-") as scratch:
        samples, problems = look(Path(scratch), chosen)
        tasks = _tasks(chosen, each, until)
        if options.only is not None:
            tasks = iter([(one, options.only, options.only + 1) for one in chosen])
        total = None if until is not None else each * len(chosen)
        with tqdm(total=total, unit="input", disable=not sys.stderr.isatty()) as bar:
            runner = Runner(samples, Path(scratch), options.keep, bar)
            runner.run(tasks, options.jobs)
    summary = _summary(runner, problems, time.monotonic() - began)
    if options.json is not None:
        options.json.write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    return _told(runner, summary, options.keep)


def _summary(runner: Runner, problems: list[str], seconds: float) -> dict[str, Any]:
    rows = {name: vars(tally) for name, tally in runner.tallies.items()}
    problems = problems + [
        f"{name}: none of {row['refused']} inputs was accepted: all fail at its first check; give it other samples"
        for name, row in rows.items()
        if row["accepted"] == 0 and row["refused"] >= MIN_REFUSED
    ]
    inputs = sum(row["accepted"] + row["refused"] + len(row["findings"]) for row in rows.values())
    return {
        "inputs": inputs,
        "accepted": sum(row["accepted"] for row in rows.values()),
        "refused": sum(row["refused"] for row in rows.values()),
        "findings": sum(len(row["findings"]) for row in rows.values()),
        "slowest_s": round(max(row["slowest_s"] for row in rows.values()), 2),
        "peak_mb": round(max(row["peak_mb"] for row in rows.values())),
        "seconds": round(seconds),
        "problems": problems,
        "targets": rows,
    }


def _told(runner: Runner, summary: dict[str, Any], keep: Path) -> int:
    print(f"{'target':<18}{'accepted':>9}{'refused':>9}{'findings':>9}{'slowest':>10}{'memory':>9}")
    for name, row in summary["targets"].items():
        slowest, peak = f"{row['slowest_s']:.2f} s", f"{row['peak_mb']:.0f} MB"
        print(f"{name:<18}{row['accepted']:>9}{row['refused']:>9}{len(row['findings']):>9}{slowest:>10}{peak:>9}")
    print(
        f"{summary['inputs']} inputs, {summary['findings']} findings, slowest {summary['slowest_s']} s, "
        f"most memory above the base {summary['peak_mb']} MB, in {summary['seconds']} s"
    )
    for (name, kind), count in sorted(runner.kinds.items()):
        one = next(found for found in runner.tallies[name].findings if found["kind"] == kind)
        print(f"\n{count} x {name}: {kind}\n    {keep}/{name}-{one['number']}")
        print(f"    python -m tests.fuzz.run --target {name} --only {one['number']}")
        print("    " + one["words"].strip()[-1500:].replace("\n", "\n    "))
    for problem in summary["problems"]:
        print(problem)
    return 1 if summary["findings"] or summary["problems"] else 0


if __name__ == "__main__":
    sys.exit(main())
