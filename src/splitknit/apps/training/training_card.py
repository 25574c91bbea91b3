"""Network and card of one of `metric`'s networks as files."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from splitknit import __version__
from splitknit.apps.training.training_folder import plain, write_file
from splitknit.errors import require
from splitknit.model import FloatArray
from splitknit.networks.unet import network_of, run_network
from splitknit.networks.weights import read_network
from splitknit.training.network import load_torch
from splitknit.training.relief_network import network_from

Packed = Callable[[Mapping[str, Any], Mapping[str, Any], str], tuple[bytes, bytes]]


def write_files(
    out: Path, name: str, state: Mapping[str, Any], facts: Mapping[str, Any], packed: Packed
) -> dict[str, Any]:
    """Write network and card, read them back, and see that onnxruntime computes what torch does.

    Parameters
    ----------
    out : folder
    name : of the network
    state : torch's ``state_dict`` of the network
    facts : of its card: command, training, data, metrics
    packed : turns state, facts and name into the files' content

    Raises
    ------
    BadInput
        If `state` is of another network.
    """
    weights, card = packed(state, plain({"software": f"splitknit {__version__}", **facts}), name)
    write_file(out / f"{name}.onnx", weights)
    write_file(out / f"{name}.json", card)
    network = network_of(*read_network(out / f"{name}.onnx"))
    stride = network.card.stride
    shape = (network.card.channels_in, 8 * stride, 9 * stride)
    probe = np.random.default_rng(0).uniform(-0.3, 0.3, shape).astype(np.float32)
    wanted = runner_of(state)(probe)
    made = run_network(network, probe[None])[0]
    # weights are stored in half precision: a few parts in a thousand of the output's range
    difference = float(np.abs(made - wanted).max() / max(float(np.abs(wanted).max()), 1e-6))
    require(
        difference < 0.02,
        f"the exported network differs from the trained one by {100 * difference:.2g} %; report this.",
    )
    return {**network.card.facts, "bytes": len(weights), "onnx_difference": difference}


def runner_of(state: Mapping[str, Any]) -> Callable[[FloatArray], FloatArray]:
    """The network whose ``state_dict`` this is, as a function of fields (n, h, w), on the processor."""
    torch = load_torch()
    network = network_from({name: part.cpu() for name, part in state.items()})

    def run(fields: FloatArray) -> FloatArray:
        with torch.no_grad():
            made = network(torch.from_numpy(np.ascontiguousarray(fields[None])))[0]
        return np.asarray(made.numpy(), dtype=np.float32)

    return run


def stride_of(state: Mapping[str, Any]) -> int:
    """What the sides of that network's input are multiples of."""
    return int(2 ** (len(network_from(state).down) - 1))


def rounded(entry: Mapping[str, float]) -> dict[str, float | None]:
    """Figures for a card; None where there is none."""
    return {name: round(value, 4) if math.isfinite(value) else None for name, value in entry.items()}


def mean_figures(figures: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Mean of each figure over the fingers that have one."""
    found = {}
    for name in figures[0]:
        values = [entry[name] for entry in figures if math.isfinite(entry[name])]
        found[name] = float(np.mean(values)) if values else math.nan
    return found
