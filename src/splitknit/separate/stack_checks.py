"""Whether a stack can hold what its patterns are to show: pixels that change, and no pattern twice."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitknit.check import BadInput, require
from splitknit.separate.stacks import DEFAULTS, StackSettings, percent, thinned
from splitknit.types import BoolArray, FloatArray


def check_contrast(
    low: FloatArray, high: FloatArray, mask: BoolArray, settings: StackSettings, words: tuple[str, str]
) -> None:
    """Refuse a stack in which too many bright pixels do not change.

    Parameters
    ----------
    low, high : (H, W, C)
        Least and greatest light.
    words : what they have never been, and the remedy

    Raises
    ------
    BadInput
        Naming their share and where the first of them is.
    """
    dark, bright = low.max(axis=-1), high.max(axis=-1)
    looked_at = mask & (bright > settings.lit_level * float(np.quantile(thinned(bright, mask), 0.999)))
    constant = looked_at & (bright - dark <= settings.least_contrast * bright)
    share = float(constant.sum()) / max(1.0, float(looked_at.sum()))
    if share <= settings.constant_share:
        return
    row, column = np.argwhere(constant)[0]
    raise BadInput(
        f"{percent(share)} of the bright pixels were {words[0]} (first at row {row}, column {column}): they change "
        f"by less than {100 * settings.least_contrast:g} % from image to image; {words[1]}."
    )


def check_repeats(
    light: FloatArray,
    mask: BoolArray,
    settings: StackSettings = DEFAULTS,
    expected: NDArray[np.float64] | None = None,
    name: str = "image",
) -> None:
    """Refuse a stack in which two images show the same pattern: a repeated shift, and so a missing one.

    Two images of one pattern differ by noise alone. Noise of neighbouring pixels is independent, patterns are wider
    than a pixel: the covariance of the difference with its neighbour tells them apart in noisy images too.

    Parameters
    ----------
    light : (N, H, W, C)
    mask : (H, W)
    expected : (N, N), optional
        How much the patterns themselves differ (any unit); all alike where None.

    Raises
    ------
    BadInput
        Naming the two images.
    """
    power = _difference_power(light, mask)
    pairs = np.triu_indices(len(light), 1)
    relative = power[pairs] if expected is None else power[pairs] / np.maximum(expected[pairs], 1e-6)
    limit = settings.repeat if expected is None else 0.2
    level = float(np.mean(np.square(light.mean(axis=0, dtype=np.float64)[mask])))
    reference = float(np.median(relative))
    require(
        reference > max(1e-10 * level, -3.0 * float(relative.min())),
        f"the {name}s differ by noise at most: the patterns never light the scene; check the projector, or whether "
        f"the direct light is too weak to be seen.",
    )
    worst = int(np.argmin(relative))
    require(
        bool(relative[worst] > limit * reference),
        f"{name}s {pairs[0][worst]} and {pairs[1][worst]} show the same pattern: a shift is repeated, and another one "
        f"may be missing; capture the stack again or remove one of them.",
    )


def _difference_power(light: FloatArray, mask: BoolArray, pixels: int = 60_000) -> NDArray[np.float64]:
    """Mean product of each difference of two images with its neighbour on the right or below, the larger: (N, N)."""
    height, width = light.shape[1:3]
    rows = np.unique(np.linspace(0, max(height - 2, 0), min(max(height - 1, 1), max(2, pixels // width))).astype(int))
    below = np.minimum(rows + 1, height - 1)
    right = np.minimum(np.arange(width) + 1, width - 1)
    change = light.mean(axis=-1, dtype=np.float64)
    change -= change.mean(axis=0)
    change *= mask
    here = change[:, rows]
    result = np.full((len(light), len(light)), -np.inf)
    for there in (here[:, :, right], change[:, below]):
        product = here.reshape(len(light), -1) @ there.reshape(len(light), -1).T
        own = np.diag(product)
        result = np.maximum(result, own[:, None] + own[None, :] - product - product.T)
    return np.asarray(result / here[0].size)
