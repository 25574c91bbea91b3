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
import re
import sys
from collections.abc import Mapping
from functools import partial
from pathlib import Path

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
    figures_table,
    rate_table,
    sensitivity_table,
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


RATES = {
    "scales": ("scales", "n", "{case}", UNDILUTED),
    "fusion": ("fusion", "attribute", "{attribute}", UNDILUTED),
    "which_normals": ("normals", "case, normals", "{case}, {reading}", (THESIS, PLAIN)),
    "ridge": ("matchers ridge", "case", "{case}", BY_PRINT),
    "minutiae": ("matchers minutiae", "case", "{case}", BY_PRINT),
    "family": ("family", "case, matcher", "{case}, {matcher}", (PLAIN, WHOLE)),
    "people": ("people", "case, matcher", "{case}, {matcher}", (PLAIN, WHOLE)),
}
"""Tables of rates: the file and, where it holds several, the matcher; what a row is called; how it
is judged."""
DIFFERENCES = {
    "scales": ("scales", UNDILUTED),
    "fusion": ("fusion", (THESIS_WHOLE, WHOLE)),
    "normals": ("cases normals", UNDILUTED),
    "relief": ("cases relief", UNDILUTED),
    "fusion_minutiae": ("fusion_minutiae", (THESIS_WHOLE, WHOLE)),
    "family": ("family", (WHOLE,)),
    "descriptors_normals": ("descriptors normals", UNDILUTED),
}
"""Tables of differences: the file and, where it holds several, the attribute; how it is judged."""


def readable(folder: Path) -> dict[str, Lines]:
    """All tables for reading."""
    tables = {name: read(folder / f"{name}.csv") for name in ("fusion", "cases", "scales")}
    for_reading = {"thesis": thesis_table(tables)}
    for name, (source, head, words, judged) in RATES.items():
        file, _, matcher = source.partition(" ")
        rows = [row for row in read(folder / f"{file}.csv") if matcher in ("", row["matcher"])]
        for_reading[name] = rate_table(rows, head, partial(_named, words), judged)
    for name, (source, judged) in DIFFERENCES.items():
        file, _, attribute = source.partition(" ")
        rows = read(folder / f"{file}_differences.csv")
        rows = [row for row in rows if attribute in ("", row["attribute"])]
        for_reading[f"{name}_differences"] = difference_table(rows, judged)
    for_reading["figures"] = figures_table(read(folder / "figures.csv"))
    sensitivity = read(folder / "sensitivity.csv")
    for factor in ("roll", "glare", "moisture", "partial"):
        rows = [row for row in sensitivity if row["factor"] == factor]
        for_reading[factor] = sensitivity_table(rows)
    return for_reading


def read(file: Path) -> list[Row]:
    """Rows of a table; none where it was not made."""
    if not file.is_file():
        return []
    with file.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def _named(words: str, row: Row) -> str:
    """What a row is called, its attribute in words."""
    named = {name: row[name].replace("_", " ") for name in ("case", "matcher", "attribute")}
    reading = "of the surface" if row["attribute"] == "normals" else "measured"
    return words.format(**named, reading=reading).removeprefix("n = ")


if __name__ == "__main__":
    sys.exit(main())
