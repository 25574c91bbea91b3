"""A small camera sensor in the manner of the IMX219: exposure, noise, raw levels, white balance,
encoding."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit import Camera
from splitknit.errors import require
from splitknit.model import FloatArray, PixelArray
from splitknit.settings import Checked, Limits

RESPONSE: Mapping[str, tuple[float, float, float]] = {
    "white": (0.90, 1.00, 0.47),
    "nir": (1.00, 0.98, 0.97),
    "coloured": (0.86, 1.00, 0.83),
}
"""Signal of the red, green and blue pixels, relative: a white card under a white LED of 5000 K (CIE
LED-B3 through the IMX219's quantum efficiency), and under 850 nm, where the colour filters are
transparent; and each under an LED of its own colour (625, 525 and 465 nm)."""

FULL_SIZE = (2200, 3200)
"""Rows and columns of the full frame. Source: thesis."""
FULL_PX_PER_MM = 75.7
"""Scale of the full frame of the thesis's rig. Source: thesis, 757 pixels per cm."""


@dataclass(frozen=True, slots=True)
class SensorSettings(Checked):
    """How light becomes stored integers."""

    exposure: Annotated[float, Limits(0.05, 1.0)] = 0.7
    """Fraction of full scale that the brightest diffusely lit skin reaches; specular reflection may
    clip."""
    full_well_e: Annotated[float, Limits(100.0)] = 4700.0
    """Electrons at full scale, a pixel of the full frame."""
    read_noise_e: Annotated[float, Limits(0.0)] = 2.5
    """Standard deviation of the noise of reading out, electrons, a pixel of the full frame; 0 or
    more."""
    raw_bits: Annotated[int, Limits(8, 16)] = 10
    """Bits of the sensor's own levels, before they are brought to `bits`; 8 to 16."""
    bits: Literal[8, 16] = 8
    """Bits of the stored files: 8 or 16."""
    encoding: Literal["linear", "srgb"] = "linear"
    """``linear`` or ``srgb``."""
    binned: bool = True
    """At a scale below one a pixel collects the electrons of the full-frame pixels it covers."""
    demosaic: bool = False
    """Store one colour a pixel (RGGB) and interpolate bilinearly: softer, with correlated noise."""
    noise: bool = True
    """False keeps exact light, quantised."""


def binning_scale(camera: Camera) -> float:
    """Size of a sensor pixel relative to an image pixel: 1 = full resolution, 0.5 = 2 x 2 binned.

    A picture of the full frame's form (2200 x 3200) is the whole frame: its columns decide,
    whatever the lens and the distance. Any other picture is a cut-out, and its px_per_mm decides,
    as though the lens were the thesis's; a camera that shows more detail than that is not binned.
    """
    rows, columns = camera.image_size
    by_pitch = camera.px_per_mm / FULL_PX_PER_MM
    by_size = columns / FULL_SIZE[1]
    whole = abs(rows - FULL_SIZE[0] * by_size) <= 1.0
    # else the two are the same but for whole pixels
    if whole and abs(by_pitch - by_size) * FULL_SIZE[1] > 1.0:
        return min(by_size, 1.0)
    return min(by_pitch, 1.0)


_ROWS_AT_A_TIME = 64
"""Rows that are exposed together, which limits memory. Chosen on: speed. Range: any; the result is
the same, since noise is drawn row by row."""


def record(
    light: FloatArray,
    band: str,
    seed: np.random.SeedSequence,
    settings: SensorSettings | None = None,
    scale: float = 1.0,
) -> PixelArray:
    """Record white-balanced linear `light` (H, W, 3), 1 = full scale, as uint8 or uint16; `scale`:
    of the image relative to the full frame, for binning.

    The variance of a signal of n electrons is n + read noise squared; the shot noise is taken as
    Gaussian. Channels of low response are noisier, because the white balance amplifies them.
    """
    settings = settings or SensorSettings()
    require(
        light.ndim == 3 and light.shape[2] == 3,
        f"light must have the shape (H, W, 3), but it has {light.shape}.",
    )
    rng = np.random.default_rng(seed) if settings.noise else None
    raw = np.empty(light.shape, dtype=np.uint16)
    for top in range(0, light.shape[0], _ROWS_AT_A_TIME):
        part = slice(top, top + _ROWS_AT_A_TIME)
        raw[part] = _expose(light[part], RESPONSE[band], rng, settings, scale)
    if settings.demosaic:
        # Keep one colour a pixel, in the order red green / green blue, and interpolate the others
        # bilinearly
        mosaic = np.empty(raw.shape[:2], dtype=np.uint16)
        for row, column, channel in ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2)):
            mosaic[row::2, column::2] = raw[row::2, column::2, channel]
        raw = np.asarray(cv2.cvtColor(mosaic, cv2.COLOR_BayerBG2RGB), dtype=np.uint16)
    stored = np.empty(light.shape, dtype=np.uint8 if settings.bits == 8 else np.uint16)
    levels = 2**settings.raw_bits
    for c, response in enumerate(RESPONSE[band]):
        values = np.arange(levels) / ((levels - 1) * response)
        stored[..., c] = _encode(values.astype(np.float32), settings)[raw[..., c]]
    return stored


def _expose(
    light: FloatArray,
    response: tuple[float, float, float],
    rng: np.random.Generator | None,
    settings: SensorSettings,
    scale: float,
) -> NDArray[np.uint16]:
    """Raw levels of some rows, which `rng` gives noise in their order."""
    pixels = 1.0 / scale**2 if settings.binned else 1.0
    full = settings.full_well_e * pixels
    signal = light * (np.asarray(response, dtype=np.float32) * np.float32(full))
    if rng is not None:
        spread = np.maximum(signal, np.float32(0.0))
        spread += np.float32(settings.read_noise_e**2 * pixels)
        np.sqrt(spread, out=spread)
        spread *= rng.standard_normal(light.shape, dtype=np.float32)
        signal += spread
    levels = 2**settings.raw_bits - 1
    signal *= np.float32(levels / full)
    np.rint(signal, out=signal)
    return np.clip(signal, 0.0, np.float32(levels), out=signal).astype(np.uint16)


def _encode(light: NDArray[np.float32], settings: SensorSettings) -> PixelArray:
    value = np.clip(light, 0.0, 1.0)
    if settings.encoding == "srgb":
        value = np.where(
            value <= 0.0031308, 12.92 * value, 1.055 * value ** np.float32(1 / 2.4) - 0.055
        )
    if settings.bits == 16:
        return np.asarray(np.rint(value * np.float32(65535.0)), dtype=np.uint16)
    return np.asarray(np.rint(value * np.float32(255.0)), dtype=np.uint8)
