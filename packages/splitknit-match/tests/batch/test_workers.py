import subprocess
import sys

from splitknit.io import paging

JOBS = """
import os, signal, time
from pathlib import Path
from splitknit import workers
from splitknit.io.atomic import atomic_folder

workers._GRACE_S = 60.0  # however slow this machine is

def work(job):
    with atomic_folder(f"out/{job}") as folder:
        (folder / "half").touch()
        while job == 0 and len(list(Path("out").glob(".splitknit-*.tmp/new/half"))) < 2:
            time.sleep(0.01)
        if job == 0:
            os.killpg(0, signal.SIGINT)  # as Ctrl-C does: to the workers as well
        time.sleep(10)
    return job

if __name__ == "__main__":
    Path("out").mkdir()
    try:
        list(workers.run_jobs(work, range(3), 2, "nothing"))
    except KeyboardInterrupt:
        print("interrupted")
"""


def test_ctrl_c_ends_the_run_and_the_jobs_of_its_workers(tmp_path):
    (tmp_path / "jobs.py").write_text(JOBS)
    run = subprocess.run(
        [sys.executable, "jobs.py"],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
        start_new_session=True,
    )
    assert (run.returncode, run.stdout, run.stderr) == (0, "interrupted\n", "")
    # no job went on to its end, and none left half of its folder
    assert not list((tmp_path / "out").iterdir())


def test_threads_of_a_worker_share_one_heap(monkeypatch):
    calls = []

    class Glibc:
        def __init__(self, name):
            pass

        def mallopt(self, parameter, value):
            calls.append((parameter, value))
            return 1

    monkeypatch.setattr(paging.ctypes, "CDLL", Glibc)
    monkeypatch.setattr(paging.os, "confstr", lambda name: "glibc 2.36", raising=False)
    paging.one_heap()
    assert calls == [(-8, 1), (-4, 0), (-1, 512 << 20)]
    monkeypatch.setattr(paging.os, "confstr", lambda name: None, raising=False)
    paging.one_heap()
    assert len(calls) == 3
