"""``splitknit simulate population``."""

from __future__ import annotations

import argparse
from dataclasses import replace

from splitknit.apps.verb import Outcome, Progress, natural
from splitknit.errors import require

DEFAULT_WORKERS = 2
_OPTIONS = ("subjects", "fingers", "sessions", "workers")


def add_population_options(verb: argparse.ArgumentParser) -> None:
    """Add what only a population knows."""
    group = verb.add_argument_group("population")
    group.add_argument("--subjects", type=natural, default=None, metavar="N", help="people (default: 17)")
    group.add_argument(
        "--fingers", default=None, metavar="LIST", help="all (default), or names with commas, such as right_index"
    )
    group.add_argument("--sessions", type=natural, default=None, metavar="N", help="captures a finger (default: 4)")
    group.add_argument(
        "--workers", type=natural, default=None, metavar="N", help=f"processes (default: {DEFAULT_WORKERS})"
    )


def refuse_population_options(options: argparse.Namespace) -> None:
    """Refuse a population's options where one finger is simulated.

    Raises
    ------
    BadInput
    """
    unused = [name for name in _OPTIONS if getattr(options, name) is not None]
    require(not unused, f"--{unused[0] if unused else ''} is for 'splitknit simulate population'.")


def run_population(options: argparse.Namespace) -> Outcome:
    """Simulate a population, or what of it is missing."""
    from splitknit.apps.options import read_changes  # noqa: PLC0415
    from splitknit.apps.simulate_population import simulate_population  # noqa: PLC0415
    from splitknit.capture.enrolment import FINGERS  # noqa: PLC0415
    from splitknit.settings import override  # noqa: PLC0415
    from splitknit.simulator.population.sessions import PopulationSettings  # noqa: PLC0415

    names = ("pattern", "rig", "motion", "condition", "severity", "mirrors")
    unused = [name for name in names if getattr(options, name) is not None]
    unused += [name.replace("_", "-") for name in ("bench", "no_nir", "impression") if getattr(options, name)]
    require(not unused, f"--{unused[0] if unused else ''} does not go with a population.")
    changes = read_changes(options.settings, options.assignments)
    settings = override(PopulationSettings(seed=options.seed), changes)
    settings = settings if options.scale is None else replace(settings, scale=options.scale)
    fingers = None
    if options.fingers is not None:
        fingers = FINGERS if options.fingers == "all" else tuple(options.fingers.split(","))
    with Progress(options) as progress:
        facts = simulate_population(
            options.out,
            settings,
            subjects=options.subjects,
            sessions=options.sessions,
            fingers=fingers,
            workers=DEFAULT_WORKERS if options.workers is None else options.workers,
            progress=progress.update,
        )
    each = facts["seconds_per_capture"]
    speed = f", {each:.1f} s each" if each is not None else ""
    lines = [
        f"{facts['simulated']} captures simulated now{speed}, {facts['found']} were there; {facts['total']} in "
        f"{options.out}: {facts['subjects']} subjects, {len(facts['fingers'])} fingers, {facts['sessions']} sessions.",
        f"{facts['table']} lists them with what was drawn.",
    ]
    return facts, lines
