"""Where the first phalange ends: the first flexion crease below the tip.

Searched in the upright frame at about 8 px/mm: a crease is half a millimetre wide and more, ridges
must be gone. The cut itself is a straight line on the full grid.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.findings import Finding
from splitknit.finger.orientation import Upright
from splitknit.finger.regions import depth_inside, largest_component, reduce_image, reduce_mask
from splitknit.imaging.geometry import refined_peak, warp
from splitknit.model import BoolArray, FloatArray


class Crease(NamedTuple):
    """The first flexion crease, or the statement that none was seen."""

    detected: bool = False
    distance_mm: float = float("nan")
    """From the tip along the finger's axis."""
    row: float = float("nan")
    """Row in the upright frame (full resolution) at the finger's middle."""
    line: tuple[tuple[float, float], tuple[float, float]] | None = None
    """Two ends of the crease, (column, row) in the input."""
    verdict: Finding = Finding("no-crease", "none is sought on an opaque thing")
    """What was decided, and why."""


def find_crease(
    mean_grey: FloatArray, mask: BoolArray, upright: Upright, px_per_mm: float
) -> Crease:
    """Find the first flexion crease below the tip; where none is in view, the verdict says why.

    The thesis equalises and blurs the mean grey image, binarises it and takes the row with the most
    dark pixels. Here a logarithm equalises, which removes tone and brightness. A place counts as
    dark if it is darker than the skin on *both* sides of it along the finger; the edge of a shadow
    and a smooth gradient are not. Rows may lean, and a crease must cross most of the finger's
    width. Of several candidates, the clearest at a usual distance from the tip is taken. Two lines
    of one joint are one crease, cut at the upper line unless that is the fainter. Source: the
    thesis, section 3.3.1.1, "Phalange Segmentation", steps 1-5. `mean_grey`: (H, W) float32 linear;
    `mask`: (H, W) bool.
    """
    # scale of the copy that is searched: a crease is half a millimetre wide and more, and ridges
    # must not show
    scale = min(1.0, 8.0 / px_per_mm, 700 / max(upright.size))
    small, inside = _upright_copy(mean_grey, mask, upright, scale)
    valleys = _transverse_valleys(small, inside, px_per_mm * scale)
    tip_row = upright.tip_row
    at_full_scale = []
    for valley in valleys:
        row, left, right = (
            (place + 0.5) / scale - 0.5 for place in (valley.row, valley.left, valley.right)
        )
        distance_mm = (row - tip_row) / px_per_mm
        at_full_scale.append(
            valley._replace(row=row, left=left, right=right, distance_mm=distance_mm)
        )
    length_mm = (upright.size[0] - tip_row) / px_per_mm
    chosen, verdict = _judge(at_full_scale, upright.width_px / px_per_mm, length_mm)
    if chosen is None:
        return Crease(verdict=verdict)
    rise = 0.5 * (chosen.right - chosen.left) * float(np.tan(chosen.tilt_rad))
    ends = np.array([[chosen.left, chosen.row + rise, 1.0], [chosen.right, chosen.row - rise, 1.0]])
    (x0, y0), (x1, y1) = (ends @ upright.input_from_upright.T)[:, :2].tolist()
    return Crease(True, chosen.distance_mm, chosen.row, ((x0, y0), (x1, y1)), verdict)


def phalange_mask(mask: BoolArray, crease: Crease, upright: Upright) -> BoolArray:
    """The part of `mask` (H, W) on the tip's side of the crease, if any, cut normal to the finger's
    axis."""
    if not crease.detected:
        return mask
    across, along, offset = upright.upright_from_input[1]
    columns = np.arange(mask.shape[1], dtype=np.float32) * np.float32(across)
    rows = np.arange(mask.shape[0], dtype=np.float32) * np.float32(along) + np.float32(
        offset - crease.row
    )
    kept = mask & (columns[None, :] + rows[:, None] < 0.0)
    return largest_component(kept) if kept.any() else mask


class _Valley(NamedTuple):
    """A line across the finger that is darker than the skin above and below it (rows, columns:
    upright frame)."""

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
    """Fraction of the width along which it is seen."""
    distance_mm: float = float("nan")
    """From the tip."""


def _upright_copy(
    grey: FloatArray, mask: BoolArray, upright: Upright, scale: float
) -> tuple[FloatArray, BoolArray]:
    small = reduce_image(grey, scale)
    size = (max(8, round(upright.size[0] * scale)), max(8, round(upright.size[1] * scale)))
    # pixel centres to pixel corners
    half = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])
    ratios = small.shape[1] / grey.shape[1], small.shape[0] / grey.shape[0]
    shrink = np.linalg.inv(half) @ np.diag([*ratios, 1.0]) @ half
    grow = (
        np.linalg.inv(half)
        @ np.diag([upright.size[1] / size[1], upright.size[0] / size[0], 1.0])
        @ half
    )
    transform = shrink @ upright.input_from_upright @ grow
    return warp(small, transform, size), warp(reduce_mask(mask, scale), transform, size) > 0.9


