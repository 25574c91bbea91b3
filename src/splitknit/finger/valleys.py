"""Dark lines across an upright finger."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from splitknit.finger.regions import depth_inside
from splitknit.model import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class Valley:
    """A line across the finger that is darker than the skin above and below it (rows, columns: upright frame)."""

    row: float
    """At the middle of the finger."""
    left: float
    """Column where the finger begins."""
    right: float
    """Column where it ends."""
    tilt_rad: float
    """Lean against the horizontal, counter-clockwise."""
    depth: float
    """Relative darkening, averaged over the width."""
    coverage: float
    """Share of the width along which it is seen."""
    distance_mm: float = float("nan")
    """From the tip."""

    def moved(self, factor: float, tip_row: float, px_per_mm: float) -> Valley:
        """The same valley on a grid `factor` times finer, with its distance from `tip_row` there."""
        row = (self.row + 0.5) * factor - 0.5
        return replace(
            self,
            row=row,
            left=(self.left + 0.5) * factor - 0.5,
            right=(self.right + 0.5) * factor - 0.5,
            distance_mm=(row - tip_row) / px_per_mm,
        )


def transverse_valleys(
    image: FloatArray,
    inside: BoolArray,
    px_per_mm: float,
    *,
    smoothing_mm: float,
    side_mm: float,
    least_depth: float,
    least_coverage: float,
    least_prominence: float,
    greatest_tilt_deg: float,
) -> tuple[Valley, ...]:
    """All dark lines across an upright finger, from the tip down.

    A place of the blurred `image` (H, W) responds by how much darker it is than the skin `side_mm` above and below,
    the lesser of the two; the response is averaged along lines that lean by up to `greatest_tilt_deg`.
    """
    response, valid = _response(image, inside, px_per_mm, smoothing_mm, side_mm)
    core = valid & (depth_inside(inside) > 0.08 * _width(inside))
    found: list[Valley] = []
    best: tuple[FloatArray, FloatArray, FloatArray] | None = None
    for tilt_deg in np.arange(-greatest_tilt_deg, greatest_tilt_deg + 0.1, 3.0):
        depth, coverage = _along_lines(response, core, inside, float(np.deg2rad(tilt_deg)), least_depth)
        tilt = np.full(depth.shape, np.deg2rad(tilt_deg), dtype=np.float32)
        if best is None:
            best = depth, coverage, tilt
        else:
            better = depth * coverage > best[0] * best[1]
            best = (
                np.where(better, depth, best[0]),
                np.where(better, coverage, best[1]),
                np.where(better, tilt, best[2]),
            )
    if best is None:
        return ()
    depth, coverage, tilt = best
    scatter = _scatter(depth)
    reach = max(1, round(side_mm * px_per_mm))
    peaks = depth >= ndimage.maximum_filter1d(depth, 2 * reach + 1)
    strong = peaks & (depth >= max(least_depth, least_prominence * scatter)) & (coverage >= least_coverage)
    for row in np.flatnonzero(strong):
        columns = np.flatnonzero(inside[row])
        if len(columns) == 0 or (found and row - found[-1].row <= reach):
            continue
        found.append(
            Valley(
                row=_refine(depth, int(row)),
                left=float(columns[0]),
                right=float(columns[-1]),
                tilt_rad=float(tilt[row]),
                depth=float(depth[row]),
                coverage=float(coverage[row]),
            )
        )
    return tuple(found)


def _response(
    image: FloatArray, inside: BoolArray, px_per_mm: float, smoothing_mm: float, side_mm: float
) -> tuple[FloatArray, BoolArray]:
    """Relative darkness against the lesser of the two sides (H, W), and where it is known.

    Differences of logarithms, so skin tone and brightness drop out. Each side is continued to the centre with the
    slope that *both* sides share (the lesser where they agree in sign, none where they do not), so that a smooth
    gradient hides no crease. But a place must be darker than both sides as they are, too: the edge of a shadow, and
    the foot of one just above a crease, never are.
    """
    weight = inside.astype(np.float32)
    sigma = max(smoothing_mm * px_per_mm, 0.3)
    light = cv2.GaussianBlur(np.maximum(image, 0.0) * weight, (0, 0), 2.0 * sigma, sigmaY=sigma)
    cover = cv2.GaussianBlur(weight, (0, 0), 2.0 * sigma, sigmaY=sigma)
    smooth = np.asarray(light / np.maximum(cover, np.float32(1e-3)), dtype=np.float32)
    typical = float(np.median(smooth[inside])) if inside.any() else 1.0
    level = np.log(np.maximum(smooth, np.float32(max(0.02 * typical, 1e-12))))
    step = max(1, round(side_mm * px_per_mm))
    above, has_above = _moved_down(level, inside, step)
    below, has_below = _moved_down(level, inside, -step)
    farther_above, has_slope_above = _moved_down(level, inside, 2 * step)
    farther_below, has_slope_below = _moved_down(level, inside, -2 * step)
    slope_above, slope_below = above - farther_above, farther_below - below
    agree = has_slope_above & has_slope_below & (slope_above * slope_below > 0.0)
    lesser = np.sign(slope_above) * np.minimum(np.abs(slope_above), np.abs(slope_below))
    slope = np.where(agree, lesser, np.float32(0.0))
    plain = np.minimum(above, below) - level
    response = np.minimum(np.minimum(above + slope, below - slope) - level, np.float32(3.0) * np.maximum(plain, 0.0))
    response = np.where(plain > 0.0, response, np.minimum(plain, 0.0))
    known = inside & has_above & has_below
    return np.where(known, response, np.float32(0.0)).astype(np.float32), known


def _moved_down(level: FloatArray, inside: BoolArray, step: int) -> tuple[FloatArray, BoolArray]:
    """What lies `step` rows above every pixel, and whether that is finger."""
    moved, known = np.zeros_like(level), np.zeros_like(inside)
    if abs(step) < level.shape[0]:
        target, source = (np.s_[step:], np.s_[:-step]) if step > 0 else (np.s_[:step], np.s_[-step:])
        moved[target], known[target] = level[source], inside[source]
    return moved, known


def _along_lines(
    response: FloatArray, core: BoolArray, inside: BoolArray, tilt: float, least_depth: float
) -> tuple[FloatArray, FloatArray]:
    """Mean response and share of responding columns for every line of one lean; zero where too little is known."""
    height, width = response.shape
    centre = _middle(inside)
    x = np.arange(width, dtype=np.float32)
    shift = (-(x - np.float32(centre)) * np.float32(np.tan(tilt))).astype(np.float32)
    rows = np.arange(height, dtype=np.float32)[:, None] + shift[None, :]
    columns = np.broadcast_to(x, rows.shape).astype(np.float32)
    values = cv2.remap(response, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    valid = cv2.remap(core.astype(np.float32), columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT) > 0.99
    count = valid.sum(axis=1).astype(np.float32)
    enough = count > 0.6 * _width(inside)
    clipped = np.clip(values, -0.2, 0.2)
    depth = np.where(enough, (clipped * valid).sum(axis=1) / np.maximum(count, 1.0), 0.0)
    hits = ((values > 0.4 * least_depth) & valid).sum(axis=1)
    coverage = np.where(enough, hits / np.maximum(count, 1.0), 0.0)
    return depth.astype(np.float32), coverage.astype(np.float32)


def _middle(inside: BoolArray) -> float:
    columns = np.flatnonzero(inside.any(axis=0))
    return float(columns.mean()) if len(columns) else 0.5 * inside.shape[1]


def _width(inside: BoolArray) -> float:
    widths = inside.sum(axis=1)
    return float(np.percentile(widths[widths > 0], 80)) if bool((widths > 0).any()) else 1.0


def _scatter(depth: NDArray[np.float32]) -> float:
    """How deep other lines across the finger usually look: the 80th percentile of the profile, at least zero."""
    known = depth[depth != 0.0]
    return max(float(np.percentile(known, 80.0)), 0.0) if known.size else 0.0


def _refine(profile: NDArray[np.float32], row: int) -> float:
    """Peak to a fraction of a row, by a parabola through three values."""
    if row == 0 or row == len(profile) - 1:
        return float(row)
    before, here, after = (float(v) for v in profile[row - 1 : row + 2])
    bend = before - 2.0 * here + after
    return float(row) if bend >= 0.0 else row + 0.5 * (before - after) / bend
