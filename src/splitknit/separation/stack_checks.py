"""Whether a stack can hold what its patterns are to show: pixels that change, and no pattern twice."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, require
from splitknit.model import BoolArray, FloatArray
from splitknit.separation.stacks import DEFAULTS, LIT_LEVEL, MIN_CONTRAST, StackSettings, percent, thinned


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
    looked_at = mask & (bright > LIT_LEVEL * float(np.quantile(thinned(bright, mask), 0.999)))
    constant = looked_at & (bright - dark <= MIN_CONTRAST * bright)
    share = float(constant.sum()) / max(1.0, float(looked_at.sum()))
    if share <= settings.constant_share:
        return
    row, column = np.argwhere(constant)[0]
    raise BadInput(
        f"{percent(share)} of the bright pixels were {words[0]} (first at row {row}, column {column}): they change "
        f"by less than {100 * MIN_CONTRAST:g} % from image to image; {words[1]}."
    )


def check_repeats(
    light: FloatArray,
    mask: BoolArray,
    settings: StackSettings = DEFAULTS,
    expected: NDArray[np.float64] | None = None,
    name: str = "image",
) -> None:
    """Refuse a stack in which two images show the same pattern: a repeated shift, and so a missing one.

    Two images of one pattern differ by noise alone. Noise is independent from pixel to pixel, patterns are not: the
    covariance of the difference with itself, moved by a pixel or two, tells them apart in noisy images too.

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
    power, covariance, count = _differences(light, mask)
    pairs = np.triu_indices(len(light), 1)
    relative = covariance[pairs] if expected is None else covariance[pairs] / np.maximum(expected[pairs], 1e-6)
    limit = settings.repeat if expected is None else 0.2
    level = float(np.mean(np.square(light.mean(axis=0, dtype=np.float64)[mask])))
    reference = float(np.median(relative))
    require(
        float(np.median(covariance[pairs])) > max(1e-10 * level, 3.0 / np.sqrt(count) * float(np.median(power[pairs]))),
        f"the {name}s differ by noise at most: the patterns never light the scene; check the projector, or whether "
        f"the direct light is too weak to be seen.",
    )
    alike = np.zeros(covariance.shape, dtype=np.bool_)
    alike[pairs] = relative <= limit * reference
    twins = odd_twins(alike)
    if twins is not None:
        raise BadInput(
            f"{name}s {twins[0]} and {twins[1]} show the same pattern: a shift is repeated, and another one may be "
            f"missing; capture the stack again or remove one of them."
        )


def odd_twins(alike: BoolArray) -> tuple[int, int] | None:
    """Return the first pair that is `alike` (N, N, upper triangle), or None if all have as many twins.

    A checkerboard moved by one check each way is the same again, so that in a full grid of an even number of shifts
    every image has a twin. One that was captured twice by mistake has a twin where others have none.
    """
    number = (alike | alike.T).sum(axis=0)
    if bool((number == number[0]).all()):
        return None
    image = int(np.argmax(number > number.min()))
    first, second = np.argwhere((alike | alike.T)[image])[0][0], image
    return int(min(first, second)), int(max(first, second))


def _differences(
    light: FloatArray, mask: BoolArray, pixels: int = 60_000
) -> tuple[NDArray[np.float64], NDArray[np.float64], int]:
    """Mean square of each difference of two images (N, N); its largest covariance with itself, moved (N, N); pixels.

    On rows that are spread over the image, relative to the mean of all images.
    """
    height, width = light.shape[1:3]
    rows = np.unique(np.linspace(0, max(height - 3, 0), min(height, max(2, pixels // width))).astype(int))
    change = light.mean(axis=-1, dtype=np.float64)
    change -= change.mean(axis=0)
    change *= mask
    here = change[:, rows]
    covariance = np.zeros((len(light), len(light)))
    for down, right in ((0, 1), (1, 0), (1, 1), (0, 2), (2, 0), (2, 2)):
        there = change[:, np.minimum(rows + down, height - 1)][:, :, np.minimum(np.arange(width) + right, width - 1)]
        covariance = np.maximum(covariance, np.abs(_of_differences(here, there)))
    return _of_differences(here, here), covariance, here[0].size


def _of_differences(here: NDArray[np.float64], there: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean of (here_i - here_j) (there_i - there_j) for all pairs of images (N, N)."""
    product = here.reshape(len(here), -1) @ there.reshape(len(there), -1).T
    own = np.diag(product)
    return np.asarray((own[:, None] + own[None, :] - product - product.T) / here[0].size)
