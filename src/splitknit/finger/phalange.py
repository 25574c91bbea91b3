"""Where the first phalange ends: the first flexion crease below the tip.

Searched in the upright frame at about 8 px/mm: a crease is half a millimetre wide and more, ridges must be gone. The
cut itself is a straight line on the full grid.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from splitknit.errors import check_image, check_mask, require
from splitknit.finger.orientation import Upright
from splitknit.finger.regions import largest_component, reduce_image, reduce_mask
from splitknit.finger.valleys import Valley, transverse_valleys
from splitknit.imaging.geometry import warp
from splitknit.model import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class CreaseSettings:
    """What counts as the first flexion crease."""

    working_px_per_mm: float = 8.0
    """Scale of the copy that is searched."""
    smoothing_mm: float = 0.3
    """Blur (sigma) across the crease; takes out ridges of 0.43 mm period."""
    side_mm: float = 1.6
    """A valley must be darker than the skin this far above and below it."""
    least_depth: float = 0.025
    """Least relative darkening, averaged over the finger's width."""
    least_coverage: float = 0.6
    """Share of the finger's width along which the valley must be seen."""
    least_prominence: float = 2.5
    """Least depth in units of what lines across this finger usually show (80th percentile of the profile)."""
    greatest_tilt_deg: float = 15.0
    """Creases may lean by this much against the finger's axis."""
    ratio_range: tuple[float, float] = (0.95, 2.4)
    """Where the first crease may lie: distance from the tip in finger widths."""
    distance_range_mm: tuple[float, float] = (14.0, 38.0)
    """... and in millimetres."""
    expected_ratio: float = 1.55
    """Distance of the first crease in finger widths, on average."""
    ratio_spread: float = 0.35
    """Standard deviation of that ratio, with which two candidates are weighed against each other."""
    doublet_mm: float = 5.0
    """Two creases nearer than this are the two lines of one joint."""
    doublet_share: float = 0.75
    """Of two such lines the upper is taken if it is at least this deep relative to the lower."""

    def __post_init__(self) -> None:
        for name in (
            "working_px_per_mm", "smoothing_mm", "side_mm", "least_depth", "least_prominence", "expected_ratio",
            "ratio_spread", "doublet_mm",
        "doublet_share",
        ):  # fmt: skip
            require(getattr(self, name) > 0, f"crease.{name} must be positive.")
        require(0 < self.least_coverage <= 1, "crease.least_coverage must lie in (0, 1].")
        require(0 <= self.greatest_tilt_deg <= 30, "crease.greatest_tilt_deg must lie in [0, 30].")
        for name in ("ratio_range", "distance_range_mm"):
            low, high = getattr(self, name)
            require(0 <= low < high, f"crease.{name} must be two numbers, the smaller first.")


@dataclass(frozen=True, slots=True, eq=False)
class Crease:
    """The first flexion crease, or the statement that none was seen."""

    found: bool
    distance_mm: float
    """From the tip along the finger's axis; NaN if not found."""
    row: float
    """Row in the upright frame (full resolution) at the finger's middle; NaN if not found."""
    line: tuple[tuple[float, float], tuple[float, float]] | None
    """Two ends of the crease, (column, row) in the input."""
    candidates: tuple[Valley, ...] = field(default=())
    """All transverse valleys that were seen, from the tip down."""
    verdict: str = ""
    """What was decided and why, in words."""


def find_crease(
    mean_grey: FloatArray,
    mask: BoolArray,
    upright: Upright,
    px_per_mm: float,
    settings: CreaseSettings | None = None,
) -> Crease:
    """Find the first flexion crease below the tip.

    The thesis equalises and blurs the mean grey image, binarises it and looks for the row with most dark pixels. Here
    the equalisation is a logarithm (so tone and brightness drop out), the binarisation asks of
    every place whether it is darker than the skin on *both* sides along the finger (so the edge of a shadow, which is
    a step, and a smooth gradient never count), and rows may lean. A crease must be seen along most of the width.

    Where several qualify, the verification rule weighs their clearness by how usual their distance from the tip is;
    two lines of one joint count as one, cut at the upper unless it is the fainter.

    Parameters
    ----------
    mean_grey : (H, W) float32 linear
    mask : (H, W) bool
    upright : Upright
    px_per_mm : float
    settings : CreaseSettings, optional

    Returns
    -------
    Crease
        `found` is false, with the reason in `verdict`, where no crease is in view: the visible finger is then kept.

    References
    ----------
    The thesis, section 3.3.1.1, "Phalange Segmentation", steps 1-5.
    """
    settings = settings or CreaseSettings()
    grey = check_image(mean_grey, name="the mean grey image")
    mask = check_mask(mask, (grey.shape[0], grey.shape[1]))
    scale = min(1.0, settings.working_px_per_mm / px_per_mm, 700 / max(upright.size))
    small, inside = _upright_copy(grey, mask, upright, scale)
    found = transverse_valleys(
        small,
        inside,
        px_per_mm * scale,
        smoothing_mm=settings.smoothing_mm,
        side_mm=settings.side_mm,
        least_depth=settings.least_depth,
        least_coverage=settings.least_coverage,
        least_prominence=settings.least_prominence,
        greatest_tilt_deg=settings.greatest_tilt_deg,
    )
    width_mm = upright.width_px / px_per_mm
    tip_row = upright.tip_row
    placed = tuple(v.moved(1.0 / scale, tip_row, px_per_mm) for v in found)
    length_mm = (upright.size[0] - tip_row) / px_per_mm
    chosen, verdict = _judge(placed, width_mm, length_mm, settings)
    if chosen is None:
        return Crease(False, float("nan"), float("nan"), None, placed, verdict)
    return Crease(True, chosen.distance_mm, chosen.row, _ends(chosen, upright), placed, verdict)


