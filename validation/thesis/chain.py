"""Everything from nothing: simulate the population, reconstruct and compare it, by the commands a user has."""

from __future__ import annotations

import argparse
import signal
import subprocess
import sys
from pathlib import Path

from crossed import CASE, OF, crossed_population

SMALL = {"subjects": 3, "sessions": 2, "fingers": "right_index,left_thumb", "scale": 0.2}
"""Enough that every table has a row."""


def run_chain(options: argparse.Namespace) -> None:
    """Run the commands of :func:`commands`; each goes on where it was stopped."""
    if options.store is None:
        options.store = options.population.parent / f"{options.population.name}-store"
    if options.small:
        options.people, options.fraction, options.impostors = SMALL["subjects"], 1.0, 1.0
    simulate, batch = commands(options)
    _run(simulate)
    _run(batch)
    apart = crossed_of(options.population)
    if crossed_population(options.population, apart):
        replaced = {str(options.population): str(apart), str(options.store): str(crossed_of(options.store))}
        cases = ",".join(case for case in options.cases if case != CASE)
        _run([replaced.get(word, OF if word == cases else word) for word in batch])


def crossed_of(folder: Path) -> Path:
    """Where the crossed images of a population, or what `splitknit batch` made of them, lie beside it."""
    return folder.with_name(f"{folder.name}-crossed")


def _run(command: list[str]) -> None:
    print(" ".join(command), flush=True)
    job = subprocess.Popen([sys.executable, "-m", *command])
    signal.signal(signal.SIGTERM, lambda *_: job.terminate())
    if (code := job.wait()) != 0:
        raise SystemExit(code)


def commands(options: argparse.Namespace) -> list[list[str]]:
    """What is run, as one would type it."""
    population, store = str(options.population), str(options.store)
    jobs = str(options.jobs)
    simulate = ["splitknit", "simulate", "population", "--out", population, "--seed", str(options.seed)]
    simulate += ["--workers", jobs, "--scale", str(SMALL["scale"] if options.small else 0.4)]
    simulate += [] if options.prints is None else ["--prints", str(options.prints)]
    if options.small:
        simulate += [text for name in ("subjects", "sessions", "fingers") for text in (f"--{name}", str(SMALL[name]))]
    cases = ",".join(case for case in options.cases if case != CASE)
    batch = ["splitknit", "batch", population, "--out", store, "--cases", cases]
    batch += ["--matchers", "thesis,ridge,minutiae", "--impostors", str(options.impostors)]
    return [simulate, [*batch, "--seed", str(options.seed), "--jobs", jobs]]
