"""Training of `metric`'s own network, which draws relief and glare: the public names of the parts.

What photometric stereo leaves of skin's light is taken apart by how it turns with the light's azimuth
(:mod:`splitknit.skin.features`); the network learns on simulated fingers what of it is relief and what is glare.
Arrays in, arrays and bytes out; what reads and writes files is ``splitknit train relief``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from splitknit.training.fields_pack import packed_fields
from splitknit.training.relief_batches import (
    CHANNELS,
    FIELDS,
    GLARE,
    OUTPUTS,
    RELIEF,
    WEIGHT,
    draw_batch,
    mirrored,
    transposed,
    turned_by,
)
from splitknit.training.relief_loop import JUDGED_PX, ReliefTrainer, judge_middle, judged
from splitknit.training.relief_loss import relief_losses, total_loss
from splitknit.training.relief_network import network_from, relief_network
from splitknit.training.relief_settings import ReliefSettings
from splitknit.training.samples import Sample

__all__ = [
    "CHANNELS",
    "FIELDS",
    "GLARE",
    "JUDGED_PX",
    "NAME",
    "OUTPUTS",
    "RELIEF",
    "WEIGHT",
    "ReliefSettings",
    "ReliefTrainer",
    "Sample",
    "draw_batch",
    "judge_middle",
    "judged",
    "mirrored",
    "network_from",
    "packed",
    "relief_losses",
    "relief_network",
    "total_loss",
    "transposed",
    "turned_by",
]

NAME = "relief"
WHAT = (
    "relief and glare of skin: the fields of splitknit.skin.features to the relief in 0.02 mm, seven "
    "waves of the glare over the light's azimuth in 0.05 of the green level, and the logarithm of the relief's "
    "variance"
)


def packed(state: Mapping[str, Any], facts: Mapping[str, Any], name: str = NAME) -> tuple[bytes, bytes]:
    """The files of a finished network: ONNX, its weights in half precision, and card; see :func:`packed_fields`."""
    return packed_fields(state, facts, name, WHAT)
