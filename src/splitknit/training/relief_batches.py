"""Patches of simulated fingers for the relief's network: cut, turned in all eight ways, and stacked.

A *sample* is one finger: what the network is given, what it shall draw, and where that counts, as one array of
(41, h, w). The network's input knows no rig and no azimuth but those of the image, so that a finger and its mirror
image are equally likely; when an image is turned, vectors and waves of the light's azimuth turn with it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from splitknit.model import FloatArray
from splitknit.training.relief_settings import ReliefSettings
from splitknit.training.samples import TRIES, Sample, check_channels, one_scale, too_little_skin
from splitknit.training.turns import Turns, cut_out

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

TURNS = Turns(
    vectors=((3, 4), (5, 6), (7, 8), (21, 22), (34, 35)),
    second_waves=((9, 10), (13, 14), (17, 18), (36, 37)),
    third_waves=((11, 12), (15, 16), (19, 20), (38, 39)),
)
"""How a sample turns."""
mirrored, transposed, turned_by = TURNS.mirrored, TURNS.transposed, TURNS.turned_by

_KEEP_SCALE = 0.02
_SCALE_PATCHES = 12


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
    for _ in range(TRIES):
        pool = whole if len(whole) > 0 and rng.random() < settings.whole_share else samples
        sample = pool[int(rng.integers(len(pool)))]
        row, column = (int(rng.integers(max(1, length - side))) for length in sample.shape[1:])
        patch = cut_out(sample, row, column, side)
        if patch[WEIGHT].mean() >= settings.least_trust:
            return patch
    raise too_little_skin(side)


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
    return one_scale(patches, _KEEP_SCALE)


def check_samples(samples: Sequence[Sample]) -> None:
    """Refuse samples of another shape.

    Raises
    ------
    BadInput
        If there are none, or one is not (41, h, w).
    """
    check_channels(samples, CHANNELS)
