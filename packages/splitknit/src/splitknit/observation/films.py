"""Photographs behind linear films: light as without them, and the light that the surface itself
reflects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from splitknit.errors import require
from splitknit.findings import Finding
from splitknit.imaging.geometry import bounding_box, wide_blur
from splitknit.imaging.pixels import GREY_WEIGHTS
from splitknit.model import Array, BoolArray, Films, FloatArray
from splitknit.observation.light import Light

NOT_SPECULAR = (
    "the crossed photographs are as bright as the parallel ones: were their folders exchanged, or"
    " did the camera change its exposure between the series?"
)
_ROWS = 64


def separate_polarised(parallel: FloatArray, crossed: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Specular and diffuse light of linear images through a parallel and a crossed analyser.

    What the surface reflects keeps its polarisation and passes the parallel analyser alone; half of
    what the skin has depolarised passes either. Light that was scattered once or twice stays in
    part with the specular light. `parallel` and `crossed`: (..., H, W) or (..., H, W, C) linear
    light of one exposure. Returns the difference, zero where noise makes it negative, and the
    crossed images as they are. Source: S. L. Jacques, J. C. Ramella-Roman and K. Lee, "Imaging skin
    pathology with polarized light", 2002.

    >>> specular, diffuse = separate_polarised(np.full((1, 4, 4), 0.5), np.full((1, 4, 4), 0.3))
    >>> float(specular[0, 0, 0].round(3)), float(diffuse[0, 0, 0])
    (0.2, 0.3)
    """
    return np.maximum(parallel - crossed, 0.0), crossed


def findings_on_series(
    parallel: FloatArray, crossed: FloatArray, mask: BoolArray
) -> tuple[Finding, ...]:
    """A finding where two series (L, H, W) are exchanged, or images of theirs were not lit from the
    same sides."""
    series = [np.maximum(stack[:, mask], 1e-6) for stack in (parallel, crossed)]
    if series[1].mean() >= series[0].mean():
        return (Finding("not-specular", NOT_SPECULAR),)
    # shows from where each image was lit
    shading = [light / light.mean(axis=0) for light in series]
    likeness = np.corrcoef(*shading)[: len(parallel), len(parallel) :]
    # an LED halfway between two others matches both
    wrong = np.flatnonzero(np.diag(likeness) < likeness.max(axis=0) - 0.1)
    if wrong.size == 0:
        return ()
    k = wrong[0]
    like = likeness[:, k].argmax()
    return (
        Finding(
            "series-order",
            f"crossed image {k} is lit as parallel image {like} is, not as image {k}"
            ": list both series in the same order of lights.",
        ),
    )


def specular_picture(specular: FloatArray, mask: BoolArray, sigma_px: float) -> FloatArray:
    """One specular image of all lights, of even brightness and contrast: the most legible picture
    of a finger.

    Returns (H, W) float32, standard deviations from the local mean, NaN outside the mask. Bright is
    skin that is turned towards half the angle between camera and a light: where it faces the
    camera, both flanks of a ridge; elsewhere one of them. `specular`: (L, H, W) specular light, or
    (1, H, W) its mean; `mask`: (H, W) where it is looked at; `sigma_px`: standard deviation, in
    pixels, of the Gaussian over which brightness and contrast are made even; about a ridge's
    period.

    >>> stack = np.random.default_rng(0).random((7, 40, 40))
    >>> specular_picture(stack, np.ones((40, 40), bool), 5.0).shape
    (40, 40)
    """
    light = specular.mean(axis=0)
    weight = mask.astype(np.float32)

    def smooth(values: FloatArray) -> FloatArray:
        return wide_blur(values * weight, sigma_px) / around

    around = np.maximum(wide_blur(weight, sigma_px), 1e-3)
    detail = light - smooth(light)
    contrast = np.sqrt(smooth(detail * detail))
    least = 1e-3 * max(float(contrast[mask].max(initial=0.0)), 1e-9)
    return np.where(mask, detail / np.maximum(contrast, least), np.nan)


