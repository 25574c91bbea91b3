"""Sweat pores, found and true, at pixels of 26 and 13 um: reliefs and photographs of simulated fingers.

    python validation/published/pores_found.py --out FOLDER [--fingers 6] [--scales 0.5 1.0] [--write]

Pores are sought on the true relief, on the reliefs of ``metric`` and ``snk``, and on the mean white photograph. A pore
is found if one lies within 0.1 mm of it. Skin counts that faces the camera within 45 deg, 0.5 mm inside the mask.
Chance: the same pores, all shifted by 0.45 mm. Intervals of 95 % draw fingers. A finger that is in FOLDER is not made
again; ``--write`` writes ``pores_found.json``. The threshold of `find_pores` was chosen on another seed (6101).
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from pores import find_pores

sys.path.append(str(Path(__file__).resolve().parents[1] / "prints"))
from agreement_compare import paired

import splitknit
import splitknit_simulator

REACH_MM, BORDER_MM, CHANCE_MM = 0.1, 0.5, 0.45
SLANT_COS = float(np.cos(np.deg2rad(45)))


def figures(seed: int, scale: float) -> dict[str, Any]:
    """Counts by what pores are sought on: true pores, found ones, both, and both by chance."""
    capture, truth = splitknit_simulator.simulate_capture(seed, settings={"scale": scale})
    results = {name: splitknit.reconstruct(capture, name) for name in ("metric", "snk")}
    metric = results["metric"]
    pitch = metric.pitch_mm
    assert pitch is not None
    photograph = capture.bands["white"].pixels.astype(np.float32).mean(axis=(0, 3))
    reliefs = {"truth": truth["relief_um"], **{name: one.ridge_mm for name, one in results.items()}}
    seen = metric.mask & (metric.normals[..., 2] > SLANT_COS)
    size = 2 * round(BORDER_MM / pitch) + 1
    seen &= cv2.erode(metric.mask.astype(np.uint8), np.ones((size, size), np.uint8)) > 0
    found = {name: find_pores(relief, metric.mask & np.isfinite(relief), pitch) for name, relief in reliefs.items()}
    found["photograph"] = find_pores(photograph, metric.mask, pitch, metric.ridge_mm)
    true = inside(truth["landmark_pores_px"], seen)
    return {name: counts(inside(one[:, :2], seen), true, pitch) for name, one in found.items()}


def inside(places: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Those of (N, 2) columns and rows that lie where it is measured."""
    column, row = np.rint(np.asarray(places, dtype=np.float64)).astype(np.intp).T
    held = (column >= 0) & (row >= 0) & (column < seen.shape[1]) & (row < seen.shape[0])
    held[held] = seen[row[held], column[held]]
    return np.asarray(places, dtype=np.float64)[held]


def counts(found: np.ndarray, true: np.ndarray, pitch: float) -> dict[str, int]:
    """How many are true, found, both, and both where the found ones are shifted."""
    reach, shift = REACH_MM / pitch, CHANCE_MM / pitch
    return {
        "true": len(true),
        "found": len(found),
        "both": len(paired(found, true, reach)[0]),
        "chance": len(paired(found + shift, true, reach)[0]),
    }


def rates(rows: list[dict[str, int]]) -> dict[str, list[float]]:
    """Recall, precision and precision by chance in %, over fingers, with intervals that draw fingers."""
    table = np.array([[row[name] for name in ("true", "found", "both", "chance")] for row in rows], dtype=np.float64)
    rng = np.random.default_rng(len(rows))
    draws = table[rng.integers(0, len(table), (1000, len(table)))].sum(axis=1)
    sums = np.vstack([table.sum(axis=0), draws])
    made = {"recall": sums[:, 2] / sums[:, 0]}
    with np.errstate(invalid="ignore"):
        made |= {"precision": sums[:, 2] / sums[:, 1], "by chance": sums[:, 3] / sums[:, 1]}
    return {
        name: [round(100 * float(v), 1) for v in (value[0], *np.nanquantile(value[1:], (0.025, 0.975)))]
        for name, value in made.items()
    }


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--fingers", type=int, default=6)
    parser.add_argument("--scales", type=float, nargs="+", default=(0.5, 1.0))
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    table: dict[str, Any] = {}
    for scale in options.scales:
        rows = []
        for seed in range(6001, 6001 + options.fingers):
            file = options.out / f"{seed}_{scale:g}.json"
            if not file.is_file():
                text = json.dumps(figures(seed, scale))
                file.write_text(text, encoding="utf-8")
            rows.append(json.loads(file.read_text(encoding="utf-8")))
        table[f"{scale:g}"] = {name: rates([row[name] for row in rows]) for name in rows[0]}
        for name, row in table[f"{scale:g}"].items():
            print(f"{scale:g} {name:12}", *(f"{key} {v[0]} [{v[1]}, {v[2]}]" for key, v in row.items()))
    if options.write:
        Path(__file__).with_suffix(".json").write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
