"""One simulated finger, a population of them, or what calibrates a simulated rig, into a folder."""

from __future__ import annotations

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from splitknit.arguments import (
    AnyPath,
    Natural,
    Progress,
    Report,
    Scale,
    Settings,
    checked,
    refuse_given,
    silent,
)
from splitknit.errors import require

_OF_POPULATIONS = Parameter(group="Population")


@checked
def simulate(
    what: Literal["finger", "population"] = "finger",
    *,
    out: AnyPath,
    overwrite: bool = False,
    seed: Natural = 0,
    bench: bool = False,
    rig: AnyPath | None = None,
    pattern: str | None = None,
    print_file: Annotated[AnyPath | None, Parameter("--print")] = None,
    rolled: bool = False,
    scale: Scale | None = None,
    motion: float | None = None,
    lights: Literal["white", "coloured", "coloured9"] = "white",
    condition: Literal["none", "wet", "dry", "dusty", "scarred", "glossy"] | None = None,
    severity: float | None = None,
    mirrors: str | None = None,
    nir: Annotated[bool, Parameter(negative="--no-nir")] = True,
    impression: Natural = 0,
    settings: Settings = None,
    subjects: Annotated[Natural | None, _OF_POPULATIONS] = None,
    fingers: Annotated[str | None, _OF_POPULATIONS] = None,
    sessions: Annotated[Natural | None, _OF_POPULATIONS] = None,
    prints: Annotated[AnyPath | None, _OF_POPULATIONS] = None,
    workers: Annotated[Natural | None, _OF_POPULATIONS] = None,
    progress: Progress = silent,
) -> Report:
    """Photograph a simulated finger, a population of them, or what calibrates a simulated rig.

    Parameters
    ----------
    what
        One capture (finger, the default), or many people's fingers in several sessions
        (population).
    out
        Capture folder to write.
    overwrite
        Replace an earlier capture in `out`.
    seed
        Which finger, or which population.
    bench
        Not a finger, but all that calibrates the rig that person `seed` built: board, disc, nail,
        white card.
    rig
        Rig file that photographs the finger.
    pattern
        loop, whorl, arch or another master print the twin knows (default: drawn).
    print_file
        A real print of 500 pixels an inch, ridges dark, tip up: the finger that left it, instead of
        a drawn one.
    rolled
        The print was rolled from nail to nail, down to the first crease: its outline sizes the
        finger.
    scale
        Size of the images, 1 = 3200 x 2200 pixels (default: the twin's).
    motion
        The finger moves by so many mm during the capture, as a hand does that is held still (0.5 is
        much).
    lights
        LEDs of the visible band: seven white ones (the default), or six or nine coloured ones, of
        which a red, a green and a blue one share an exposure.
    condition
        What is the matter with the finger's skin (default: none).
    severity
        Of the condition: 0 (nothing) to 1 (default: 1).
    mirrors
        Mirrors beside the finger, seen in the same picture: left, right, tip, or several with
        commas between.
    nir
        --no-nir: leave out the NIR LEDs; mirrors give the shape.
    impression
        Which capture of the finger: pose and noise change.
    subjects
        People (default: 17).
    fingers
        All (default), or names with commas, such as right_index.
    sessions
        Captures a finger (default: 4).
    prints
        Folder of real prints of 500 pixels an inch, FINGER_IMPRESSION.png, tip up, ridges dark: the
        ridges of a third of the fingers, one print for each; with mirror images where they are too
        few.
    workers
        Processes (default: 2).

    Returns
    -------
    Report

    Raises
    ------
    BadInput
        Naming the argument or the file at fault; nothing is written.

    Examples
    --------
    >>> simulate(out="capture", seed=1, scale=0.1).facts["images"]  # doctest: +SKIP
    14
    """
    of_a_finger = {
        "pattern": pattern,
        "rig": rig,
        "print_file": print_file,
        "rolled": rolled,
        "motion": motion,
        "condition": condition,
        "mirrors": mirrors,
        "nir": not nir,
        "impression": impression or None,
    }
    if what == "population":
        why = "does not go with a population."
        refuse_given(why, **of_a_finger, severity=severity, bench=bench, overwrite=overwrite)
        population = {} if scale is None else {"scale": scale}
        return _population(
            Path(out),
            {"seed": seed, **(settings or {}), **population},
            fingers,
            subjects=subjects,
            sessions=sessions,
            prints=None if prints is None else Path(prints),
            workers=2 if workers is None else workers,
            progress=progress,
        )
    why = "is for 'splitknit simulate population'."
    refuse_given(
        why, subjects=subjects, fingers=fingers, sessions=sessions, workers=workers, prints=prints
    )
    if bench:
        refuse_given("does not go with `bench`, which has no finger.", **of_a_finger)
    changes = dict(settings or {})
    if motion is not None:
        changes["motion.amplitude_mm"] = motion
    named = severity is None or condition not in (None, "none")
    require(named, "`severity` sets how bad a `condition` is; name one.")
    if condition is not None:
        changes["condition.kind"] = condition
    if severity is not None:
        changes["condition.severity"] = severity
    if mirrors is not None:
        changes.setdefault("mirrors.names", tuple(part.strip() for part in mirrors.split(",")))
    if not nir:
        shaped = mirrors is not None or rig is not None
        require(
            shaped,
            "`nir` needs `mirrors`: without mirrors the shape of the finger comes from its NIR"
            " images.",
        )
        changes.setdefault("mirrors.nir", False)
    if bench:
        together = "`bench` and `lights` do not go together: what is calibrated has white LEDs."
        require(lights == "white", together)
        return _bench(
            Path(out),
            changes,
            seed=seed,
            scale=scale or 0.5,
            overwrite=overwrite,
            progress=progress,
        )

    from splitknit import write_capture
    from splitknit.io.atomic import atomic_folder
    from splitknit.io.targets import check_capture
    from splitknit_simulator.twin import (
        finger_of_print,
        rig_settings,
        simulate_capture,
        twin_settings,
    )

    started, folder = time.perf_counter(), Path(out)
    require(
        rig is None or scale is None,
        "the rig file says how large the images are; leave out the scale.",
    )
    twin = rig_settings(twin_settings(scale, changes), None if rig is None else Path(rig), lights)
    require(
        print_file is not None or not rolled,
        "`rolled` describes a real print; name its file (`print_file`).",
    )
    require(
        print_file is None or pattern is None,
        "a print has a pattern of its own; leave out the pattern.",
    )
    finger = None if print_file is None else finger_of_print(Path(print_file), seed, rolled=rolled)
    check_capture(folder, overwrite=overwrite)
    with atomic_folder(folder, overwrite=overwrite) as target:
        progress("simulating", 0.0)
        capture, truth = simulate_capture(seed, pattern, twin, impression=impression, finger=finger)
        progress("writing", 0.8)
        write_capture(capture, target, truth, overwrite=True)
    progress("done", 1.0)
    facts = {
        "out": str(out),
        "seed": seed,
        "pattern": str(truth.get("landmark_pattern", pattern or "finger")),
        "images": sum(len(band.leds) for band in capture.bands.values()),
        "image_size": list(capture.shape),
        "px_per_mm": capture.rig.camera.px_per_mm,
        "total_s": time.perf_counter() - started,
    }
    rows, columns = capture.shape
    images = f"{facts['images']} images of {columns} x {rows} pixels, with truth."
    preset = " --preset lin" if lights != "white" else ""
    return Report(
        facts,
        (
            f"Simulated capture of a {facts['pattern']} written to {out}: {images}",
            f"Next: splitknit reconstruct {out} --out RESULT{preset}",
        ),
    )


