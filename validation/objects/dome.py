"""A stranger's dome: how flat does a coin come out, and do two sets of photographs agree on the
lights?

    python validation/objects/dome.py

Photographs of a coin of one birr and of an ammonite under one home-made dome ($SPLITKNIT_DATA).
Lights come from both balls and the ground (`calibrate lights`), or from one ball's directions alone
(`reconstruct` asks the ground). Neither the coin's flatness nor the agreement enters a fit. Writes
tables/dome.json: of the coin's rim its rms off a plane (medians of 72 sectors), its tilt, and how
far the middle lies off that plane; of the lights the distance between the two sets' places.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.io.light_list import read_light_list

DATA = Path(os.environ.get("SPLITKNIT_DATA", Path(__file__).parents[2].parent / "shared" / "data"))
TABLE = Path(__file__).with_name("tables") / "dome.json"
BALLS = {
    "birr": ("163,740.6,39", "2202,795,40"),
    "ammonite": ("122,761,40", "2174,782.5,40"),
}
"""Outlines of the balls in each set: column, row, radius in pixels, drawn by hand."""
PX_PER_MM = 18.0
"""Scale on the coin, which is 27 mm wide. Source: the coin."""
Array = NDArray[np.float64]


def run(*words: object) -> None:
    """One command of splitknit."""
    line = [sys.executable, "-m", "splitknit", *map(str, words)]
    subprocess.run(line, check=True, capture_output=True)


def calibrated(name: str, balls: Sequence[str], out: Path) -> Path:
    """The list of a set's lights by one outlined ball, or by more and the ground."""
    words: list[object] = ["--images", DATA / "dome" / name, "--sphere", "chrome", "--out", out]
    for ball in balls:
        words += ["--ball", ball]
    if len(balls) > 1:
        words += ["--px-per-cm", 10 * PX_PER_MM, "--ground"]
    run("calibrate", "lights", *words)
    return out


def reconstructed(name: str, lights: Path, out: Path) -> Path:
    """The result of a set under a list of lights."""
    images = DATA / "dome" / name
    words = ["--images", images, "--lights", lights, "--px-per-mm", PX_PER_MM, "--out", out]
    run("reconstruct", *words, "--keep")
    return out


def flatness(result: Path) -> dict[str, float]:
    """Of the coin in a result."""
    with np.load(result / "height.npz") as arrays:
        height, mask = arrays["height_mm"].astype(np.float64), arrays["mask"]
    rows, columns = np.nonzero(mask)
    middle = [(each.min() + each.max()) / 2 for each in (columns, rows)]
    radius = (np.ptp(columns) + np.ptp(rows)) / 4
    row, column = np.indices(height.shape)
    x, y = column - middle[0], row - middle[1]
    part = np.hypot(x, y) / radius
    rim = (part > 0.9) & (part < 0.965) & np.isfinite(height)
    sector = np.floor((np.arctan2(y, x)[rim] + np.pi) * (36 / np.pi)).astype(int) % 72
    chosen = [np.flatnonzero(sector == k) for k in range(72)]
    places = np.array([[np.mean(x[rim][k]), np.mean(y[rim][k]), 1.0] for k in chosen])
    levels = np.array([np.median(height[rim][k]) for k in chosen])
    plane = np.linalg.lstsq(places, levels, rcond=None)[0]
    inner = (part < 0.55) & np.isfinite(height)
    off = height - (plane[0] * x + plane[1] * y + plane[2])
    return {
        "rim_um": round(1000 * float(np.std(levels - places @ plane)), 1),
        "tilt_deg": round(float(np.rad2deg(np.hypot(*plane[:2]) * PX_PER_MM)), 2),
        "middle_mm": round(float(np.median(off[inner])), 3),
    }


def fitted_places(name: str, lights: Path, result: Path) -> dict[str, Array]:
    """Places by photograph that `reconstruct` fitted to the ground, by number."""
    facts = json.loads((result / "report.json").read_text("utf-8"))["facts"]
    return dict(zip(numbers(name, lights), np.array(facts["light_places_mm"]), strict=True))


def numbers(name: str, lights: Path) -> list[str]:
    """Numbers of the photographs of a list."""
    files = read_light_list(lights).names or sorted(
        file.name for file in (DATA / "dome" / name).iterdir()
    )
    return [Path(file).stem.rpartition("_")[2] for file in files]


def agreement(first: dict[str, Array], second: dict[str, Array]) -> dict[str, float]:
    """Distances of the places of two sets, mm."""
    both = sorted(set(first) & set(second))
    apart = np.linalg.norm([first[k] - second[k] for k in both], axis=1)
    return {
        "lights": len(both),
        "median_mm": round(float(np.median(apart)), 2),
        "rms_mm": round(float(np.sqrt(np.mean(apart**2))), 2),
    }


def main() -> None:
    """Measure, and write the table."""
    argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0]).parse_args()
    table: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        fitted, listed = [], []
        for name, balls in BALLS.items():
            list_of_both = calibrated(name, balls, work / f"{name}.txt")
            places = np.asarray(read_light_list(list_of_both).lights)
            listed.append(dict(zip(numbers(name, list_of_both), places, strict=True)))
            directions = calibrated(name, balls[:1], work / f"{name}.lp")
            result = reconstructed(name, directions, work / f"{name}-directions")
            fitted.append(fitted_places(name, directions, result))
            if name == "birr":
                table["coin, directions alone"] = flatness(result)
                table["coin, balls and ground"] = flatness(
                    reconstructed(name, list_of_both, work / "both")
                )
        table["lights of both sets, directions alone"] = agreement(*fitted)
        table["lights of both sets, balls and ground"] = agreement(*listed)
    TABLE.write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")
    print(TABLE.read_text("utf-8"))


if __name__ == "__main__":
    main()
