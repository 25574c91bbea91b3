"""Which pixels are the finger.

The coarse decision (k-means) is taken at about 10 px/mm, the outline at about 20 px/mm with sub-pixel interpolation to
the full grid: finer than the skin's own blur, and a tenth of the work.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray

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
from splitknit.model import BoolArray, FloatArray
from splitknit.settings import Checked, Limits


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
    """Chromaticity of the modified specular-free image, (H, W, 3) in [0, 1].

    I_MSF = I - I_min + mean(I_min) with I_min the minimum channel of a pixel. Adding the mean back, as the sources of
    the dichromatic model do, also settles the colour of the unlit background: where there is next to no light the three
    channels of I_MSF are equal and noise does not turn into colour. Source: the thesis, eqs. 3.58-3.63, with (3.61)
    corrected (``I - I_min + I_min_avg``).
    """
    least = _least(image)
    average = max(float(np.maximum(least, 0.0).mean()), 1e-3 * float(np.abs(image).max()), 1e-12)
    msf = np.maximum(image - least[..., None] + np.float32(average), np.float32(1e-12))
    return np.asarray(msf / _brightness(msf)[..., None], dtype=np.float32)


def _brightness(image: FloatArray) -> FloatArray:
    """(H, W) sum of the channels."""
    return image if image.ndim == 2 else np.asarray(image[..., 0] + image[..., 1] + image[..., 2])


def _least(image: FloatArray) -> FloatArray:
    """(H, W) least of three channels."""
    return np.asarray(np.minimum(np.minimum(image[..., 0], image[..., 1]), image[..., 2]))


def _signals(image: FloatArray) -> list[FloatArray]:
    """What separates skin from a dark neutral background: brightness, and the sum of I - I_min, which ignores neutral
    light (specular reflection, white dust, leaked infra-red).
    """
    brightness = _brightness(image)
    return [brightness] if image.ndim == 2 else [brightness, brightness - np.float32(3.0) * _least(image)]


def _skin_evidence(
    image: FloatArray, around: _Around, margin: float, *, local: bool = False, samples: int = SAMPLES
) -> tuple[FloatArray, bool]:
    """Evidence map: above one where a pixel rises from the background by enough to be skin.

    For each signal the background is a quadratic surface fitted robustly outside the seed, and the threshold is
    `_EDGE_FRACTION` of the rise inside it nearby (at most of its median), but at least `_NOISE_FACTOR` times the noise
    outside. So a shadow on the finger stays finger. `image`: (H, W) or (H, W, 3) linear; `around`: the seed, surely
    finger; `margin`: pixels around it that belong to neither side; `local`: let the background follow a shadow's edge
    beside the finger; only for a seed that is already complete; `samples`: pixels to which the background is fitted.
    Returns `evidence`: (H, W) float32; `usable`: whether any signal distinguishes the seed from the background.
    """
    seed = around.mask
    outside = around.away > margin
    inside = around.depth > 0.5 * margin
    inside = inside if inside.any() else seed
    evidence = np.zeros(seed.shape, dtype=np.float32)
    usable = False
    if outside.sum() < 50:
        return seed.astype(np.float32) * np.float32(2.0), True
    for signal in _signals(image):
        background, noise = _fit_background(signal, outside, samples)
        rise = signal - background
        if local:
            dim = np.minimum(rise, np.float32(3.0 * noise))  # dust, which is bright, hardly counts
            offset, cover = _local_mean(dim, outside, 2.0 * margin)
            rise = rise - np.where(cover > 1e-3, offset, np.float32(0.0))
        level = float(np.median(rise[inside]))
        if level < 3.0 * _NOISE_FACTOR * noise or level <= 0.0:
            continue
        usable = True
        near, cover = _local_mean(np.maximum(rise, 0.0), inside, 2.0 * margin)  # a shaded part is darker
        own = np.minimum(np.where(cover > 1e-2, near, np.float32(level)), np.float32(level))
        threshold = np.maximum(_EDGE_FRACTION * own, _NOISE_FACTOR * noise)
        np.maximum(evidence, rise / threshold.astype(np.float32), out=evidence)
    return evidence, usable


def _local_mean(values: FloatArray, where: BoolArray, sigma: float) -> tuple[FloatArray, FloatArray]:
    """Mean of values near every pixel over those of a region, and how much of it is near."""
    weight = where.astype(np.float32)
    cover = wide_blur(weight, sigma)
    mean = wide_blur(values * weight, sigma) / np.maximum(cover, np.float32(1e-3))
    return np.asarray(mean, dtype=np.float32), cover


def _rise_at_edge(image: FloatArray, around: _Around, reach: float) -> float:
    """Relative step of brightness or colour across the outline: (inside - outside) / inside, the larger."""
    inside = around.mask & (around.depth <= reach)
    outside = (around.away <= 1.3 * reach) & (around.away > 0.3 * reach)
    if not outside.any() or not inside.any():
        return 0.0
    steps = []
    for signal in _signals(image):
        within, without = float(np.median(signal[inside])), float(np.median(signal[outside]))
        steps.append((within - without) / within if within > 0.0 else 0.0)
    return max(steps)


def _fit_background(signal: FloatArray, outside: BoolArray, samples: int) -> tuple[FloatArray, float]:
    """Robust quadratic surface through `signal` outside the finger, and the noise about it. What does not belong to the
    background is brighter: the fit starts from the darker pixels, the noise is measured below the surface.
    """
    height, width = signal.shape
    x = np.linspace(-1.0, 1.0, width)
    y = np.linspace(-1.0, 1.0, height)
    rows, columns = np.nonzero(outside)
    step = max(1, len(rows) // samples)
    rows, columns = rows[::step], columns[::step]
    values = signal[rows, columns].astype(np.float64)
    u, v = x[columns], y[rows]
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


def _below(residual: NDArray[np.float64]) -> tuple[NDArray[np.bool_], float]:
    """Residuals that belong to the background, and the scatter of those below it: the larger of a robust and a plain
    standard deviation, since the latter counts a shadow's edge that the fit cannot follow.
    """
    negative = -residual[residual <= 0.0]
    if negative.size == 0:
        return residual <= 1e-12, 0.0
    noise = max(1.4826 * float(np.median(negative)), float(np.sqrt(np.mean(negative * negative))))
    return residual <= max(2.5 * noise, 1e-12), noise


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
"""A region nowhere as wide as this is no finger."""
_BRIGHT = 0.1
"""A background at least this bright against the brightest of the image may be darker than skin in some places only."""
_COLOURED = 0.3
"""A bright background whose channels differ by more than this fraction is distinguished by its colour."""
_MIN_STEP = 0.15
"""A region across whose outline neither brightness nor colour changes by this fraction is no finger."""


@dataclass(frozen=True, slots=True)
class MaskSettings(Checked):
    """How the finger is separated from the background."""

    coarse_px_per_mm: Annotated[float, Limits(0, above=True)] = 10.0
    """Scale of the copy that is clustered."""
    fine_px_per_mm: Annotated[float, Limits(0, above=True)] = 20.0
    """Scale of the copy on which the outline is found."""


def finger_mask(mean_image: FloatArray, px_per_mm: float, settings: MaskSettings | None = None) -> BoolArray:
    """Find the finger, (H, W) bool, one component without holes, on a dark background, or on an even, coloured one.

    `mean_image`: (H, W, 3) or (H, W), mean of the white frames, linear, ambient removed, at any scale. Seed: k-means (k
    = 2) on the blurred chromaticity of the modified specular-free image, or on brightness where that separates better
    (grey images, strong infra-red leakage). The finger is the cluster that holds less of the image's border. Then the
    background is fitted outside the seed and the seed grows to whatever rises from it, so that a shadowed part is not
    lost; spurs are cut, the largest component kept and its holes (specular reflection) filled. Before a bright,
    coloured background all this is done on the sum of the channels in which the background's own colour vanishes.
    Raises BadInput if there is no finger, or it touches three borders of the image. Source: the thesis, section
    3.3.1.1, eqs. 3.58-3.63 (3.61 corrected).
    """
    settings = settings or MaskSettings()
    image = _check_image(mean_image, px_per_mm)
    height, width = image.shape[:2]
    fine_scale = reduction((height, width), px_per_mm, settings.fine_px_per_mm, 1200)
    fine = reduce_image(image, fine_scale)
    coarse_scale = reduction(fine.shape[:2], px_per_mm * fine_scale, settings.coarse_px_per_mm, 600)
    coarse = reduce_image(fine, coarse_scale)
    coarse_px = px_per_mm * fine_scale * coarse_scale
    coarse = blur(coarse, 0.5 * BLUR_MM * coarse_px)

    bright = coarse
    weights = _colour_filter(coarse)
    if weights is not None:
        coarse, fine = _filtered(coarse, weights), _filtered(fine, weights)
    try:
        mask = _coarse_mask(coarse, coarse_px)
    except BadInput:
        check_borders(_bright_side(bright))  # so close that there is more finger than background along the border
        raise
    result = _fine_outline(fine, mask, (height, width), px_per_mm * fine_scale)
    check_borders(result)
    return result


def _coarse_mask(image: FloatArray, px_per_mm: float, samples: int = SAMPLES) -> BoolArray:
    """The finger on the coarse copy."""
    margin = _EDGE_MARGIN_MM * px_per_mm
    mask = _seed(image, BLUR_MM * px_per_mm, lambda part: remove_spurs(fill_holes(part), _SPUR_FRACTION))
    for _ in range(2):
        around = _Around.of(mask, margin)
        evidence, usable = _skin_evidence(image, around, margin, samples=samples)
        require(usable, _NO_FINGER, NoFinger)
        mask = _clean(evidence > 1.0, around.depth)
    around = _Around.of(mask, 1.3 * margin)
    require(2.0 * float(around.depth.max()) >= _MIN_WIDTH_MM * px_per_mm, _NO_FINGER, NoFinger)
    require(_rise_at_edge(image, around, margin) >= _MIN_STEP, _NO_FINGER, NoFinger)
    return mask


def _colour_filter(image: FloatArray) -> NDArray[np.float32] | None:
    """(3,) weights of the channels in whose sum a bright, coloured background vanishes; None before any other.

    The background's colour is the median along the image's border. Light of one colour is a line through the origin,
    however strong it is, so what is orthogonal to it is zero all over the background; of that, the direction in which
    the rest of the image is strongest. Skin itself along most of the border is no background.
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


