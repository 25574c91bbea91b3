"""Training of the shape network, which estimates the residual slopes of the shape in the `metric` method.

Where a finger turns away, ridges that are not resolved and specular reflection at grazing angles bend the shape that
all bands agree on (:mod:`splitknit.skin.learned`); the network learns on simulated fingers which slopes are missing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, Any

import cv2
import numpy as np

from splitknit import SHAPE_SLOPE, SHAPE_SYMMETRY, FloatArray, Limits, require
from splitknit_simulator.training.fields import FIELDS, FieldsSettings, FieldsTask, Run, Sample
from splitknit_simulator.training.networks import load_torch
from splitknit_simulator.training.shape_data import shape_sample
from splitknit_simulator.training.trainer import NetworkKind, files_of

NETWORK = NetworkKind(
    "shape",
    "slopes that a finger's shape lacks: the fields of splitknit.skin.learned on the coarse grid to slopes "
    "along x and y in units of 0.1",
    (FIELDS, 2),
)
FILES = files_of(NETWORK.name, "fingers")
PARTS = ("slope", "wide")
SLOPES = slice(32, 34)  # the residual slopes along x and y (up), in the network's unit
WEIGHT = 34  # number of the weight in a sample, in [0, 1]
CHANNELS = 35
SYMMETRY = replace(SHAPE_SYMMETRY, vectors=(*SHAPE_SYMMETRY.vectors, (32, 33)))  # symmetry of a sample
OF_NIR = (6, 7, 11, 16, 17, 18, 19, 29, 30)  # fields that are zero without near-infrared images
JUDGED_WIDE_PX = 17  # side of the squares over which slopes are averaged: wide errors become the shape's
UNIT = float(SHAPE_SLOPE)  # unit of the network's slopes
_WIDE_PX = 8  # side of the blocks over which the loss also compares mean slopes: wide errors become the shape's
_MIN_TRUST = 0.05  # blocks with little weight count for less than that weight


@dataclass(frozen=True, slots=True)
class ShapeNetSettings(FieldsSettings):
    """Network, loss and training.

    The network that ships was trained in three runs of 957, 2623 and 2354 iterations, each from the weights of the one
    before, while its fingers became ready. The defaults are its numbers, the iterations rounded, in one run.
    """

    widths: Annotated[tuple[int, ...], Limits(1)] = (24, 32, 48, 64, 64)
    """Channels of each level; every level but the first works at half the scale of the one before."""
    iterations: Annotated[int, Limits(1, 10_000_000)] = 6000
    """Corrections of the weights."""
    batch: Annotated[int, Limits(1, 4096)] = 8
    """Patches of each."""
    patch_px: Annotated[int, Limits(1, 2048)] = 160
    """Side of a patch on the coarse grid; a multiple of the network's stride."""
    warm_up: Annotated[int, Limits(1, 10_000_000)] = 100
    """Iterations over which the learning rate rises; then it falls along a cosine."""
    weight_decay: Annotated[float, Limits(0)] = 1e-3
    """By which weights shrink, times the learning rate."""
    beyond_px: Annotated[int, Limits(0)] = 20
    """How far a patch may reach over a finger's edge, where the shape errs most."""
    no_nir_share: Annotated[float, Limits(0, 1, below=True)] = 0.15
    """Fraction of the patches without near-infrared fields; below 1."""
    wide_share: Annotated[float, Limits(0)] = 1.0
    """Weight of the mean slopes of blocks in the loss, beside the slopes with weight one."""

    def __post_init__(self) -> None:
        FieldsSettings.__post_init__(self)
        require(
            max(self.beyond_px + 1, _WIDE_PX) <= self.patch_px,
            f"training.patch_px must be larger than beyond_px ({self.beyond_px}) and {_WIDE_PX - 1}, "
            f"but it is {self.patch_px}.",
        )

    @property
    def loss_weights(self) -> dict[str, float]:
        """Weights of the loss's parts in their sum."""
        return {"slope": 1.0, "wide": self.wide_share}


def _shape_losses(made: Any, batch: Any, wide_px: int = _WIDE_PX) -> dict[str, Any]:
    """Losses of the slopes `made` (B, 2, h, w), means over the pixels that count: ``slope``, squared error; ``wide``,
    of its means over blocks of `wide_px`, as integration adds up what is wrong over many pixels.
    """
    pooled = load_torch().nn.functional.avg_pool2d
    weight = batch[:, WEIGHT : WEIGHT + 1]
    error = made - batch[:, SLOPES]
    count = weight.sum() + 1.0
    means = pooled(error * weight, wide_px) ** 2 / (pooled(weight, wide_px) + _MIN_TRUST)
    return {"slope": (error**2 * weight).sum() / count, "wide": means.sum() * wide_px**2 / count}


def _judge_whole(run: Run, sample: Sample, stride: int) -> dict[str, float]:
    """Figures of :func:`_judged`, without last rows and columns where the sides are no multiples of `stride`."""
    rows, columns = (length // stride * stride for length in sample.shape[1:])
    seen = np.asarray(sample[:, :rows, :columns], dtype=np.float32)
    return _judged(run(seen[:FIELDS]), seen)


def _judged(made: FloatArray, sample: FloatArray) -> dict[str, float]:
    """Figures of slopes (2, h, w) against a sample (35, h, w), network's unit; NaN without skin: weighted rms slope
    error without and with them, ``before`` and ``after``, and of means over squares of 17 pixels, ``wide_before`` and
    ``wide_after``.
    """
    weight = np.asarray(sample[WEIGHT], dtype=np.float64)
    wanted = np.asarray(sample[SLOPES], dtype=np.float64)
    found: dict[str, float] = {}
    for name, error in (("before", wanted), ("after", wanted - made)):
        found[name] = _rms(error, weight)
        fraction = np.maximum(_mean(weight), _MIN_TRUST)
        found[f"wide_{name}"] = _rms(np.stack([_mean(part * weight) / fraction for part in error]), weight)
    return found


def _rms(error: Any, weight: Any) -> float:
    total = float(weight.sum())
    return math.sqrt(float((error**2 * weight).sum()) / total / 2) if total > 0 else math.nan


def _mean(field: Any) -> Any:
    return cv2.blur(field, (JUDGED_WIDE_PX, JUDGED_WIDE_PX), borderType=cv2.BORDER_CONSTANT)


TASK = FieldsTask(
    kind=NETWORK,
    channels=CHANNELS,
    symmetry=SYMMETRY,
    losses=_shape_losses,
    judge=_judge_whole,
    in_units=lambda entry: {name: UNIT * value for name, value in entry.items()},
    held_out=": error of the shape's slopes (rms of one slope, steep parts count less) before and after mending, and "
    f"of their means over {JUDGED_WIDE_PX} x {JUDGED_WIDE_PX} pixels of the coarse grid",
    lines={
        "training": lambda entry: UNIT * math.sqrt(entry["slope"] / 2),  # of one slope
        "held out": lambda entry: UNIT * entry["held_out_after"],
        "held out, before": lambda entry: UNIT * entry["held_out_before"],
    },
    unit="error of a slope",
    min_weight=0.15,
    min_deviation=0.05,
    scale_patches=24,
    shoot=lambda kind, number, data: [shape_sample(number, data)],
    of_nir=OF_NIR,
)
