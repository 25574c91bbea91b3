"""Which pixels are the finger.

The coarse decision (k-means) is taken at about 10 px/mm, the outline at about 20 px/mm with sub-pixel interpolation to
the full grid: finer than the skin's own blur, and a tenth of the work.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from splitknit.errors import BadInput, require
from splitknit.finger.regions import (
    blur,
    depth_inside,
    dilate,
    distance_outside,
    erode,
    fill_holes,
    largest_component,
    reduce_image,
    reduction,
    remove_specks,
    remove_spurs,
)
from splitknit.imaging.geometry import wide_blur
from splitknit.model import Array, BoolArray, FloatArray
from splitknit.settings import Checked


@dataclass(frozen=True, slots=True, eq=False)
class _Around:
    """A region and how far every pixel is from its outline: what is near is asked several times."""

    mask: BoolArray
    depth: FloatArray
    """To the nearest pixel outside, zero there."""
    away: FloatArray
    """To the nearest pixel inside, zero there."""

    @classmethod
    def of(cls, mask: BoolArray, reach: float) -> _Around:
        """All distances inside, and those up to `reach` outside; what is farther is infinitely far."""
        return cls(mask, depth_inside(mask), distance_outside(mask, reach))


# How much every pixel looks like skin rather than like the background.

SAMPLES = 8000
"""The background is fitted to about so many pixels."""


def _chromaticity(image: FloatArray) -> FloatArray:
    """Chromaticity (H, W, 3) in [0, 1] of the modified specular-free image I - I_min + mean(I_min), I_min a pixel's
    least channel. The mean settles the colour of the unlit background too: noise does not turn into colour there.
    Source: the thesis, eqs. 3.58-3.63, (3.61) corrected as the sources of the dichromatic model have it.
    """
    least = _least(image)
    average = max(float(np.maximum(least, 0.0).mean()), 1e-3 * float(np.abs(image).max()), 1e-12)
    msf = np.maximum(image - least[..., None] + average, 1e-12)
    return msf / _brightness(msf)[..., None]


def _brightness(image: FloatArray) -> FloatArray:
    return image if image.ndim == 2 else image[..., 0] + image[..., 1] + image[..., 2]


def _least(image: FloatArray) -> FloatArray:
    return np.minimum(np.minimum(image[..., 0], image[..., 1]), image[..., 2])


def _signals(image: FloatArray) -> list[FloatArray]:
    """Brightness, and the sum of I - I_min, which ignores neutral light: reflection, white dust, leaked infra-red."""
    brightness = _brightness(image)
    return [brightness] if image.ndim == 2 else [brightness, brightness - 3.0 * _least(image)]


def _skin_evidence(
    image: FloatArray, around: _Around, margin: float, *, local: bool = False, samples: int = SAMPLES
) -> tuple[FloatArray, bool]:
    """Evidence map (H, W): above one where a pixel rises from the background by enough to be skin; and whether any
    signal distinguishes the seed. The background is a quadratic surface fitted robustly outside the seed, the threshold
    `_EDGE_FRACTION` of the rise inside it nearby (at most of its median), at least `_NOISE_FACTOR` times the noise: a
    shadow on the finger stays finger. `margin`: pixels around the seed that belong to neither side; `local`: the
    background may follow a shadow's edge beside a complete seed; `samples`: pixels fitted.
    """
    seed = around.mask
    outside = around.away > margin
    inside = around.depth > 0.5 * margin
    inside = inside if inside.any() else seed
    evidence = np.zeros(seed.shape, dtype=np.float32)
    usable = False
    if outside.sum() < 50:
        return seed.astype(np.float32) * 2.0, True
    for signal in _signals(image):
        background, noise = _fit_background(signal, outside, samples)
        rise = signal - background
        if local:
            dim = np.minimum(rise, 3.0 * noise)  # dust, which is bright, hardly counts
            offset, cover = _local_mean(dim, outside, 2.0 * margin)
            rise = rise - np.where(cover > 1e-3, offset, 0.0)
        level = float(np.median(rise[inside]))
        if level < 3.0 * _NOISE_FACTOR * noise or level <= 0.0:
            continue
        usable = True
        near, cover = _local_mean(np.maximum(rise, 0.0), inside, 2.0 * margin)  # a shaded part is darker
        own = np.minimum(np.where(cover > 1e-2, near, level), level)
        threshold = np.maximum(_EDGE_FRACTION * own, _NOISE_FACTOR * noise)
        np.maximum(evidence, rise / threshold.astype(np.float32), out=evidence)
    return evidence, usable


def _local_mean(values: FloatArray, where: BoolArray, sigma: float) -> tuple[FloatArray, FloatArray]:
    """Mean of values near every pixel over those of a region, and how much of it is near."""
    weight = where.astype(np.float32)
    cover = wide_blur(weight, sigma)
    mean = wide_blur(values * weight, sigma) / np.maximum(cover, 1e-3)
    return mean, cover


def _rise_at_edge(image: FloatArray, around: _Around, reach: float) -> float:
    """Relative step of brightness or colour across the outline: (inside - outside) / inside, the larger."""
    inside = around.mask & (around.depth <= reach)
    outside = (around.away <= 1.3 * reach) & (around.away > 0.3 * reach)
    if not outside.any() or not inside.any():
        return 0.0
    steps = []
    for signal in _signals(image):
        within = float(np.median(signal[inside]))
        without = float(np.median(signal[outside]))
        steps.append((within - without) / within if within > 0.0 else 0.0)
    return max(steps)


def _fit_background(signal: FloatArray, outside: BoolArray, samples: int) -> tuple[FloatArray, float]:
    """Robust quadratic surface through `signal` outside the finger, and the noise about it, from the darker pixels."""
    height, width = signal.shape
    x = np.linspace(-1.0, 1.0, width)
    y = np.linspace(-1.0, 1.0, height)
    rows, columns = np.nonzero(outside)
    step = max(1, len(rows) // samples)
    rows = rows[::step]
    columns = columns[::step]
    values = signal[rows, columns].astype(np.float64)
    u = x[columns]
    v = y[rows]
    design = np.stack([np.ones_like(u), u, v, u * u, v * v, u * v])  # (6, n)
    residual = values - float(np.percentile(values, 40.0))
    keep, noise = _below(residual)
    for _ in range(6):
        part = design[:, keep]
        normal = np.einsum("in,jn->ij", part, part) + 1e-6 * part.shape[1] * np.eye(6)
        solution = np.linalg.solve(normal, np.einsum("in,n->i", part, values[keep]))
        residual = values - np.einsum("in,i->n", design, solution)
        kept = keep
        keep, noise = _below(residual)
        if np.array_equal(keep, kept):
            break
    level, right, down, right_right, down_down, twist = solution
    surface = (level + right * x + right_right * x * x)[None, :] + (down * y + down_down * y * y)[:, None]
    surface += (twist * y)[:, None] * x[None, :]
    return surface.astype(np.float32), noise


def _below(residual: Array) -> tuple[BoolArray, float]:
    """Those of the background, and the scatter below it: robust or plain deviation, which counts a shadow's edge."""
    negative = -residual[residual <= 0.0]
    if negative.size == 0:
        return residual <= 1e-12, 0.0
    noise = max(1.4826 * float(np.median(negative)), float(np.sqrt(np.mean(negative * negative))))
    return residual <= max(2.5 * noise, 1e-12), noise


