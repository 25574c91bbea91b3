"""The same capture gives the same bytes, whatever the number of threads."""

import hashlib
import os
import subprocess
import sys

import pytest

from small_capture import copy_of, edit

CODE = """
import sys
import cv2
cv2.setNumThreads(int(sys.argv[1]))
from splitknit.cli.main import main
for capture, preset, out in zip(sys.argv[2::3], sys.argv[3::3], sys.argv[4::3], strict=True):
    quick = ["--set", "metric.rounds=2", "--set", "metric.coarse_steps=2"]
    code = main(["reconstruct", capture, "--out", out, "--preset", preset, "--json", *quick])
    assert code == 0, code
"""


def digests(folder):
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.stem != "report")
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in files
    }


@pytest.mark.slow
def test_threads_do_not_change_a_byte(twin_folder, tmp_path):
    opaque = copy_of(twin_folder, tmp_path / "opaque")
    edit(opaque / "capture.json", lambda document: document.update(material="opaque"))
    runs = {}
    for threads in (1, 2):
        out = tmp_path / str(threads)
        cases = [(twin_folder, "metric"), (twin_folder, "snk"), (opaque, "metric")]
        arguments = [
            str(word)
            for k, (c, preset) in enumerate(cases)
            for word in (c, preset, out / f"{k}_{preset}")
        ]
        environment = {
            **os.environ,
            "OMP_NUM_THREADS": str(threads),
            "OPENBLAS_NUM_THREADS": str(threads),
        }
        command = [sys.executable, "-c", CODE, str(threads), *arguments]
        run = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        assert run.returncode == 0, run.stderr
        runs[threads] = digests(out)
    assert len(runs[1]) >= 3 * 7
    assert runs[1] == runs[2]
