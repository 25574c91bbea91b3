"""Training of the network that mends the shape: the public names of the parts.

Where a finger turns away, ridges that nobody resolves and glare at grazing angles bend the shape that all bands agree
on (:mod:`splitknit.skin.shape_features`); the network learns on simulated fingers which slopes are missing. Arrays
in, arrays and bytes out; what reads and writes files is ``splitknit train shape``.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from splitknit.training.fields_pack import packed_fields
from splitknit.training.relief_network import network_from, relief_network
from splitknit.training.samples import Sample
from splitknit.training.shape_batches import (
    CHANNELS,
    FIELDS,
    OUTPUTS,
    SLOPES,
    TURNS,
    WEIGHT,
    draw_batch,
    without_nir,
)
from splitknit.training.shape_loop import ShapeTrainer
from splitknit.training.shape_loss import JUDGED_WIDE_PX, PARTS, judge_whole, judged, shape_losses
from splitknit.training.shape_settings import ShapeSettings

__all__ = [
    "CHANNELS",
    "FIELDS",
    "JUDGED_WIDE_PX",
    "NAME",
    "OUTPUTS",
    "PARTS",
    "SLOPES",
    "TURNS",
    "WEIGHT",
    "Sample",
    "ShapeSettings",
    "ShapeTrainer",
    "draw_batch",
    "judge_whole",
    "judged",
    "network_from",
    "packed",
    "relief_network",
    "shape_losses",
    "without_nir",
]

NAME = "shape"
WHAT = (
    "slopes that a finger's shape lacks: the fields of splitknit.skin.shape_features on the coarse grid to slopes "
    "along x and y in units of 0.1"
)


def packed(state: Mapping[str, Any], facts: Mapping[str, Any], name: str = NAME) -> tuple[bytes, bytes]:
    """The files of a finished network: ONNX, its weights in half precision, and card; see :func:`packed_fields`."""
    return packed_fields(state, facts, name, WHAT)
