"""Tables of ``agreement.json`` as CSV, in ``tables/``: ``python
validation/prints/agreement_report.py [--check]``.

``docs/experiments/prints.md`` quotes them.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from splitknit.io.csv_table import csv_text

HERE = Path(__file__).resolve().parent
RESULTS = HERE / "agreement.json"
TABLES = HERE / "tables"
WORDS = {"truth": "true relief", "pressed": "pressed print"}
PICTURES = {"print": "mindtct", "enhanced": "mindtct, enhanced", "phase": "phase"}


def cells(figure: Sequence[float | None], digits: int = 2) -> list[str]:
    """A figure and the two ends of its interval."""
    return ["" if v is None else f"{v:.{digits}f}" for v in figure]


def columns(name: str) -> list[str]:
    """Names of a figure's column and those of its interval."""
    return [name, f"{name}_low", f"{name}_high"]


def named(key: str) -> tuple[str, str]:
    """What was printed, and how its minutiae were found."""
    *what, picture = key.split()
    return " ".join([WORDS.get(what[0], what[0]), *what[1:]]), PICTURES[picture]


def minutiae(facts: dict[str, Any]) -> list[list[str]]:
    """Recall, precision and direction of the minutiae on every print."""
    rows = [
        ["print", "minutiae_by", *columns("recall"), *columns("precision"), "direction_median_deg"]
    ]
    rows[0] += [
        "direction_p90_deg",
        *columns("recall_below_60_deg"),
        *columns("precision_below_60_deg"),
    ]
    for key, row in facts["minutiae"].items():
        off = [f"{row[name][0]:.1f}" for name in ("direction_median_deg", "direction_p90_deg")]
        flat = row["below_60_deg"]
        below = (
            [""] * 6
            if key.startswith("pressed")
            else [*cells(flat["recall"]), *cells(flat["precision"])]
        )
        rows.append([*named(key), *cells(row["recall"]), *cells(row["precision"]), *off, *below])
    return rows


def scores(facts: dict[str, Any]) -> list[list[str]]:
    """Scores of bozorth3, session 1 against session 2 or against the pressed print."""
    rows = [["print", "minutiae_by", "fingers", *columns("genuine_above_all_impostors")]]
    rows[0] += ["genuine_median", "impostor_largest"]
    named_rows = [(named(key), row) for key, row in facts.get("bozorth3", {}).items()]
    for key, row in facts.get("cross_modal", {}).items():
        method, picture = key.split()[:2]
        named_rows.append(((f"metric {method} against the pressed print", PICTURES[picture]), row))
    for name, row in named_rows:
        ends = [f"{row['genuine_median']:.0f}", f"{row['impostor_largest']:.0f}"]
        rows.append([*name, str(row["fingers"]), *cells(row["above_all_impostors"]), *ends])
    return rows


def main(arguments: list[str] | None = None) -> int:
    """Write the tables, or return 1 if they are not those of the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true")
    options = parser.parse_args(arguments)
    facts = json.loads(RESULTS.read_text(encoding="utf-8"))
    current = True
    for table in (minutiae, scores):
        text = csv_text(table(facts))
        path = TABLES / f"{table.__name__}.csv"
        if options.check:
            current = current and path.read_text(encoding="utf-8") == text
        else:
            path.write_text(text, encoding="utf-8")
    return int(not current)


if __name__ == "__main__":
    sys.exit(main())
