"""Checks of pixel values: images must not be dark, overexposed or identical, and a mask must be
one."""

from __future__ import annotations

from collections.abc import Collection
from concurrent.futures import ThreadPoolExecutor
from math import ceil, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splitknit.capture import Band
from splitknit.errors import BadExposure, require
from splitknit.io.photos import Photo
from splitknit.model import BoolArray, PixelArray


def check_contents(bands: Collection[Band]) -> None:
    """Refuse bands as :func:`check_content`, and images with the same pixels (noise differs);
    BadInput names both."""
    with ThreadPoolExecutor(2) as pool:
        samples = list(pool.map(check_content, bands))
    seen: dict[bytes, tuple[Band, int]] = {}
    for band, of_band in zip(bands, samples, strict=True):
        for k, sample in enumerate(of_band):
            first, j = seen.setdefault(sample.tobytes(), (band, k))
            other = first is not band or j != k
            same = other and np.array_equal(first.pixels[j], band.pixels[k])
            require(
                not same,
                f"{image_name(first, j)} and {image_name(band, k)} hold the same pixels: "
                "one is a copy; correct the names, or capture it again.",
            )


def check_content(band: Band) -> list[NDArray[Any]]:
    """Samples (C, n) of a band's images; refuse it where one is black, unlit, without any
    structure, or overexposed.

    An overexposed pixel is one in which two of the three channels are clipped: with one channel
    clipped (red, on light skin) the others still carry the shading. Raises BadExposure naming the
    file and its LED.
    """
    ambient = _ambient_light(band)
    samples = [_sample(band.pixels, k) for k in range(len(band.pixels))]
    peaks = np.array([_check_image(band, k, each, ambient) for k, each in enumerate(samples)])
    scaled = peaks / band.exposure
    # a short exposure is dark, but lit
    fraction = np.maximum(peaks / np.median(peaks), scaled / np.median(scaled))
    for k, part in enumerate(fraction):
        require(
            part >= 0.03,  # LEDs of a rig differ by a factor of 3 at most
            f"{image_name(band, k)} is almost black beside the other images (its bright pixels"
            f" reach {100 * part:.1f} % of theirs): {_leds(band, k)} did not light; capture it"
            " again.",
            BadExposure,
        )
    return samples


def _check_image(
    band: Band, k: int, sample: NDArray[Any], ambient: NDArray[np.float32] | None
) -> float:
    """Return the light of the bright pixels of image k as a fraction of the full scale."""
    scale = float(np.iinfo(band.pixels.dtype).max)
    black = np.float32(band.black_level[k])
    most = int(sample.max())
    name = image_name(band, k)
    clips_at = ceil(0.995 * scale)  # 254 of 255; 10- and 12-bit data in 16 bits end above
    if most >= clips_at:
        clipped = (sample >= clips_at).sum(axis=0) >= min(2, len(sample))
        lit = sample.max(axis=0) > black + np.float32(0.02 * scale)  # not its black background
        fraction = float(clipped.sum()) / max(1.0, float(lit.sum()))
        # glare on wet skin clips a few per cent, which robust weights take; nor is a dark object
        # with a small highlight overexposed
        few = fraction <= 0.2 or float(clipped.mean()) <= 0.005
        require(
            few,
            f"{name} is overexposed: {100 * fraction:.0f} % of its lit pixels are at the full"
            " scale; capture it again with a shorter exposure or a lower gain.",
            BadExposure,
        )
    light = sample.max(axis=0) - black
    if ambient is not None:
        light = np.maximum.reduce(
            sample - (black + ambient * np.float32(scale * float(band.exposure[k])))
        )
    peak = float(np.quantile(light, 0.999)) / scale  # hot pixels are not light
    above = " above the ambient image" if band.ambient is not None else ""
    require(
        peak > 0.01,  # below 2 of 255 levels 8 bits hold no shading
        f"{name} is black: its bright pixels reach {100 * max(peak, 0.0):.1f} % of the full"
        f" scale{above}; check {_leds(band, k)} and capture it again (or, if data of fewer bits"
        " were stored unscaled, scale them).",
        BadExposure,
    )
    require(
        most > int(sample.min()) or sample.size == 1,
        f"{name} shows nothing: every pixel is {most}; capture it again.",
        BadExposure,
    )
    return peak


def _ambient_light(band: Band) -> NDArray[np.float32] | None:
    """Sample (C, n) of the ambient light as a fraction of the full scale at exposure 1, in the
    images' channels."""
    if band.ambient is None:
        return None
    dark = band.ambient
    ambient = _sample(dark.pixels[None], 0) - np.float32(dark.black_level)
    ambient *= np.float32(1.0 / (float(np.iinfo(dark.pixels.dtype).max) * dark.exposure))
    return ambient if len(ambient) == band.pixels.shape[3] else ambient.mean(axis=0, keepdims=True)


_GREY_PART = 0.7
"""Grey fraction of the pixels that are not black, above which a mask is taken for a picture: up to
0.12 of 360 drawn masks sharp, of JPEG or noisy; 5 of 240 feathered or enlarged ones are above the
limit; 0.72 and more of 272 photographs."""


def mask_from_image(pixels: PixelArray, name: str) -> BoolArray:
    """Mask (H, W) of an image (H, W, C): above half the scale, or 1 in an image of 0, 1; BadInput
    if none is, or if it is a picture, most of whose pixels are neither dark nor bright."""
    bright = pixels.max(axis=2)
    top = int(bright.max())
    half = 0 if top == 1 else int(np.iinfo(pixels.dtype).max) // 2
    mask: BoolArray = np.asarray(bright > half)
    require(
        bool(mask.any()),
        f"{name} is an empty mask: not one pixel is white; white marks the finger or object.",
    )
    drawn = bright > 0.1 * top
    part = float((drawn & (bright < 0.9 * top)).sum()) / float(drawn.sum())
    require(
        part < _GREY_PART,
        f"{name} is a picture and no mask: {100 * part:.0f} % of what is not black in it is not"
        " white either; paint the object white and all else black.",
    )
    return mask


def mask_of_photo(photo: Photo, name: str) -> BoolArray:
    """Mask (H, W) of a picture of any kind: what is not transparent, or as of
    :func:`mask_from_image`."""
    pixels = photo.pixels
    if photo.opaque is not None:
        pixels = photo.opaque[..., None].astype(np.uint8)
    elif pixels.dtype.kind == "f":
        pixels = np.rint(255.0 * np.clip(pixels, 0.0, 1.0)).astype(np.uint8)
    return mask_from_image(pixels, name)


SAMPLE_PIXELS = 200_000
"""Approximate number of pixels sampled from an image on a regular grid; a thousandth of them is
200. Chosen on: speed."""


def _sample(stack: PixelArray, k: int) -> NDArray[Any]:
    """Pixels (C, n) of image k on a regular grid."""
    _, rows, columns, channels = stack.shape
    step = max(1, round(sqrt(rows * columns / SAMPLE_PIXELS)))
    image = stack[k, ::step][:, ::step]
    return np.ascontiguousarray(np.moveaxis(image, 2, 0)).reshape(channels, -1)


def image_name(band: Band, k: int) -> str:
    """What messages call image k."""
    return band.files[k] if band.files else f"image {k} of the band '{band.name}'"


def _leds(band: Band, k: int) -> str:
    group = band.leds[k]
    return f"LED {group[0]}" if len(group) == 1 else "LEDs " + ", ".join(map(str, group))
