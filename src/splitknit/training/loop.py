"""The training itself: Adam on the mean squared error, an epoch at a time, to be stopped and taken up again."""

from __future__ import annotations

import contextlib
import math
from dataclasses import asdict
from typing import Any

import numpy as np

from splitknit.errors import BadInput, require
from splitknit.model import FloatArray
from splitknit.training.batches import Batch, Patches
from splitknit.training.checkpoint import opened_state, packed_state
from splitknit.training.network import export_onnx, load_torch, unet
from splitknit.training.settings import MAY_CHANGE, TrainSettings


class Trainer:
    """A network in training.

    Repeatable on a processor: the same settings and data give the same weights, also when the training was interrupted
    between epochs, as long as the number of threads is the same.
    """

    def __init__(self, settings: TrainSettings) -> None:
        """Draw the first weights from the settings' seed."""
        torch = load_torch()
        require(
            settings.device != "cuda" or bool(torch.cuda.is_available()),
            "no GPU can be used by torch here; train with --device cpu.",
        )
        self.torch, self.settings = torch, settings
        self.device = torch.device(settings.device)
        torch.set_num_threads(settings.threads)
        torch.manual_seed(settings.seed)
        # channels last: convolutions of few channels run about twice as fast
        self.network = unet(settings).to(self.device, memory_format=torch.channels_last)
        self.optimiser = torch.optim.Adam(self.network.parameters(), lr=settings.learning_rate)
        self.epoch = 0
        """Epochs done."""
        self.curve: list[dict[str, float]] = []
        """One entry an epoch."""

    def train_epoch(self, patches: Patches, tick: Any = None) -> float:
        """Train on every patch once and return the mean loss; `tick(share)` hears of the progress."""
        settings = self.settings
        batches = math.ceil(len(patches) / settings.batch)
        self.network.train()
        total, count = 0.0, 0
        for number, batch in enumerate(patches.shuffled(settings, self.epoch)):
            share = (self.epoch + number / batches) / settings.epochs
            for group in self.optimiser.param_groups:
                group["lr"] = settings.learning_rate * learning_factor(share, settings.decay)
            loss = self._loss(batch)
            self.optimiser.zero_grad(set_to_none=True)
            loss.backward()
            self.optimiser.step()
            total += float(loss.detach()) * len(batch[0])
            count += len(batch[0])
            if tick is not None:
                tick(share)
        mean = total / count
        if not math.isfinite(mean):
            raise BadInput("the training diverged (its loss is no number); train with a lower learning rate.")
        self.epoch += 1
        return mean

    def loss_of(self, patches: Patches, enhanced: bool) -> float:
        """Mean squared error over all patches as they are, nothing dropped."""
        self.network.eval()
        total, count = 0.0, 0
        with self.torch.no_grad():
            for batch in patches.fixed(enhanced, self.settings.batch):
                total += float(self._loss(batch)) * len(batch[0])
                count += len(batch[0])
        return total / count

    def run(self, images: FloatArray) -> FloatArray:
        """(N, 3, H, W) through the network as it is, in single precision."""
        self.network.eval()
        with self.torch.no_grad():
            made = self.network(self._tensor(images))
        return np.asarray(made.float().cpu().numpy(), dtype=np.float32)

    def export(self) -> bytes:
        """Return the network as an ONNX file."""
        return export_onnx(self.network, 3, self.settings.stride)

    def state(self) -> bytes:
        """Everything that is needed to go on from here."""
        return packed_state(
            self.torch,
            {
                "settings": asdict(self.settings),
                "epoch": self.epoch,
                "curve": self.curve,
                "network": self.network.state_dict(),
                "optimiser": self.optimiser.state_dict(),
                "random": self.torch.get_rng_state(),
            },
        )

    def restore(self, state: bytes) -> None:
        """Go on from where `state` was taken.

        Raises
        ------
        BadInput
            If it is damaged or of a training with other settings.
        """
        document = opened_state(self.torch, state, self.device, asdict(self.settings), MAY_CHANGE)
        self.network.load_state_dict(document["network"])
        self.optimiser.load_state_dict(document["optimiser"])
        self.torch.set_rng_state(document["random"].cpu())
        self.epoch, self.curve = int(document["epoch"]), list(document["curve"])

    def _loss(self, batch: Batch) -> Any:
        inputs, targets = (self._tensor(part) for part in batch)
        with self._precision():
            made = self.network(inputs)
        error = made.float() - targets
        rim = self.settings.border_px
        if rim:
            error = error[:, :, rim:-rim, rim:-rim]
        return (error * error).mean()

    def _tensor(self, array: FloatArray) -> Any:
        tensor = self.torch.from_numpy(np.ascontiguousarray(array))
        return tensor.to(self.device, memory_format=self.torch.channels_last)

    def _precision(self) -> Any:
        if not self.settings.mixed:
            return contextlib.nullcontext()
        return self.torch.autocast(self.settings.device, dtype=self.torch.bfloat16)


def learning_factor(share: float, decay: float) -> float:
    """Learning rate, relative to its start, when `share` of the training is done: it falls over the last `decay`."""
    if decay <= 0 or share <= 1 - decay:
        return 1.0
    return 0.5 * (1.0 + math.cos(math.pi * min((share - 1 + decay) / decay, 1.0)))
