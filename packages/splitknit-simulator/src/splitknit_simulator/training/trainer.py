"""The one trainer: a network in training, and the folder that it grows in.

Everything that the three networks share: data files that are written once and read back, the loop with its learning
curve and checkpoints, and the ONNX file with its card. A training that was interrupted goes on where it stopped, for
every file in its folder is whole or absent. What differs (data, loss, figures) stands in
:mod:`splitknit_simulator.training.separation`, :mod:`~splitknit_simulator.training.relief` and
:mod:`~splitknit_simulator.training.shape`.
"""

from __future__ import annotations

import contextlib
import functools
import io
import json
import math
import os
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from splitknit import (
    BadInput,
    Checked,
    FloatArray,
    Limits,
    Progress,
    atomic_file,
    card_bytes,
    csv_text,
    json_text,
    map_npy,
    network_of,
    no_progress,
    parse_json,
    plain_json,
    provenance,
    read_bytes,
    read_json,
    read_network,
    refusing,
    require,
    run_jobs,
    run_network,
)
from splitknit_simulator.training.networks import export_onnx, load_torch, unet_reach

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Chart = Callable[[Sequence[float], Mapping[str, Sequence[float]], str, str], bytes]
"""Draws a learning curve as SVG: x, lines by name, labels of x and y."""
HELD_OUT_FROM = 1_000_000  # fingers and palms from this number on are never trained on
FREE = ("threads", "device", "precision")  # settings that may change when a training is resumed: where it runs
_MAX_BYTES = 2_000_000_000  # a checkpoint has three times the network's bytes
_DATA_PART = 0.4  # fraction of the progress bar for the data
_MAX_DIFFERENCE = 0.02
"""Largest difference of the exported network, of the output's range: its weights are stored in half precision."""


@dataclass(frozen=True, slots=True)
class TrainerSettings(Checked):
    """What every training has: steps, and the machine."""

    _group = "training"

    batch: Annotated[int, Limits(1, 4096)] = 32
    """Patches of each step."""
    learning_rate: Annotated[float, Limits(0, above=True)] = 1e-3
    """Step of the optimiser; its maximum where it changes."""
    seed: Annotated[int, Limits(0)] = 0
    """Seed of weights, patches and dropout."""
    device: Literal["cpu", "cuda"] = "cpu"
    """``cpu`` or ``cuda``."""
    threads: Annotated[int, Limits(1, 1024)] = 1
    """Threads of torch on the processor, and processes that photograph; repeatable for a fixed number."""
    precision: Literal["auto", "float32", "mixed"] = "auto"
    """``float32``; ``mixed`` (bfloat16 products, float32 weights and sums); ``auto``: mixed on a GPU only."""

    @property
    def mixed(self) -> bool:
        """Whether products are formed in half precision."""
        return self.precision == "mixed" or (self.precision == "auto" and self.device == "cuda")


class Step(NamedTuple):
    """One correction of the weights."""

    batch: Any
    learning_rate: float
    weight: float  # weight of its loss in the mean over an entry of the learning curve
    progress: float  # fraction of the training, 0 to 1


