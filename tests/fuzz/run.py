"""Every reader, on sound files that were changed: each input must give a result or one sentence.

    python -m tests.fuzz.run --inputs 100000 --jobs 2       # a number of inputs over all readers
    python -m tests.fuzz.run --hours 8                      # as many as there is time for
    python -m tests.fuzz.run --target image --seed 4711     # one block of inputs again

Hypothesis draws the changes (:mod:`tests.fuzz.mutators`) and makes what fails as small as it can. A
block of inputs follows from its target and seed alone, and is read in a process of its own.
Findings are: a crash; an exception other than ``BadInput`` (and anything beside one printable
sentence); more than 3 s of processor time, or no end at all; more than 1 GB of memory above what
was held before; anything written to stdout or stderr; any file left behind. Their files are kept.
The exit code is 1 if there is one.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import faulthandler
import importlib
import json
import math
import os
import pickle
import resource
import shutil
import signal
import sys
import tempfile
import threading
import time
import traceback
import warnings
from collections import Counter
from pathlib import Path

from hypothesis import HealthCheck, Phase, Verbosity, given, seed, settings
from tests.fuzz import PACKAGES
from tests.fuzz.mutators import inputs
from tests.fuzz.targets import TARGETS, Target, check_refusal, put

from splitknit.errors import BadInput

MAX_S, MAX_MB = 3.0, 1024
WAIT_S = 120
"""After so long an input waits for something that never comes."""
BLOCK = 200
RECURSION = sys.getrecursionlimit()
GUARD_MB = 2500
"""Address space beyond what a process begins with: nothing takes the whole machine."""
MIN_REFUSED, MORE = 100, 400
"""A target that accepts none of so many inputs may test nothing behind its first check. It gets
more, and none accepted of those is a problem: some readers accept one changed input in thirty, so
that a hundred refused are chance.
"""
MORE_SEED = 1_000_000
READERS = ("read_", "decode_", "unpack_", "open_", "load_", "import_", "parse_")
NO_READERS = {
    "acceptance.photographs.read_photographs": (
        "reads what io.capture.read_capture and the target `radiometry` read"
    ),
    "observation.stored.decode_table": "makes a table, reads nothing",
    "importing.import_files": (
        "reads what observation.plain.capture_from_photographs and prints.from_file.read_print_file read"
    ),
    "light.skin.load_walks": "reads a table of the package",
    "prints.verbs.import_prints": "reads what prints.from_file.read_print_file reads",
}
"""Functions named as readers that need no target, and why."""
Task = tuple[Target, int, int]
"""Target, seed, number of inputs."""


# --- in the child
# ------------------------------------------------------------------------------------------------


def _memory_mb(key):
    with open("/proc/self/status", "rb") as stream:  # noqa: PTH123 - read for every input
        return int(next(line for line in stream if line.startswith(key)).split()[1]) / 1024


def _processor_s():
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def _listed(folder):
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*")}


def judge(target, files, folder, output):
    """Read one input; return ``accepted`` or ``refused``, or fail. What failed stays in
    `folder`."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    put(folder, files)
    before, held, began = _listed(folder), _memory_mb(b"VmRSS:"), _processor_s()
    os.ftruncate(output, 0)
    os.lseek(output, 0, os.SEEK_SET)
    Path("/proc/self/clear_refs").write_text("5")  # the peak of memory is counted anew
    # either signal ends the process, whatever it is doing
    signal.setitimer(signal.ITIMER_PROF, 3 * MAX_S)
    signal.alarm(WAIT_S)
    deep = sys.getrecursionlimit()
    sys.setrecursionlimit(RECURSION)  # Hypothesis allows more than the command line has
    try:
        target.read(folder, files)
        verdict = "accepted"
    except BadInput as error:
        check_refusal(error)
        verdict = "refused"
    finally:
        sys.setrecursionlimit(deep)
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.alarm(0)
    used, taken = _processor_s() - began, _memory_mb(b"VmHWM:") - held
    assert used < MAX_S, f"it takes {used:.1f} s of processor time"
    assert taken < MAX_MB, f"it takes {taken:.0f} MB of memory"
    aloud = os.pread(output, 4000, 0).decode("utf-8", "replace")
    assert not aloud, f"it writes to stdout or stderr: {aloud}"
    assert _listed(folder) == before, (
        f"left behind or removed: {', '.join(sorted(_listed(folder) ^ before))[:500]}"
    )
    return verdict


