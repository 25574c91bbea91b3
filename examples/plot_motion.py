"""A finger that moves while it is photographed: still, moved as it is, and moved with the motion
undone.

    python examples/plot_motion.py --out pictures

Fourteen shots take seven seconds, and a hand drifts and trembles. The shots are brought onto one of
them before anything else is done, unless the finger lay still.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

import splitknit
from splitknit.finger.ridges import surface_print
from splitknit.io.images import write_image
from splitknit.presets import PRESETS
from splitknit.reconstruction import surface_of
from splitknit_simulator.accuracy import compare
from splitknit_simulator.finger.motion import HandMotion
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import simulate_capture


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--amplitude-mm", type=float, default=0.4, help="largest distance between two shots"
    )
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--scale", type=float, default=0.25)
    parser.add_argument("--out", type=Path, help="folder for pictures; none are written without it")
    options = parser.parse_args(arguments)
    metric = PRESETS["metric"]
    as_it_is = replace(metric, motion=replace(metric.motion, correct="off"))
    moving = HandMotion(amplitude_mm=options.amplitude_mm)
    prints = []
    for name, motion, settings in (
        ("still", HandMotion(), metric),
        ("moved, as it is", moving, as_it_is),
        ("moved, undone", moving, metric),
    ):
        capture, truth = simulate_capture(
            options.seed, "whorl", TwinSettings(scale=options.scale, motion=motion)
        )
        result = splitknit.reconstruct(capture, settings=settings)
        figures = compare(result, truth).figures
        print(
            f"{name:16s} ridge correlation {figures['ridge_correlation']:.2f}, gain"
            f" {figures['ridge_gain']:.2f}, surface rms {figures['surface_rms_mm']:.2f} mm"
        )
        for warning in result.warnings:
            print(f"  the software reports: {warning}")
        prints.append(surface_print(surface_of(result)))
    if options.out is not None:
        tall = max(image.shape[0] for image in prints)
        panels = [np.pad(p, ((0, tall - p.shape[0]), (0, 12)), constant_values=255) for p in prints]
        write_image(options.out / "still-moved-undone.png", np.hstack(panels))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
