"""What raises the contrast of ridges: random walks below a flat patch with sinusoidal ridges.

    python validation/path_traced/ridged_patch.py    # needs numba; writes tables/ridged_patch.csv

Ridges of 65 um in 0.45 mm under the rig's seven lights, seen from above. One part of the optics is
changed at a time. Contrast: amplitude at the ridges' period over the mean, linear light, root mean
square over the lights; the last column is green light without specular reflection.
"""

from __future__ import annotations

import csv
import sys
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from walked_finger import FingerOptics, render_finger, specular

from splitknit.model import Camera, default_rig
from splitknit_simulator.light.skin import CHANNELS
from splitknit_simulator.surface import SimulatedSurface

TABLE = Path(__file__).with_name("tables") / "ridged_patch.csv"
PITCH_MM = 0.03
PERIOD_PX = 15
DEPTH_MM = 0.065
SIZE = (31, 4 * PERIOD_PX + 1)
USUAL = FingerOptics(spread=1 / 3, scattering_factor=0.7, mottle=0.0)
CHANGES: tuple[dict[str, float], ...] = (
    {},
    {"spread": 0.0},
    {"spread": 1.0},
    {"scattering_factor": 0.3},
    {"scattering_factor": 1.5},
    {"spread": 1.0, "scattering_factor": 1.5},
    {"melanin": 0.006},
    {"blood": 0.012},
    {"roughness": 0.15},
    {"roughness": 0.45},
    {"gloss": 0.0},
    {"gloss": 2.0},
    {"roughness": 0.15, "gloss": 2.0},
    {"spread": 0.0, "gloss": 0.0},
    {"spread": 1.0, "gloss": 0.0},
)


def ridged_patch() -> SimulatedSurface:
    """Flat skin that fills the picture; its ridges are even beyond the mirrored border, too."""
    phase = 2 * np.pi * np.arange(SIZE[1]) / PERIOD_PX
    height = np.broadcast_to(0.5 * DEPTH_MM * np.cos(phase), SIZE)
    slope = -0.5 * DEPTH_MM * 2 * np.pi / (PERIOD_PX * PITCH_MM) * np.sin(phase)
    normals = np.zeros((*SIZE, 3))
    normals[..., 0], normals[..., 2] = -slope, 1.0
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    up, ones = np.zeros((*SIZE, 3), dtype=np.float32), np.ones(SIZE, dtype=np.float32)
    up[..., 2] = 1.0
    camera = Camera(1 / PITCH_MM, SIZE)
    relief = 1e3 * (height - 0.5 * DEPTH_MM)
    return SimulatedSurface(
        camera,
        height.astype(np.float32),
        0 * ones,
        normals.astype(np.float32),
        up,
        relief.astype(np.float32),
        ones > 0,
        ones,
    )


def contrast(images: np.ndarray) -> float:
    """Root mean square, over (L, H, W) images, of the amplitude at the ridges' period."""
    lines = images[:, :, : SIZE[1] - 1].mean(axis=1, dtype=np.float64)
    wave = np.exp(-2j * np.pi * np.arange(SIZE[1] - 1) / PERIOD_PX)
    return float(np.sqrt(np.mean(np.abs(2 * (lines @ wave) / lines.sum(axis=1)) ** 2)))


def main() -> int:
    surface, rig = ridged_patch(), default_rig(0.5)
    leds = [replace(led, lobe_exponent=0.0) for led in rig.leds if led.band == "white"]
    walked, rows = {}, []
    for change in CHANGES:
        optics = replace(USUAL, **change)
        # the walks know nothing of gloss
        below = replace(optics, gloss=0.0)
        if below not in walked:
            walked[below] = {
                name: render_finger(
                    surface, leds, name, below, walks=200.0, rays=32, threads=1, seed=5
                ).radiance
                for name in CHANNELS
            }
        gloss = optics.gloss * np.stack([specular(surface, led, optics.roughness) for led in leds])
        light = walked[below]
        each = [contrast(light[name] + gloss) for name in CHANNELS]
        part = float(gloss.mean() / (gloss.mean() + light["green"].mean()))
        name = ", ".join(f"{key} {value:g}" for key, value in change.items()) or "usual"
        figures = [*each, each[0] / each[1], each[3] / each[1], part, contrast(light["green"])]
        rows.append([name, *(f"{value:.3g}" for value in figures)])
        print(*rows[-1], sep="; ", flush=True)
    heads = ["optics", *CHANNELS, "red_over_green", "nir_over_green", "specular_part", "green_matt"]
    with TABLE.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([heads, *rows])
    print("usual:", asdict(USUAL))
    return 0


if __name__ == "__main__":
    sys.exit(main())
