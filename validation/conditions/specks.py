"""When the check for specks warns: ``python validation/conditions/specks.py SCRATCH POPULATION``.

On clean captures drawn from a population, on three of the reported fingers at other scales, on all six in every
condition and severity (captures that ``run.py --keep`` left in SCRATCH, else made anew), and on six with other faults:
the fraction of the finger under dark and under bright specks in both bands, and whether the sentence about dust, or
that about dry skin, was said.
SCRATCH/specks.jsonl holds a row for each capture, and running it again goes on; ``specks.json`` is the summary,
``--table`` writes ``tables/specks.csv``.
``summary.py`` takes the sentences from there for rows that were made before the check existed.

The thresholds were chosen on other fingers: seeds 7401 to 7406, and subjects S16 and S17 of the population.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
from collections.abc import Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from run import KINDS, SEEDS, photographed
from scipy.stats import binomtest

import splitknit_simulator.finger.finger as drawing
from splitknit.finger.locate import find_finger
from splitknit.io.capture import read_capture
from splitknit.model import Capture
from splitknit.presets import preset_settings
from splitknit_simulator.twin import simulate_capture

OUT = Path(__file__).with_name("specks.json")
SEVERITIES = (0.25, 0.5, 0.75, 1.0)
SCALES = (0.165, 0.25, 0.6)
"""Of the twin: 12, 19 and 45 px/mm; the conditions' own is 0.35, 26 px/mm."""
PX_PER_MM = 75.7
"""Of the twin at scale 1."""
CHOSEN_ON = ("S16", "S17")
DARK, BRIGHT = "dark specks", "bright specks"


def facts(capture: Capture) -> dict[str, Any]:
    """Fractions under dark and bright specks in each band, and every sentence about specks."""
    finger = find_finger(capture, preset_settings("metric"))
    fractions = {band: [found["dark_specks"], found["bright_specks"]] for band, found in finger.quality.items()}
    return {"shares": fractions, "said": [text for text in finger.warnings if DARK in text or BRIGHT in text]}


def condition_tasks(seeds: tuple[int, ...]) -> Iterator[dict[str, Any]]:
    """Captures of the conditions: the clean ones, then every kind at every severity."""
    for seed in seeds:
        yield {"set": "conditions", "seed": seed, "impression": 0, "kind": "none", "severity": 0.0}
        yield {"set": "conditions", "seed": seed, "impression": 1, "kind": "none", "severity": 0.0}
        for kind in KINDS:
            for severity in SEVERITIES:
                yield {"set": "conditions", "seed": seed, "impression": 0, "kind": kind, "severity": severity}


def scale_tasks(seeds: tuple[int, ...], scales: tuple[float, ...]) -> Iterator[dict[str, Any]]:
    """The first fingers at other scales: clean, dusty and dry."""
    for scale in scales:
        for seed in seeds:
            for kind, severity in (("none", 0.0), ("dusty", 0.25), ("dusty", 1.0), ("dry", 0.5), ("dry", 1.0)):
                yield {
                    "set": "scales", "scale": scale, "seed": seed, "impression": 0, "kind": kind, "severity": severity
                }  # fmt: skip


def fault_tasks(seeds: Sequence[int]) -> Iterator[dict[str, Any]]:
    """Fingers with one fault that is not a speck: shallow ridges, blur, strong glare, little light, little in view."""
    for seed in seeds:
        for fault in ("dry", "defocus", "partial", "glare", "dark"):
            yield {"set": "faults", "seed": seed, "kind": fault, "severity": 1.0}


def with_fault(seed: int, fault: str) -> Capture:
    """A capture of ``validation/prints/quality_faults.py``."""
    folder = str(Path(__file__).parents[1] / "prints")
    if folder not in sys.path:
        sys.path.append(folder)
    from quality_faults import FAULTS, finger_of

    return simulate_capture(seed, settings=FAULTS[fault], finger=finger_of(seed, fault))[0]


def population_tasks(population: Path, count: int) -> Iterator[dict[str, Any]]:
    """Captures drawn by chance from the subjects on whom nothing was chosen."""
    names = sorted(
        path.relative_to(population).as_posix()
        for path in population.glob("S*/session_*/*")
        if path.relative_to(population).parts[0] not in CHOSEN_ON
    )
    some = np.random.default_rng(7).permutation(len(names))[:count]
    return ({"set": "population", "capture": names[k]} for k in some)


def wilson(passed: int, trials: int) -> list[float]:
    """95 % interval of a fraction of independent trials (Wilson 1927)."""
    found = binomtest(passed, trials).proportion_ci(method="wilson")
    return [round(float(found.low), 4), round(float(found.high), 4)]


