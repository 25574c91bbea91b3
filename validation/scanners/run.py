"""The same simulated fingers by every scanner: `python validation/scanners/run.py [--fingers 24]
[--system NAME]`.

Every finger and system is written to --out, with the scanner's cloud (``1-stripes.xyz``, for
``cloud.py``), and not measured twice. `--tables` prints the table (as in ``tables/``) behind
docs/experiments/scanners.md from what is there.
"""

from __future__ import annotations

import argparse
import itertools
import json
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import simulated as sim
import structured_light
from cloud import result_of_points
from scipy.stats import binomtest

import splitknit
import splitknit_match
import splitknit_simulator
from splitknit.model import FloatArray

FINE_PERIOD = 12.0
"""Period in projector rows, finer than ridges."""
FRAME_S = 1 / 30


def colour_stripes(finger: sim.Fingers) -> sim.Scan:
    """One exposure a period, the three steps in its three colours, and an evenly lit one."""
    sight = finger.at(0)
    lamp = sim.projector()
    series, light = [], 0.0
    for k, channel in enumerate(("red", "green", "blue")):
        radiance, brightest, unit = sight.even(channel, lamp)
        flat = np.maximum(sight.record(radiance, brightest), 0.01)
        shots = list(
            sight.light(channel, lamp, [sim.stripe(period, k, 3) for period in sim.PERIODS])
        )
        series.append([sight.record(shot, brightest) / flat for shot, _ in shots])
        light += (1 + sum(shot for _, shot in shots) / unit) / 3
    images = np.swapaxes(np.array(series), 0, 1) * sight.surface.mask
    begun = time.process_time()
    cloud, _ = structured_light.scan(sight.view, lamp, structured_light.decode(images, sim.PERIODS))
    return cloud, light, time.process_time() - begun


SYSTEMS: dict[str, tuple[Callable[[sim.Fingers], sim.Scan], str, int, int, float]] = {
    "stripes": (sim.stripes, "Structured light, 3 periods x 6 steps, blue", 3, 650, 18 * FRAME_S),
    "stripes-fine": (
        lambda f: sim.stripes(f, "blue", (*sim.PERIODS, FINE_PERIOD)),
        "Structured light, a fourth period of 0.36 mm, blue",
        3,
        650,
        24 * FRAME_S,
    ),
    "colour-stripes": (
        colour_stripes,
        "Three-colour fringes, 3 periods, 4 exposures",
        3,
        650,
        4 * FRAME_S,
    ),
    "laser": (sim.laser_line, "Laser line, red, 0.1 mm a step", 4, 450, 264 * FRAME_S),
    "focus": (sim.depth_from_focus, "Depth from focus, 20 pictures", 4, 400, 20 * FRAME_S),
    "stereo2": (lambda f: sim.cameras(f, (-9.0, 9.0)), "Stereo, two cameras", 4, 300, FRAME_S),
    "stereo5": (sim.cameras, "Stereo, five cameras", 7, 550, FRAME_S),
    "hull": (sim.hull, "Visual hull, six cameras", 8, 620, FRAME_S),
}
"""How, name, parts, price in EUR (both estimated), seconds of capture at 30 frames a second."""


def on_grid(points: FloatArray, shape: tuple[int, int], pitch: float) -> splitknit.Reconstruction:
    """A result on the pixels of the thesis's camera: its corners, far below, fix the grid."""
    x, y = (shape[1] - 1) / 2 * pitch, (shape[0] - 1) / 2 * pitch
    points = points[
        (np.abs(points[:, 0]) < x) & (np.abs(points[:, 1]) < y) & (np.abs(points[:, 2]) < 30)
    ]
    corners = np.array([[a, b, -40.0] for a in (-x, x) for b in (-y, y)], np.float32)
    return result_of_points(np.concatenate([points, corners]).astype(np.float32), pitch, 0.0)


def fused(
    coarse: splitknit.Reconstruction, ridges: splitknit.Reconstruction
) -> splitknit.Reconstruction:
    """Shape of one, relief of the other."""
    from dataclasses import replace

    mask = coarse.mask & ridges.mask
    height = np.where(mask, coarse.shape_mm + ridges.ridge_mm, np.nan)
    return replace(ridges, mask=mask, shape_mm=coarse.shape_mm, height_mm=height)


KEEP = (
    "surface_rms_mm",
    "ridge_correlation",
    "ridge_gain",
    "ridge_rms_um",
    "ridge_truth_std_um",
    "ridge_area_mm2",
    "ridge_good_area",
)


