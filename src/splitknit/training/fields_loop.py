"""The training of `metric`'s networks: some iterations at a time, to be stopped and taken up again."""

from __future__ import annotations

import contextlib
import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import numpy as np

from splitknit.errors import BadInput, require
from splitknit.model import FloatArray
from splitknit.training.checkpoint import opened_state, packed_state
from splitknit.training.fields_settings import FieldsSettings
from splitknit.training.network import load_torch
from splitknit.training.relief_network import relief_network

FREE = ("threads", "device", "precision")
"""Settings of a training that may change on the way."""


class FieldsTrainer(ABC):
    """A network in training.

    Repeatable on a processor: the same settings and samples give the same weights, also when the training was
    interrupted, as long as the number of threads is the same.
    """

    def __init__(self, settings: FieldsSettings, outputs: int, scale: FloatArray, weight_decay: float = 0.0) -> None:
        """Draw the first weights from the settings' seed.

        Parameters
        ----------
        settings : FieldsSettings
        outputs : channels that the network draws
        scale : (n,) of each field, see :func:`splitknit.training.relief_network.relief_network`
        weight_decay : by which weights shrink, times the learning rate

        Raises
        ------
        BadInput
            If there is no such device.
        """
        torch = load_torch()
        require(
            settings.device != "cuda" or bool(torch.cuda.is_available()),
            "no GPU can be used by torch here; train with --device cpu.",
        )
        self.torch = torch
        self.device = torch.device(settings.device)
        self._common = settings
        torch.set_num_threads(settings.threads)
        torch.manual_seed(settings.seed)
        network = relief_network(settings.widths, len(scale), outputs)
        network.scale.copy_(torch.from_numpy(scale))
        # channels last: convolutions of few channels run about twice as fast
        self.network = network.to(self.device, memory_format=torch.channels_last)
        self.optimiser = torch.optim.AdamW(
            self.network.parameters(), lr=settings.learning_rate, weight_decay=weight_decay
        )
        self.iteration = 0
        """Iterations done."""
        self.curve: list[dict[str, float]] = []
        """Entries by whoever trains."""

    @abstractmethod
    def draw(self, iteration: int) -> FloatArray:
        """The patches (B, n, side, side) of one iteration; the network is given the first fields."""

    @abstractmethod
    def losses(self, made: Any, batch: Any) -> dict[str, Any]:
        """The parts of the loss of what the network made of a batch, torch scalars."""

    @abstractmethod
    def total(self, parts: dict[str, Any]) -> Any:
        """The weighted sum of the parts."""

    @abstractmethod
    def judge(self, sample: Any) -> dict[str, float]:
        """Figures of what the network as it is makes of a finger."""

    def train(self, iterations: int, tick: Callable[[float], None] | None = None) -> dict[str, float]:
        """Go on by so many iterations and return the mean of each part of the loss; `tick(share)` hears of it.

        Raises
        ------
        BadInput
            If the loss is no number any more.
        """
        settings = self._common
        fields = len(self.network.scale)
        self.network.train()
        totals: dict[str, float] = {}
        for _ in range(iterations):
            for group in self.optimiser.param_groups:
                group["lr"] = settings.rate(self.iteration)
            batch = self._tensor(self.draw(self.iteration))
            with self._precision():
                made = self.network(batch[:, :fields].contiguous(memory_format=self.torch.channels_last))
            parts = self.losses(made.float(), batch)
            self.optimiser.zero_grad(set_to_none=True)
            self.total(parts).backward()
            self.torch.nn.utils.clip_grad_norm_(self.network.parameters(), settings.gradient_limit)
            self.optimiser.step()
            for name, part in parts.items():
                totals[name] = totals.get(name, 0.0) + float(part.detach())
            self.iteration += 1
            if tick is not None:
                tick(self.iteration / settings.iterations)
        if not all(map(math.isfinite, totals.values())):
            raise BadInput("the training diverged (its loss is no number); train with a lower learning rate.")
        return {name: total / iterations for name, total in totals.items()}

    def run(self, fields: FloatArray) -> FloatArray:
        """(n, h, w) through the network as it is, in single precision; sides are multiples of the stride."""
        self.network.eval()
        with self.torch.no_grad():
            made = self.network(self._tensor(fields[None]))[0]
        return np.asarray(made.float().cpu().numpy(), dtype=np.float32)

    def state(self) -> bytes:
        """Everything that is needed to go on from here."""
        return packed_state(
            self.torch,
            {
                "settings": asdict(self._common),
                "iteration": self.iteration,
                "curve": self.curve,
                "network": self.network.state_dict(),
                "optimiser": self.optimiser.state_dict(),
            },
        )

    def restore(self, state: bytes) -> None:
        """Go on from where `state` was taken.

        Raises
        ------
        BadInput
            If it is damaged or of a training with other settings.
        """
        document = opened_state(self.torch, state, self.device, asdict(self._common), FREE)
        self.network.load_state_dict(document["network"])
        self.optimiser.load_state_dict(document["optimiser"])
        self.iteration, self.curve = int(document["iteration"]), list(document["curve"])

    def _tensor(self, array: FloatArray) -> Any:
        tensor = self.torch.from_numpy(np.ascontiguousarray(array))
        return tensor.to(self.device, memory_format=self.torch.channels_last)

    def _precision(self) -> Any:
        if self._common.precision != "mixed":
            return contextlib.nullcontext()
        return self.torch.autocast(self._common.device, dtype=self.torch.bfloat16)
