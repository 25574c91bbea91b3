"""Run every benchmark, one after the other, and print one Markdown document.

    python benchmarks/run_all.py [--quick] > benchmarks/out/tables.md
    python benchmarks/run_all.py --page [--only bench_match.py ...]

``--page`` writes what the scripts print between their markers in docs/experiments/performance.md instead: one run on a
quiet machine (load below 1.5, else it warns) remakes the page's tables.
"""

from __future__ import annotations

import argparse
import os
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
    "bench_clouds.py": ([], ["--points", "1e5"]),
    "bench_live.py": (["--seconds", "15"], ["--seconds", "3"]),
    "bench_evaluate.py": (["--rounds", "9"], ["--rounds", "2", "--replicates", "20"]),
    "bench_capture.py": (["--rounds", "2"], ["--rounds", "1", "--scales", "0.5"]),
    "bench_mirror_shape.py": (["--rounds", "5"], ["--rounds", "1"]),
    "bench_motion.py": (["--rounds", "3"], ["--rounds", "1", "--scale", "0.4"]),
    "bench_reconstruct.py": (["--rounds", "5"], ["--rounds", "1", "--scales", "0.5"]),
}
"""Arguments of each script: in full, and with ``--quick``."""
PAGE = HERE.parent / "docs" / "experiments" / "performance.md"
QUIET = 1.5
JSON = ("bench_mirror_shape.py",)
"""These print one JSON object, which the document shows as it is."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="few rounds, half scale: does everything run?")
    parser.add_argument("--page", action="store_true", help="write the tables into docs/experiments/performance.md")
    parser.add_argument("--only", nargs="+", choices=sorted(SUITES), default=list(SUITES), metavar="SCRIPT")
    options = parser.parse_args()
    if options.page:
        return page(options.only, options.quick)
    packages = ", ".join(
        f"{name} {version(name)}" for name in ("splitknit", "numpy", "scipy", "opencv-python-headless")
    )
    print(f"# Benchmarks\n\nPython {platform.python_version()}, {packages}, {platform.machine()}", flush=True)
    failed = 0
    for script in options.only:
        print(f"\n## {script}\n", flush=True)
        fence = script in JSON
        if fence:
            print("```json", flush=True)
        failed |= subprocess.run(command(script, options.quick), check=False).returncode
        if fence:
            print("```", flush=True)
    return int(failed != 0)


def command(script: str, quick: bool) -> list[str]:
    return [sys.executable, str(HERE / script), *SUITES[script][quick]]


def page(scripts: list[str], quick: bool) -> int:
    """Replace what the page holds between the markers of each script; scripts without markers are left out."""
    failed = []
    for script in scripts:
        if f"<!-- {script} -->" not in PAGE.read_text(encoding="utf-8"):
            continue
        load = os.getloadavg()[0]
        if load > QUIET:
            print(f"{script}: the load is {load:.1f}; figures for the page need a quiet machine.", file=sys.stderr)
        run = subprocess.run(command(script, quick), check=False, stdout=subprocess.PIPE, text=True)
        if run.returncode:
            failed.append(script)
            continue
        PAGE.write_text(replaced(PAGE.read_text(encoding="utf-8"), script, run.stdout), encoding="utf-8")
    if failed:
        print(f"The page keeps what it had of {', '.join(failed)}, which failed.", file=sys.stderr)
    return int(bool(failed))


def replaced(text: str, script: str, tables: str) -> str:
    """`text` with `tables` between the markers of `script`."""
    before, start, rest = text.partition(f"<!-- {script} -->\n")
    _, end, after = rest.partition(f"<!-- /{script} -->")
    if not (start and end):
        raise SystemExit(f"{PAGE.name} holds no pair of markers of {script}.")
    return f"{before}{start}{tables.strip()}\n{end}{after}"


if __name__ == "__main__":
    sys.exit(main())
