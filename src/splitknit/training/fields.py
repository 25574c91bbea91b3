"""What the two networks of the `metric` method share: both turn 32 fields of a finger into others.

A *sample* is one finger, or a piece of one, as one array (channels, h, w): the fields that the network sees, what it
shall compute, and a weight in [0, 1]. Patches are cut from samples and laid down in one of eight orientations: a finger
and its mirror image are equally likely, and so are a capture and its quarter turns.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, require
from splitknit.model import FloatArray
from splitknit.settings import Limits, check_fields
from splitknit.training.networks import fields_network, load_torch
from splitknit.training.trainer import (
    Architecture,
    Entry,
    NetworkKind,
    Step,
    Trainer,
    TrainerSettings,
    packed,
    write_network,
)

FIELDS = 32
"""Fields that a network sees, the first of a sample."""
LAST_RATE = 0.02
"""Learning rate at the end of a training, relative to its maximum."""
_TRIES = 2000
"""Patches that are drawn before a training is given up for want of skin."""

Sample = NDArray[np.floating[Any]]
"""(channels, h, w), any float type."""


@dataclass(frozen=True, slots=True)
class FieldsSettings(TrainerSettings):
    """Training of a network that turns fields on a grid into others."""

    batch: Annotated[int, Limits(1, 4096)] = 6
    """Patches of each iteration."""
    learning_rate: Annotated[float, Limits(0, above=True)] = 1.5e-3
    """Maximum step of the optimiser."""
    precision: Literal["auto", "float32", "mixed"] = "mixed"
    """``mixed`` (bfloat16 products, float32 weights and sums), ``float32``; ``auto``: mixed on a GPU only."""
    widths: Annotated[tuple[int, ...], Limits(1)] = (16, 32, 48, 64, 64)
    """Channels of each level, two to seven; every level but the first works at half the scale of the one before."""
    iterations: Annotated[int, Limits(1, 10_000_000)] = 7200
    """Corrections of the weights."""
    patch_px: Annotated[int, Limits(1, 2048)] = 192
    """Side of a patch; a multiple of the network's stride."""
    warm_up: Annotated[int, Limits(1, 10_000_000)] = 200
    """Iterations over which the learning rate rises; then it falls along a cosine."""
    report_every: Annotated[int, Limits(1, 10_000_000)] = 200
    """Iterations between two entries of the learning curve, after each of which a training can be resumed."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "widths", tuple(self.widths))
        check_fields(self)
        require(
            2 <= len(self.widths) <= 7,
            f"training.widths must be two to seven numbers, but they are {list(self.widths)}.",
        )
        require(
            self.patch_px % self.stride == 0,
            f"training.patch_px must be a multiple of {self.stride}, but it is {self.patch_px}.",
        )

    @property
    def stride(self) -> int:
        """Both sides of what the network sees are multiples of this."""
        return int(2 ** (len(self.widths) - 1))

    def rate(self, iteration: int) -> float:
        """Learning rate of an iteration, counted from zero."""
        rise = min(1.0, (iteration + 1) / self.warm_up)
        fall = 0.5 * (1.0 + math.cos(math.pi * min(iteration / self.iterations, 1.0)))
        return self.learning_rate * rise * (fall * (1.0 - LAST_RATE) + LAST_RATE)


@dataclass(frozen=True, slots=True)
class FieldsLoss:
    """What a network of fields learns from."""

    draw: Callable[[int], FloatArray]
    """The patches (B, channels, side, side) of an iteration."""
    parts: Callable[[Any, Any], dict[str, Any]]
    """The parts of the loss, torch scalars, of what the network made of patches, and these."""
    weights: Mapping[str, float]
    """Of the parts, in their sum."""


class FieldsTrainer(Trainer):
    """A network in training that turns fields into others."""

    gradient_limit: ClassVar[float] = 5.0

    def __init__(
        self, settings: FieldsSettings, outputs: int, scale: FloatArray, loss: FieldsLoss, weight_decay: float = 0.0
    ) -> None:
        """Build the network; `scale` (n,) multiplies its fields, see :func:`one_scale`."""

        def build() -> Any:
            network = fields_network(settings.widths, len(scale), outputs)
            network.scale.copy_(load_torch().from_numpy(scale))
            return network

        super().__init__(settings, build, weight_decay)
        self._fields, self._loss = settings, loss

    def steps(self) -> Iterator[Step]:
        """One step: the patches of this iteration."""
        settings = self._fields
        yield Step(self._loss.draw(self.done), settings.rate(self.done), 1.0, (self.done + 1) / settings.iterations)

    def losses(self, batch: FloatArray) -> dict[str, Any]:
        """The parts of the loss of what the network makes of patches (B, channels, side, side), torch scalars."""
        patches = self.tensor(batch)
        seen = patches[:, : len(self.network.scale)].contiguous(memory_format=self.torch.channels_last)
        return self._loss.parts(self.forward(seen), patches)

    def total(self, parts: dict[str, Any]) -> Any:
        """The weighted sum of the parts."""
        return sum(weight * parts[name] for name, weight in self._loss.weights.items())


def patch_with_skin(cut: Callable[[], FloatArray], side: int, min_weight: float) -> FloatArray:
    """The first patch of `cut` whose mean weight, its last channel, is large enough.

    Raises
    ------
    BadInput
        If patches with enough skin cannot be found.
    """
    for _ in range(_TRIES):
        patch = cut()
        if patch[-1].mean() >= min_weight:
            return patch
    raise BadInput(f"hardly any patch of {side} pixels holds enough skin to train on; take smaller patches.")


def patch_at(sample: Sample, row: int, column: int, side: int) -> FloatArray:
    """The square (n, side, side) of a sample (n, h, w) whose corner is there; zero beyond the sample."""
    first = [max(start, 0) for start in (row, column)]
    part = np.asarray(sample[:, first[0] : max(row + side, 0), first[1] : max(column + side, 0)], dtype=np.float32)
    before = [low - start for low, start in zip(first, (row, column), strict=True)]
    missing = [(low, side - low - length) for low, length in zip(before, part.shape[1:], strict=True)]
    return np.pad(part, ((0, 0), *missing)) if any(map(any, missing)) else part


def one_scale(fields: FloatArray, min_deviation: float) -> FloatArray:
    """(n,) factors that bring fields (patches, n, h, w) to about one scale: one over their standard deviation.

    Parameters
    ----------
    fields : of a few patches
    min_deviation : a smaller standard deviation counts as this
    """
    return np.asarray(1.0 / np.maximum(fields.std(axis=(0, 2, 3)), min_deviation), dtype=np.float32)


def check_channels(samples: Sequence[Sample], channels: int) -> None:
    """Refuse samples of another shape.

    Raises
    ------
    BadInput
        If there are none, or one is not (channels, h, w).
    """
    require(len(samples) > 0, "there are no fingers to train on.")
    for sample in samples:
        require(
            sample.ndim == 3 and sample.shape[0] == channels and min(sample.shape) > 0,
            f"a finger to train on must have the shape ({channels}, h, w), but one has {sample.shape}.",
        )


def _packed_fields(kind: NetworkKind, state: Mapping[str, Any], facts: Mapping[str, Any]) -> tuple[bytes, bytes]:
    """The files of a finished network, see :func:`splitknit.training.trainer.packed`.

    Parameters
    ----------
    kind : NetworkKind
    state : ``state_dict`` of a :func:`splitknit.training.networks.fields_network`
    facts : what the card also contains: command, training, data, metrics

    Raises
    ------
    BadInput
        If `state` belongs to another network.
    """
    network = _network_from(state)
    widths = [int(level[0].out_channels) for level in network.down]
    channels = int(network.down[0][0].in_channels), int(network.out.out_channels)
    words = f"U-Net of {len(widths)} levels, widths {', '.join(map(str, widths))}"
    return packed(kind, network, Architecture(words, channels, len(widths) - 1), facts)


def write_fields(out: Path, kind: NetworkKind, state: Mapping[str, Any], facts: Mapping[str, Any]) -> dict[str, Any]:
    """Write network and card of a ``state_dict``, see :func:`splitknit.training.trainer.write_network`."""
    files = _packed_fields(kind, state, facts)
    stride, fields = stride_of(state), int(state["scale"].shape[0])
    probe = np.random.default_rng(0).uniform(-0.3, 0.3, (fields, 8 * stride, 9 * stride)).astype(np.float32)
    run = runner_of(state)
    return write_network(out, kind.name, files, lambda images: run(images[0])[None], probe[None])


def runner_of(state: Mapping[str, Any]) -> Callable[[FloatArray], FloatArray]:
    """The network whose ``state_dict`` this is, as a function of fields (n, h, w), on the processor."""
    torch = load_torch()
    network = _network_from({name: part.cpu() for name, part in state.items()})

    def run(fields: FloatArray) -> FloatArray:
        with torch.no_grad():
            made = network(torch.from_numpy(np.ascontiguousarray(fields[None])))[0]
        return np.asarray(made.numpy(), dtype=np.float32)

    return run


def stride_of(state: Mapping[str, Any]) -> int:
    """What the sides of that network's input are multiples of."""
    return int(2 ** (len(_network_from(state).down) - 1))


