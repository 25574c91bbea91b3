"""Stacks of one scene under changing patterns, and which pixel a pattern lights in which image:
checked, named, found.

All methods of :mod:`splitknit.separation` share one model. A pixel whose surface point the pattern
lights with brightness s (1 = lit, `dark` = unlit) records L = s L_direct + k L_global: direct light
follows the pattern, global light (scattered in the skin or between surfaces) sees only the
pattern's mean brightness k, because it gathers many checks. With a fraction `alpha` of the source
lit, k = alpha + dark (1 - alpha).

Source: S. K. Nayar, G. Krishnan, M. D. Grossberg and R. Raskar, "Fast separation of direct and
global components of a scene using high frequency illumination", ACM Transactions on Graphics 25(3),
2006.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.checks import check_mask
from splitknit.errors import BadInput, require
from splitknit.model import BoolArray, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Separation:
    """Direct and global light under the whole source, NaN outside the mask: together the image that
    it gives."""

    direct: FloatArray
    """(H, W) or (H, W, C): single reflection at the surface, and all transport shorter than the
    pattern's period."""
    # (H, W) or (H, W, C): light that came round, through the skin or from other surfaces
    global_: FloatArray

    @property
    def white(self) -> FloatArray:
        """The image under the whole source: direct plus global light."""
        return self.direct + self.global_


@dataclass(frozen=True, slots=True, eq=False)
class LightStack:
    """A stack that passed the checks."""

    light: FloatArray  # (N, H, W, C) linear light
    mask: BoolArray  # (H, W), true where a result is wanted
    grey: bool  # whether the images came without an axis for channels
    names: tuple[str, ...]  # what messages call the images

    def shaped(self, values: NDArray[Any]) -> FloatArray:
        """`values` (H, W, C) as a result: float32, NaN outside the mask, without the channel axis
        if grey."""
        result = np.array(values, dtype=np.float32)
        result[~self.mask] = np.nan
        return result[..., 0] if self.grey else result

    def separation(
        self, low: NDArray[Any], high: NDArray[Any], alpha: float, dark: float
    ) -> Separation:
        """Direct and global light of the light recorded dark (`low`) and lit (`high`), shaped.

        With k = alpha + dark (1 - alpha): direct = (high - low) / (1 - dark), global = (low - dark
        high) / (k (1 - dark)). S. K. Nayar et al. 2006, eq. 7 and 8, for one fraction alpha in all
        images.
        """
        k = mean_brightness(alpha, dark)
        lit, unlit = np.asarray(high, dtype=np.float64), np.asarray(low, dtype=np.float64)
        parts = (lit - unlit) / (1.0 - dark), (unlit - dark * lit) / (k * (1.0 - dark))
        return Separation(*map(self.shaped, parts))


CLIP_LEVEL = 0.99  # of full scale: linear light from which on a value counts as clipped


def light_stack(
    stack: Any,
    mask: Any = None,
    clip_level: float | None = CLIP_LEVEL,
    *,
    files: Sequence[str] = (),
) -> LightStack:
    """Check a stack of linear light, (N, H, W), (N, H, W, C) or a sequence of images, C = 1 or 3,
    and its mask (H, W).

    `clip_level`: linear light from which on a value counts as clipped; None where the images cannot
    clip. Values beyond 1 show that the stack is not a file's [0, 1] scale, and nothing is looked
    for. `files`: the images' names, for messages. Raises BadInput if there are fewer than two
    images, sizes differ, values are not finite, or an image is black or overexposed.
    """
    images = [np.asarray(image) for image in stack]
    require(len(images) >= 2, f"at least 2 images are needed, but there are {len(images)}.")
    names = tuple(f"image {k} ({file})" for k, file in enumerate(files))
    names = names or tuple(f"image {k}" for k in range(len(images)))
    first = images[0].shape
    for name, image in zip(names, images, strict=True):
        require(
            image.shape == first,
            f"{name} has the shape {image.shape}, but {names[0]} has {first}; all must be of one"
            " size and kind.",
        )
    grey = len(first) == 2
    require(
        (grey or (len(first) == 3 and first[2] in (1, 3))) and min(first) > 0,
        "an image must have the shape (H, W) or (H, W, C) with 1 or 3 channels, but it has"
        f" {first}.",
    )
    light = np.stack([np.atleast_3d(image) for image in images]).astype(np.float32)
    for name, image in zip(names, light, strict=True):
        require(np.isfinite(image).all(), f"{name} contains NaN or infinite values.")
    checked = LightStack(light, check_mask(mask, first[:2]), grey, names)
    _check_exposure(checked, clip_level)
    return checked


