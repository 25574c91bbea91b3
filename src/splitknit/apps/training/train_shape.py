"""What ``splitknit train shape`` does: fingers, training, learning curve, network and card, in one folder.

The folder grows as the work goes on, every file whole or not there, so that an interrupted training is taken up where
it stopped: fingers one by one, the network some hundred iterations at a time.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.apps.training.shape_data import shape_sample
from splitknit.apps.training.shape_scenes import ShapeData
from splitknit.apps.training.training_card import mean_figures, rounded, runner_of, stride_of, write_files
from splitknit.apps.training.training_data import HELD_OUT_FROM, load_data, make_data, require_fingers
from splitknit.apps.training.training_folder import Progress, files_of, open_folder
from splitknit.apps.training.training_stretches import DATA_PART, train_in_stretches
from splitknit.skin.learned import SHAPE_SLOPE
from splitknit.training.network import load_torch
from splitknit.training.shape import (
    CHANNELS,
    JUDGED_WIDE_PX,
    NAME,
    Sample,
    ShapeSettings,
    ShapeTrainer,
    judge_whole,
    packed,
)

FILES = files_of(NAME, "fingers")


def train_shape(
    out: Path,
    data: ShapeData,
    settings: ShapeSettings,
    *,
    resume: bool = False,
    command: str = "",
    progress: Progress = lambda stage, share: None,
) -> dict[str, Any]:
    """Simulate the fingers and train; return what came out.

    Parameters
    ----------
    out : folder to write into; it must be new, unless `resume`
    data, settings : what to train on, and how
    resume : go on with the training in `out`
    command : the command line that does this again, for the card
    progress : hears what is being done and the share of the whole that is done

    Raises
    ------
    BadInput
        If torch is missing, `out` is in use, what is there does not fit the settings, or no finger can be used.
    """
    started = time.perf_counter()
    load_torch()
    open_folder(out, data, settings, resume)

    def photograph(kind: str, number: int) -> tuple[NDArray[np.float16], dict[str, Any]]:
        return shape_sample(number, data)

    def fits(shape: tuple[int, ...]) -> bool:
        return len(shape) == 3 and shape[0] == CHANNELS and min(shape) >= settings.stride

    numbers = range(data.first, data.first + data.fingers), range(HELD_OUT_FROM, HELD_OUT_FROM + data.held_out)
    subjects = [("finger", number) for part in numbers for number in part]
    refused = make_data(out, subjects, photograph, lambda share: progress("photographing", DATA_PART * share))
    fingers, judges = (load_data(out, "finger", part, fits) for part in numbers)
    require_fingers(len(fingers), "train on", refused)
    require_fingers(len(judges), "judge the network on", refused)
    trainer = ShapeTrainer(settings, list(fingers.values()))
    lines = {
        "training": lambda entry: UNIT * math.sqrt(entry["slope"] / 2),  # of one slope
        "held out": lambda entry: UNIT * entry["held_out_after"],
        "held out, before": lambda entry: UNIT * entry["held_out_before"],
    }
    train_in_stretches(out, trainer, settings, judges, progress=progress, lines=lines, unit="error of a slope")
    progress("exporting", 1.0)
    facts = {
        "command": command,
        "training": {**asdict(settings), "iterations_done": trainer.iteration},
        "data": {**asdict(data), "fingers_used": len(fingers), "fingers_refused": len(refused)},
        "metrics": shape_metrics(trainer.network.state_dict(), judges),
    }
    written = write_shape_network(out, trainer.network.state_dict(), facts)
    return {**written, "refused": len(refused), "out": str(out), "total_s": time.perf_counter() - started}


# Network and card of what mends the shape as files, and what the card says of how good the network is.

UNIT = float(SHAPE_SLOPE)
"""Unit of the network's slopes."""


def write_shape_network(out: Path, state: Mapping[str, Any], facts: Mapping[str, Any]) -> dict[str, Any]:
    """Write network and card of a training's ``state_dict``, as :func:`write_files` does."""
    return write_files(out, NAME, state, facts, packed)


def shape_metrics(state: Mapping[str, Any], samples: Mapping[int, Sample]) -> dict[str, Any]:
    """What a card says of how a network does on fingers that it was not trained on.

    Parameters
    ----------
    state : torch's ``state_dict`` of the network
    samples : fingers (35, h, w) by their numbers

    Returns
    -------
    dict with the figures of each finger, see :func:`splitknit.training.shape.judged`, as slopes, and their means
    """
    run, stride = runner_of(state), stride_of(state)
    figures = {
        number: {name: UNIT * value for name, value in judge_whole(run, sample, stride).items()}
        for number, sample in samples.items()
    }
    return {
        "held_out": f"{len(figures)} simulated fingers not trained on, drawn from the same ranges: error of the "
        "shape's slopes (rms of one slope, steep parts count less) before and after mending, and of their means over "
        f"{JUDGED_WIDE_PX} x {JUDGED_WIDE_PX} pixels of the coarse grid",
        "mean": rounded(mean_figures(list(figures.values()))),
        "fingers": [{"finger": number, **rounded(entry)} for number, entry in figures.items()],
    }
