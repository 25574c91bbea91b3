"""``splitknit train separation | relief | shape``: options in, settings out."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from splitknit.cli.verb import Outcome, Progress, group, new_verb

Number = tuple[str, float, str]
"""Name, default and meaning of an option; a whole number where its default is one."""

_SEPARATION_DATA: tuple[Number, ...] = (
    ("palms", 50, "simulated palms"),
    ("fingers", 0, "simulated fingers beside them"),
    ("views", 1, "photographs of each, under other light and with other optics of the skin"),
    ("patches", 750, "patches of 72 x 72 pixels of each photograph"),
    ("check_mm", 0.42, "side of the checks that direct light is defined with"),
    ("held_out", 4, "palms, and as many fingers, set apart for the learning curve"),
)
_SEPARATION: tuple[Number, ...] = (
    ("width", 64, "channels of the first block; the cost grows with its square"),
    ("epochs", 50, "times that every patch is seen"),
    ("dropout", 0.5, "fraction dropped in the deepest blocks while training"),
    ("decay", 0.0, "last part of the training over which the learning rate falls to zero"),
    ("start_fraction", 0.0, "fraction of its image that the untrained network gives"),
    ("border", 0, "pixels at a patch's border that the loss leaves out"),
    ("seed", 0, "of data, weights and order"),
    ("threads", 1, "of the processor; repeatable for a fixed number"),
)
_RELIEF_DATA: tuple[Number, ...] = (
    ("fingers", 160, "simulated fingers to take pieces of, about 35 MB each on disk"),
    ("crops", 5, "pieces of each, every one with its own skin, lights and exposure"),
    ("whole_fingers", 116, "fingers to train on as a whole, about 60 MB each on disk"),
    ("held_out", 6, "further whole ones, for the learning curve and the card"),
    ("first", 7000, "number of the first finger for pieces; everything about a finger follows from its number"),
    ("first_whole", 5000, "number of the first whole finger"),
)
_RELIEF: tuple[Number, ...] = (
    ("iterations", 7200, "corrections of the weights"),
    ("batch", 6, "patches of each"),
    ("patch", 192, "side of a patch in pixels"),
    ("seed", 0, "of weights and patches"),
    ("threads", 1, "of torch on the processor; repeatable for a fixed number"),
)
_SHAPE_DATA: tuple[Number, ...] = (
    ("fingers", 160, "simulated fingers to train on, about 4 MB each on disk"),
    ("held_out", 8, "further ones, for the learning curve and the card"),
    ("first", 5000, "number of the first finger; everything about a finger follows from its number"),
)
_SHAPE: tuple[Number, ...] = (
    ("iterations", 6000, "corrections of the weights"),
    ("batch", 8, "patches of each"),
    ("patch", 160, "side of a patch in pixels of the coarse grid"),
    ("seed", 0, "of weights and patches"),
    ("threads", 1, "of torch on the processor; repeatable for a fixed number"),
)


def add_train(verbs: Any) -> None:
    """Add ``splitknit train`` with its kinds; the defaults are the thesis's, or what the shipped networks saw."""
    kinds = group(verbs, "train", "train a network on simulated skin (needs torch)")
    verb = new_verb(kinds, "separation", "the thesis's U-Net, which separates direct light", _run_separation)
    _add_folder(verb)
    data = verb.add_argument_group("data set")
    _add_numbers(data, _SEPARATION_DATA)
    data.add_argument(
        "--labels",
        choices=("stack", "truth"),
        default="stack",
        help="direct light from 25 shifted checkerboards (stack, the default), or the twin's own, ten times faster",
    )
    training = verb.add_argument_group("network and training")
    _add_numbers(training, _SEPARATION)
    _add_machine(training, ("auto", "float32", "mixed"), "mixed: products in half precision; auto (default): on a GPU")
    for name, does, run, numbers in (
        ("relief", "the network of the preset metric for relief and glare", _run_relief, _RELIEF_DATA + _RELIEF),
        ("shape", "the network of the preset metric that corrects the shape", _run_shape, _SHAPE_DATA + _SHAPE),
    ):
        verb = new_verb(kinds, name, does, run)
        _add_folder(verb)
        _add_numbers(verb, numbers)
        _add_machine(verb, ("mixed", "float32"), "mixed (default): products in half precision")


def _add_folder(verb: argparse.ArgumentParser) -> None:
    verb.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="folder to train in; new, or with --resume"
    )
    verb.add_argument("--resume", action="store_true", help="go on with the training in DIR")


def _add_numbers(place: Any, numbers: Sequence[Number]) -> None:
    for name, default, meaning in numbers:
        option = f"--{name.replace('_', '-')}"
        help_line = f"{meaning} (default: {default})"
        place.add_argument(option, type=type(default), default=default, metavar="N", help=help_line)


def _add_machine(place: Any, precisions: Sequence[str], meaning: str) -> None:
    place.add_argument("--device", choices=("cpu", "cuda"), default="cpu", help="default: cpu")
    place.add_argument("--precision", choices=precisions, default=precisions[0], help=meaning)


