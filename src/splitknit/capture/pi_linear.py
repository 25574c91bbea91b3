"""Pictures in proportion to light: the Pi's image processor straightened, or its sensor's raw values developed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require

RAW_BLACK = 64
"""Stored value of no light, of 1023."""
RAW_BITS = 10


def linear_tuning(tuning: Mapping[str, Any]) -> dict[str, Any]:
    """Return a tuning of the Pi's image processor without what bends light: tone curve, colour mixing, shading.

    Tuning files are lists of algorithms (version 2). The tone curve becomes the identity, the colour matrix the unit
    matrix, and the correction of lens shading, which would differ between captures, goes: the rig file has the lens's
    fall-off.
    """
    algorithms: list[dict[str, Any]] = []
    for entry in tuning.get("algorithms", []):
        kept: dict[str, Any] = {}
        for name, values in entry.items():
            if name == "rpi.contrast":
                kept[name] = {"ce_enable": 0, "gamma_curve": [0, 0, 65535, 65535]}
            elif name == "rpi.ccm":
                kept[name] = {"ccms": [{"ct": 5000, "ccm": [1, 0, 0, 0, 1, 0, 0, 0, 1]}]}
            elif name != "rpi.alsc":
                kept[name] = values
        if kept:
            algorithms.append(kept)
    names = {name for entry in algorithms for name in entry}
    require(
        "rpi.contrast" in names,
        "the camera's tuning file is of an unknown version; update libcamera (apt full-upgrade).",
    )
    return {**tuning, "algorithms": algorithms}


def developed(raw: NDArray[np.uint16], gains: tuple[float, float]) -> NDArray[np.uint16]:
    """White-balanced colours from raw values.

    Parameters
    ----------
    raw : (H, W) 10-bit values, blue green / green red
    gains : of red and blue

    Returns
    -------
    (H, W, 3) uint16, linear: red, green, blue; no light is at 64 of 1023 still, so that noise is not clipped
    """
    # OpenCV names a pattern by its second row and column: blue green / green red is "BayerRG", and RGB its order
    colours = np.asarray(cv2.cvtColor(np.ascontiguousarray(raw), cv2.COLOR_BayerRG2RGB), dtype=np.uint16)
    levels = np.arange(1 << RAW_BITS, dtype=np.float64) - RAW_BLACK
    step = 1 << (16 - RAW_BITS)
    result = np.empty_like(colours)
    for c, gain in enumerate((gains[0], 1.0, gains[1])):
        table = np.clip(np.rint((levels * gain + RAW_BLACK) * step), 0, 65535)
        table[-1] = 65535  # what the sensor clips is clipped in every channel
        result[..., c] = table.astype(np.uint16)[np.minimum(colours[..., c], (1 << RAW_BITS) - 1)]
    return result
