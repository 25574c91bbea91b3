"""Training of the network that separates direct light.

The thesis, 3.3.1.4: a U-Net of three encoder and three decoder blocks, trained on 72 x 72 patches of 50 palms whose
direct light was measured with 25 shifted checkerboards; Adam on the mean squared error, an epoch at a time.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np

from splitknit import BoolArray, ClaheSettings, FloatArray, Limits, clahe, local_level
from splitknit_simulator.training.networks import unet
from splitknit_simulator.training.separation_data import (
    CHANNELS,
    PATCH_PX,
    Batch,
    Patches,
    Photograph,
    SeparationData,
    enhanced_contrast,
    photographs,
)
from splitknit_simulator.training.trainer import (
    FREE,
    HELD_OUT_FROM,
    LearningCurve,
    NetworkKind,
    Sample,
    Step,
    Subject,
    Trainer,
    TrainerSettings,
    TrainingRun,
    files_of,
    load_data,
    make_data,
    open_folder,
    packed,
    require_subjects,
    require_torch,
    train_in_folder,
    write_network,
)

NETWORK = NetworkKind(
    "direct",
    "direct light of skin: a photograph, or its CLAHE-enhanced grey image three times, to its direct part",
    (3, 3),
)
FILES = files_of(NETWORK.name, "photographs")


@dataclass(frozen=True, slots=True)
class SeparationSettings(TrainerSettings):
    """Network and training; the defaults are the thesis's where it gives a number."""

    width: Annotated[int, Limits(1, 1024)] = 64
    """Channels of the first block; they double from block to block. The thesis: 64."""
    depth: Annotated[int, Limits(1, 6)] = 3
    """Encoder blocks, and decoder blocks."""
    dropout: Annotated[float, Limits(0, 1, below=True)] = 0.5
    """Fraction dropped after the last encoder block and the bridge, while training; below 1."""
    start_fraction: Annotated[float, Limits(0, 1)] = 0.0
    """The untrained network gives this fraction of its image: a better start than noise. 0 = all random."""
    epochs: Annotated[int, Limits(1, 100_000)] = 50
    """How often every patch is seen."""
    decay: Annotated[float, Limits(0, 1)] = 0.0
    """Over this last part of the training the learning rate falls to zero along a cosine; the thesis keeps it."""
    border_px: Annotated[int, Limits(0, 512)] = 0
    """Pixels at a patch's border that the loss leaves out: there the network sees zeros where an image would go on."""

    @property
    def stride(self) -> int:
        """Both sides of what the network sees are multiples of this."""
        return int(2**self.depth)


class SeparationTrainer(Trainer):
    """The network for direct light in training."""

    counted: ClassVar[str] = "epoch"
    free: ClassVar[tuple[str, ...]] = (*FREE, "epochs", "decay")

    def __init__(self, settings: SeparationSettings, patches: Patches) -> None:
        """Draw the first weights from the settings' seed."""
        shape = (settings.width, settings.depth, settings.dropout, settings.start_fraction)
        super().__init__(settings, lambda: unet(*shape))
        self.settings: SeparationSettings = settings
        self.patches = patches

    def steps(self) -> Iterator[Step]:
        """One epoch: every patch once, augmented."""
        settings = self.settings
        count = math.ceil(len(self.patches) / settings.batch)
        for number, batch in enumerate(self.patches.shuffled(settings.batch, settings.seed, self.done)):
            done = (self.done + number / count) / settings.epochs
            rate = settings.learning_rate * _learning_factor(done, settings.decay)
            yield Step(batch, rate, len(batch[0]), done)

    def losses(self, batch: Batch) -> dict[str, Any]:
        """Mean squared error."""
        inputs, targets = (self.tensor(part) for part in batch)
        error = self.forward(inputs) - targets
        rim = self.settings.border_px
        if rim:
            error = error[:, :, rim:-rim, rim:-rim]
        return {"loss": (error * error).mean()}

    def loss_of(self, patches: Patches, enhanced: bool) -> float:
        """Mean squared error over all patches as they are, nothing dropped."""
        self.network.eval()
        total, count = 0.0, 0
        with self.torch.no_grad():
            for batch in patches.fixed(enhanced, self.settings.batch):
                total += float(self.losses(batch)["loss"]) * len(batch[0])
                count += len(batch[0])
        return total / count

    def packed(self, facts: Mapping[str, Any]) -> tuple[bytes, bytes]:
        """Network and card, see :func:`splitknit_simulator.training.trainer.packed`."""
        settings = self.settings
        words = f"U-Net of the thesis (figure 3.19), depth {settings.depth}, width {settings.width}"
        return packed(NETWORK, self.network, words, settings.depth, facts)


def _learning_factor(done: float, decay: float) -> float:
    """Learning rate, relative to its start, when a fraction is `done`: it falls over the last `decay`."""
    if decay <= 0 or done <= 1 - decay:
        return 1.0
    return 0.5 * (1.0 + math.cos(math.pi * min((done - 1 + decay) / decay, 1.0)))


