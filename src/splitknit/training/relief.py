"""Training of `metric`'s own network, which draws relief and glare: the public names of the parts.

What photometric stereo leaves of skin's light is taken apart by how it turns with the light's azimuth
(:mod:`splitknit.skin.learned`); the network learns on simulated fingers what of it is relief and what is glare.
Arrays in, arrays and bytes out; what reads and writes files is ``splitknit train relief``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from splitknit.errors import require
from splitknit.model import FloatArray
from splitknit.training.fields_loop import FieldsTrainer
from splitknit.training.fields_pack import packed_fields
from splitknit.training.relief_batches import (
    CHANNELS,
    FIELDS,
    GLARE,
    OUTPUTS,
    RELIEF,
    WEIGHT,
    check_samples,
    draw_batch,
    field_scale,
    mirrored,
    transposed,
    turned_by,
)
from splitknit.training.relief_network import network_from, relief_network
from splitknit.training.relief_settings import ReliefSettings
from splitknit.training.samples import Sample

__all__ = [
    "CHANNELS",
    "FIELDS",
    "GLARE",
    "JUDGED_PX",
    "NAME",
    "OUTPUTS",
    "RELIEF",
    "WEIGHT",
    "ReliefSettings",
    "ReliefTrainer",
    "Sample",
    "draw_batch",
    "judge_middle",
    "judged",
    "mirrored",
    "network_from",
    "packed",
    "relief_losses",
    "relief_network",
    "total_loss",
    "transposed",
    "turned_by",
]

NAME = "relief"
WHAT = (
    "relief and glare of skin: the fields of splitknit.skin.learned to the relief in 0.02 mm, seven "
    "waves of the glare over the light's azimuth in 0.05 of the green level, and the logarithm of the relief's "
    "variance"
)


def packed(state: Mapping[str, Any], facts: Mapping[str, Any], name: str = NAME) -> tuple[bytes, bytes]:
    """The files of a finished network: ONNX, its weights in half precision, and card; see :func:`packed_fields`."""
    return packed_fields(state, facts, name, WHAT)


# The training of the relief's network, and how it is judged.

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
        """See :func:`splitknit.training.relief.relief_losses`."""
        return relief_losses(made, batch)

    def total(self, parts: dict[str, Any]) -> Any:
        """See :func:`splitknit.training.relief.total_loss`."""
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


# Loss of the relief network.

PARTS = ("relief", "slope", "likelihood", "glare")
VARIANCE_LIMITS = (-6.0, 4.0)
"""Of the logarithm of the relief's variance, in the network's unit."""


def relief_losses(made: Any, batch: Any) -> dict[str, Any]:
    """The parts of the loss, each a mean over the pixels that count.

    Parameters
    ----------
    made : (B, 9, h, w) torch.Tensor
        What the network drew.
    batch : (B, 41, h, w) torch.Tensor
        Samples, see :mod:`splitknit.training.relief_batches`.

    Returns
    -------
    dict of torch scalars by the names of :data:`PARTS`:
    ``relief``, the mean squared error of the heights; ``slope``, that of their differences from pixel to pixel, where
    ridges outweigh what is wide; ``likelihood``, the negative logarithm of the likelihood of the error under the drawn
    variance (the error is taken as given here, so that no height is made worse for it); ``glare``, the mean squared
    error of its waves.
    """
    weight = batch[:, WEIGHT]
    count = weight.sum() + 1.0
    error = made[:, 0] - batch[:, RELIEF]
    along = (error[:, :, 1:] - error[:, :, :-1]) * weight[:, :, 1:]
    down = (error[:, 1:] - error[:, :-1]) * weight[:, 1:]
    logarithm = made[:, 8].clamp(*VARIANCE_LIMITS)
    glare = made[:, 1:8] - batch[:, GLARE]
    return {
        "relief": (error**2 * weight).sum() / count,
        "slope": ((along**2).sum() + (down**2).sum()) / count,
        "likelihood": ((error.detach() ** 2 * (-logarithm).exp() + logarithm) * weight).sum() / count,
        "glare": (glare**2 * weight[:, None]).sum() / count / glare.shape[1],
    }


def total_loss(parts: dict[str, Any], settings: ReliefSettings) -> Any:
    """The weighted sum of the parts."""
    return (
        parts["relief"]
        + settings.slope_share * parts["slope"]
        + settings.likelihood_share * parts["likelihood"]
        + settings.glare_share * parts["glare"]
    )
