"""Run every benchmark, one after the other, and print one Markdown document.

    python benchmarks/run_all.py [--quick] > benchmarks/out/tables.md
    python benchmarks/run_all.py --page [--only bench_match.py ...]

``--page`` stores what the scripts print in tables/bench_*.json instead, and writes the rows
``SHOWN`` of it into docs/experiments/performance.md: one run on a quiet machine (load below 1.5,
else it warns) remakes them.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import subprocess
import sys
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
SUITES = {
    "bench_normals.py": (["--rounds", "9"], ["--rounds", "2"]),
    "bench_integrate.py": (["--rounds", "9"], ["--rounds", "2"]),
    "bench_separate.py": (["--rounds", "5"], ["--rounds", "1"]),
    "bench_prints.py": (["--rounds", "5"], ["--rounds", "1", "--scale", "0.3", "--count", "2"]),
    "bench_match.py": (["--rounds", "5"], ["--rounds", "1"]),
    "bench_gallery.py": (["--captures", "10000"], ["--captures", "300", "--rounds", "1"]),
    "bench_evaluate.py": (["--rounds", "9"], ["--rounds", "2", "--replicates", "20"]),
    "bench_reconstruct.py": (["--rounds", "5"], ["--rounds", "1", "--scales", "0.5"]),
}
"""Arguments of each script: in full, and with ``--quick``."""
TABLES = HERE / "tables"
PAGE = HERE.parent / "docs" / "experiments" / "performance.md"
QUIET = 1.5
_FRAME = "3200 x 2200, 14 images and two ambient frames, 8-bit PNG"
_HALF = "1600 x 1100, 14 images and two ambient frames, 8-bit PNG"
_IMREAD = "OpenCV, imread of all images, one after the other"
_MINUTIAE = "Minutiae, prints of 533 x 342 at 500 ppi"
_PHALANGE = "A phalange of 1968 x 1233 pixels (75.7 px/mm)"
SHOWN = (
    (
        "`reconstruct` of 16 frames of 3200 x 2200, `metric`",
        "bench_reconstruct.py",
        _FRAME,
        "`metric`",
        _IMREAD,
    ),
    ("the same, `snk`", "bench_reconstruct.py", _FRAME, "`snk`", ""),
    ("16 frames of 1600 x 1100, `metric`", "bench_reconstruct.py", _HALF, "`metric`", _IMREAD),
    (
        "network for direct light, seven images of 1528 x 936",
        "bench_separate.py",
        "Seven images",
        "direct_light, colours, two threads",
        "",
    ),
    (
        "shadow-aware normals of the same images",
        "bench_normals.py",
        "Shadow-aware",
        "robust (shadow-aware)",
        "numpy: batched solve, shadow-aware",
    ),
    (
        "Poisson integration of 1528 x 936 normals, masked",
        "bench_integrate.py",
        "Masked",
        "poisson, masked",
        "pyamg: Ruge-Stueben with CG, double (rtol 1e-09)",
    ),
    (
        "integration by shapelets, the same normals",
        "bench_integrate.py",
        "Shapelets, n = 3",
        "shapelets",
        "numpy: scale by scale (Kovesi)",
    ),
    (
        "one comparison by `ridge`, templates ready",
        "bench_match.py",
        "Ridge templates",
        "comparison, both sides prepared",
        "",
    ),
    (
        "one comparison by the thesis's matcher",
        "bench_match.py",
        "The thesis's matcher, four channels of 1528 x 936",
        "lbp",
        "",
    ),
    (
        "minutiae of a print of 533 x 342",
        "bench_match.py",
        _MINUTIAE,
        "minutiae of a relief print",
        "nbis-py: minutiae of the same as PNG",
    ),
    (
        "unrolling a phalange of 1968 x 1233",
        "bench_prints.py",
        _PHALANGE,
        "unrolled print (free)",
        "",
    ),
    (
        "ROC of 1,020,000 scores",
        "bench_evaluate.py",
        "ROC, scores in double precision",
        "roc",
        "scikit-learn: roc_curve",
    ),
)
"""Rows of the page: what it calls them, script, how the table's title begins, the row there, and a
peer's row."""


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--quick", action="store_true", help="few rounds, half scale: does everything run?"
    )
    parser.add_argument(
        "--page",
        action="store_true",
        help="store the tables, and write docs/experiments/performance.md",
    )
    parser.add_argument(
        "--only", nargs="+", choices=sorted(SUITES), default=list(SUITES), metavar="SCRIPT"
    )
    options = parser.parse_args()
    if options.page:
        return page(options.only, options.quick)
    packages = ", ".join(
        f"{name} {version(name)}"
        for name in ("splitknit", "numpy", "scipy", "opencv-python-headless")
    )
    print(
        f"# Benchmarks\n\nPython {platform.python_version()}, {packages}, {platform.machine()}",
        flush=True,
    )
    failed = 0
    for script in options.only:
        print(f"\n## {script}\n", flush=True)
        failed |= subprocess.run(command(script, options.quick), check=False).returncode
    return int(failed != 0)


