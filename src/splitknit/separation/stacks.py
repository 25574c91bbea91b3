"""Stacks of one scene under changing patterns: what comes in is checked here, what comes out is named here.

All methods of :mod:`splitknit.separation` share one model. A pixel whose surface point the pattern lights with
brightness s (1 = lit, `dark` = unlit) records L = s L_direct + k L_global: direct light follows the pattern, global
light (scattered in the skin or between surfaces) sees only the pattern's mean brightness k, because it gathers many
checks. With a fraction `alpha` of the source lit, k = alpha + dark (1 - alpha).

Source: S. K. Nayar, G. Krishnan, M. D. Grossberg and R. Raskar, "Fast separation of direct and global components of a
scene using high frequency illumination", ACM Transactions on Graphics 25(3), 2006.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, check_mask, require
from splitknit.model import BoolArray, FloatArray
from splitknit.settings import Checked, Limits

_MAX_CLIPPED = 0.02
"""More clipped pixels than this and the stack is refused: the maximum, and with it the direct light, is wrong."""
LIT_LEVEL = 0.1
"""Only pixels brighter than this part of the brightest ones are checked: no black background, and nothing that 8 bits
cannot resolve."""
MIN_CONTRAST = 0.005
"""A pixel that changes by less than this part of its maximum was never lit, or never dark."""
_BLACK_IMAGE = 0.03
"""An image whose bright pixels stay below this part of the other images' is black."""
EDGE = 0.1
"""Where states are known: lit from 1 - `edge`, dark up to `edge`; in between (the rim of a check) is left out."""


@dataclass(frozen=True, slots=True)
class StackSettings(Checked):
    """When a stack is refused. Fractions are of the pixels inside the mask."""

    clip_level: Annotated[float | None, Limits(0, above=True)] = 0.99
    """Linear light from which on a value counts as clipped; None where the images cannot clip. Values beyond 1 show
    that the stack is no file's [0, 1] scale, and nothing is looked for."""
    constant_share: Annotated[float, Limits(0, 1, below=True)] = 0.05
    """More such pixels than this, among the bright ones, and the stack is refused."""
    repeat: Annotated[float, Limits(0, 1, below=True)] = 0.02
    """Two images that differ by less than this part of the usual power of differences show one pattern twice."""


DEFAULTS = StackSettings()


