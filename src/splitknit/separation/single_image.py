"""Direct and global light from one image under a fine pattern, at a lower resolution."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import check_image, require
from splitknit.model import FloatArray
from splitknit.separation.stacks import (
    DEFAULTS,
    EDGE,
    LightStack,
    Separation,
    StackSettings,
    check_contrast,
    from_extremes,
    light_stack,
    mean_brightness,
)


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
    of a check in pixels, needed without `pattern`; `alpha`, `dark`: as for
    :func:`splitknit.separation.checkerboard.checkerboard`. Returns (H // block, W // block) or with C; rows and columns
    that fill no block are dropped. Raises BadInput if the image is black or saturated, holds no such pattern, or a
    block is never lit or never dark.
    """
    mean_brightness(alpha, dark)
    images = light_stack([image], least=1, settings=settings)
    light = images.light[0]
    size = light.shape[:2]
    require(
        block == int(block) and 2 <= block <= min(size),
        f"block must be a whole number from 2 to the image's smaller side, {min(size)}, but it is {block}.",
    )
    if pattern is None:
        require(
            check_px is not None and 1.5 <= check_px <= block / 2,
            f"check_px, the side of a check, must be from 1.5 pixels to half a block ({block / 2:g}), "
            f"but it is {check_px}.",
        )
        low, high = (_block_mean(part, block) for part in _envelopes(light, float(check_px or 0.0)))
    else:
        low, high = _by_state(light, check_image(pattern, name="pattern"), block, dark)
    mask = np.ones(low.shape[:2], dtype=np.bool_)
    words = ("never lit or never dark", "light them with the pattern, or choose larger blocks")
    check_contrast(low.astype(np.float32), high.astype(np.float32), mask, settings, words)
    direct, global_ = from_extremes(low, high, alpha, dark)
    result = LightStack(images.light, mask, images.grey)
    return Separation(result.shaped(direct), result.shaped(global_))


def _envelopes(light: FloatArray, check_px: float) -> tuple[FloatArray, FloatArray]:
    """Light from valley to valley and from peak to peak (H, W, C): opening and closing of each channel. The closing
    carries peaks over dark checks and follows the slopes of shading, where a plain maximum would be a neighbour's rim.
    A window of 1.5 checks always holds the middle of a lit and of a dark one.
    """
    reach = int(np.ceil(0.75 * check_px))
    window = cv2.getStructuringElement(cv2.MORPH_RECT, (2 * reach + 1, 2 * reach + 1))
    rim = 2 * reach  # within it windows would leave the image; it takes the values of the nearest pixel inside
    size = light.shape[:2]
    require(
        min(size) > 2 * rim, f"the image must be larger than {2 * rim} pixels a side for checks of {check_px:g} pixels."
    )
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
    require(
        pattern.shape == light.shape[:2],
        f"pattern must have the shape {light.shape[:2]} of the image, but it has {pattern.shape}.",
    )
    require(
        float(pattern.min()) >= 0 and float(pattern.max()) <= 1, "pattern must hold states from 0 (dark) to 1 (lit)."
    )
    used = ((pattern <= EDGE) | (pattern >= 1 - EDGE)).astype(np.float64)
    number = _block_mean(used[..., None], block)
    s = (dark + (1 - dark) * pattern.astype(np.float64))[..., None]
    safe = np.maximum(number, 1e-12)
    mean_s = _block_mean(used[..., None] * s, block) / safe
    mean = _block_mean(used[..., None] * light, block) / safe
    spread = _block_mean(used[..., None] * s * s, block) / safe - mean_s**2
    shared = _block_mean(used[..., None] * s * light, block) / safe - mean_s * mean
    require(
        bool((spread > 0.01 * (1 - dark) ** 2).all()),
        "a block is never lit or never dark by the pattern; choose larger blocks.",
    )
    slope = shared / spread
    return mean + slope * (dark - mean_s), mean + slope * (1 - mean_s)


def _block_mean(values: Any, block: int) -> NDArray[np.float64]:
    """Mean over blocks of (H, W, C): (H // block, W // block, C)."""
    height, width = (n // block for n in values.shape[:2])
    trimmed = np.asarray(values, dtype=np.float64)[: height * block, : width * block]
    return np.asarray(trimmed.reshape(height, block, width, block, -1).mean(axis=(1, 3)))