_CREASE_RATIOS = (0.95, 2.4)
"""Where the first crease may lie: smallest and largest distance from the tip, in widths of the
finger. Chosen on: judgement. Range: 0.7 to 1 times these values (validation/parameters)."""
_CREASE_DISTANCES_MM = (14.0, 38.0)
"""Where it may lie in millimetres. Chosen on: judgement. Range: 0.7 to 1.4 times these values
(validation/parameters)."""


def _judge(
    candidates: Sequence[_Valley], width_mm: float, length_mm: float
) -> tuple[_Valley | None, Finding]:
    """Thesis step 4: choose among the candidates by clearness and by where a first crease usually
    lies."""
    keep = "the whole visible finger is kept."
    if not candidates:
        return None, Finding(
            "no-crease",
            f"no flexion crease is fully in view ({{:.0f mm}} of the finger are); {keep}",
            lengths_mm=(length_mm,),
        )
    near = max(_CREASE_DISTANCES_MM[0], _CREASE_RATIOS[0] * width_mm)
    far = min(_CREASE_DISTANCES_MM[1], _CREASE_RATIOS[1] * width_mm)
    plausible = [valley for valley in candidates if near <= valley.distance_mm <= far]
    if not plausible:
        places = "{:.1f mm-}, " * (len(candidates) - 1) + "{:.1f mm}"
        words = (
            f"dark lines lie {places} below the tip, none where the first flexion crease of a"
            f" finger {{:.1f mm}} wide can be; {keep}"
        )
        lengths_mm = (*(valley.distance_mm for valley in candidates), width_mm)
        return None, Finding("no-crease", words, lengths_mm=lengths_mm)

    def weight(valley: _Valley) -> float:
        # mean and standard deviation of a first crease's distance from the tip, in widths
        offset = (valley.distance_mm / width_mm - 1.55) / 0.35
        return valley.depth * valley.coverage * float(np.exp(-0.5 * offset * offset))

    lower = max(plausible, key=weight)

    def upper_line(valley: _Valley) -> bool:
        # two creases nearer than this are the two lines of one joint
        near = 0.0 < lower.distance_mm - valley.distance_mm <= 5.0
        # least depth of the upper of two such lines, over that of the lower one, for the upper to
        # be taken
        return near and valley.depth >= 0.75 * lower.depth

    chosen = next(filter(upper_line, plausible), lower)
    further = len(candidates) - 1
    extra = (
        f" ({further} further dark line{'s' if further > 1 else ''} weighed against it)"
        if further
        else ""
    )
    return chosen, Finding(
        "crease",
        f"cut at the first flexion crease, {{:.1f mm}} below the tip{extra}.",
        lengths_mm=(chosen.distance_mm,),
    )


# Dark lines across an upright finger.


_CREASE_SIDE_MM = 1.6
"""A valley must be darker than the skin this far above and below it. Chosen on: judgement. Range:
0.8 to 2.24 (validation/parameters)."""


_MIN_CREASE_DEPTH = 0.025  # minimum relative darkening, averaged over the finger's width
_MAX_CREASE_TILT_DEG = 15.0  # creases may lean by this much against the finger's axis