def _check_exposure(images: LightStack, clip_level: float | None) -> None:
    light, mask = images.light, images.mask
    peaks = np.array([np.quantile(_thinned(image.max(axis=-1), mask), 0.999) for image in light])
    usual = float(np.median(peaks))
    require(peaks.max() > 0, "every image is black; check the light source and capture again.")
    k = int(np.argmin(peaks))
    # an image whose bright pixels stay below this fraction of the other images' is black
    require(
        peaks[k] > 0.03 * usual,
        f"{images.names[k]} is black: its bright pixels reach {peaks[k]:.3g}, those of the others "
        f"{usual:.3g}; its pattern lights nothing, capture it again or leave it out.",
    )
    brightest = light.max(axis=(0, -1))
    if clip_level is None or brightest.max() > 1.0001:
        return
    fraction = float((brightest[mask] >= clip_level).mean())
    # a stack with more clipped pixels is refused: its maximum, so its direct light, is wrong
    require(
        fraction <= 0.02,
        f"{percent(fraction)} of the pixels are saturated (linear value {clip_level:g} or more) in "
        "their brightest image; capture again with a shorter exposure.",
    )


def mean_brightness(alpha: float, dark: float) -> float:
    """Mean brightness k of a pattern of which a fraction `alpha` is lit and the rest has the
    brightness `dark`."""
    require(0 < alpha <= 1, f"alpha must lie in (0, 1], but it is {alpha:g}.")
    require(0 <= dark < 1, f"dark must lie in [0, 1), but it is {dark:g}.")
    return alpha + dark * (1.0 - alpha)


