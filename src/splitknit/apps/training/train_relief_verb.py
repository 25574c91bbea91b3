"""The command line of ``splitknit train relief``: options in, settings out."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

Progress = Callable[[str, float], None]
Counts = tuple[tuple[str, int, str], ...]
"""Name, default and meaning of the whole numbers among the options."""
_COUNTS = (
    ("fingers", 160, "simulated fingers to take pieces of, about 35 MB each on disk"),
    ("crops", 5, "pieces of each, every one with its own skin, lights and exposure"),
    ("whole_fingers", 116, "fingers to train on as a whole, about 60 MB each on disk"),
    ("held_out", 6, "further whole ones, for the learning curve and the card"),
    ("first", 7000, "number of the first finger for pieces; everything about a finger follows from its number"),
    ("first_whole", 5000, "number of the first whole finger"),
    ("iterations", 7200, "corrections of the weights"),
    ("batch", 6, "patches of each"),
    ("patch", 192, "side of a patch in pixels"),
    ("seed", 0, "of weights and patches"),
    ("threads", 1, "of torch on the processor; repeatable for a fixed number"),
)


def add_relief_options(verb: argparse.ArgumentParser) -> None:
    """Add the options of ``splitknit train relief``; the defaults are what the shipped network saw in all."""
    add_training_options(verb, _COUNTS)


def add_training_options(verb: argparse.ArgumentParser, counts: Counts) -> None:
    """Add the options of the training of one of `metric`'s networks."""
    verb.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="folder to train in; new, or with --resume"
    )
    verb.add_argument("--resume", action="store_true", help="go on with the training in DIR")
    for name, default, words in counts:
        option = f"--{name.replace('_', '-')}"
        verb.add_argument(option, type=int, default=default, metavar="N", help=f"{words} (default: {default})")
    verb.add_argument("--device", choices=("cpu", "cuda"), default="cpu", help="default: cpu")
    verb.add_argument(
        "--precision",
        choices=("mixed", "float32"),
        default="mixed",
        help="mixed (default): products in half precision",
    )


def training_settings(options: argparse.Namespace) -> dict[str, Any]:
    """Settings of a training as the options of :func:`add_training_options` give them."""
    names = ("iterations", "batch", "seed", "device", "threads", "precision")
    return {"patch_px": options.patch, **{name: getattr(options, name) for name in names}}


def written(out: Path, files: Mapping[str, str]) -> list[str]:
    """What a training has left in its folder, in words."""
    return ["Written:", *(f"  {out / name}: {what}" for name, what in files.items() if (out / name).exists())]


def run_relief(options: argparse.Namespace, progress: Progress) -> tuple[dict[str, Any], list[str]]:
    """Train, and say what came out."""
    from splitknit.apps.training.relief_scenes import ReliefData  # noqa: PLC0415 - only this verb pays for it
    from splitknit.apps.training.train_relief import FILES, train_relief  # noqa: PLC0415
    from splitknit.training.relief import ReliefSettings  # noqa: PLC0415

    names = ("fingers", "crops", "whole_fingers", "held_out", "first", "first_whole")
    data = ReliefData(**{name: getattr(options, name) for name in names})
    settings = ReliefSettings(**training_settings(options))
    command = relief_command(options)
    facts = train_relief(options.out, data, settings, resume=options.resume, command=command, progress=progress)
    mean = facts["metrics"]["mean"]
    used = facts["data"]
    lines = [
        f"A network was trained for {settings.iterations} iterations in {facts['total_s']:.0f} s "
        f"(pieces: {used['pieces_used']}; whole fingers: {used['whole_fingers_used']}; refused: {facts['refused']}).",
        "Held out: " + ", ".join(_figures(mean)) + ".",
    ]
    return facts, lines + written(options.out, FILES)


def relief_command(options: argparse.Namespace) -> str:
    """The command line that does this again, every option written out, for the network's card."""
    return command_line(options, "relief", _COUNTS)


def command_line(options: argparse.Namespace, network: str, counts: Counts) -> str:
    """The command line of the training of a network, every option written out."""
    words = ["splitknit", "train", network, "--out", "DIR"]
    for name in (*(name for name, _, _ in counts), "device", "precision"):
        words += [f"--{name.replace('_', '-')}", str(getattr(options, name))]
    return shlex.join(words)


def _figures(mean: dict[str, float | None]) -> list[str]:
    """Those figures that there are, in words."""
    words = {
        "correlation": "ridge correlation {:.3f}",
        "gain": "gain {:.2f}",
        "rms_um": "error {:.1f} µm",
        "glare_r2": "{:.2f} of the glare's power explained",
    }
    return [text.format(value) for name, text in words.items() if (value := mean[name]) is not None]
