"""What a rig's polarising films do to its captures, undone: image shift, brightness and tint, light that they leak."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.imaging.band import GREY_WEIGHTS, linear_channels
from splitknit.model import Band, Capture, Films, FloatArray

_SIDE = 300
"""Images of about so many pixels a side are enough to compare two series."""
_BRIGHTER = 1.03
"""Crossed over parallel light beyond which films cannot be the cause."""


def aligned(capture: Capture) -> tuple[Capture, dict[str, Any], tuple[str, ...]]:
    """The capture whose crossed series has the place and the brightness of the parallel one; facts and warnings.

    The rig's films give both (:class:`splitknit.model.Films`). Without them the crossed series stays as it is: skin
    does not show its brightness, because light that is scattered once keeps its polarisation. In a path-traced finger
    behind films that pass the same, the crossed images have 0.89 of the parallel ones' red light, and 0.83 of the
    green, even under the light that the surface reflects least.

    Raises
    ------
    BadInput
        If the rig's films were measured under other LEDs.
    """
    parallel, crossed = capture.bands["white"], capture.bands.get("white_crossed")
    if crossed is None:
        return capture, {}, ()
    films = capture.rig.films
    if films is None:
        ratio = _over_parallel(capture)
        facts: dict[str, Any] = {"films": "taken as ideal", "crossed_over_parallel": round(ratio, 3)}
        note = (
            f"the crossed images are {ratio:.2f} times as bright as the parallel ones even where the finger shines "
            "least; exchange the series if they are swapped, or measure the films by 'splitknit calibrate polarisers'."
        )
        return capture, facts, (note,) if ratio > _BRIGHTER else ()
    brightness = np.array(films.brightness)[_lights(films, parallel)]
    if crossed.pixels.shape[3] == 1:
        brightness = brightness @ GREY_WEIGHTS[:, None]
    if films.shift_px != (0.0, 0.0) or films.scale != 1.0:
        pixels = np.stack([undone(image, films).reshape(image.shape) for image in crossed.pixels])
        crossed = replace(crossed, pixels=pixels)
    crossed = replace(crossed, transmission=brightness)
    return replace(capture, bands={**capture.bands, crossed.name: crossed}), {"films": "measured"}, ()


def _over_parallel(capture: Capture) -> float:
    """Crossed over parallel red light of the brighter pixels, under lights that are mirrored little there."""
    every = max(1, max(capture.shape) // _SIDE)
    bands = (capture.bands[name].sampled(every) for name in ("white", "white_crossed"))
    p, c = (linear_channels(band, capture.encoding, ("red",))[0] for band in bands)
    lit = p.min(axis=0) > 0.25 * np.percentile(p.mean(axis=0), 99)
    return float(np.median(np.percentile(c[:, lit] / p[:, lit], 70, axis=0))) if lit.any() else 1.0


def contrast(capture: Capture) -> NDArray[np.float64]:
    """Difference of parallel and crossed image over their sum (L,), for light that the surface itself reflects.

    Of the specular light M in both images, the films leave the part `leak` in the crossed one: 1 / extinction ratio +
    sin^2(angle error), about. So P - C = (1 - 2 leak) M, and depolarised light cancels. Ideal films give 1.
    """
    band, films = capture.bands["white"], capture.rig.films
    if films is None:
        return np.ones(len(band.leds))
    return np.asarray(1.0 - 2.0 * np.array(films.leak)[_lights(films, band)])


def crossed_place(films: Films, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """(2, 3) from columns and rows of the parallel image to where the crossed one shows the same."""
    x, y = (shape[1] - 1) / 2, (shape[0] - 1) / 2
    s, (dx, dy) = films.scale, films.shift_px
    return np.array([[s, 0.0, (1.0 - s) * x + dx], [0.0, s, (1.0 - s) * y + dy]])


def undone(image: FloatArray, films: Films) -> FloatArray:
    """A crossed image (h, w) or (h, w, C), of floats or as stored, resampled onto the parallel one's pixels."""
    matrix, size = crossed_place(films, image.shape), (image.shape[1], image.shape[0])
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    return np.asarray(cv2.warpAffine(image, matrix, size, flags=flags, borderMode=cv2.BORDER_REPLICATE))


def _lights(films: Films, parallel: Band) -> list[int]:
    """Entry of the films for every image."""
    entries = []
    for group in parallel.leds:
        require(
            group[0] in films.leds,
            f"LED {group[0]} lights a polarised image, but the rig's films were measured under LEDs "
            f"{', '.join(map(str, films.leds))} only; calibrate the polarisers again.",
        )
        entries.append(films.leds.index(group[0]))
    return entries
