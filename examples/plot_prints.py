"""From 3D to 2D: one finger as a print by four methods, and enhanced.

    python examples/plot_prints.py --out pictures

The relief as ink; the surface unrolled at equal distances; its curvature; and the plain photograph
as the baseline. The upper row shows the prints, the lower row their enhancement.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

from splitknit.io.capture import write_capture
from splitknit.io.images import write_image
from splitknit_match.prints.make import enhance, make_print
from splitknit_match.prints.minutiae import extract, nfiq2
from splitknit_match.prints.sources import read_source
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import simulate_capture

METHODS = ("relief", "unroll", "curvature", "photo")


def beside(panels: list[np.ndarray]) -> np.ndarray:
    """Pictures in a row on white paper."""
    tall = max(panel.shape[0] for panel in panels)
    paper = [np.pad(p, ((0, tall - p.shape[0]), (0, 12)), constant_values=255) for p in panels]
    return np.hstack(paper)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=2)
    parser.add_argument("--scale", type=float, default=0.35)
    parser.add_argument("--out", type=Path, help="folder for pictures; none are written without it")
    options = parser.parse_args(arguments)
    capture, _ = simulate_capture(options.seed, "right_loop", TwinSettings(scale=options.scale))
    with tempfile.TemporaryDirectory() as folder:
        write_capture(capture, Path(folder) / "capture")
        source = read_source(Path(folder) / "capture", photo=True, surface=True)
    upper, lower = [], []
    for method in METHODS:
        finger_print = make_print(source, method)
        better = enhance(finger_print)
        upper.append(finger_print.image)
        lower.append(better.image)
        minutiae = extract(finger_print.image, 500.0)
        rows, columns = finger_print.image.shape
        quality = nfiq2(finger_print.image)
        print(
            f"{method:10s} {columns} x {rows} px at 500 ppi = {columns / 500 * 25.4:.1f} x"
            f" {rows / 500 * 25.4:.1f} mm, {minutiae.count} minutiae, NFIQ 2 {quality}"
        )
    if options.out is not None:
        write_image(options.out / "prints.png", np.vstack([beside(upper), beside(lower)]))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
