"""``splitknit train separation | relief | shape``: options in, settings out."""

from __future__ import annotations

import shlex
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from splitknit import AnyPath, Help, Job, Outcome, Progress, Verb, options_of, path

Task = tuple[Callable[..., dict[str, Any]], type[Any], type[Any]]
"""What trains, and the settings of its data and of itself."""
_Seed = Annotated[int, Help("of weights and patches", "N")]
_Threads = Annotated[int, Help("of torch, and processes that simulate; repeatable for a fixed number", "N")]
_Device = Annotated[Literal["cpu", "cuda"], Help("default: cpu")]
_Precision = Annotated[Literal["mixed", "float32"], Help("mixed (default): products in half precision")]


def _data(text: str) -> Help:
    return Help(text, "N", group="data set")


def _training(text: str, metavar: str = "N") -> Help:
    return Help(text, metavar, group="network and training")


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainJob(Job, ABC):
    """Train a network on simulated skin; the defaults are the thesis's, or what the shipped networks saw.

    Returns
    -------
    dict
        What the network's card holds, and ``out``, ``refused``, ``total_s``.

    Raises
    ------
    BadInput
        If torch is missing, the folder is in use, or what is there does not fit the settings.
    """

    network: ClassVar[str]
    out: Annotated[AnyPath, Help("folder to train in; new, or with `resume`", "DIR")]
    resume: Annotated[bool, Help("go on with the training in DIR")] = False

    def run(self, progress: Progress) -> dict[str, Any]:
        """Make the data set and train."""
        from splitknit_simulator.training.trainer import TrainingRun  # verbs import what they need

        train, *kinds = self._task()
        data, settings = (
            kind(**{one.name: getattr(self, one.name) for one in fields(kind) if hasattr(self, one.name)})
            for kind in kinds
        )
        run = TrainingRun(path(self.out), self.resume, self.command(), progress, _curve_svg)
        return train(run, data=data, settings=settings)

    @abstractmethod
    def _task(self) -> Task:
        """What trains this network."""

    def command(self) -> str:
        """The command line that trains this network again, every option written out, for its card."""
        words, options = ["splitknit", "train", self.network, "--out", "DIR"], options_of(Verb(type(self)))
        for name in (one.name for one in fields(self) if one.name not in ("out", "resume")):
            value = getattr(self, name)
            words += [options[name], f"{value:g}" if isinstance(value, float) else str(value)]
        return shlex.join(words)


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainSeparationJob(TrainJob):
    """Train the thesis's U-Net, which separates direct light."""

    network = "separation"
    # fmt: off
    palms: Annotated[int, _data("simulated palms")] = 50
    fingers: Annotated[int, _data("simulated fingers beside them")] = 0
    views: Annotated[int, _data("photographs of each, under other light and with other optics of the skin")] = 1
    patches: Annotated[int, _data("patches of 72 x 72 pixels of each photograph")] = 750
    check_mm: Annotated[float, _data("side of the checks that direct light is defined with")] = 0.42
    held_out: Annotated[int, _data("palms, and as many fingers, set apart for the learning curve")] = 4
    labels: Annotated[Literal["stack", "truth"], Help(
        "direct light from 25 shifted checkerboards (stack, the default), or the twin's own, ten times faster",
        group="data set")] = "stack"
    width: Annotated[int, _training("channels of the first block; the cost grows with its square")] = 64
    epochs: Annotated[int, _training("times that every patch is seen")] = 50
    dropout: Annotated[float, _training("fraction dropped in the deepest blocks while training")] = 0.5
    decay: Annotated[float, _training(
        "last part of the training over which the learning rate falls to zero")] = 0.0
    start_fraction: Annotated[float, _training("fraction of its image that the untrained network gives")] = 0.0
    border_px: Annotated[int, Help(
        "pixels at a patch's border that the loss leaves out", "N", "--border", group="network and training")] = 0
    seed: Annotated[int, _training("of data, weights and order")] = 0
    threads: Annotated[int, _training("of torch, and processes that simulate; repeatable for a fixed number")] = 1
    device: Annotated[Literal["cpu", "cuda"], _training("default: cpu", "")] = "cpu"
    precision: Annotated[Literal["auto", "float32", "mixed"], _training(
        "mixed: products in half precision; auto (default): on a GPU", "")] = "auto"
    # fmt: on

    def _task(self) -> Task:
        from splitknit_simulator.training.separation import SeparationData, SeparationSettings, train_separation

        return train_separation, SeparationData, SeparationSettings


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainReliefJob(TrainJob):
    """Train the network of the preset metric for relief and glare."""

    network = "relief"
    # fmt: off
    fingers: Annotated[int, Help("simulated fingers to take pieces of, about 35 MB each on disk", "N")] = 160
    crops: Annotated[int, Help("pieces of each, every one with its own skin, lights and exposure", "N")] = 5
    whole_fingers: Annotated[int, Help("fingers to train on as a whole, about 60 MB each on disk", "N")] = 116
    held_out: Annotated[int, Help("further whole ones, for the learning curve and the card", "N")] = 6
    first: Annotated[int, Help(
        "number of the first finger for pieces; everything about a finger follows from its number", "N")] = 7000
    first_whole: Annotated[int, Help("number of the first whole finger", "N")] = 5000
    iterations: Annotated[int, Help("corrections of the weights", "N")] = 7200
    batch: Annotated[int, Help("patches of each", "N")] = 6
    patch_px: Annotated[int, Help("side of a patch in pixels", "N", option="--patch")] = 192
    seed: _Seed = 0
    threads: _Threads = 1
    device: _Device = "cpu"
    precision: _Precision = "mixed"
    # fmt: on

    def _task(self) -> Task:
        from splitknit_simulator.training.fields import train_fields
        from splitknit_simulator.training.relief import TASK, ReliefData, ReliefSettings

        return partial(train_fields, task=TASK), ReliefData, ReliefSettings


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainShapeJob(TrainJob):
    """Train the network of the preset metric that corrects the shape."""

    network = "shape"
    # fmt: off
    fingers: Annotated[int, Help("simulated fingers to train on, about 4 MB each on disk", "N")] = 160
    held_out: Annotated[int, Help("further ones, for the learning curve and the card", "N")] = 8
    first: Annotated[int, Help(
        "number of the first finger; everything about a finger follows from its number", "N")] = 5000
    iterations: Annotated[int, Help("corrections of the weights", "N")] = 6000
    batch: Annotated[int, Help("patches of each", "N")] = 8
    patch_px: Annotated[int, Help("side of a patch in pixels of the coarse grid", "N", option="--patch")] = 160
    seed: _Seed = 0
    threads: _Threads = 1
    device: _Device = "cpu"
    precision: _Precision = "mixed"
    # fmt: on

    def _task(self) -> Task:
        from splitknit_simulator.training.fields import train_fields
        from splitknit_simulator.training.shape import TASK, ShapeData, ShapeNetSettings

        return partial(train_fields, task=TASK), ShapeData, ShapeNetSettings