class Trainer(ABC):
    """A network in training. Repeatable on a processor: the same settings and data give the same weights, also when the
    training was interrupted, as long as the number of threads is the same.
    """

    counted: ClassVar[str] = "iteration"
    """What `done` counts: the first column of the learning curve."""
    free: ClassVar[tuple[str, ...]] = FREE
    gradient_limit: ClassVar[float] = math.inf
    """Longer gradients are shortened to this."""

    def __init__(self, settings: TrainerSettings, build: Callable[[], Any], weight_decay: float = 0.0) -> None:
        """Build the network with weights drawn from the settings' seed."""
        self.torch, self.settings = require_torch(settings), settings
        self.device = self.torch.device(settings.device)
        self.torch.set_num_threads(settings.threads)
        self.torch.manual_seed(settings.seed)
        # channels last: convolutions of few channels run about twice as fast
        self.network = build().to(self.device, memory_format=self.torch.channels_last)
        self.optimiser = self.torch.optim.AdamW(
            self.network.parameters(), lr=settings.learning_rate, weight_decay=weight_decay
        )
        self.done = 0
        """Epochs or iterations, see `counted`."""
        self.curve: list[dict[str, float]] = []

    @abstractmethod
    def steps(self) -> Iterator[Step]:
        """The steps of the next epoch or iteration; they follow from `done` and the settings."""

    @abstractmethod
    def losses(self, batch: Any) -> dict[str, Any]:
        """The parts of a batch's loss, torch scalars."""

    def total(self, parts: dict[str, Any]) -> Any:
        """The weighted sum of the parts; plain unless weights are given."""
        return sum(parts.values())

    def train(self, count: int, tick: Callable[[float], None] | None = None) -> dict[str, float]:
        """Train `count` epochs or iterations; return the mean of each part of the loss; BadInput if not finite."""
        self.network.train()
        sums: dict[str, float] = {}
        weight = 0.0
        for _ in range(count):
            for step in self.steps():
                for group in self.optimiser.param_groups:
                    group["lr"] = step.learning_rate
                parts = self.losses(step.batch)
                self.optimiser.zero_grad(set_to_none=True)
                self.total(parts).backward()
                if math.isfinite(self.gradient_limit):
                    self.torch.nn.utils.clip_grad_norm_(self.network.parameters(), self.gradient_limit)
                self.optimiser.step()
                for name, part in parts.items():
                    sums[name] = sums.get(name, 0.0) + float(part.detach()) * step.weight
                weight += step.weight
                if tick is not None:
                    tick(step.progress)
            self.done += 1
        if not all(map(math.isfinite, sums.values())):
            raise BadInput("the training diverged (its loss is not finite); train with a lower learning rate.")
        return {name: value / weight for name, value in sums.items()}

    def forward(self, inputs: Any) -> Any:
        """The network's float32 result for a torch tensor."""
        mixed = self.torch.autocast(self.settings.device, dtype=self.torch.bfloat16)
        with mixed if self.settings.mixed else contextlib.nullcontext():
            made = self.network(inputs)
        return made.float()

    def run(self, images: FloatArray) -> FloatArray:
        """(N, n, H, W) or (n, H, W) through the network as it is, in single precision; sides fit the stride."""
        self.network.eval()
        with self.torch.no_grad():
            made = self.network(self.tensor(images if images.ndim == 4 else images[None])).float().cpu().numpy()
        return np.asarray(made if images.ndim == 4 else made[0], dtype=np.float32)

    def tensor(self, array: FloatArray) -> Any:
        """An array (N, n, H, W) as torch's tensor on the device."""
        tensor = self.torch.from_numpy(np.ascontiguousarray(array))
        return tensor.to(self.device, memory_format=self.torch.channels_last)

    def state(self) -> bytes:
        """Everything that is needed to go on from here."""
        buffer = io.BytesIO()
        document = {
            "settings": asdict(self.settings),
            self.counted: self.done,
            "curve": self.curve,
            "network": self.network.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "random": self.torch.get_rng_state(),
        }
        self.torch.save(document, buffer)
        return buffer.getvalue()

    def restore(self, state: bytes) -> None:
        """Go on from where `state` was taken; BadInput if it is damaged or of a training with other settings."""
        settings = asdict(self.settings)
        with refusing("the checkpoint is damaged; train anew in another folder."):
            document = self.torch.load(io.BytesIO(state), map_location=self.device, weights_only=True)
            network, optimiser, theirs = (document[name] for name in ("network", "optimiser", "settings"))
            curve, done = list(document["curve"]), int(document[self.counted])
            changed = [name for name in settings if name not in self.free and theirs.get(name) != settings[name]]
        require(
            not changed,
            f"the checkpoint is of a training with other settings ({', '.join(changed)}); "
            "resume with the same settings or train in another folder.",
        )
        self.network.load_state_dict(network)
        self.optimiser.load_state_dict(optimiser)
        if "random" in document:
            self.torch.set_rng_state(document["random"].cpu())
        self.done, self.curve = done, curve


def require_torch(settings: TrainerSettings) -> Any:
    """Torch, if it is installed and has the device of the settings."""
    torch = load_torch()
    require(
        settings.device != "cuda" or bool(torch.cuda.is_available()),
        "no GPU can be used by torch here; train with `device` cpu.",
    )
    return torch


@dataclass(frozen=True, slots=True)
class TrainingRun:
    """A training in its folder."""

    out: Path
    """Folder to write into; it must be new, unless `resume`."""
    resume: bool = False
    """Go on with the training in `out`."""
    command: str = ""
    """The command line that does this again, for the card."""
    progress: Progress = no_progress
    """Called with what is being done and the fraction of the whole that is done."""
    chart: Chart | None = None
    """Draws the learning curve as SVG; without it there is only the table."""


def files_of(network: str, photographed: str) -> dict[str, str]:
    """Files of a finished training, each with its description."""
    return {
        f"{network}.onnx": "the network",
        f"{network}.json": "its card",
        "curve.svg": "the learning curve",
        "curve.csv": "the same in numbers",
        "data": f"the {photographed}; may be deleted when the training is done",
        "checkpoint.pt": "to go on from; may be deleted as well",
    }


