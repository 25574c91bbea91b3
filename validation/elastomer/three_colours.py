"""Balls in one photograph under three coloured lights, in micrometres: calibrated, measured live, judged by geometry.

    python validation/elastomer/three_colours.py IMAGE scan.yaml --radius-mm 1.97 --pitch-mm 6.35 [--json]

There is no photograph of the flat gel: its light is taken from between the balls. *Left out*: every eighth of the balls
is measured by a calibration that did not see it. *Seen*: the whole frame as ``splitknit view --live`` measures it, with
the calibration by all balls; `caps.py` judges its heights. Balls whose outline is a twentieth smaller than the median
are not pressed in as deeply and are left out, and so is what lies apart from the others.
"""

from __future__ import annotations

import argparse
import json
import re
from functools import partial
from pathlib import Path

import numpy as np
from caps import score

from splitknit.io.images import read_image
from splitknit.photometric.shading import flat_of_fall_off, shading_slopes
from splitknit_rig.calibration.shading import calibrate_shading
from splitknit_rig.capture.live import HeightMeter, linear_colours


def outlines(path):
    """Column, row, radius in pixels (N, 3) of the balls in a scan.yaml that are pressed in deeply and lie together."""
    number = r"(-?[\d.]+)"
    text = Path(path).read_text(encoding="utf-8")
    found = re.findall(rf"\br: {number}.*?\bx: {number}\s+y: {number}", text, re.DOTALL)
    balls = np.array(found, dtype=float)[:, [1, 2, 0]]
    apart = np.hypot(*(balls[:, None, :2] - balls[None, :, :2]).T) + np.where(np.eye(len(balls)) > 0, np.inf, 0.0)
    nearest = apart.min(axis=0)
    return balls[(balls[:, 2] > 0.95 * np.median(balls[:, 2])) & (nearest < 1.2 * np.median(nearest))]


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("image", type=Path)
    parser.add_argument("scan", type=Path)
    parser.add_argument("--radius-mm", type=float, required=True)
    parser.add_argument("--pitch-mm", type=float, required=True)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    pixels, balls = read_image(given.image), outlines(given.scan)
    fit = calibrate_shading([linear_colours(pixels, "linear")], None, given.radius_mm, given.pitch_mm, [balls])
    shading = fit.shading
    meter = HeightMeter(partial(shading_slopes, shading), shading.pitch_mm, shading.image_size)
    meter.divide_by(flat_of_fall_off(shading.fall_off, shading.image_size))
    measured = meter(pixels)
    file = Path(given.image.stem + "-height.npz")
    try:
        np.savez(file, height_mm=measured.height_um / 1000.0, pitch_mm=shading.pitch_mm)
        seen = score(file, given.radius_mm, fit.balls[fit.used][:, 1:3])
    finally:
        file.unlink(missing_ok=True)
    left_out = {key: shading.facts[key] for key in ("cap_rms_um", "cap_rms_um_median", "cap_gain")}
    figures = {"balls": int(fit.used.sum()), "pitch_um": 1000 * shading.pitch_mm, "left_out": left_out, "seen": seen}
    if given.json:
        print(json.dumps(figures, indent=1))
        return
    print(f"{figures['balls']} balls, {figures['pitch_um']:.3f} um a pixel")
    for name, one, gain in (("left out", left_out, left_out["cap_gain"]), ("seen", seen, seen["gain"])):
        low, middle, high = gain
        print(f"{name}: {one['cap_rms_um']:.1f} um rms (median {one['cap_rms_um_median']:.1f}), gain {middle:.3f} "
              f"({low:.3f} to {high:.3f})")  # fmt: skip
    print("plane over 1 mm: {:.1f} um rms, {:.1f} in the worst twentieth".format(*seen["plane_rms_um"]))


if __name__ == "__main__":
    main()
