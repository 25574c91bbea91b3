"""A capture of a white card as numbers: one image for every LED of the rig, checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.imaging.band import linear_image, linear_stack, pick_channel
from splitknit.model import Band, Capture, FloatArray, Led, Rig

# Images in a few hundred numbers: robust means over cells, which dust and noise hardly touch.


_ACROSS = 40
"""Cells along the image's longer side."""
_INNER = 5
"""A cell's brightness is the median of the means of this many blocks a side."""


def _cells_of(band: Band, encoding: str) -> tuple[Array, Array]:
    """Middles of the cells, (rows, columns, 2) columns and rows, and a band's linear grey light (L, rows, columns) in
    them: black level and ambient light removed, the lens's fall-off left in.
    """
    size = band.pixels.shape[1:3]
    require(
        min(size) >= 16 and max(size) >= _ACROSS,
        f"the images have {size[0]} x {size[1]} pixels, too few for a calibration; use at least {_ACROSS}.",
    )
    binning = max(1, round(max(size) / (_ACROSS * _INNER)))
    stack = linear_stack(band, encoding, "grey", binning=binning)
    inner = min(_INNER, max(1, max(size) // (binning * _ACROSS)))
    light = _median_blocks(stack, inner)
    side = binning * inner
    row, column = np.mgrid[: light.shape[1], : light.shape[2]] * side + (side - 1) / 2
    return np.stack([column, row], axis=-1), light


def _median_blocks(stack: FloatArray, side: int) -> Array:
    """Median (L, H // side, W // side) over blocks of `side` x `side`; what fills no block is dropped."""
    count, height, width = stack.shape
    rows, columns = height // side, width // side
    trimmed = stack[:, : rows * side, : columns * side].reshape(count, rows, side, columns, side)
    return np.median(trimmed.transpose(0, 1, 3, 2, 4).reshape(count, rows, columns, -1), axis=-1).astype(np.float64)


Array = NDArray[np.float64]


_MAX_CLIPPED_PERCENT = 0.5
"""An image is refused if more than this fraction of its pixels is at full scale."""
_FULL_SCALE = 0.985
"""A value from here on is at full scale."""
_MIN_LIGHT = 0.02
"""An image whose median is below this fraction of full scale is black."""


@dataclass(frozen=True, slots=True, eq=False)
class CardImages:
    """A white card under every LED of a rig, in the order of its LEDs."""

    pixels: Array
    """(N, 2) column and row of the cells' middles."""
    light: Array
    """(L, N) linear light of the LED alone, the lens's fall-off in it, by the exposure."""
    shape: tuple[int, int]
    """Rows and columns of cells."""
    ambient_percent: dict[str, float | None]
    """Of each band: light with all LEDs off, relative to the mean image; None where there is no such image."""
    exposures_given: bool
    """Whether the capture states how long it exposed, so that brightness can be compared with another day's."""
    brightest: Array
    """(L,) 99th percentile of each image's values, as a part of full scale."""


def led_name(leds: Sequence[Led], index: int) -> str:
    """Such as ``white 3``: an LED by its band and its number in it."""
    band = leds[index].band
    return f"{band} {sum(led.band == band for led in leds[:index])}"


def card_images(capture: Capture, rig: Rig, black_level: float | None = None) -> CardImages:
    """Condense a capture of a white card, each LED of the rig alone in one image. `black_level`: stored value of no
    light, where the capture does not state it. Raises BadInput if capture and rig do not fit, an LED has no image or
    several, or an image is black or clipped.
    """
    _check_fit(capture, rig)
    bands = [_with_black(band, black_level) for band in capture.bands.values()]
    order = _images_of_leds(bands, rig)
    for band in bands:
        for k in range(len(band.pixels)):
            _check_image(band, k, rig)
    cells = [_cells_of(replace(band, shading=()), capture.encoding) for band in bands]
    places = cells[0][0]
    stored = [
        [float(np.percentile(image[::4, ::4].max(axis=2), 99)) / np.iinfo(image.dtype).max for image in band.pixels]
        for band in bands
    ]
    return CardImages(
        pixels=places.reshape(-1, 2),
        light=np.stack([cells[b][1][k].ravel() for b, k in order]),
        shape=(places.shape[0], places.shape[1]),
        ambient_percent={
            band.name: _ambient_percent(band, capture.encoding, light)
            for band, (_, light) in zip(bands, cells, strict=True)
        },
        exposures_given=any(bool((band.exposure != 1.0).any()) for band in bands),
        brightest=np.array([stored[b][k] for b, k in order]),
    )


def _check_fit(capture: Capture, rig: Rig) -> None:
    own = capture.rig
    require(
        own.camera.image_size == rig.camera.image_size,
        f"the card's images have {own.camera.image_size[0]} x {own.camera.image_size[1]} pixels, but the rig's camera "
        f"has {rig.camera.image_size[0]} x {rig.camera.image_size[1]}; give the rig that took them.",
    )
    require(
        [led.band for led in own.leds] == [led.band for led in rig.leds],
        f"the card was taken with a rig of {len(own.leds)} LEDs, but the rig to calibrate has {len(rig.leds)} (or "
        f"orders its bands otherwise); give the rig that took them.",
    )
    for k, led in enumerate(rig.leds):
        require(
            led.position_mm is not None,
            f"LED {k} of the rig has a direction, but no position_mm; calibrate the lights first.",
        )


def _with_black(band: Band, black_level: float | None) -> Band:
    if black_level is None or (band.black_level != 0).any():
        return band
    return replace(band, black_level=np.full(len(band.black_level), black_level), ambient_black_level=black_level)


def _images_of_leds(bands: Sequence[Band], rig: Rig) -> list[tuple[int, int]]:
    """Band and image of every LED."""
    found: dict[int, tuple[int, int]] = {}
    for b, band in enumerate(bands):
        for k, group in enumerate(band.leds):
            require(
                len(group) == 1,
                f"image {k} of the band '{band.name}' is lit by {len(group)} LEDs; each LED must light the card alone.",
            )
            require(
                group[0] not in found,
                f"LED {group[0]} ({led_name(rig.leds, group[0])}) lights two images of the card; keep one.",
            )
            found[group[0]] = (b, k)
    missing = [f"{k} ({led_name(rig.leds, k)})" for k in range(len(rig.leds)) if k not in found]
    require(
        not missing,
        f"the card has {len(found)} images for the rig's {len(rig.leds)} LEDs: LED {', '.join(missing)} "
        f"{'is' if len(missing) == 1 else 'are'} missing; take the card under every LED.",
    )
    return [found[k] for k in range(len(rig.leds))]


def _check_image(band: Band, k: int, rig: Rig) -> None:
    name = band.files[k] if band.files else f"image {k} of the band '{band.name}'"
    pixels, full = band.pixels[k], float(np.iinfo(band.pixels.dtype).max)
    clipped = 100 * float((pixels.max(axis=2) >= _FULL_SCALE * full).mean())
    require(
        clipped <= _MAX_CLIPPED_PERCENT,
        f"{name} is clipped: {clipped:.1f} % of its pixels are at full scale (at most {_MAX_CLIPPED_PERCENT:g} % "
        f"may be); take the card with a shorter exposure.",
    )
    middle = (float(np.median(pixels[::4, ::4])) - float(band.black_level[k])) / full
    led = band.leds[k][0]
    require(
        middle > _MIN_LIGHT,
        f"{name} is black ({100 * middle:.1f} % of full scale): LED {led} ({led_name(rig.leds, led)}) did not light, "
        f"or the exposure is far too short.",
    )


def _ambient_percent(band: Band, encoding: str, light: Array) -> float | None:
    if band.ambient is None:
        return None
    image = linear_image(band.ambient, encoding, band.ambient_exposure, band.ambient_black_level, binning=2)
    return 100 * float(np.mean(pick_channel(image, "grey"))) / float(np.mean(light))
