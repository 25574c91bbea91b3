"""Linear light of all images of a band: ambient removed, exposures made equal, colours told apart."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.imaging.image import CHANNELS, decode_table, linear_image, pick_channel
from splitknit.imaging.lens import lens_shading
from splitknit.model import Band, FloatArray

Window = tuple[slice, slice]


def linear_channels(
    band: Band, encoding: str, channels: Sequence[str], window: Window | None = None, binning: int = 1
) -> FloatArray:
    """Linear light (C, L, h, w) of a band inside `window`: black level and ambient removed, exposures made equal.

    Parameters
    ----------
    band : Band
    encoding : ``linear`` or ``srgb``
    channels : names out of ``grey``, ``red``, ``green``, ``blue``; a grey file gives its one channel for all of them
    window : rows and columns, optional
    binning : average blocks of this many pixels a side

    Returns
    -------
    (C, L, h, w) float32
        L is the number of `band.lights`: where coloured LEDs share an exposure, each colour has an image of its own,
        without what the other colours leave in its pixels; it is had as ``grey`` alone. Negative values, which noise
        gives where there is no light, are kept: clipping would bias dark pixels upwards.
    """
    for channel in channels:
        require(channel == "grey" or channel in CHANNELS, f"channel '{channel}' is not known.")
        require(
            channel == "grey" or not band.colours,
            f"the band '{band.name}' was lit by coloured LEDs, one colour an image; it has no channel '{channel}'.",
        )
    where = window if window is not None else (slice(None), slice(None))
    ambient = _ambient_light(band, encoding, where, binning)
    shape = band.pixels[0][where].shape[:2]
    count = band.pixels.shape[0]
    stack = np.empty((len(channels), len(band.lights), shape[0] // binning, shape[1] // binning), dtype=np.float32)
    first, levels = _first_lights(band), _clip_levels(band, encoding)

    def work(k: int) -> None:
        light = _lit_light(band, k, encoding, where, binning, ambient)
        if band.colours and band.colours[k][0]:
            told = _told_apart(light, band.colours[k], band.crosstalk, float(levels[k]))
            stack[:, first[k] : first[k] + len(told)] = told
            return
        for c, channel in enumerate(channels):
            stack[c, first[k]] = pick_channel(light, channel)

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(work, range(count)))
    return stack


def linear_stack(
    band: Band, encoding: str, channel: str = "grey", window: Window | None = None, binning: int = 1
) -> FloatArray:
    """One channel (L, h, w) of :func:`linear_channels`."""
    return np.asarray(linear_channels(band, encoding, (channel,), window, binning)[0])


def linear_survey(band: Band, encoding: str, binning: int = 1) -> tuple[FloatArray, FloatArray]:
    """Mean over all images with all their channels, and every image in grey, without ever holding both for all.

    The mean of a band of coloured LEDs is grey: its colours came from different sides.

    Returns
    -------
    mean : (h, w, C) float32
    grey : (L, h, w) float32
        As :func:`linear_stack` gives it.
    """
    if band.colours:
        grey = linear_stack(band, encoding, "grey", binning=binning)
        return np.asarray(grey.mean(axis=0)[..., None], dtype=np.float32), grey
    count = band.pixels.shape[0]
    height, width = (n // binning for n in band.pixels.shape[1:3])
    total = np.zeros((height, width, band.pixels.shape[3]), dtype=np.float32)
    grey = np.empty((count, height, width), dtype=np.float32)
    ambient = _ambient_light(band, encoding, (slice(None), slice(None)), binning)

    def work(k: int) -> FloatArray:
        light = _lit_light(band, k, encoding, (slice(None), slice(None)), binning, ambient)
        grey[k] = pick_channel(light, "grey")
        return light

    with ThreadPoolExecutor(2) as pool:
        waiting = [pool.submit(work, k) for k in range(min(3, count))]
        for k in range(count):  # summed in their order, whichever thread was faster
            total += waiting.pop(0).result()
            if k + 3 < count:
                waiting.append(pool.submit(work, k + 3))
    total /= np.float32(count)
    return total, grey


def _ambient_light(band: Band, encoding: str, window: Window, binning: int) -> FloatArray | None:
    if band.ambient is None:
        return None
    return linear_image(band.ambient[window], encoding, band.ambient_exposure, band.ambient_black_level, binning)


def _lit_light(  # noqa: PLR0917
    band: Band, k: int, encoding: str, window: Window, binning: int, ambient: FloatArray | None
) -> FloatArray:
    """Linear light (h, w, C) of image k without the ambient light."""
    exposure, black = float(band.exposure[k]), float(band.black_level[k])
    light = linear_image(band.pixels[k][window], encoding, exposure, black, binning)
    if ambient is not None:
        light -= ambient
    if band.shading:
        rows, columns = (range(*part.indices(n)) for part, n in zip(window, band.pixels.shape[1:3], strict=True))
        fall_off = lens_shading(band.shading, band.pixels.shape[1:3], rows.start, columns.start, binning, light.shape)
        light /= fall_off[..., None]
    return light


def _told_apart(
    light: FloatArray, colours: Sequence[str], crosstalk: NDArray[np.float64] | None, clips_at: float
) -> FloatArray:
    """(n, h, w) light of each of the `colours` in an exposure (h, w, C), in the order red, green, blue.

    Light that clips in a channel is kept as it is stored, so that it still counts as clipped.
    """
    present = [c for name, c in CHANNELS.items() if name in colours]
    if light.shape[2] == 1:
        return np.moveaxis(light, 2, 0)
    if crosstalk is None:
        return np.ascontiguousarray(np.moveaxis(light[..., present], 2, 0))
    inverse = np.linalg.inv(np.asarray(crosstalk, dtype=np.float64))[present]
    apart = np.moveaxis(cv2.transform(light, inverse).reshape(*light.shape[:2], len(present)), 2, 0)
    stored = np.moveaxis(light[..., present], 2, 0)
    return np.where(stored >= np.float32(clips_at), stored, apart).astype(np.float32)


def _first_lights(band: Band) -> list[int]:
    """For each exposure the first of its images in the stack."""
    counts = [len(set(names)) for names in band.colours] if band.colours else [1] * band.pixels.shape[0]
    return [sum(counts[:k]) for k in range(len(counts))]


def saturation_levels(band: Band, encoding: str) -> NDArray[np.float64]:
    """Linear light (L,) at which each image clips, on the scale of :func:`linear_channels` with ambient left in."""
    count = np.diff([*_first_lights(band), len(band.lights)])
    return np.repeat(_clip_levels(band, encoding), count)


def _clip_levels(band: Band, encoding: str) -> NDArray[np.float64]:
    """The same for each exposure."""
    table = decode_table(band.pixels.dtype, encoding)
    black = np.interp(band.black_level, np.arange(table.size), table)
    return np.asarray((0.985 - black) / band.exposure)


def has_colour(band: Band) -> bool:
    """Whether the band's images carry three channels of one light."""
    return bool(band.pixels.shape[-1] == 3) and not band.colours
