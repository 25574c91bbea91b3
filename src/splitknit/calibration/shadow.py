"""The tips of a nail and of its shadows in photographs: one image under each LED of a band.

What is dark whatever LED is lit is the nail; what is dark under one LED only is a shadow. The ratio of an image to the
median of all takes the ground's texture, the lens and half of the light's fall-off away; a smooth surface takes the
rest. The shadow of a cone is the hull of its base and of the tip's shadow, with a penumbra that widens towards the tip;
that shape is fitted to every shadow, so that the blunt tip and the penumbra do not draw the tip out or in.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.calibration.nail_tip import nail_tip
from splitknit.calibration.shadow_shape import Scale, Shape, fit_shape
from splitknit.errors import check_stack, require
from splitknit.model import BoolArray, FloatArray

Points = NDArray[np.float64]
_STRETCH = 1.12
"""A tip's shadow against the tip: for a nail of an eighth to a tenth of the LEDs' height. It hardly matters."""


@dataclass(frozen=True, slots=True)
class ShadowSettings:
    """What counts as nail and as shadow. Sizes on the finger plane."""

    nail_level: float = 0.45
    """The nail is darker than this part of the ground around it under every LED."""
    shadow_level: float = 0.5
    """A shadow is darker than this part of the same place under the other LEDs."""
    least_nail_mm2: float = 0.3
    """Area of the nail that is seen."""
    least_shadow_mm: float = 0.7
    """A shadow must reach this far beyond the nail."""
    border_mm: float = 0.3
    """A shadow that comes nearer to the picture's border leaves it."""
    max_pixels: int = 500
    """Pixels about one shadow's outline that the fit takes, evenly spread."""

    def __post_init__(self) -> None:
        require(0.05 <= self.nail_level <= 0.9, "ShadowSettings: nail_level must lie in 0.05 to 0.9.")
        require(0.05 <= self.shadow_level <= 0.9, "ShadowSettings: shadow_level must lie in 0.05 to 0.9.")
        for name in ("least_nail_mm2", "least_shadow_mm", "border_mm"):
            require(0 <= getattr(self, name) <= 100, f"ShadowSettings: {name} must lie between 0 and 100.")
        require(self.max_pixels >= 100, "ShadowSettings: max_pixels must be at least 100.")


@dataclass(frozen=True, slots=True, eq=False)
class NailView:
    """What the images of one nail position and one band show; pixels are columns and rows."""

    nail_px: Points
    """(2,) the nail's tip."""
    tips_px: Points
    """(L, 2) the shadows' tips; NaN where a shadow leaves the picture."""
    shapes: tuple[Shape | None, ...]
    """The shadows' outlines as fitted."""
    nail: BoolArray
    """(H, W)."""


def find_nail(
    stack: FloatArray, px_per_mm: float, names: Sequence[str], settings: ShadowSettings | None = None
) -> NailView:
    """Find the tips of the nail and of its shadows.

    Parameters
    ----------
    stack : (L, H, W), L >= 3, linear light, the nail in one place, another LED lit in each image
    px_per_mm : scale on the finger plane
    names : of the images, for messages
    settings : ShadowSettings

    Returns
    -------
    NailView

    Raises
    ------
    BadInput
        If there is no nail, or an image without its shadow (named).
    """
    settings = settings or ShadowSettings()
    images = check_stack(stack, least=3, name="the photographs of the nail")
    usual = np.median(images, axis=0).astype(np.float32)
    require(float(np.percentile(usual, 99)) > 0, f"{names[0]} and the images beside it are black.")
    ground = _smooth(usual, np.ones(usual.shape, dtype=np.bool_))
    dark = usual < settings.nail_level * ground
    ratios = [_ratio(image, usual, dark) for image in images]
    shadows = np.stack([(ratio < settings.shadow_level) & ~dark for ratio in ratios])
    nail = _nail_among(dark, shadows, px_per_mm, settings, names)
    rows, columns = np.nonzero(nail)
    middle = np.array([columns.mean(), rows.mean()])
    size = float(np.sqrt(rows.size / np.pi))
    near = cv2.dilate(nail.astype(np.uint8), _disc(0.25 * px_per_mm)) > 0
    parts = [_shadow_of(shadow, near) for shadow in shadows]
    ends = [_far_end(part, middle) for part in parts]
    for end, name in zip(ends, names, strict=True):
        reach = float(np.linalg.norm(end - middle)) - size if end is not None else 0.0
        require(
            reach >= settings.least_shadow_mm * px_per_mm,
            f"{name} shows no shadow of the nail; check that its LED was lit, and alone, and that the nail stands in "
            f"the picture.",
        )
    scale = Scale(px_per_mm, settings.max_pixels)
    first: list[Shape | None] = []
    for ratio, part, end in zip(ratios, parts, ends, strict=True):
        if end is None or _leaves(part, settings.border_mm * px_per_mm):
            first.append(None)
            continue
        start = Shape(
            tip=end, tip_radius=0.1 * px_per_mm, penumbra=0.1 * px_per_mm, base=middle, base_radius=size, depth=0.95
        )
        first.append(fit_shape(1.0 - ratio, ~near, start, scale))
    shapes = _second_fit(first, [1.0 - ratio for ratio in ratios], ~near, scale)
    tips = np.array([(np.nan, np.nan) if shape is None else shape.tip for shape in shapes])
    # the faces meet where a sharp tip would be; the blunt one lies lower, and so is seen nearer to the base
    blunt = float(np.median([shape.tip_radius for shape in shapes if shape is not None] or [0.0])) / _STRETCH
    tip = middle + (nail_tip(images, nail, px_per_mm) - middle) * (1.0 - min(blunt / size, 0.5))
    return NailView(tip, tips, shapes, nail)


