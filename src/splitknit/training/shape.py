"""Training of the network that mends the shape: the public names of the parts.

Where a finger turns away, ridges that nobody resolves and glare at grazing angles bend the shape that all bands agree
on (:mod:`splitknit.skin.learned`); the network learns on simulated fingers which slopes are missing. Arrays
in, arrays and bytes out; what reads and writes files is ``splitknit train shape``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from splitknit.errors import require
from splitknit.model import FloatArray
from splitknit.training.fields_loop import FieldsTrainer
from splitknit.training.fields_pack import packed_fields
from splitknit.training.fields_settings import FieldsSettings
from splitknit.training.network import load_torch
from splitknit.training.relief_network import network_from, relief_network
from splitknit.training.samples import TRIES, Sample, check_channels, one_scale, too_little_skin
from splitknit.training.turns import Turns, cut_out

__all__ = [
    "CHANNELS",
    "FIELDS",
    "JUDGED_WIDE_PX",
    "NAME",
    "OUTPUTS",
    "PARTS",
    "SLOPES",
    "TURNS",
    "WEIGHT",
    "Sample",
    "ShapeSettings",
    "ShapeTrainer",
    "draw_batch",
    "judge_whole",
    "judged",
    "network_from",
    "packed",
    "relief_network",
    "shape_losses",
    "without_nir",
]

NAME = "shape"
WHAT = (
    "slopes that a finger's shape lacks: the fields of splitknit.skin.learned on the coarse grid to slopes "
    "along x and y in units of 0.1"
)


def packed(state: Mapping[str, Any], facts: Mapping[str, Any], name: str = NAME) -> tuple[bytes, bytes]:
    """The files of a finished network: ONNX, its weights in half precision, and card; see :func:`packed_fields`."""
    return packed_fields(state, facts, name, WHAT)


# The training of the network that mends the shape.


class ShapeTrainer(FieldsTrainer):
    """The network of the shape in training."""

    def __init__(self, settings: ShapeSettings, samples: Sequence[Sample]) -> None:
        """Draw the first weights from the settings' seed, and the fields' scale from the samples."""
        check_samples(samples)
        super().__init__(settings, OUTPUTS, field_scale(samples, settings), settings.weight_decay)
        self.settings, self.samples = settings, samples

    def draw(self, iteration: int) -> FloatArray:
        """See :func:`splitknit.training.shape.draw_batch`."""
        return draw_batch(self.samples, self.settings, iteration)

    def losses(self, made: Any, batch: Any) -> dict[str, Any]:
        """See :func:`splitknit.training.shape.shape_losses`."""
        return shape_losses(made, batch, self.settings.wide_px)

    def total(self, parts: dict[str, Any]) -> Any:
        """The weighted sum of the parts."""
        return parts["slope"] + self.settings.wide_share * parts["wide"]

    def judge(self, sample: Sample) -> dict[str, float]:
        """What the network makes of a finger, see :func:`splitknit.training.shape.judged`."""
        return judge_whole(self.run, sample, self.settings.stride)


# Loss of the shape network, and how it is evaluated.

PARTS = ("slope", "wide")
LEAST_SHARE = 0.05
"""Blocks with little weight count for less than that weight."""
JUDGED_WIDE_PX = 17
"""Side of the squares over which slopes are averaged to judge what becomes the shape's error."""


def shape_losses(made: Any, batch: Any, wide_px: int) -> dict[str, Any]:
    """The parts of the loss, each a mean over the pixels that count.

    Parameters
    ----------
    made : (B, 2, h, w) torch.Tensor
        The slopes that the network drew.
    batch : (B, 35, h, w) torch.Tensor
        Samples, see :mod:`splitknit.training.shape`.
    wide_px : side of the blocks of ``wide``

    Returns
    -------
    dict of torch scalars by the names of :data:`PARTS`:
    ``slope``, the mean square of the error (both slopes together); ``wide``, that of its means over blocks: what is
    wrong over many pixels adds up when slopes are integrated, what changes from pixel to pixel does not.
    """
    pooled = load_torch().nn.functional.avg_pool2d
    weight = batch[:, WEIGHT : WEIGHT + 1]
    error = made - batch[:, SLOPES]
    count = weight.sum() + 1.0
    means = pooled(error * weight, wide_px) ** 2 / (pooled(weight, wide_px) + LEAST_SHARE)
    return {"slope": (error**2 * weight).sum() / count, "wide": means.sum() * wide_px**2 / count}