def _transverse_valleys(image: FloatArray, inside: BoolArray, px_per_mm: float) -> list[_Valley]:
    """All dark lines across an upright finger, from the tip down: places of the blurred image
    darker than the skin `_CREASE_SIDE_MM` above and below, averaged along lines that lean by up to
    `_MAX_CREASE_TILT_DEG`.
    """
    response, valid = _response(image, inside, px_per_mm)
    widths = inside.sum(axis=1)
    width = float(np.percentile(widths[widths > 0], 80)) if (widths > 0).any() else 1.0
    core = valid & (depth_inside(inside) > 0.08 * width)
    tilts = np.deg2rad(np.arange(-_MAX_CREASE_TILT_DEG, _MAX_CREASE_TILT_DEG + 0.1, 3.0))
    lines = [_along_lines(response, core, inside, width, float(tilt)) for tilt in tilts]
    depths, coverages = (np.stack(part) for part in zip(*lines, strict=True))
    best = np.argmax(depths * coverages, axis=0)
    rows = np.arange(depths.shape[1])
    depth = depths[best, rows]
    coverage = coverages[best, rows]
    tilt = tilts[best].astype(np.float32)
    known = depth[depth != 0.0]
    # depth of other lines
    usual = max(float(np.percentile(known, 80.0)), 0.0) if known.size else 0.0
    reach = max(1, round(_CREASE_SIDE_MM * px_per_mm))
    peaks = depth >= cv2.dilate(depth[:, None], np.ones((2 * reach + 1, 1), dtype=np.uint8))[:, 0]
    # 2.5 times the depth that lines across this finger usually show
    strong = (
        peaks
        & (depth >= max(_MIN_CREASE_DEPTH, 2.5 * usual))
        & (coverage >= 0.6)  # fraction of the finger's width along which the valley must show
    )
    valleys: list[_Valley] = []
    for row in np.flatnonzero(strong & inside.any(axis=1)).tolist():
        if valleys and row - valleys[-1].row <= reach:
            continue
        columns = np.flatnonzero(inside[row])
        place = refined_peak(depth, row), float(columns[0]), float(columns[-1])
        valleys.append(_Valley(*place, float(tilt[row]), float(depth[row]), float(coverage[row])))
    return valleys


def _response(
    image: FloatArray, inside: BoolArray, px_per_mm: float
) -> tuple[FloatArray, BoolArray]:
    """Relative darkness against the lesser of the two sides (H, W), and where it is known. It is of
    logarithms, free of tone and brightness. Each side is continued to the centre with the slope
    that *both* share (the lesser, none of opposite ones), so that no smooth gradient hides a
    crease; but a place must be darker than both sides as they are: a shadow's edge or foot is not.
    """
    weight = inside.astype(np.float32)
    # blur (sigma) across the crease; removes ridges of 0.43 mm period
    sigma = max(0.3 * px_per_mm, 0.3)
    light = cv2.GaussianBlur(np.maximum(image, 0.0) * weight, (0, 0), 2.0 * sigma, sigmaY=sigma)
    cover = cv2.GaussianBlur(weight, (0, 0), 2.0 * sigma, sigmaY=sigma)
    smooth = light / np.maximum(cover, 1e-3)
    typical = float(np.median(smooth[inside])) if inside.any() else 1.0
    level = np.log(np.maximum(smooth, max(0.02 * typical, 1e-12)))
    step = max(1, round(_CREASE_SIDE_MM * px_per_mm))

    def beside(part: NDArray[Any]) -> list[NDArray[Any]]:
        padded = np.pad(part, ((2 * step, 2 * step), (0, 0)))
        return [padded[k * step :][: len(part)] for k in (0, 1, 3, 4)]

    farther_above, above, below, farther_below = beside(level)
    has_slope_above, has_above, has_below, has_slope_below = beside(inside)
    slope_above = above - farther_above
    slope_below = farther_below - below
    agree = has_slope_above & has_slope_below & (slope_above * slope_below > 0.0)
    lesser = np.sign(slope_above) * np.minimum(np.abs(slope_above), np.abs(slope_below))
    slope = np.where(agree, lesser, 0.0)
    plain = np.minimum(above, below) - level
    response = np.minimum(
        np.minimum(above + slope, below - slope) - level, 3.0 * np.maximum(plain, 0.0)
    )
    response = np.where(plain > 0.0, response, np.minimum(plain, 0.0))
    known = inside & has_above & has_below
    return np.where(known, response, 0.0).astype(np.float32), known


def _along_lines(
    response: FloatArray, core: BoolArray, inside: BoolArray, finger_width: float, tilt: float
) -> tuple[FloatArray, FloatArray]:
    """Mean response and fraction of responding columns for every line of one lean; zero where too
    little is known."""
    occupied = np.flatnonzero(inside.any(axis=0))
    centre = float(occupied.mean()) if len(occupied) else 0.0
    lean = float(np.tan(tilt))
    shear = np.array([[1.0, 0.0, 0.0], [-lean, 1.0, lean * centre], [0.0, 0.0, 1.0]])
    values, valid = (
        warp(part, shear, response.shape) for part in (response, core.astype(np.float32))
    )
    known = valid > 0.99
    count = known.sum(axis=1).astype(np.float32)
    enough = count > 0.6 * finger_width
    depth = np.where(
        enough, (np.clip(values, -0.2, 0.2) * known).sum(axis=1) / np.maximum(count, 1.0), 0.0
    )
    hits = ((values > 0.4 * _MIN_CREASE_DEPTH) & known).sum(axis=1)
    coverage = np.where(enough, hits / np.maximum(count, 1.0), 0.0)
    return depth.astype(np.float32), coverage.astype(np.float32)
