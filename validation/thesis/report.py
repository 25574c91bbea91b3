"""Write this folder's figures as tables for reading, and one of them into
``docs/experiments/thesis-tables.md``.

    python validation/thesis/report.py            # tables/*.csv and the page
    python validation/thesis/report.py --check  # exit code 1 if either does not show what lies here

Cells of the tables are ``value [drawn by finger] (drawn by subject)``. The CSV files beside this
file hold the same figures with more digits, one figure a column.
"""

from __future__ import annotations

import argparse
import csv
import io
import json
import re
import sys
from collections.abc import Mapping
from pathlib import Path

from page_facts import discarded_table, failures_table, figures_table, run_table, sensitivity_table
from page_tables import (
    BY_PRINT,
    PLAIN,
    THESIS,
    THESIS_WHOLE,
    UNDILUTED,
    WHOLE,
    Lines,
    Row,
    difference_table,
    margin_table,
    order_table,
    rate_table,
    thesis_table,
)

HERE = Path(__file__).resolve().parent
PAGE = HERE.parents[1] / "docs" / "experiments" / "thesis-tables.md"


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--check", action="store_true")
    options = parser.parse_args()
    if options.check:
        texts = {**files(HERE), PAGE: fill(PAGE.read_text(encoding="utf-8"), blocks(HERE))}
        return int(
            any(
                not file.is_file() or file.read_text(encoding="utf-8") != text
                for file, text in texts.items()
            )
        )
    write(HERE, PAGE)
    return 0


def write(folder: Path, page: Path) -> None:
    """Write the tables of `folder` to its ``tables``, and the page with its table to `page`."""
    (folder / "tables").mkdir(exist_ok=True)
    for file, text in files(folder).items():
        file.write_text(text, encoding="utf-8")
    page.write_text(fill(PAGE.read_text(encoding="utf-8"), blocks(folder)), encoding="utf-8")


def files(folder: Path) -> dict[Path, str]:
    """Each table's file and its text; none of what was not measured."""
    tables = {}
    for name, lines in readable(folder).items():
        if len(lines) > 1:
            stream = io.StringIO()
            csv.writer(stream, lineterminator="\n").writerows(lines)
            tables[folder / "tables" / f"{name}.csv"] = stream.getvalue()
    return tables


def fill(page: str, parts: Mapping[str, str]) -> str:
    """The page with every block in its place.

    A block stands between ``<!-- begin NAME -->`` and ``<!-- end NAME -->``.
    """
    for name, text in parts.items():
        pattern = re.compile(rf"(<!-- begin {name} -->\n).*?(<!-- end {name} -->)", re.DOTALL)
        if not pattern.search(page):
            raise SystemExit(f"{PAGE.name} has no marks for '{name}'.")
        page = pattern.sub(lambda match, text=text: f"{match[1]}\n{text}\n\n{match[2]}", page)
    return page


def blocks(folder: Path) -> dict[str, str]:
    """The generated part of the page, in Markdown: figures that the thesis states."""
    head, *rows = thesis_table(
        {name: read(folder / f"{name}.csv") for name in ("scales", "fusion", "cases")}, SHOWN
    )
    place = head.index("impostor pairs")
    rows_shown = [
        head,
        ["---"] * len(head),
        *(row for row in rows if row[head.index("thesis")] != "-"),
    ]
    return {
        "thesis": "\n".join(
            f"|{'|'.join((*cells[:place], *cells[place + 1 :]))}|" for cells in rows_shown
        )
    }


SHOWN = (THESIS, PLAIN)
"""How the page's table is judged."""


def readable(folder: Path) -> dict[str, Lines]:
    """All tables for reading."""
    runs = json.loads((folder / "runs.json").read_text(encoding="utf-8"))
    tables = {
        name: read(folder / f"{name}.csv") for name in ("fusion", "cases", "matchers", "scales")
    }
    differ = {name: read(folder / f"{name}_differences.csv") for name in tables}
    for_reading = {
        "run": run_table(runs),
        "thesis": thesis_table(tables),
        "order": order_table(tables, differ),
        "scales": rate_table(
            tables["scales"], "n", lambda row: row["case"].removeprefix("n = "), UNDILUTED
        ),
        "scales_differences": difference_table(differ["scales"], UNDILUTED),
        "fusion": rate_table(tables["fusion"], "attribute", _attribute, UNDILUTED),
        "fusion_differences": difference_table(differ["fusion"], (THESIS_WHOLE, WHOLE)),
        "failures": failures_table(read(folder / "failures.csv")),
        "discarded": discarded_table(runs["failures"]["roll"]),
    }
    for name in ("normals", "relief"):
        rows = [row for row in differ["cases"] if row["attribute"] == name]
        for_reading[f"{name}_differences"] = difference_table(rows, UNDILUTED)
    which, between = (read(folder / f"normals{ending}.csv") for ending in ("", "_differences"))
    for_reading["which_normals"] = rate_table(which, "case, normals", _which, (THESIS, PLAIN))
    for_reading["which_normals_differences"] = difference_table(between, (PLAIN,))
    for_reading["fusion_minutiae"] = rate_table(
        read(folder / "fusion_minutiae.csv"),
        "case, joined",
        lambda row: f"{row['case']}, {_attribute(row)}",
        (THESIS, PLAIN),
    )
    for_reading["fusion_minutiae_differences"] = difference_table(
        read(folder / "fusion_minutiae_differences.csv"), (THESIS_WHOLE, WHOLE)
    )
    for name in ("ridge", "minutiae"):
        rows = [row for row in tables["matchers"] if row["matcher"] == name]
        for_reading[name] = rate_table(rows, "case", lambda row: row["case"], BY_PRINT)
        for_reading[f"{name}_margin"] = margin_table(rows)
    for name in ("family", "people"):
        for_reading[name] = rate_table(
            read(folder / f"{name}.csv"),
            "case, matcher",
            lambda row: f"{row['case']}, {row['matcher']}",
            (PLAIN, WHOLE),
        )
    for_reading["family_differences"] = difference_table(
        read(folder / "family_differences.csv"), (WHOLE,)
    )
    described, apart = (
        read(folder / f"descriptors{ending}.csv") for ending in ("", "_differences")
    )
    for name in ("normals", "relief"):
        rows, two = (
            [row for row in part if row["attribute"] == name] for part in (described, apart)
        )
        for_reading[f"descriptors_{name}"] = rate_table(
            rows, f"feature, {name}", lambda row: row["case"], UNDILUTED
        )
        for_reading[f"descriptors_{name}_differences"] = difference_table(two, UNDILUTED)
    for_reading["figures"] = figures_table(read(folder / "figures.csv"))
    sensitivity = read(folder / "sensitivity.csv")
    for factor in ("roll", "glare", "moisture", "partial"):
        for_reading[factor] = sensitivity_table(
            [row for row in sensitivity if row["factor"] == factor]
        )
    return for_reading


def read(file: Path) -> list[Row]:
    """Rows of a table; none where it was not made."""
    if not file.is_file():
        return []
    with file.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def _attribute(row: Row) -> str:
    return row["attribute"].replace("_", " ")


def _which(row: Row) -> str:
    """Of the surface, or as photometric stereo measured them."""
    return f"{row['case']}, {'of the surface' if row['attribute'] == 'normals' else 'measured'}"


if __name__ == "__main__":
    sys.exit(main())
