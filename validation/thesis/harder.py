"""The population ``hard-1``: fingers whose crease is always in view, on skin and a camera that make
matching difficult.

    python validation/thesis/harder.py --out people                 # 17 people, two sessions
    splitknit batch --cases snk,pr,ea,ea-split,metric --matchers thesis,ridge \\
        --impostors 0.5 --seed 5171 people --out store
    python validation/thesis/run.py cases --population people --store store \\
        --cases snk pr ea ea-split metric --out TABLES      # rates; BENCHMARK.md has them

People, prints and poses are drawn as `splitknit simulate population` draws them. Four things differ:

- no finger is longer than `LONGEST_MM`, and each is laid down to below its first crease
- ridges and pores are worn: the depth of each finger's is reduced by a factor from `WORN`
- half of the captures show dry, flaking skin, the other half moves by `MOTION_MM`
- the camera is a cheap one: fewer electrons at full scale, more noise of reading out

The ranges were fixed before any comparison was made. The same command goes on after a stop.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from splitknit import write_capture
from splitknit.io.atomic import atomic_folder, write_file
from splitknit.io.enrolment import PlannedCapture, fingers_named, open_enrolment
from splitknit.io.provenance import json_text, plain_json, settings_hash
from splitknit.workers import run_jobs
from splitknit_simulator.finger.conditions import Condition
from splitknit_simulator.finger.deformation import deformed, draw_deformation
from splitknit_simulator.finger.motion import HandMotion
from splitknit_simulator.population.people import FINGERS, OwnFinger
from splitknit_simulator.population.sessions import (
    LARGE,
    PopulationSettings,
    SessionRanges,
    draw_impression,
    finger_of_today,
    skin_of_today,
    twin_settings_of,
)
from splitknit_simulator.twin import simulate_capture

SETTINGS = PopulationSettings(seed=5171, scale=0.3, sessions=SessionRanges(partial_share=0.0))
LONGEST_MM = 24.5
"""Longest finger from tip to first crease: the picture shows 29 mm."""
INSERTION_MM = (27.4, 28.4)
"""From the lower border of the picture to the tip."""
WORN = (0.4, 1.0)
"""Depth of a finger's ridges and pores, relative to a sound finger's."""
DRYNESS = (0.3, 1.0)
"""Severity of dry skin, see :class:`splitknit_simulator.finger.conditions.Condition`."""
MOTION_MM = (0.1, 0.5)
"""Largest distance between two shots of a finger that moves."""
FULL_WELL_E = (1000.0, 2500.0)
"""Electrons at full scale, the population of the other figures: 2500 to 4700."""
READ_NOISE_E = (4.0, 8.0)
"""Noise of reading out, there 2.5 to 4."""


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--subjects", type=int, default=17)
    parser.add_argument("--fingers", default=None)
    parser.add_argument("--sessions", type=int, default=2)
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args(arguments)
    enrolment = open_enrolment(
        options.out,
        subjects=options.subjects,
        sessions=options.sessions,
        fingers=fingers_named(options.fingers),
    )
    write_file(options.out / "population.json", population_text())
    work = partial(simulate, out=options.out)
    waiting = sorted(enrolment.waiting(), key=lambda planned: (planned.subject, planned.finger))
    for place, _ in run_jobs(work, waiting, options.jobs, "what is finished"):
        print(place.folder, flush=True)
    return 0


def population_text() -> bytes:
    """What tells this population from any other: all its settings and ranges, with their hash."""
    ranges = {
        "longest_mm": LONGEST_MM,
        "insertion_mm": INSERTION_MM,
        "worn": WORN,
        "dryness": DRYNESS,
        "motion_mm": MOTION_MM,
        "full_well_e": FULL_WELL_E,
        "read_noise_e": READ_NOISE_E,
    }
    settings = plain_json(SETTINGS) | {"harder": ranges}
    document = {"settings": settings, "settings_sha256": settings_hash(settings)}
    return json_text(document).encode("ascii")


def simulate(planned: PlannedCapture, out: Path) -> None:
    """Write one capture with its truth and ``impression.json``."""
    number, name, session = int(planned.subject[1:]), planned.finger, planned.session
    own = capped(SETTINGS.person(number).fingers[name])
    place = (SETTINGS.seed, number, session)
    impression = draw_impression(own, SETTINGS.sessions, SETTINGS.rig().camera, place)
    which = FINGERS.index(name)
    worn = np.random.default_rng([SETTINGS.seed, 0x3A1, number, which]).uniform(*WORN)
    rng = np.random.default_rng([SETTINGS.seed, 0x3A2, number, which, session])
    impression = replace(
        impression,
        insertion_mm=rng.uniform(*INSERTION_MM),
        full_well_e=rng.uniform(*FULL_WELL_E),
        read_noise_e=rng.uniform(*READ_NOISE_E),
        ridge_contrast=impression.ridge_contrast * worn,
    )
    master = own.finger.master()
    slip = draw_deformation(rng, master, impression.deformation_mm, stretch=impression.swelling)
    finger = replace(finger_of_today(own.finger, impression), printed=deformed(master, slip))
    dry = bool(rng.random() < 0.5)
    settings = replace(
        twin_settings_of(SETTINGS, impression),
        scale=SETTINGS.scale,
        skin=skin_of_today(own, impression),
        pose=impression.pose(),
        motion=HandMotion(0.0 if dry else rng.uniform(*MOTION_MM)),
        condition=Condition("dry", rng.uniform(*DRYNESS)) if dry else Condition(),
    )
    seed = int(rng.integers(2**31))
    capture, truth = simulate_capture(seed, None, settings, impression=session, finger=finger)
    subject = {"subject": planned.subject, "finger": name, "session": session}
    identity = {"id": planned.subject, "finger": name, "session": session}
    facts = subject | {
        "partial": False,
        "roll_deg": impression.roll_deg,
        "yaw_deg": impression.yaw_deg,
        "moisture": impression.moisture,
        "worn": worn,
        "dryness": settings.condition.severity if dry else 0.0,
        "motion_mm": settings.motion.amplitude_mm,
    }
    truth = {key: value for key, value in truth.items() if key not in LARGE}
    with atomic_folder(out / planned.folder, overwrite=False) as written:
        write_capture(replace(capture, subject=identity), written, truth, overwrite=True)
        (written / "impression.json").write_text(json_text(facts), encoding="ascii")


def capped(own: OwnFinger) -> OwnFinger:
    """A finger that is no longer than `LONGEST_MM`."""
    shape = own.finger.shape
    shape = replace(shape, length_mm=min(shape.length_mm, LONGEST_MM))
    return replace(own, finger=replace(own.finger, shape=shape))


if __name__ == "__main__":
    sys.exit(main())
