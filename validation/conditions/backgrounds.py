"""Segmentation and ridges before coloured paper: ``python validation/conditions/backgrounds.py
SCRATCH``.

Six simulated fingers before the twin's black background and before black, green, blue and purple
paper (the thesis, section 4.1.2); presets metric and snk. A row of SCRATCH/backgrounds.jsonl is one
preset on one capture; running it again goes on. The table is written to ``tables/backgrounds.csv``,
black paper less green, finger by finger, to ``tables/black_green.csv``.
"""

from __future__ import annotations

import argparse
import csv
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import stats
from summary import interval

from splitknit.capture import Capture
from splitknit.errors import BadInput
from splitknit.finger.locate import SURVEY_PX_PER_MM, enlarged_mask
from splitknit.finger.mask import finger_mask
from splitknit.observation.observe import observe
from splitknit.pipeline import reconstruct
from splitknit_simulator.accuracy import compare
from splitknit_simulator.light.renderer import RenderSettings
from splitknit_simulator.scene import BackgroundSettings, TwinSettings
from splitknit_simulator.twin import simulate_capture

SEEDS = (7301, 7302, 7303, 7304, 7305, 7306)
SCALE = 0.35
COLOURS = {
    "the twin's black": None,
    "black paper": (0.045, 0.045, 0.045, 0.06),
    "green paper": (0.08, 0.30, 0.12, 0.75),
    "blue paper": (0.06, 0.14, 0.40, 0.70),
    "purple paper": (0.25, 0.08, 0.32, 0.75),
}
"""Reflectance in red, green, blue and NIR. Assumed: dyed papers take their colour from the dye,
which is transparent in NIR; black paper holds soot, which is not."""
FIGURES = {
    "iou": "{:.4f}",  # overlap of mask and truth
    "border_mm": "{:.2f}",  # worst distance of the outlines
    "ridge_correlation": "{:.3f}",
    "ridge_gain": "{:.2f}",
    "normals_mean_deg": "{:.1f}",
    "shape_rms_mm": "{:.3f}",
}
TABLE = Path(__file__).with_name("tables") / "backgrounds.csv"
DIFFERENCES = TABLE.with_name("black_green.csv")


def segmentation(capture: Capture, truth: NDArray[np.bool_]) -> dict[str, float]:
    """Overlap and worst distance of the outline from the truth's, in mm, where it does not run
    along the border."""
    px_per_mm = capture.rig.camera.px_per_mm
    binning = max(1, int(px_per_mm / SURVEY_PX_PER_MM))
    mean, _ = observe(capture).white.at(binning).survey()
    mask = enlarged_mask(finger_mask(mean, px_per_mm / binning), capture.shape, binning)
    distances = [_farthest(first, second) for first, second in ((mask, truth), (truth, mask))]
    return {
        "iou": float((mask & truth).sum() / (mask | truth).sum()),
        "border_mm": max(distances) / px_per_mm,
    }


def _farthest(first: NDArray[np.bool_], second: NDArray[np.bool_]) -> float:
    """Largest distance in pixels from the outline of one mask to that of the other."""
    edges = [
        mask & ~cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
        for mask in (first, second)
    ]
    to_second = cv2.distanceTransform(
        (~edges[1]).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE
    )
    return float(to_second[edges[0]].max())


def rows_of(seed: int, background: str, presets: list[str]) -> list[dict[str, Any]]:
    """What segmentation and every preset make of one capture."""
    settings = TwinSettings(
        scale=SCALE,
        render=RenderSettings(workers=1),
        background=BackgroundSettings(colour=COLOURS[background]),
    )
    capture, truth = simulate_capture(seed, settings=settings)
    row: dict[str, Any] = {"seed": seed, "background": background}
    try:
        row |= segmentation(capture, truth["mask"])
    except BadInput as refusal:
        return [{**row, "preset": preset, "refused": str(refusal)} for preset in presets]
    rows = []
    for preset in presets:
        try:
            figures = compare(reconstruct(capture, preset), truth).figures
            rows.append(
                {
                    **row,
                    "preset": preset,
                    **{name: figures[name] for name in FIGURES if name in figures},
                }
            )
        except BadInput as refusal:
            rows.append({**row, "preset": preset, "refused": str(refusal)})
    return rows


def table(rows: list[dict[str, Any]]) -> list[list[str]]:
    """Medians over fingers with 95 % intervals."""
    ends = ("", "_low", "_high")
    lines = [["background", "preset", "fingers", *(name + end for name in FIGURES for end in ends)]]
    for background in COLOURS:
        for preset in sorted({row["preset"] for row in rows}):
            rows_of_preset = [
                row for row in rows if (row["background"], row["preset"]) == (background, preset)
            ]
            good = [row for row in rows_of_preset if "refused" not in row]
            cells = [background, preset, f"{len(good)} of {len(rows_of_preset)}"]
            for name, form in FIGURES.items():
                values = np.array([row[name] for row in good])
                cells += [form.format(value) for value in (np.median(values), *interval(values))]
            lines.append(cells)
    return lines


def differences(rows: list[dict[str, Any]]) -> list[list[str]]:
    """Black paper less green, finger by finger: means with Student's 95 %."""
    lines = [["preset", "what", "fingers", "mean"]]
    by_key = {(row["background"], row["preset"], row["seed"]): row for row in rows}
    for preset in sorted({row["preset"] for row in rows}):
        for name, form in FIGURES.items():
            values = [
                by_key["black paper", preset, seed][name]
                - by_key["green paper", preset, seed][name]
                for seed in SEEDS
            ]
            centre = float(np.mean(values))
            reach = float(stats.t.ppf(0.975, len(values) - 1) * stats.sem(values))
            signed = form.replace(":", ":+")
            mean, low, high = (
                signed.format(end) for end in (centre, centre - reach, centre + reach)
            )
            lines.append([preset, name, str(len(values)), f"{mean} [{low}, {high}]"])
    return lines


def main() -> None:
    """Simulate, segment, reconstruct, append, write the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scratch", type=Path)
    parser.add_argument("--presets", nargs="+", default=["metric", "snk"])
    options = parser.parse_args()
    options.scratch.mkdir(parents=True, exist_ok=True)
    kept = options.scratch / "backgrounds.jsonl"
    rows = [json.loads(line) for line in kept.read_text().splitlines()] if kept.is_file() else []
    done = {(row["seed"], row["background"], row["preset"]) for row in rows}
    for seed in SEEDS:
        for background in COLOURS:
            missing = [
                preset for preset in options.presets if (seed, background, preset) not in done
            ]
            for row in rows_of(seed, background, missing) if missing else []:
                rows.append(row)
                with kept.open("a") as file:
                    file.write(json.dumps(row) + "\n")
                print(json.dumps(row), flush=True)
    for place, lines in ((TABLE, table(rows)), (DIFFERENCES, differences(rows))):
        with place.open("w", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows(lines)


if __name__ == "__main__":
    main()
