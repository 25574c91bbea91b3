"""What ``splitknit train relief`` does: fingers, training, learning curve, network and card, in one folder.

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

from splitknit.apps.training.relief_crops import training_crops
from splitknit.apps.training.relief_data import training_sample
from splitknit.apps.training.relief_scenes import ReliefData
from splitknit.apps.training.training_card import mean_figures, rounded, runner_of, stride_of, write_files
from splitknit.apps.training.training_data import HELD_OUT_FROM, load_data, make_data, require_fingers
from splitknit.apps.training.training_folder import Progress, files_of, open_folder
from splitknit.apps.training.training_stretches import DATA_PART, train_in_stretches
from splitknit.skin.learned import RELIEF_MM
from splitknit.training.network import load_torch
from splitknit.training.relief import (
    CHANNELS,
    JUDGED_PX,
    NAME,
    ReliefSettings,
    ReliefTrainer,
    Sample,
    judge_middle,
    packed,
)

FILES = files_of(NAME, "fingers")


def train_relief(
    out: Path,
    data: ReliefData,
    settings: ReliefSettings,
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
        if kind == "finger":
            return training_sample(number, data)
        pieces = training_crops(number, data)
        return pieces, {"finger": number, "pieces": len(pieces)}

    def whole_fits(shape: tuple[int, ...]) -> bool:
        return len(shape) == 3 and shape[0] == CHANNELS and min(shape) >= settings.stride

    pieces, whole, held_out = _numbers(data)
    kinds = [*(("pieces", number) for number in pieces), *(("finger", number) for number in (*whole, *held_out))]
    refused = make_data(out, kinds, photograph, lambda share: progress("photographing", DATA_PART * share))
    crops = [crop for many in load_data(out, "pieces", pieces, lambda s: whole_fits(s[1:])).values() for crop in many]
    fingers, judges = (load_data(out, "finger", numbers, whole_fits) for numbers in (whole, held_out))
    require_fingers(len(crops), "train on", refused)
    require_fingers(len(judges), "judge the network on", refused)
    trainer = ReliefTrainer(settings, crops, list(fingers.values()))
    lines = {
        "training": lambda entry: UNIT_UM * math.sqrt(entry["relief"]),
        "held out": lambda entry: UNIT_UM * entry["held_out_rms"],
    }
    train_in_stretches(out, trainer, settings, judges, progress=progress, lines=lines, unit="error of the relief, µm")
    progress("exporting", 1.0)
    facts = {
        "command": command,
        "training": {**asdict(settings), "iterations_done": trainer.iteration},
        "data": {
            **asdict(data),
            "pieces_used": len(crops),
            "whole_fingers_used": len(fingers),
            "fingers_refused": len(refused),
        },
        "metrics": network_metrics(trainer.network.state_dict(), judges),
    }
    written = write_network(out, trainer.network.state_dict(), facts)
    return {**written, "refused": len(refused), "out": str(out), "total_s": time.perf_counter() - started}


def _numbers(data: ReliefData) -> tuple[range, range, range]:
    """Numbers of the fingers to take pieces of, of the whole ones, and of those held out."""
    return (
        range(data.first, data.first + data.fingers),
        range(data.first_whole, data.first_whole + data.whole_fingers),
        range(HELD_OUT_FROM, HELD_OUT_FROM + data.held_out),
    )


# Network and card of the relief as files, and what the card says of how good the network is.

UNIT_UM = 1000.0 * float(RELIEF_MM)
"""Unit of the network's relief, micrometres."""


def write_network(out: Path, state: Mapping[str, Any], facts: Mapping[str, Any]) -> dict[str, Any]:
    """Write network and card of a training's ``state_dict``, as :func:`write_files` does."""
    return write_files(out, NAME, state, facts, packed)


def network_metrics(state: Mapping[str, Any], samples: Mapping[int, Sample]) -> dict[str, Any]:
    """What a card says of how a network does on fingers that it was not trained on.

    Parameters
    ----------
    state : torch's ``state_dict`` of the network
    samples : fingers (41, h, w) by their numbers

    Returns
    -------
    dict with the figures of each finger, see :func:`splitknit.training.relief.judged`, and their means
    """
    run, stride = runner_of(state), stride_of(state)
    figures = {number: judge_middle(run, sample, stride) for number, sample in samples.items()}

    def in_um(entry: Mapping[str, float]) -> dict[str, float | None]:
        others = {name: value for name, value in entry.items() if name != "rms"}
        return rounded({**others, "rms_um": UNIT_UM * entry["rms"]})

    return {
        "held_out": f"{len(figures)} simulated fingers not trained on, drawn from the same ranges; the middle "
        f"{JUDGED_PX} x {JUDGED_PX} pixels, on the smooth shape they would be trained on",
        "mean": in_um(mean_figures(list(figures.values()))),
        "fingers": [{"finger": number, **in_um(entry)} for number, entry in figures.items()],
    }