_COARSE_PX_PER_MM, _FINE_PX_PER_MM = 10.0, 20.0
"""Scales of the copy that is clustered and of the one on which the outline is found."""
BLUR_MM = 0.25
"""Gaussian blur (sigma) of the chromaticity before clustering."""
_FINE_BLUR_MM = 0.06
"""Gaussian blur (sigma) of the images on which the outline is found."""
_EDGE_FRACTION = 0.12
"""A pixel is finger if it rises from the background by this fraction of the finger's median rise."""
_NOISE_FACTOR = 5.0
"""A pixel is finger if it also rises by this many standard deviations of the background's noise."""
_SPUR_FRACTION = 0.4
"""Parts narrower than this fraction of the finger's own width are cut off."""
_SPECK_MM = 1.0
"""Bumps of the outline narrower than twice this (dust on the background beside the finger) are cut off."""
_EDGE_MARGIN_MM = 1.0
"""Width of the zone along the outline that counts neither as finger nor as background while either is measured."""
_MIN_WIDTH_MM = 4.0
"""A region nowhere as wide as this is not a finger."""
_BRIGHT = 0.1
"""A background at least this bright against the brightest of the image may be darker than skin in some places only."""
_COLOURED = 0.3
"""A bright background whose channels differ by more than this fraction is distinguished by its colour."""
_MIN_STEP = 0.15
"""A region across whose outline neither brightness nor colour changes by this fraction is not a finger."""


