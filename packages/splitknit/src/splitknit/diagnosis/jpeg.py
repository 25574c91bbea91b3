"""Whether the photographs were saved as JPEG."""

from __future__ import annotations

import cv2
import numpy as np

from splitknit.diagnosis.parameters import (
    JPEG_GRID,
    JPEG_SIDE,
)
from splitknit.findings import Finding, Severity
from splitknit.finger.locate import Finger
from splitknit.imaging.band import pick_channel
from splitknit.model import Band, Capture

JPEG = (
    "the photographs were saved as JPEG, which loses fine detail: ridges of simulated fingers came"
    " out up to 18 % too low above 15 px/mm, and 61 to 89 % at 11; save PNG, TIFF or RAW."
)


def jpeg(capture: Capture, finger: Finger) -> tuple[dict[str, bool], list[Finding]]:
    """A fact where photographs are JPEG files, or show JPEG's blocks of 8 pixels; of skin a doubt
    as well."""
    if not any(_was_jpeg(band, finger) for band in capture.bands.values()):
        return {}, []
    return {"jpeg": True}, (
        [Finding("jpeg", JPEG, Severity.DOUBT)] if capture.material == "skin" else []
    )


def _was_jpeg(band: Band, finger: Finger) -> bool:
    """Whether a band's photographs are JPEG files, or show JPEG's blocks of 8 pixels."""
    if any(file.lower().endswith((".jpg", ".jpeg")) for file in band.files):
        return True
    stored = band.pixels[0][finger.window][:JPEG_SIDE, :JPEG_SIDE].astype(np.float32)
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
    return grids[0] < JPEG_GRID * grids[1]
