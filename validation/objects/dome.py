"""A stranger's dome: how flat does a coin come out, and do two sets of photographs agree on the
lights?

    python validation/objects/dome.py [rendered]

Photographs of a coin of one birr and of an ammonite under one home-made dome ($SPLITKNIT_DATA).
Lights come from both balls and the ground (`calibrate lights`), or from one ball's directions alone
(`reconstruct` asks the ground). Neither the coin's flatness nor the agreement enters a fit. Writes
tables/dome.json: of the coin's rim its rms off a plane (medians of 72 sectors), its tilt, and how
far the middle lies off that plane; of the lights the distance between the two sets' places.

`rendered` compares places with the truth of twelve rendered domes (dome_scene.py), under bare LEDs
and LEDs with a lens, and writes tables/rendered_dome.json: how far the median light of a scene is
off (min, median and max of the scenes), in how many scenes that is below 2 mm, and what fraction of
the lights lies within the stated 95 % interval.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import dome_scene
import numpy as np
from numpy.typing import NDArray

from splitknit.io.light_list import read_light_list

DATA = Path(os.environ.get("SPLITKNIT_DATA", Path(__file__).parents[2].parent / "shared" / "data"))
TABLES = Path(__file__).with_name("tables")
BALLS = {
    "birr": ("163,740.6,39", "2202,795,40"),
    "ammonite": ("122,761,40", "2174,782.5,40"),
}
"""Outlines of the balls in each set: column, row, radius in pixels, drawn by hand."""
PX_PER_MM = 18.0
"""Scale on the coin, which is 27 mm wide. Source: the coin."""
Array = NDArray[np.float64]


def run(*words: object) -> str:
    """What one command of splitknit prints."""
    line = [sys.executable, "-m", "splitknit", *map(str, words)]
    return subprocess.run(line, check=True, capture_output=True, text=True).stdout


def calibrated(images: Path, balls: Sequence[str], out: Path, *more: object) -> dict[str, Any]:
    """Facts of a set's lights by outlined balls; `out` receives their list."""
    words: list[object] = ["--images", images, "--sphere", "chrome", "--out", out, *more]
    for ball in balls:
        words += ["--ball", ball]
    return json.loads(run("calibrate", "lights", *words, "--json"))


def reconstructed(
    images: Path, lights: Path, out: Path, *more: object, px_per_mm: float = PX_PER_MM
) -> Path:
    """The result of a set under a list of lights."""
    words = ["--images", images, "--lights", lights, "--px-per-mm", px_per_mm, "--out", out]
    run("reconstruct", *words, "--keep", *more)
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


def fitted_places(images: Path, lights: Path, result: Path) -> tuple[dict[str, Array], float]:
    """Places by photograph that `reconstruct` fitted to the ground, by number, and half of their
    95 % interval; empty where it took the lights as distant."""
    facts = json.loads((result / "report.json").read_text("utf-8"))["facts"]
    places = np.array(facts.get("light_places_mm", np.zeros((0, 3))))
    if not len(places):
        return {}, 0.0
    distance_mm = float(np.median(np.linalg.norm(places, axis=1)))
    interval_mm = 1.96 * facts["light_places_sd"] * distance_mm
    return dict(zip(numbers(images, lights), places, strict=True)), interval_mm


def numbers(images: Path, lights: Path) -> list[str]:
    """Numbers of the photographs of a list."""
    files = read_light_list(lights).names or sorted(file.name for file in images.iterdir())
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


def photographed() -> dict[str, Any]:
    """The coin's flatness and the agreement of both sets."""
    table: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        fitted, listed = [], []
        for name, balls in BALLS.items():
            images, both = DATA / "dome" / name, work / f"{name}.txt"
            calibrated(images, balls, both, "--px-per-cm", 10 * PX_PER_MM, "--ground")
            places = np.asarray(read_light_list(both).lights)
            listed.append(dict(zip(numbers(images, both), places, strict=True)))
            directions = work / f"{name}.lp"
            calibrated(images, balls[:1], directions)
            result = reconstructed(images, directions, work / f"{name}-directions")
            fitted.append(fitted_places(images, directions, result)[0])
            if name == "birr":
                table["coin, directions alone"] = flatness(result)
                table["coin, balls and ground"] = flatness(
                    reconstructed(images, both, work / "both")
                )
        table["lights of both sets, directions alone"] = agreement(*fitted)
        table["lights of both sets, balls and ground"] = agreement(*listed)
    return table


