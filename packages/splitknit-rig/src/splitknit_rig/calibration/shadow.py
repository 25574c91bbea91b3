"""The tips of a nail and of its shadows in photographs: one image under each LED of a band.

Pixels that are dark under every LED are the nail; pixels that are dark under one LED only are its
shadow. Dividing an image by the median of all removes the ground's texture, the lens's fall-off and
half of the light's fall-off; dividing by a smooth surface removes the rest. The shadow of a cone is
the hull of its base and of the tip's shadow, with a penumbra that widens towards the tip; that
shape is fitted to every shadow, so that neither the blunt tip nor the penumbra biases the tip's
position.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.special import ndtr

from splitknit.checks import check_stack
from splitknit.errors import require
from splitknit.imaging.robust import cauchy, deviation
from splitknit.model import Array, BoolArray, FloatArray, GreyArray

# The shadow of a blunt cone as a shape: the hull of two circles, softened by the size of the light.

_RING = 2.0 * np.pi * np.arange(8) / 8
"""Source: definition of eight equal steps."""
_LIGHT = np.concatenate([np.zeros((1, 2)), 0.75 * np.stack([np.cos(_RING), np.sin(_RING)], axis=1)])
"""(9, 2) points that stand for equal parts of a disc of radius one and have its spread.

Source: the variance of a disc, a quarter along each axis.
"""


@dataclass(frozen=True, slots=True, eq=False)
class _Shape:
    tip: Array  # (2,) column and row: where the light's middle throws the middle of the nail's tip
    tip_radius: float  # radius of the blunt tip's shadow
    penumbra: float  # radius of the light's image about the tip
    base: Array  # (2,) middle of the cone's base
    base_radius: float
    depth: float  # how much of the light is missing in the full shadow

    def darkness(self, places: Array) -> Array:
        """Fraction of the light that is missing at places (N, 2), column and row."""
        total = np.zeros(len(places))
        for tip in self.tip + self.penumbra * _LIGHT:
            away = _hull_distance(
                places - self.base, tip - self.base, self.base_radius, self.tip_radius
            )
            # an edge is soft by half a pixel (standard deviation): pixels and lens
            total += ndtr(-away / 0.5)
        return self.depth * total / len(_LIGHT)


def _hull_distance(places: Array, far_end: Array, radius: float, far_radius: float) -> Array:
    """Distance (N,), negative inside, to the hull of a circle about the origin and another about
    `far_end` (2,)."""
    length = max(float(np.linalg.norm(far_end)), 1e-9)
    along = places @ far_end / length
    beside = np.abs(places[:, 0] * far_end[1] - places[:, 1] * far_end[0]) / length
    slope = float(np.clip((radius - far_radius) / length, -0.999, 0.999))
    across = float(np.sqrt(1.0 - slope * slope))
    foot = across * along - slope * beside
    square = beside * beside  # and no hypot, which is slow
    near = np.sqrt(along * along + square) - radius
    far = np.sqrt((along - length) ** 2 + square) - far_radius
    side = across * beside + slope * along - radius
    return np.asarray(np.where(foot < 0, near, np.where(foot > across * length, far, side)))


def _fit_shape(
    darkness: FloatArray,
    usable: BoolArray,
    start: _Shape,
    px_per_mm: float,
) -> _Shape:
    """Fit the shape to the darkness (H, W), the missing fraction of the light, about its outer
    part. `usable`: (H, W), off the nail.
    """

    def shape_of(v: Array) -> _Shape:
        return _Shape(v[0:2], abs(v[6]), abs(v[7]), v[2:4], abs(v[4]), v[5])

    def residuals(v: Array, places: Array, values: Array) -> Array:
        # the base is seldom seen; its place is known from the nail, loosely
        known = [(v[2] - start.base[0]) / px_per_mm, (v[3] - start.base[1]) / px_per_mm]
        known += [(v[4] - start.base_radius) / px_per_mm, (v[5] - 0.97) / 0.05]
        known += [(v[6] / px_per_mm - 0.15) / 0.15, (v[7] / px_per_mm - 0.15) / 0.15]
        return np.concatenate([shape_of(v).darkness(places) - values, 0.3 * np.array(known)])

    shape = start
    sizes = np.array([1.0, 1.0, 5.0, 5.0, 5.0, 0.05, 1.0, 1.0])
    # the pixels are chosen again once the outline is better known
    for _ in range(2):
        pixels = _pixels_about(darkness, usable, shape, px_per_mm)
        if len(pixels[0]) < 20:
            return shape
        x = np.array(
            [
                *shape.tip,
                *shape.base,
                shape.base_radius,
                shape.depth,
                shape.tip_radius,
                shape.penumbra,
            ]
        )
        fit = least_squares(
            residuals,
            x,
            x_scale=sizes,
            loss="soft_l1",
            f_scale=0.15,
            max_nfev=20,
            args=pixels,
        )
        shape = shape_of(np.asarray(fit.x))
    return shape


_OUTLINE_PIXELS = 500
"""Number of pixels near a shadow's tip, evenly spread; half as many along its sides. Chosen on:
speed."""


def _pixels_about(
    darkness: FloatArray, usable: BoolArray, shape: _Shape, px_per_mm: float
) -> tuple[Array, Array]:
    """Columns and rows (N, 2) of pixels near the outline of the outer shadow, and their darkness
    (N,)."""
    arm, margin = shape.tip - shape.base, 0.7 * px_per_mm + shape.penumbra
    length, reach = float(np.linalg.norm(arm)), margin + shape.base_radius
    box = np.stack([shape.tip, shape.base + 0.25 * arm])
    low = np.maximum(np.floor(box.min(axis=0) - reach).astype(int), 0)
    high = np.minimum(
        np.ceil(box.max(axis=0) + reach).astype(int) + 1, np.array(darkness.shape[::-1])
    )
    if np.any(high - low < 2):
        return np.empty((0, 2)), np.empty(0)
    columns, rows = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
    places = np.stack([columns.ravel(), rows.ravel()], axis=1).astype(np.float64)
    distance = _hull_distance(places - shape.base, arm, shape.base_radius, shape.tip_radius)
    along = (places - shape.base) @ arm / length
    chosen = (
        (np.abs(distance) < margin)
        & (along > 0.25 * length)
        & usable[rows.ravel(), columns.ravel()]
    )
    index = np.flatnonzero(chosen)
    # near the tip all pixels count, along the sides as many as there is room for
    near = np.linalg.norm(places[index] - shape.tip, axis=1) < 1.5 * px_per_mm
    index = np.concatenate(
        [_thin(index[near], _OUTLINE_PIXELS), _thin(index[~near], _OUTLINE_PIXELS // 2)]
    )
    values = darkness[rows.ravel()[index], columns.ravel()[index]].astype(np.float64)
    return places[index], np.clip(values, -0.5, 1.2)


def _thin(index: NDArray[np.intp], most: int) -> NDArray[np.intp]:
    return index[:: max(1, -(-index.size // most))]


@dataclass(frozen=True, slots=True, eq=False)
class NailView:
    """Tips in the images of one nail position and one band, as columns and rows."""

    nail_px: Array  # (2,) the nail's tip
    tips_px: Array  # (L, 2) the shadows' tips; NaN where a shadow leaves the picture
    nail: BoolArray  # (H, W)


def find_nail(stack: FloatArray, px_per_mm: float, names: Sequence[str]) -> NailView:
    """Tips of the nail and its shadows in `stack` (L, H, W), L >= 3, linear, one image per LED.
    Raises BadInput if there is no nail, or an image shows no shadow (the image is named).
    """
    images = check_stack(stack, least=3, name="the photographs of the nail")
    usual = np.median(images, axis=0).astype(np.float32)
    require(float(np.percentile(usual, 99)) > 0, f"{names[0]} and the images beside it are black.")
    ground = _smooth(usual, np.ones(usual.shape, dtype=np.bool_))
    # the nail is darker than the ground around it, a shadow than its place under the other LEDs
    dark = usual < 0.45 * ground
    ratios = [_ratio(image, usual, dark) for image in images]
    shadows = np.stack([(ratio < 0.5) & ~dark for ratio in ratios])
    nail = _nail_among(dark, shadows, px_per_mm, names)
    rows, columns = np.nonzero(nail)
    middle = np.array([columns.mean(), rows.mean()])
    size = float(np.sqrt(rows.size / np.pi))
    near = cv2.dilate(nail.astype(np.uint8), _disc(0.25 * px_per_mm)) > 0
    shapes: dict[int, _Shape] = {}
    # a shadow within 0.3 mm of the picture's border leaves it
    border = max(round(0.3 * px_per_mm), 1)
    for led, (shadow, name) in enumerate(zip(shadows, names, strict=True)):
        part = _shadow_of(shadow, near)
        end = _far_end(part, middle)
        reach = float(np.linalg.norm(end - middle)) - size
        require(
            reach >= 0.7 * px_per_mm,  # mm beyond the nail
            f"{name} shows no shadow of the nail; check that its LED was lit, and alone, and that"
            " the nail stands in the picture.",
        )
        if part[border:-border, border:-border].sum() == part.sum():  # else it leaves the picture
            start = _Shape(end, 0.1 * px_per_mm, 0.1 * px_per_mm, middle, size, depth=0.95)
            shapes[led] = _fit_shape(1.0 - ratios[led], ~near, start, px_per_mm)
    tips = np.full((len(images), 2), np.nan)
    for led, shape in shapes.items():
        tips[led] = shape.tip
    # the faces meet where a sharp tip would be; the blunt one lies lower, and so is seen nearer to
    # the base; a tip's shadow is 1.12 times the tip for a nail of an eighth of the LEDs' height
    blunt = float(np.median([shape.tip_radius for shape in shapes.values()] or [0.0])) / 1.12
    tip = middle + (_nail_tip(images, nail, px_per_mm) - middle) * (1.0 - min(blunt / size, 0.5))
    return NailView(tip, tips, nail)


def _ratio(image: FloatArray, usual: FloatArray, dark: BoolArray) -> FloatArray:
    """Ratio of the image to the median of all, (H, W), one where nothing is shadowed."""
    ratio: FloatArray = np.asarray(image / np.maximum(usual, np.float32(1e-6)), dtype=np.float32)
    return np.asarray(ratio / np.maximum(_smooth(ratio, ~dark), 1e-3), dtype=np.float32)


def _smooth(image: FloatArray, usable: BoolArray) -> FloatArray:
    """A quadratic surface (H, W) through most of an image's pixels, robust to a few that are much
    darker."""
    height, width = image.shape
    step = max(1, int(np.sqrt(image.size / 20_000)))
    rows, columns = np.mgrid[0:height:step, 0:width:step]
    keep = usable[::step, ::step]
    r, c = rows[keep] / height - 0.5, columns[keep] / width - 0.5
    terms = np.stack([np.ones_like(r), r, c, r * r, r * c, c * c], axis=1)
    values = image[::step, ::step][keep].astype(np.float64)
    good = np.ones(values.size, dtype=np.bool_)
    for _ in range(8):
        weights = np.linalg.lstsq(terms[good], values[good], rcond=None)[0]
        off = values - terms @ weights
        spread = deviation(off[good]) + 1e-9
        good = np.abs(off) < 3.0 * spread
    r, c = np.arange(height)[:, None] / height - 0.5, np.arange(width)[None, :] / width - 0.5
    a, by_r, by_c, rr, rc, cc = weights
    return np.asarray(
        a + by_r * r + by_c * c + rr * r * r + rc * r * c + cc * c * c, dtype=np.float32
    )


def _nail_among(
    dark: BoolArray, shadows: BoolArray, px_per_mm: float, names: Sequence[str]
) -> BoolArray:
    """The dark region from which most shadows start; dots on the ground cast none."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(
        dark.astype(np.uint8), connectivity=8
    )
    area = 0.3 * px_per_mm**2  # mm^2
    best, most = 0, 0
    for label in range(1, count):
        if stats[label, cv2.CC_STAT_AREA] >= area:
            part = (labels == label).astype(np.uint8)
            ring = (cv2.dilate(part, _disc(0.4 * px_per_mm)) > 0) & (part == 0)
            touched = sum(bool((shadow & ring).sum() > 0.03 * ring.sum()) for shadow in shadows)
            best, most = (label, touched) if touched > most else (best, most)
    require(
        best > 0,
        f"no nail with shadows was found in {names[0]} and the images beside it; it must be darker"
        " than the ground, upright, and wholly in the picture, and nothing else may move.",
    )
    filled = cv2.morphologyEx(
        (labels == best).astype(np.uint8), cv2.MORPH_CLOSE, _disc(0.3 * px_per_mm)
    )
    return filled > 0


