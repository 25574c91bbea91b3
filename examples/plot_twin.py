"""The digital twin: a finger, its photographs under each light, and the truth behind them.

    python examples/plot_twin.py --out pictures

Seven white and seven near-infrared images of one simulated finger. Ridges show in white light and
nearly vanish in near-infrared, where light travels further under the skin; the specular reflection
of the surface is known separately.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from splitknit.io.images import write_image
from splitknit_simulator.scene import TwinSettings
from splitknit_simulator.twin import simulate_capture

Array = np.ndarray


def ridge_contrast(image: Array, mask: Array) -> float:
    """Local standard deviation over local mean, on the facing part of the finger."""
    rows, columns = np.nonzero(mask)
    middle = slice(int(np.median(rows)) - 40, int(np.median(rows)) + 40)
    across = slice(int(np.median(columns)) - 40, int(np.median(columns)) + 40)
    patch = image[middle, across].astype(float)
    y, x = np.mgrid[: patch.shape[0], : patch.shape[1]] / 40.0 - 1.0
    smooth = np.stack([np.ones_like(x), x, y, x * y, x * x, y * y], axis=-1).reshape(-1, 6)
    plane = smooth @ np.linalg.lstsq(smooth, patch.ravel(), rcond=None)[0]
    return float((patch.ravel() - plane).std() / patch.mean())


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=4)
    parser.add_argument("--scale", type=float, default=0.2)
    parser.add_argument("--out", type=Path, help="folder for pictures; none are written without it")
    options = parser.parse_args(arguments)
    capture, truth = simulate_capture(options.seed, "whorl", TwinSettings(scale=options.scale))
    white, nir = capture.bands["white"].pixels, capture.bands["nir"].pixels
    mask = truth["mask"].astype(bool)
    print(
        f"{len(white)} white and {len(nir)} near-infrared images of {mask.shape[1]} x"
        f" {mask.shape[0]} pixels"
    )
    for name, image in (
        ("red", white[1, ..., 0]),
        ("green", white[1, ..., 1]),
        ("blue", white[1, ..., 2]),
    ):
        print(f"ridge contrast, {name:6s} {100 * ridge_contrast(image, mask):.1f} %")
    print(f"ridge contrast, NIR    {100 * ridge_contrast(nir[1, ..., 0], mask):.1f} %")
    relief = 1000.0 * (truth["height_mm"] - truth["shape_mm"])
    print(f"true relief: {np.nanpercentile(relief, 95) - np.nanpercentile(relief, 5):.0f} um deep")
    if options.out is not None:
        glare = truth["glare_white"][1].astype(np.float32)
        panels = [
            white[1],
            np.repeat(nir[1, ..., :1], 3, axis=2),
            np.repeat(
                np.clip(255 * glare / max(float(np.percentile(glare, 99.8)), 1e-6), 0, 255)[
                    ..., None
                ],
                3,
                axis=2,
            ),
            np.repeat(
                np.where(mask, np.clip(255 + 2.5 * np.nan_to_num(relief), 0, 255), 255)[..., None],
                3,
                axis=2,
            ),
        ]
        rows, columns = np.nonzero(mask)
        window = (
            slice(max(rows.min() - 10, 0), rows.max()),
            slice(max(columns.min() - 10, 0), columns.max() + 10),
        )
        row = np.hstack([np.round(panel[window]).astype(np.uint8) for panel in panels])
        write_image(options.out / "white-nir-glare-relief.png", row)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