def _second_fit(
    first: Sequence[Shape | None],
    darkness: Sequence[FloatArray],
    usable: BoolArray,
    scale: Scale,
) -> tuple[Shape | None, ...]:
    """All shadows again with one bluntness of tip and one penumbra, for it is one nail."""
    found = [shape for shape in first if shape is not None]
    if len(found) < 3:
        return tuple(first)
    common = (
        float(np.median([shape.tip_radius for shape in found])),
        float(np.median([shape.penumbra for shape in found])),
    )
    return tuple(
        None if shape is None else fit_shape(dark, usable, shape, scale, common)
        for shape, dark in zip(first, darkness, strict=True)
    )


def _ratio(image: FloatArray, usual: FloatArray, dark: BoolArray) -> FloatArray:
    """The image against the median of all, one where it is lit as usual, (H, W)."""
    ratio: FloatArray = np.asarray(image / np.maximum(usual, np.float32(1e-6)), dtype=np.float32)
    return np.asarray(ratio / np.maximum(_smooth(ratio, ~dark), 1e-3), dtype=np.float32)


def _smooth(image: FloatArray, usable: BoolArray) -> FloatArray:
    """A surface of the second degree through most of an image's pixels, whatever few are much darker, (H, W)."""
    height, width = image.shape
    step = max(1, int(np.sqrt(image.size / 20_000)))
    rows, columns = np.mgrid[0:height:step, 0:width:step]
    keep = usable[::step, ::step]
    terms = _terms(rows[keep] / height - 0.5, columns[keep] / width - 0.5)
    values = image[::step, ::step][keep].astype(np.float64)
    good = np.ones(values.size, dtype=np.bool_)
    for _ in range(8):
        weights = np.linalg.lstsq(terms[good], values[good], rcond=None)[0]
        off = values - terms @ weights
        spread = 1.4826 * float(np.median(np.abs(off[good]))) + 1e-9
        good = np.abs(off) < 3.0 * spread
    r, c = np.arange(height)[:, None] / height - 0.5, np.arange(width)[None, :] / width - 0.5
    surface = weights[0] + weights[1] * r + weights[2] * c
    surface = surface + weights[3] * r * r + weights[4] * r * c + weights[5] * c * c
    return np.asarray(surface, dtype=np.float32)


def _terms(r: Points, c: Points) -> Points:
    return np.stack([np.ones_like(r), r, c, r * r, r * c, c * c], axis=1)


def _nail_among(
    dark: BoolArray, shadows: NDArray[np.bool_], px_per_mm: float, settings: ShadowSettings, names: Sequence[str]
) -> BoolArray:
    """The dark thing from which most shadows start: dots on the ground have none."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(dark.astype(np.uint8), connectivity=8)
    area = settings.least_nail_mm2 * px_per_mm**2
    best, most = 0, 0.0
    ring_width = _disc(0.4 * px_per_mm)
    for label in range(1, count):
        if stats[label, cv2.CC_STAT_AREA] >= area:
            part = (labels == label).astype(np.uint8)
            ring = (cv2.dilate(part, ring_width) > 0) & (part == 0)
            touched = float(sum(bool((shadow & ring).sum() > 0.03 * ring.sum()) for shadow in shadows))
            if touched > most:
                best, most = label, touched
    require(
        best > 0,
        f"no nail with shadows was found in {names[0]} and the images beside it; it must be darker than the ground, "
        f"upright, and wholly in the picture, and nothing else may move.",
    )
    filled = cv2.morphologyEx((labels == best).astype(np.uint8), cv2.MORPH_CLOSE, _disc(0.3 * px_per_mm))
    return np.asarray(filled > 0)


def _shadow_of(shadow: BoolArray, near: BoolArray) -> BoolArray:
    """The part of a shadow's pixels that hangs together with the nail."""
    opened = cv2.medianBlur(shadow.astype(np.uint8), 3)
    _, labels = cv2.connectedComponents((opened > 0).astype(np.uint8) | near.astype(np.uint8), connectivity=8)
    touching = np.unique(labels[near])
    part = np.isin(labels, touching[touching > 0]) & (opened > 0) & ~near
    return np.asarray(part)


def _far_end(part: BoolArray, middle: Points) -> Points | None:
    rows, columns = np.nonzero(part)
    if rows.size == 0:
        return None
    away = np.hypot(columns - middle[0], rows - middle[1])
    far = away >= np.quantile(away, 0.999)
    return np.array([columns[far].mean(), rows[far].mean()])


def _leaves(part: BoolArray, border_px: float) -> bool:
    border = max(round(border_px), 1)
    inner = part[border:-border, border:-border]
    return int(inner.sum()) < int(part.sum())


def _disc(radius_px: float) -> NDArray[np.uint8]:
    size = 2 * max(round(radius_px), 1) + 1
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)), dtype=np.uint8)