@dataclass(frozen=True, slots=True, eq=False)
class Separation:
    """Direct and global light, NaN outside the mask. Both are what the camera would record with the whole source lit,
    so that they add up to that image.
    """

    direct: FloatArray
    """(H, W) or (H, W, C): single reflection at the surface, and all transport shorter than the pattern's period."""
    global_: FloatArray
    """(H, W) or (H, W, C): light that came round, through the skin or from other surfaces."""

    @property
    def white(self) -> FloatArray:
        """The image under the whole source: direct plus global light."""
        return np.asarray(self.direct + self.global_, dtype=np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class LightStack:
    """A stack that passed the checks."""

    light: FloatArray
    """(N, H, W, C) linear light."""
    mask: BoolArray
    """(H, W), true where a result is wanted."""
    grey: bool
    """Whether the images came without an axis for channels."""

    def shaped(self, values: NDArray[Any]) -> FloatArray:
        """`values` (H, W, C) as a result: float32, NaN outside the mask, without the channel axis if grey."""
        result = np.array(values, dtype=np.float32)
        result[~self.mask] = np.nan
        return result[..., 0] if self.grey else result


def light_stack(stack: Any, *, least: int, mask: Any = None, settings: StackSettings = DEFAULTS) -> LightStack:
    """Check a stack of linear light, (N, H, W), (N, H, W, C) or a sequence of images, C = 1 or 3, and its mask (H, W).

    Raises BadInput if there are fewer than `least` images, sizes differ, values are not finite, or an image is black or
    overexposed.
    """
    images = [np.asarray(image) for image in stack]
    require(len(images) >= least, f"at least {least} images are needed, but there are {len(images)}.")
    first = images[0].shape
    for k, image in enumerate(images):
        require(
            image.shape == first,
            f"image {k} has the shape {image.shape}, but image 0 has {first}; all must be of one size and kind.",
        )
    grey = len(first) == 2
    require(
        (grey or (len(first) == 3 and first[2] in (1, 3))) and min(first) > 0,
        f"an image must have the shape (H, W) or (H, W, C) with 1 or 3 channels, but it has {first}.",
    )
    light = np.empty((len(images), *first[:2], 1 if grey else first[2]), dtype=np.float32)
    for k, image in enumerate(images):
        light[k] = image[..., None] if grey else image
        require(bool(np.isfinite(light[k]).all()), f"image {k} contains NaN or infinite values.")
    where = check_mask(mask, first[:2])
    _check_exposure(light, where, settings)
    return LightStack(light, where, grey)


def _check_exposure(light: FloatArray, mask: BoolArray, settings: StackSettings) -> None:
    """Refuse black images, and a stack that clips in too many pixels."""
    peaks = np.array([np.quantile(_thinned(image.max(axis=-1), mask), 0.999) for image in light])
    usual = float(np.median(peaks))
    require(float(peaks.max()) > 0, "every image is black; check the light source and capture again.")
    k = int(np.argmin(peaks))
    require(
        bool(peaks[k] > _BLACK_IMAGE * usual),
        f"image {k} is black: its bright pixels reach {peaks[k]:.3g}, those of the others {usual:.3g}; its pattern "
        f"lights nothing, capture it again or leave it out.",
    )
    brightest = light.max(axis=(0, -1))
    if settings.clip_level is None or float(brightest.max()) > 1.0001:
        return
    fraction = float((brightest[mask] >= settings.clip_level).mean())
    require(
        fraction <= _MAX_CLIPPED,
        f"{percent(fraction)} of the pixels are saturated (linear value {settings.clip_level:g} or more) in their "
        f"brightest image; capture again with a shorter exposure.",
    )


def check_fraction(value: float, name: str) -> float:
    """Return `value` as a float in (0, 1], or [0, 1) where it is the dark level."""
    number = float(value)
    good, limits = (0 <= number < 1, "[0, 1)") if name == "dark" else (0 < number <= 1, "(0, 1]")
    require(good, f"{name} must lie in {limits}, but it is {number:g}.")
    return number


def mean_brightness(alpha: float, dark: float) -> float:
    """Mean brightness k of a pattern of which a fraction `alpha` is lit and the rest has the brightness `dark`."""
    return check_fraction(alpha, "alpha") + check_fraction(dark, "dark") * (1.0 - float(alpha))


def from_extremes(
    low: NDArray[Any], high: NDArray[Any], alpha: float, dark: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Direct and global light of the light recorded dark (`low`) and lit (`high`), any shape.

    With k = alpha + dark (1 - alpha): direct = (high - low) / (1 - dark), global = (low - dark high) / (k (1 - dark)).
    S. K. Nayar et al. 2006, eq. 7 and 8, for one fraction alpha in all images.
    """
    k = mean_brightness(alpha, dark)
    lit, unlit = np.asarray(high, dtype=np.float64), np.asarray(low, dtype=np.float64)
    direct = (lit - unlit) / (1.0 - dark)
    return direct, (unlit - dark * lit) / (k * (1.0 - dark))


def by_rows(count: int, height: int, work: Callable[[slice], None]) -> None:
    """Call `work` for slices of rows, so that arrays of `count` values a row in float64 stay small."""
    step = max(1, 2_000_000 // max(1, count))
    for top in range(0, height, step):
        work(slice(top, min(top + step, height)))


def _thinned(values: NDArray[Any], mask: BoolArray) -> NDArray[Any]:
    """Values inside the mask, thinned to about 200,000 of them."""
    inside = values[mask]
    return np.asarray(inside[:: max(1, inside.size // 200_000)])


def percent(fraction: float) -> str:
    """`fraction` (0 to 1) as a percentage for people, never rounded to nothing."""
    return f"{100 * fraction:.1f} %" if fraction >= 0.001 or fraction == 0 else f"{100 * fraction:.1g} %"


# Whether a stack can hold what its patterns are to show: pixels that change, and no pattern twice.


def check_contrast(
    low: FloatArray, high: FloatArray, mask: BoolArray, settings: StackSettings, words: tuple[str, str]
) -> None:
    """Refuse a stack in which too many bright pixels do not change, naming their fraction and the first's place.
    `words`: what they have never been, and the remedy.
    """
    dark, bright = low.max(axis=-1), high.max(axis=-1)
    looked_at = mask & (bright > LIT_LEVEL * float(np.quantile(_thinned(bright, mask), 0.999)))
    constant = looked_at & (bright - dark <= MIN_CONTRAST * bright)
    fraction = float(constant.sum()) / max(1.0, float(looked_at.sum()))
    if fraction <= settings.constant_share:
        return
    row, column = np.argwhere(constant)[0]
    raise BadInput(
        f"{percent(fraction)} of the bright pixels were {words[0]} (first at row {row}, column {column}): they change "
        f"by less than {100 * MIN_CONTRAST:g} % from image to image; {words[1]}."
    )


def check_repeats(
    light: FloatArray, mask: BoolArray, settings: StackSettings = DEFAULTS, expected: NDArray[np.float64] | None = None
) -> None:
    """Refuse a stack in which two images show the same pattern: a repeated shift, and so a missing one.

    They differ by noise alone, which is independent from pixel to pixel: the covariance of the difference with itself,
    moved by a pixel or two, shows patterns. `expected`: (N, N) how much patterns differ (any unit); all equal where
    None.
    """
    power, covariance, count = _differences(light, mask)
    pairs = np.triu_indices(len(light), 1)
    relative = covariance[pairs] if expected is None else covariance[pairs] / np.maximum(expected[pairs], 1e-6)
    limit = settings.repeat if expected is None else 0.2
    level = float(np.mean(np.square(light.mean(axis=0, dtype=np.float64)[mask])))
    reference = float(np.median(relative))
    require(
        float(np.median(covariance[pairs])) > max(1e-10 * level, 3.0 / np.sqrt(count) * float(np.median(power[pairs]))),
        "the images differ by noise at most: the patterns never light the scene; check the projector, or whether "
        "the direct light is too weak to be seen.",
    )
    similar = np.zeros(covariance.shape, dtype=np.bool_)
    similar[pairs] = relative <= limit * reference
    twins = odd_twins(similar)
    if twins is not None:
        raise BadInput(
            f"images {twins[0]} and {twins[1]} show the same pattern: a shift is repeated, and another one may be "
            f"missing; capture the stack again or remove one of them."
        )


def odd_twins(similar: BoolArray) -> tuple[int, int] | None:
    """Return the first pair that is `similar` (N, N, upper triangle), or None if all have as many twins.

    In a full grid of an even number of shifts every checkerboard has a twin, a check away each way; one captured twice
    by mistake has a twin where others have none.
    """
    number = (similar | similar.T).sum(axis=0)
    if bool((number == number[0]).all()):
        return None
    image = int(np.argmax(number > number.min()))
    first, second = np.argwhere((similar | similar.T)[image])[0][0], image
    return int(min(first, second)), int(max(first, second))


def _differences(light: FloatArray, mask: BoolArray) -> tuple[NDArray[np.float64], NDArray[np.float64], int]:
    """Mean square of each difference of two images, less their means (N, N); its largest covariance with itself, moved
    (N, N); pixels: on rows spread over the image.
    """
    height, width = light.shape[1:3]
    rows = np.unique(np.linspace(0, max(height - 3, 0), min(height, max(2, 60_000 // width))).astype(int))
    change = light.mean(axis=-1, dtype=np.float64)
    change -= change.mean(axis=0)
    change *= mask
    here = change[:, rows]
    covariance = np.zeros((len(light), len(light)))
    for down, right in ((0, 1), (1, 0), (1, 1), (0, 2), (2, 0), (2, 2)):
        there = change[:, np.minimum(rows + down, height - 1)][:, :, np.minimum(np.arange(width) + right, width - 1)]
        covariance = np.maximum(covariance, np.abs(difference_products(here, there)))
    return difference_products(here, here), covariance, here[0].size


def difference_products(here: NDArray[np.float64], there: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean of (here_i - here_j) (there_i - there_j) for all pairs of images (N, N)."""
    product = here.reshape(len(here), -1) @ there.reshape(len(there), -1).T
    own = np.diag(product)
    return np.asarray((own[:, None] + own[None, :] - product - product.T) / here[0].size)
