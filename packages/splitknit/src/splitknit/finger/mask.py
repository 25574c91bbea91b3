"""Which pixels are the finger.

The coarse decision (k-means) is taken at about 10 px/mm, the outline at about 20 px/mm with
sub-pixel interpolation to the full grid: finer than the skin's own blur, and a tenth of the work.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import NamedTuple

import cv2
import numpy as np

from splitknit.errors import BadInput, require
from splitknit.finger.regions import (
    blur,
    border,
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
from splitknit.imaging.geometry import local_mean
from splitknit.imaging.robust import deviation
from splitknit.model import Array, BoolArray, FloatArray
from splitknit.steps import keep

_NO_FINGER = (
    "no finger was found in the white images: nothing stands out from the background in colour or"
    " brightness; check the exposure, the LEDs and the dark background, or give a mask."
)


class NoFinger(BadInput):
    """Nothing in the images stands out as a finger does."""


class BeyondView(BadInput):
    """What stands out touches three borders of the image, or all."""


_SEED_BLUR_MM = 0.25
"""Gaussian blur (sigma) of the chromaticity before clustering. Chosen on: judgement. Range: 0.125
to 0.5 (validation/parameters)."""


def finger_mask(mean_image: FloatArray, px_per_mm: float) -> BoolArray:
    """Find the finger, (H, W) bool, one component without holes, on a dark background, or on an
    even, coloured one.

    `mean_image`: (H, W, 3) or (H, W), mean of the white frames, linear, ambient removed, at any
    scale. Seed: k-means (k = 2) on the blurred chromaticity of the modified specular-free image, or
    on brightness where that separates better (grey images, strong infra-red leakage). The finger is
    the cluster that holds less of the image's border. Then the background is fitted outside the
    seed and the seed grows to whatever rises from it, so that a shadowed part is not lost; spurs
    are cut, the largest component kept and its holes (specular reflection) filled. Before a bright,
    coloured background all this is done on the sum of the channels in which the background's own
    colour vanishes. Raises BadInput if there is no finger, or it touches three borders of the
    image. Source: the thesis, section 3.3.1.1, eqs. 3.58-3.63 (3.61 corrected).
    """
    image = _checked(mean_image)
    size = image.shape[:2]
    # scale of the copy on which the outline is traced
    fine_scale = reduction(size, px_per_mm, 20.0, 1200)
    fine = reduce_image(image, fine_scale)
    fine_px = px_per_mm * fine_scale
    # scale of the copy that is clustered
    coarse_scale = reduction(fine.shape[:2], fine_px, 10.0, 600)
    coarse_px = fine_px * coarse_scale
    coarse = blur(reduce_image(fine, coarse_scale), 0.5 * _SEED_BLUR_MM * coarse_px)
    bright = coarse
    weights = _colour_filter(coarse)
    if weights is not None:
        coarse, fine = coarse @ weights, fine @ weights
    try:
        rough = _coarse_mask(coarse, coarse_px)
    except NoFinger:
        # so close that there is more finger than background along the border
        light = _brightness(bright)
        second, split = _two_means(light.reshape(-1, 1))
        part = _brighter(second.reshape(light.shape), light)
        if split and light[part].mean() > 3.0 * max(float(light[~part].mean()), 0.0):
            check_borders(largest_component(part))
        raise
    mask = _fine_outline(fine, rough, size, fine_px)
    check_borders(mask)
    return mask


_MIN_WIDTH_MM = 4.0  # a region that is nowhere as wide as this is not a finger


def finger_masks(mean_image: FloatArray, px_per_mm: float) -> list[BoolArray]:
    """Roughly where several fingers are between which the background shows: a mask (H, W) each, by
    the clusters of :func:`finger_mask`, of 4 mm and a fifth of the largest one's area at least.
    Raises BadInput if there is none.
    """
    image = blur(_checked(mean_image), 0.5 * _SEED_BLUR_MM * px_per_mm)
    weights = _colour_filter(image)
    radius = 0.5 * _MIN_WIDTH_MM * px_per_mm

    def wide(cluster: BoolArray) -> BoolArray:
        filled = fill_holes(cluster)
        return filled & dilate(erode(filled, radius), 1.15 * radius)

    mask = _seed(image if weights is None else image @ weights, _SEED_BLUR_MM * px_per_mm, wide)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    areas = stats[1:, cv2.CC_STAT_AREA]
    # smallest area of a finger, over that of the largest finger in view
    return [labels == 1 + k for k in np.flatnonzero(areas >= 0.2 * areas.max())]


_SPUR_FRACTION = 0.4  # parts narrower than this fraction of the finger's own width are cut off
_OBJECT_SPLITS = 3
"""How often the brighter part is split again while it touches a border of the image. Chosen on:
drawn scenes (tests/finger/test_object.py)."""
_MIN_OBJECT_STEP = 2.0
"""Min ratio of an object's brightness to that beyond its outline. Chosen on: drawn scenes
(tests/finger/test_object.py)."""
MIN_OBJECT_CONTOUR = 0.9
"""Min fraction of the outline along which that ratio holds. Chosen on: drawn scenes
(tests/finger/test_object.py)."""
_CONTOUR_REACH = 0.01
"""Distance inside and outside the outline at which both are measured, in longer sides of the
image."""
_MIN_SHADING_DEG = 4.0
"""Least median angle between the brightness over the lights of an object's pixels and its mean, in
degrees. Chosen on: drawn scenes (tests/finger/test_object.py)."""


def object_before_wall(stack: FloatArray) -> BoolArray | None:
    """The bright object (H, W) before something darker that reaches the border, or None where no
    such object is certain.

    `stack`: (L, H, W) images, linear. The object is the largest bright part of two clusters of the
    logarithm of the greatest brightness over the lights, which cast shadows hardly change. It is
    certain if it touches no border of the image, is far brighter than what lies beyond almost all
    of its outline, and its shading differs from place to place: a flat print in black and white is
    one object.
    """
    if min(stack.shape[1:]) < 16:
        return None
    brightest = blur(stack.max(axis=0), 1.0)
    floor = 1e-3 * max(float(brightest.max()), 1e-12)
    level = np.log(np.maximum(brightest, floor))
    part = np.ones(level.shape, dtype=np.bool_)
    for _ in range(_OBJECT_SPLITS):  # black beside a dim wall is split off first
        bright = np.zeros_like(part)
        bright[part] = _brighter(_two_means(level[part][:, None])[0], level[part])
        if not bright.any():
            return None
        part = remove_spurs(fill_holes(largest_component(bright)), _SPUR_FRACTION)
        if not border(part).any():
            break
    # smallest object that is told from what lies behind it, in fraction of the image
    if part.mean() < 0.02 or border(part).any():
        return None
    reach = max(4.0, _CONTOUR_REACH * max(part.shape))
    inside, cover = local_mean(brightest, part & ~erode(part, reach), 0.5 * reach)
    contour = dilate(part, reach) & ~dilate(part, 0.5 * reach)
    apart = (inside > _MIN_OBJECT_STEP * brightest) & (cover > 1e-3)
    if apart[contour].mean() < MIN_OBJECT_CONTOUR:
        return None
    profiles = stack[:, part]
    profiles = profiles / np.maximum(np.linalg.norm(profiles, axis=0), floor)
    mean = profiles.mean(axis=1)
    cosine = (mean / np.linalg.norm(mean)) @ profiles
    turn_deg = np.degrees(np.arccos(np.clip(np.median(cosine), 0.0, 1.0)))
    return part if turn_deg > _MIN_SHADING_DEG else None


CLEARLY_BRIGHT = 4.0
"""Ratio of an object's brightness to its ground's above which missing parts are detected: 9 to 80
on a dark ground. Source: validation/objects (glossy)."""


def left_out_part(image: FloatArray, outline: BoolArray) -> float:
    """Fraction of an object that its `outline` leaves out, as the narrow blade of a key: what is as
    bright in the mean image, joins the outline and reaches no border of the image.
    """
    brightness = blur(_brightness(image), 1.0)
    inside = float(np.median(brightness[outline]))
    ground = float(np.median(brightness[~outline])) if not outline.all() else inside
    if inside <= CLEARLY_BRIGHT * ground:
        return 0.0
    reach = max(2.0, 0.5 * _CONTOUR_REACH * max(outline.shape))
    beside = (brightness > np.sqrt(inside * max(ground, 1e-3 * inside))) & ~outline
    parts = cv2.connectedComponents(dilate(erode(beside, reach), reach).astype(np.uint8))[1]
    joined = np.setdiff1d(parts[dilate(outline, 3.0 * reach)], [0, *border(parts)])
    area = int(np.isin(parts, joined).sum())
    return area / (area + int(outline.sum()))


def _brighter(second: BoolArray, brightness: FloatArray) -> BoolArray:
    """Whichever of two clusters is the brighter one."""
    if not second.any() or second.all():
        return second
    return second if brightness[second].mean() > brightness[~second].mean() else ~second


def touched_borders(mask: BoolArray) -> tuple[str, ...]:
    """Names of the image borders that `mask` reaches along at least 1 % of their length."""
    sides = {"top": mask[0], "bottom": mask[-1], "left": mask[:, 0], "right": mask[:, -1]}
    return tuple(name for name, line in sides.items() if line.sum() >= max(3, 0.01 * line.size))


def check_borders(mask: BoolArray) -> None:
    """BeyondView if `mask` touches more borders than one where the finger enters, or two across a
    corner."""
    touched = touched_borders(mask)
    require(
        len(touched) < 3,
        f"the finger touches {len(touched)} borders of the image ({', '.join(touched)}): "
        "move it back so that its tip and both sides are in view, or give a mask.",
        BeyondView,
    )


def _checked(image: FloatArray) -> FloatArray:
    """The image (H, W) or (H, W, 3) as float32; BadInput if it is too small to show a finger."""
    rows, columns = image.shape[:2]
    require(
        min(rows, columns) >= 16,
        f"the picture is too small for a finger: {rows} x {columns} pixels where it is looked for,"
        " and 16 each way are needed; check the rig's px_per_mm, or take larger images.",
    )
    return np.ascontiguousarray(
        image[..., 0] if image.ndim == 3 and image.shape[2] == 1 else image, dtype=np.float32
    )


def _enlarged(mask: BoolArray, size: tuple[int, ...]) -> BoolArray:
    """A mask on a grid of `size` (rows, columns)."""
    return np.asarray(cv2.resize(mask.astype(np.float32), (size[1], size[0])) > 0.5)


# The seed: two clusters of the pixels' colour, or brightness.


def _seed(image: FloatArray, sigma: float, tidy: Callable[[BoolArray], BoolArray]) -> BoolArray:
    """Cluster by chromaticity and by brightness, keep the clearer split; `tidy` leaves what of it
    may be a finger."""
    brightness = _brightness(image)
    ceiling = max(float(np.percentile(brightness, 99.5)), 1e-12)
    candidates = [
        blur(np.sqrt(np.clip(brightness / ceiling, 0.0, 1.0)).astype(np.float32), sigma)[..., None]
    ]
    if image.ndim == 3:
        chromaticity = _chromaticity(image)
        keep("chromaticity", lambda: chromaticity)
        candidates.append(blur(chromaticity, sigma))
    best = np.zeros(brightness.shape, dtype=np.bool_)
    clearest = 0.0
    for features in candidates:
        second, separation = _two_means(features.reshape(-1, features.shape[2]))
        cluster = _finger_cluster(second.reshape(brightness.shape), brightness)
        if features.shape[2] == 3:
            keep("raw_mask", functools.partial(cluster.astype, np.float32))
        region = tidy(cluster)
        purity = float(region.sum()) / max(float(cluster.sum()), 1.0)
        if separation * purity > clearest:
            best = region
            clearest = separation * purity
    require(best.any(), _NO_FINGER, NoFinger)
    return best


def _without_spurs(cluster: BoolArray) -> BoolArray:
    return remove_spurs(fill_holes(cluster), _SPUR_FRACTION)


def _finger_cluster(second: BoolArray, brightness: FloatArray) -> BoolArray:
    """Whichever side holds less of the image's border; the brighter one where both hold about as
    much."""
    fraction = float(border(second).mean())
    if abs(fraction - 0.5) > 0.1:
        return second if fraction < 0.5 else ~second
    return _brighter(second, brightness)


def _two_means(features: FloatArray) -> tuple[BoolArray, float]:
    """Membership (N,) of the second of two clusters of features (N, D), from a split at the middle
    of the feature that varies most, the same every time; and the distance of the two means over the
    pooled standard deviation along it.
    """
    if len(features) < 2:
        return np.zeros(len(features), dtype=np.bool_), 0.0
    values = np.ascontiguousarray(features - features.mean(axis=0))
    widest = values[:, values.var(axis=0).argmax()]
    start = (widest > 0.5 * np.percentile(widest, [1.0, 99.0]).sum()).astype(np.int32)[:, None]
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 30, 1e-5)
    _, labels, means = cv2.kmeans(values, 2, start, criteria, 1, cv2.KMEANS_USE_INITIAL_LABELS)
    second = labels.ravel() > 0
    axis = means[1] - means[0]
    distance = float(np.linalg.norm(axis))
    if distance == 0.0 or not second.any() or second.all():
        return second, 0.0
    along = values @ (axis / distance)
    spread = 0.5 * (along[~second].var() + along[second].var())
    return second, distance / (float(np.sqrt(spread)) + 1e-9 * distance)


# How much every pixel looks like skin rather than like the background.


def _brightness(image: FloatArray) -> FloatArray:
    return image if image.ndim == 2 else image[..., 0] + image[..., 1] + image[..., 2]


def _least(image: FloatArray) -> FloatArray:
    return np.minimum(np.minimum(image[..., 0], image[..., 1]), image[..., 2])


def _chromaticity(image: FloatArray) -> FloatArray:
    """Chromaticity (H, W, 3) in [0, 1] of the modified specular-free image I - I_min + mean(I_min),
    I_min a pixel's least channel. The mean settles the colour of the unlit background too: noise
    does not turn into colour there. Source: the thesis, eqs. 3.58-3.63, (3.61) corrected as the
    sources of the dichromatic model have it.
    """
    least = _least(image)
    average = max(float(np.maximum(least, 0.0).mean()), 1e-3 * float(np.abs(image).max()), 1e-12)
    msf = np.maximum(image - least[..., None] + average, 1e-12)
    return msf / _brightness(msf)[..., None]


def _signals(image: FloatArray) -> list[FloatArray]:
    """Brightness, and the sum of I - I_min, which ignores neutral light: reflection, white dust,
    leaked infra-red."""
    brightness = _brightness(image)
    return [brightness] if image.ndim == 2 else [brightness, brightness - 3.0 * _least(image)]


_BRIGHT_BACKGROUND = 0.1
"""A background at least this bright against the brightest of the image may be darker than skin in
some places only. Chosen on: simulated fingers (coloured paper, validation/conditions)."""
_COLOURED_BACKGROUND = 0.3
"""A bright background whose channels differ by more than this fraction is distinguished by its
colour. Chosen on: simulated fingers (coloured paper, validation/conditions)."""


def _colour_filter(image: FloatArray) -> FloatArray | None:
    """(3,) weights of the channels in whose sum a bright, coloured background vanishes; None before
    any other. They are orthogonal to its colour, the median along the image's border (skin along
    most of it is none), towards the direction in which the rest of the image is strongest.
    """
    if image.ndim == 2:
        return None
    edge = border(image).astype(np.float64)
    light = edge.sum(axis=1)
    if np.median(light) <= _BRIGHT_BACKGROUND * max(
        float(np.percentile(image.sum(axis=2), 99.0)), 0.0
    ):
        return None
    colour = np.median(edge[light > 0.0] / light[light > 0.0, None], axis=0)
    if colour.min() > (1.0 - _COLOURED_BACKGROUND) * float(colour.max()):
        return None
    colour /= np.linalg.norm(colour)
    pixels = image.reshape(-1, 3).astype(np.float64)
    rest = pixels - np.outer(pixels @ colour, colour)
    weights = np.linalg.eigh(rest.T @ rest)[1][:, -1]
    sign = 1.0 if float(rest.mean(axis=0) @ weights) >= 0.0 else -1.0
    return np.asarray(sign * weights, dtype=np.float32)


class _Region(NamedTuple):
    """A region, and how far every pixel is from its outline."""

    mask: BoolArray
    depth: FloatArray
    """To the nearest pixel outside, zero there."""
    away: FloatArray
    """To the nearest pixel inside, zero there; infinite well beyond the reach asked for."""


def _region(mask: BoolArray, reach: float) -> _Region:
    return _Region(mask, depth_inside(mask), distance_outside(mask, reach))


_EDGE_FRACTION = 0.12
"""A pixel is finger if it rises from the background by this fraction of the finger's median rise.
Chosen on: judgement. Range: 0.06 to 0.168 (validation/parameters)."""
_NOISE_FACTOR = 5.0
"""A pixel is finger if it also rises by this many standard deviations of the background's noise, in
standard deviations."""


def _skin_evidence(
    image: FloatArray, seed: _Region, margin: float, *, local: bool = False
) -> tuple[FloatArray, bool]:
    """Evidence map (H, W): above one where a pixel rises from the background by enough to be skin;
    and whether any signal distinguishes the seed. The background is a quadratic surface fitted
    robustly outside the seed, the threshold `_EDGE_FRACTION` of the rise inside it nearby (at most
    of its median), at least `_NOISE_FACTOR` times the noise: a shadow on the finger stays finger.
    `margin`: pixels around the seed that belong to neither side; `local`: the background may follow
    a shadow's edge beside a complete seed.
    """
    outside = seed.away > margin
    inside = seed.depth > 0.5 * margin
    inside = inside if inside.any() else seed.mask
    if outside.sum() < 50:
        return seed.mask.astype(np.float32) * 2.0, True
    evidence = np.zeros(inside.shape, dtype=np.float32)
    usable = False
    for signal in _signals(image):
        background, noise = _fit_background(signal, outside)
        rise = signal - background
        if local:
            dim = np.minimum(rise, 3.0 * noise)  # dust, which is bright, hardly counts
            offset, cover = local_mean(dim, outside, 2.0 * margin)
            rise = rise - np.where(cover > 1e-3, offset, 0.0)
        level = float(np.median(rise[inside]))
        if level < 3.0 * _NOISE_FACTOR * noise or level <= 0.0:
            continue
        usable = True
        # a shaded part is darker
        near, cover = local_mean(np.maximum(rise, 0.0), inside, 2.0 * margin)
        expected = np.minimum(np.where(cover > 1e-2, near, level), level)
        threshold = np.maximum(_EDGE_FRACTION * expected, _NOISE_FACTOR * noise)
        np.maximum(evidence, rise / threshold.astype(np.float32), out=evidence)
    return evidence, usable


def _fit_background(signal: FloatArray, outside: BoolArray) -> tuple[FloatArray, float]:
    """Robust quadratic surface through `signal` outside the finger, and the noise about it, from
    the darker pixels."""
    y, x = (np.linspace(-1.0, 1.0, side) for side in signal.shape)
    rows, columns = (place[:: max(1, len(place) // 8000)] for place in np.nonzero(outside))
    values = signal[rows, columns].astype(np.float64)
    powers = np.polynomial.polynomial.polyvander2d(y[rows], x[columns], (2, 2))
    quadratic = [0, 1, 2, 3, 4, 6]  # of the nine powers: 1, x, x^2, y, x y, y^2
    terms = powers[:, quadratic]
    keep, noise = _below(values - float(np.percentile(values, 40.0)))
    solution = np.zeros(9)
    for _ in range(6):
        solution[quadratic] = np.linalg.lstsq(terms[keep], values[keep], rcond=None)[0]
        kept = keep
        keep, noise = _below(values - powers @ solution)
        if np.array_equal(keep, kept):
            break
    surface = np.polynomial.polynomial.polygrid2d(y, x, solution.reshape(3, 3))
    return surface.astype(np.float32), noise


def _below(residual: Array) -> tuple[BoolArray, float]:
    """Those of the background, and the scatter below it: robust or plain deviation, which counts a
    shadow's edge."""
    negative = -residual[residual <= 0.0]
    if negative.size == 0:
        return residual <= 1e-12, 0.0
    noise = max(deviation(negative), float(np.sqrt(np.mean(negative * negative))))
    return residual <= max(2.5 * noise, 1e-12), noise


