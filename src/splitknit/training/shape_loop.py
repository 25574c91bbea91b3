"""The training of the network that mends the shape."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from splitknit.model import FloatArray
from splitknit.training.fields_loop import FieldsTrainer
from splitknit.training.samples import Sample
from splitknit.training.shape_batches import OUTPUTS, check_samples, draw_batch, field_scale
from splitknit.training.shape_loss import judge_whole, shape_losses
from splitknit.training.shape_settings import ShapeSettings


class ShapeTrainer(FieldsTrainer):
    """The network of the shape in training."""

    def __init__(self, settings: ShapeSettings, samples: Sequence[Sample]) -> None:
        """Draw the first weights from the settings' seed, and the fields' scale from the samples."""
        check_samples(samples)
        super().__init__(settings, OUTPUTS, field_scale(samples, settings), settings.weight_decay)
        self.settings, self.samples = settings, samples

    def draw(self, iteration: int) -> FloatArray:
        """See :func:`splitknit.training.shape_batches.draw_batch`."""
        return draw_batch(self.samples, self.settings, iteration)

    def losses(self, made: Any, batch: Any) -> dict[str, Any]:
        """See :func:`splitknit.training.shape_loss.shape_losses`."""
        return shape_losses(made, batch, self.settings.wide_px)

    def total(self, parts: dict[str, Any]) -> Any:
        """The weighted sum of the parts."""
        return parts["slope"] + self.settings.wide_share * parts["wide"]

    def judge(self, sample: Sample) -> dict[str, float]:
        """What the network makes of a finger, see :func:`splitknit.training.shape_loss.judged`."""
        return judge_whole(self.run, sample, self.settings.stride)
