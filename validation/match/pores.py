"""Pores beside ridges: simulated fingers in two sessions, whole and in small windows.

    python validation/match/pores.py --out FOLDER [--fingers 16] [--write]

One finger each of people 1 to 16 of a population of its own seed, in sessions 1 and 2 (another pose, skin bent by 0.2
to 0.5 mm, another moisture and exposure; a pore stays where it is and open), scale 0.4 (33 um), ``metric``. Pores are
those of the mean white photograph (`surface_pores`). Each finger of session 1 is compared with each of session 2:
whole, and with only a disc of that of session 2 (four places each, of 4 and 6 mm across). Scores: ridges alone
(`ridge_match`), pores alone (`pore_match` on the alignment by ridges), and their logistic regression, fitted on the
other fingers (ten groups of people). With true places of pores, too, to tell the matcher from the detector.
Captures that are in FOLDER are not made again.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

import splitknit
from splitknit.simulator.population.people import FINGERS
from splitknit.simulator.population.sessions import PopulationSettings, population_capture

SEED, SCALE, SESSIONS = 36, 0.4, (1, 2)
FIELDS = ("ridge_mm", "shape_mm", "normals", "mask")


def made(folder: Path, number: int, session: int) -> Path:
    """A file with the reconstruction, the mean photograph and the true pores of one capture."""
    file = folder / f"{number}_{session}.npz"
    if not file.is_file():
        settings = PopulationSettings(seed=SEED, scale=SCALE)
        shown = population_capture(settings, settings.person(number), FINGERS[number % len(FINGERS)], session)
        result = splitknit.reconstruct(shown.capture, "metric")
        photograph = shown.capture.bands["white"].pixels.astype(np.float32).mean(axis=(0, 3))
        arrays: dict[str, Any] = {name: getattr(result, name) for name in FIELDS}
        arrays |= {"normals": result.normals.astype(np.float16), "photograph": photograph}
        arrays |= {"pitch_mm": result.pitch_mm, "input_from_upright": result.input_from_upright}
        arrays |= {"upright_size": result.upright_size, "true_pores": shown.truth["landmark_pores_px"]}
        with file.with_suffix(".part").open("wb") as stream:
            np.savez_compressed(stream, **arrays)
        file.with_suffix(".part").rename(file)
    return file


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--fingers", type=int, default=16)
    parser.add_argument("--write", action="store_true", help="write pores.json beside this file")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for number in range(1, options.fingers + 1):
        for session in SESSIONS:
            made(options.out, number, session)
            print(number, session, flush=True)


if __name__ == "__main__":
    main()