def judge_whole(run: Callable[[FloatArray], FloatArray], sample: Sample, stride: int) -> dict[str, float]:
    """Figures of :func:`judged` for a finger, as `run` turns its fields (32, h, w) into (2, h, w).

    The last rows and columns are left out where the sides are no multiples of `stride`.
    """
    rows, columns = (length // stride * stride for length in sample.shape[1:])
    require(
        min(rows, columns) > 0, f"a finger of {sample.shape[1]} x {sample.shape[2]} pixels is too small to be judged."
    )
    seen = np.asarray(sample[:, :rows, :columns], dtype=np.float32)
    return judged(run(seen[:FIELDS]), seen)


def judged(made: FloatArray, sample: FloatArray) -> dict[str, float]:
    """Figures of the drawn slopes (2, h, w) against the truth in a sample (35, h, w), in the network's unit.

    Returns
    -------
    dict of
    ``before`` and ``after``, the shape's slope error (rms of one slope, weighted) without and with what was drawn;
    ``wide_before`` and ``wide_after``, the same of means over squares of 17 pixels. NaN where there is no skin.
    """
    weight = np.asarray(sample[WEIGHT], dtype=np.float64)
    wanted = np.asarray(sample[SLOPES], dtype=np.float64)
    found: dict[str, float] = {}
    for name, error in (("before", wanted), ("after", wanted - made)):
        found[name] = _rms(error, weight)
        share = np.maximum(_mean(weight), LEAST_SHARE)
        found[f"wide_{name}"] = _rms(np.stack([_mean(part * weight) / share for part in error]), weight)
    return found


def _rms(error: Any, weight: Any) -> float:
    total = float(weight.sum())
    return math.sqrt(float((error**2 * weight).sum()) / total / 2) if total > 0 else math.nan


def _mean(field: Any) -> Any:
    return cv2.blur(field, (JUDGED_WIDE_PX, JUDGED_WIDE_PX), borderType=cv2.BORDER_CONSTANT)


# Patches of simulated fingers for the network that mends the shape: cut, turned in all eight ways, and stacked.
#
# A *sample* is one finger on the coarse grid: what the network is given, the slopes that it shall add, and where they
# count, as one array of (35, h, w).

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


# Settings of the training of the network that mends the shape.


@dataclass(frozen=True, slots=True)
class ShapeSettings(FieldsSettings):
    """Network, loss and training.

    The network that ships was trained in three runs of 957, 2623 and 2354 iterations, each from the weights of the one
    before, while its fingers became ready. The defaults are its numbers, the iterations rounded, in one run.
    """

    widths: tuple[int, ...] = (24, 32, 48, 64)
    """Channels of each level; every level but the first works at half the scale of the one before."""
    iterations: int = 6000
    """Corrections of the weights."""
    batch: int = 8
    """Patches of each."""
    patch_px: int = 160
    """Side of a patch on the coarse grid; a multiple of the network's stride."""
    least_trust: float = 0.15
    """Patches whose mean weight is less are not used: they hold next to no skin."""
    warm_up: int = 100
    """Iterations over which the learning rate rises; then it falls along a cosine."""
    weight_decay: float = 1e-3
    """By which weights shrink, times the learning rate."""
    beyond_px: int = 20
    """So far a patch may reach over a finger's edge: there the shape has most to mend."""
    no_nir_share: float = 0.15
    """Part of the patches that are shown as if there were no near-infrared images."""
    wide_px: int = 8
    """Side of the blocks over which the loss also compares mean slopes: wide errors become the shape's."""
    wide_share: float = 1.0
    """Weight of those means in the loss, beside the slopes with weight one."""

    def __post_init__(self) -> None:
        FieldsSettings.__post_init__(self)
        self._check_shares("no_nir_share")
        self._check_weights("weight_decay", "wide_share")
        require(
            0 <= self.beyond_px < self.patch_px,
            f"training: patch_px must be larger than beyond_px ({self.beyond_px}), but it is {self.patch_px}.",
        )
        require(
            1 <= self.wide_px <= self.patch_px,
            f"training: wide_px must lie between 1 and {self.patch_px}, but it is {self.wide_px}.",
        )