def _filtered(image: FloatArray, weights: NDArray[np.float32]) -> FloatArray:
    """(H, W) sum of the channels with the given weights."""
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
    """Return the borders that `mask` touches: one where the finger enters, or two across a corner. Raises BadInput if
    it touches three or four: too much of the finger is out of view.
    """
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


def _check_image(mean_image: FloatArray, px_per_mm: float) -> FloatArray:
    """The image (H, W) or (H, W, 3) as float32, if it may show a finger."""
    require(np.isfinite(px_per_mm) and px_per_mm > 0, "px_per_mm must be a positive number.")
    image = np.asarray(mean_image)
    require(
        image.ndim == 2 or (image.ndim == 3 and image.shape[2] in (1, 3)),
        f"the mean image must have the shape (H, W) or (H, W, 3), but it has {image.shape}.",
    )
    rows, columns = image.shape[:2]
    require(
        min(rows, columns) >= 16,
        f"the picture is too small for a finger: {rows} x {columns} pixels where it is looked for, and 16 each way are "
        "needed; check the rig's px_per_mm, or take larger images.",
    )
    image = np.ascontiguousarray(image[..., 0] if image.ndim == 3 and image.shape[2] == 1 else image, dtype=np.float32)
    require(bool(np.isfinite(image).all()), "the mean image contains NaN or infinite values.")
    return image


