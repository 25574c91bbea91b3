"""The training of the relief's network, and how it is judged."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from splitknit.errors import require
from splitknit.model import FloatArray
from splitknit.training.fields_loop import FieldsTrainer
from splitknit.training.relief_batches import (
    FIELDS,
    GLARE,
    OUTPUTS,
    RELIEF,
    WEIGHT,
    check_samples,
    draw_batch,
    field_scale,
)
from splitknit.training.relief_loss import VARIANCE_LIMITS, relief_losses, total_loss
from splitknit.training.relief_settings import ReliefSettings
from splitknit.training.samples import Sample

JUDGED_PX = 512
"""Side of the middle part of a finger on which it is judged."""


class ReliefTrainer(FieldsTrainer):
    """The network of the relief in training."""

    def __init__(self, settings: ReliefSettings, samples: Sequence[Sample], whole: Sequence[Sample] = ()) -> None:
        """Draw the first weights from the settings' seed, and the fields' scale from the samples.

        A share of the patches, :attr:`ReliefSettings.whole_share`, is cut from the samples `whole`, if there are any.
        """
        check_samples(samples)
        if len(whole) > 0:
            check_samples(whole)
        super().__init__(settings, OUTPUTS, field_scale(samples, settings, whole))
        self.settings, self.samples, self.whole = settings, samples, whole

    def draw(self, iteration: int) -> FloatArray:
        """See :func:`splitknit.training.relief_batches.draw_batch`."""
        return draw_batch(self.samples, self.settings, iteration, self.whole)

    def losses(self, made: Any, batch: Any) -> dict[str, Any]:
        """See :func:`splitknit.training.relief_loss.relief_losses`."""
        return relief_losses(made, batch)

    def total(self, parts: dict[str, Any]) -> Any:
        """See :func:`splitknit.training.relief_loss.total_loss`."""
        return total_loss(parts, self.settings)

    def judge(self, sample: Sample) -> dict[str, float]:
        """What the network makes of the middle of a finger, see :func:`judged`."""
        return judge_middle(self.run, sample, self.settings.stride)


def judge_middle(run: Callable[[FloatArray], FloatArray], sample: Sample, stride: int) -> dict[str, float]:
    """Figures of :func:`judged` for the middle of a finger, as `run` turns its fields (32, h, w) into (9, h, w)."""
    limits = [min(JUDGED_PX, length // stride * stride) for length in sample.shape[1:]]
    require(min(limits) > 0, f"a finger of {sample.shape[1]} x {sample.shape[2]} pixels is too small to be judged.")
    first = [(length - side) // 2 for length, side in zip(sample.shape[1:], limits, strict=True)]
    rows, columns = (slice(start, start + side) for start, side in zip(first, limits, strict=True))
    middle = np.asarray(sample[:, rows, columns], dtype=np.float32)
    return judged(run(middle[:FIELDS]), middle)


def judged(made: FloatArray, sample: FloatArray) -> dict[str, float]:
    """Figures of what was drawn (9, h, w) against the truth in a sample (41, h, w), where the weight is above 1/2.

    Returns
    -------
    dict of
    ``correlation`` of the relief; ``gain``, the slope of drawn over true relief; ``rms``, its error in the network's
    unit; ``error_ratio``, that error over what the network expected of it (one is honest); ``glare_r2``, the part of
    the glare's power that is explained, all waves together. NaN where the sample holds no skin, or no glare.
    """
    counts = sample[WEIGHT] > 0.5
    if not counts.any():
        return dict.fromkeys(("correlation", "gain", "rms", "error_ratio", "glare_r2"), math.nan)
    drawn, truth = (np.asarray(field[counts], dtype=np.float64) for field in (made[0], sample[RELIEF]))
    power = float((truth**2).mean())
    square = float(((drawn - truth) ** 2).mean())
    expected = float(np.exp(np.clip(made[8][counts], *VARIANCE_LIMITS), dtype=np.float64).mean())
    spread = float(drawn.std() * truth.std())
    glare = np.asarray(sample[GLARE][:, counts], dtype=np.float64)
    missed = float(((made[1:8][:, counts] - glare) ** 2).mean())
    shone = float((glare**2).mean())
    product = float(((drawn - drawn.mean()) * (truth - truth.mean())).mean())
    return {
        "correlation": product / spread if spread > 0 else math.nan,
        "gain": float((drawn * truth).mean()) / power if power > 0 else math.nan,
        "rms": math.sqrt(square),
        "error_ratio": math.sqrt(square / expected),
        "glare_r2": 1.0 - missed / shone if shone > 0 else math.nan,
    }