def rounded(entry: Mapping[str, float]) -> dict[str, float | None]:
    """Figures for a card; None where there is none."""
    return {name: round(value, 4) if math.isfinite(value) else None for name, value in entry.items()}


def mean_figures(figures: Sequence[Mapping[str, float]]) -> Entry:
    """Mean of each figure over the fingers that have one."""
    found = {}
    for name in figures[0]:
        values = [entry[name] for entry in figures if math.isfinite(entry[name])]
        found[name] = float(np.mean(values)) if values else math.nan
    return found


def _network_from(state: Mapping[str, Any]) -> Any:
    """The network whose ``state_dict`` this is; widths follow from the weights' shapes.

    Raises
    ------
    BadInput
        If it is not the state of a :func:`fields_network`.
    """
    try:
        levels = sum(name.startswith("down.") and name.endswith(".0.weight") for name in state)
        widths = [int(state[f"down.{number}.0.weight"].shape[0]) for number in range(levels)]
        fields, outputs = int(state["down.0.0.weight"].shape[1]), int(state["out.weight"].shape[0])
        network = fields_network(widths, fields, outputs)
        network.load_state_dict(dict(state))
    except (KeyError, AttributeError, IndexError, RuntimeError, TypeError) as error:
        reason = str(error).splitlines()[0]
        raise BadInput(f"these are not the weights of a relief or shape network ({reason}).") from error
    return network.eval()
