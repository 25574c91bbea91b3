"""A finished network of `metric` as the bytes of its files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from splitknit.networks.weights import card_bytes
from splitknit.training.network import export_onnx, unet_reach
from splitknit.training.relief_network import network_from


def packed_fields(state: Mapping[str, Any], facts: Mapping[str, Any], name: str, what: str) -> tuple[bytes, bytes]:
    """The files of a finished network: ONNX, its weights in half precision, and card.

    Parameters
    ----------
    state : ``state_dict`` of a :func:`splitknit.training.relief_network.relief_network`
    facts : what the card says beside channels, stride, reach and architecture: data, training, metrics, command, ...
    name : of the network
    what : it turns into what

    Raises
    ------
    BadInput
        If `state` belongs to another network.
    """
    network = network_from(state)
    widths = [int(level[0].out_channels) for level in network.down]
    fields, outputs = int(network.down[0][0].in_channels), int(network.out.out_channels)
    depth = len(widths) - 1
    weights = export_onnx(network, fields, 2**depth)
    head = {
        "channels_in": fields,
        "channels_out": outputs,
        "stride": 2**depth,
        "reach": unet_reach(depth),
        "what": what,
        "architecture": f"U-Net of {len(widths)} levels, widths {', '.join(map(str, widths))}",
        "licence": "Apache-2.0",
    }
    return weights, card_bytes(name, weights, {**head, **facts})