# The mask: coarse, and its outline.


_EDGE_MARGIN_MM = 1.0
"""Width of the zone along the outline that counts neither as finger nor as background while either
is measured. Chosen on: judgement. Range: 0.5 to 2 (validation/parameters)."""


def _coarse_mask(image: FloatArray, px_per_mm: float) -> BoolArray:
    margin = _EDGE_MARGIN_MM * px_per_mm
    mask = _seed(image, _SEED_BLUR_MM * px_per_mm, _without_spurs)
    for _ in range(2):
        seed = _region(mask, margin)
        evidence, usable = _skin_evidence(image, seed, margin)
        require(usable, _NO_FINGER, NoFinger)
        grown = fill_holes((evidence > 1.0) | (seed.depth > 0.5 * float(seed.depth.max())))
        # it holds the middle of the seed
        cleaned = remove_spurs(largest_component(grown), _SPUR_FRACTION)
        require(cleaned.any(), _NO_FINGER, NoFinger)
        mask = fill_holes(cleaned)
    finger = _region(mask, 1.3 * margin)
    wide = 2.0 * float(finger.depth.max()) >= _MIN_WIDTH_MM * px_per_mm
    # a region across whose outline neither brightness nor colour changes by this fraction is not a
    # finger
    require(wide and _step_at_edge(image, finger, margin) >= 0.15, _NO_FINGER, NoFinger)
    return mask


