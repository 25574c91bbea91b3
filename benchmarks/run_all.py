"""Run every benchmark, one after the other, and print one Markdown document.

python benchmarks/run_all.py [--quick] > benchmarks/out/tables.md
"""

from __future__ import annotations

import argparse
import platform
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

HERE = Path(__file__).resolve().parent
SUITES = {
    "bench_normals.py": (["--rounds", "9"], ["--rounds", "2"]),
    "bench_skin_layers.py": (["--rounds", "5"], ["--rounds", "1", "--pixels", "20"]),
    "bench_integrate.py": (["--rounds", "9"], ["--rounds", "2"]),
    "bench_separate.py": (["--rounds", "5"], ["--rounds", "1"]),
    "bench_prints.py": (["--rounds", "5"], ["--rounds", "1", "--scale", "0.3", "--count", "2"]),
    "bench_match.py": (["--rounds", "5"], ["--rounds", "1"]),
    "bench_search.py": (["--rounds", "5"], ["--rounds", "1", "--fingers", "2000", "--people", "3"]),
    "bench_gallery.py": ([], ["--fingers", "2000"]),
    "bench_batch.py": ([], ["--scale", "0.1", "--fingers", "1"]),
    "bench_viewer.py": (["--rounds", "5"], ["--rounds", "1", "--scale", "0.3"]),
    "bench_evaluate.py": (["--rounds", "9"], ["--rounds", "2", "--replicates", "20"]),
    "bench_capture.py": (["--rounds", "2"], ["--rounds", "1", "--scales", "0.5"]),
    "bench_mirror_shape.py": (["--rounds", "5"], ["--rounds", "1"]),
    "bench_motion.py": (["--rounds", "3"], ["--rounds", "1", "--scale", "0.4"]),
    "bench_reconstruct.py": (["--rounds", "5"], ["--rounds", "1", "--scales", "0.5"]),
}
"""Arguments of each script: in full, and with ``--quick``."""
JSON = ("bench_mirror_shape.py",)
"""These print one JSON object, which the document shows as it is."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="few rounds, half scale: does everything run?")
    quick = parser.parse_args().quick
    packages = ", ".join(
        f"{name} {version(name)}" for name in ("splitknit", "numpy", "scipy", "opencv-python-headless")
    )
    print(f"# Benchmarks\n\nPython {platform.python_version()}, {packages}, {platform.machine()}", flush=True)
    failed = 0
    for script, arguments in SUITES.items():
        print(f"\n## {script}\n", flush=True)
        fence = script in JSON
        if fence:
            print("```json", flush=True)
        failed |= subprocess.run([sys.executable, str(HERE / script), *arguments[quick]], check=False).returncode
        if fence:
            print("```", flush=True)
    return int(failed != 0)


if __name__ == "__main__":
    sys.exit(main())