def _shadow_of(shadow: BoolArray, near: BoolArray) -> BoolArray:
    """The part of a shadow's pixels that is connected to the nail."""
    opened = cv2.medianBlur(shadow.astype(np.uint8), 3)
    _, labels = cv2.connectedComponents(
        (opened > 0).astype(np.uint8) | near.astype(np.uint8), connectivity=8
    )
    touching = np.unique(labels[near])
    return np.isin(labels, touching[touching > 0]) & (opened > 0) & ~near


def _far_end(part: BoolArray, middle: Array) -> Array:
    """End (2,) of a shadow; the middle of the nail if there is none."""
    rows, columns = np.nonzero(part)
    if rows.size == 0:
        return middle
    away = np.hypot(columns - middle[0], rows - middle[1])
    far = away >= np.quantile(away, 0.999)
    return np.array([columns[far].mean(), rows[far].mean()])


def _disc(radius_px: float) -> GreyArray:
    size = 2 * max(round(radius_px), 1) + 1
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)), dtype=np.uint8)


# The tip of a cone seen from above, from how its faces are lit.


def _nail_tip(stack: FloatArray, nail: BoolArray, px_per_mm: float) -> Array:
    """Image (2,) of a cone's tip in `stack` (L, H, W), linear. Lines from a cone's tip to its base
    are lit equally along their length: the gradient g of brightness (over the LEDs' mean) at p
    obeys g . (p - tip) = 0, by robust least squares over all pixels and images (turned by 90 deg:
    R. Parthasarathy, Nature Methods 9, 2012).
    """
    sigma = max(0.08 * px_per_mm, 0.7)
    margin = round(3.0 * sigma) + 1
    rows, columns = np.nonzero(nail)
    top, left = max(int(rows.min()) - margin, 0), max(int(columns.min()) - margin, 0)
    part = (slice(top, int(rows.max()) + margin + 1), slice(left, int(columns.max()) + margin + 1))
    inner = cv2.erode(nail[part].astype(np.uint8), _disc(margin), borderValue=0)
    places = np.argwhere(inner > 0)[:, ::-1].astype(np.float64)
    require(
        len(places) >= 30,
        "the nail is too small in the picture for its tip to be found; type the table instead.",
    )
    soft = [
        cv2.GaussianBlur(np.asarray(image[part], dtype=np.float32), (0, 0), sigma)
        for image in stack
    ]
    # against the mean of all images, so that the fall-off from the tip, which is nearer to the
    # light, cancels
    mean = np.maximum(np.mean(soft, axis=0), np.float32(1e-6))
    slopes = []
    for image in soft:
        ratio = image / mean
        gradient = np.stack(
            [cv2.Sobel(ratio, cv2.CV_32F, 1, 0), cv2.Sobel(ratio, cv2.CV_32F, 0, 1)], axis=-1
        )
        slopes.append(gradient[inner > 0])
    g = np.concatenate(slopes).astype(np.float64)  # (L N, 2)
    p = np.tile(places, (len(stack), 1))
    tip = places.mean(axis=0)
    weights = np.ones(len(g))
    scale = float(np.sqrt((g * g).sum(axis=1).mean()))
    require(
        scale > 0,
        "the nail shows no shading, so that its tip cannot be found; type the table instead.",
    )
    for _ in range(12):
        # a gradient far from the tip has a longer lever for the same error of its direction
        lever = np.linalg.norm(p - tip, axis=1) + 2.0 * sigma
        w = weights / lever**2
        normal = np.einsum("n,ni,nj->ij", w, g, g)
        right = np.einsum("n,ni,nj,nj->i", w, g, g, p)
        before, tip = tip, np.linalg.solve(normal + 1e-9 * np.trace(normal) * np.eye(2), right)
        off = np.abs(((p - tip) * g).sum(axis=1)) / lever / scale
        weights = cauchy(off, 0.1 + 2.0 * float(np.median(off))) ** 2
        if float(np.abs(tip - before).max()) < 1e-3:
            break
    column, row = tip + np.array([left, top])
    inside = (
        0 <= row < nail.shape[0]
        and 0 <= column < nail.shape[1]
        and bool(nail[int(row), int(column)])
    )
    require(
        inside,
        "the nail's faces do not show where its tip is; type the table, or photograph a matt cone.",
    )
    return np.array([column, row])
