"""Whether the photographs were saved as JPEG."""

from __future__ import annotations

import cv2
import numpy as np

from splitknit.capture import Band
from splitknit.findings import Finding, Severity
from splitknit.imaging.pixels import Window, pick_channel
from splitknit.observation.observe import Observation

JPEG = (
    "the photographs were saved as JPEG, which loses fine detail: ridges of simulated fingers came"
    " out up to 18 % too low above 15 px/mm, and 61 to 89 % at 11; save PNG, TIFF or RAW."
)


def saved_as_jpeg(
    observation: Observation, window: Window
) -> tuple[dict[str, bool], list[Finding]]:
    """A fact where photographs are JPEG files, or show JPEG's blocks of 8 pixels in a window; of
    skin a doubt as well."""
    if not any(_was_jpeg(light.stored, window) for light in observation.bands.values()):
        return {}, []
    skin = observation.material == "skin"
    return {"jpeg": True}, [Finding("jpeg", JPEG, Severity.DOUBT)] if skin else []


def _was_jpeg(band: Band, window: Window) -> bool:
    """Whether a band's photographs are JPEG files, or show JPEG's blocks of 8 pixels."""
    if any(file.lower().endswith((".jpg", ".jpeg")) for file in band.files):
        return True
    stored = band.pixels[0][window][:1024, :1024].astype(np.float32)
    if band.pixels.dtype != np.uint8 or min(stored.shape[:2]) < 64:
        return False
    # the upper half of a block's frequencies
    image, k = pick_channel(stored, "grey"), np.arange(4, 8)
    waves = 0.5 * np.cos(np.pi / 16 * k[:, None] * (2 * np.arange(8) + 1)).astype(np.float32)
    total = np.zeros_like(image)
    for across in waves:
        rows = cv2.filter2D(image, cv2.CV_32F, across[None], anchor=(0, 0))
        for down in waves:
            total += np.minimum(
                np.abs(cv2.filter2D(rows, cv2.CV_32F, down[:, None], anchor=(0, 0))), 4.0
            )
    grids = sorted(float(total[i:-8:8, j:-8:8].mean()) for i in range(8) for j in range(8))
    # 0.66 to 0.85 at quality 97, 0.54 to 0.66 at 95, less below; 0.99 and more without JPEG, and
    # from 99 on
    return grids[0] < 0.92 * grids[1]
