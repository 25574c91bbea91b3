"""The command line of ``splitknit train shape``: options in, settings out."""

from __future__ import annotations

import argparse
from typing import Any

from splitknit.apps.training.train_relief_verb import (
    Progress,
    add_training_options,
    command_line,
    training_settings,
    written,
)

_COUNTS = (
    ("fingers", 160, "simulated fingers to train on, about 4 MB each on disk"),
    ("held_out", 8, "further ones, for the learning curve and the card"),
    ("first", 5000, "number of the first finger; everything about a finger follows from its number"),
    ("iterations", 6000, "corrections of the weights"),
    ("batch", 8, "patches of each"),
    ("patch", 160, "side of a patch in pixels of the coarse grid"),
    ("seed", 0, "of weights and patches"),
    ("threads", 1, "of torch on the processor; repeatable for a fixed number"),
)


def add_shape_options(verb: argparse.ArgumentParser) -> None:
    """Add the options of ``splitknit train shape``; the defaults are what the shipped network saw in all."""
    add_training_options(verb, _COUNTS)


def run_shape(options: argparse.Namespace, progress: Progress) -> tuple[dict[str, Any], list[str]]:
    """Train, and say what came out."""
    from splitknit.apps.training.shape_scenes import ShapeData  # noqa: PLC0415 - only this verb pays for it
    from splitknit.apps.training.train_shape import FILES, train_shape  # noqa: PLC0415
    from splitknit.training.shape import ShapeSettings  # noqa: PLC0415

    data = ShapeData(fingers=options.fingers, held_out=options.held_out, first=options.first)
    settings = ShapeSettings(**training_settings(options))
    command = shape_command(options)
    facts = train_shape(options.out, data, settings, resume=options.resume, command=command, progress=progress)
    mean = facts["metrics"]["mean"]
    lines = [
        f"A network was trained for {settings.iterations} iterations in {facts['total_s']:.0f} s "
        f"(fingers: {facts['data']['fingers_used']}; refused: {facts['refused']}).",
    ]
    if None not in mean.values():
        lines.append(
            f"Held out: error of a slope {mean['before']:.3f} before mending, {mean['after']:.3f} after; "
            f"of wide slopes {mean['wide_before']:.3f} and {mean['wide_after']:.3f}."
        )
    return facts, lines + written(options.out, FILES)


def shape_command(options: argparse.Namespace) -> str:
    """The command line that does this again, every option written out, for the network's card."""
    return command_line(options, "shape", _COUNTS)