def _show_separation(facts: dict[str, Any], job: TrainSeparationJob) -> Outcome:
    from splitknit_simulator.training.separation import FILES

    metrics = facts["metrics"]
    lines = [
        f"A network of width {job.width} was trained for {job.epochs} epochs in {facts['total_s']:.0f} s.",
        f"Held out: {metrics['psnr_linear_db']:.1f} dB on linear images, "
        f"{metrics['psnr_enhanced_db']:.1f} dB on enhanced ones.",
    ]
    return facts, lines + _written(path(job.out), FILES)


def _show_relief(facts: dict[str, Any], job: TrainReliefJob) -> Outcome:
    from splitknit_simulator.training.relief import FILES

    used, mean = facts["data"], facts["metrics"]["mean"]
    formats = {
        "correlation": "ridge correlation {:.3f}",
        "gain": "gain {:.2f}",
        "rms_um": "error {:.1f} µm",
        "glare_r2": "{:.2f} of the glare's power explained",
    }
    figures = [text.format(value) for name, text in formats.items() if (value := mean[name]) is not None]
    lines = [
        f"A network was trained for {job.iterations} iterations in {facts['total_s']:.0f} s "
        f"(pieces: {used['pieces_used']}; whole fingers: {used['whole_fingers_used']}; refused: {facts['refused']}).",
        "Held out: " + ", ".join(figures) + ".",
    ]
    return facts, lines + _written(path(job.out), FILES)


def _show_shape(facts: dict[str, Any], job: TrainShapeJob) -> Outcome:
    from splitknit_simulator.training.shape import FILES

    mean = facts["metrics"]["mean"]
    lines = [
        f"A network was trained for {job.iterations} iterations in {facts['total_s']:.0f} s "
        f"(fingers: {facts['data']['fingers_used']}; refused: {facts['refused']})."
    ]
    if None not in mean.values():
        lines.append(
            f"Held out: error of a slope {mean['before']:.3f} before mending, {mean['after']:.3f} after; "
            f"of wide slopes {mean['wide_before']:.3f} and {mean['wide_after']:.3f}."
        )
    return facts, lines + _written(path(job.out), FILES)


SEPARATION = Verb(TrainSeparationJob, _show_separation)
RELIEF, SHAPE = Verb(TrainReliefJob, _show_relief), Verb(TrainShapeJob, _show_shape)


def _written(out: Path, files: Mapping[str, str]) -> list[str]:
    return ["Written:", *(f"  {out / name}: {what}" for name, what in files.items() if (out / name).exists())]


def _curve_svg(x: Sequence[float], lines: Mapping[str, Sequence[float]], x_label: str, y_label: str) -> bytes:
    import numpy as np

    from splitknit import Curve, profile_chart, standalone

    drawn = [Curve(name, np.array(x, dtype=np.float64), np.array(y)) for name, y in lines.items()]
    return standalone(profile_chart(drawn, x_label, y_label))