def _seed(image: FloatArray, sigma: float, tidy: Callable[[BoolArray], BoolArray]) -> BoolArray:
    """Cluster by chromaticity and by brightness, keep the clearer split; `tidy` leaves what of it may be a finger."""
    brightness = _brightness(image)
    ceiling = max(float(np.percentile(brightness, 99.5)), 1e-12)
    root = np.sqrt(np.clip(brightness / np.float32(ceiling), 0.0, 1.0)).astype(np.float32)
    candidates = [blur(root, sigma)[..., None]]
    if image.ndim == 3:
        candidates.append(blur(_chromaticity(image), sigma))
    best: BoolArray | None = None
    clearest = 0.0
    for features in candidates:
        second, separation = _two_means(features.reshape(-1, features.shape[2]))
        cluster = _finger_cluster(second.reshape(brightness.shape), brightness)
        region = tidy(cluster)
        purity = float(region.sum()) / max(float(cluster.sum()), 1.0)
        if separation * purity > clearest:
            best, clearest = region, separation * purity
    if best is None or not best.any():
        raise NoFinger(_NO_FINGER)
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


def _clean(candidate: BoolArray, depth: FloatArray) -> BoolArray:
    """One component that contains the middle of the seed, without spurs and holes; `depth`: inside the seed."""
    grown = fill_holes(candidate | (depth > 0.5 * float(depth.max())))
    cleaned = remove_spurs(largest_component(grown), _SPUR_FRACTION)
    require(bool(cleaned.any()), _NO_FINGER, NoFinger)
    return fill_holes(cleaned)


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
    require(bool(cleaned.any()), _NO_FINGER, NoFinger)
    # above one exactly on `cleaned`; between the grid points the evidence itself gives where one is crossed
    field = np.where(cleaned, np.clip(evidence, 1.001, 2.0), np.clip(evidence, 0.0, 0.999))
    field = np.where(erode(cleaned, 1.5), 2.0, np.where(dilate(cleaned, 1.5), field, 0.0)).astype(np.float32)
    full = cv2.resize(field, (size[1], size[0]), interpolation=cv2.INTER_LINEAR) > 1.0
    return largest_component(full)


