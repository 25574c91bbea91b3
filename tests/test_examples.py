"""Every example runs without arguments, quickly and without warnings."""

import hashlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("plot_*.py"))


@pytest.mark.slow
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs(example, tmp_path):
    done = subprocess.run(
        [sys.executable, "-W", "error", str(example)],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stderr == ""
    assert done.stdout.strip()
    assert list(tmp_path.iterdir()) == []  # an example cleans up after itself


def test_the_page_shows_the_examples_as_they_are():
    """`make examples` was run after the last change of any of them."""
    page = (ROOT / "docs" / "guide" / "examples.md").read_text(encoding="utf-8")
    digests = dict(re.findall(r"<!-- (plot_\w+\.py) ([0-9a-f]{64}) -->", page))
    assert digests == {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in EXAMPLES
    }