def _step_at_edge(image: FloatArray, region: _Region, reach: float) -> float:
    """Relative step of brightness or colour across the outline: (inside - outside) / inside, the
    larger."""
    inside = region.mask & (region.depth <= reach)
    outside = (region.away <= 1.3 * reach) & (region.away > 0.3 * reach)
    if not outside.any() or not inside.any():
        return 0.0
    levels = [
        (float(np.median(signal[inside])), float(np.median(signal[outside])))
        for signal in _signals(image)
    ]
    return max((within - without) / within if within > 0.0 else 0.0 for within, without in levels)


def _fine_outline(
    fine: FloatArray, rough: BoolArray, size: tuple[int, ...], px_per_mm: float
) -> BoolArray:
    """Find the edge of the mask `rough` on the `fine` copy and interpolate it to `size` (rows,
    columns)."""
    guess = _enlarged(rough, fine.shape)
    margin = _EDGE_MARGIN_MM * px_per_mm
    region = _region(guess, margin)
    # gaussian blur (sigma) of the images on which the outline is traced
    evidence, _ = _skin_evidence(blur(fine, 0.06 * px_per_mm), region, margin, local=True)
    near = (region.away <= 0.7 * margin) & (region.depth <= margin)
    skin = np.where(near, evidence > 1.0, guess)
    cleaned = remove_spurs(largest_component(fill_holes(skin)), _SPUR_FRACTION)
    # bumps of the outline narrower than twice this (dust on the background beside the finger) are
    # cut off
    cleaned = fill_holes(remove_specks(cleaned, 1.0 * px_per_mm))
    require(cleaned.any(), _NO_FINGER, NoFinger)
    # above one exactly on `cleaned`; between the grid points the evidence itself gives where one is
    # crossed
    field = np.where(cleaned, np.clip(evidence, 1.001, 2.0), np.clip(evidence, 0.0, 0.999))
    field = np.where(erode(cleaned, 1.5), 2.0, np.where(dilate(cleaned, 1.5), field, 0.0)).astype(
        np.float32
    )
    return largest_component(cv2.resize(field, (size[1], size[0])) > 1.0)
