"""What JPEG takes from the relief of simulated fingers, by scale and quality.

    python validation/jpeg/measure.py [--fingers 2]

Writes tables/loss.csv. The photographs are those of our simulator, brought to 8 bits sRGB, and through JPEG (4:2:0) or
not; both are reconstructed by `metric`. `gain` is the height of the ridges over those without JPEG, `rest` the rms
difference over the rms relief, where the finger faces the camera. `stated` is what the uncertainty holds for it.
"""

from __future__ import annotations

import argparse
import csv
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

import splitknit
from splitknit.imaging.band import linear_image, srgb_code
from splitknit_simulator import simulate_capture

TABLES = Path(__file__).with_name("tables")
FIRST, SCALES, QUALITIES = 700, (0.15, 0.2, 0.25, 0.4), (60, 85, 92, 97)


def stored(capture, quality: int | None):
    """The capture in 8 bits sRGB, by JPEG of this quality."""
    bands = {}
    for name, band in capture.bands.items():
        images = []
        for image, black in zip(band.pixels, band.black_level, strict=True):
            light = np.clip(linear_image(image, capture.encoding, 1.0, float(black)), 0.0, 1.0)
            code = np.rint(255.0 * srgb_code(light)).astype(np.uint8)
            if quality is not None:
                made = cv2.imencode(".jpg", code[..., ::-1].squeeze(), [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
                code = cv2.imdecode(made, cv2.IMREAD_UNCHANGED)
                code = (code if code.ndim == 3 else code[..., None])[..., ::-1]
            images.append(np.ascontiguousarray(code))
        bands[name] = replace(band, pixels=np.stack(images), black_level=np.zeros(len(images)), ambient=None)
    return replace(capture, bands=bands, encoding="srgb")


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fingers", type=int, default=2)
    rows = []
    for seed in range(FIRST, FIRST + parser.parse_args().fingers):
        for scale in SCALES:
            capture, _ = simulate_capture(seed, settings={"scale": scale})
            before = splitknit.reconstruct(stored(capture, None))
            facing = before.mask & (before.normals[..., 2] > 0.7)
            for quality in QUALITIES:
                after = splitknit.reconstruct(stored(capture, quality), settings={"keep": True})
                both = facing & after.mask
                one, other = before.ridge_mm[both].astype(float), after.ridge_mm[both].astype(float)
                gain = float(one @ other / (one @ one))
                rest = float(np.sqrt(np.mean((one - other) ** 2) / np.mean(one**2)))
                share = np.sqrt(np.mean((after.uncertainty_um[both] / 1000) ** 2) / np.mean(other**2))
                row = (
                    seed,
                    capture.rig.camera.px_per_mm,
                    quality,
                    gain,
                    rest,
                    float(share),
                    after.facts.get("jpeg", False),
                )
                rows.append([*row[:1], *(f"{value:.3f}" if isinstance(value, float) else value for value in row[1:])])
                sys.stdout.write(" ".join(map(str, rows[-1])) + "\n")
                sys.stdout.flush()
    TABLES.mkdir(exist_ok=True)
    with (TABLES / "loss.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows(
            [("finger", "px_per_mm", "quality", "gain", "rest", "stated", "noticed"), *rows]
        )


if __name__ == "__main__":
    main()