CASES = {
    "two balls and ground": (2, ("--ground",)),
    "one ball and ground": (1, ("--ground",)),
    "two balls": (2, ()),
}


def of_scene(scene: dome_scene.Dome, images: Path, work: Path) -> dict[str, tuple[Array, Array]]:
    """Distances of a rendered scene's lights from the truth, and half of their stated 95 %
    intervals, in mm; by case, empty where no places are stated."""
    truth = {f"{k:02d}": place for k, place in enumerate(scene.lamps_mm)}
    outlines = scene.outlines()
    px_per_mm = dome_scene.PX_PER_MM
    off = {}
    for case, (balls, more) in CASES.items():
        words = ("--px-per-cm", 10 * px_per_mm, *more)
        leds = calibrated(images, outlines[:balls], work / "lights.txt", *words)["leds"]
        leds = [led for led in leds if led["position_mm"] is not None]
        off[case] = (
            np.array([math.dist(led["position_mm"], truth[led["image"][:2]]) for led in leds]),
            np.array([led["interval_mm"] for led in leds]),
        )
    directions = work / "lights.lp"
    calibrated(images, outlines[:1], directions)
    options = ("--mask", work / "mask.png")
    result = reconstructed(images, directions, work / "result", *options, px_per_mm=px_per_mm)
    places, interval_mm = fitted_places(images, directions, result)
    errors = np.array([math.dist(place, truth[name]) for name, place in places.items()])
    off["directions alone"] = errors, np.full(len(errors), interval_mm)
    return off


def of_scenes(scenes: Sequence[tuple[Array, Array]]) -> dict[str, Any]:
    """Summary of the scenes that state places."""
    stated = [scene for scene in scenes if len(scene[0])]
    row: dict[str, Any] = {"scenes": len(scenes), "with_places": len(stated)}
    if stated:
        medians = [float(np.median(errors)) for errors, _ in stated]
        inside = np.concatenate([errors <= interval for errors, interval in stated])
        row["median_mm"] = [round(f(medians), 2) for f in (min, statistics.median, max)]
        row["below_2_mm"] = sum(median < 2.0 for median in medians)
        row["inside_95"] = round(float(inside.mean()), 3)
    return row


def rendered(seeds: Sequence[int] = range(12), *scene_of: Any) -> dict[str, Any]:
    """Places of the lights of rendered domes against their truth; `scene_of`: number of lamps, and
    how far beside the middle they are aimed."""
    table: dict[str, Any] = {}
    for beam, exponent in (("bare LEDs", dome_scene.BARE), ("LEDs with a lens", dome_scene.LENS)):
        found: dict[str, list[tuple[Array, Array]]] = {}
        for seed in seeds:
            scene = dome_scene.dome(seed, *scene_of)
            with tempfile.TemporaryDirectory() as folder:
                images = Path(folder) / "photographs"
                images.mkdir()
                mask = dome_scene.photographs(scene, exponent, images)
                cv2.imwrite(f"{folder}/mask.png", 255 * mask.astype(np.uint8))
                for case, off in of_scene(scene, images, Path(folder)).items():
                    found.setdefault(case, []).append(off)
        table[beam] = {case: of_scenes(scenes) for case, scenes in found.items()}
    return table


def main() -> None:
    """Measure, and write the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument("what", nargs="?", choices=("photographed", "rendered"))
    is_rendered = parser.parse_args().what == "rendered"
    file = TABLES / ("rendered_dome.json" if is_rendered else "dome.json")
    table = rendered() if is_rendered else photographed()
    file.write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")
    print(file.read_text("utf-8"))


if __name__ == "__main__":
    main()
