"""Direct and global light from binary patterns: shifted checkerboards, a moving line or mesh, one image.

Maximum and minimum over *noisy* images are biased: of 25 images with noise of standard deviation sigma the direct light
comes out about 3.3 sigma too large. Least squares with states that are known, or found with
:func:`splitknit.separation.stacks.estimate_patterns`, has no such bias and less variance.

In skin some global light comes from less than a check away: a pixel at the rim of a lit check records less than one in
its middle. Maximum minus minimum is what it records in the middle; the mean over all lit and dark images is a fifth to
a third less. With `check_px` the spread of the light is fitted too, and the result is that of the middle.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import check_image, require
from splitknit.model import BoolArray, FloatArray
from splitknit.separation.stacks import (
    DEFAULTS,
    EDGE,
    LightStack,
    Separation,
    StackSettings,
    by_rows,
    check_contrast,
    check_fraction,
    check_patterns,
    check_repeats,
    check_shifts,
    light_stack,
    mean_brightness,
)


def checkerboard(
    stack: Any,
    *,
    alpha: float = 0.5,
    dark: float = 0.0,
    patterns: Any = None,
    check_px: float | None = None,
    shifts: Any = None,
    period: Any = None,
    mask: Any = None,
    settings: StackSettings = DEFAULTS,
) -> Separation:
    """Separate direct from global light.

    Without `patterns`: each pixel's maximum and minimum over the images (Nayar et al.; the thesis's 3.54 to 3.57). With
    `patterns`: least squares of L = s L_direct + k L_global over a pixel's images, s = dark + (1 - dark) P, with images
    left out in which the pixel lies on the rim of a check (P neither lit nor dark: there P is uncertain and the direct
    light partly missing). It is unbiased, since the states do not depend on the noise.

    With `patterns` and `check_px`, for matter in which light spreads: least squares of L = a + b s + c m, where m is s
    averaged over a square of 0.8 checks around the pixel, with the weights |2 m - 1|, evaluated where the pixel lies
    nearest to the middle of a lit and of a dark check. These places are known: no bias by noise. Raises BadInput if the
    stack is inconsistent: a shift missing or repeated, pixels never lit or never dark, saturated or black images, sizes
    that differ, NaN, images that do not show their patterns.

    stack : (N, H, W) or (N, H, W, C), N >= 2, linear light, black level removed; all patterns have the same `alpha`
    alpha : fraction of the source that is lit, in (0, 1]
    dark : brightness of the unlit part over the lit one, in [0, 1); zero where a "black" image was subtracted
    patterns : (N, H, W) in [0, 1], state P of the pattern at each camera pixel: 1 lit, 0 dark
    check_px : side of a check on the camera's pixels, for skin; without, global light is the same under all shifts
    shifts : (N,) or (N, 2), of each image's pattern: a full grid, each shift once
    period : number or pair, of the pattern in the units of `shifts`, which are then compared modulo it
    mask : (H, W) bool

    Source: S. K. Nayar et al., "Fast separation of direct and global components of a scene using high frequency
    illumination", ACM Transactions on Graphics 25(3), 2006, section 3.

    >>> import numpy as np
    >>> board = np.kron([[1.0, 0.0], [0.0, 1.0]], np.ones((4, 4)))
    >>> patterns = np.stack([board, np.roll(board, 4, axis=1)])
    >>> parts = checkerboard(0.3 * patterns + 0.5 * 0.2, patterns=patterns)
    >>> bool(np.allclose(parts.direct, 0.3) and np.allclose(parts.global_, 0.2))
    True
    """
    mean_brightness(alpha, dark)
    require(check_px is None or patterns is not None, "check_px needs patterns, the states of the pixels.")
    require(check_px is None or 1 <= check_px <= 1e4, f"check_px must be at least 1, but it is {check_px}.")
    if shifts is not None:
        check_shifts(shifts, len(stack), period)
    images = light_stack(stack, least=2, mask=mask, settings=settings)
    if patterns is None:
        low, high = images.light.min(axis=0), images.light.max(axis=0)
        words = ("never lit or never dark", "let the patterns reach every pixel, or give a mask")
        check_contrast(low, high, images.mask, settings, words)
        check_repeats(images.light, images.mask, settings)
        return images.separation(low, high, alpha, dark)
    states = check_patterns(patterns, images)
    if check_px is None:
        return Separation(*map(images.shaped, _by_states(images.light, states, alpha, dark)))
    low, high = _in_the_middle(images.light, states, check_px)
    return images.separation(low, high, alpha, dark)


def _by_states(light: FloatArray, states: FloatArray, alpha: float, dark: float) -> tuple[FloatArray, FloatArray]:
    """Direct and global light (H, W, C) by least squares over the images in which a pixel is lit or dark."""
    k = mean_brightness(alpha, dark)
    direct = np.empty(light.shape[1:], dtype=np.float32)
    global_ = np.empty_like(direct)

    def work(rows: slice) -> None:
        state = states[:, rows].astype(np.float64)
        used: BoolArray = (state <= EDGE) | (state >= 1 - EDGE)
        number = np.maximum(used.sum(axis=0), 1)[..., None]
        s = np.where(used, dark + (1 - dark) * state, 0.0)
        mean_s = s.sum(axis=0)[..., None] / number
        values = light[:, rows]
        mean = np.einsum("nhw,nhwc->hwc", used.astype(np.float64), values) / number
        centred = np.where(used, s - mean_s[..., 0], 0.0)
        spread = (centred * centred).sum(axis=0)[..., None]
        slope = np.einsum("nhw,nhwc->hwc", centred, values - mean) / np.maximum(spread, 1e-12)
        direct[rows] = slope
        global_[rows] = (mean - slope * mean_s) / k

    by_rows(light[:, 0].size, light.shape[1], work)
    return direct, global_


def _in_the_middle(light: FloatArray, states: FloatArray, check_px: float) -> tuple[FloatArray, FloatArray]:
    """Light (H, W, C) of each pixel where it is nearest to the middle of a dark and of a lit check. The pattern's mean
    over a square somewhat smaller than a check, 1 or 0 in its middle and 1/2 at its rim, stands for the light from
    around, and weighs the images.
    """
    around = np.stack([_square_mean(state, 0.8 * check_px) for state in states])
    used = (states <= EDGE) | (states >= 1 - EDGE)
    low = np.empty(light.shape[1:], dtype=np.float32)
    high = np.empty_like(low)

    def work(rows: slice) -> None:
        near = around[:, rows].astype(np.float64)
        terms = np.stack([np.ones_like(near), states[:, rows], near], axis=-1)  # (N, h, W, 3)
        weighted = terms * (used[:, rows] * np.abs(2 * near - 1))[..., None]
        normal = np.einsum("nhwk,nhwl->hwkl", weighted, terms)
        # where no shift separates the terms they share the light; far too little to bias what is known
        normal += 1e-9 * np.trace(normal, axis1=2, axis2=3)[..., None, None] * np.eye(3)
        fitted = np.linalg.solve(normal, np.einsum("nhwk,nhwc->hwkc", weighted, light[:, rows]))
        for part, image in ((low, near.argmin(axis=0)), (high, near.argmax(axis=0))):
            term = np.take_along_axis(terms, image[None, ..., None], axis=0)[0]
            part[rows] = np.einsum("hwk,hwkc->hwc", term, fitted)

    by_rows(3 * light[:, 0].size, light.shape[1], work)
    return low, high


def _square_mean(state: FloatArray, side_px: float) -> FloatArray:
    """Mean (H, W) over a square around each pixel, whose side need not be whole pixels."""
    reach = int(np.ceil(max(side_px - 1, 0) / 2))
    fraction = np.ones(2 * reach + 1)
    if reach > 0:
        fraction[[0, -1]] = (side_px - (2 * reach - 1)) / 2
    fraction /= fraction.sum()
    return np.asarray(cv2.sepFilter2D(state, cv2.CV_32F, fraction, fraction, borderType=cv2.BORDER_REFLECT))


KINDS = ("line", "mesh")


def occluder(
    sequence: Any,
    kind: str = "line",
    *,
    alpha: float | None = None,
    shadow_percent: float = 0.0,
    patterns: Any = None,
    mask: Any = None,
    settings: StackSettings = DEFAULTS,
) -> Separation:
    """Separate direct from global light by a moving shadow (S. K. Nayar et al. 2006, section 5.1).

    A thin line takes away hardly any of the global light: direct = greatest - least, global = least. A mesh that lets
    the fraction `alpha` of the light through takes the rest of the global light with it in *every* image: global =
    least / alpha.

    Minimum and maximum over noisy images are biased outwards. Two remedies: `shadow_percent`, the fraction of the
    images in which every pixel is surely in full shadow: the median of that many darkest images is its shadow, the
    median of the upper half its light (robust against a passing fly, less biased). Or `patterns`, known or from
    :func:`splitknit.separation.stacks.estimate_patterns`: the means over a pixel's lit and shadowed images, unbiased.

    `sequence`: (N, H, W) or (N, H, W, C) linear light, black level removed, lamp and camera fixed, or an iterable of
    images, two at least; `kind`: ``line`` or ``mesh``; `alpha`, in (0, 1], is to be given for a mesh; `shadow_percent`:
    0 (plain extremes) to 50; `patterns`: (N, H, W), 1 lit, 0 in the shadow, left out between; `mask`: (H, W) bool.
    Raises BadInput if pixels were never shadowed (fraction and first of them), or the images are unusable.
    """
    require(kind in KINDS, f"kind must be 'line' or 'mesh', but it is '{kind}'.")
    require(kind == "line" or alpha is not None, "a mesh needs alpha, the fraction of the light that passes it.")
    require(0 <= shadow_percent <= 50, f"shadow_percent must lie in [0, 50], but it is {shadow_percent}.")
    fraction = check_fraction(1.0 if alpha is None else alpha, "alpha")
    images = light_stack(sequence, least=2, mask=mask, settings=settings)
    light = images.light
    if patterns is not None:
        states = check_patterns(patterns, images, distinct=False)
        low, high = _mean_where(light, states <= EDGE), _mean_where(light, states >= 1 - EDGE)
    elif shadow_percent == 0:
        low, high = light.min(axis=0), light.max(axis=0)
    else:
        low, high = _robust_extremes(light, shadow_percent)
    words = ("never shadowed (or never lit)", "sweep the occluder over them, or leave them out with a mask")
    check_contrast(low, high, images.mask, settings, words)
    return images.separation(low, high, fraction, 0.0)


def _mean_where(light: FloatArray, used: Any) -> FloatArray:
    """Mean (H, W, C) of the images in which `used` (N, H, W) holds."""
    total = np.zeros(light.shape[1:], dtype=np.float64)
    for image, here in zip(light, used, strict=True):
        total += np.where(here[..., None], image, np.float32(0))
    return np.asarray(total / np.maximum(used.sum(axis=0), 1)[..., None], dtype=np.float32)


def _robust_extremes(light: FloatArray, percent: float) -> tuple[FloatArray, FloatArray]:
    """Medians (H, W, C) of the darkest `percent` and of the brighter half of the images."""
    count = len(light)
    darkest = max(1, int(count * percent / 100))
    low = np.empty(light.shape[1:], dtype=np.float32)
    high = np.empty_like(low)
    for row in range(light.shape[1]):
        ordered = np.sort(light[:, row], axis=0)
        low[row] = np.median(ordered[:darkest], axis=0)
        high[row] = np.median(ordered[count // 2 :], axis=0)
    return low, high


def single_image(
    image: Any,
    block: int,
    *,
    check_px: float | None = None,
    alpha: float = 0.5,
    dark: float = 0.0,
    pattern: Any = None,
    settings: StackSettings = DEFAULTS,
) -> Separation:
    """Separate direct from global light in blocks of `block` x `block` pixels (S. K. Nayar et al. 2006, section 6).

    Without `pattern`: in each channel the local peaks (a check's brightest pixels) and valleys are found, carried over
    to all pixels, and averaged over the blocks. Peaks and valleys of noise and of the skin's own texture are taken
    along: direct light comes out too large. With `pattern`, (H, W) in [0, 1], least squares of L = s L_direct + k
    L_global over the pixels of each block, which noise does not bias.

    `image`: (H, W) or (H, W, C) linear light, black level removed; `block`: at least twice the check; `check_px`: side
    of a check in pixels, needed without `pattern`; `alpha`, `dark`: as for :func:`checkerboard`. Returns (H // block, W
    // block) or with C; rows and columns that fill no block are dropped. Raises BadInput if the image is black or
    saturated, holds no such pattern, or a block is never lit or never dark.
    """
    mean_brightness(alpha, dark)
    images = light_stack([image], least=1, settings=settings)
    light = images.light[0]
    size = light.shape[:2]
    fault = f"block must be a whole number from 2 to the image's smaller side, {min(size)},"
    require(block == int(block) and 2 <= block <= min(size), f"{fault} but it is {block}.")
    if pattern is None:
        fault = f"check_px, the side of a check, must be from 1.5 pixels to half a block ({block / 2:g}),"
        require(check_px is not None and 1.5 <= check_px <= block / 2, f"{fault} but it is {check_px}.")
        low, high = (_block_mean(part, block) for part in _envelopes(light, float(check_px or 0.0)))
    else:
        low, high = _by_state(light, check_image(pattern, name="pattern"), block, dark)
    mask = np.ones(low.shape[:2], dtype=np.bool_)
    words = ("never lit or never dark", "light them with the pattern, or choose larger blocks")
    check_contrast(low.astype(np.float32), high.astype(np.float32), mask, settings, words)
    return LightStack(images.light, mask, images.grey).separation(low, high, alpha, dark)


def _envelopes(light: FloatArray, check_px: float) -> tuple[FloatArray, FloatArray]:
    """Light from valley to valley and from peak to peak (H, W, C): opening and closing of each channel. The closing
    carries peaks over dark checks and follows the slopes of shading, where a plain maximum would be a neighbour's rim.
    A window of 1.5 checks always holds the middle of a lit and of a dark one.
    """
    reach = int(np.ceil(0.75 * check_px))
    window = cv2.getStructuringElement(cv2.MORPH_RECT, (2 * reach + 1, 2 * reach + 1))
    rim = 2 * reach  # within it windows would leave the image; it takes the values of the nearest pixel inside
    size = light.shape[:2]
    small = f"the image must be larger than {2 * rim} pixels a side for checks of {check_px:g} pixels."
    require(min(size) > 2 * rim, small)
    low, high = np.empty_like(light), np.empty_like(light)
    for c in range(light.shape[-1]):
        plane = np.ascontiguousarray(light[..., c])
        for result, kind in ((low, cv2.MORPH_OPEN), (high, cv2.MORPH_CLOSE)):
            inner = cv2.morphologyEx(plane, kind, window)[rim : size[0] - rim, rim : size[1] - rim]
            result[..., c] = cv2.copyMakeBorder(inner, rim, rim, rim, rim, borderType=cv2.BORDER_REPLICATE)
    return low, high


def _by_state(
    light: FloatArray, pattern: FloatArray, block: int, dark: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Light of the dark and of the lit state in each block (h, w, C), by least squares over its pixels."""
    fault = f"pattern must have the shape {light.shape[:2]} of the image,"
    require(pattern.shape == light.shape[:2], f"{fault} but it has {pattern.shape}.")
    states = "pattern must hold states from 0 (dark) to 1 (lit)."
    require(float(pattern.min()) >= 0 and float(pattern.max()) <= 1, states)
    used = ((pattern <= EDGE) | (pattern >= 1 - EDGE)).astype(np.float64)
    number = _block_mean(used[..., None], block)
    s = (dark + (1 - dark) * pattern.astype(np.float64))[..., None]
    safe = np.maximum(number, 1e-12)
    mean_s = _block_mean(used[..., None] * s, block) / safe
    mean = _block_mean(used[..., None] * light, block) / safe
    spread = _block_mean(used[..., None] * s * s, block) / safe - mean_s**2
    shared = _block_mean(used[..., None] * s * light, block) / safe - mean_s * mean
    cure = "choose larger blocks."
    require(bool((spread > 0.01 * (1 - dark) ** 2).all()), f"a block is never lit or never dark by the pattern; {cure}")
    slope = shared / spread
    return mean + slope * (dark - mean_s), mean + slope * (1 - mean_s)


def _block_mean(values: Any, block: int) -> NDArray[np.float64]:
    """Mean over blocks of (H, W, C): (H // block, W // block, C)."""
    height, width = (n // block for n in values.shape[:2])
    trimmed = np.asarray(values, dtype=np.float64)[: height * block, : width * block]
    return np.asarray(trimmed.reshape(height, block, width, block, -1).mean(axis=(1, 3)))
