"""The finger's shape from mirrors: one image, three views, no near-infrared light.

    python examples/plot_mirror_shape.py --out pictures

Mirrors at 45 deg beside a simulated finger and at its tip show it from the side. Outlines of all
views give the shape, and the mirrors' true poses with it; the white images give the ridges, which
are laid upon that shape.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

import splitknit
from splitknit.io.images import write_image
from splitknit.io.pictures import upright_frame
from splitknit.presets import PRESETS
from splitknit.report.figures import small_fields, view_from_above
from splitknit_simulator.accuracy import compare
from splitknit_simulator.rigs import MirrorSettings
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import simulate_capture


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--scale", type=float, default=0.35)
    parser.add_argument("--out", type=Path, help="folder for pictures; none are written without it")
    options = parser.parse_args(arguments)
    twin = TwinSettings(
        scale=options.scale, mirrors=MirrorSettings(names=("left", "right", "tip"), nir=False)
    )
    capture, truth = simulate_capture(options.seed, "left_loop", twin)
    metric = PRESETS["metric"]
    mirrored = replace(metric, shape=replace(metric.shape, source="mirror"))
    for name, settings in (("white images alone", metric), ("mirrors", mirrored)):
        result = splitknit.reconstruct(capture, settings=settings)
        figures = compare(result, truth).figures
        print(
            f"shape from {name:20s} surface rms {figures['surface_rms_mm']:.2f} mm, ridge"
            f" correlation {figures['ridge_correlation']:.2f}"
        )
    if options.out is not None:
        photograph = capture.bands["white"].pixels[1].astype(np.float32)
        bright = np.clip(photograph / np.percentile(photograph, 99.5), 0, 1) ** (1 / 2.2)
        write_image(
            options.out / "one-image-four-views.png", np.round(255 * bright).astype(np.uint8)
        )
        above = view_from_above(small_fields(result, upright_frame(result, 700)))
        write_image(options.out / "surface.png", above)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
