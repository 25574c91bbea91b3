"""Time several methods of doing one thing, in turns, so that a busy machine slows all of them
equally."""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from typing import Any


@dataclass(frozen=True, slots=True)
class Row:
    """One contender: its result and its seconds."""

    name: str
    result: Any
    wall_s: tuple[float, ...]
    cpu_s: tuple[float, ...]
    """Of all threads of this process, round by round."""

    @property
    def min_s(self) -> float:
        return min(self.wall_s)

    @property
    def median_s(self) -> float:
        return statistics.median(self.wall_s)


def race(contenders: dict[str, Callable[[], Any]], rounds: int = 5) -> list[Row]:
    """Run every contender `rounds` times, one after the other (A B A B ...), after one run to warm
    up."""
    results = {name: run() for name, run in contenders.items()}
    seconds: dict[str, list[tuple[float, float]]] = {name: [] for name in contenders}
    for _ in range(rounds):
        for name, run in contenders.items():
            start = time.perf_counter()
            busy = time.process_time()
            run()
            seconds[name].append((time.perf_counter() - start, time.process_time() - busy))
    return [Row(name, results[name], *zip(*taken, strict=True)) for name, taken in seconds.items()]


def ratio(row: Row, first: Row) -> float:
    """Median over the rounds of this one's processor time against the first's in the same round."""
    return statistics.median(
        own / max(of_first, 1e-9) for own, of_first in zip(row.cpu_s, first.cpu_s, strict=True)
    )


def print_table(
    title: str, rows: list[Row], facts: Callable[[Any], str] | None = None, head: str = ""
) -> None:
    """Print a Markdown table; the last column compares processor time with the first row's, round
    by round."""
    fact = f" {head} |" if head else ""
    print(
        f"\n**{title}**\n\n| method | wall ms, min / median | processor ms, min / median |{fact}"
        " ratio |"
    )
    print("| --- | --- | --- | --- |" + (" --- |" if head else ""))
    for row in rows:
        wall, busy = (
            f"{_ms(min(taken))} / {_ms(statistics.median(taken))}"
            for taken in (row.wall_s, row.cpu_s)
        )
        fact = f" {facts(row.result)} |" if facts and head else ""
        print(f"| {row.name} | {wall} | {busy} |{fact} {ratio(row, rows[0]):.2f} |")


def _ms(seconds: float) -> str:
    return f"{1000 * seconds:.0f}" if seconds >= 0.1 else f"{1000 * seconds:.3g}"


def machine(*packages: str) -> str:
    """When, on what and with which versions the figures were measured."""
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    versions = ", ".join(f"{name} {_version(name)}" for name in ("splitknit", "numpy", *packages))
    day = datetime.now(UTC).date().isoformat()
    return f"{day}, {os.cpu_count()} cores, load {load:.1f} when the run began, {versions}"


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "(not installed)"
