"""A few changed inputs of every reader; `python -m tests.fuzz.run` goes on as long as one likes."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from tests.fuzz.kills import NOT_STOPPED, VERBS

from splitknit.registry import GROUP, registered

ROOT = Path(__file__).resolve().parents[2]
PLANTED = {
    "IndexError": lambda folder, data: data[3],
    "stdout or stderr": lambda folder, data: print(data[:1]) if len(data) < 4 else None,
    "left behind": lambda folder, data: (folder / "y").touch() if len(data) < 4 else None,
    "SIGABRT": lambda folder, data: os.abort() if len(data) < 4 else None,
}
"""What goes wrong with files of fewer than four bytes, by a word of the finding."""
HARNESS = """
import sys
from tests.fuzz import run
from tests.fuzz.targets import Target
from tests.fuzz.test_fuzz import PLANTED
def target(what):
    def read(folder, files):
        data = files.get("x")
        PLANTED[what](folder, data if isinstance(data, bytes) else b"whole")
    return Target(what.split()[0], lambda: [{"x": b"12345678"}], read)
run.TARGETS = tuple(map(target, PLANTED))
run.public_readers = dict
run.NO_READERS = {}
sys.exit(run.main(["--inputs", "800", "--keep", sys.argv[1]]))
"""


def run(*words):
    return subprocess.run(
        [sys.executable, *words],
        cwd=ROOT,
        env=os.environ,
        capture_output=True,
        text=True,
        check=False,
    )


def test_every_verb_that_writes_is_stopped_at_drawn_moments():
    verbs, words = set(registered(GROUP)), list(VERBS.values())
    stopped = {verb for verb in verbs if any(command.startswith(f"{verb} ") for command in words)}
    assert verbs - stopped == set(NOT_STOPPED)


@pytest.mark.slow
def test_every_reader_gives_a_result_or_one_sentence(tmp_path):
    done = run("-m", "tests.fuzz.run", "--inputs", "820", "--keep", str(tmp_path / "findings"))
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stderr == ""
    assert " 0 findings" in done.stdout


@pytest.mark.slow
def test_what_goes_wrong_is_found_made_small_and_kept(tmp_path):
    done = run("-c", HARNESS, str(tmp_path))
    assert done.returncode == 1, done.stdout + done.stderr
    assert f" {len(PLANTED)} findings" in done.stdout
    for what in PLANTED:
        assert what in done.stdout
        assert len((tmp_path / f"{what.split()[0]}-0" / "x").read_bytes()) < 4
