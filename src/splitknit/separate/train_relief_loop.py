"""The training of the relief's network: some iterations at a time, to be stopped and taken up again."""

from __future__ import annotations

import contextlib
import io
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from splitknit.check import BadInput, require
from splitknit.separate.train_network import load_torch
from splitknit.separate.train_relief_batches import (
    FIELDS,
    GLARE,
    RELIEF,
    WEIGHT,
    Sample,
    check_samples,
    draw_batch,
    field_scale,
)
from splitknit.separate.train_relief_loss import PARTS, VARIANCE_LIMITS, relief_losses, total_loss
from splitknit.separate.train_relief_network import relief_network
from splitknit.separate.train_relief_settings import ReliefSettings
from splitknit.types import FloatArray

JUDGED_PX = 512
"""Side of the middle part of a finger on which it is judged."""


class ReliefTrainer:
    """A network in training.

    Repeatable on a processor: the same settings and samples give the same weights, also when the training was
    interrupted, as long as the number of threads is the same.
    """

    def __init__(self, settings: ReliefSettings, samples: Sequence[Sample], whole: Sequence[Sample] = ()) -> None:
        """Draw the first weights from the settings' seed, and the fields' scale from the samples.

        A share of the patches, :attr:`ReliefSettings.whole_share`, is cut from the samples `whole`, if there are any.
        """
        torch = load_torch()
        require(
            settings.device != "cuda" or bool(torch.cuda.is_available()),
            "no GPU can be used by torch here; train with --device cpu.",
        )
        check_samples(samples)
        if len(whole) > 0:
            check_samples(whole)
        self.torch, self.settings, self.samples, self.whole = torch, settings, samples, whole
        self.device = torch.device(settings.device)
        torch.set_num_threads(settings.threads)
        torch.manual_seed(settings.seed)
        network = relief_network(settings.widths)
        network.scale.copy_(torch.from_numpy(field_scale(samples, settings, whole)))
        # channels last: convolutions of few channels run about twice as fast
        self.network = network.to(self.device, memory_format=torch.channels_last)
        self.optimiser = torch.optim.Adam(self.network.parameters(), lr=settings.learning_rate)
        self.iteration = 0
        """Iterations done."""
        self.curve: list[dict[str, float]] = []
        """Entries by whoever trains."""

    def train(self, iterations: int, tick: Callable[[float], None] | None = None) -> dict[str, float]:
        """Go on by so many iterations and return the mean of each part of the loss; `tick(share)` hears of it.

        Raises
        ------
        BadInput
            If the loss is no number any more.
        """
        settings = self.settings
        self.network.train()
        totals = dict.fromkeys(PARTS, 0.0)
        for _ in range(iterations):
            for group in self.optimiser.param_groups:
                group["lr"] = settings.rate(self.iteration)
            batch = self._tensor(draw_batch(self.samples, settings, self.iteration, self.whole))
            with self._precision():
                made = self.network(batch[:, :FIELDS].contiguous(memory_format=self.torch.channels_last))
            parts = relief_losses(made.float(), batch)
            self.optimiser.zero_grad(set_to_none=True)
            total_loss(parts, settings).backward()
            self.torch.nn.utils.clip_grad_norm_(self.network.parameters(), settings.gradient_limit)
            self.optimiser.step()
            for name in PARTS:
                totals[name] += float(parts[name].detach())
            self.iteration += 1
            if tick is not None:
                tick(self.iteration / settings.iterations)
        if not all(map(math.isfinite, totals.values())):
            raise BadInput("the training diverged (its loss is no number); train with a lower learning rate.")
        return {name: total / iterations for name, total in totals.items()}

    def run(self, fields: FloatArray) -> FloatArray:
        """(32, h, w) through the network as it is, in single precision; sides are multiples of the stride."""
        self.network.eval()
        with self.torch.no_grad():
            made = self.network(self._tensor(fields[None]))[0]
        return np.asarray(made.float().cpu().numpy(), dtype=np.float32)

    def judge(self, sample: Sample) -> dict[str, float]:
        """What the network makes of the middle of a finger, see :func:`judged`."""
        return judge_middle(self.run, sample, self.settings.stride)

    def state(self) -> bytes:
        """Everything that is needed to go on from here."""
        buffer = io.BytesIO()
        self.torch.save(
            {
                "settings": asdict(self.settings),
                "iteration": self.iteration,
                "curve": self.curve,
                "network": self.network.state_dict(),
                "optimiser": self.optimiser.state_dict(),
            },
            buffer,
        )
        return buffer.getvalue()

    def restore(self, state: bytes) -> None:
        """Go on from where `state` was taken.

        Raises
        ------
        BadInput
            If it is damaged or of a training with other settings.
        """
        try:
            document = self.torch.load(io.BytesIO(state), map_location=self.device, weights_only=True)
            settings, iteration, curve = document["settings"], int(document["iteration"]), list(document["curve"])
        except Exception as error:  # torch, zipfile and pickle each have their own
            raise BadInput(
                f"the checkpoint is damaged ({type(error).__name__}); train anew in another folder."
            ) from error
        free = ("threads", "device", "precision")  # these may change on the way
        ours = asdict(self.settings)
        changed = [name for name in ours if name not in free and settings.get(name) != ours[name]]
        require(
            not changed,
            f"the checkpoint is of a training with other settings ({', '.join(changed)}); "
            "resume with the same settings or train in another folder.",
        )
        self.network.load_state_dict(document["network"])
        self.optimiser.load_state_dict(document["optimiser"])
        self.iteration, self.curve = iteration, curve

    def _tensor(self, array: FloatArray) -> Any:
        tensor = self.torch.from_numpy(np.ascontiguousarray(array))
        return tensor.to(self.device, memory_format=self.torch.channels_last)

    def _precision(self) -> Any:
        if self.settings.precision != "mixed":
            return contextlib.nullcontext()
        return self.torch.autocast(self.settings.device, dtype=self.torch.bfloat16)


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
