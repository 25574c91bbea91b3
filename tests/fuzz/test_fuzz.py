"""A few changed inputs of every reader; `python -m tests.fuzz.run` goes on for as long as one likes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def test_every_reader_gives_a_result_or_one_sentence(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tests.fuzz.run", "--inputs", "1600", "--keep", str(tmp_path / "findings")]
    run = subprocess.run(command, cwd=ROOT, env=os.environ, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
    assert run.stderr == ""