def reports_of(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """How many were warned of dust and of dry skin, with intervals, and the range of the fractions."""
    result: dict[str, Any] = {"captures": len(rows)}
    for name, words in (("dust", DARK), ("dry", BRIGHT)):
        warned = sum(any(words in text for text in row["said"]) for row in rows)
        result[name] = {"told": warned, "interval": wilson(warned, len(rows))}
    for band in sorted(rows[0]["shares"]):
        for column, name in enumerate(("dark", "bright")):
            values = [row["shares"][band][column] for row in rows if row["shares"][band][column] is not None]
            if values:
                three = (min(values), float(np.median(values)), max(values))
                result[f"{band}_{name}_percent"] = [round(100 * value, 3) for value in three]
    return result


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Groups of captures by set, condition, severity and scale."""
    groups: dict[str, dict[str, list[dict[str, Any]]]] = {}
    for row in rows:
        name = "clean" if row["set"] == "population" else f"{row['kind']} {row['severity']:g}"
        name += f" at scale {row['scale']:g}" if row["set"] == "scales" else ""
        groups.setdefault(row["set"], {}).setdefault(name, []).append(row)
    return {part: {name: reports_of(some) for name, some in named.items()} for part, named in groups.items()}


COLUMNS = (
    *("captures", "count", "dust_reported", "dust_percent_low", "dust_percent_high"),
    *("dry_reported", "dry_percent_low", "dry_percent_high"),
    *(f"{what}_specks_percent{end}" for what in ("dark", "bright") for end in ("", "_min", "_max")),
)


def table(rows: list[dict[str, Any]]) -> list[list[str]]:
    """Rows of ``tables/specks.csv``: how many were warned, with intervals, and the white band's median and range."""
    lines = [list(COLUMNS)]

    def line(name: str, some: list[dict[str, Any]]) -> None:
        if not some:
            return
        found = reports_of(some)
        cells = [name, str(len(some))]
        for what in ("dust", "dry"):
            low, high = (100 * end for end in found[what]["interval"])
            cells += [str(found[what]["told"]), f"{low:.3g}", f"{high:.3g}"]
        for what in ("dark", "bright"):
            low, middle, high = found[f"white_{what}_percent"]
            cells += [f"{middle:.2f}", f"{low:.2f}", f"{high:.2f}"]
        lines.append(cells)

    line("clean, from the population", [row for row in rows if row["set"] == "population"])
    mine = [row for row in rows if row["set"] == "conditions"]
    line("clean, the six fingers", [row for row in mine if row["kind"] == "none"])
    for kind in ("dusty", "dry"):
        for severity in SEVERITIES:
            line(f"{kind} {severity:g}", [r for r in mine if (r["kind"], r["severity"]) == (kind, severity)])
    for kind in ("wet", "scarred", "glossy"):
        line(f"{kind}, all severities", [row for row in mine if row["kind"] == kind])
    line("out of focus, dark, glaring, shallow, short", [row for row in rows if row["set"] == "faults"])
    for scale in sorted({row["scale"] for row in rows if row["set"] == "scales"}):
        for kind, words in (("none", "clean"), ("dusty", "dusty 0.25 and 1"), ("dry", "dry 0.5 and 1")):
            some = [row for row in rows if (row.get("scale"), row.get("kind")) == (scale, kind)]
            line(f"{words}, at {PX_PER_MM * scale:.0f} px/mm", some)
    return lines


def main() -> None:
    """Measure what is missing, summarise."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scratch", type=Path)
    parser.add_argument("population", type=Path, nargs="?")
    parser.add_argument("--captures", type=int, default=150, help="of the population")
    parser.add_argument("--seeds", type=int, nargs="+", default=SEEDS)
    parser.add_argument("--scales", type=float, nargs="*", default=SCALES)
    parser.add_argument(
        "--faults", type=int, nargs="*", default=range(9201, 9207), help="seeds of fingers with a fault"
    )
    parser.add_argument("--out", type=Path, default=OUT)
    parser.add_argument("--table", type=Path, help="CSV to write, such as tables/specks.csv")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    drawing.master_print = lru_cache(maxsize=8)(drawing.master_print)  # type: ignore[assignment]
    file = options.scratch / "specks.jsonl"
    rows = [json.loads(line) for line in file.read_text().splitlines()] if file.is_file() else []
    done = {_key(row) for row in rows}
    seeds = tuple(options.seeds)
    tasks = [
        *scale_tasks(seeds[:3], tuple(options.scales)),
        *condition_tasks(seeds),
        *fault_tasks(tuple(options.faults)),
    ]
    if options.population:
        tasks = [*population_tasks(options.population, options.captures), *tasks]
    for task in tasks:
        if _key(task) in done:
            continue
        if task["set"] == "population":
            capture = read_capture(options.population / task["capture"])
        elif task["set"] == "faults":
            capture = with_fault(task["seed"], task["kind"])
        else:
            capture, _ = photographed(
                options.scratch, task["seed"], task["impression"], task["kind"], task["severity"], task.get("scale")
            )
        rows.append(task | facts(capture))
        with file.open("a") as lines:
            lines.write(json.dumps(rows[-1]) + "\n")
        print(_key(task), rows[-1]["said"], flush=True)
    options.out.write_text(json.dumps(summary(rows), indent=1) + "\n")
    if options.table:
        with options.table.open("w", newline="") as written:
            csv.writer(written, lineterminator="\n").writerows(table(rows))


def _key(task: dict[str, Any]) -> tuple[Any, ...]:
    names = ("set", "capture", "scale", "seed", "impression", "kind", "severity")
    return tuple(task.get(name) for name in names)


if __name__ == "__main__":
    main()
