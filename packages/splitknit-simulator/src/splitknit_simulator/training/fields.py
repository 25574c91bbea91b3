"""What the two networks of the `metric` method share: both turn 32 fields of a finger into others.

A *sample* is one finger, or a piece of one, as one array (channels, h, w): the fields that the network sees, what it
shall compute, and a weight in [0, 1]. Patches are cut from samples and laid down in one of eight orientations: a finger
and its mirror image are equally likely, and so are a capture and its quarter turns.
"""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from splitknit import BadInput, FloatArray, Limits, Symmetry, check_fields, require
from splitknit_simulator.training.networks import fields_network, load_torch
from splitknit_simulator.training.scenes import SceneRanges
from splitknit_simulator.training.trainer import (
    Entry,
    LearningCurve,
    NetworkKind,
    Step,
    Trainer,
    TrainerSettings,
    TrainingRun,
    load_data,
    make_data,
    open_folder,
    packed,
    require_subjects,
    require_torch,
    train_in_folder,
    write_network,
)
from splitknit_simulator.training.trainer import Sample as Stored

FIELDS = 32  # fields that a network sees, the first of a sample
LAST_RATE = 0.02  # learning rate at the end of a training, relative to its maximum
_TRIES = 2000  # patches that are drawn before a training is given up for want of skin

Sample = NDArray[np.floating[Any]]
"""(channels, h, w), any float type."""
Run = Callable[[FloatArray], FloatArray]
"""A network, from the fields (32, h, w) to its result."""


@dataclass(frozen=True, slots=True, eq=False)
class FieldsTask:
    """What a network of fields learns, and how it is judged."""

    kind: NetworkKind
    channels: int  # how many channels a sample has
    symmetry: Symmetry  # symmetry of a sample
    # the parts of the loss, torch scalars, of what the network made of patches, and these
    losses: Callable[[Any, Any], dict[str, Any]]
    # figures of a network on a sample, in the network's units; its sides fit the stride
    judge: Callable[[Run, Sample, int], Entry]
    in_units: Callable[[Entry], Entry]  # the same in the card's units
    held_out: str  # what the figures are of, after the number of fingers
    # lines of the chart, with their unit: from an entry of the learning curve to a value
    lines: Mapping[str, Callable[[Entry], float]]
    unit: str
    min_weight: float  # patches with a smaller mean weight are not used: they hold next to no skin
    min_deviation: float  # a smaller standard deviation of a field counts as this
    scale_patches: int  # that the fields' standard deviations are taken of
    # from the ranges of scenes, and the kind and number of a subject, to its samples
    shoot: Callable[[Any, str, int], Sequence[Stored]]
    of_nir: tuple[int, ...] = ()  # fields that a fraction of the patches has zero, as without near-infrared images


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

    @property
    def loss_weights(self) -> Mapping[str, float]:
        """Weights of the loss's parts in their sum."""
        return {}

    # what a network's own settings may say otherwise
    weight_decay = 0.0  # by which weights shrink, times the learning rate
    whole_share = 0.0  # fraction of the patches that are cut from whole fingers, where there are any
    beyond_px = 0  # how far a patch may reach over a finger's edge
    no_nir_share = 0.0  # fraction of the patches without near-infrared fields

    def rate(self, iteration: int) -> float:
        """Learning rate of an iteration, counted from zero."""
        rise = min(1.0, (iteration + 1) / self.warm_up)
        fall = 0.5 * (1.0 + math.cos(math.pi * min(iteration / self.iterations, 1.0)))
        return self.learning_rate * rise * (fall * (1.0 - LAST_RATE) + LAST_RATE)


