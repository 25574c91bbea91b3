"""``splitknit simulate``: one finger, a population of them, or what calibrates a simulated rig."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from splitknit.cli.verb import Outcome, Progress, add_overwrite, add_settings, natural, new_verb, refuse_given, scale
from splitknit.errors import require


def add_simulate(verbs: Any) -> None:
    """Add ``splitknit simulate``."""
    verb = new_verb(
        verbs,
        "simulate",
        "photograph a simulated finger, a population of them, or what calibrates a simulated rig",
        _run,
    )
    verb.add_argument(
        "what",
        nargs="?",
        choices=("finger", "population"),
        default="finger",
        help="one capture (finger, the default), or many people's fingers in several sessions",
    )
    verb.add_argument("--out", type=Path, required=True, metavar="DIR", help="capture folder to write")
    add_overwrite(verb)
    verb.add_argument("--seed", type=natural, default=0, help="which finger, or which population (default: 0)")
    verb.add_argument(
        "--bench",
        action="store_true",
        help="not a finger, but all that calibrates the rig that person SEED built: board, disc, nail, white card",
    )
    verb.add_argument("--rig", type=Path, metavar="RIG", help="rig file that photographs the finger")
    verb.add_argument("--pattern", help="loop, whorl, arch or another master print the twin knows (default: drawn)")
    verb.add_argument(
        "--print",
        dest="print_file",
        type=Path,
        metavar="FILE",
        help="a real print of 500 pixels an inch, ridges dark, tip up: the finger that left it, instead of a drawn one",
    )
    verb.add_argument("--scale", type=scale, help="size of the images, 1 = 3200 x 2200 pixels (default: the twin's)")
    verb.add_argument(
        "--motion",
        type=float,
        metavar="MM",
        help="the finger moves by MM during the capture, as a hand does that is held still (0.5 is much)",
    )
    verb.add_argument(
        "--lights",
        choices=("white", "coloured", "coloured9"),
        default="white",
        help="LEDs of the visible band: seven white ones (the default), or six or nine coloured ones, of which a red, "
        "a green and a blue one share an exposure",
    )
    verb.add_argument(
        "--condition",
        choices=("none", "wet", "dry", "dusty", "scarred", "glossy"),
        help="what is the matter with the finger's skin (default: none)",
    )
    verb.add_argument("--severity", type=float, metavar="S", help="of the condition: 0 (nothing) to 1 (default: 1)")
    verb.add_argument(
        "--mirrors",
        metavar="NAMES",
        help="mirrors beside the finger, seen in the same picture: left, right, tip, or several with commas between",
    )
    verb.add_argument("--no-nir", action="store_true", help="a rig with mirrors does without NIR LEDs")
    verb.add_argument(
        "--impression", type=natural, default=0, help="which capture of the finger: pose and noise change (default: 0)"
    )
    add_settings(verb)
    _add_population_options(verb)


def _run(options: argparse.Namespace) -> Outcome:
    from splitknit.cli.options import read_changes
    from splitknit.simulator.twin import simulate_to_folder

    if options.what == "population":
        return _run_population(options)
    refuse_given(options, _OPTIONS, "is for 'splitknit simulate population'.")
    changes = read_changes(options.settings, options.assignments)
    if options.bench:
        of_fingers = ("pattern", "rig", "print_file", "motion", "condition", "mirrors", "no_nir")
        also = ("impression",) if options.impression else ()
        refuse_given(options, (*of_fingers, *also), "does not go with --bench, which has no finger.")
    if options.motion is not None:
        changes = {**changes, "motion.amplitude_mm": options.motion}
    require(
        options.severity is None or options.condition not in (None, "none"),
        "--severity sets how bad a --condition is; name one.",
    )
    if options.condition is not None:
        worst = {} if options.severity is None else {"condition.severity": options.severity}
        changes = {**changes, "condition.kind": options.condition, **worst}
    changes = _mirror_changes(options) | changes
    if options.lights != "white":
        require(not options.bench, "--bench and --lights do not go together: what is calibrated has white LEDs.")
    if options.bench:
        return _run_bench(options, changes)
    with Progress(options) as progress:
        facts = simulate_to_folder(
            options.out,
            seed=options.seed,
            pattern=options.pattern,
            scale=options.scale,
            rig=options.rig,
            lights=options.lights,
            impression=options.impression,
            print_file=options.print_file,
            changes=changes,
            overwrite=options.overwrite,
            progress=progress.update,
        )
    rows, columns = facts["image_size"]
    lines = [
        f"Simulated capture of a {facts['pattern']} written to {options.out}: "
        f"{facts['images']} images of {columns} x {rows} pixels, with truth.",
        f"Next: splitknit reconstruct {options.out} --out RESULT"
        + (" --preset lin" if options.lights != "white" else ""),
    ]
    return facts, lines


def _mirror_changes(options: argparse.Namespace) -> dict[str, Any]:
    """Settings that ``--mirrors`` and ``--no-nir`` stand for."""
    changes: dict[str, Any] = {}
    if options.mirrors is not None:
        changes["mirrors.names"] = tuple(part.strip() for part in options.mirrors.split(","))
    if options.no_nir:
        require(
            options.mirrors is not None or options.rig is not None,
            "--no-nir needs --mirrors: without mirrors the shape of the finger comes from its NIR images.",
        )
        changes["mirrors.nir"] = False
    return changes


def _run_bench(options: argparse.Namespace, changes: Mapping[str, Any]) -> Outcome:
    """Write the photographs that calibrate a simulated rig."""
    from splitknit.settings import override
    from splitknit.simulator.bench_photos import BenchPhotos, bench_to_folder

    photos = override(BenchPhotos(), changes)
    with Progress(options) as progress:
        facts = bench_to_folder(
            options.out,
            seed=options.seed,
            scale=options.scale or 0.5,
            photos=photos,
            overwrite=options.overwrite,
            progress=progress.update,
        )
    out = options.out
    lines = [
        f"The bench of rig {facts['seed']} written to {out}: {facts['boards']} photographs of a board of "
        f"{facts['board']} inner corners and {facts['square_mm']:g} mm, the nail in {facts['nails']} places, a card.",
        f"Next: splitknit calibrate camera {out}/board --board {facts['board']} --plane {out}/plane.png "
        f"--rig {out}/rig_drawn.json --out rig.json",
    ]
    return facts, lines


DEFAULT_WORKERS = 2
_OPTIONS = ("subjects", "fingers", "sessions", "workers", "prints")


def _add_population_options(verb: argparse.ArgumentParser) -> None:
    """Add what only a population knows."""
    group = verb.add_argument_group("population")
    group.add_argument("--subjects", type=natural, metavar="N", help="people (default: 17)")
    group.add_argument("--fingers", metavar="LIST", help="all (default), or names with commas, such as right_index")
    group.add_argument("--sessions", type=natural, metavar="N", help="captures a finger (default: 4)")
    group.add_argument(
        "--prints",
        type=Path,
        metavar="FOLDER",
        help="real prints of 500 pixels an inch, FINGER_IMPRESSION.png, tip up, ridges dark: the ridges of a third of "
        "the fingers, one print for each; with mirror images where they are too few",
    )
    group.add_argument("--workers", type=natural, metavar="N", help=f"processes (default: {DEFAULT_WORKERS})")


def _run_population(options: argparse.Namespace) -> Outcome:
    """Simulate a population, or what of it is missing."""
    from splitknit.batch.simulate import simulate_population
    from splitknit.capture.enrolment import FINGERS
    from splitknit.cli.options import read_changes
    from splitknit.settings import override
    from splitknit.simulator.population.sessions import PopulationSettings

    names = ("pattern", "rig", "motion", "condition", "severity", "mirrors", "bench", "no_nir", "overwrite")
    also = ("impression",) if options.impression else ()
    refuse_given(options, (*names, *also, "print_file"), "does not go with a population.")
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
            prints=options.prints,
            workers=DEFAULT_WORKERS if options.workers is None else options.workers,
            progress=progress.update,
        )
    each = facts["seconds_per_capture"]
    speed = f", {each:.1f} s each" if each is not None else ""
    lines = [
        f"{facts['simulated']} captures simulated now{speed}, {facts['found']} were there; {facts['total']} in "
        f"{options.out}: {facts['subjects']} subjects, {len(facts['fingers'])} fingers, {facts['sessions']} sessions.",
        *_prints_words(facts),
        f"{facts['table']} lists them with what was drawn.",
    ]
    return facts, lines


def _prints_words(facts: Mapping[str, Any]) -> list[str]:
    """How many fingers have a real print's ridges."""
    if not facts["prints"]:
        return []
    fingers = facts["subjects"] * len(facts["fingers"])
    mirrored = f", {facts['prints_mirrored']} of them mirrored" if facts["prints_mirrored"] else ""
    return [f"{facts['prints']} of {fingers} fingers have the ridges of a real print{mirrored}."]
