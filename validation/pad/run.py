"""Presentation attack detection on simulated captures: `python validation/pad/run.py [--live 230] [--each 19]`.

Captures are simulated, reconstructed and measured one by one; each is written to --out and not made twice. Then
`--score` prints the tables of docs/experiments/pad.md from what is there, leaving out one species at a time, and
`--write` fits the shipped model, src/splitknit/data/pad.json, to all of it.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import cv2
import numpy as np
from attacks import SPECIES, simulate_attack

import splitknit
from splitknit.pad import pad_features, pad_images
from splitknit.simulator.twin import twin_settings

SCALE = 0.2
CONDITIONS = ("wet", "dry", "dusty", "scarred", "glossy")


def measure(name: str, seed: int, out: Path, scale: float = SCALE) -> None:
    """One capture: its features, or why there is no result."""
    path = out / f"{name}-{seed}.json"
    if path.exists():
        return
    changes: dict[str, object] = {"render.workers": 1}
    rng = np.random.default_rng([seed, 0xAD])
    state = "clean"
    if name == "live" and rng.random() < 0.3:
        state = str(rng.choice(CONDITIONS))
        changes |= {"condition.kind": state, "condition.severity": float(rng.uniform(0.1, 0.6))}
    changes["films.kind"] = "analyser" if out.name.endswith("films") else "none"
    settings = twin_settings(scale, changes)
    capture, _ = simulate_attack(seed, name, settings)
    facts: dict[str, object] = {"name": name, "seed": seed, "state": state}
    try:
        facts["features"] = pad_features(pad_images(capture), splitknit.reconstruct(capture, "metric"))
    except splitknit.BadInput as error:
        facts["failed"] = str(error)
    path.write_text(json.dumps(facts))
    print(name, seed, state, facts.get("failed", ""), flush=True)


def simulate(out: Path, live: int, each: int, scale: float) -> None:
    """Live fingers and instruments of all species side by side, so that every stop leaves a fair mixture."""
    copies = [(name, 5000 + 100 * k + j) for j in range(each) for k, name in enumerate(SPECIES)]
    fingers = [("live", 1000 + j) for j in range(live)]
    for pair in itertools.zip_longest(fingers, copies):
        for job in filter(None, pair):
            measure(*job, out, scale)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("validation/out/pad"))
    parser.add_argument("--live", type=int, default=230)
    parser.add_argument("--each", type=int, default=19, help="instruments of each species")
    parser.add_argument("--scale", type=float, default=SCALE)
    parser.add_argument("--score", action="store_true", help="print the tables from what is there")
    parser.add_argument("--write", action="store_true", help="fit the shipped model to what is there")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    options.out.mkdir(parents=True, exist_ok=True)
    if options.score or options.write:
        import model  # needs scikit-learn (extra `pad`)

        rows = model.read(options.out)
        print("\n".join(model.table(rows) if options.score else [model.ship(rows)]))
    else:
        simulate(options.out, options.live, options.each, options.scale)
