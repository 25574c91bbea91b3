"""Claims 24 and 29 on new simulated fingers, by differences that are taken finger by finger.

    python validation/thesis/paired.py  # ten fingers, four minutes; writes tables/paired.csv

- 3.2.4: Frankot and Chellappa's integral beside Poisson's on exact normals, on the rectangle around
  the finger, as the thesis does, with the same borders, and within the mask: rms error in mm inside
  the mask, its mean removed
- 3.22: error of the shape, in um, under near-infrared light (`snk`) less that under white light
  (`ea`)

Intervals are Student's, of 95 %.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from figures import bands
from scipy import stats

from splitknit.integration.frankot_chellappa import frankot_chellappa
from splitknit.integration.poisson import poisson
from splitknit.pipeline import reconstruct
from splitknit_simulator.accuracy import compare
from splitknit_simulator.surface import SimulatedSurface
from splitknit_simulator.twin import lay_down, simulate_capture, twin_settings
from tables import write_csv

ZEROS = "Frankot-Chellappa, zeros"
MIRRORED = "Frankot-Chellappa, mirrored"
RECTANGLE = "Poisson, rectangle"
MASK = "Poisson, mask"
NIR = "shape under NIR"
WHITE = "shape under white light"
PAIRS = ((ZEROS, RECTANGLE), (MIRRORED, RECTANGLE), (MIRRORED, MASK), (NIR, WHITE))


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--fingers", type=int, default=10)
    parser.add_argument("--first-seed", type=int, default=2001)
    parser.add_argument(
        "--scale", type=float, default=0.4, help="size of the images, 1 = the thesis's"
    )
    parser.add_argument(
        "--out", type=Path, default=Path(__file__).with_name("tables") / "paired.csv"
    )
    options = parser.parse_args(arguments)
    fingers = [errors_of(options.first_seed + k, options.scale) for k in range(options.fingers)]
    rows = [row(name, [errors[name] for errors in fingers]) for name in fingers[0]]
    rows += [
        row(f"{a} - {b}", [errors[a] - errors[b] for errors in fingers], "+") for a, b in PAIRS
    ]
    write_csv(options.out, rows)
    for line in rows:
        print(f"{line['what']:50s} {line['mean']} {line['unit']}")
    return 0


def errors_of(seed: int, scale: float) -> dict[str, float]:
    """All errors on one finger: of the integrators in mm, of the shapes in um."""
    settings = twin_settings(scale, None)
    capture, truth = simulate_capture(seed, None, settings)
    shapes = {}
    for name, preset in ((NIR, "snk"), (WHITE, "ea")):
        result = reconstruct(capture, preset)
        surface = result.shape_mm if preset == "snk" else result.height_mm
        shapes[name] = bands(surface - truth["shape_mm"], compare(result, truth).surface, result)[
            "shape"
        ]
    return integrated(lay_down(seed, settings=settings)[0]) | shapes


def integrated(surface: SimulatedSurface) -> dict[str, float]:
    """Rms error in mm of each integrator on the exact normals of a finger with its ridges."""
    mask, normals = surface.mask, surface.normals
    steep = np.maximum(normals[..., 2], 1e-3)
    p, q = (np.where(mask, -normals[..., k] / steep, 0.0).astype(np.float32) for k in (0, 1))
    heights = {
        ZEROS: frankot_chellappa(p, q, mask),
        MIRRORED: frankot_chellappa(p, q, mask, padding="mirror"),
        RECTANGLE: poisson(p, q),
        MASK: poisson(p, q, mask),
    }
    pitch_mm = surface.camera.pitch_mm
    return {
        name: float(np.std((height * pitch_mm - surface.height_mm)[mask]))
        for name, height in heights.items()
    }


def row(what: str, values: Sequence[float], sign: str = "") -> dict[str, object]:
    """Mean over fingers, with its interval, and how many are negative."""
    mean = float(np.mean(values))
    reach = float(stats.t.ppf(0.975, len(values) - 1) * stats.sem(values))
    unit, digits = ("um", 1) if what.startswith(NIR) or what == WHITE else ("mm", 3)
    mean_text, low, high = (
        f"{end + 0.0:{sign}.{digits}f}".replace("-0.000", "+0.000")
        for end in (mean, mean - reach, mean + reach)
    )
    return {
        "what": what,
        "fingers": len(values),
        "mean": f"{mean_text} [{low}, {high}]",
        "unit": unit,
        "negative": int(np.sum(np.asarray(values) < 0)),
    }


if __name__ == "__main__":
    sys.exit(main())
