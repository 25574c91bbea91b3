"""Network and card of what mends the shape as files, and what the card says of how good the network is."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from splitknit.apps.training.training_card import mean_figures, rounded, runner_of, stride_of, write_files
from splitknit.skin.learned import SHAPE_SLOPE
from splitknit.training.shape import JUDGED_WIDE_PX, NAME, Sample, judge_whole, packed

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