def open_folder(
    run: TrainingRun, data: DataclassInstance, settings: DataclassInstance, free: Sequence[str] = FREE
) -> None:
    """Make the folder, or check that it holds this training; settings named in `free` may differ from those there.
    Raises BadInput if it is a file or holds something else, a training not to be resumed, or one with other settings.
    """
    out = run.out
    wanted: Any = plain_json({"format": "splitknit-training", "data": data, "training": settings})
    file = out / "run.json"
    require(not out.exists() or out.is_dir(), f"'{out}' is a file; name a folder to train in.")
    if not out.is_dir() or not any(out.iterdir()):
        _write(file, json_text(wanted).encode())
        return
    require(file.is_file(), f"'{out}' is not empty and holds no training of splitknit; name another folder.")
    require(run.resume, f"'{out}' holds a training already; add `resume` to go on with it, or name another folder.")
    with refusing(f"'{file}' is damaged; train anew in another folder."):
        before = parse_json(read_bytes(file, _MAX_BYTES), str(file))
        changed = [
            f"{part}.{name}"
            for part in ("data", "training")
            for name in sorted(wanted[part])
            if before[part].get(name) != wanted[part][name] and name not in free
        ]
    require(
        not changed, f"the training in '{out}' has other settings ({', '.join(changed)}); resume with the same ones."
    )
    if before != wanted:
        _write(file, json_text(wanted).encode())


def _write(file: Path, content: bytes) -> None:
    """Write a file that is whole, on the disk, or absent."""
    with atomic_file(file) as stream:
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())


Subject = tuple[str, int]
"""What is photographed (``palm``, ``finger``; ``pieces`` of a finger), and its number."""
Sample = tuple[NDArray[Any], dict[str, Any]]
"""An array and its facts: a ``.npy`` and a ``.json`` file."""
Shoot = Callable[[str, int], Iterable[Sample]]
"""From a subject to its samples, one for each view; raises BadInput where the subject cannot be used."""
Fits = Callable[[tuple[int, ...], Mapping[str, Any]], bool]
"""Whether an array may have this shape beside these facts."""
_ONE_VIEW = ("",)


def make_data(
    run: TrainingRun, subjects: Sequence[Subject], shoot: Shoot, views: Sequence[str] = _ONE_VIEW, workers: int = 1
) -> list[str]:
    """Photograph the subjects that are not there yet; return those that cannot be used, with the reason. `views`:
    endings of the files' names, one for each photograph. By several `workers`, `shoot` is a function of a module.
    """
    names = {subject: [_name(run.out, *subject, view) for view in views] for subject in subjects}
    missing = [one for one in subjects if not all(name.with_suffix(".json").exists() for name in names[one])]
    run.progress("photographing", _DATA_PART * (len(subjects) - len(missing)) / len(subjects))
    work = functools.partial(_shoot, run.out, views, shoot)
    for left, _ in enumerate(run_jobs(work, missing, workers, f"what is in '{run.out}'"), 1 - len(missing)):
        run.progress("photographing", _DATA_PART * (len(subjects) + left) / len(subjects))
    found = [(number, _facts(files[0])) for (_, number), files in names.items()]
    return [f"{number}: {facts['refused']}" for number, facts in found if "refused" in facts]


def load_data(
    out: Path, kind: str, numbers: Iterable[int], fits: Fits, views: Sequence[str] = _ONE_VIEW
) -> dict[int, list[Sample]]:
    """Samples of the subjects that were not refused, by their numbers; mapped, as they may be larger than memory."""
    found: dict[int, list[Sample]] = {}
    for number in numbers:
        for view in views:
            name = _name(out, kind, number, view)
            facts = _facts(name)
            if "refused" in facts:
                continue
            file = name.with_suffix(".npy")
            remedy = "delete it and its .json, and resume."
            array = map_npy(file, f"'{file}' is damaged (no array of numbers); {remedy}")
            with refusing(f"'{file}' is damaged (it does not fit its .json); {remedy}"):
                sound = array.dtype == np.float16 and fits(array.shape, facts)
            require(sound, f"'{file}' is damaged (it holds {array.dtype} of the shape {array.shape}); {remedy}")
            found.setdefault(number, []).append((array, facts))
    return found


def require_subjects(count: int, purpose: str, refused: Sequence[str]) -> None:
    """Refuse a data set without subjects, with the reasons."""
    require(count > 0, f"not one finger to {purpose} could be used ({'; '.join(refused)}); take more fingers.")