# Two-class k-means that gives the same answer every time.


def _two_means(features: NDArray[np.float32], iterations: int = 30) -> tuple[BoolArray, float]:
    """Split feature vectors into two clusters (Lloyd's algorithm, deterministic start).

    The start is the split at the middle of the direction of greatest variance, so no random number is involved.
    `features`: (N, D) float32. Returns `second`: (N,) bool, membership of the second cluster; `separation`: distance of
    the two means in units of the pooled standard deviation along the line that joins them. Source: Lloyd, S., "Least
    squares quantization in PCM", IEEE Trans. Information Theory 28(2), 1982.
    """
    values = np.ascontiguousarray(features.T, dtype=np.float64)
    middle = values.mean(axis=1)
    centred = values - middle[:, None]
    axis = np.linalg.eigh(np.einsum("in,jn->ij", centred, centred))[1][:, -1]
    along = np.einsum("in,i->n", centred, axis)
    second = along > 0.5 * float(np.percentile(along, [1.0, 99.0]).sum())
    for _ in range(iterations):
        count = int(np.count_nonzero(second))
        if count in {0, second.size}:
            return np.asarray(second, dtype=np.bool_), 0.0
        mean = np.einsum("in,n->i", centred, second.astype(np.float64)) / count  # of the first: what makes the sum zero
        axis = mean * (second.size / (second.size - count))
        along = np.einsum("in,i->n", centred, axis)
        updated = along > float(np.sum(axis * mean)) - 0.5 * float(np.sum(axis * axis))
        if bool((updated == second).all()):
            break
        second = updated
    return np.asarray(second, dtype=np.bool_), _separation(along, second, float(np.sqrt(np.sum(axis * axis))))


