"""The thesis's segmentation and yaw (section 3.3.1.1) beside this package's, on simulated fingers.

    python validation/thesis/outline.py --fingers 24      # writes tables/outline.csv; 4 s a finger

Overlap (intersection over union) of the outline with the true one, and the error of the yaw, at scale 0.3; the mean,
and the worst finger. Intervals of 95 % draw fingers.
"""

from __future__ import annotations

import argparse
import csv
from dataclasses import replace
from pathlib import Path

import numpy as np

import splitknit_simulator
from splitknit.errors import BadInput
from splitknit.finger.locate import find_finger
from splitknit.presets import preset_settings

TABLE = Path(__file__).resolve().parent / "tables/outline.csv"
SCALE, FIRST = 0.3, 3001


def measured(seed: int) -> list[float]:
    """Overlap, grown and by k-means; error of the yaw (deg), by rows of full width and by all; NaN where refused."""
    capture, truth = splitknit_simulator.simulate_capture(seed, settings={"scale": SCALE})
    usual = replace(preset_settings("snk").finding(), cut_at_crease=False)
    ways = [usual, replace(usual, mask=replace(usual.mask, method="kmeans")), replace(usual, yaw="all_rows")]
    found = []
    for settings in ways:
        try:
            found.append(find_finger(capture, settings))
        except BadInput:
            found.append(None)
    masks = [np.nan if one is None else overlap(one.mask, truth["mask"]) for one in found[:2]]
    yaw = float(np.rad2deg(truth["landmark_yaw_rad"]))
    yaws = [np.nan if one is None else abs(one.facts["yaw_deg"] - yaw) for one in (found[0], found[2])]
    return [*masks, *yaws]


def overlap(one: np.ndarray, other: np.ndarray) -> float:
    """Intersection over union."""
    return float((one & other).sum() / max((one | other).sum(), 1))


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fingers", type=int, default=24)
    table = np.array([measured(seed) for seed in range(FIRST, FIRST + parser.parse_args().fingers)])
    rng = np.random.default_rng(0)
    with TABLE.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["figure", "way", "mean", "low", "high", "worst", "refused", "fingers"])
        names = ("overlap,grown", "overlap,kmeans", "yaw_error_deg,full_width", "yaw_error_deg,all_rows")
        for name, values in zip(names, table.T, strict=True):
            known = values[np.isfinite(values)]
            draws = known[rng.integers(0, len(known), (2000, len(known)))].mean(axis=1)
            worst = known.min() if name.startswith("overlap") else known.max()
            figures = [f"{v:.3f}" for v in (known.mean(), *np.quantile(draws, (0.025, 0.975)), worst)]
            writer.writerow([*name.split(","), *figures, len(values) - len(known), len(values)])
            print(name, *figures)


if __name__ == "__main__":
    main()