class FieldsTrainer(Trainer):
    """A network in training that turns fields into others."""

    gradient_limit: ClassVar[float] = 5.0

    def __init__(
        self, task: FieldsTask, settings: FieldsSettings, samples: Sequence[Sample], whole: Sequence[Sample] = ()
    ) -> None:
        """Build the network; a fraction of the patches is cut from the samples `whole`, if there are any."""
        scale = field_scale(task, samples, settings, whole)

        def build() -> Any:
            network = fields_network(settings.widths, len(scale), task.kind.channels[1])
            network.scale.copy_(load_torch().from_numpy(scale))
            return network

        super().__init__(settings, build, settings.weight_decay)
        self._task, self._fields, self._samples, self._whole = task, settings, samples, whole

    def steps(self) -> Iterator[Step]:
        """One step: the patches of this iteration."""
        settings = self._fields
        batch = draw_batch(self._task, self._samples, settings, self.done, self._whole)
        yield Step(batch, settings.rate(self.done), 1.0, (self.done + 1) / settings.iterations)

    def losses(self, batch: FloatArray) -> dict[str, Any]:
        """The parts of the loss of what the network makes of patches (B, channels, side, side), torch scalars."""
        patches = self.tensor(batch)
        seen = patches[:, : len(self.network.scale)].contiguous(memory_format=self.torch.channels_last)
        return self._task.losses(self.forward(seen), patches)

    def total(self, parts: dict[str, Any]) -> Any:
        """The weighted sum of the parts."""
        return sum(weight * parts[name] for name, weight in self._fields.loss_weights.items())

    def packed(self, facts: Mapping[str, Any]) -> tuple[bytes, bytes]:
        """Network and card, see :func:`splitknit_simulator.training.trainer.packed`."""
        task, widths = self._task, self._fields.widths
        words = f"U-Net of {len(widths)} levels, widths {', '.join(map(str, widths))}"
        return packed(task.kind, self.network, words, len(widths) - 1, facts)


def draw_batch(
    task: FieldsTask, samples: Sequence[Sample], settings: FieldsSettings, iteration: int, whole: Sequence[Sample] = ()
) -> FloatArray:
    """The patches (batch, channels, side, side) of an iteration; they follow from its number and the settings' seed."""
    rng = np.random.default_rng(np.random.SeedSequence([settings.seed, 0xBE, iteration]))
    patches = []
    for _ in range(settings.batch):
        patch = task.symmetry.oriented(draw_patch(task, samples, settings, rng, whole), int(rng.integers(8)))
        if task.of_nir and rng.random() < settings.no_nir_share:
            patch = np.array(patch, dtype=np.float32)
            patch[list(task.of_nir)] = 0.0
        patches.append(patch)
    return np.stack(patches)


def draw_patch(
    task: FieldsTask,
    samples: Sequence[Sample],
    settings: FieldsSettings,
    rng: np.random.Generator,
    whole: Sequence[Sample] = (),
) -> FloatArray:
    """Cut a patch (channels, side, side) anywhere in any sample, as it is; zero where it reaches over the sample."""
    side, beyond = settings.patch_px, settings.beyond_px
    for _ in range(_TRIES):
        pool = whole if len(whole) > 0 and rng.random() < settings.whole_share else samples
        sample = pool[int(rng.integers(len(pool)))]
        row, column = (
            int(rng.integers(-beyond, max(1 - beyond, length - side + beyond))) for length in sample.shape[1:]
        )
        patch = _patch_at(sample, row, column, side)
        if patch[-1].mean() >= task.min_weight:
            return patch
    raise BadInput(f"hardly any patch of {side} pixels holds enough skin to train on; take smaller patches.")


def _patch_at(sample: Sample, row: int, column: int, side: int) -> FloatArray:
    """The square (n, side, side) of a sample (n, h, w) whose corner is there; zero beyond the sample."""
    window = tuple(slice(max(start, 0), max(start + side, 0)) for start in (row, column))
    part = np.asarray(sample[(slice(None), *window)], dtype=np.float32)
    before = (max(-start, 0) for start in (row, column))
    missing = [(low, side - low - length) for low, length in zip(before, part.shape[1:], strict=True)]
    return np.pad(part, ((0, 0), *missing)) if any(map(any, missing)) else part