def command(script: str, quick: bool) -> list[str]:
    return [sys.executable, str(HERE / script), *SUITES[script][quick]]


def page(scripts: list[str], quick: bool) -> int:
    """Store what each script prints, and show some of it on the page; scripts without a stored file
    are left out."""
    failed = []
    for script in scripts:
        if not stored(script).is_file():
            continue
        load = os.getloadavg()[0]
        if load > QUIET:
            print(
                f"{script}: the load is {load:.1f}; figures for the page need a quiet machine.",
                file=sys.stderr,
            )
        run = subprocess.run(command(script, quick), check=False, stdout=subprocess.PIPE, text=True)
        if run.returncode:
            failed.append(script)
            continue
        stored(script).write_text(as_json(parsed(run.stdout)), encoding="utf-8")
    PAGE.write_text(replaced(PAGE.read_text(encoding="utf-8"), page_table()), encoding="utf-8")
    if failed:
        print(
            f"The tables keep what they had of {', '.join(failed)}, which failed.", file=sys.stderr
        )
    return int(bool(failed))


def stored(script: str) -> Path:
    return TABLES / f"{Path(script).stem}.json"


def as_json(document: Mapping[str, Any]) -> str:
    """Each row of a table on one line."""
    text = json.dumps(document, indent=1, ensure_ascii=False)
    return re.sub(r'\[\s+("[^\n]*"(?:,\n\s+"[^\n]*")*)\s+\]', _on_one_line, text) + "\n"


def _on_one_line(match: re.Match[str]) -> str:
    return f"[{' '.join(cell.strip() for cell in match[1].splitlines())}]"


def parsed(text: str) -> dict[str, Any]:
    """The Markdown that a script prints: its lines of prose, and its tables, each with the title
    above it."""
    notes: list[str] = []
    tables: list[dict[str, Any]] = []
    title, open_table = "", False
    for line in map(str.strip, text.splitlines()):
        cells = [cell.strip() for cell in line.strip("|").split(" | ")]
        if not line.startswith("|"):
            heading = re.fullmatch(r"(?:\*\*|#+ )(.+?)(?:\*\*)?", line)
            title = heading[1] if heading else title
            notes += [line] if line and not heading else []
        elif not open_table:
            tables.append({"title": title, "columns": cells, "rows": []})
        elif not set(line) <= set("|- :"):
            tables[-1]["rows"].append(cells)
        open_table = line.startswith("|")
    return {"notes": notes, "tables": tables}


def page_table() -> str:
    """The page's table: the rows ``SHOWN`` of what is stored."""
    lines = [
        "| what is timed | wall time, ms: min / median | processor time, ms | a peer's wall time"
        " on the same input, ms |",
        "| --- | --- | --- | --- |",
    ]
    for words, script, title, row, peer in SHOWN:
        tables = json.loads(stored(script).read_text(encoding="utf-8"))["tables"]
        cells = [figure(tables, title, row, kind) for kind in ("wall", "processor")]
        named = peer.partition(",")[0]
        beside = f"{figure(tables, title, peer, 'wall')} ({named})" if peer else ""
        lines.append(f"| {words} | {' | '.join(cells)} | {beside} |")
    return "\n".join(lines)


KINDS = {"wall": ("wall", "seconds"), "processor": ("processor", "CPU")}
"""How scripts begin the head of a column of times."""


def figure(tables: list[dict[str, Any]], title: str, row: str, kind: str) -> str:
    """A cell in ms; a dash where no table has such a row and column, as of a peer that is not
    installed."""
    for table in tables:
        cells = next((cells for cells in table["rows"] if cells[0] == row), None)
        column = next(
            (k for k, name in enumerate(table["columns"]) if name.startswith(KINDS[kind])), None
        )
        if table["title"].startswith(title) and cells is not None and column is not None:
            factor = 1 if " ms" in table["columns"][column] else 1000
            return " / ".join(f"{factor * float(cell):g}" for cell in cells[column].split(" / "))
    return "-"


def replaced(text: str, table: str) -> str:
    """`text` with `table` between the markers."""
    before, start, rest = text.partition("<!-- run_all.py -->\n")
    _, end, after = rest.partition("<!-- /run_all.py -->")
    if not (start and end):
        raise SystemExit(f"{PAGE.name} holds no pair of markers of run_all.py.")
    return f"{before}{start}{table}\n{end}{after}"


if __name__ == "__main__":
    sys.exit(main())
