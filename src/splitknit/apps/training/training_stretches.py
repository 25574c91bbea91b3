"""The training of one of `metric`'s networks in a folder, some hundred iterations at a time."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from splitknit.apps.training.training_card import mean_figures
from splitknit.apps.training.training_folder import Progress, curve_chart, curve_table, read_file, write_file
from splitknit.report.charts import Line
from splitknit.training.fields_loop import FieldsTrainer
from splitknit.training.fields_settings import FieldsSettings

DATA_PART = 0.4
"""Of the progress bar."""
Entry = dict[str, float]
"""Of the learning curve."""


def train_in_stretches(
    out: Path,
    trainer: FieldsTrainer,
    settings: FieldsSettings,
    judges: Mapping[int, Any],
    *,
    progress: Progress,
    lines: Mapping[str, Callable[[Entry], float]],
    unit: str,
) -> None:
    """Train to the end, from the checkpoint in the folder if there is one; keep checkpoint and learning curve.

    Parameters
    ----------
    out : folder of the training
    trainer, settings : what to train, and how
    judges : samples of the fingers that are held out, by their numbers
    progress : hears of it
    lines : of the chart by their names: from an entry to a value
    unit : what the chart shows
    """
    checkpoint = out / "checkpoint.pt"
    if checkpoint.exists():
        trainer.restore(read_file(checkpoint))
    while trainer.iteration < settings.iterations:
        started = time.perf_counter()
        count = min(settings.report_every, settings.iterations - trainer.iteration)
        words = f"training to {trainer.iteration + count} of {settings.iterations}"
        parts = trainer.train(count, lambda share: progress(words, DATA_PART + (1 - DATA_PART) * share))  # noqa: B023
        figures = mean_figures([trainer.judge(sample) for sample in judges.values()])
        trainer.curve.append(
            {
                "iteration": trainer.iteration,
                **parts,
                **{f"held_out_{name}": value for name, value in figures.items()},
                "seconds": time.perf_counter() - started,
            }
        )
        write_file(checkpoint, trainer.state())
        write_file(out / "curve.csv", curve_table(trainer.curve))
        if len(trainer.curve) > 1:
            write_file(out / "curve.svg", _chart(trainer.curve, lines, unit))


def _chart(curve: list[Entry], lines: Mapping[str, Callable[[Entry], float]], unit: str) -> bytes:
    iterations = np.array([entry["iteration"] for entry in curve], dtype=np.float64)
    drawn = [Line(name, iterations, np.array([value(entry) for entry in curve])) for name, value in lines.items()]
    return curve_chart(drawn, "iteration", unit)
