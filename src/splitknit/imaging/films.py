"""What a rig's polarising films do to its captures, undone: image shift, brightness and tint, light that they leak."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.imaging.band import GREY_WEIGHTS
from splitknit.model import Band, Capture, Films, FloatArray


def aligned(capture: Capture) -> tuple[Capture, dict[str, Any]]:
    """The capture whose crossed series has the place and the brightness of the parallel one, and facts on its films.

    The rig's films give both (:class:`splitknit.model.Films`). Without them the crossed series stays as it is: skin
    does not show its brightness, because light that is scattered once keeps its polarisation. In a path-traced finger
    behind films that pass the same, the crossed images have 0.89 of the parallel ones' red light, and 0.83 of the
    green, even under the light that the surface reflects least. Raises BadInput if the rig's films were measured under
    other LEDs.
    """
    parallel, crossed, films = capture.bands["white"], capture.bands.get("white_crossed"), capture.rig.films
    if crossed is None or films is None:
        return capture, {} if crossed is None else {"films": "taken as ideal"}
    brightness = np.array(films.brightness)[_lights(films, parallel)]
    if crossed.pixels.shape[3] == 1:
        brightness = brightness @ GREY_WEIGHTS[:, None]
    if films.shift_px != (0.0, 0.0) or films.scale != 1.0:
        pixels = np.stack([undone(image, films).reshape(image.shape) for image in crossed.pixels])
        crossed = replace(crossed, pixels=pixels)
    crossed = replace(crossed, transmission=brightness)
    return replace(capture, bands={**capture.bands, crossed.name: crossed}), {"films": "measured"}


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
