"""Time several methods of doing one thing, in turns, so that a busy machine slows all of them equally."""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class Row:
    """One contender: its result and its seconds."""

    name: str
    result: Any
    min_s: float
    median_s: float


def race(contenders: dict[str, Callable[[], Any]], rounds: int = 5) -> list[Row]:
    """Run every contender `rounds` times, one after the other, after one run to warm up."""
    results = {name: run() for name, run in contenders.items()}
    seconds: dict[str, list[float]] = {name: [] for name in contenders}
    for _ in range(rounds):
        for name, run in contenders.items():
            start = time.perf_counter()
            run()
            seconds[name].append(time.perf_counter() - start)
    return [Row(name, results[name], min(s), statistics.median(s)) for name, s in seconds.items()]


def print_table(title: str, rows: list[Row], facts: Callable[[Any], str], head: str) -> None:
    """Print a Markdown table; the last column is the time relative to the first row."""
    print(f"\n### {title}\n\n| method | seconds, least / median | {head} | time against the first |")
    print("| --- | --- | --- | --- |")
    for row in rows:
        ratio = row.median_s / rows[0].median_s
        print(f"| {row.name} | {row.min_s:.3f} / {row.median_s:.3f} | {facts(row.result)} | {ratio:.1f} |")


def machine() -> str:
    """What the figures were measured on."""
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    return f"{os.cpu_count()} cores, load {load:.1f} when the run began"
