"""What the trainings of `metric`'s two networks share in cutting their samples."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import BadInput, require
from splitknit.model import FloatArray

Sample = NDArray[np.floating[Any]]
"""(channels, h, w), any float type."""
TRIES = 2000
"""Patches that are drawn before a training is given up for want of skin."""


def too_little_skin(side: int) -> BadInput:
    """Return what is raised when patches with enough skin cannot be found."""
    return BadInput(
        f"hardly any patch of {side} pixels holds enough skin to train on; take smaller patches or a lower least_trust."
    )


def one_scale(fields: FloatArray, least: float) -> FloatArray:
    """(n,) factors that bring fields (patches, n, h, w) to about one scale: one over their standard deviation.

    Parameters
    ----------
    fields : of a few patches
    least : a smaller standard deviation counts as this
    """
    return np.asarray(1.0 / np.maximum(fields.std(axis=(0, 2, 3)), least), dtype=np.float32)


def check_channels(samples: Sequence[Sample], channels: int) -> None:
    """Refuse samples of another shape.

    Raises
    ------
    BadInput
        If there are none, or one is not (channels, h, w).
    """
    require(len(samples) > 0, "there are no fingers to train on.")
    for sample in samples:
        require(
            sample.ndim == 3 and sample.shape[0] == channels and min(sample.shape) > 0,
            f"a finger to train on must have the shape ({channels}, h, w), but one has {sample.shape}.",
        )