def _work(task, samples, scratch, output):
    """Read the block's inputs; return how many were accepted and refused."""
    target, number, count = task
    os.dup2(output, 1)
    os.dup2(output, 2)
    sys.stdout, sys.stderr = os.fdopen(1, "w", buffering=1), os.fdopen(2, "w", buffering=1)
    faulthandler.enable(sys.stderr)
    warnings.simplefilter("always")
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    judge(target, samples[0], scratch / "input", output)  # imports and caches belong to the base
    limit = int(_memory_mb(b"VmSize:") + GUARD_MB) << 20
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    tally: Counter[str] = Counter()

    @seed(number)
    @settings(
        max_examples=count,
        database=None,
        deadline=None,
        report_multiple_bugs=False,
        verbosity=Verbosity.quiet,
        phases=(Phase.generate, Phase.shrink),
        suppress_health_check=list(HealthCheck),
    )
    @given(inputs(samples, target.repair))
    def each(files):
        tally[judge(target, files, scratch / "input", output)] += 1

    each()
    return tally


def in_child(work, out, output):
    """Do some work in a process of its own, which leaves its result, or what went wrong, in
    files."""
    pid = os.fork()
    if pid:
        return pid
    try:
        out.write_bytes(pickle.dumps(work()))
        os._exit(0)
    except BaseException:
        os.write(output, traceback.format_exc().encode())
    finally:
        os._exit(1)


# --- sound samples, and whether they reach every reader
# -----------------------------------------------------------


def public_readers():
    """File and name of every public function of the members that is named as a reader, and its
    dotted name."""
    functions = {}
    for file in PACKAGES.glob("*/src/*/**/*.py"):
        module = ".".join(file.relative_to(PACKAGES).with_suffix("").parts[3:])
        for node in ast.parse(file.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.FunctionDef) and node.name.startswith(READERS):
                functions[str(file), node.name] = f"{module}.{node.name}"
    return functions


def look(scratch, chosen):
    """Sound samples by target, and what is wrong with them or with the list of targets."""
    called: set[tuple[str, str]] = set()

    def note(frame, event, _):
        if event == "call":
            called.add((frame.f_code.co_filename, frame.f_code.co_name))

    problems, samples = [], {}
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
    if len(chosen) == len(TARGETS):
        readers = public_readers()
        missing = sorted(
            name
            for place, name in readers.items()
            if place not in called and name not in NO_READERS
        )
        problems += [f"no target reads a sound sample by {name}" for name in missing]
        gone = set(NO_READERS) - set(readers.values())
        problems += [f"NO_READERS names {name}, which is not there" for name in gone]
    return samples, problems


# --- the parent
# --------------------------------------------------------------------------------------------------


def _tasks(chosen, each, until, first):
    """Blocks of all targets by turns, so that a run that is stopped has seen all of them."""
    for number in range(first, 1 << 62):
        left = BLOCK if until is not None else min(BLOCK, each - (number - first) * BLOCK)
        if left <= 0 or (until is not None and time.monotonic() > until):
            return
        yield from ((target, number, left) for target in chosen)


def run(tasks, samples, scratch, keep, jobs):
    """Do all tasks; return what became of each target's inputs, and the findings."""
    tallies: dict[str, Counter[str]] = {name: Counter() for name in samples}
    findings: list[str] = []
    running: dict[int, tuple[Task, Path, int]] = {}
    while True:
        while len(running) < jobs and (task := next(tasks, None)) is not None:
            place, output = Path(tempfile.mkdtemp(dir=scratch)), os.memfd_create("output")
            work = lambda task=task, place=place, output=output: _work(  # noqa: E731
                task, samples[task[0].name], place, output
            )
            running[in_child(work, place / "tally", output)] = task, place, output
        if not running:
            return {"tallies": tallies, "findings": findings}
        pid, status = os.wait()
        (target, number, count), place, output = running.pop(pid)
        if status == 0:
            tallies[target.name] += pickle.loads((place / "tally").read_bytes())
        else:
            how = signal.Signals(os.WTERMSIG(status)).name if os.WIFSIGNALED(status) else "failed"
            words = (
                os.pread(output, 1 << 20, 0)
                .decode("utf-8", "replace")
                .strip()[-2500:]
                .replace("\n", "\n    ")
            )
            kept = keep / f"{target.name}-{number}"
            shutil.rmtree(kept, ignore_errors=True)
            shutil.copytree(place / "input", kept, symlinks=True, ignore=_no_files)
            again = (
                f"python -m tests.fuzz.run --target {target.name} --seed {number} --inputs {count}"
            )
            findings.append(f"{target.name}: {how}\n    {kept}\n    {again}\n    {words}")
        os.close(output)
        shutil.rmtree(place)