def _bench(out: Path, changes: Mapping[str, Any], **how: Any) -> Report:
    """Photograph a bench; `how`: see :func:`splitknit_simulator.bench_photos.bench_to_folder`."""
    from splitknit.settings import override
    from splitknit_simulator.bench_photos import BenchPhotos, bench_to_folder

    facts = bench_to_folder(out, photos=override(BenchPhotos(), changes), **how)
    return Report(
        facts,
        (
            (
                f"The bench of rig {facts['seed']} written to {out}: {facts['boards']} photographs"
                f" of a board of {facts['board']} inner corners and {facts['square_mm']:g} mm, the"
                f" nail in {facts['nails']} places, a card."
            ),
            (
                f"Next: splitknit calibrate camera {out}/board --board {facts['board']} --plane"
                f" {out}/plane.png --rig {out}/rig_drawn.json --out rig.json"
            ),
        ),
    )


def _population(out: Path, changes: Mapping[str, Any], fingers: str | None, **how: Any) -> Report:
    """Simulate a population; `how`: see
    :func:`splitknit_simulator.population.folder.simulate_population`."""
    from splitknit.io.enrolment import fingers_named
    from splitknit.settings import override
    from splitknit_simulator.population.folder import simulate_population
    from splitknit_simulator.population.sessions import PopulationSettings

    population = override(PopulationSettings(), changes)
    facts = simulate_population(out, population, fingers=fingers_named(fingers), **how)
    each = facts["seconds_per_capture"]
    speed = f", {each:.1f} s each" if each is not None else ""
    people = (
        f"{facts['subjects']} subjects, {len(facts['fingers'])} fingers, {facts['sessions']}"
        " sessions"
    )
    lines = [
        f"{facts['simulated']} captures simulated now{speed}, {facts['found']} were there;"
        f" {facts['total']} in {out}: {people}."
    ]
    if facts["prints"]:
        count = facts["subjects"] * len(facts["fingers"])
        lines.append(f"{facts['prints']} of {count} fingers have the ridges of a real print.")
    lines.append(f"{facts['table']} lists them with what was drawn.")
    return Report(facts, tuple(lines))
