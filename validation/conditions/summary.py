"""What fails first: ``python validation/conditions/summary.py SCRATCH``, after ``run.py``.

Writes ``conditions.csv`` (medians over fingers with 95 % bootstrap intervals, beside the range of
clean captures) and ``conditions.json`` (what leaves its clean range first, and what the software
said), and prints the table of ``docs/experiments/conditions.md``: the first preset at severity 1.
"""

from __future__ import annotations

import argparse
import json
import re
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from splitknit.io.csv_table import csv_text
from splitknit_match.prints.folder import advice
from splitknit_match.prints.print_quality import PrintQuality, QualityFigures, score_of

HERE = Path(__file__).parent
WORSE_WHEN_LOWER = (
    "ridge_correlation",
    "ridge_good_area",
    "print_quality",
    "similarity",
    "mask_overlap",
)
WORSE_WHEN_HIGHER = ("normals_mean_deg", "shape_rms_mm", "surface_rms_mm")
WORSE_BOTH_WAYS = ("ridge_gain", "nfiq2")
SHOWN_ONLY = ("saturated", "ridge_contrast")
FIGURES = (*WORSE_WHEN_LOWER, *WORSE_WHEN_HIGHER, *WORSE_BOTH_WAYS, *SHOWN_ONLY)
JUDGED = (
    "ridge_correlation",
    "ridge_gain",
    "normals_mean_deg",
    "shape_rms_mm",
    "print_quality",
    "nfiq2",
    "similarity",
)
"""Figures that may fail first: those by which a condition is judged."""


def interval(values: np.ndarray, rounds: int = 2000) -> tuple[float, float]:
    """95 % bootstrap interval of the median over fingers."""
    rng = np.random.default_rng(0)
    medians = np.median(rng.choice(values, (rounds, len(values))), axis=1)
    return float(np.percentile(medians, 2.5)), float(np.percentile(medians, 97.5))


def outside(figure: str, value: float, clean: np.ndarray) -> float:
    """How far a value lies beyond the clean captures' range, in widths of that range; 0 inside."""
    low = float(clean.min())
    high = float(clean.max())
    width = max(high - low, 1e-9)
    below, above = (low - value) / width, (value - high) / width
    if figure in WORSE_WHEN_LOWER:
        return max(0.0, below)
    if figure in WORSE_WHEN_HIGHER:
        return max(0.0, above)
    return max(0.0, below, above)