def phalange_mask(mask: BoolArray, crease: Crease, upright: Upright) -> BoolArray:
    """The part of `mask` (H, W) on the tip's side of the crease, cut normal to the finger's axis.

    Without a crease the mask is returned as it is.
    """
    if not crease.found:
        return mask
    across, along, offset = upright.upright_from_input[1]
    columns = np.arange(mask.shape[1], dtype=np.float32) * np.float32(across)
    rows = np.arange(mask.shape[0], dtype=np.float32) * np.float32(along) + np.float32(offset - crease.row)
    kept = mask & (columns[None, :] + rows[:, None] < 0.0)
    return largest_component(kept) if kept.any() else mask


def _upright_copy(grey: FloatArray, mask: BoolArray, upright: Upright, scale: float) -> tuple[FloatArray, BoolArray]:
    """Reduced copies of image and mask in the upright frame."""
    small, share = reduce_image(grey, scale), reduce_mask(mask, scale)
    size = (max(8, round(upright.size[0] * scale)), max(8, round(upright.size[1] * scale)))
    half = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])  # pixel centres to pixel corners
    ratios = small.shape[1] / grey.shape[1], small.shape[0] / grey.shape[0]
    shrink = np.linalg.inv(half) @ np.diag([*ratios, 1.0]) @ half
    grow = np.linalg.inv(half) @ np.diag([upright.size[1] / size[1], upright.size[0] / size[0], 1.0]) @ half
    transform = shrink @ upright.input_from_upright @ grow
    return warp(small, transform, size), np.asarray(warp(share, transform, size) > 0.9, dtype=np.bool_)


def _judge(
    candidates: tuple[Valley, ...], width_mm: float, length_mm: float, settings: CreaseSettings
) -> tuple[Valley | None, str]:
    """Thesis step 4: choose among the candidates by clearness and by where a first crease usually lies."""
    keep = "the whole visible finger is kept."
    if not candidates:
        return None, f"no flexion crease is fully in view ({length_mm:.0f} mm of the finger are); {keep}"
    low, high = settings.ratio_range
    near, far = settings.distance_range_mm
    plausible = [
        valley
        for valley in candidates
        if low <= valley.distance_mm / width_mm <= high and near <= valley.distance_mm <= far
    ]
    if not plausible:
        places = ", ".join(f"{valley.distance_mm:.1f}" for valley in candidates)
        return None, (
            f"dark lines lie {places} mm below the tip, none where the first flexion crease of a finger "
            f"{width_mm:.1f} mm wide can be; {keep}"
        )

    def weight(valley: Valley) -> float:
        offset = (valley.distance_mm / width_mm - settings.expected_ratio) / settings.ratio_spread
        return valley.depth * valley.coverage * float(np.exp(-0.5 * offset * offset))

    best = max(plausible, key=weight)
    for valley in plausible:
        if (
            0.0 < best.distance_mm - valley.distance_mm <= settings.doublet_mm
            and valley.depth >= settings.doublet_share * best.depth
        ):
            best = valley
            break
    others = len(candidates) - 1
    extra = "" if others == 0 else f" ({others} further dark line{'s' if others > 1 else ''} weighed against it)"
    return best, f"cut at the first flexion crease, {best.distance_mm:.1f} mm below the tip{extra}."


def _ends(valley: Valley, upright: Upright) -> tuple[tuple[float, float], tuple[float, float]]:
    half = 0.5 * (valley.right - valley.left)
    rise = half * float(np.tan(valley.tilt_rad))
    points = np.array([[valley.left, valley.row + rise, 1.0], [valley.right, valley.row - rise, 1.0]], dtype=np.float64)
    first, second = (points @ upright.input_from_upright.T)[:, :2]
    return (float(first[0]), float(first[1])), (float(second[0]), float(second[1]))