def measure(seed: int, names: list[str], out: Path) -> None:
    todo = [name for name in (*names, "metric") if not (out / f"{seed}-{name}.json").exists()]
    if not todo:
        return
    settings = {"scale": sim.SCALE}
    capture, truth = splitknit_simulator.simulate_capture(seed, settings=settings)
    own = out / f"{seed}-metric"
    if "metric" in todo:
        begun = time.process_time()
        metric = splitknit.reconstruct(capture, "metric")
        facts = {"compute_s": time.process_time() - begun, "capture_s": 14 * 0.17, "light": 14.0}
        facts |= {
            k: float(v)
            for k, v in splitknit_simulator.compare(metric, truth).figures.items()
            if k in KEEP
        }
        metric.save(own)
        second, _ = splitknit_simulator.simulate_capture(seed, settings=settings, impression=1)
        splitknit.reconstruct(second, "metric").save(out / f"{seed}-second")
        (out / f"{seed}-metric.json").write_text(json.dumps(facts))
    metric = splitknit.read_result(own)
    finger = sim.Fingers(seed)
    for name in todo:
        if name == "metric":
            continue
        how = SYSTEMS[name][0]
        cloud, light, seconds = how(finger)
        np.savetxt(out / f"{seed}-{name}.xyz", cloud, "%.4f")
        begun = time.process_time()
        try:
            result = on_grid(cloud, metric.mask.shape, metric.pitch_mm)
        except splitknit.BadInput as refusal:
            (out / f"{seed}-{name}.json").write_text(json.dumps({"refused": str(refusal)}))
            print(seed, name, refusal, flush=True)
            continue
        facts = {"compute_s": seconds + time.process_time() - begun, "light": light}
        facts |= {
            k: float(v)
            for k, v in splitknit_simulator.compare(result, truth).figures.items()
            if k in KEEP
        }
        facts["fused_surface_rms_mm"] = splitknit_simulator.compare(
            fused(result, metric), truth
        ).figures["surface_rms_mm"]
        result.save(out / f"{seed}-{name}")
        (out / f"{seed}-{name}.json").write_text(json.dumps(facts))
        print(seed, name, {k: round(v, 3) for k, v in facts.items()}, flush=True)


def rates(out: Path, seeds: list[int], name: str) -> dict[str, tuple[float, bool]]:
    """Scans against second captures by `metric`, every pair: the matcher `ridge`, its similarity
    and its decision."""
    path = out / f"rates-{name}.json"
    kept = json.loads(path.read_text()) if path.exists() else {}
    template = cache(lambda folder: splitknit_match.make_template(folder).payload)
    for a, b in itertools.product(seeds, seeds):
        if f"{a}-{b}" not in kept:
            sides = out / f"{a}-{name}", out / f"{b}-second"
            try:
                match = splitknit_match.match(*map(template, sides), "ridge", fmr=1e-3)
                kept[f"{a}-{b}"] = float(match.similarity), bool(match.decision.match)
            except splitknit.BadInput:  # refused as a cloud, or too little of it to compare
                kept[f"{a}-{b}"] = 0.0, False
    path.write_text(json.dumps(kept))
    return kept


def interval(hits: int, tried: int) -> str:
    """Fraction with the 95 % interval of Clopper and Pearson, per cent."""
    low, high = binomtest(hits, tried).proportion_ci(method="exact")
    return f"{hits} of {tried} ({100 * low:.0f} to {100 * high:.0f} %)"


def tables(out: Path, seeds: list[int]) -> None:
    """Print the table: means over the fingers whose cloud is accepted, rates over all."""
    print(f"{len(seeds)} fingers")
    names = {"metric": ("", "`metric`", 17, 306, 2.4)} | SYSTEMS
    for name, (_, title, parts, price, capture) in names.items():
        rows = [json.loads((out / f"{seed}-{name}.json").read_text()) for seed in seeds]
        rows = [row for row in rows if "refused" not in row]
        mean = {key: float(np.mean([row[key] for row in rows])) for key in rows[0]}
        spread = float(np.std([1e3 * row["surface_rms_mm"] for row in rows], ddof=1))
        fusion = (
            f"{1e3 * mean['fused_surface_rms_mm']:.0f}" if "fused_surface_rms_mm" in mean else "-"
        )
        cells = [
            title,
            str(len(rows)),
            f"{1e3 * mean['surface_rms_mm']:.0f} +- {spread:.0f}",
            f"{mean['ridge_correlation']:.2f}",
            f"{mean['ridge_gain']:.2f}",
            f"{mean['ridge_rms_um']:.0f}",
            f"{mean['ridge_area_mm2']:.0f}",
            f"{100 * mean['ridge_good_area']:.0f}",
            fusion,
            f"{capture:.2g}",
            f"{mean['compute_s']:.1f}",
            f"{mean['light']:.1f}",
            str(parts),
            str(price),
        ]
        scores = rates(out, seeds, name)
        genuine = [scores[f"{k}-{k}"][1] for k in seeds]
        others = [scores[f"{a}-{b}"][1] for a, b in itertools.permutations(seeds, 2)]
        cells += [interval(sum(genuine), len(genuine)), interval(sum(others), len(others))]
        print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fingers", type=int, default=24)
    parser.add_argument("--system", choices=[*SYSTEMS], action="append")
    parser.add_argument("--out", type=Path, default=Path("build/scanners"))
    parser.add_argument(
        "--tables", action="store_true", help="match what was measured, and print the tables only"
    )
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    if options.tables:
        tables(options.out, list(range(1, options.fingers + 1)))
    for seed in range(1, options.fingers + 1) if not options.tables else ():
        measure(seed, options.system or [*SYSTEMS], options.out)
