"""``kill -9`` at random moments while a gallery is written and while a batch runs: nothing is lost, nothing is doubled.

    python -m tests.fuzz.kills --kills 50

After every kill the gallery opens, is sound, and holds exactly what was committed, or that and the one change that was
under way; every finished chunk of the batch has the bytes of a run that nobody disturbed, and so has the whole store
once it is finished.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from random import Random

import numpy as np
from tests.batch.batch_stores import EA, chunks

from splitknit.batch.engine import run_batch
from splitknit.batch.simulate import simulate_population
from splitknit.errors import BadInput
from splitknit.gallery.entry import Entry, NewCapture
from splitknit.gallery.gallery import Gallery
from splitknit.gallery.key import Key
from splitknit.matching.template import Template, pack
from splitknit.simulator.population.sessions import PopulationSettings

KEYS = [Key(bytes([k] * 32), raw=True) for k in range(2)]
BATCH = replace(EA, matchers=("ridge",), chunk_captures=1)
Change = tuple[str, int]
"""``add`` or ``remove`` and a capture's number, or ``rekey`` and a key's."""


def killed(work: Callable[[], object], after_s: float) -> bool:
    """Do `work` in a process that is killed after some seconds; whether it was still at work."""
    pid = os.fork()
    if pid == 0:
        code = 1
        try:
            os.setsid()
            work()
            code = 0
        finally:
            os._exit(code)
    time.sleep(after_s)
    try:
        os.killpg(pid, signal.SIGKILL)
    except ProcessLookupError:  # it has not come to setsid yet
        os.kill(pid, signal.SIGKILL)
    _, status = os.waitpid(pid, 0)
    if os.WIFEXITED(status) and os.WEXITSTATUS(status) != 0:
        raise SystemExit("the work failed before it was killed")
    return os.WIFSIGNALED(status)


# --- gallery -----------------------------------------------------------------------------------------------------


def _capture(number: int) -> NewCapture:
    level = np.random.default_rng(number).integers(0, 4, (60, 50)).astype(np.uint8)
    entry = Entry(f"P{number}", "right_index", "1", "result", f"{number:064x}", area_mm2=30.0)
    return NewCapture(entry, pack(Template(level, np.ones((60, 50), bool), 0.1)), bytes(100), 1, bytes(5000))


def _write(path: Path, log: Path, held: set[int], key: int, seed: int) -> None:
    """Change the gallery until killed; say of every change that it begins, and that it is done."""
    random = Random(seed)
    descriptor = os.open(log, os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    following = max(held, default=0)
    while True:
        kind = random.choice(("add", "add", "remove", "rekey")) if held else "add"
        following += kind == "add"
        number = {"add": following, "remove": min(held, default=0), "rekey": 1 - key}[kind]
        os.write(descriptor, f"{kind} {number}\n".encode())
        with Gallery.open(path, KEYS[key]) as gallery:
            if kind == "add":
                gallery.add([_capture(number)])
            elif kind == "remove":
                gallery.remove([one.row for one in gallery.entries(person=f"P{number}")])
            else:
                gallery.rekey(KEYS[number])
        os.write(descriptor, b"done\n")
        held, key = _changed(held, key, (kind, number))


def _changed(held: set[int], key: int, change: Change) -> tuple[set[int], int]:
    kind, number = change
    if kind == "rekey":
        return held, number
    return (held | {number}) if kind == "add" else (held - {number}), key


def _logged(log: Path, held: set[int], key: int) -> tuple[set[int], int, Change | None]:
    """What was committed, and the change that was under way."""
    begun: Change | None = None
    for line in log.read_text().splitlines() if log.exists() else ():
        if line == "done":
            assert begun is not None
            held, key = _changed(held, key, begun)
            begun = None
        else:
            kind, number = line.split()
            begun = kind, int(number)
    return held, key, begun


def _look(path: Path, key: int) -> set[int]:
    """Numbers of the captures in the gallery, each of them sound and there once."""
    with Gallery.open(path, KEYS[key]) as gallery:
        assert gallery.problems() == []
        templates = gallery.templates()
        entries = gallery.entries()
    numbers = [int(one.entry.person[1:]) for one in entries]
    assert len(set(numbers)) == len(numbers), f"doubled: {sorted(numbers)}"
    for one, number in zip(entries, numbers, strict=True):
        assert templates[one.row] == _capture(number).template, f"another template of {number}"
    return set(numbers)


def kill_gallery(kills: int, folder: Path) -> tuple[int, int]:
    """Return the number of changes that were committed, and of kills in the middle of one that was not kept."""
    path = folder / "people.skg"
    held, key, committed, undone = {1, 2, 3}, 0, 0, 0
    with Gallery.create(path, "5e" * 32, KEYS[key]) as gallery:
        gallery.add([_capture(number) for number in held])
    random = Random(9)
    for number in range(kills):
        log = folder / f"log-{number}"
        state = set(held), key
        killed(lambda log=log, state=state, number=number: _write(path, log, *state, number), random.uniform(0.02, 0.4))
        held, key, begun = _logged(log, held, key)
        committed += log.read_text().count("done") if log.exists() else 0
        states = [(held, key)] + ([_changed(held, key, begun)] if begun is not None else [])
        for one in reversed(states):
            try:
                there = _look(path, one[1])
            except BadInput as error:
                if "key" in str(error) and len(states) == 2:  # the other key
                    continue
                raise
            if there == one[0]:
                undone += begun is not None and one == states[0]
                held, key = one
                break
        else:
            raise AssertionError(
                f"kill {number} during {begun}: {sorted(there)} instead of {[sorted(s) for s, _ in states]}"
            )
        left = [file.name for file in folder.iterdir() if ".tmp" in file.name]
        assert not left, f"left behind: {left}"
    return committed, undone


# --- batch -------------------------------------------------------------------------------------------------------


def kill_batch(kills: int, folder: Path, *, subjects: int = 2) -> tuple[int, int]:
    """Return the number of kills that hit a batch at work, and of stores that were finished and compared."""
    people = folder / "people"
    settings = PopulationSettings(seed=3, scale=0.08)
    simulate_population(people, settings, subjects=subjects, sessions=2, fingers=("right_index",), workers=1)
    began = time.monotonic()
    run_batch(people, folder / "sound", BATCH, jobs=1)
    whole_s = time.monotonic() - began
    sound = chunks(folder / "sound") | _tables(folder / "sound")
    random, out, hits, stores = Random(7), folder / "killed-0", 0, 0
    while hits < kills:
        hit = killed(lambda out=out: run_batch(people, out, BATCH, jobs=1), random.uniform(0.0, 0.6 * whole_s))
        hits += hit
        there = chunks(out) if out.is_dir() else {}
        assert there.items() <= sound.items(), "a chunk differs from that of the run that nobody disturbed"
        if not hit:
            stores += _finished(people, out, sound)
            out = folder / f"killed-{stores}"
    stores += _finished(people, out, sound)
    return hits, stores


def _tables(out: Path) -> dict[str, bytes]:
    return {path.relative_to(out).as_posix(): path.read_bytes() for path in (*out.glob("csv/*"), out / "store.json")}


def _finished(people: Path, out: Path, sound: dict[str, bytes]) -> int:
    run_batch(people, out, BATCH, jobs=1)
    assert chunks(out) | _tables(out) == sound, "the finished store differs from that of the run that nobody disturbed"
    # a kill between a folder's making and its marking leaves it empty, and nobody knows whose it is
    assert not [left for left in out.rglob("*.tmp") if any(left.iterdir())], "something half-written is left"
    return 1


def main() -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.kills", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--kills", type=int, default=50, help="of each (default 50)")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="splitknit-kills-") as scratch:
        committed, undone = kill_gallery(options.kills, Path(scratch))
        print(f"gallery: {options.kills} kills, {committed} changes committed and found, {undone} cut short and undone")
        hits, stores = kill_batch(options.kills, Path(scratch))
        print(f"batch: {hits} kills, {stores} stores finished to the same bytes")
    return 0


if __name__ == "__main__":
    sys.exit(main())
