"""From a capture to a metric fingerprint in Python: simulate a small capture, reconstruct it,
compare with the truth.

python examples/plot_reconstruct.py                # prints the figures, a few seconds
python examples/plot_reconstruct.py --preset ea    # the plain method of the thesis's comparison
python examples/plot_reconstruct.py --out pictures # photograph, relief, shaded surface
python examples/plot_reconstruct.py --capture DIR  # a capture folder of your own
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import splitknit
from splitknit.io.images import write_image
from splitknit.io.pictures import colour, on_paper, to_frame, upright_frame
from splitknit.observation.stored import linear_image
from splitknit.report.figures import small_fields, view_from_above
from splitknit_simulator.accuracy import compare
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import simulate_capture


def describe(result: splitknit.Reconstruction) -> None:
    """Report what was reconstructed, in the units it comes in."""
    area = float(result.mask.sum()) * result.pitch_mm**2
    depth = float(np.nanmax(result.height_mm) - np.nanmin(result.height_mm))
    facing = result.mask & (result.normals[..., 2] > 0.7)
    low, high = np.percentile(result.ridge_mm[facing], (5, 95))
    print(
        f"preset {result.preset}: {area:.0f} mm2 of skin, {depth:.1f} mm deep, one height each"
        f" {result.pitch_mm:.3f} mm"
    )
    print(
        f"yaw {result.facts['yaw_deg']:.1f} deg; crease {result.facts['crease_distance_mm']:.1f} mm"
        " below the tip"
    )
    print(f"relief, 5th to 95th percentile: {1000 * (high - low):.0f} um")
    if result.uncertainty_um is not None:
        print(
            f"stated uncertainty of the relief: {np.median(result.uncertainty_um[facing]):.0f} um"
            " (median)"
        )
    for warning in result.warnings:
        print(f"please note: {warning}")


def pictures(capture: splitknit.Capture, result: splitknit.Reconstruction, folder: Path) -> None:
    """Save one of the photographs, and the relief beside the shaded surface."""
    light = linear_image(capture.bands["white"].pixels[1], capture.encoding)
    displayed = np.clip(light / np.percentile(light[result.mask], 99.5), 0.0, 1.0) ** (1 / 2.2)
    write_image(folder / "photograph.png", np.round(255 * displayed).astype(np.uint8))
    frame = upright_frame(result, 900)
    relief, weight = to_frame(1000.0 * result.ridge_mm, result.mask, frame)
    shaded = view_from_above(small_fields(result, frame))
    flat = on_paper(colour(relief, -40.0, 40.0), weight)
    rows = min(flat.shape[0], shaded.shape[0])
    write_image(folder / "relief-and-surface.png", np.hstack([flat[:rows], shaded[:rows]]))


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--capture", type=Path, help="capture folder; a small one is simulated without it"
    )
    parser.add_argument("--preset", choices=["metric", "snk", "pr", "ea"], default="metric")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--scale", type=float, default=0.2)
    parser.add_argument("--out", type=Path, help="folder for pictures; none are written without it")
    options = parser.parse_args(arguments)
    truth = None
    if options.capture is None:
        capture, truth = simulate_capture(
            options.seed, "left_loop", TwinSettings(scale=options.scale)
        )
    else:
        capture = splitknit.read_capture(options.capture)
    result = splitknit.reconstruct(capture, preset=options.preset)
    describe(result)
    if truth is not None:
        figures = compare(result, truth).figures
        print(
            f"against the truth: surface rms {figures['surface_rms_mm']:.3f} mm, ridge correlation "
            f"{figures['ridge_correlation']:.2f}, ridge gain {figures['ridge_gain']:.2f}"
        )
    if options.out is not None:
        pictures(capture, result, options.out)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
