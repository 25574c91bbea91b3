"""The command line of ``splitknit train``: options in, settings out."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

Progress = Callable[[str, float], None]


def add_separation_options(verb: argparse.ArgumentParser) -> None:
    """Add the options of ``splitknit train separation``; the defaults are the thesis's."""
    verb.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="folder to train in; new, or with --resume"
    )
    verb.add_argument("--resume", action="store_true", help="go on with the training in DIR")
    data = verb.add_argument_group("data set")
    _number(data, "--palms", 50, int, "simulated palms")
    _number(data, "--fingers", 0, int, "simulated fingers beside them")
    _number(data, "--views", 1, int, "photographs of each, under other light and with other optics of the skin")
    _number(data, "--patches", 750, int, "patches of 72 x 72 pixels of each photograph")
    _number(data, "--check-mm", 0.42, float, "side of the checks that direct light is defined with")
    _number(data, "--held-out", 4, int, "palms, and as many fingers, set apart for the learning curve")
    data.add_argument(
        "--labels",
        choices=("stack", "truth"),
        default="stack",
        help="direct light from 25 shifted checkerboards (stack, the default), or the twin's own, ten times faster",
    )
    training = verb.add_argument_group("network and training")
    _number(training, "--width", 64, int, "channels of the first block; the cost grows with its square")
    _number(training, "--epochs", 50, int, "times that every patch is seen")
    _number(training, "--dropout", 0.5, float, "share dropped in the deepest blocks while training")
    _number(training, "--decay", 0.0, float, "last part of the training over which the learning rate falls to zero")
    _number(training, "--start-fraction", 0.0, float, "fraction of its image that the untrained network gives")
    _number(training, "--border", 0, int, "pixels at a patch's border that the loss leaves out")
    _number(training, "--seed", 0, int, "of data, weights and order")
    training.add_argument("--device", choices=("cpu", "cuda"), default="cpu", help="default: cpu")
    _number(training, "--threads", 1, int, "of the processor; repeatable for a fixed number")
    training.add_argument(
        "--precision",
        choices=("auto", "float32", "mixed"),
        default="auto",
        help="mixed: products in half precision; auto (default): mixed on a GPU",
    )


def run_separation(options: argparse.Namespace, progress: Progress) -> tuple[dict[str, Any], list[str]]:
    """Train, and say what came out."""
    from splitknit.apps.training.train import FILES, train_separation  # noqa: PLC0415 - only this verb pays for it
    from splitknit.training.train import DataSettings, TrainSettings  # noqa: PLC0415

    data = DataSettings(
        palms=options.palms,
        fingers=options.fingers,
        views=options.views,
        patches=options.patches,
        labels=options.labels,
        check_mm=options.check_mm,
        held_out=options.held_out,
    )
    settings = TrainSettings(
        width=options.width,
        dropout=options.dropout,
        start_fraction=options.start_fraction,
        epochs=options.epochs,
        decay=options.decay,
        border_px=options.border,
        seed=options.seed,
        device=options.device,
        threads=options.threads,
        precision=options.precision,
    )
    facts = train_separation(
        options.out,
        data,
        settings,
        resume=options.resume,
        command=command_of(options),
        progress=progress,
    )
    metrics = facts["metrics"]
    lines = [
        f"A network of width {options.width} was trained for {options.epochs} epochs in {facts['total_s']:.0f} s.",
        f"Held out: {metrics['psnr_linear_db']:.1f} dB on linear images, "
        f"{metrics['psnr_enhanced_db']:.1f} dB on enhanced ones.",
        "Written:",
    ]
    lines += [f"  {options.out / name}: {what}" for name, what in FILES.items() if (options.out / name).exists()]
    return facts, lines


def command_of(options: argparse.Namespace) -> str:
    """The command line that does this again, every option written out, for the network's card."""
    words = ["splitknit", "train", "separation", "--out", "DIR"]
    for name in (
        "palms",
        "fingers",
        "views",
        "patches",
        "check_mm",
        "held_out",
        "labels",
        "width",
        "epochs",
        "dropout",
        "decay",
        "start_fraction",
        "border",
        "seed",
        "device",
        "threads",
        "precision",
    ):
        value = getattr(options, name)
        words += [f"--{name.replace('_', '-')}", f"{value:g}" if isinstance(value, float) else str(value)]
    return shlex.join(words)


def _number(group: Any, name: str, default: float, kind: type, words: str) -> None:
    group.add_argument(name, type=kind, default=default, metavar="N", help=f"{words} (default: {default})")