def _command_line(options: argparse.Namespace, network: str) -> str:
    """The command line that trains this network again, every option written out, for its card."""
    numbers: dict[str, tuple[Number, ...]] = {
        "separation": (*_SEPARATION_DATA, ("labels", 0, ""), *_SEPARATION),
        "relief": _RELIEF_DATA + _RELIEF,
        "shape": _SHAPE_DATA + _SHAPE,
    }
    words = ["splitknit", "train", network, "--out", "DIR"]
    for name in (*(option[0] for option in numbers[network]), "device", "precision"):
        value = getattr(options, name)
        words += [f"--{name.replace('_', '-')}", f"{value:g}" if isinstance(value, float) else str(value)]
    return shlex.join(words)


def _chosen(options: argparse.Namespace, numbers: Sequence[Number], *others: str) -> dict[str, Any]:
    """Settings as the options give them."""
    renamed = {"border": "border_px", "patch": "patch_px"}
    names = (*(option[0] for option in numbers), *others)
    return {renamed.get(name, name): getattr(options, name) for name in names}


def _run_separation(options: argparse.Namespace) -> Outcome:
    """Build the data set and train the network for direct light."""
    from splitknit.training import separation  # only these verbs pay for it
    from splitknit.training.separation_data import SeparationData

    data = SeparationData(**_chosen(options, _SEPARATION_DATA, "labels"))
    settings = separation.SeparationSettings(**_chosen(options, _SEPARATION, "device", "precision"))
    facts = _train(separation.train_separation, options, "separation", data, settings)
    metrics = facts["metrics"]
    lines = [
        f"A network of width {options.width} was trained for {options.epochs} epochs in {facts['total_s']:.0f} s.",
        f"Held out: {metrics['psnr_linear_db']:.1f} dB on linear images, "
        f"{metrics['psnr_enhanced_db']:.1f} dB on enhanced ones.",
    ]
    return facts, lines + _written(options.out, separation.FILES)


def _run_relief(options: argparse.Namespace) -> Outcome:
    """Simulate the fingers and train the network for relief and glare."""
    from splitknit.training import relief
    from splitknit.training.fields import train_fields
    from splitknit.training.relief_data import ReliefData

    data = ReliefData(**_chosen(options, _RELIEF_DATA))
    settings = relief.ReliefSettings(**_chosen(options, _RELIEF, "device", "precision"))
    facts = _train(partial(train_fields, task=relief.TASK), options, "relief", data, settings)
    used, mean = facts["data"], facts["metrics"]["mean"]
    formats = {
        "correlation": "ridge correlation {:.3f}",
        "gain": "gain {:.2f}",
        "rms_um": "error {:.1f} µm",
        "glare_r2": "{:.2f} of the glare's power explained",
    }
    figures = [text.format(value) for name, text in formats.items() if (value := mean[name]) is not None]
    lines = [
        f"A network was trained for {settings.iterations} iterations in {facts['total_s']:.0f} s "
        f"(pieces: {used['pieces_used']}; whole fingers: {used['whole_fingers_used']}; refused: {facts['refused']}).",
        "Held out: " + ", ".join(figures) + ".",
    ]
    return facts, lines + _written(options.out, relief.FILES)


def _run_shape(options: argparse.Namespace) -> Outcome:
    """Simulate and reconstruct the fingers, and train the network that refines the shape."""
    from splitknit.training import shape
    from splitknit.training.fields import train_fields
    from splitknit.training.shape_data import ShapeData

    data = ShapeData(**_chosen(options, _SHAPE_DATA))
    settings = shape.ShapeNetSettings(**_chosen(options, _SHAPE, "device", "precision"))
    facts = _train(partial(train_fields, task=shape.TASK), options, "shape", data, settings)
    mean = facts["metrics"]["mean"]
    lines = [
        f"A network was trained for {settings.iterations} iterations in {facts['total_s']:.0f} s "
        f"(fingers: {facts['data']['fingers_used']}; refused: {facts['refused']})."
    ]
    if None not in mean.values():
        lines.append(
            f"Held out: error of a slope {mean['before']:.3f} before mending, {mean['after']:.3f} after; "
            f"of wide slopes {mean['wide_before']:.3f} and {mean['wide_after']:.3f}."
        )
    return facts, lines + _written(options.out, shape.FILES)


def _train(
    train: Callable[..., dict[str, Any]], options: argparse.Namespace, network: str, data: Any, settings: Any
) -> dict[str, Any]:
    from splitknit.training.trainer import TrainingRun

    with Progress(options) as progress:
        run = TrainingRun(options.out, options.resume, _command_line(options, network), progress.update, _curve_svg)
        return train(run, data=data, settings=settings)


def _written(out: Path, files: Mapping[str, str]) -> list[str]:
    """The files that a training left in its folder."""
    return ["Written:", *(f"  {out / name}: {what}" for name, what in files.items() if (out / name).exists())]


def _curve_svg(x: Sequence[float], lines: Mapping[str, Sequence[float]], x_label: str, y_label: str) -> bytes:
    """A learning curve as an SVG file."""
    import numpy as np

    from splitknit.report.charts import Curve, profile_chart, standalone

    drawn = [Curve(name, np.array(x, dtype=np.float64), np.array(y)) for name, y in lines.items()]
    return standalone(profile_chart(drawn, x_label, y_label))