@dataclass(frozen=True, slots=True)
class MaskSettings(Checked):
    """How the finger is separated from the background."""

    method: Literal["grown", "kmeans"] = "grown"
    """``grown``: from a seed by k-means to whatever rises from the background; ``kmeans``: the thesis's two clusters of
    the chromaticity alone."""


def finger_mask(mean_image: FloatArray, px_per_mm: float, method: Literal["grown", "kmeans"] = "grown") -> BoolArray:
    """Find the finger, (H, W) bool, one component without holes, on a dark background, or on an even, coloured one.

    `mean_image`: (H, W, 3) or (H, W), mean of the white frames, linear, ambient removed, at any scale. Seed: k-means (k
    = 2) on the blurred chromaticity of the modified specular-free image, or on brightness where that separates better
    (grey images, strong infra-red leakage). The finger is the cluster that holds less of the image's border. Then the
    background is fitted outside the seed and the seed grows to whatever rises from it, so that a shadowed part is not
    lost; spurs are cut, the largest component kept and its holes (specular reflection) filled. Before a bright,
    coloured background all this is done on the sum of the channels in which the background's own colour vanishes.
    `method`: as in :class:`MaskSettings`.
    Raises BadInput if there is no finger, or it touches three borders of the image. Source: the thesis, section
    3.3.1.1, eqs. 3.58-3.63 (3.61 corrected).
    """
    image = _checked(mean_image)
    height, width = image.shape[:2]
    fine_scale = reduction((height, width), px_per_mm, _FINE_PX_PER_MM, 1200)
    fine = reduce_image(image, fine_scale)
    coarse_scale = reduction(fine.shape[:2], px_per_mm * fine_scale, _COARSE_PX_PER_MM, 600)
    coarse = reduce_image(fine, coarse_scale)
    coarse_px = px_per_mm * fine_scale * coarse_scale
    coarse = blur(coarse, 0.5 * BLUR_MM * coarse_px)

    if method == "kmeans":
        found = _seed(fine, BLUR_MM * px_per_mm * fine_scale, _tidy, seen=-1)
        result = largest_component(fill_holes(cv2.resize(found.astype(np.float32), (width, height)) > 0.5))
        check_borders(result)
        return result
    bright = coarse
    weights = _colour_filter(coarse)
    if weights is not None:
        coarse = _filtered(coarse, weights)
        fine = _filtered(fine, weights)
    try:
        mask = _coarse_mask(coarse, coarse_px)
    except BadInput:
        check_borders(_bright_side(bright))  # so close that there is more finger than background along the border
        raise
    result = _fine_outline(fine, mask, (height, width), px_per_mm * fine_scale)
    check_borders(result)
    return result