def _separation(along: NDArray[np.float64], second: NDArray[np.bool_], distance: float) -> float:
    if distance == 0.0 or not second.any() or second.all():
        return 0.0
    spread = (along[~second].var() + along[second].var()) / distance**2
    return distance / float(np.sqrt(0.5 * spread) + 1e-9)


# The finger's mask in two steps, where time counts: roughly where it is, and its outline around that.

FEW_SAMPLES = 2000
"""Pixels to which the background is fitted where time counts."""


def finger_region(mean_image: FloatArray, px_per_mm: float, settings: MaskSettings | None = None) -> BoolArray:
    """Find roughly where the finger is: what :func:`finger_mask` does first, in a fraction of its time, to the pitch of
    the coarse copy (``coarse_px_per_mm``). Raises BadInput as it does.
    """
    settings = settings or MaskSettings()
    image = _check_image(mean_image, px_per_mm)
    height, width = image.shape[:2]
    scale = reduction((height, width), px_per_mm, settings.coarse_px_per_mm, 600)
    coarse = blur(reduce_image(image, scale), 0.5 * BLUR_MM * px_per_mm * scale)
    mask = _coarse_mask(coarse, px_per_mm * scale, FEW_SAMPLES)
    check_borders(mask)
    full = cv2.resize(mask.astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR) > 0.5
    return np.asarray(full, dtype=np.bool_)


def finger_outline(
    mean_image: FloatArray, rough: BoolArray, px_per_mm: float, settings: MaskSettings | None = None
) -> BoolArray:
    """Find the outline of a finger that is roughly known, (H, W) bool, as :func:`finger_mask` does in the end.

    `mean_image`: (H, W, 3) or (H, W), the finger and at least three times ``edge_margin_mm`` of background around it,
    save where it leaves the image; `rough`: (h, w) bool, the finger on the same piece of the scene, at any scale.
    Raises BadInput if nothing stands out from the background there.
    """
    settings = settings or MaskSettings()
    image = _check_image(mean_image, px_per_mm)
    height, width = image.shape[:2]
    require(bool(rough.any()), _NO_FINGER, NoFinger)
    scale = reduction((height, width), px_per_mm, settings.fine_px_per_mm, 1200)
    fine = reduce_image(image, scale)
    return _fine_outline(fine, rough, (height, width), px_per_mm * scale, FEW_SAMPLES)


_SMALLEST_PART = 0.2
"""Of the largest finger's area: what is smaller is none."""


def finger_masks(mean_image: FloatArray, px_per_mm: float) -> list[BoolArray]:
    """Find roughly where several fingers are between which the background shows: the clusters of :func:`finger_mask`.

    `mean_image`: (H, W) or (H, W, 3) float32, linear. Returns a mask (H, W) for each finger; what is narrower than 4 mm
    or has less than a fifth of the largest finger's area is left out. Raises BadInput if there is no finger.
    """
    image = blur(_check_image(mean_image, px_per_mm), 0.5 * BLUR_MM * px_per_mm)
    weights, radius = _colour_filter(image), 0.5 * _MIN_WIDTH_MM * px_per_mm

    def wide(region: BoolArray) -> BoolArray:
        region = fill_holes(region)
        return region & dilate(erode(region, radius), 1.15 * radius)

    mask = _seed(image if weights is None else _filtered(image, weights), BLUR_MM * px_per_mm, wide)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    areas = stats[1:, cv2.CC_STAT_AREA]
    return [np.asarray(labels == 1 + k) for k in np.flatnonzero(areas >= _SMALLEST_PART * areas.max())]