def field_scale(
    task: FieldsTask, samples: Sequence[Sample], settings: FieldsSettings, whole: Sequence[Sample] = ()
) -> FloatArray:
    """(32,) factors that bring the fields to about one scale: one over their standard deviation in a few patches."""
    rng = np.random.default_rng(np.random.SeedSequence([settings.seed, 0x5C]))
    drawn = (draw_patch(task, samples, settings, rng, whole)[:FIELDS] for _ in range(task.scale_patches))
    deviation = np.stack(list(drawn)).std(axis=(0, 2, 3))
    return np.asarray(1.0 / np.maximum(deviation, task.min_deviation), dtype=np.float32)


def _network_metrics(task: FieldsTask, run: Run, stride: int, samples: Mapping[int, Sample]) -> dict[str, Any]:
    """The card's figures of a network on fingers, by their numbers, not trained on."""
    figures = {number: task.in_units(task.judge(run, sample, stride)) for number, sample in samples.items()}
    return {
        "held_out": f"{len(figures)} simulated fingers not trained on, drawn from the same ranges{task.held_out}",
        "mean": _rounded(_mean_figures(list(figures.values()))),
        "fingers": [{"finger": number, **_rounded(entry)} for number, entry in figures.items()],
    }


def train_fields(run: TrainingRun, task: FieldsTask, data: SceneRanges, settings: FieldsSettings) -> dict[str, Any]:
    """Simulate the fingers and train; return what came out. Raises BadInput if torch is missing, the folder is in use,
    what is there does not fit the settings, or no finger can be used.
    """
    started = time.perf_counter()
    require_torch(settings)
    open_folder(run, data, settings)

    def fits(shape: tuple[int, ...], facts: Mapping[str, Any]) -> bool:
        return len(shape) == 3 and shape[0] == task.channels and min(shape) >= settings.stride

    pieces, whole, held_out = data.numbers
    subjects = [*(("pieces", number) for number in pieces), *(("finger", number) for number in (*whole, *held_out))]
    refused = make_data(run, subjects, functools.partial(task.shoot, data), workers=settings.threads)
    cut = load_data(run.out, "pieces", pieces, lambda shape, facts: fits(shape[1:], facts))
    crops: list[Sample] = [crop for found in cut.values() for crop in found[0][0]]
    fingers, judges = (
        {number: found[0][0] for number, found in load_data(run.out, "finger", numbers, fits).items()}
        for numbers in (whole, held_out)
    )
    samples: list[Sample] = crops if pieces else list(fingers.values())
    require_subjects(len(samples), "train on", refused)
    require_subjects(len(judges), "judge the network on", refused)
    trainer = FieldsTrainer(task, settings, samples, list(fingers.values()) if pieces else ())

    def judged() -> Entry:
        return _mean_figures([task.judge(trainer.run, sample, settings.stride) for sample in judges.values()])

    curve = LearningCurve(settings.report_every, judged, task.lines, task.unit)
    train_in_folder(run, trainer, settings.iterations, curve)
    run.progress("exporting", 1.0)
    used = {"pieces_used": len(crops), "whole_fingers_used": len(fingers)} if pieces else {"fingers_used": len(fingers)}
    facts = {
        "command": run.command,
        "training": {**asdict(settings), "iterations_done": trainer.done},
        "data": {**asdict(data), **used, "fingers_refused": len(refused)},
        "metrics": _network_metrics(task, trainer.run, settings.stride, judges),
    }
    sides = (1, FIELDS, 8 * settings.stride, 9 * settings.stride)
    probe = np.random.default_rng(0).uniform(-0.3, 0.3, sides).astype(np.float32)
    written = write_network(run.out, task.kind.name, trainer.packed(facts), trainer.run, probe)
    return {**written, "refused": len(refused), "out": str(run.out), "total_s": time.perf_counter() - started}


def _rounded(entry: Mapping[str, float]) -> dict[str, float | None]:
    return {name: round(value, 4) if math.isfinite(value) else None for name, value in entry.items()}


def _mean_figures(figures: Sequence[Mapping[str, float]]) -> Entry:
    known = {name: [entry[name] for entry in figures if math.isfinite(entry[name])] for name in figures[0]}
    return {name: float(np.mean(values)) if values else math.nan for name, values in known.items()}
