"""Whether photographs were processed: saved as JPEG, or sharpened."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.capture import Band
from splitknit.findings import Finding, Severity
from splitknit.imaging.pixels import Window, pick_channel
from splitknit.model import BoolArray
from splitknit.observation.light import Light
from splitknit.observation.observe import Observation
from splitknit.observation.stored import decode_table

JPEG = (
    "the photographs were saved as JPEG, which loses fine detail: ridges of simulated fingers came"
    " out up to 18 % too low above 15 px/mm, and 61 to 89 % at 11; save PNG, TIFF or RAW."
)
SHARPENED = (
    "the photographs were sharpened: beside {:.0f} % of the finger's outline the background is"
    " darker than farther away; ridges come out too high; switch sharpening off, or save RAW."
)


def findings_on_processing(
    observation: Observation, window: Window, mask: BoolArray
) -> tuple[dict[str, bool], list[Finding]]:
    """A fact where photographs are JPEG files, or show JPEG's blocks of 8 pixels in a window; of
    skin a doubt as well, and where they were sharpened. `mask`: (H, W) of the finger."""
    jpeg = any(_was_jpeg(light.stored, window) for light in observation.bands.values())
    facts = {"jpeg": True} if jpeg else {}
    if observation.material != "skin":
        return facts, []
    findings = [Finding("jpeg", JPEG, Severity.DOUBT)] if jpeg else []
    dark = _dark_outline(observation.white, mask)
    # up to 0.32 on 93 sound fingers, 0.40 to 1 where an unsharp mask of 1 to 3 px (sigma) added
    # half the detail or all of it
    if dark > 0.36:
        words = SHARPENED.format(100 * dark)
        findings.append(Finding("sharpened-photographs", words, Severity.DOUBT))
    return facts, findings


_OFFSETS = np.arange(-10, 21)  # px from the outline, outwards
_INSIDE, _BESIDE, _FAR = _OFFSETS < -2, (_OFFSETS >= -1) & (_OFFSETS < 9), _OFFSETS > 10
_NEIGHBOURS = 16  # rays whose mean is one profile, as single pixels are noisy


def _dark_outline(light: Light, mask: BoolArray) -> float:
    """Fraction of the lit outline beside which the background is clearly darker than farther away,
    less the fraction where it is clearly brighter. An unsharp mask undershoots there (A. Polesel,
    G. Ramponi and V. J. Mathews, "Image enhancement via adaptive unsharp masking", IEEE TIP 9,
    2000); a lens's blur, and stray light, brighten it."""
    rays = _rays_across_outline(mask)
    table = decode_table(light.stored.pixels.dtype, light.encoding)
    darker = []
    for pixels in light.stored.pixels:
        values = table[pixels[rays]].mean(axis=-1)
        profiles = values.reshape(len(_OFFSETS), -1, _NEIGHBOURS).mean(axis=2)
        lit = profiles[_INSIDE].max(axis=0) > 10.0 * np.median(profiles[_FAR], axis=0)
        beside, far = (profiles[part][:, lit].min(axis=0) for part in (_BESIDE, _FAR))
        darker.append((beside < 0.7 * far).astype(np.float64) - (far < 0.7 * beside))
    signs = np.concatenate(darker)
    return float(signs.mean()) if signs.size >= 20 else 0.0


def _rays_across_outline(mask: BoolArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns (31, n) of the pixels at `_OFFSETS` from points of the outline, along its
    normals; without rays that leave the picture, or meet the mask again."""
    outlines, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    outline = max(outlines, key=len)[:, 0]  # column and row
    along = (np.roll(outline, -8, axis=0) - np.roll(outline, 8, axis=0)).astype(np.float64)
    along *= np.sign(cv2.contourArea(outline, oriented=True))
    normals = along[:, ::-1] * (1, -1) / np.maximum(np.hypot(*along.T), 1e-9)[:, None]
    places = np.rint(outline + _OFFSETS[:, None, None] * normals).astype(np.intp)
    kept = ((places >= 0) & (places < mask.shape[::-1])).all(axis=(0, 2))
    column, row = places[:, kept].transpose(2, 0, 1)
    clear = np.flatnonzero(~mask[row, column][_OFFSETS > 1].any(axis=0))
    clear = clear[: clear.size // _NEIGHBOURS * _NEIGHBOURS]
    return row[:, clear], column[:, clear]


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
