"""Linear light of all images of a band: ambient removed, exposures made equal, colours
separated."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import lru_cache
from math import ceil
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.imaging.parameters import CHUNK_ROWS
from splitknit.imaging.view import lens_shading
from splitknit.model import Array, Band, BoolArray, FloatArray, PixelArray, coarse_grid
from splitknit.steps import let_go

# Linear light of one stored image.

CHANNELS = {"red": 0, "green": 1, "blue": 2}
GREY_WEIGHTS = np.array([0.299, 0.587, 0.114], dtype=np.float32)
"""Weights of red, green and blue in luma, the conversion behind the thesis's grey images. Source:
ITU-R BT.601."""


@lru_cache(maxsize=4)
def decode_table(dtype: np.dtype[Any], encoding: str) -> FloatArray:
    """Read-only table from stored integer to linear light in [0, 1]: ``linear`` or ``srgb`` (IEC
    61966-2-1)."""
    require(
        encoding in ("linear", "srgb"),
        f"encoding must be 'linear' or 'srgb', but it is '{encoding}'.",
    )
    full_scale = int(np.iinfo(dtype).max)
    values = np.arange(full_scale + 1, dtype=np.float64) / full_scale
    table = (_srgb_light(values) if encoding == "srgb" else values).astype(np.float32)
    table.setflags(write=False)
    return table


def _srgb_light(code: FloatArray) -> FloatArray:
    """Stored sRGB values in [0, 1] as linear light in [0, 1] (IEC 61966-2-1)."""
    return np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)


def srgb_code(light: FloatArray) -> FloatArray:
    """Linear light in [0, 1] as sRGB stores it (IEC 61966-2-1), in [0, 1]."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def linear_image(
    pixels: PixelArray,
    encoding: str,
    exposure: float = 1.0,
    black_level: float = 0.0,
    binning: float = 1,
) -> FloatArray:
    """Linear light (H // binning, W // binning, C) float32 of one stored image (H, W, C) uint8 or
    uint16.

    `exposure`: relative (time times gain), by which the light is divided; `black_level`: stored
    value of no light; `binning`: average blocks of this many pixels a side, a multiple of 1/8 from
    1 upwards; rows and columns that fill no block are dropped.
    """
    height, width = (int(n // binning) for n in pixels.shape[:2])
    table = decode_table(pixels.dtype, encoding)
    light = np.empty((height, width, pixels.shape[2]), dtype=np.float32)
    columns = ceil(width * binning)
    for top in range(0, height, CHUNK_ROWS):  # what is between stored values and means stays small
        part = slice(top, min(top + CHUNK_ROWS, height))
        stored = pixels[int(part.start * binning) : ceil(part.stop * binning), :columns]
        decoded = _decoded(np.ascontiguousarray(stored), table, encoding)
        if binning > 1:
            decoded = block_means(decoded, (part.stop - part.start, width), binning)
        light[part] = decoded.reshape(light[part].shape)
    light -= np.float32(np.interp(black_level, np.arange(table.size), table))
    light *= 1.0 / exposure
    return light


def block_means(image: NDArray[Any], shape: tuple[int, int], side: float) -> FloatArray:
    """Means (h, w) or (h, w, C) over blocks of `side` pixels, fractions of pixels by their area."""
    if side == int(side):
        means = cv2.resize(image, shape[::-1], interpolation=cv2.INTER_AREA)
    else:
        means = cv2.resize(image, None, fx=1 / side, fy=1 / side, interpolation=cv2.INTER_AREA)
    return np.asarray(means[: shape[0], : shape[1]])


def _decoded(stored: NDArray[Any], table: FloatArray, encoding: str) -> FloatArray:
    """Linear light of contiguous stored values, by `table` of :func:`decode_table`."""
    if encoding == "linear":
        light = stored.astype(np.float32)
        light *= table[1]
        return light
    if stored.dtype == np.uint8:
        return np.asarray(cv2.LUT(stored.view(np.uint8), table).reshape(stored.shape))
    return np.asarray(table[stored])


def pick_channel(light: FloatArray, channel: str) -> FloatArray:
    """One channel (h, w) of linear light (h, w, C)."""
    if light.shape[-1] == 1:
        return light[..., 0]
    if channel == "grey":
        return np.asarray(cv2.transform(light, GREY_WEIGHTS[None]).reshape(light.shape[:2]))
    return light[..., CHANNELS[channel]]


def bin_mean(image: FloatArray, factor: float) -> FloatArray:
    """Mean over blocks of `factor` x `factor` pixels of the last two axes; what fills no block is
    dropped."""
    if factor == 1:
        return image
    height, width = (int(n // factor) for n in image.shape[-2:])
    trimmed = image[..., : ceil(height * factor), : ceil(width * factor)]
    flat = trimmed.reshape(-1, *trimmed.shape[-2:])
    small = [block_means(plane, (height, width), factor) for plane in flat]
    return np.stack(small).reshape(*image.shape[:-2], height, width)


Window = tuple[slice, slice]


def linear_channels(
    band: Band,
    encoding: str,
    channels: Sequence[str],
    window: Window | None = None,
    binning: float = 1,
) -> FloatArray:
    """Linear light (C, L, h, w) of a band inside `window`: black level and ambient removed,
    exposures made equal.

    `channels`: names out of ``grey``, ``red``, ``green``, ``blue``; a grey file gives its one
    channel for all of them. L is the number of `band.lights`: where coloured LEDs share an
    exposure, each colour has an image of its own, without what the other colours leave in its
    pixels; it is had as ``grey`` alone. Negative values, which noise gives where there is no light,
    are kept: clipping would bias dark pixels upwards. `binning`: as of :func:`linear_image`.
    """
    unknown = set(channels) - {"grey", *CHANNELS}
    require(not unknown, f"channel '{', '.join(unknown)}' is not known.")
    require(
        not band.colours or set(channels) <= {"grey"},
        f"the band '{band.name}' was lit by coloured LEDs, one colour an image; it has no channels"
        " of one light.",
    )
    where = window or (slice(None), slice(None))
    ambient = ambient_light(band, encoding, where, binning)
    size = (int(n // binning) for n in band.pixels[0][where].shape[:2])
    stack = np.empty((len(channels), len(band.lights), *size), dtype=np.float32)
    first = _first_lights(band)
    levels = _clip_levels(band, encoding)

    def work(k: int) -> None:
        light = _lit_light(band, k, encoding, where, binning, ambient)
        let_go(band.pixels)
        if band.colours and band.colours[k][0]:
            separated = _colours_apart(light, band.colours[k], band.crosstalk, float(levels[k]))
            stack[:, first[k] : first[k] + len(separated)] = separated
            return
        for c, channel in enumerate(channels):
            stack[c, first[k]] = pick_channel(light, channel)

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(work, range(len(band.pixels))))
    return stack


def linear_stack(
    band: Band, encoding: str, channel: str = "grey", window: Window | None = None, binning: int = 1
) -> FloatArray:
    """One channel (L, h, w) of :func:`linear_channels`."""
    return np.asarray(linear_channels(band, encoding, (channel,), window, binning)[0])


def linear_survey(band: Band, encoding: str, binning: int = 1) -> tuple[FloatArray, FloatArray]:
    """Mean (h, w, C) float32 over all images with all channels (grey for coloured LEDs, which light
    different sides), and every image in grey, (L, h, w) as :func:`linear_stack`, never all of both
    in memory.
    """
    if band.colours:
        grey = linear_stack(band, encoding, "grey", binning=binning)
        return grey.mean(axis=0)[..., None], grey
    count = band.pixels.shape[0]
    height, width = (n // binning for n in band.pixels.shape[1:3])
    total = np.zeros((height, width, band.pixels.shape[3]), dtype=np.float32)
    grey = np.empty((count, height, width), dtype=np.float32)
    ambient = ambient_light(band, encoding, (slice(None), slice(None)), binning)

    def work(top: int) -> None:  # all images of a few rows: their sum stays in a core's cache
        part = slice(top, min(top + CHUNK_ROWS, height))
        rows = slice(part.start * binning, part.stop * binning)
        dark = None if ambient is None else ambient[part]
        for k in range(count):
            light = _lit_light(band, k, encoding, (rows, slice(None)), binning, dark)
            grey[k, part] = pick_channel(light, "grey")
            total[part] += light
            let_go(band.pixels)

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(work, range(0, height, CHUNK_ROWS)))
    total /= count
    return total, grey


def ambient_light(band: Band, encoding: str, window: Window, binning: float) -> FloatArray | None:
    """Linear light (h, w, C) of the ambient image inside a window; None where there is none."""
    if band.ambient is None:
        return None
    return linear_image(
        band.ambient[window], encoding, band.ambient_exposure, band.ambient_black_level, binning
    )


def _lit_light(  # noqa: PLR0917
    band: Band, k: int, encoding: str, window: Window, binning: float, ambient: FloatArray | None
) -> FloatArray:
    """Linear light (h, w, C) of image k without the ambient light; of two polarised series their
    mean. Where either clips in two channels, all have the light at which the parallel one does, so
    that it counts as clipped.
    """
    if band.crossed is None:
        return _series_light(band, k, encoding, window, binning, ambient)
    crossed_ambient = ambient_light(band.crossed, encoding, window, binning)
    parallel = _series_light(band, k, encoding, window, binning, ambient)
    crossed = _series_light(band.crossed, k, encoding, window, binning, crossed_ambient)
    let_go(band.crossed.pixels)
    clipped = _clipped(band, k, encoding, parallel, ambient)
    clipped |= _clipped(band.crossed, k, encoding, crossed, crossed_ambient)
    level = np.float32(_clip_levels(band, encoding)[k])
    return np.where(clipped, np.maximum(parallel, level), 0.5 * (parallel + crossed))


def _clipped(
    band: Band, k: int, encoding: str, light: FloatArray, ambient: FloatArray | None
) -> BoolArray:
    """(h, w, 1) where the light of image k clips in two channels."""
    stored = light if band.transmission is None else light * band.transmission[k].astype(np.float32)
    stored = stored if ambient is None else stored + ambient
    channels = (stored >= _clip_levels(band, encoding)[k]).sum(axis=-1, keepdims=True)
    return np.asarray(channels >= min(2, light.shape[-1]))


def _series_light(  # noqa: PLR0917
    band: Band, k: int, encoding: str, window: Window, binning: float, ambient: FloatArray | None
) -> FloatArray:
    """Linear light (h, w, C) of image k of one series without the ambient light, the lens's
    fall-off and the films' tint."""
    image = band.pixels[k]
    exposure = float(band.exposure[k])
    black = float(band.black_level[k])
    light = linear_image(image[window], encoding, exposure, black, binning)
    if ambient is not None:
        light -= ambient
    size = image.shape[:2]
    top, left = (part.indices(n)[0] for part, n in zip(window, size, strict=True))
    if band.shading:
        light /= lens_shading(band.shading, size, top, left, binning, light.shape)[..., None]
    if band.flat is not None:
        flat = flat_light(band, encoding)
        field = flat[k] / flat.mean()
        if band.promised is not None:
            field = field / band.promised[k]
        light /= flat_at(field, size, (top, left), binning, light.shape)[..., None]
    if band.transmission is not None:
        light /= band.transmission[k].astype(np.float32)
    return light


def flat_light(band: Band, encoding: str) -> FloatArray:
    """(L, h, w) linear light of a band's flat images. Raises BadInput if they are black in
    places."""
    assert band.flat is not None
    scale = float(np.iinfo(band.flat.dtype).max) / float(np.iinfo(band.pixels.dtype).max)
    return np.stack(
        [
            _lit(
                linear_image(image[..., None], encoding, float(exposure), scale * float(black))[
                    ..., 0
                ]
            )
            for image, exposure, black in zip(
                band.flat, band.exposure, band.black_level, strict=True
            )
        ]
    )


def _lit(flat: FloatArray) -> FloatArray:
    require(
        float(flat.min()) > 1e-4 * float(flat.max()) > 0.0,
        "the flat photographs are black in places; light the whole field, and check their black"
        " level.",
    )
    return flat


def coarse_flat(image: FloatArray) -> FloatArray:
    """A flat surface's image (H, W) on a coarse grid, smoothed over its pixels; BadInput if it is
    black in places."""
    return _lit(np.asarray(coarse_grid(image), dtype=np.float32))


def flat_at(
    flat: FloatArray,
    size: tuple[int, ...],
    corner: tuple[int, ...],
    binning: float,
    shape: tuple[int, ...],
) -> FloatArray:
    """A coarse flat image (h, w) of images of `size` on the pixels of a window that begins at
    `corner`."""
    y_step, x_step = np.array(flat.shape) / size
    x = (corner[1] + 0.5 * binning) * x_step - 0.5
    y = (corner[0] + 0.5 * binning) * y_step - 0.5
    matrix = np.array([[binning * x_step, 0.0, x], [0.0, binning * y_step, y]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(
        cv2.warpAffine(flat, matrix, shape[1::-1], flags=flags, borderMode=cv2.BORDER_REPLICATE)
    )


def _colours_apart(
    light: FloatArray, colours: Sequence[str], crosstalk: Array | None, clips_at: float
) -> FloatArray:
    """(n, h, w) light of each of the `colours` in an exposure (h, w, C), in the order red, green,
    blue. Light that clips in a channel is kept as stored, so that it still counts as clipped.
    """
    present = [c for name, c in CHANNELS.items() if name in colours]
    if light.shape[2] == 1:
        return np.moveaxis(light, 2, 0)
    if crosstalk is None:
        return np.ascontiguousarray(np.moveaxis(light[..., present], 2, 0))
    inverse = np.linalg.inv(crosstalk)[present]
    apart = np.moveaxis(cv2.transform(light, inverse).reshape(*light.shape[:2], len(present)), 2, 0)
    stored = np.moveaxis(light[..., present], 2, 0)
    return np.where(stored >= clips_at, stored, apart).astype(np.float32)


def _first_lights(band: Band) -> list[int]:
    """For each exposure the first of its images in the stack."""
    counts = (
        [len(set(names)) for names in band.colours] if band.colours else [1] * band.pixels.shape[0]
    )
    return [sum(counts[:k]) for k in range(len(counts))]


def saturation_levels(band: Band, encoding: str) -> Array:
    """Linear light (L,) at which each image clips, on the scale of :func:`linear_channels` with
    ambient left in."""
    count = np.diff([*_first_lights(band), len(band.lights)])
    levels = _clip_levels(band, encoding)
    if band.transmission is not None and not band.polarisation:
        levels = levels * (1.0 / band.transmission).mean(axis=1)
    return np.repeat(levels, count)


def _clip_levels(band: Band, encoding: str) -> Array:
    """The same for each exposure."""
    table = decode_table(band.pixels.dtype, encoding)
    black = np.interp(band.black_level, np.arange(table.size), table)
    return (0.985 - black) / band.exposure


def grey_as_grey(band: Band) -> Band:
    """The band in one channel where its three are equal: a grey camera's images that were stored as
    colour."""

    def equal(pixels: PixelArray) -> bool:
        least = pixels.min(axis=-1)
        return bool((pixels.max(axis=-1) - least <= np.iinfo(pixels.dtype).max // 255).all())

    def every_equal(step: int) -> bool:
        for image in band.pixels:
            if not equal(image[::step, ::step]):
                return False
            let_go(band.pixels)
        return True

    # a coarse look first, which nearly all coloured images end at
    if not has_colour(band) or not every_equal(16) or not every_equal(1):
        return band
    ambient, transmission = band.ambient, band.transmission
    if ambient is not None and not equal(ambient):
        return band
    if transmission is not None and np.ptp(transmission, axis=1).any():
        return band  # the images become coloured where they are divided by it
    return replace(
        band,
        pixels=band.pixels[..., 1:2],
        ambient=None if ambient is None else ambient[..., 1:2],
        transmission=None if transmission is None else transmission[:, -1:],
    )


def has_colour(band: Band) -> bool:
    """Whether the band's images carry three channels of one light."""
    return bool(band.pixels.shape[-1] == 3) and not band.colours
