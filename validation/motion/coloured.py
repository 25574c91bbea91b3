"""What coloured LEDs are for: fewer exposures, so that a finger has less time to move.

    python validation/motion/coloured.py                  # resumable: simulates and measures what is missing
    python validation/motion/coloured.py --summary        # prints what is there, and writes tables/coloured.csv

The same hands hold the same fingers under seven white LEDs (seven exposures), nine coloured ones (three) and six (two).
The drift is a random walk, so that over fewer exposures it goes less far: each capture has the amplitude that its
number of exposures has on average where fourteen have `--amplitude`. Reconstructed by the preset `lin` (`ea` with
coloured lights) and `ea`, and, for what a better reconstruction makes of seven exposures, by `metric`. Writes
``coloured.json`` beside this file; the fingers are those of ``run.py``.
"""

from __future__ import annotations

import argparse
import csv
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from captures import OUT, SCALE, SEEDS
from measure import figures, loaded, undone
from run import interval, rounded

from splitknit import reconstruct
from splitknit.errors import BadInput
from splitknit.io.capture import write_capture
from splitknit.model import Rig, default_rig
from splitknit_simulator.finger.motion import HandMotion
from splitknit_simulator.light.renderer import RenderSettings
from splitknit_simulator.rigs import coloured_rig
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import simulate_capture

RESULTS = Path(__file__).resolve().parent / "coloured.json"
TABLE = Path(__file__).resolve().parent / "tables" / "coloured.csv"
SHOTS_IN_ALL = 14
LIGHTS: Mapping[str, tuple[int, tuple[str, ...]]] = {
    "seven white": (7, ("ea-split", "metric")),
    "nine coloured": (3, ("lin",)),
    "six coloured": (2, ("lin",)),
}
"""Exposures, and presets."""


def rig_of(lights: str, seed: int, scale: float) -> Rig:
    """The rig without its NIR LEDs."""
    exposures = LIGHTS[lights][0]
    rig = default_rig(scale, seed) if lights == "seven white" else coloured_rig(scale, seed, exposures=exposures)
    return replace(rig, leds=tuple(led for led in rig.leds if led.band == "white"))


def farthest(shots: int, draws: int = 20000) -> float:
    """Mean largest distance between two of `shots` places of a random walk in the plane, in its steps."""
    path = np.cumsum(np.random.default_rng(1).standard_normal((draws, shots, 2)), axis=1)
    apart = [np.linalg.norm(path[:, i] - path[:, j], axis=1) for i in range(shots) for j in range(i)]
    return float(np.max(apart, axis=0).mean())


def amplitude_of(lights: str, whole_mm: float) -> float:
    """Amplitude over a capture's exposures of a hand that moves by `whole_mm` in fourteen."""
    return round(whole_mm * farthest(LIGHTS[lights][0]) / farthest(SHOTS_IN_ALL), 4)


def capture_folder(lights: str, seed: int, whole_mm: float, scale: float) -> Path:
    """Folder of a capture with truth; it is simulated where it is missing."""
    folder = OUT / f"{lights.replace(' ', '_')}_{seed}_{whole_mm:g}_{scale:g}"
    if not (folder / "truth.npz").is_file():
        motion = HandMotion(amplitude_mm=amplitude_of(lights, whole_mm))
        settings = TwinSettings(
            scale=scale, rig=rig_of(lights, seed, scale), motion=motion, render=RenderSettings(workers=1)
        )
        capture, truth = simulate_capture(seed, None, settings)
        kept = {name: value for name, value in truth.items() if not name.startswith(("glare", "relief"))}
        write_capture(capture, folder, kept, overwrite=True)
    return folder


def measured(lights: str, seed: int, whole_mm: float, scale: float) -> dict[str, Any]:
    """One finger under some lights, still and moving, by every preset."""
    row: dict[str, Any] = {"lights": lights, "seed": seed, "amplitude_mm": amplitude_of(lights, whole_mm)}
    still, still_truth = loaded(capture_folder(lights, seed, 0.0, scale))
    moving, truth = loaded(capture_folder(lights, seed, whole_mm, scale))
    without_motion = undone(moving, truth)
    for preset in LIGHTS[lights][1]:
        off = {"motion.correct": "off"}
        found: dict[str, Any] = {
            "still": figures(reconstruct(still, preset), still_truth)["ridge_correlation"],
            "uncorrected": figures(reconstruct(moving, preset, off), truth)["ridge_correlation"],
            "oracle": figures(reconstruct(without_motion, preset, off), truth)["ridge_correlation"],
        }
        try:
            result = reconstruct(moving, preset)
        except BadInput as error:
            found["refused"] = str(error)
        else:
            found["corrected"] = figures(result, truth)["ridge_correlation"]
            found["undone"] = "motion" in result.facts
        row[preset] = found
    return row


def table(results: dict[str, Any]) -> list[list[str]]:
    """Rows of the table, its head first: ridge correlation, mean and 95 % interval over the fingers."""
    kinds = ("still", "uncorrected", "corrected", "oracle")
    found_rows = [["lights, preset", "exposures", "motion, mm", "fingers", "undone", "refused", *kinds]]
    for lights, (exposures, presets) in LIGHTS.items():
        rows = [row for row in results["rows"] if row["lights"] == lights]
        for preset in presets if rows else ():
            found = [row[preset] for row in rows]
            counts = [len(rows), sum(f.get("undone", False) for f in found), sum("refused" in f for f in found)]
            cells = [interval([f[kind] for f in found if kind in f]) for kind in kinds]
            first = [f"{lights}, {preset}", exposures, f"{rows[0]['amplitude_mm']:.2f}", *counts]
            found_rows.append([str(cell) for cell in (*first, *cells)])
    return found_rows


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, then print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=SEEDS)
    parser.add_argument("--amplitude", type=float, default=0.5, help="mm, over fourteen shots")
    parser.add_argument("--scale", type=float, default=SCALE)
    parser.add_argument("--out", type=Path, default=RESULTS)
    parser.add_argument("--summary", action="store_true", help="print the table, measure nothing")
    options = parser.parse_args(arguments)
    done = {"scale": options.scale, "amplitude_mm": options.amplitude, "rows": []}
    if options.out.is_file():
        done = json.loads(options.out.read_text())
        if (done["scale"], done["amplitude_mm"]) != (options.scale, options.amplitude):
            raise SystemExit(f"{options.out} holds results of another scale or amplitude; name another with --out.")
    for seed in () if options.summary else options.seeds:
        for lights in LIGHTS:
            if not any((row["seed"], row["lights"]) == (seed, lights) for row in done["rows"]):
                done["rows"].append(rounded(measured(lights, seed, options.amplitude, options.scale)))
                options.out.write_text(json.dumps(done, indent=1) + "\n")
                print(seed, lights, flush=True)
    rows = table(done)
    print("\n".join(" | ".join(row) for row in rows))
    if options.out == RESULTS:
        TABLE.parent.mkdir(exist_ok=True)
        with TABLE.open("w", encoding="ascii", newline="") as stream:
            csv.writer(stream, lineterminator="\n").writerows(rows)


if __name__ == "__main__":
    main()
