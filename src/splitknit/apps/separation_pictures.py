"""Previews of separated light for people."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.model import FloatArray
from splitknit.separation import PhaseSeparation


def light_picture(light: FloatArray) -> NDArray[np.uint8]:
    """8 bits for people: black to the 99.9th percentile, sRGB curve; black where nothing is known."""
    known = np.isfinite(light)
    top = max(float(np.quantile(light[known], 0.999)) if known.any() else 1.0, 1e-12)
    scaled = np.clip(np.where(known, light, 0.0) / top, 0.0, 1.0)
    curve = np.where(scaled <= 0.0031308, 12.92 * scaled, 1.055 * scaled ** (1 / 2.4) - 0.055)
    return np.asarray(np.round(255 * curve), dtype=np.uint8)


def phase_picture(parts: PhaseSeparation) -> NDArray[np.uint8]:
    """The phase as hue, as bright as the modulation is strong."""
    known = np.isfinite(parts.phase_rad)
    hue = np.mod(np.where(known, parts.phase_rad, 0.0) / (2 * np.pi), 1.0) * 180.0
    strength = np.clip(np.where(known, parts.modulation, 0.0) / 0.5, 0.0, 1.0)
    coded = np.dstack([np.minimum(hue, 179.0), np.full(hue.shape, 200.0), 255.0 * strength])
    return np.asarray(cv2.cvtColor(np.round(coded).astype(np.uint8), cv2.COLOR_HSV2RGB), dtype=np.uint8)