def _shoot(out: Path, views: Sequence[str], shoot: Shoot, subject: Subject) -> None:
    kind, number = subject
    names = [_name(out, kind, number, view) for view in views]
    try:
        samples = list(shoot(kind, number))
    except BadInput as error:
        for name in names:
            _write(name.with_suffix(".json"), (json.dumps({"finger": number, "refused": str(error)}) + "\n").encode())
        return
    for name, (array, facts) in zip(names, samples, strict=True):
        buffer = io.BytesIO()
        np.save(buffer, array, allow_pickle=False)
        _write(name.with_suffix(".npy"), buffer.getvalue())
        _write(name.with_suffix(".json"), (json.dumps(facts) + "\n").encode())  # last: it marks both as complete


def _name(out: Path, kind: str, number: int, view: str) -> Path:
    return out / "data" / f"{kind}_{number:07d}{view}"


def _facts(name: Path) -> dict[str, Any]:
    file = name.with_suffix(".json")
    damaged = f"'{file}' is damaged; delete it and resume."
    facts, _ = read_json(file, damaged)
    require(isinstance(facts, dict), damaged)
    return dict(facts)


Entry = dict[str, float]
"""An entry of the learning curve."""


@dataclass(frozen=True, slots=True)
class LearningCurve:
    """What is measured during a training, and drawn."""

    stretch: int  # epochs or iterations between two entries
    judge: Callable[[], Entry]  # figures of the network as it is on held-out data
    lines: Mapping[str, Callable[[Entry], float]]  # lines of the chart by their names: from an entry to a value
    unit: str  # unit of these values


def train_in_folder(run: TrainingRun, trainer: Trainer, end: int, curve: LearningCurve) -> None:
    """Train to the end, from the folder's checkpoint if there is one; keep checkpoint and curve."""
    out, progress = run.out, run.progress
    checkpoint = out / "checkpoint.pt"
    if checkpoint.exists():
        trainer.restore(read_bytes(checkpoint, _MAX_BYTES))
    while trainer.done < end:
        started = time.perf_counter()
        count = min(curve.stretch, end - trainer.done)
        doing = f"{trainer.counted} {trainer.done + count} of {end}"

        def tick(done: float, doing: str = doing) -> None:
            progress(doing, _DATA_PART + (1 - _DATA_PART) * done)

        parts = trainer.train(count, tick)
        figures = {f"held_out_{name}": value for name, value in curve.judge().items()}
        seconds = time.perf_counter() - started
        trainer.curve.append({trainer.counted: trainer.done, **parts, **figures, "seconds": seconds})
        _write(checkpoint, trainer.state())
        rows = [list(trainer.curve[0]), *(entry.values() for entry in trainer.curve)]
        _write(out / "curve.csv", csv_text(rows).encode())
        if run.chart is not None and len(trainer.curve) > 1:
            drawn = {name: [value(entry) for entry in trainer.curve] for name, value in curve.lines.items()}
            x = [entry[trainer.counted] for entry in trainer.curve]
            _write(out / "curve.svg", run.chart(x, drawn, trainer.counted, curve.unit))


@dataclass(frozen=True, slots=True)
class NetworkKind:
    """A network by its name, and what it turns into what."""

    name: str
    what: str
    channels: tuple[int, int]  # channels of input and output


def packed(
    kind: NetworkKind, network: Any, architecture: str, depth: int, facts: Mapping[str, Any]
) -> tuple[bytes, bytes]:
    """The files of a finished network: ONNX, with weights in half precision, and card with `facts`.
    `architecture`: of the U-Net, in words; `depth`: times that it halves the scale.
    """
    weights = export_onnx(network, kind.channels[0], 2**depth)
    head = {
        "channels_in": kind.channels[0],
        "channels_out": kind.channels[1],
        "stride": 2**depth,
        "reach": unet_reach(depth),
        "what": kind.what,
        "architecture": architecture,
        "licence": "Apache-2.0",
        "software": f"splitknit {provenance()['version']}",
    }
    return weights, card_bytes(kind.name, weights, {**head, **facts})


def write_network(
    out: Path, name: str, files: tuple[bytes, bytes], run: Callable[[FloatArray], FloatArray], probe: FloatArray
) -> dict[str, Any]:
    """Write network and card; check that onnxruntime computes what torch does on `probe` (1, n, H, W). Returns the
    card, the weights' bytes, and the difference relative to the output's range.
    """
    file = out / f"{name}.onnx"
    for path, content in zip((file, file.with_suffix(".json")), files, strict=True):
        _write(path, content)
    network = network_of(*read_network(file))
    made, wanted = run_network(network, probe), run(probe)
    difference = float(np.abs(made - wanted).max() / max(float(np.abs(wanted).max()), 1e-6))
    require(
        difference < _MAX_DIFFERENCE,
        f"the exported network differs from the trained one by {100 * difference:.2g} %; report this.",
    )
    return {**network.card.facts, "bytes": len(files[0]), "onnx_difference": difference}
