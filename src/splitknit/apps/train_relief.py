"""What ``splitknit train relief`` does: fingers, training, learning curve, network and card, in one folder.

The folder grows as the work goes on, every file whole or not there, so that an interrupted training is taken up where
it stopped: fingers one by one, the network some hundred iterations at a time.
"""

from __future__ import annotations

import io
import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.apps.charts import Line
from splitknit.apps.relief_card import UNIT_UM, mean_figures, network_metrics, write_network
from splitknit.apps.relief_crops import training_crops
from splitknit.apps.relief_data import training_sample
from splitknit.apps.relief_scenes import ReliefData
from splitknit.apps.training_folder import (
    Progress,
    curve_chart,
    curve_table,
    open_folder,
    read_file,
    write_file,
)
from splitknit.check import BadInput, require
from splitknit.separate.train_network import load_torch
from splitknit.separate.train_relief import CHANNELS, NAME, ReliefSettings, ReliefTrainer

HELD_OUT_FROM = 1_000_000
"""Fingers from this number on are never trained on."""
DATA_PART = 0.4
"""Of the progress bar."""
FILES = {
    f"{NAME}.onnx": "the network",
    f"{NAME}.json": "its card",
    "curve.svg": "the learning curve",
    "curve.csv": "the same in numbers",
    "data": "the fingers; may be deleted when the training is done",
    "checkpoint.pt": "to go on from; may be deleted as well",
}
Samples = dict[int, NDArray[np.float16]]
Subject = tuple[str, int]
"""``pieces`` or ``finger``, and its number."""


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
    pieces, whole, held_out = _numbers(data)
    kinds = [*(("pieces", number) for number in pieces), *(("finger", number) for number in (*whole, *held_out))]
    refused = make_data(out, kinds, data, lambda share: progress("photographing", DATA_PART * share))
    crops = [crop for many in _load(out, "pieces", pieces, settings).values() for crop in many]
    fingers, judges = (_load(out, "finger", numbers, settings) for numbers in (whole, held_out))
    for count, words in ((len(crops), "train on"), (len(judges), "judge the network on")):
        require(
            count > 0,
            f"not one finger to {words} could be used ({'; '.join(refused)}); take more fingers.",
        )
    trainer = ReliefTrainer(settings, crops, list(fingers.values()))
    checkpoint = out / "checkpoint.pt"
    if checkpoint.exists():
        trainer.restore(read_file(checkpoint))
    while trainer.iteration < settings.iterations:
        stretch_started = time.perf_counter()
        count = min(settings.report_every, settings.iterations - trainer.iteration)
        words = f"training to {trainer.iteration + count} of {settings.iterations}"
        parts = trainer.train(count, lambda share: progress(words, DATA_PART + (1 - DATA_PART) * share))  # noqa: B023
        figures = mean_figures([trainer.judge(sample) for sample in judges.values()])
        trainer.curve.append(
            {
                "iteration": trainer.iteration,
                **parts,
                **{f"held_out_{name}": value for name, value in figures.items()},
                "seconds": time.perf_counter() - stretch_started,
            }
        )
        write_file(checkpoint, trainer.state())
        _write_curve(out, trainer.curve)
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


def make_data(out: Path, kinds: Sequence[Subject], data: ReliefData, tick: Callable[[float], None]) -> list[str]:
    """Photograph the fingers that are not there yet; return why those are not used that cannot be."""
    refused = []
    for done, subject in enumerate(kinds):
        tick(done / len(kinds))
        file = _name(out, *subject).with_suffix(".json")
        if not file.exists():
            write_file(
                file, (json.dumps(_store(out, *subject, data)) + "\n").encode()
            )  # last: it says that all is there
        facts = _facts(out, *subject)
        if "refused" in facts:
            refused.append(f"{subject[1]}: {facts['refused']}")
    return refused


def _store(out: Path, kind: str, number: int, data: ReliefData) -> dict[str, Any]:
    """Photograph one finger, whole or in pieces, and keep it; return its facts, or why it was refused."""
    try:
        if kind == "pieces":
            sample = training_crops(number, data)
            facts: dict[str, Any] = {"finger": number, "pieces": len(sample)}
        else:
            sample, facts = training_sample(number, data)
    except BadInput as error:
        return {"finger": number, "refused": str(error)}
    buffer = io.BytesIO()
    np.save(buffer, sample, allow_pickle=False)
    write_file(_name(out, kind, number).with_suffix(".npy"), buffer.getvalue())
    return facts


def _numbers(data: ReliefData) -> tuple[range, range, range]:
    """Numbers of the fingers to take pieces of, of the whole ones, and of those held out."""
    return (
        range(data.first, data.first + data.fingers),
        range(data.first_whole, data.first_whole + data.whole_fingers),
        range(HELD_OUT_FROM, HELD_OUT_FROM + data.held_out),
    )


def _name(out: Path, kind: str, number: int) -> Path:
    return out / "data" / f"{kind}_{number:07d}"


def _facts(out: Path, kind: str, number: int) -> dict[str, Any]:
    file = _name(out, kind, number).with_suffix(".json")
    try:
        facts = json.loads(read_file(file))
        require(isinstance(facts, dict), "no table")
        return dict(facts)
    except ValueError as error:
        raise BadInput(f"'{file}' is damaged ({error}); delete it and resume.") from error


def _load(out: Path, kind: str, numbers: Sequence[int], settings: ReliefSettings) -> Samples:
    """The fingers that were not refused, read as they are needed: they may be larger than the memory."""
    found = {}
    for number in numbers:
        if "refused" in _facts(out, kind, number):
            continue
        file = _name(out, kind, number).with_suffix(".npy")
        try:
            sample = np.load(file, mmap_mode="r", allow_pickle=False)
            shape = sample.shape[1:] if kind == "pieces" else sample.shape
            sound = len(shape) == 3 and shape[0] == CHANNELS and min(shape) >= settings.stride
            require(sound and sample.dtype == np.float16, f"it holds {sample.dtype} of the shape {sample.shape}")
        except (OSError, ValueError) as error:
            raise BadInput(f"'{file}' is damaged ({error}); delete it and its .json, and resume.") from error
        found[number] = sample
    return found


def _write_curve(out: Path, curve: list[dict[str, float]]) -> None:
    write_file(out / "curve.csv", curve_table(curve))
    if len(curve) < 2:
        return
    iterations = np.array([entry["iteration"] for entry in curve], dtype=np.float64)
    lines = [
        Line("training", iterations, np.array([UNIT_UM * math.sqrt(entry["relief"]) for entry in curve])),
        Line("held out", iterations, np.array([UNIT_UM * entry["held_out_rms"] for entry in curve])),
    ]
    write_file(out / "curve.svg", curve_chart(lines, "iteration", "error of the relief, µm"))
