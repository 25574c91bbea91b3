"""Network and card of the relief as files, and what the card says of how good the network is."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from splitknit import __version__
from splitknit.apps.training_folder import plain, write_file
from splitknit.check import require
from splitknit.metric.learned import RELIEF_MM
from splitknit.separate.train_network import load_torch
from splitknit.separate.train_relief import JUDGED_PX, NAME, Sample, judge_middle, network_from, packed
from splitknit.separate.unet import network_of, run_network
from splitknit.separate.weights import read_network
from splitknit.types import FloatArray

UNIT_UM = 1000.0 * float(RELIEF_MM)
"""Unit of the network's relief, micrometres."""


def write_network(out: Path, state: Mapping[str, Any], facts: Mapping[str, Any]) -> dict[str, Any]:
    """Write network and card, read them back, and see that onnxruntime computes what torch does.

    Parameters
    ----------
    out : folder
    state : torch's ``state_dict`` of the network
    facts : of its card: command, training, data, metrics

    Raises
    ------
    BadInput
        If `state` is of another network.
    """
    weights, card = packed(state, plain({"software": f"splitknit {__version__}", **facts}))
    write_file(out / f"{NAME}.onnx", weights)
    write_file(out / f"{NAME}.json", card)
    network = network_of(*read_network(out / f"{NAME}.onnx"))
    stride = network.card.stride
    shape = (network.card.channels_in, 8 * stride, 9 * stride)
    probe = np.random.default_rng(0).uniform(-0.3, 0.3, shape).astype(np.float32)
    torch = load_torch()
    with torch.no_grad():
        wanted = network_from({name: part.cpu() for name, part in state.items()})(torch.from_numpy(probe[None])).numpy()
    made = run_network(network, probe[None])
    # weights are stored in half precision: a few parts in a thousand of the output's range
    difference = float(np.abs(made - wanted).max() / max(float(np.abs(wanted).max()), 1e-6))
    require(
        difference < 0.02,
        f"the exported network differs from the trained one by {100 * difference:.2g} %; report this.",
    )
    return {**network.card.facts, "bytes": len(weights), "onnx_difference": difference}


def network_metrics(state: Mapping[str, Any], samples: Mapping[int, Sample]) -> dict[str, Any]:
    """What a card says of how a network does on fingers that it was not trained on.

    Parameters
    ----------
    state : torch's ``state_dict`` of the network
    samples : fingers (41, h, w) by their numbers

    Returns
    -------
    dict with the figures of each finger, see :func:`splitknit.separate.train_relief.judged`, and their means
    """
    torch = load_torch()
    network = network_from({name: part.cpu() for name, part in state.items()})

    def run(fields: FloatArray) -> FloatArray:
        with torch.no_grad():
            made = network(torch.from_numpy(fields[None]))[0]
        return np.asarray(made.numpy(), dtype=np.float32)

    def rounded(entry: Mapping[str, float]) -> dict[str, float | None]:
        facts = {name: value for name, value in entry.items() if name != "rms"}
        facts["rms_um"] = UNIT_UM * entry["rms"]
        return {name: round(value, 4) if math.isfinite(value) else None for name, value in facts.items()}

    stride = 2 ** (len(network.down) - 1)
    figures = {number: judge_middle(run, sample, stride) for number, sample in samples.items()}
    return {
        "held_out": f"{len(figures)} simulated fingers not trained on, drawn from the same ranges; the middle "
        f"{JUDGED_PX} x {JUDGED_PX} pixels, on the smooth shape they would be trained on",
        "mean": rounded(mean_figures(list(figures.values()))),
        "fingers": [{"finger": number, **rounded(entry)} for number, entry in figures.items()],
    }


def mean_figures(figures: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Mean of each figure over the fingers that have one."""
    found = {}
    for name in figures[0]:
        values = [entry[name] for entry in figures if math.isfinite(entry[name])]
        found[name] = float(np.mean(values)) if values else math.nan
    return found