def cells(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """One row for each preset, condition, severity and figure."""
    table_rows = []
    for preset in sorted({row["preset"] for row in rows}):
        completed = [row for row in rows if row["preset"] == preset and row["exit"] == 0]
        clean = [row for row in completed if row["kind"] == "none"]
        fingers = len({row["seed"] for row in clean if row["impression"] == 0})
        groups = sorted(
            {(row["kind"], row["severity"]) for row in completed},
            key=lambda key: (key[0] != "none", key),
        )
        for kind, severity in groups:
            rows_of_condition = [
                r
                for r in completed
                if (r["kind"], r["severity"]) == (kind, severity) and r["impression"] == 0
            ]
            tried = [
                r
                for r in rows
                if (r["preset"], r["kind"], r["severity"]) == (preset, kind, severity)
            ]
            if len({r["seed"] for r in tried}) < fingers or not rows_of_condition:
                continue  # not measured on all fingers yet
            for figure in FIGURES:
                values = np.array(
                    [row[figure] for row in rows_of_condition if row.get(figure) is not None]
                )
                known = np.array([row[figure] for row in clean if row.get(figure) is not None])
                if len(values) == 0 or len(known) == 0:
                    continue
                low, high = interval(values)
                middle = float(np.median(values))
                table_rows.append(
                    {
                        "preset": preset,
                        "kind": kind,
                        "severity": severity,
                        "figure": figure,
                        "fingers": len(values),
                        "median": round(middle, 4),
                        "low": round(low, 4),
                        "high": round(high, 4),
                        "clean_low": round(float(known.min()), 4),
                        "clean_high": round(float(known.max()), 4),
                        "beyond": 0.0
                        if kind == "none" or figure in SHOWN_ONLY
                        else round(outside(figure, middle, known), 2),
                    }
                )
    return table_rows


def first_failures(table: list[dict[str, Any]], preset: str) -> dict[str, Any]:
    """For each condition: at which severity which figures first leave the clean range, the furthest
    first."""
    result = {}
    for kind in sorted({row["kind"] for row in table} - {"none"}):
        judged = [
            r for r in table if (r["preset"], r["kind"]) == (preset, kind) and r["figure"] in JUDGED
        ]
        gone = sorted({row["severity"] for row in judged if row["beyond"] > 0})
        if not gone:
            result[kind] = {
                "severity": None,
                "figures": [],
                "measured": sorted({r["severity"] for r in judged}),
            }
            continue
        left = sorted(
            (r for r in judged if r["severity"] == gone[0] and r["beyond"] > 0),
            key=lambda r: -r["beyond"],
        )
        result[kind] = {
            "severity": gone[0],
            "figures": [
                {k: r[k] for k in ("figure", "median", "low", "high", "clean_low", "clean_high")}
                for r in left
            ],
            "measured": sorted({r["severity"] for r in judged}),
        }
    return result


def sentences(rows: list[dict[str, Any]], preset: str) -> dict[str, dict[str, int]]:
    """How many of the fingers heard what, by condition and severity; numbers in the sentences are
    dropped."""
    heard: dict[str, Counter[str]] = {}
    for row in rows:
        if row["preset"] != preset or row["impression"] != 0:
            continue
        count = heard.setdefault(f"{row['kind']} {row['severity']:g}", Counter())
        count["captures"] += 1
        if row["exit"]:
            count["refused: " + plain(row["refused"])] += 1
            continue
        heard_now = {
            "reconstruct: " + plain(text)
            for text in row["warnings"]
            if "flexion crease" not in text
        }
        heard_now |= {"print: " + plain(text) for text in advice_of(row)}
        count.update(sorted(heard_now))
        count["silent"] += not heard_now
        count["reconstruct silent"] += not any(text.startswith("reconstruct") for text in heard_now)
        count["not the same finger at a false match rate of 1e-4"] += bool(
            row.get("fmr", 0) and row["fmr"] > 1e-4
        )
    return {key: dict(count.most_common()) for key, count in heard.items()}


def advice_of(row: dict[str, Any]) -> tuple[str, ...]:
    """Advice on the print in the words of today."""
    if "print_figures" not in row:
        return tuple(row["advice"])
    figures = QualityFigures(**row["print_figures"])
    score, worth = score_of(figures)
    return tuple(map(str, advice(PrintQuality(score, worth, figures))))


def plain(text: str) -> str:
    """A sentence without its numbers, and whether the white or the nir band was meant."""
    return re.sub(
        r"\d+(\.\d+)?", "N", text.replace("white band: ", "").replace("nir band: ", "nir: ")
    )


def show(document: dict[str, Any], table: list[dict[str, Any]], preset: str) -> str:
    """Markdown: clean fingers and every condition at severity 1, bold where a figure left its clean
    range."""
    lines = [
        "| condition | from severity | " + " | ".join(NAMES.values()) + " |",
        "| --- " * (2 + len(NAMES)) + "|",
    ]
    chosen = {
        (row["kind"], row["figure"]): row
        for row in table
        if row["preset"] == preset and (row["kind"] == "none" or row["severity"] == 1)
    }
    for kind in dict.fromkeys(kind for kind, _ in chosen):
        values = []
        for figure in NAMES:
            row = chosen.get((kind, figure))
            three = [] if row is None else [f"{row[end]:.2f}" for end in ("median", "low", "high")]
            text = f"{three[0]} ({three[1]}-{three[2]})" if three else ""
            values.append(f"**{text}**" if row is not None and row["beyond"] > 0 else text)
        first = "" if kind == "none" else document["first"][preset][kind]["severity"]
        lines.append(
            f"| {kind} | {'never' if first is None else first} | " + " | ".join(values) + " |"
        )
    return "\n".join(lines)


NAMES = {
    "ridge_correlation": "ridge correlation",
    "ridge_gain": "ridge gain",
    "similarity": "similarity",
}
"""Columns of the page's table."""


def main() -> None:
    """Read, summarise, write, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scratch", type=Path)
    parser.add_argument("--out", type=Path, default=HERE)
    parser.add_argument(
        "--page", type=Path, help="page whose table is replaced, such as conditions.md"
    )
    options = parser.parse_args()
    rows = [json.loads(line) for line in (options.scratch / "rows.jsonl").read_text().splitlines()]
    table = cells(rows)
    presets = sorted(
        {row["preset"] for row in rows}, key=lambda name: (name != "metric", name != "snk", name)
    )
    lines = csv_text([table[0], *(row.values() for row in table)])
    (options.out / "conditions.csv").write_text(lines, encoding="utf-8")
    document = {
        "fingers": sorted({row["seed"] for row in rows}),
        "captures": len(
            {(row["seed"], row["impression"], row["kind"], row["severity"]) for row in rows}
        ),
        "first": {preset: first_failures(table, preset) for preset in presets},
        "said": {preset: sentences(rows, preset) for preset in presets},
    }
    (options.out / "conditions.json").write_text(json.dumps(document, indent=1) + "\n")
    text = show(document, table, presets[0])
    if options.page:
        page = options.page.read_text()
        start, end = "<!-- conditions -->", "<!-- /conditions -->"
        options.page.write_text(f"{page.split(start)[0]}{start}\n{text}\n{end}{page.split(end)[1]}")
    print(text)


if __name__ == "__main__":
    main()
