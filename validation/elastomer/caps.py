"""Heights of balls pressed into a gel, against spheres: by geometry alone.

    python validation/elastomer/caps.py RESULT --radius-mm 0.2475 [--scan scan.yaml] [--json]

RESULT is a folder of ``splitknit reconstruct``, or its ``height.npz``. Of every ball a sphere of the known radius is
fitted in position (three unknowns) to the heights within 0.6 of the radius; what is left is the error. The gain is the
factor on the sphere's height that fits best, its position free again. The plane is judged in windows of 1 mm between
the balls, further than 1.6 radii from each: the rms height over the plane that fits best, means over 5 x 5 pixels.
Nothing here is of the calibration or of the reconstruction. Balls come from the outlines in a ``scan.yaml``, else from
the tops in the heights.
"""

from __future__ import annotations

import argparse
import json
import re
from pathlib import Path

import cv2
import numpy as np
from scipy.optimize import least_squares

CAP, APART = 0.6, 1.6


def outlines_of_scan(path):
    """Columns and rows (N, 2) of the circles in a scan.yaml."""
    text = Path(path).read_text(encoding="utf-8")
    number = r"(-?[\d.]+(?:e-?\d+)?)"
    found = re.findall(rf"type: GridCircle.*?\n\s+x: {number}\s*\n\s+y: {number}", text, re.DOTALL)
    return np.array(found, dtype=float).reshape(-1, 2)


def tops(height_mm, pitch_mm, radius_mm):
    """Columns and rows (N, 2) of the balls' tops: what rises above its surroundings as a ball does."""
    step = max(1, int(radius_mm / pitch_mm / 12))
    filled = np.where(np.isfinite(height_mm), height_mm, np.nanmedian(height_mm)).astype(np.float32)
    small = cv2.resize(filled, None, fx=1 / step, fy=1 / step, interpolation=cv2.INTER_AREA)
    radius = radius_mm / pitch_mm / step
    rise = cv2.GaussianBlur(small, (0, 0), 0.3 * radius) - cv2.GaussianBlur(small, (0, 0), 1.5 * radius)
    peak = rise == cv2.dilate(rise, np.ones((2 * int(radius) + 1,) * 2))
    rows, columns = np.nonzero(peak & (rise > 0.15 * radius_mm))
    return (np.column_stack([columns, rows]) + 0.5) * step - 0.5


def cap(height_mm, pitch_mm, radius_mm, centre, *, gain=False):
    """Errors (n,) in mm within the cap once a sphere is fitted, its place (x, y in mm, image axes), and its gain."""
    reach = CAP * radius_mm / pitch_mm
    rows, columns = np.mgrid[
        int(centre[1] - reach) : int(centre[1] + reach) + 2, int(centre[0] - reach) : int(centre[0] + reach) + 2
    ].reshape(2, -1)
    near = np.hypot(columns - centre[0], rows - centre[1]) < reach
    rows, columns = rows[near], columns[near]
    x, y, z = (columns - centre[0]) * pitch_mm, (rows - centre[1]) * pitch_mm, height_mm[rows, columns].astype(float)

    def misfit(p):
        sphere = np.sqrt(np.maximum(radius_mm**2 - (x - p[0]) ** 2 - (y - p[1]) ** 2, 1e-12)) - radius_mm
        return p[2] + (p[3] if gain else 1.0) * sphere - z

    start = [0.0, 0.0, float(z.max()), *([1.0] if gain else [])]
    fit = least_squares(misfit, start, x_scale=radius_mm)
    return -fit.fun, fit.x[:2], float(fit.x[3]) if gain else 1.0


def plane_rms_um(height_mm, pitch_mm, radius_mm, centres, window_mm=1.0):
    """Rms height in um over the best plane, (W,) of every window that is a quarter plane at least."""
    smooth = cv2.blur(height_mm, (5, 5))
    rows, columns = height_mm.shape
    step, found = 5, []
    y, x = np.mgrid[step // 2 : rows : step, step // 2 : columns : step]
    free = np.isfinite(smooth[y, x])
    for column, row in centres:
        free &= np.hypot(x - column, y - row) * pitch_mm > APART * radius_mm
    side = window_mm / pitch_mm
    for top in np.arange(0.25 * side, rows - 1.25 * side, 0.5 * side):
        for left in np.arange(0.25 * side, columns - 1.25 * side, 0.5 * side):
            here = free & (y >= top) & (y < top + side) & (x >= left) & (x < left + side)
            if here.sum() * step**2 > 0.25 * side**2:
                z = smooth[y[here], x[here]].astype(float)
                terms = np.column_stack([np.ones(len(z)), x[here], y[here]])
                found.append(1000.0 * float(np.std(z - terms @ np.linalg.lstsq(terms, z, rcond=None)[0])))
    return np.array(found)


def score(file, radius_mm, centres=None):
    """Figures of one result, as a dictionary."""
    with np.load(file / "height.npz" if Path(file).is_dir() else file) as arrays:
        height, pitch = arrays["height_mm"], float(arrays["pitch_mm"])
        stated = arrays.get("uncertainty_um")
    places = tops(height, pitch, radius_mm) if centres is None else np.asarray(centres)
    margin = (CAP + 0.05) * radius_mm / pitch
    whole = (places > margin).all(axis=1) & (places < np.array(height.shape[::-1]) - 1 - margin).all(axis=1)
    rms, gains, ratios = [], [], []
    for outline in places[whole]:
        _, moved, _ = cap(height, pitch, radius_mm, outline)  # the disc about the ball as the heights show it
        place = outline + np.clip(moved / pitch, -0.2 * margin, 0.2 * margin)
        error, _, _ = cap(height, pitch, radius_mm, place)
        rms.append(1000.0 * float(np.sqrt(np.mean(error**2))))
        gains.append(cap(height, pitch, radius_mm, place, gain=True)[2])
        if stated is not None:
            column, row = (round(v) for v in place)
            reach = int(CAP * radius_mm / pitch)
            part = stated[max(row - reach, 0) : row + reach + 1, max(column - reach, 0) : column + reach + 1]
            ratios.append(rms[-1] / float(np.sqrt(np.nanmean(part**2))))
    plane = plane_rms_um(height, pitch, radius_mm, places)
    return {
        "balls": len(rms),
        "cap_rms_um": float(np.sqrt(np.mean(np.square(rms)))),
        "cap_rms_um_median": float(np.median(rms)),
        "gain": [float(value) for value in np.percentile(gains, (5, 50, 95))],
        "error_over_stated": float(np.sqrt(np.mean(np.square(ratios)))) if ratios else None,
        "plane_rms_um": [float(value) for value in np.percentile(plane, (50, 95))] if len(plane) else None,
        "pitch_mm": pitch,
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("result", type=Path)
    parser.add_argument("--radius-mm", type=float, required=True)
    parser.add_argument("--scan", type=Path, help="scan.yaml with the balls' outlines")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    found = score(given.result, given.radius_mm, None if given.scan is None else outlines_of_scan(given.scan))
    if given.json:
        print(json.dumps(found, indent=1))
        return
    low, middle, high = found["gain"]
    print(f"{found['balls']} caps: {found['cap_rms_um']:.2f} um rms (median {found['cap_rms_um_median']:.2f})")
    print(f"gain {middle:.3f} ({low:.3f} to {high:.3f})")
    if found["error_over_stated"] is not None:
        print(f"error over stated {found['error_over_stated']:.2f}")
    if found["plane_rms_um"] is not None:
        print("plane over 1 mm: {:.2f} um rms, {:.2f} in the worst twentieth".format(*found["plane_rms_um"]))


if __name__ == "__main__":
    main()