def _coarse_mask(image: FloatArray, px_per_mm: float, samples: int = SAMPLES) -> BoolArray:
    margin = _EDGE_MARGIN_MM * px_per_mm
    mask = _seed(image, BLUR_MM * px_per_mm, _tidy)
    for _ in range(2):
        around = _Around.of(mask, margin)
        evidence, usable = _skin_evidence(image, around, margin, samples=samples)
        require(usable, _NO_FINGER, NoFinger)
        grown = fill_holes((evidence > 1.0) | (around.depth > 0.5 * float(around.depth.max())))
        cleaned = remove_spurs(largest_component(grown), _SPUR_FRACTION)  # it holds the middle of the seed
        require(cleaned.any(), _NO_FINGER, NoFinger)
        mask = fill_holes(cleaned)
    around = _Around.of(mask, 1.3 * margin)
    require(2.0 * float(around.depth.max()) >= _MIN_WIDTH_MM * px_per_mm, _NO_FINGER, NoFinger)
    require(_rise_at_edge(image, around, margin) >= _MIN_STEP, _NO_FINGER, NoFinger)
    return mask


def _colour_filter(image: FloatArray) -> FloatArray | None:
    """(3,) weights of the channels in whose sum a bright, coloured background vanishes; None before any other. They are
    orthogonal to its colour, the median along the image's border (skin along most of it is none), towards the direction
    in which the rest of the image is strongest.
    """
    if image.ndim == 2:
        return None
    border = np.concatenate([image[0], image[-1], image[:, 0], image[:, -1]]).astype(np.float64)
    light = border.sum(axis=1)
    if float(np.median(light)) <= _BRIGHT * max(float(np.percentile(image.sum(axis=2), 99.0)), 0.0):
        return None
    colour = np.median(border[light > 0.0] / light[light > 0.0, None], axis=0)
    if float(colour.min()) > (1.0 - _COLOURED) * float(colour.max()):
        return None
    colour /= np.sqrt(np.sum(colour * colour))
    pixels = image.reshape(-1, 3).astype(np.float64)
    rest = pixels - np.einsum("ni,i->n", pixels, colour)[:, None] * colour
    weights = np.linalg.eigh(np.einsum("ni,nj->ij", rest, rest))[1][:, -1]
    sign = 1.0 if float(np.sum(rest.mean(axis=0) * weights)) >= 0.0 else -1.0
    return np.asarray(sign * weights, dtype=np.float32)


def _filtered(image: FloatArray, weights: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("hwc,c->hw", image, weights), dtype=np.float32)


def _bright_side(image: FloatArray) -> BoolArray:
    """Whatever is far brighter than the rest of the image (nothing, where no such split shows)."""
    brightness = _brightness(image)
    second, _ = _two_means(brightness.reshape(-1, 1))
    split = second.reshape(brightness.shape)
    levels = [float(brightness[part].mean()) if part.any() else 0.0 for part in (split, ~split)]
    bright = split if levels[0] > levels[1] else ~split
    return largest_component(bright) if max(levels) > 3.0 * max(min(levels), 0.0) else np.zeros_like(bright)


def touched_borders(mask: BoolArray) -> tuple[str, ...]:
    """Names of the image borders that `mask` reaches along at least 1 % of their length."""
    sides = {"top": mask[0], "bottom": mask[-1], "left": mask[:, 0], "right": mask[:, -1]}
    return tuple(name for name, line in sides.items() if int(line.sum()) >= max(3, 0.01 * line.size))


def check_borders(mask: BoolArray) -> tuple[str, ...]:
    """The borders that `mask` touches: one where the finger enters, or two across a corner. BadInput for more."""
    touched = touched_borders(mask)
    require(
        len(touched) < 3,
        f"the finger touches {len(touched)} borders of the image ({', '.join(touched)}): "
        "move it back so that its tip and both sides are in view, or give a mask.",
    )
    return touched


_NO_FINGER = (
    "no finger was found in the white images: nothing stands out from the background in colour or brightness; "
    "check the exposure, the LEDs and the dark background, or give a mask."
)


class NoFinger(BadInput):
    """Nothing in the images stands out as a finger does."""


def _checked(image: FloatArray) -> FloatArray:
    """The image (H, W) or (H, W, 3) as float32; BadInput if it is too small to show a finger."""
    rows, columns = image.shape[:2]
    require(
        min(rows, columns) >= 16,
        f"the picture is too small for a finger: {rows} x {columns} pixels where it is looked for"
        ", and 16 each way are needed; check the rig's px_per_mm, or take larger images.",
    )
    return np.ascontiguousarray(image[..., 0] if image.ndim == 3 and image.shape[2] == 1 else image, dtype=np.float32)