def train_separation(run: TrainingRun, data: SeparationData, settings: SeparationSettings) -> dict[str, Any]:
    """Build the data set and train. BadInput if torch is missing, or the folder in use or of other settings."""
    started = time.perf_counter()
    require_torch(settings)
    open_folder(run, data, settings, SeparationTrainer.free)
    views = [f"_{view:02d}" for view in range(data.views)]
    subjects = _subjects(data)
    refused = make_data(run, subjects, lambda kind, index: _shoot(kind, index, data, settings.seed), views)
    stored = [stored_photographs(run.out, data, held_out) for held_out in (False, True)]
    for found, purpose in zip(stored, ("train on", "judge the network on"), strict=True):
        require_subjects(len(found), purpose, refused)
    train, held_out = map(Patches, stored)
    trainer = SeparationTrainer(settings, train)
    lines = {
        "training": lambda entry: _psnr(entry["loss"]),
        "held out": lambda entry: _psnr(entry["held_out_linear"]),
        "held out, enhanced": lambda entry: _psnr(entry["held_out_enhanced"]),
    }
    curve = LearningCurve(
        1,
        lambda: {"linear": trainer.loss_of(held_out, False), "enhanced": trainer.loss_of(held_out, True)},
        lines,
        "PSNR, dB",
    )
    train_in_folder(run, trainer, settings.epochs, curve)
    run.progress("exporting", 1.0)
    last = trainer.curve[-1]
    facts = {
        "command": run.command,
        "training": {**asdict(settings), "epochs_done": trainer.done, "patches": len(train)},
        "data": asdict(data),
        "metrics": {
            "held_out": f"{data.held_out} palms and {data.held_out} fingers not trained on, patches, local level 1",
            "psnr_linear_db": _psnr(last["held_out_linear"]),
            "psnr_enhanced_db": _psnr(last["held_out_enhanced"]),
        },
    }
    side = 10 * settings.stride
    probe = np.random.default_rng(0).random((1, 3, side, side + settings.stride), dtype=np.float32)
    written = write_network(run.out, NETWORK.name, trainer.packed(facts), trainer.run, probe)
    return {**written, "refused": len(refused), "out": str(run.out), "total_s": time.perf_counter() - started}


def stored_photographs(folder: Path, data: SeparationData, held_out: bool) -> list[Photograph]:
    """The photographs that a training keeps in `folder`: those trained on, or those held out."""
    views = [f"_{view:02d}" for view in range(data.views)]
    found = []
    for kind, number in _subjects(data):
        if (number >= HELD_OUT_FROM) is held_out:
            for pixels, facts in load_data(folder, kind, [number], _fits, views).get(number, []):
                found.append(Photograph(pixels, np.asarray(facts["corners"], dtype=np.int32).reshape(-1, 2), facts))
    return found


def _subjects(data: SeparationData) -> list[Subject]:
    counts = {"palm": data.palms, "finger": data.fingers}
    trained = [(kind, index) for kind, count in counts.items() for index in range(count)]
    return trained + [(kind, HELD_OUT_FROM + index) for kind in counts for index in range(data.held_out)]


def _shoot(kind: str, index: int, data: SeparationData, seed: int) -> Iterable[Sample]:
    """Every second palm and finger is equalised in linear light, so that the network knows both."""
    for photograph in photographs(kind, index, seed, data, _enhance_linear if index % 2 else enhanced_contrast):
        facts = photograph.facts
        stored = {**facts, "skin": asdict(facts["skin"]), "corners": photograph.corners.tolist()}
        yield _levelled(photograph).pixels, stored


def _fits(shape: tuple[int, ...], facts: Mapping[str, Any]) -> bool:
    """Whether these are the pixels of a photograph, and its patches lie within."""
    corners = np.asarray(facts["corners"], dtype=np.int32).reshape(-1, 2)
    inside = corners.min() >= 0 and (corners.max(axis=0) + PATCH_PX <= shape[:2]).all()
    return len(shape) == 3 and shape[2] == CHANNELS and bool(inside)


def _psnr(loss: float) -> float:
    """PSNR of a mean squared error, in dB, for a peak of one: the local level."""
    return float(-10.0 * np.log10(max(loss, 1e-12)))


def _enhance_linear(grey: FloatArray, px_per_mm: float, mask: BoolArray) -> FloatArray:
    return clahe(grey, px_per_mm, ClaheSettings(grey="linear"), mask=mask)


def _levelled(photograph: Photograph) -> Photograph:
    """The photograph divided by its local level, as the network is given it."""
    pixels = photograph.pixels.astype(np.float32)
    level = local_level(np.ascontiguousarray(pixels[..., :3].transpose(2, 0, 1)))[..., None]
    enhanced_level = local_level(np.ascontiguousarray(pixels[..., 6]))[..., None]
    divided = np.concatenate([pixels[..., :6] / level, pixels[..., 6:] / enhanced_level], axis=2)
    return replace(photograph, pixels=divided.astype(np.float16))