def specular_of(white: Light, mask: BoolArray, px_per_mm: float) -> FloatArray | None:
    """The :func:`specular_picture` (H, W) inside `mask` of white light that is the mean of two
    series; None without films."""
    if white.crossed is None:
        return None
    rows, columns = bounding_box(mask)
    specular = np.zeros((rows.stop - rows.start, columns.stop - columns.start), dtype=np.float32)
    for top in range(rows.start, rows.stop, _ROWS):  # of all images a few rows at a time
        window = (slice(top, min(top + _ROWS, rows.stop)), columns)
        both = replace(white, crossed=None).at(1, window).grey, white.crossed.at(1, window).grey
        difference = separate_polarised(*both)[0]
        specular[top - rows.start : window[0].stop - rows.start] = difference.mean(axis=0)
    picture = np.full(mask.shape, np.nan, dtype=np.float32)
    even_px = 0.5 * px_per_mm  # about a ridge's period
    picture[rows, columns] = specular_picture(specular[None], mask[rows, columns], even_px)
    return picture


def picture_bytes(picture: FloatArray) -> NDArray[np.uint8]:
    """A specular picture (H, W) in 8 bits: its local mean 102, a standard deviation 51, 0 where it
    is not known."""
    return np.where(
        np.isfinite(picture), np.clip(np.nan_to_num(51 * picture + 102), 1, 255), 0
    ).astype(np.uint8)


# What a rig's polarising films do to its captures, undone: image shift, brightness and tint, light
# that they leak.


def aligned(crossed: Light, parallel: Light, films: Films) -> Light:
    """The crossed series with the place and the brightness of the parallel one.

    The rig's films give both (:class:`splitknit.model.Films`). Without them the crossed series
    stays as it is: skin does not show its brightness, because light that is scattered once keeps
    its polarisation. In a path-traced finger behind films that pass the same, the crossed images
    have 0.89 of the parallel ones' red light, and 0.83 of the green, even under the light that the
    surface reflects least. Raises BadInput if the rig's films were measured under other LEDs.
    """
    brightness = np.array(films.brightness)[_lights(films, parallel.stored.leds)]
    if not crossed.has_colour:
        brightness = brightness @ GREY_WEIGHTS[:, None]
    if films.shift_px != (0.0, 0.0) or films.scale != 1.0:
        place = crossed_place(films, crossed.shape)
        crossed = crossed.moved_by([place] * crossed.photographs)
    return crossed.divided_by(brightness)


def contrast(films: Films | None, parallel: Light) -> Array:
    """(P - C) / (P + C) of parallel and crossed image (L,), for light that the surface reflects:
    the films leave `leak` of it (about 1 / extinction ratio + sin^2(angle error)) in the crossed
    one, P - C = (1 - 2 leak) M. Ideal films: 1.
    """
    if films is None:
        return np.ones(parallel.photographs)
    return 1.0 - 2.0 * np.array(films.leak)[_lights(films, parallel.stored.leds)]


def crossed_place(films: Films, shape: tuple[int, ...]) -> Array:
    """(2, 3) from columns and rows of the parallel image to where the crossed one shows the
    same."""
    scale = films.scale
    x = (1.0 - scale) * ((shape[1] - 1) / 2) + films.shift_px[0]
    y = (1.0 - scale) * ((shape[0] - 1) / 2) + films.shift_px[1]
    return np.array([[scale, 0.0, x], [0.0, scale, y]])


def _lights(films: Films, groups: Sequence[Sequence[int]]) -> list[int]:
    """Entry of the films for the LEDs of every image."""
    entries = []
    for group in groups:
        require(
            group[0] in films.leds,
            f"LED {group[0]} lights a polarised image, but "
            f"the rig's films were measured under LEDs {', '.join(map(str, films.leds))} only"
            "; calibrate the polarisers again.",
        )
        entries.append(films.leds.index(group[0]))
    return entries
