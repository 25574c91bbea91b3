"""Direct and global light from binary patterns: shifted checkerboards.

Maximum and minimum over *noisy* images are biased: of 25 images with noise of standard deviation
sigma the direct light comes out about 3.3 sigma too large. Least squares with states that are
known, or found with :func:`splitknit.separation.stacks.estimate_patterns`, has no such bias and
less variance.

In skin some global light comes from less than a check away: a pixel at the rim of a lit check
records less than one in its middle. Maximum minus minimum is what it records in the middle; the
mean over all lit and dark images is a fifth to a third less. With `check_px` the spread of the
light is fitted too, and the result is that of the middle.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np

from splitknit.errors import require
from splitknit.imaging.chunks import for_each_chunk
from splitknit.model import Array, BoolArray, FloatArray
from splitknit.separation.stacks import (
    CLIP_LEVEL,
    STATE_EDGE,
    Separation,
    check_change,
    check_contrast,
    check_patterns,
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
    mask: Any = None,
    clip_level: float | None = CLIP_LEVEL,
    files: Sequence[str] = (),
) -> Separation:
    """Separate direct from global light.

    Without `patterns`: each pixel's maximum and minimum over the images (Nayar et al.; the thesis's
    3.54 to 3.57). With `patterns`: least squares of L = s L_direct + k L_global over a pixel's
    images, s = dark + (1 - dark) P, with images left out in which the pixel lies on the rim of a
    check (P neither lit nor dark: there P is uncertain and the direct light partly missing). It is
    unbiased, since the states do not depend on the noise.

    With `patterns` and `check_px`, for matter in which light spreads: least squares of L = a + b s
    + c m, where m is s averaged over a square of 0.8 checks around the pixel, with the weights |2 m
    - 1|, evaluated where the pixel lies nearest to the middle of a lit and of a dark check. These
    places are known: no bias by noise. Raises BadInput if the stack is inconsistent: pixels never
    lit or never dark, saturated or black images, sizes that differ, NaN, images that do not show
    their patterns.

    stack : (N, H, W) or (N, H, W, C), N >= 2, linear light, black level removed; all patterns have
    the same `alpha`
    alpha : fraction of the source that is lit, in (0, 1]
    dark : brightness of the unlit part over the lit one, in [0, 1); zero where a "black" image was
    subtracted
    patterns : (N, H, W) in [0, 1], state P of the pattern at each camera pixel: 1 lit, 0 dark
    check_px : side of a check on the camera's pixels, for skin; without, global light is the same
    under all shifts
    mask : (H, W) bool
    clip_level, files : of :func:`splitknit.separation.stacks.light_stack`

    Source: S. K. Nayar et al., "Fast separation of direct and global components of a scene using
    high frequency illumination", ACM Transactions on Graphics 25(3), 2006, section 3.

    >>> import numpy as np
    >>> board = np.kron([[1.0, 0.0], [0.0, 1.0]], np.ones((4, 4)))
    >>> patterns = np.stack([board, np.roll(board, 4, axis=1)])
    >>> parts = checkerboard(0.3 * patterns + 0.5 * 0.2, patterns=patterns)
    >>> bool(np.allclose(parts.direct, 0.3) and np.allclose(parts.global_, 0.2))
    True
    """
    mean_brightness(alpha, dark)
    require(
        check_px is None or patterns is not None,
        "check_px needs patterns, the states of the pixels.",
    )
    require(
        check_px is None or 1 <= check_px <= 1e4,
        f"check_px must be at least 1, but it is {check_px}.",
    )
    images = light_stack(stack, mask, clip_level, files=files)
    if patterns is None:
        low, high = images.light.min(axis=0), images.light.max(axis=0)
        check_contrast(low, high, images.mask)
        check_change(images.light)
        return images.separation(low, high, alpha, dark)
    states = check_patterns(patterns, images)
    if check_px is None:
        return Separation(*map(images.shaped, _by_states(images.light, states, alpha, dark)))
    low, high = _in_the_middle(images.light, states, check_px)
    return images.separation(low, high, alpha, dark)


def _by_states(
    light: FloatArray, states: FloatArray, alpha: float, dark: float
) -> tuple[FloatArray, FloatArray]:
    """Direct and global light (H, W, C) by least squares over the images in which a pixel is lit or
    dark."""
    k = mean_brightness(alpha, dark)
    direct = np.empty(light.shape[1:], dtype=np.float32)
    global_ = np.empty_like(direct)

    def work(rows: slice) -> None:
        state = states[:, rows].astype(np.float64)
        terms = np.stack([np.ones_like(state), dark + (1 - dark) * state], axis=-1)
        fitted = _fitted(terms, _decided(state), light[:, rows])
        direct[rows] = fitted[:, :, 1]
        global_[rows] = fitted[:, :, 0] / k

    for_each_chunk(work, light.shape[1], light.shape[2], 4 * light[:, 0, 0].size)
    return direct, global_


def _in_the_middle(
    light: FloatArray, states: FloatArray, check_px: float
) -> tuple[FloatArray, FloatArray]:
    """Light (H, W, C) of each pixel where it is nearest to the middle of a dark and of a lit check.
    The pattern's mean over a square somewhat smaller than a check, 1 or 0 in its middle and 1/2 at
    its rim, stands for the light from around, and weighs the images.
    """
    around = np.stack([_square_mean(state, 0.8 * check_px) for state in states])
    low = np.empty(light.shape[1:], dtype=np.float32)
    high = np.empty_like(low)

    def work(rows: slice) -> None:
        near = around[:, rows].astype(np.float64)
        terms = np.stack([np.ones_like(near), states[:, rows], near], axis=-1)
        weights = _decided(states[:, rows]) * np.abs(2 * near - 1)
        fitted = _fitted(terms, weights, light[:, rows])
        for part, image in ((low, near.argmin(axis=0)), (high, near.argmax(axis=0))):
            term = np.take_along_axis(terms, image[None, ..., None], axis=0)[0]
            part[rows] = np.einsum("hwk,hwkc->hwc", term, fitted)

    for_each_chunk(work, light.shape[1], light.shape[2], 6 * light[:, 0, 0].size)
    return low, high


def _decided(states: FloatArray) -> BoolArray:
    """Whether a pixel is lit or dark, and not at the rim of a check."""
    return (states <= STATE_EDGE) | (states >= 1 - STATE_EDGE)


def _fitted(terms: FloatArray, weights: FloatArray | BoolArray, light: FloatArray) -> Array:
    """Coefficients (h, W, K, C) of terms (N, h, W, K) by weighted least squares in each pixel of
    `light` (N, h, W, C)."""
    weighted = terms * weights[..., None]
    normal = np.einsum("nhwk,nhwl->hwkl", weighted, terms)
    # where no shift separates the terms they share the light; far too little to bias what is known
    normal += 1e-9 * np.trace(normal, axis1=2, axis2=3)[..., None, None] * np.eye(terms.shape[-1])
    return np.asarray(np.linalg.solve(normal, np.einsum("nhwk,nhwc->hwkc", weighted, light)))


def _square_mean(state: FloatArray, side_px: float) -> FloatArray:
    """Mean (H, W) over a square around each pixel, whose side need not be whole pixels."""
    reach = int(np.ceil(max(side_px - 1, 0) / 2))
    fraction = np.ones(2 * reach + 1)
    if reach > 0:
        fraction[[0, -1]] = (side_px - (2 * reach - 1)) / 2
    fraction /= fraction.sum()
    return np.asarray(
        cv2.sepFilter2D(state, cv2.CV_32F, fraction, fraction, borderType=cv2.BORDER_REFLECT)
    )