def _barren(tally):
    return tally["accepted"] == 0 and tally["refused"] >= MIN_REFUSED


def _no_files(folder, names):
    """Pipes cannot be copied, and what is enormous holds nothing."""
    paths = {name: Path(folder) / name for name in names}
    return [
        name
        for name, path in paths.items()
        if path.is_fifo() or (path.is_file() and path.stat().st_size > 1 << 28)
    ]


def main(arguments=None):
    """Run from the command line."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.fuzz.run", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument(
        "--inputs", type=int, default=4000, help="over all targets together (default 4000)"
    )
    parser.add_argument("--hours", type=float, default=None, help="as many as there is time for")
    parser.add_argument("--jobs", type=int, default=2, help="processes at a time (default 2)")
    parser.add_argument(
        "--target", action="append", choices=[target.name for target in TARGETS], help="only these"
    )
    parser.add_argument(
        "--seed", type=int, default=0, help="of the first block of inputs (default 0)"
    )
    parser.add_argument(
        "--keep", type=Path, default=Path("fuzz-findings"), help="folder for the files of findings"
    )
    parser.add_argument(
        "--json", type=Path, default=None, metavar="FILE", help="write the summary there, too"
    )
    options = parser.parse_args(arguments)
    chosen = [
        target for target in TARGETS if options.target is None or target.name in options.target
    ]
    until = None if options.hours is None else time.monotonic() + 3600 * options.hours
    for module in ("tifffile", "nbis"):
        with contextlib.suppress(ImportError):  # once, here, and not in every child
            importlib.import_module(module)
    # the same for what hypothesis loads when it is first used
    settings(max_examples=1, database=None)(
        given(inputs([{"x": b"1"}], None))(lambda files: None)
    )()
    with tempfile.TemporaryDirectory(prefix="splitknit-fuzz-") as name:
        scratch = Path(name)
        # threads of readers stay there
        pid = in_child(lambda: look(scratch, chosen), scratch / "samples", 2)
        if os.waitpid(pid, 0)[1] != 0:
            raise SystemExit("the sound samples cannot be made")
        samples, problems = pickle.loads((scratch / "samples").read_bytes())
        tasks = _tasks(chosen, math.ceil(options.inputs / len(chosen)), until, options.seed)
        results = run(tasks, samples, scratch, options.keep, options.jobs)
        barren = [target for target in chosen if _barren(results["tallies"][target.name])]
        more = run(
            _tasks(barren, MORE, None, options.seed + MORE_SEED),
            samples,
            scratch,
            options.keep,
            options.jobs,
        )
    results["findings"] += more["findings"]
    for target, tally in results["tallies"].items():
        tally.update(more["tallies"][target])
        print(f"{target:<18}{tally['accepted']:>9} accepted{tally['refused']:>9} refused")
        if _barren(tally):
            problems.append(
                f"{target}: none of {tally['refused']} inputs was accepted; give it other samples"
            )
    print("\n\n".join([*problems, *results["findings"]]))
    total = sum(tally.total() for tally in results["tallies"].values())
    print(f"{total} inputs, {len(results['findings'])} findings, {len(problems)} problems")
    if options.json is not None:
        options.json.write_text(
            json.dumps(results | {"problems": problems}, indent=1) + "\n", encoding="utf-8"
        )
    return 1 if results["findings"] or problems else 0


if __name__ == "__main__":
    sys.exit(main())
