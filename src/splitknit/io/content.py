"""What the pictures themselves must show: light, not too much of it, and directions that determine a normal."""

from __future__ import annotations

from math import ceil, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.model import Band, BoolArray, PixelArray
from splitknit.steps import let_go

# When an image is refused as black or as overexposed; fractions of the full scale (255 or 65535) as stored.
_DARK_FRACTION = 0.01
"""An image is black if its bright pixels, black level and ambient light taken off, stay below this: two of 255
levels, below which 8 bits hold no shading, and the spread of a sensor's noise without light."""
_RELATIVE_DARK = 0.03
"""An image is unlit too if its bright pixels stay below this part of the band's median image; LEDs of one rig
differ by far less (a factor of two or three), stray light of a dark room is less."""
_BRIGHT_QUANTILE = 0.999
"""Which pixels are "bright": all but the brightest thousandth, so that hot pixels do not count as light."""
_FULL_SCALE = 0.995
"""A stored value from here on counts as clipped (254 of 255; 10- and 12-bit data shifted to 16 bits end above)."""
_LIT_FRACTION = 0.02
"""Pixels above this (black level taken off) are lit: the finger, not its black background."""
_SATURATED_FRACTION = 0.2
"""An image is overexposed if more than this part of the lit pixels is clipped. Glare on wet skin clips a few
per cent, which robust weights and a warning deal with; with a fifth gone, many pixels lose several lights."""
_SATURATED_AREA = 0.005
"""It must be more than this part of the whole image too: a dark object with a small highlight is no overexposure."""
_SAMPLE_PIXELS = 200_000
"""About so many pixels are looked at in an image, on a regular grid; enough for a thousandth to be 200 pixels."""


def check_content(band: Band) -> None:
    """Refuse a band in which an image is black, unlit, without any structure, or overexposed.

    An overexposed pixel is one in which two of the three channels are clipped: with one channel clipped (red, on light
    skin) the others still carry the shading. Raises BadInput naming the file and its LED.
    """
    ambient = _ambient_light(band)
    peaks = np.array([_check_image(band, k, ambient) for k in range(len(band.pixels))])
    scaled = peaks / band.exposure
    fraction = np.maximum(peaks / np.median(peaks), scaled / np.median(scaled))  # a short exposure is dark, but lit
    for k in range(len(peaks)):
        require(
            bool(fraction[k] >= _RELATIVE_DARK),
            f"{_name(band, k)} is almost black beside the other images (its bright pixels reach "
            f"{100 * fraction[k]:.1f} % of theirs): {_leds(band, k)} did not light; capture it again.",
        )


def _check_image(band: Band, k: int, ambient: NDArray[np.float32] | None) -> float:
    """Return the light of the bright pixels of image k as a fraction of the full scale."""
    scale = float(np.iinfo(band.pixels.dtype).max)
    sample = _sample(band.pixels[k])
    let_go(band.pixels)
    black, most = np.float32(band.black_level[k]), int(sample.max())
    require(
        most - float(black) > _DARK_FRACTION * scale,
        f"{_name(band, k)} is black: its largest value is {most} of {int(scale)}; check "
        f"{_leds(band, k)} and capture it again (or, if data of fewer bits were stored unscaled, scale them).",
    )
    require(
        most > int(sample.min()) or sample.size == 1,
        f"{_name(band, k)} shows nothing: every pixel is {most}; capture it again.",
    )
    clips_at = ceil(_FULL_SCALE * scale)
    if most >= clips_at:
        clipped = (sample >= clips_at).sum(axis=0) >= min(2, len(sample))
        lit = sample.max(axis=0) > black + np.float32(_LIT_FRACTION * scale)
        fraction = float(clipped.sum()) / max(1.0, float(lit.sum()))
        require(
            fraction <= _SATURATED_FRACTION or float(clipped.mean()) <= _SATURATED_AREA,
            f"{_name(band, k)} is overexposed: {100 * fraction:.0f} % of its lit pixels are at the full scale; capture "
            f"it again with a shorter exposure or a lower gain.",
        )
    light = sample.max(axis=0) - black
    if ambient is not None:
        light = np.maximum.reduce(sample - (black + ambient * np.float32(scale * float(band.exposure[k]))))
    peak = float(np.quantile(light, _BRIGHT_QUANTILE)) / scale
    require(
        peak > _DARK_FRACTION,
        f"{_name(band, k)} is black: its bright pixels reach {100 * max(peak, 0.0):.1f} % of the full scale"
        f"{' above the ambient image' if band.ambient is not None else ''}; check "
        f"{_leds(band, k)} and capture it again (or, if data of fewer bits were stored unscaled, scale them).",
    )
    return peak


def _ambient_light(band: Band) -> NDArray[np.float32] | None:
    """Sample (C, n) of the ambient light as a fraction of the full scale at exposure 1, in the images' channels."""
    if band.ambient is None:
        return None
    ambient = _sample(band.ambient) - np.float32(band.ambient_black_level)
    ambient *= np.float32(1.0 / (float(np.iinfo(band.ambient.dtype).max) * band.ambient_exposure))
    return ambient if len(ambient) == band.pixels.shape[3] else ambient.mean(axis=0, keepdims=True)


def mask_from_image(pixels: PixelArray, name: str) -> BoolArray:
    """Mask (H, W) that an image (H, W, C) shows: white (above half the scale), or 1 in an image of 0 and 1; BadInput if
    no pixel is white.
    """
    bright = pixels.max(axis=2)
    top = int(bright.max())
    half = 0 if top == 1 else int(np.iinfo(pixels.dtype).max) // 2
    mask: BoolArray = np.asarray(bright > half)
    require(bool(mask.any()), f"{name} is an empty mask: not one pixel is white; white marks the finger.")
    return mask


def _sample(image: PixelArray) -> NDArray[Any]:
    """Pixels (C, n) on a regular grid."""
    step = max(1, round(sqrt(image.shape[0] * image.shape[1] / _SAMPLE_PIXELS)))
    return np.ascontiguousarray(np.moveaxis(image[::step, ::step], 2, 0)).reshape(image.shape[2], -1)


def _name(band: Band, k: int) -> str:
    return band.files[k] if band.files else f"image {k} of the band '{band.name}'"


def _leds(band: Band, k: int) -> str:
    group = band.leds[k]
    return f"LED {group[0]}" if len(group) == 1 else "LEDs " + ", ".join(map(str, group))
