"""Accuracy under coloured LEDs (Lin) and of Zheng's photometric stereo, beside the thesis's baseline and `metric`.

    python validation/published/lights.py --work DIR [--fingers 6] [--scale 0.4] [--out lights.json]

Every finger is photographed three times in the same pose: under seven white LEDs, and under six and nine coloured ones.
Records are kept in DIR, one a finger, so that a run that was stopped goes on. Nothing was tuned on these fingers.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.accuracy import compare
from splitknit.finger.locate import find_finger
from splitknit.imaging.band import linear_stack
from splitknit.io.atomic import atomic_file
from splitknit.model import COLOURS, Capture
from splitknit.photometric.lambertian import left_out
from splitknit.pipeline import reconstruct
from splitknit.presets import preset_settings
from splitknit_simulator.rigs import coloured_rig
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import simulate_capture

FIRST_SEED = 4100
KEPT = ("normals_mean_deg", "ridge_correlation", "ridge_gain", "ridge_rms_um", "shape_rms_mm", "ridge_good_area")
BAND_MM = 0.32
Truth = Mapping[str, NDArray[Any]]


def without_crosstalk(capture: Capture) -> Capture:
    """The capture as a rig file reads it without crosstalk."""
    bands = {name: replace(band, crosstalk=None) for name, band in capture.bands.items()}
    rig = replace(capture.rig, camera=replace(capture.rig.camera, crosstalk=None))
    return replace(capture, rig=rig, bands=bands)


def ridge_contrast(capture: Capture, truth: Truth) -> dict[str, float]:
    """Ridge band of the images of each colour, over their mean, in per cent: what the skin's blur leaves of it."""
    band, mask = capture.bands["white"], np.asarray(truth["mask"], dtype=np.bool_)
    inner = cv2.erode(mask.astype(np.uint8), np.ones((9, 9), np.uint8), borderValue=0) > 0
    stack = linear_stack(band, capture.encoding)
    sigma = BAND_MM * capture.rig.camera.px_per_mm
    found: dict[str, list[float]] = {colour: [] for colour in COLOURS}
    for image, group in zip(stack, band.lights, strict=True):
        mean = cv2.GaussianBlur(image, (0, 0), sigma)
        lit = inner & (mean > 0.2 * float(np.quantile(mean[inner], 0.9)))
        ridges = (cv2.GaussianBlur(image, (0, 0), 1.0) - mean)[lit] / mean[lit]
        found[capture.rig.leds[group[0]].colour].append(100 * float(np.sqrt(np.mean(ridges**2))))
    return {colour: float(np.mean(values)) for colour, values in found.items()}


def spread_of_sets(capture: Capture, truth: Truth) -> dict[str, float]:
    """Normals of the seven leave-one-out sets: error of each against the truth (mean), and among themselves."""
    finger = find_finger(capture, preset_settings("zheng"))
    white, window = capture.bands["white"], finger.window
    stack = np.maximum(linear_stack(white, capture.encoding, "grey", window), np.float32(0))
    mask = finger.mask[window] & np.asarray(truth["mask"][window], dtype=np.bool_)
    true = np.asarray(truth["normals"][window][mask], dtype=np.float64)
    sets = [normals[mask] for normals, _ in left_out(stack, capture.rig.select(white.lights).light_vectors(), mask)]
    mean = np.sum(sets, axis=0)
    mean /= np.linalg.norm(mean, axis=1, keepdims=True)

    def angle(a: NDArray[Any], b: NDArray[Any]) -> float:
        return float(np.rad2deg(np.arccos(np.clip((a * b).sum(axis=1), -1, 1))).mean())

    return {
        "sets_mean_deg": float(np.mean([angle(one, true) for one in sets])),
        "mean_of_sets_deg": angle(mean, true),
        "among_sets_deg": float(np.mean([angle(one, mean) for one in sets])),
    }


def finger_record(seed: int, scale: float) -> dict[str, Any]:
    """All figures of one finger."""
    record: dict[str, Any] = {"seed": seed, "cases": {}}

    def case(name: str, capture: Capture, truth: Truth, preset: str, changes: dict[str, Any] | None = None) -> None:
        figures = compare(reconstruct(capture, preset, changes), truth).figures
        record["cases"][name] = {key: round(float(figures[key]), 4) for key in KEPT}

    white, truth = simulate_capture(seed, None, TwinSettings(scale=scale))
    case("metric", white, truth, "metric")
    case("ea", white, truth, "ea")
    case("zheng", white, truth, "zheng")
    case("lin, put together from white", white, truth, "lin")
    record["zheng"] = spread_of_sets(white, truth)
    for count, exposures in ((6, 2), (9, 3)):
        settings = TwinSettings(rig=coloured_rig(scale, 0, exposures=exposures))
        coloured, facts = simulate_capture(seed, None, settings)
        case(f"lin, {count} coloured LEDs", coloured, facts, "lin")
        if count == 6:
            case("lin, 6, colours not balanced", coloured, facts, "lin", {"lights.balance": False})
            case("lin, 6, crosstalk not known", without_crosstalk(coloured), facts, "lin")
            record["ridge_contrast"] = ridge_contrast(coloured, facts)
    return record


def summary(records: list[dict[str, Any]]) -> dict[str, Any]:
    """Mean over fingers with its 95 % interval (fingers drawn with replacement), and paired differences from ea."""
    rng = np.random.default_rng(1)
    drawn = rng.integers(0, len(records), (1000, len(records)))

    def interval(values: NDArray[np.float64]) -> list[float]:
        low, high = np.percentile(values[drawn].mean(axis=1), [2.5, 97.5])
        return [round(float(v), 4) for v in (values.mean(), low, high)]

    result: dict[str, Any] = {"fingers": len(records), "cases": {}, "less_ea": {}}
    for name in records[0]["cases"]:
        for table, base in (("cases", None), ("less_ea", "ea")):
            rows = {}
            for key in KEPT:
                values = np.array([one["cases"][name][key] for one in records])
                if base is not None:
                    values = values - np.array([one["cases"][base][key] for one in records])
                rows[key] = interval(values)
            result[table][name] = rows
    for part in ("zheng", "ridge_contrast"):
        result[part] = {key: interval(np.array([one[part][key] for one in records])) for key in records[0][part]}
    return result


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--fingers", type=int, default=6)
    parser.add_argument("--scale", type=float, default=0.4)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".json"))
    options = parser.parse_args()
    options.work.mkdir(parents=True, exist_ok=True)
    records = []
    for seed in range(FIRST_SEED, FIRST_SEED + options.fingers):
        file = options.work / f"{seed}-{options.scale:g}.json"
        if not file.is_file():
            with atomic_file(file) as stream:
                stream.write(json.dumps(finger_record(seed, options.scale)).encode("ascii"))
        records.append(json.loads(file.read_text(encoding="ascii")))
        print(seed, flush=True)
    document = {"scale": options.scale, "summary": summary(records), "records": records}
    options.out.write_text(json.dumps(document, indent=1) + "\n", encoding="ascii")


if __name__ == "__main__":
    main()
