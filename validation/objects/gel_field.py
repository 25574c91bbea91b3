"""Balls pressed into a gel: is what is left after ``--level`` a bend of the field, or the balls' own heights?

    python validation/objects/gel_field.py BGA-001 Flat-001 shading.npz

Folders of photographs under each light, ``scan.yaml`` with the balls' outlines among them, and their calibration. After
levelling three things are compared: the field in a ring around each ball (1.75 to 2.1 radii), the tops of the balls
(spheres of the known radius within 0.4 of it), and the rise from ring to top on four paths of slopes, from left, right,
below and above, which share no pixel. Tops of a bent field are alike where balls are close, and a polynomial through
the others predicts each. Writes tables/gel_field.json.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from splitknit.jobs import ReadPhotographsJob
from splitknit.methods.photometry import linear_grey
from splitknit.methods.shaded import everything_in_view
from splitknit.photometric.shading import read_shading, shading_slopes
from splitknit.pipeline import reconstruct
from splitknit.presets import PRESETS

Array = NDArray[np.float64]
RADIUS_MM = 0.2475


def outlines(scan: Path) -> Array:
    """Columns and rows (N, 2) of the circles."""
    found = re.findall(
        r"type: GridCircle.*?\n\s+x: (-?[\d.]+)\s*\n\s+y: (-?[\d.]+)", scan.read_text("utf-8"), re.DOTALL
    )
    return np.array(found, dtype=float)


def scatter(values: Array) -> float:
    """1.48 times the median deviation from the median, um."""
    return round(float(1.48 * np.nanmedian(np.abs(values - np.nanmedian(values)))), 2)


def off_plane(values: Array, centres: Array) -> Array:
    """`values` less a plane that fits most of them."""
    terms, weights = np.column_stack([np.ones(len(values)), centres]), np.ones(len(values))
    for _ in range(20):
        root = np.sqrt(weights)
        rest = values - terms @ np.linalg.lstsq(terms * root[:, None], values * root, rcond=None)[0]
        weights = 1.0 / (1.0 + (rest / (3.0 * np.median(np.abs(rest)))) ** 2)
    return rest


def left_out(values: Array, centres: Array, order: int) -> float:
    """Rms of each value less the polynomial of the place through all others, um."""
    x, y = (2.0 * (centres - centres.mean(axis=0)) / np.ptp(centres, axis=0)).T
    terms = np.column_stack([x ** (n - j) * y**j for n in range(order + 1) for j in range(n + 1)])
    hat = np.einsum("ni,im->nm", terms, np.linalg.pinv(terms))
    return round(float(np.std((values - hat @ values) / (1.0 - np.diag(hat)))), 1)


def apart_um(values: Array, centres: Array, pitch: float, low: float, high: float) -> float:
    """Rms difference, over the root of two, of values whose balls are `low` to `high` mm apart."""
    off = pitch * np.hypot(*(centres[:, None] - centres).transpose(2, 0, 1))
    pairs = (values[:, None] - values)[(off > low) & (off < high)]
    return round(float(np.sqrt(np.mean(pairs**2) / 2.0)), 1)


def measured(pressed: Path, flat: Path, calibration: Path) -> dict[str, object]:
    """Heights around and on the balls."""
    job = ReadPhotographsJob(pressed, shading=calibration, flat=flat)
    capture, shading = job.read()[0], read_shading(calibration)
    photographs = everything_in_view(capture, PRESETS["metric"])
    images = linear_grey(photographs.bands[0], photographs.capture.encoding, "grey")
    slopes = shading_slopes(shading, images)[0]
    height = 1000.0 * reconstruct(capture, "metric").height_mm.astype(np.float64)
    centres, pitch = outlines(pressed / "scan.yaml"), shading.pitch_mm
    rows, columns = np.mgrid[: height.shape[0], : height.shape[1]]
    rings, tops, paths = [], [], []
    for x, y in centres:
        apart = np.hypot(columns - x, rows - y) * pitch / RADIUS_MM
        rings.append(np.median(height[(apart > 1.75) & (apart < 2.1)]))
        cap = apart < 0.4
        place = np.column_stack([np.ones(cap.sum()), columns[cap] - x, rows[cap] - y])
        sphere = 1000.0 * RADIUS_MM * (np.sqrt(1.0 - apart[cap] ** 2) - 1.0)
        tops.append(np.linalg.lstsq(place, height[cap] - sphere, rcond=None)[0][0])
        paths.append(rises(slopes, round(x), round(y), round(2 * RADIUS_MM / pitch), pitch))
    rise, each = np.array(tops) - np.array(rings), np.array(paths)
    plain = off_plane(np.array(tops), centres)
    whole = np.isfinite(each).all(axis=1)
    return {
        "balls": len(centres),
        "ring_scatter_um": scatter(off_plane(np.array(rings), centres)),
        "top_scatter_um": scatter(plain),
        "tops_1_mm_apart_um": apart_um(plain, centres, pitch, 0.5, 1.2),
        "tops_4_to_6_mm_apart_um": apart_um(plain, centres, pitch, 4.0, 6.0),
        "tops_left_out_um_by_order": {n: left_out(np.array(tops), centres, n) for n in (1, 2, 3, 4)},
        "rise_scatter_um": scatter(rise),
        "rise_range_um": [round(float(one)) for one in (rise.min(), rise.max())],
        "balls_with_four_paths": int(whole.sum()),
        "paths_sd_within_ball_um": round(float(np.median(each[whole].std(axis=1))), 2),
        "paths_mean_against_rise_correlation": round(
            float(np.corrcoef(each[whole].mean(axis=1), rise[whole])[0, 1]), 3
        ),
    }


def rises(slopes: Array, x: int, y: int, reach: int, pitch: float) -> list[float]:
    """Rise in um from `reach` pixels away to the middle of a ball, from left, right, below and above."""
    if min(x, y, slopes.shape[2] - 1 - x, slopes.shape[1] - 1 - y) < reach + 8:
        return [np.nan] * 4
    over = range(-6, 7, 3)
    left = np.mean([slopes[0, y + k, x - reach : x].sum() for k in over])
    right = -np.mean([slopes[0, y + k, x : x + reach].sum() for k in over])
    above = -np.mean([slopes[1, y - reach : y, x + k].sum() for k in over])
    below = np.mean([slopes[1, y : y + reach, x + k].sum() for k in over])
    return [1000.0 * pitch * float(one) for one in (left, right, below, above)]


if __name__ == "__main__":
    found = measured(*(Path(word) for word in sys.argv[1:4]))
    text = json.dumps(found, indent=1) + "\n"
    Path(__file__).with_name("tables").joinpath("gel_field.json").write_text(text, encoding="utf-8")
    sys.stdout.write(text)
