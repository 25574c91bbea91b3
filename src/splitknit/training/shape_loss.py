"""What the network that mends the shape is punished for, and how it is judged."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

from splitknit.errors import require
from splitknit.model import FloatArray
from splitknit.training.network import load_torch
from splitknit.training.samples import Sample
from splitknit.training.shape_batches import FIELDS, SLOPES, WEIGHT

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
        Samples, see :mod:`splitknit.training.shape_batches`.
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
