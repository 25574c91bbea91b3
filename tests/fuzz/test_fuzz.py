"""A few changed inputs of every reader, and a few kills; `python -m tests.fuzz.run` goes on as long as one likes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def run(*words: str) -> str:
    command = [sys.executable, "-m", *words]
    done = subprocess.run(command, cwd=ROOT, env=os.environ, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stderr == ""
    return done.stdout


@pytest.mark.slow
def test_every_reader_gives_a_result_or_one_sentence(tmp_path: Path) -> None:
    assert " 0 findings" in run("tests.fuzz.run", "--inputs", "820", "--keep", str(tmp_path / "findings"))


@pytest.mark.slow
def test_kills_lose_and_double_nothing() -> None:
    assert "batch: 3 kills" in run("tests.fuzz.kills", "--kills", "3")
