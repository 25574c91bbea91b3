"""What the twin knows about a capture, as plain arrays by name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.simulator.skin import CHANNELS, SkinSettings
from splitknit.simulator.surface import Surface


def surface_truth(surface: Surface) -> dict[str, NDArray[Any]]:
    """Heights, normals, mask, relief and landmarks; of a perspective camera also the points' x and y, and its lens."""
    truth: dict[str, NDArray[Any]] = {
        "height_mm": surface.height_mm,
        "shape_mm": surface.shape_mm,
        "mask": surface.mask,
        "normals": surface.normals,
        "relief_um": surface.relief_um,
        "pitch_mm": np.array(surface.camera.pitch_mm),
    }
    if surface.x_mm is not None and surface.y_mm is not None:
        truth |= {"x_mm": surface.x_mm, "y_mm": surface.y_mm} | _flat("camera", asdict(surface.camera))
    if surface.coat is not None:
        truth |= surface.coat.truth()
    return truth | _flat("landmark", surface.landmarks)


def optics_truth(skin: SkinSettings) -> dict[str, NDArray[Any]]:
    """Return the coefficients by channel, in the order red, green, blue, NIR, and the parameters they come from."""
    media = [skin.channel(channel) for channel in CHANNELS]
    truth: dict[str, NDArray[Any]] = {
        "optics_channels": np.array(CHANNELS),
        "optics_scattering_per_mm": np.array([m.scattering_per_mm for m in media]),
        "optics_absorption_per_mm": np.array([m.absorption_per_mm for m in media]),
        "optics_relief_gain_per_um": np.array([m.relief_gain_per_um for m in media]),
    }
    return truth | _flat("skin", asdict(skin))


def _flat(prefix: str, values: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    """One array for each entry; what is inside mappings and lists of arrays gets longer names."""
    result: dict[str, NDArray[Any]] = {}
    for key, value in values.items():
        name = f"{prefix}_{key}"
        if isinstance(value, Mapping):
            result |= _flat(name, value)
        elif isinstance(value, list):
            result |= _flat(name, {str(k): one for k, one in enumerate(value)})
        elif value is not None:
            result[name] = np.asarray(value)
    return result
