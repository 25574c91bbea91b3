from __future__ import annotations

import subprocess
import sys
from pathlib import Path

JOBS = """
import os, signal
from pathlib import Path
from splitknit.batch.workers import run_jobs

def work(job):
    if job == 0:
        os.killpg(0, signal.SIGINT)  # as Ctrl-C does: to the workers as well
    Path(f"done_{job}").touch()
    return job

if __name__ == "__main__":
    try:
        list(run_jobs(work, range(3), 2, "nothing"))
    except KeyboardInterrupt:
        print("interrupted")
"""


def test_ctrl_c_is_for_the_run_and_not_for_its_workers(tmp_path: Path) -> None:
    (tmp_path / "jobs.py").write_text(JOBS)
    run = subprocess.run(
        [sys.executable, "jobs.py"], capture_output=True, text=True, check=False, cwd=tmp_path, start_new_session=True
    )
    assert (run.returncode, run.stdout, run.stderr) == (0, "interrupted\n", "")
    assert (tmp_path / "done_0").exists()
