"""What motion during the capture costs, and what is left of the loss when it is undone.

    python validation/motion/run.py  # resumable: simulates and measures what is missing
    python validation/motion/run.py --summary        # prints the tables of what is there

writes ``results.json`` beside this file. The motion is the twin's (drift, tremor, turns, slip); the
fingers are not those on which the settings were chosen. The truth is that of the reference shot.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from captures import AMPLITUDES_MM, SCALE, SEEDS
from measure import moved_row, still_row

RESULTS = Path(__file__).resolve().parent / "results.json"
Row = dict[str, Any]


def read(file: Path) -> dict[str, Any]:
    """What is measured already."""
    return (
        json.loads(file.read_text())
        if file.is_file()
        else {"scale": SCALE, "still": [], "moved": []}
    )


def run(file: Path, seeds: Sequence[int], amplitudes: Sequence[float], scale: float) -> None:
    """Measure what is missing; the file is written after every row."""
    done = read(file)
    if done["scale"] != scale:
        raise SystemExit(
            f"{file} holds results at scale {done['scale']:g}; name another file with --out."
        )

    def keep(kind: str, row: Row) -> None:
        done[kind].append(rounded(row))
        done[kind].sort(key=lambda r: (r.get("amplitude_mm", 0.0), r["seed"]))
        file.write_text(json.dumps(done, indent=1) + "\n")
        print(kind, row["seed"], row.get("amplitude_mm", ""), flush=True)

    for amplitude in amplitudes:
        for seed in seeds:
            if not any(row["seed"] == seed for row in done["still"]):
                keep("still", still_row(seed, scale))
            if not any(
                (row["seed"], row["amplitude_mm"]) == (seed, amplitude) for row in done["moved"]
            ):
                keep("moved", moved_row(seed, amplitude, scale))


def rounded(value: Any) -> Any:
    """Numbers with five digits behind the point."""
    if isinstance(value, dict):
        return {key: rounded(part) for key, part in value.items()}
    return round(value, 5) if isinstance(value, float) else value


def interval(values: Sequence[float]) -> str:
    """Mean and 95 % interval by bootstrap over the fingers."""
    if not values:
        return "-"
    draws = np.random.default_rng(7).choice(values, (4000, len(values))).mean(axis=1)
    low, high = np.quantile(draws, (0.025, 0.975))
    return f"{np.mean(values):.3f} [{low:.3f}, {high:.3f}]"


def tables(results: dict[str, Any]) -> list[str]:
    """The tables as lines of Markdown."""
    still = {row["seed"]: row["still"] for row in results["still"]}
    lines = [
        (
            f"Still: {len(still)} fingers, ridge correlation"
            f" {interval([s['ridge_correlation'] for s in still.values()])}, shape rms"
            f" {interval([s['shape_rms_mm'] for s in still.values()])} mm; left alone:"
            f" {sum(row['left_alone'] for row in results['still'])}, bit-equal:"
            f" {sum(row['same'] for row in results['still'])}."
        ),
        "",
    ]
    for figure, sign in (("ridge_correlation", 1.0), ("shape_rms_mm", -1.0)):
        kinds = ["uncorrected", "corrected", "oracle"]
        lines += [f"Loss of {figure} against the still finger:", ""]
        lines += [
            "| motion, mm | fingers | " + " | ".join(kinds) + " |",
            "| --- | --- |" + " --- |" * len(kinds),
        ]
        for amplitude, rows in by_amplitude(results["moved"]):
            cells = [
                interval(
                    [sign * (still[r["seed"]][figure] - r[kind][figure]) for r in rows if kind in r]
                )
                for kind in kinds
            ]
            lines.append(f"| {amplitude:g} | {len(rows)} | " + " | ".join(cells) + " |")
        lines.append("")
    columns: dict[str, Callable[[Row], float | None]] = {
        "error white, um": lambda r: r.get("error_um", {}).get("white"),
        "error nir, um": lambda r: r.get("error_um", {}).get("nir"),
    }
    lines += [
        "| motion, mm | undone | refused | " + " | ".join(columns) + " |",
        "| --- | --- | --- |" + " --- |" * len(columns),
    ]
    for amplitude, rows in by_amplitude(results["moved"]):
        cells = [
            interval([v for v in map(column, rows) if v is not None]) for column in columns.values()
        ]
        counts = (
            f"{sum(r.get('undone', False) for r in rows)} | {sum('refused' in r for r in rows)}"
        )
        lines.append(f"| {amplitude:g} | {counts} | " + " | ".join(cells) + " |")
    return lines


def by_amplitude(rows: Iterable[Row]) -> list[tuple[float, list[Row]]]:
    """Rows of each amplitude, rising."""
    rows = list(rows)
    return [
        (a, [r for r in rows if r["amplitude_mm"] == a])
        for a in sorted({r["amplitude_mm"] for r in rows})
    ]


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, then print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, nargs="+", default=SEEDS)
    parser.add_argument("--amplitudes", type=float, nargs="+", default=AMPLITUDES_MM)
    parser.add_argument("--scale", type=float, default=SCALE)
    parser.add_argument("--out", type=Path, default=RESULTS)
    parser.add_argument("--summary", action="store_true", help="print the tables, measure nothing")
    options = parser.parse_args(arguments)
    if not options.summary:
        run(options.out, options.seeds, options.amplitudes, options.scale)
    print("\n".join(tables(read(options.out))))


if __name__ == "__main__":
    main()
