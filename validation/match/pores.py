"""Pores beside ridges: simulated fingers in two sessions, whole and in small windows.

    python validation/match/pores.py --out FOLDER [--fingers 8] [--true] [--write]

One finger each of the first people of a population of its own seed, in sessions 1 and 2 (another pose, skin bent by 0.2
to 0.5 mm, another moisture and exposure; a pore stays where it is and open), scale 0.4 (33 um), ``metric``. Pores are
those of the mean white photograph on the crests of the relief; with ``--true`` the simulator's, which tells the matcher
from the detector. Each finger of a session is compared with each of the other: whole, and with only a disc of it (four
places, 4 and 6 mm across). Scores: ridges alone, pores alone (`pore_match`, laid by the ridges), and the sum of both
after z-normalisation by the impostors of other fingers. Rates at the score that 1 % of the impostors reach, with
Clopper and Pearson's intervals, which take comparisons as independent: those of one finger are not. What is in FOLDER
is not made again.
"""

from __future__ import annotations

import argparse
import itertools
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pore_match import PoreTemplate, pore_match, pore_template
from scipy.special import betaincinv

import splitknit
from splitknit.imaging.geometry import bounding_box
from splitknit.model import Surface
from splitknit_match.matching.ridge import Prepared
from splitknit_match.prints.pores import find_pores
from splitknit_simulator.population.people import FINGERS
from splitknit_simulator.population.sessions import PopulationSettings, population_capture

SEED, SCALE, SESSIONS = 36, 0.4, (1, 2)
DISCS_MM, PLACES = (6.0, 4.0), 4
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


def sides(file: Path, *, true: bool) -> PoreTemplate:
    """Ridges and pores of one capture."""
    data = np.load(file)
    size = (int(data["upright_size"][0]), int(data["upright_size"][1]))
    mask, pitch = data["mask"], float(data["pitch_mm"])
    normals = data["normals"].astype(np.float32)
    surface = Surface(data["ridge_mm"], data["shape_mm"], normals, mask, pitch, data["input_from_upright"], size)
    if true:
        return pore_template(surface, data["true_pores"])
    cache = file.with_name(f"{file.stem}_found.npy")
    if not cache.is_file():
        box = bounding_box(mask)
        found = find_pores(data["photograph"][box], mask[box], pitch, surface.ridge_mm[box])
        np.save(cache, found[:, :2] + [box[1].start, box[0].start])
    return pore_template(surface, np.load(cache))


def disc(side: PoreTemplate, diameter_mm: float, rng: np.random.Generator) -> PoreTemplate:
    """What a small window shows of one finger."""
    template = side.ridges.template
    rows, columns = np.indices(template.valid.shape)
    radius = diameter_mm / 2 / template.pitch_mm
    while True:
        row, column = (rng.uniform(radius, n - radius) for n in template.valid.shape)
        inside = np.hypot(rows - row, columns - column) < radius
        if template.valid[inside].mean() > 0.95:
            break
    box, inside = bounding_box(inside), inside & template.valid
    cut = replace(template, valid=inside[box].copy(), level=np.where(inside, template.level, 0)[box].astype(np.uint8))
    near = np.hypot(side.pores[:, 0] - column, side.pores[:, 1] - row) < radius
    return PoreTemplate(Prepared(cut), side.pores[near] - [box[1].start, box[0].start])


def compared(a: list[PoreTemplate], b: list[PoreTemplate]) -> list[list[float]]:
    """Rows of finger, finger, ridges, pores, number of pores of the first (shown by the second)."""
    rows = []
    for (i, one), (j, other) in itertools.product(enumerate(a), enumerate(b)):
        found = pore_match(one, other)
        rows.append([i, j, found.ridges, found.similarity, found.pores[0]])
    return rows


def rates(rows: np.ndarray) -> dict[str, Any]:
    """Genuine acceptance at 1 % of the impostors and equal error rate, by score."""
    i, j, scores = rows[:, 0], rows[:, 1], rows[:, 2:4]
    fused = np.zeros(len(rows))
    for finger in np.unique(i):
        others = (i != finger) & (j != finger) & (i != j)
        normal = (scores - scores[others].mean(axis=0)) / scores[others].std(axis=0)
        fused[i == finger] = normal[i == finger].sum(axis=1)
    passed = np.zeros((3, int((i == j).sum())), dtype=bool)
    result: dict[str, Any] = {"genuine": int((i == j).sum()), "impostors": int((i != j).sum())}
    for k, (name, score) in enumerate({"ridges": scores[:, 0], "pores": scores[:, 1], "both": fused}.items()):
        genuine, impostor = score[i == j], np.sort(score[i != j])
        at = impostor[int(np.ceil(0.99 * len(impostor))) - 1]
        passed[k] = genuine > at
        good, count = int(passed[k].sum()), len(genuine)
        low = 0.0 if good == 0 else float(betaincinv(good, count - good + 1, 0.025))
        high = 1.0 if good == count else float(betaincinv(good + 1, count - good, 0.975))
        steps = np.concatenate([genuine, impostor])
        eer = min(max((genuine < t).mean(), (impostor >= t).mean()) for t in steps)
        result[name] = {
            "accepted": good, "rate": [good / count, low, high], "eer": float(eer),
            "genuine_median": float(np.median(genuine)), "genuine_least": float(genuine.min()),
            "impostor_median": float(np.median(impostor)), "impostor_largest": float(impostor[-1]),
        }  # fmt: skip
    result["by_ridges_alone"] = int((passed[0] & ~passed[1]).sum())
    result["by_pores_alone"] = int((passed[1] & ~passed[0]).sum())
    return result


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--fingers", type=int, default=8)
    parser.add_argument("--true", action="store_true", help="the simulator's pores instead of found ones")
    parser.add_argument("--write", action="store_true", help="write pores.json beside this file")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    numbers = range(1, options.fingers + 1)
    first, second = ([sides(made(options.out, n, k), true=options.true) for n in numbers] for k in SESSIONS)
    table: dict[str, Any] = {"fingers": options.fingers, "true_pores": options.true}
    table["whole"] = rates(np.array(compared(first, second)))
    print("whole", json.dumps(table["whole"]), flush=True)
    for diameter in DISCS_MM:
        rng = np.random.default_rng(round(10 * diameter))
        rows = []
        for turn in range(2 * PLACES):
            a, b = (first, second) if turn % 2 else (second, first)
            rows += compared([disc(one, diameter, rng) for one in a], b)
        pores = float(np.mean(np.array(rows)[:, 4]))
        table[f"{diameter:g}"] = rates(np.array(rows)) | {"pores_shown": pores}
        print(diameter, json.dumps(table[f"{diameter:g}"]), flush=True)
    if options.write:
        file = Path(__file__).with_name("pores_true.json" if options.true else "pores.json")
        file.write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