def _tidy(part: BoolArray) -> BoolArray:
    """What of a cluster may be a finger."""
    return remove_spurs(fill_holes(part), _SPUR_FRACTION)


def _seed(image: FloatArray, sigma: float, tidy: Callable[[BoolArray], BoolArray], seen: int = 0) -> BoolArray:
    """Cluster by chromaticity and by brightness, keep the clearer split; `tidy` leaves what of it may be a finger.
    `seen`: -1 by chromaticity alone, where there is any.
    """
    brightness = _brightness(image)
    ceiling = max(float(np.percentile(brightness, 99.5)), 1e-12)
    root = np.sqrt(np.clip(brightness / ceiling, 0.0, 1.0)).astype(np.float32)
    candidates = [blur(root, sigma)[..., None]]
    if image.ndim == 3:
        candidates.append(blur(_chromaticity(image), sigma))
    best = np.zeros(brightness.shape, dtype=np.bool_)
    clearest = 0.0
    for features in candidates[seen:]:
        second, separation = _two_means(features.reshape(-1, features.shape[2]))
        cluster = _finger_cluster(second.reshape(brightness.shape), brightness)
        region = tidy(cluster)
        purity = float(region.sum()) / max(float(cluster.sum()), 1.0)
        if separation * purity > clearest:
            best = region
            clearest = separation * purity
    require(best.any(), _NO_FINGER, NoFinger)
    return best


def _finger_cluster(second: BoolArray, brightness: FloatArray) -> BoolArray:
    """Whichever side holds less of the image's border; the brighter one where both hold about as much."""
    border = np.concatenate([second[0], second[-1], second[:, 0], second[:, -1]])
    fraction = float(border.mean())
    if abs(fraction - 0.5) > 0.1:
        return second if fraction < 0.5 else ~second
    if not second.any() or second.all():
        return second
    return second if float(brightness[second].mean()) > float(brightness[~second].mean()) else ~second


