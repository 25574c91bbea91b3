"""Patches of simulated fingers for the network that mends the shape: cut, turned in all eight ways, and stacked.

A *sample* is one finger on the coarse grid: what the network is given, the slopes that it shall add, and where they
count, as one array of (35, h, w).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from splitknit.model import FloatArray
from splitknit.training.samples import TRIES, Sample, check_channels, one_scale, too_little_skin
from splitknit.training.shape_settings import ShapeSettings
from splitknit.training.turns import Turns, cut_out

FIELDS = 32
"""Fields that the network is given, the first of a sample."""
SLOPES = slice(32, 34)
"""The slopes along x and y (up) that the shape lacks, in the network's unit."""
WEIGHT = 34
"""Number of the weight in a sample, in [0, 1]."""
CHANNELS = 35
OUTPUTS = 2

TURNS = Turns(
    vectors=((0, 1), (2, 3), (4, 5), (6, 7), (20, 21), (32, 33)),
    second_waves=((12, 13), (16, 17), (24, 25)),
    third_waves=((14, 15), (18, 19)),
)
"""How a sample turns; where across the ridges is, is given by cosine and sine of twice its azimuth."""
OF_NIR = (6, 7, 11, 16, 17, 18, 19, 29, 30)
"""Fields that are zero without near-infrared images."""

_KEEP_SCALE = 0.05
_SCALE_PATCHES = 24


def draw_patch(samples: Sequence[Sample], settings: ShapeSettings, rng: np.random.Generator) -> FloatArray:
    """Cut a patch (35, side, side) anywhere in any sample, as it is; zero where it reaches over the sample.

    Raises
    ------
    BadInput
        If patches with enough skin cannot be found.
    """
    side, beyond = settings.patch_px, settings.beyond_px
    for _ in range(TRIES):
        sample = samples[int(rng.integers(len(samples)))]
        row, column = (
            int(rng.integers(-beyond, max(1 - beyond, length - side + beyond))) for length in sample.shape[1:]
        )
        patch = cut_out(sample, row, column, side)
        if patch[WEIGHT].mean() >= settings.least_trust:
            return patch
    raise too_little_skin(side)


def without_nir(patch: FloatArray) -> FloatArray:
    """The patch as it would be seen without near-infrared images."""
    blind: FloatArray = np.array(patch, dtype=np.float32)
    blind[list(OF_NIR)] = 0.0
    return blind


def draw_batch(samples: Sequence[Sample], settings: ShapeSettings, iteration: int) -> FloatArray:
    """The patches (batch, 35, side, side) of one iteration; they follow from its number and the settings' seed."""
    rng = np.random.default_rng(np.random.SeedSequence([settings.seed, 0xBE, iteration]))
    patches = []
    for _ in range(settings.batch):
        patch = TURNS.turned_by(draw_patch(samples, settings, rng), int(rng.integers(8)))
        patches.append(without_nir(patch) if rng.random() < settings.no_nir_share else patch)
    return np.stack(patches)


def field_scale(samples: Sequence[Sample], settings: ShapeSettings) -> FloatArray:
    """(32,) factors that bring the fields to about one scale: one over their standard deviation in a few patches."""
    rng = np.random.default_rng(np.random.SeedSequence([settings.seed, 0x5C]))
    patches = np.stack([draw_patch(samples, settings, rng)[:FIELDS] for _ in range(_SCALE_PATCHES)])
    return one_scale(patches, _KEEP_SCALE)


def check_samples(samples: Sequence[Sample]) -> None:
    """Refuse samples of another shape.

    Raises
    ------
    BadInput
        If there are none, or one is not (35, h, w).
    """
    check_channels(samples, CHANNELS)
