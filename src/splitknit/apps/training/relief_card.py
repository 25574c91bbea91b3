"""Network and card of the relief as files, and what the card says of how good the network is."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from splitknit.apps.training.training_card import mean_figures, rounded, runner_of, stride_of, write_files
from splitknit.skin.learned import RELIEF_MM
from splitknit.training.relief import JUDGED_PX, NAME, Sample, judge_middle, packed

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