def _fine_outline(
    fine: FloatArray, mask: BoolArray, size: tuple[int, int], px_per_mm: float, samples: int = SAMPLES
) -> BoolArray:
    """Find the edge of the coarse `mask` on the `fine` copy and interpolate it to `size` (rows, columns)."""
    shape = fine.shape[:2]
    guess = cv2.resize(mask.astype(np.float32), (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR) > 0.5
    smooth = blur(fine, _FINE_BLUR_MM * px_per_mm)
    margin = _EDGE_MARGIN_MM * px_per_mm
    around = _Around.of(guess, margin)
    evidence, _ = _skin_evidence(smooth, around, margin, local=True, samples=samples)
    near = (around.away <= 0.7 * margin) & (around.depth <= margin)
    skin = np.where(near, evidence > 1.0, guess)
    cleaned = remove_spurs(largest_component(fill_holes(skin)), _SPUR_FRACTION)
    cleaned = fill_holes(remove_specks(cleaned, _SPECK_MM * px_per_mm))
    require(cleaned.any(), _NO_FINGER, NoFinger)
    # above one exactly on `cleaned`; between the grid points the evidence itself gives where one is crossed
    field = np.where(cleaned, np.clip(evidence, 1.001, 2.0), np.clip(evidence, 0.0, 0.999))
    field = np.where(erode(cleaned, 1.5), 2.0, np.where(dilate(cleaned, 1.5), field, 0.0)).astype(np.float32)
    full = cv2.resize(field, (size[1], size[0]), interpolation=cv2.INTER_LINEAR) > 1.0
    return largest_component(full)


# Two-class k-means that gives the same answer every time.


def _two_means(features: FloatArray) -> tuple[BoolArray, float]:
    """Membership (N,) of the second of two clusters of features (N, D), by Lloyd's algorithm (IEEE Trans. IT 28(2),
    1982) from a split at the middle of the direction of greatest variance; and the distance of the two means over the
    pooled standard deviation along it.
    """
    values = np.ascontiguousarray(features.T, dtype=np.float64)
    middle = values.mean(axis=1)
    centred = values - middle[:, None]
    axis = np.linalg.eigh(np.einsum("in,jn->ij", centred, centred))[1][:, -1]
    along = np.einsum("in,i->n", centred, axis)
    second = along > 0.5 * float(np.percentile(along, [1.0, 99.0]).sum())
    for _ in range(30):
        count = int(np.count_nonzero(second))
        if count in {0, second.size}:
            return second, 0.0
        mean = np.einsum("in,n->i", centred, second.astype(np.float64)) / count  # of the first: what makes the sum zero
        axis = mean * (second.size / (second.size - count))
        along = np.einsum("in,i->n", centred, axis)
        updated = along > float(np.sum(axis * mean)) - 0.5 * float(np.sum(axis * axis))
        if (updated == second).all():
            break
        second = updated
    distance = float(np.sqrt(np.sum(axis * axis)))
    if distance == 0.0 or not second.any() or second.all():
        return second, 0.0
    spread = (along[~second].var() + along[second].var()) / distance**2
    return second, distance / float(np.sqrt(0.5 * spread) + 1e-9)


# The finger's mask in two steps, where time counts: roughly where it is, and its outline around that.

_ROUGH_PX_PER_MM, _OUTLINE_PX_PER_MM = 5.5, 10.0
"""Scales of the copies on which the finger and its outline are found; between pixels the outline is interpolated."""
FEW_SAMPLES = 2000
"""Pixels to which the background is fitted where time counts."""


def finger_region(mean_image: FloatArray, px_per_mm: float) -> BoolArray:
    """Roughly where the finger is, to a pixel of the coarse copy: the first step of :func:`finger_mask`, which see."""
    image = _checked(mean_image)
    height, width = image.shape[:2]
    scale = reduction((height, width), px_per_mm, _ROUGH_PX_PER_MM, 600)
    coarse = blur(reduce_image(image, scale), 0.5 * BLUR_MM * px_per_mm * scale)
    mask = _coarse_mask(coarse, px_per_mm * scale, FEW_SAMPLES)
    check_borders(mask)
    return cv2.resize(mask.astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR) > 0.5


def finger_outline(mean_image: FloatArray, rough: BoolArray, px_per_mm: float) -> BoolArray:
    """Refine a mask `rough` (h, w) of the same view, at any scale, to the finger's outline (H, W): the last step of
    :func:`finger_mask`. `mean_image`: three times ``edge_margin_mm`` of background around it. BadInput if nothing
    stands out.
    """
    image = _checked(mean_image)
    height, width = image.shape[:2]
    require(rough.any(), _NO_FINGER, NoFinger)
    scale = reduction((height, width), px_per_mm, _OUTLINE_PX_PER_MM, 1200)
    fine = reduce_image(image, scale)
    return _fine_outline(fine, rough, (height, width), px_per_mm * scale, FEW_SAMPLES)


_SMALLEST_PART = 0.2
"""Smallest area of a finger, over that of the largest finger in view."""


def finger_masks(mean_image: FloatArray, px_per_mm: float) -> list[BoolArray]:
    """Roughly where several fingers are between which the background shows: a mask (H, W) each, by the clusters of
    :func:`finger_mask`, of 4 mm and a fifth of the largest one's area at least. Raises BadInput if there is none.
    """
    image = blur(_checked(mean_image), 0.5 * BLUR_MM * px_per_mm)
    weights = _colour_filter(image)
    radius = 0.5 * _MIN_WIDTH_MM * px_per_mm

    def wide(region: BoolArray) -> BoolArray:
        region = fill_holes(region)
        return region & dilate(erode(region, radius), 1.15 * radius)

    mask = _seed(image if weights is None else _filtered(image, weights), BLUR_MM * px_per_mm, wide)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    areas = stats[1:, cv2.CC_STAT_AREA]
    return [labels == 1 + k for k in np.flatnonzero(areas >= _SMALLEST_PART * areas.max())]
