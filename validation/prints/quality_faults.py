"""Fingers with one known fault each, reconstructed: ``python validation/prints/quality_faults.py FOLDER SEED...``.

Writes FOLDER/SEED_FAULT.npz, which ``validation/prints/quality.py --faults FOLDER`` reads. A minute each.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from splitknit.io.npz import write_npz
from splitknit.pipeline import reconstruct
from splitknit_simulator.camera.sensor import SensorSettings
from splitknit_simulator.finger.finger import PoseRanges, SimulatedFinger, draw_finger
from splitknit_simulator.light.renderer import RenderSettings
from splitknit_simulator.light.skin import SkinRanges
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import simulate_capture

BASE = TwinSettings(scale=0.35, render=RenderSettings(workers=1))
FAULTS = {
    "none": BASE,
    "dry": replace(BASE, skin=SkinRanges(glare=(0.5, 0.5), roughness=(0.35, 0.35))),
    "defocus": replace(BASE, render=RenderSettings(workers=1, aperture_mm=5.5, focus_depth_mm=10.0)),
    "partial": replace(BASE, pose=PoseRanges(insertion_mm=(13.0, 14.0))),
    "glare": replace(BASE, skin=SkinRanges(glare=(3.0, 3.0), roughness=(0.18, 0.18))),
    "dark": replace(BASE, sensor=SensorSettings(exposure=0.06, full_well_e=2500.0, read_noise_e=4.0)),
}
DRY_DEPTH = 0.3
"""Depth of a dry finger's ridges and pores relative to its own."""


def finger_of(seed: int, fault: str) -> SimulatedFinger:
    """The finger of a seed; a dry one is shallow."""
    finger = draw_finger(seed)
    if fault != "dry":
        return finger
    skin = finger.skin
    depths = {"ridge_depth_um": DRY_DEPTH * skin.ridge_depth_um, "pore_depth_um": DRY_DEPTH * skin.pore_depth_um}
    return replace(finger, skin=replace(skin, **depths))


def main() -> None:
    """Simulate, reconstruct, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("seeds", type=int, nargs="+")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    options.folder.mkdir(parents=True, exist_ok=True)
    for seed in options.seeds:
        for fault, settings in FAULTS.items():
            out = options.folder / f"{seed}_{fault}.npz"
            if out.exists():
                continue
            capture, truth = simulate_capture(seed, settings=settings, finger=finger_of(seed, fault))
            result = reconstruct(capture, "metric")
            arrays = {
                "ridge_mm": result.ridge_mm, "shape_mm": result.shape_mm, "mask": result.mask,
                "pitch_mm": np.float64(result.pitch_mm), "input_from_upright": result.input_from_upright,
                "upright_size": np.array(result.upright_size), "minutiae_px": truth["landmark_minutiae_px"],
            }  # fmt: skip
            write_npz(out, arrays)
            print(seed, fault, flush=True)


if __name__ == "__main__":
    main()
