"""Templates of many simulated fingers for the codes of 1:N search, cheaply: true surfaces, no pictures.

    python validation/match/code_fingers.py --seed 7001 --people 400 --sessions 3 --out FOLDER

Every person gives one finger (the ten in turn). Poses, rolls, insertions, swelling and skin deformation are those of
the population (``splitknit simulate population``); the master print covers what lies above the first crease and has no
pores, and surfaces are seen at 0.15 of full scale. The files (``SEED_FIRST.npz``, 50 people each) are made once: what
is there is not made again.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from splitknit.finger.orientation import find_upright
from splitknit.io.atomic import atomic_file
from splitknit.model import Surface, default_rig
from splitknit_match.matching.surface import MatchingSettings, surface_template
from splitknit_match.matching.template import Template, pack, unpack
from splitknit_simulator.finger.deformation import deformed, draw_deformation
from splitknit_simulator.finger.finger import finger_surface
from splitknit_simulator.population.people import FINGERS, draw_person
from splitknit_simulator.population.sessions import SessionRanges, draw_impression, finger_of_today

SCALE = 0.15
CHUNK = 50
PHALANGE_MM = (17.0, 23.0)
"""Of each impression so much is used, from the tip on, drawn evenly: what reconstructions keep."""


def templates_of(seed: int, number: int, sessions: int) -> list[Template]:
    """Impressions of one finger of the person `number`."""
    ranges, camera = SessionRanges(), default_rig(SCALE).camera
    own = draw_person(seed, number).fingers[FINGERS[number % len(FINGERS)]]
    settings = own.finger.print_settings
    settings = replace(settings, pitch_mm=min(0.05, settings.period_mm / 8.0), proximal_mm=2.0)
    master = replace(own.finger, print_settings=settings).master()
    found = []
    for session in range(1, sessions + 1):
        impression = draw_impression(own, ranges, camera, (seed, number, session))
        rng = np.random.default_rng([seed, 0xC0DE, number, session])
        skin = draw_deformation(
            rng, master, impression.deformation_mm, ranges.deformation_smooth_mm, impression.swelling
        )
        seen = finger_surface(
            replace(finger_of_today(own.finger, impression), printed=deformed(master, skin)),
            impression.pose(),
            camera,
            workers=1,
        )
        first = int(np.argmax(seen.mask.any(axis=1)))
        mask = seen.mask.copy()
        mask[first + round(rng.uniform(*PHALANGE_MM) * camera.px_per_mm) :] = False
        upright = find_upright(mask)
        surface = Surface(
            seen.height_mm - seen.shape_mm, seen.shape_mm, seen.normals, mask, camera.pitch_mm,
            upright.input_from_upright, upright.size,
        )  # fmt: skip
        found.append(surface_template(surface, MatchingSettings()))
    return found


def make(folder: Path, seed: int, people: int, sessions: int) -> None:
    """Write the templates of the people 1 to `people` of the population `seed`, in files of 50 people."""
    folder.mkdir(parents=True, exist_ok=True)
    for first in range(1, people + 1, CHUNK):
        target = folder / f"{seed}_{first:05d}.npz"
        if target.is_file():
            continue
        payloads, owners = [], []
        for number in range(first, first + CHUNK):
            for template in templates_of(seed, number, sessions):
                payloads.append(np.frombuffer(pack(template), dtype=np.uint8))
                owners.append(number)
        lengths = np.array([len(payload) for payload in payloads])
        with atomic_file(target) as file:
            np.savez(file, payload=np.concatenate(payloads), length=lengths, owner=np.array(owners))
        print(target.name, flush=True)


def load(folder: Path, seed: int, people: int | None = None) -> tuple[list[Template], list[int]]:
    """Templates and their owners' numbers, of the people who are there (or of the first `people`)."""
    templates, owners = [], []
    for file in sorted(folder.glob(f"{seed}_*.npz")):
        with np.load(file) as arrays:
            ends = np.cumsum(arrays["length"])
            payload, owner = arrays["payload"], arrays["owner"]
        for start, end, number in zip(ends - np.diff(ends, prepend=0), ends, owner.tolist(), strict=True):
            if people is None or number <= people:
                templates.append(unpack(payload[start:end].tobytes()))
                owners.append(number)
    return templates, owners


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--people", type=int, required=True)
    parser.add_argument("--sessions", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    make(options.out, options.seed, options.people, options.sessions)


if __name__ == "__main__":
    main()