def _thinned(values: NDArray[Any], mask: BoolArray) -> NDArray[Any]:
    """Values inside the mask, thinned to about 200,000 of them."""
    inside = values[mask]
    return inside[:: max(1, inside.size // 200_000)]


def percent(fraction: float) -> str:
    """`fraction` (0 to 1) as a percentage for people, never rounded to nothing."""
    return (
        f"{100 * fraction:.1f} %"
        if fraction >= 0.001 or fraction == 0
        else f"{100 * fraction:.1g} %"
    )


# Whether a stack can hold what its patterns are to show: pixels that change.


_LIT_LEVEL = 0.1
"""Only pixels brighter than this fraction of the brightest ones are checked: no black background,
and nothing that 8 bits cannot resolve."""
_MIN_CONTRAST = 0.005
"""A pixel that changes by less than this fraction of its maximum was never lit, or never dark."""


def check_contrast(low: FloatArray, high: FloatArray, mask: BoolArray) -> None:
    """Refuse a stack in which too many bright pixels do not change."""
    dark, bright = low.max(axis=-1), high.max(axis=-1)
    looked_at = mask & (bright > _LIT_LEVEL * float(np.quantile(_thinned(bright, mask), 0.999)))
    constant = looked_at & (bright - dark <= _MIN_CONTRAST * bright)
    fraction = float(constant.sum()) / max(1.0, float(looked_at.sum()))
    if fraction <= 0.05:  # a stack with more such pixels among the bright ones is refused
        return
    row, column = np.argwhere(constant)[0]
    raise BadInput(
        f"{percent(fraction)} of the bright pixels were never lit or never dark (first at row"
        f" {row}, column {column}): they change by less than {100 * _MIN_CONTRAST:g} % from image"
        " to image; let the patterns reach every pixel, or give a mask."
    )


def check_change(light: FloatArray) -> None:
    """Refuse a stack whose images differ by noise alone, which is independent from pixel to
    pixel."""
    rows = light[:, :: max(1, light[0, ..., 0].size // 60_000)].mean(axis=-1, dtype=np.float64)
    change = rows - rows.mean(axis=0)
    power = float((change * change).mean())
    covariance = max(
        abs(float((change[..., away:] * change[..., :-away]).mean())) for away in (1, 2)
    )
    require(
        covariance > 3.0 / np.sqrt(change[0].size) * power,
        "the images differ by noise at most: the patterns never light the scene; check the"
        " projector, or whether the direct light is too weak to be seen.",
    )


_DECIDED_PART = 1 - 2 * 0.2
"""Part of half the range of its neighbours beyond which a pixel's state is decided."""


def estimate_patterns(
    stack: Any,
    *,
    mask: Any = None,
    clip_level: float | None = CLIP_LEVEL,
    files: Sequence[str] = (),
) -> FloatArray:
    """Find the states (N, H, W) of unknown patterns from the images themselves: 1 lit, 0 dark, 0.5
    undecided.

    A pixel's state is read from the mean of its *neighbours* (a Gaussian of one pixel without its
    centre), relative to their own maximum and minimum over the images; in the middle three fifths
    of that range it is undecided. The neighbours share its state and not its noise, so that least
    squares with these states is unbiased in all but the faintest pixels; there it falls short,
    towards zero, where maximum and minimum would invent direct light. Checks must be wider than
    about five pixels.
    """
    images = light_stack(stack, mask, clip_level, files=files)
    kernel = cv2.getGaussianKernel(9, 1.0, cv2.CV_64F)
    around = kernel @ kernel.T
    around[4, 4] = 0.0
    around /= around.sum()
    greys = (np.ascontiguousarray(image.mean(axis=-1)) for image in images.light)
    means = np.stack(
        [cv2.filter2D(grey, cv2.CV_32F, around, borderType=cv2.BORDER_REFLECT) for grey in greys]
    )
    low, high = means.min(axis=0), means.max(axis=0)
    middle = (high + low) / 2
    half = np.maximum((high - low) / 2, 1e-20)
    states = np.full(means.shape, 0.5, dtype=np.float32)
    states[means >= middle + _DECIDED_PART * half] = 1.0
    states[means <= middle - _DECIDED_PART * half] = 0.0
    return states


STATE_EDGE = 0.1
"""Known states are lit from one less this, dark up to this; the rim of a check is left out."""


def check_patterns(patterns: Any, images: LightStack) -> FloatArray:
    """Return known states (N, H, W), checked against the stack they belong to."""
    states = np.asarray(patterns, dtype=np.float32)
    shape = images.light.shape[:3]
    require(
        states.shape == shape,
        f"patterns must have the shape {shape} of the images, but it has {states.shape}.",
    )
    require(
        bool(np.isfinite(states).all()) and states.min() >= 0 and states.max() <= 1,
        "patterns must hold states from 0 (dark) to 1 (lit), without NaN.",
    )
    for reached, word in ((states >= 1 - STATE_EDGE, "lit"), (states <= STATE_EDGE, "dark")):
        never = images.mask & ~reached.any(axis=0)
        if never.any():
            row, column = np.argwhere(never)[0]
            raise BadInput(
                f"{percent(never.sum() / images.mask.sum())} of the pixels are never {word} by the"
                f" patterns (first at row {row}, column {column}): a shift is missing; capture it,"
                " or leave these pixels out with a mask."
            )
    _check_order(images, states)
    return states


def _check_order(images: LightStack, states: FloatArray) -> None:
    step = max(1, int(np.count_nonzero(images.mask)) // 40_000)
    light = images.light.mean(axis=-1)[:, images.mask][:, ::step].astype(np.float64)
    light -= light.mean(axis=0)
    known = states[:, images.mask][:, ::step].astype(np.float64)
    known = np.ma.masked_inside(known, STATE_EDGE, 1 - STATE_EDGE)  # undecided
    decided = ~np.ma.getmaskarray(known)
    known = (known - known.mean(axis=0)).filled(0.0)
    power = (known * known).sum(axis=1) * ((light * light) @ decided.T)
    correlation = light @ known.T / np.sqrt(np.maximum(power, 1e-30))
    for k, best in enumerate(np.argmax(correlation, axis=1)):
        require(
            correlation[k, k] > 0.02,
            f"{images.names[k]} does not show its pattern at all; check that images and patterns"
            " belong together.",
        )
        require(
            correlation[k, best] < correlation[k, k] + 0.02,
            f"{images.names[k]} shows pattern {best} instead of its own: a shift is repeated,"
            " missing or out of order.",
        )
