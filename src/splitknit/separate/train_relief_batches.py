"""Patches of simulated fingers for the relief's network: cut, turned in all eight ways, and stacked.

A *sample* is one finger: what the network is given, what it shall draw, and where that counts, as one array of
(41, h, w). The network's input knows no rig and no azimuth but those of the image, so that a finger and its mirror
image are equally likely; when an image is turned, vectors and waves of the light's azimuth turn with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.check import BadInput, require
from splitknit.separate.train_relief_settings import ReliefSettings
from splitknit.types import FloatArray

FIELDS = 32
"""Fields that the network is given, the first of a sample."""
RELIEF = 32
"""Number of the relief in a sample, in the network's unit."""
GLARE = slice(33, 40)
"""The glare in a sample, in the network's unit: its mean over the light's azimuth a, cos a, sin a, ..., sin 3a."""
WEIGHT = 40
"""Number of the weight in a sample, in [0, 1]."""
CHANNELS = 41
OUTPUTS = 9
"""Of the network: the relief, seven waves of the glare, the logarithm of the relief's variance."""

VECTORS = ((3, 4), (5, 6), (7, 8), (21, 22), (34, 35))
"""Pairs of fields that are a vector's x and y (up), or cos a and sin a of its azimuth."""
SECOND_WAVES = ((9, 10), (13, 14), (17, 18), (36, 37))
"""Pairs of fields that are parts of cos 2a and sin 2a."""
THIRD_WAVES = ((11, 12), (15, 16), (19, 20), (38, 39))
"""Pairs of fields that are parts of cos 3a and sin 3a."""

Sample = NDArray[np.floating[Any]]
"""(41, h, w), any float type."""

_TRIES = 2000
_KEEP_SCALE = 0.02
_SCALE_PATCHES = 12


def mirrored(sample: FloatArray) -> FloatArray:
    """Swap left and right: x becomes -x, an azimuth a becomes pi - a."""
    turned: FloatArray = np.array(sample[:, :, ::-1], dtype=np.float32)
    for x, _ in VECTORS:
        turned[x] *= -1
    for _, sine in SECOND_WAVES:
        turned[sine] *= -1
    for cosine, _ in THIRD_WAVES:
        turned[cosine] *= -1
    return turned


def transposed(sample: FloatArray) -> FloatArray:
    """Swap rows and columns: (x, y) becomes (-y, -x), for y points up against the rows; a becomes 3 pi / 2 - a."""
    old = np.asarray(sample.swapaxes(1, 2), dtype=np.float32)
    turned = old.copy()
    for x, y in VECTORS:
        turned[x], turned[y] = -old[y], -old[x]
    for cosine, _ in SECOND_WAVES:
        turned[cosine] *= -1
    for cosine, sine in THIRD_WAVES:
        turned[cosine], turned[sine] = old[sine], old[cosine]
    return turned


def turned_by(sample: FloatArray, way: int) -> FloatArray:
    """One of the eight ways (0 to 7) to lay down a square."""
    if way & 1:
        sample = mirrored(sample)
    if way & 2:
        sample = transposed(mirrored(transposed(sample)))  # top and bottom swapped
    return transposed(sample) if way & 4 else sample


def draw_patch(
    samples: Sequence[Sample], settings: ReliefSettings, rng: np.random.Generator, whole: Sequence[Sample] = ()
) -> FloatArray:
    """Cut a patch (41, side, side) anywhere in any sample, as it is; zero where a sample is smaller.

    Where there are whole fingers, a fixed share of the patches is from them.

    Raises
    ------
    BadInput
        If patches with enough skin cannot be found.
    """
    side = settings.patch_px
    for _ in range(_TRIES):
        pool = whole if len(whole) > 0 and rng.random() < settings.whole_share else samples
        sample = pool[int(rng.integers(len(pool)))]
        row, column = (int(rng.integers(max(1, length - side))) for length in sample.shape[1:])
        patch = np.asarray(sample[:, row : row + side, column : column + side], dtype=np.float32)
        missing = [(0, side - length) for length in patch.shape[1:]]
        if any(after for _, after in missing):
            patch = np.pad(patch, ((0, 0), *missing))
        if patch[WEIGHT].mean() >= settings.least_trust:
            return patch
    raise BadInput(
        f"hardly any patch of {side} pixels holds enough skin to train on; take smaller patches or a lower least_trust."
    )


def draw_batch(
    samples: Sequence[Sample], settings: ReliefSettings, iteration: int, whole: Sequence[Sample] = ()
) -> FloatArray:
    """The patches (batch, 41, side, side) of one iteration; they follow from its number and the settings' seed."""
    rng = np.random.default_rng(np.random.SeedSequence([settings.seed, 0xBE, iteration]))
    return np.stack(
        [turned_by(draw_patch(samples, settings, rng, whole), int(rng.integers(8))) for _ in range(settings.batch)]
    )


def field_scale(samples: Sequence[Sample], settings: ReliefSettings, whole: Sequence[Sample] = ()) -> FloatArray:
    """(32,) factors that bring the fields to about one scale: one over their standard deviation in a few patches."""
    rng = np.random.default_rng(np.random.SeedSequence([settings.seed, 0x5C]))
    patches = np.stack([draw_patch(samples, settings, rng, whole)[:FIELDS] for _ in range(_SCALE_PATCHES)])
    return np.asarray(1.0 / np.maximum(patches.std(axis=(0, 2, 3)), _KEEP_SCALE), dtype=np.float32)


def check_samples(samples: Sequence[Sample]) -> None:
    """Refuse samples of another shape.

    Raises
    ------
    BadInput
        If there are none, or one is not (41, h, w).
    """
    require(len(samples) > 0, "there are no fingers to train on.")
    for sample in samples:
        require(
            sample.ndim == 3 and sample.shape[0] == CHANNELS and min(sample.shape) > 0,
            f"a finger to train on must have the shape ({CHANNELS}, h, w), but one has {sample.shape}.",
        )
