"""Two traits of the same simulated people: prints, and knuckles as the rig sees them; alone and fused.

    nice python validation/match/knuckles.py --work FOLDER                 # 12 people, 5 minutes of one core

Each person's finger is pressed twice (sessions 1 and 2, the model of sensor named below), and its back is captured
twice, in poses of its own, and reconstructed by `metric` without the cut at the crease. Prints are compared by the
default matcher, knuckles by `ridge`, both as they are. FOLDER keeps ``prints.csv`` and ``knuckles.csv``, as
``splitknit evaluate --fuse`` reads them. Intervals of 95 % draw people. All of it is our simulator's.
"""

from __future__ import annotations

import argparse
import csv
import json
import pickle
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from contactless import SENSORS
from fvc import kept
from knuckle import draw_knuckle, knuckle_pose
from pressed_prints import press

import splitknit
import splitknit_match
import splitknit_simulator
from splitknit.model import surface_of
from splitknit_match.evaluation.intervals import BootstrapSettings
from splitknit_match.evaluation.protocol import comparisons
from splitknit_match.matching.fusion import fused_match
from splitknit_match.matching.inputs import print_template
from splitknit_match.matching.ridge import Prepared, ridge_match
from splitknit_match.matching.surface import MatchingSettings, surface_template
from splitknit_match.matching.template import Template
from splitknit_simulator.finger.finger import draw_finger
from splitknit_simulator.scene import TwinSettings

OUT = Path(__file__).with_suffix(".json")
SEED = 99_000
SENSOR = "fvc2004_db2b"


def made(person: int, session: int, folder: Path, scale: float) -> tuple[Template, Template]:
    """Templates of a press and of the knuckle."""
    file = folder / f"person_{person}_{session}.pickle"
    if not file.is_file():
        seed = SEED + person
        pose = knuckle_pose(np.random.default_rng([seed, session, 0xD04]))
        finger, settings = draw_knuckle(seed, session), TwinSettings(scale=scale, pose=pose)
        capture, _ = splitknit_simulator.simulate_capture(seed, settings=settings, impression=session, finger=finger)
        found = splitknit.reconstruct(capture, settings={"cut_at_crease": False})
        knuckle = surface_template(surface_of(found), MatchingSettings())
        kept(file, (print_template(press(draw_finger(seed).master(), session, SENSORS[SENSOR])), knuckle))
    templates: tuple[Template, Template] = pickle.loads(file.read_bytes())
    return templates


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--people", type=int, default=12)
    parser.add_argument("--scale", type=float, default=0.2, help="of the camera")
    parser.add_argument("--write", action="store_true", help=f"write {OUT.name}")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    options.work.mkdir(parents=True, exist_ok=True)
    person, session = np.tile(np.arange(options.people), 2), np.repeat([1, 2], options.people)
    every = [made(int(who), int(when), options.work, options.scale) for who, when in zip(person, session, strict=True)]
    pairs = comparisons(person, session)
    files = []
    for name, place, match in (("prints", 0, fused_match), ("knuckles", 1, ridge_match)):
        sides = [Prepared(one[place]) for one in every]
        files.append(options.work / f"{name}.csv")
        with files[-1].open("w", newline="", encoding="utf-8") as stream:
            rows = csv.writer(stream)
            rows.writerow(["label", "score", "subject_a", "subject_b", "session_a", "session_b"])
            for a, b, genuine in zip(pairs.a, pairs.b, pairs.genuine, strict=True):
                found = match(sides[a], sides[b])
                score = f"{found.similarity:.5f}" if found.compared else ""
                rows.writerow([int(genuine), score, person[a], person[b], session[a], session[b]])
    study = splitknit_match.evaluate(files, fuse="all", bootstrap=BootstrapSettings(targets=(0.01,), curve_points=0))
    facts: dict[str, Any] = {"what": "simulated people", "people": options.people, "rates": {}}
    for one in study.results:
        figures = {"eer": one.eer, "gar_far_1": one.gar_at(0.01)}
        row = {name: [round(100 * v, 1) for v in (f.value, f.low, f.high)] for name, f in figures.items()}
        facts["rates"][one.scores.name] = row | {"d_prime": round(one.intervals.figures["d_prime"].value, 2)}
        print(f"{one.scores.name:16s}", facts["rates"][one.scores.name], flush=True)
    if options.write:
        OUT.write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
